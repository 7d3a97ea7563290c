"""Signs, units and gear sides as hypotheses about a log, and which of them brings it to the model.

A hypothesis multiplies channels by known factors. Under the right one the inertia and the friction or gravity of the relation
(relation.py) come to within `PARAMETER_FACTOR` of the model's. A factor of the torque alone is no fault unless they come
together: an inertia that is twice as large is a parameter. The ratio of the angle to the integrated velocity needs no model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from diagnose.check.machine import Machine
from diagnose.check.relation import Fit, Pair, Ratio, Relation, Signals, compare_channels
from diagnose.check.thresholds import DISTINCT, INERTIA_RANGE, PARAMETER_FACTOR, RATIO_TOLERANCE, RESOLVED, Z_TEST

__all__ = ["Evidence", "Hypothesis", "Scale", "find_scale", "gather", "hypotheses"]

SPREAD = math.log(1.5)  # standard deviation of the logarithm of a parameter over its nominal value: most are within 50 %
CLOSE = 9.0  # difference of cost (3 standard deviations) within which hypotheses are equivalent
WORST = 1e3  # cost of a contradiction, as a negative inertia
NOTHING_EXPLAINED = (
    30.0  # cost of a torque of which nothing is explained; ten per cent of it is one hypothesis' standard deviation
)


@dataclass(frozen=True)
class Hypothesis:
    """Factors that turn logged channels into what they are called; kind: "none", "sign", "unit" or "side"; channel: which is
    wrong."""

    kind: str
    channel: str
    what: str
    advice: str
    torque: float = 1.0
    velocity: float = 1.0
    angle: float = 1.0
    time: float = 1.0

    @property
    def factor(self) -> float:
        """The factor of the channel that is wrong."""
        return next((f for f in (self.torque, self.velocity, self.angle, self.time) if f != 1.0), 1.0)

    def apply(self, s: Signals) -> Signals:
        """The channels as they would be."""
        v = None if s.velocity is None else self.velocity * s.velocity
        q = None if s.angle is None else self.angle * s.angle
        return Signals(self.time * s.dt, self.torque * s.torque, v, q)


NONE = Hypothesis("none", "", "as labelled", "")


def hypotheses(machine: Machine, signals: Signals) -> list[Hypothesis]:
    """All single faults that this machine and these channels allow."""
    turn, per_minute, degree = 2 * math.pi, math.pi / 30, math.pi / 180
    has_v, has_q = signals.velocity is not None, signals.angle is not None
    bind = "bind it with unit = "
    out = [Hypothesis("sign", "torque", "the torque has the opposite sign", "bind torque with gain = -1", torque=-1.0)]
    force = ("N", "mN", "kN") if not machine.hinge else ("N m", "mN m", "kN m")
    keys = ("mN", "kN") if not machine.hinge else ("mNm", "kNm")
    out += [
        Hypothesis("unit", "torque", f"the torque is in {name}, not {force[0]}", f'{bind}"{key}"', torque=factor)
        for name, key, factor in ((force[1], keys[0], 1e-3), (force[2], keys[1], 1e3)) if machine.hinge or key == "kN"
    ]  # fmt: skip
    out += [
        Hypothesis("unit", "time", f"the time is in {name}, not s", f'{bind}"{key}"', time=f, velocity=1.0)
        for name, key, f in (("ms", "ms", 1e-3), ("us", "us", 1e-6), ("ns", "ns", 1e-9))
    ]
    angles = (("deg", "deg", degree), ("rev", "rev", turn), ("mrad", "mrad", 1e-3)) if machine.hinge else (("mm", "mm", 1e-3),)
    speeds = (("deg/s", "deg/s", degree), ("rpm", "rpm", per_minute)) if machine.hinge else (("mm/s", "mm/s", 1e-3),)
    si = ("rad", "rad/s") if machine.hinge else ("m", "m/s")
    if has_q:
        out += [Hypothesis("unit", "angle", f"the angle is in {n}, not {si[0]}", f'{bind}"{k}"', angle=f) for n, k, f in angles]
    if has_v:
        out += [Hypothesis("unit", "velocity", f"the velocity is in {n}, not {si[1]}", f'{bind}"{k}"', velocity=f)
                for n, k, f in speeds]  # fmt: skip
    if has_v and has_q:
        out += [Hypothesis("sign", c, f"the {c} has the opposite sign", f"bind {c} with gain = -1", **{c: -1.0})
                for c in ("velocity", "angle")]  # fmt: skip
        degrees = f"angle and velocity are in {angles[0][0]} and {speeds[0][0]}"
        out.append(
            Hypothesis("unit", "angle", degrees, f'{bind}"{angles[0][1]}" and "{speeds[0][1]}"',
                       angle=angles[0][2], velocity=speeds[0][2])
        )  # fmt: skip
    for gear in machine.gears:
        out += _sides(gear, has_v, has_q)
    return out


def _sides(gear: float, has_v: bool, has_q: bool) -> list[Hypothesis]:
    """The channels at the other side of a gear: the torque, the motion, or one channel of it."""
    out = []
    for factor, low in ((gear, True), (1 / gear, False)):
        side, other = ("slow", "fast") if low else ("fast", "slow")
        text = f"of the gear of ratio {gear:.6g}, not on its {other} one"
        gain = f"bind it with gain = {factor:.6g}"
        # a torque logged on the slow side is larger by the ratio; a motion logged there is smaller
        torque_gain = f"bind it with gain = {1 / factor:.6g}"
        out.append(Hypothesis("side", "torque", f"the torque is on the {side} side {text}", torque_gain, torque=1 / factor))
        if has_v and has_q:
            out += [
                Hypothesis(
                    "side", "angle", f"angle and velocity are on the {side} side {text}", gain, angle=factor, velocity=factor
                ),
                Hypothesis(
                    "side", "angle", f"the angle is on the {side} side {text}", f"{gain}, or as second_angle", angle=factor
                ),
                Hypothesis("side", "velocity", f"the velocity is on the {side} side {text}", gain, velocity=factor),
            ]
        elif has_v or has_q:
            channel = "velocity" if has_v else "angle"
            out.append(Hypothesis("side", channel, f"the {channel} is on the {side} side {text}", gain, **{channel: factor}))
    return out


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the channels say under a hypothesis: a fit per response, and angle against velocity."""

    fits: tuple[Fit, ...]
    pair: Pair | None

    def cost(self) -> float:
        """Minus twice the log of the plausibility of the ratios, up to a constant."""
        total = 0.0
        for fit in self.fits:
            total += _distance(fit.inertia, SPREAD) + NOTHING_EXPLAINED * max(0.0, 1 - fit.explained)
            total += _distance(fit.gravity, SPREAD) if fit.gravity is not None else 0.0
            total += min(_distance(fit.loss, 2 * SPREAD), CLOSE) if fit.loss is not None else 0.0
        if self.pair is not None:
            total += min(_distance(self.pair.ratio, RATIO_TOLERANCE), WORST)
        return total

    def with_torque(self, factor: float) -> Evidence:
        """The same with the torque times a factor: the relation is linear in it, so that every ratio is."""
        if factor == 1.0:
            return self
        return replace(self, fits=tuple(_times(f, factor) for f in self.fits))

    def channels_agree(self) -> bool:
        """Whether the angle moves as the velocity says, to within the tolerance of a sensor's gain."""
        r = None if self.pair is None else self.pair.ratio
        return r is None or not (_rejected(r, 1 + RATIO_TOLERANCE) or (r.value < 0 and r.determined(RESOLVED)))

    def model_agrees(self) -> bool:
        """Whether no response contradicts the model's inertia (its gravity, where the inertia is not determined)."""
        return not any(_rejected(_leading(f), PARAMETER_FACTOR) for f in self.fits)

    def turned(self) -> bool:
        """Whether a response has a negative inertia and friction that drives, which no parameter makes."""
        return any(
            f.inertia.value < -Z_TEST * f.inertia.error and f.dissipated.value < Z_TEST * f.dissipated.error
            for f in self.fits if f.explained > 0
        )  # fmt: skip

    def supported(self) -> bool:
        """Whether every response has the model's inertia and its gravity, or friction where it has no gravity."""
        return bool(self.fits) and all(_supported(f) for f in self.fits)

    def common(self) -> float | None:
        """The factor that inertia and a second torque share, where they are determined and agree; else None."""
        for f in self.fits:
            second = f.gravity if f.gravity is not None and f.gravity.determined(RESOLVED) else f.loss
            if second is None or not second.determined(RESOLVED) or not f.inertia.determined(RESOLVED):
                continue
            if f.inertia.value > 0 and second.value > 0 and abs(math.log(f.inertia.value / second.value)) < 2 * SPREAD:
                return math.sqrt(f.inertia.value * second.value)
        return None

    def out_of_reach(self) -> Ratio | None:
        """The inertia over the model's where both it and a second torque are off, the same way, by more than a fit takes."""
        for f in self.fits:
            second = f.gravity if f.gravity is not None and f.gravity.determined(RESOLVED) else f.loss
            if second is None or (f.inertia.value > 1) != (second.value > 1):
                continue
            if _rejected(f.inertia, INERTIA_RANGE) and _rejected(second, INERTIA_RANGE):
                return f.inertia
        return None


@dataclass(frozen=True, eq=False)
class Scale:
    """The outcome: chosen hypothesis (NONE where the labels are right or nothing known mends them), its equivalents, evidence.

    contradicted: whether the labels are; labelled, evidence: the evidence under the labels, and under the chosen hypothesis.
    """

    chosen: Hypothesis
    equivalents: tuple[Hypothesis, ...]
    labelled: Evidence
    evidence: Evidence
    contradicted: bool
    responses: tuple[str, ...]


def gather(signals: Signals, machine: Machine, hypothesis: Hypothesis = NONE, hold: str = "held") -> Evidence:
    """The evidence under a hypothesis."""
    s = hypothesis.apply(signals)
    fits = [Relation(s, machine, n).fit(hold) for n in _responses(s)]
    return Evidence(tuple(f for f in fits if f is not None), compare_channels(s))


def _responses(s: Signals) -> tuple[str, ...]:
    return tuple(n for n, x in (("velocity", s.velocity), ("angle", s.angle)) if x is not None)


def find_scale(signals: Signals, machine: Machine, hold: str = "held") -> Scale:
    """Test the labels; where they are contradicted, every known hypothesis."""
    labelled = gather(signals, machine, NONE, hold)
    if not labelled.fits or (labelled.channels_agree() and labelled.model_agrees() and not labelled.turned()):
        return Scale(NONE, (), labelled, labelled, contradicted=False, responses=_responses(signals))
    motions: dict[tuple[float, float, float], Evidence] = {(1.0, 1.0, 1.0): labelled}
    every = []
    for h in _compatible(hypotheses(machine, signals), labelled, signals):
        key = (h.velocity, h.angle, h.time)
        if key not in motions:
            motions[key] = gather(signals, machine, replace(h, torque=1.0), hold)
        every.append((h, motions[key].with_torque(h.torque)))
    mends = [(h, e) for h, e in every if _mends(h, e, labelled)]
    if not mends:
        return Scale(NONE, (), labelled, labelled, contradicted=True, responses=_responses(signals))
    mends.sort(key=lambda he: he[1].cost())
    best = mends[0][1].cost()
    near = [(h, e) for h, e in mends if e.cost() - best < CLOSE]
    return Scale(
        near[0][0], tuple(h for h, _ in near[1:]), labelled, near[0][1], contradicted=True, responses=_responses(signals)
    )


def _compatible(every: Sequence[Hypothesis], labelled: Evidence, signals: Signals) -> list[Hypothesis]:
    """Those that leave the ratio of the channels alone where it is right, and mend it where it is not."""
    if labelled.pair is None or signals.velocity is None:
        return list(every)
    kept = []
    for h in every:
        ratio = labelled.pair.ratio.value * h.angle / h.time / h.velocity
        if ratio > 0 and abs(math.log(ratio)) < math.log(1 + RATIO_TOLERANCE) + Z_TEST * labelled.pair.ratio.error:
            kept.append(h)
    return kept


def _mends(h: Hypothesis, e: Evidence, labelled: Evidence) -> bool:
    """Whether a hypothesis takes the contradiction away and has the support that its kind needs."""
    if not e.fits or not e.channels_agree() or not e.model_agrees() or e.turned():
        return False
    if not labelled.channels_agree() or (h.kind == "sign" and labelled.turned()):
        return True  # the ratio of the channels, or a negative inertia, is evidence without a second torque
    return max(abs(h.factor), 1 / abs(h.factor)) >= DISTINCT and e.supported()


def _times(fit: Fit, factor: float) -> Fit:
    def scaled(r: Ratio | None) -> Ratio | None:
        return None if r is None else Ratio(factor * r.value, abs(factor) * r.error)

    inertia, dissipated = scaled(fit.inertia), scaled(fit.dissipated)
    assert inertia is not None
    assert dissipated is not None
    return replace(
        fit, inertia=inertia, loss=scaled(fit.loss), gravity=scaled(fit.gravity), dissipated=dissipated, extra=scaled(fit.extra),
        target=factor * fit.target, residual=factor * fit.residual,
    )  # fmt: skip


def _leading(fit: Fit) -> Ratio:
    if not fit.inertia.determined(RESOLVED) and fit.gravity is not None and fit.gravity.determined(RESOLVED):
        return fit.gravity
    return fit.inertia


def _rejected(ratio: Ratio, factor: float) -> bool:
    """Whether a ratio is outside [1 / factor, factor] at the level of one test."""
    if not ratio.determined(RESOLVED):
        return False
    if ratio.value <= 0:
        return False  # a matter of signs
    return abs(math.log(ratio.value)) - Z_TEST * ratio.error / ratio.value > math.log(factor)


def _supported(fit: Fit) -> bool:
    if not fit.inertia.determined(RESOLVED) or not _within(fit.inertia):
        return False
    if fit.gravity is not None and fit.gravity.determined(RESOLVED):
        return _within(fit.gravity)
    return fit.loss is not None and fit.loss.determined(RESOLVED) and _within(fit.loss)


def _within(ratio: Ratio) -> bool:
    return ratio.value > 0 and abs(math.log(ratio.value)) < math.log(PARAMETER_FACTOR)


def _distance(ratio: Ratio, spread: float) -> float:
    """Squared distance of a ratio from 1 in standard deviations of its logarithm, its own error included."""
    if not math.isfinite(ratio.value) or ratio.value <= 0:
        return WORST if math.isfinite(ratio.value) and ratio.determined(RESOLVED) else CLOSE
    error = min(ratio.error / ratio.value, 3.0)
    return math.log(ratio.value) ** 2 / (spread**2 + error**2) + math.log1p((error / spread) ** 2)
