"""From the search at a servo joint to an answer: findings with intervals, the joint's own numbers, verdict, and changes in
words."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from diagnose.evidence.held_out import compare
from diagnose.result import Estimate, FitFigures, Verdict
from diagnose.robot.result import JointResult, RobotFinding, Trace
from diagnose.robot.servos.fit import Fit, Number, covariance, determined, fit, slots_of
from diagnose.robot.servos.library import ServoLaw
from diagnose.robot.servos.motion import JointProblem
from diagnose.robot.servos.remains import black_box, tells
from diagnose.robot.servos.state import QUICK, JointSearch, Structure, held_out
from diagnose.robot.servos.weight import FACTOR, weight_factor, weight_line
from diagnose.thresholds import MOST
from mjsim.quantity import Motion, Quantity
from mjsim.robot.joint_kernel import SLOT, SLOTS

__all__ = ["AT_NOISE", "STARTS", "Scale", "answer", "changed", "scale_of", "scale_of_fit"]

LEAST_LOAD = (
    0.2  # of the servo's torque: what the links must take for their masses to set the scale, and not an error of friction
)
SMALL = 0.01  # relative change of a number that is not said: the kernel's step and the smoothed motion err by as much
KNOWN = 0.25  # standard deviation of a gain's logarithm below which the data tell the gain, and not only its ratios
AT_NOISE = 1.5  # times the noise: the largest rms of an error that is taken for noise
UNTOLD = math.log(1e3)  # half interval of a ratio's logarithm above which the ratio is not given
DRAWN = 20_000  # points of a trace at most
OWN = {
    "kp": ("kp", Quantity.STIFFNESS), "kv": ("kv", Quantity.DAMPING), "damp": ("kv + damping", Quantity.DAMPING),
    "damping": ("damping", Quantity.DAMPING), "armature": ("armature", Quantity.INERTIA), "zero": ("zero", Quantity.ANGLE),
    "friction": ("frictionloss", Quantity.TORQUE)
}  # fmt: skip


@dataclass(frozen=True)
class Scale:
    """Whether the data tell the torque scale of a joint; gain: coded kp (kv of a velocity servo) and its standard deviation."""

    identifiable: bool
    gain: float
    error: float


def scale_of(s: JointSearch) -> Scale:
    """From the covariance of the search's fit."""
    return scale_of_fit(s.problem, s.now.fit)


def scale_of_fit(p: JointProblem, found: Fit) -> Scale:
    """From the covariance of a fit of a joint."""
    V = covariance(p, found)
    main = "kv" if p.drive.velocity else "kp"
    k = next(i for i, n in enumerate(found.numbers) if n.slot == main)
    error = math.sqrt(V[k, k])
    gain = float(found.slots[SLOT[main]])
    drive = gain * (p.first - (p.series[:, 6] if p.drive.velocity else p.angle))[p.fitted]
    loaded = float(np.mean(p.series[p.fitted, 4] ** 2)) > LEAST_LOAD**2 * float(np.mean(drive**2))
    return Scale(loaded and error < KNOWN, float(found.x[k]), error)


def nominal_fit(s: JointSearch) -> Fit:
    """The file as given, counted in the weights of the search."""
    p = s.problem
    return Fit((), np.zeros(0), p.nominal, p.as_given.error(p.nominal), math.nan, s.weights)


def figures(s: JointSearch, fit: Fit) -> FitFigures:
    """Errors [rad | m], and over the spread of the measured position, on fitted and held-out samples."""
    p = s.problem
    held = held_out(p, fit.error, s.weights)
    rms = fit.rms(p.fitted)
    spread = math.sqrt(_spread(s, p.fitted))
    return FitFigures(rms, rms / spread, held.rms, held.nrmse)


def _spread(s: JointSearch, mask: np.ndarray) -> float:
    """Mean square of the measured position about the mean of each recording."""
    p, total, count = s.problem, 0.0, 0
    for k in range(len(p.sources)):
        a = p.angle[p.part(k)][mask[p.part(k)]]
        if len(a):
            total, count = total + float(np.sum((a - np.mean(a)) ** 2)), count + len(a)
    return total / max(count, 1) + 1e-300


def answer(s: JointSearch, scale: Scale, borrowed: str) -> JointResult:
    """The result of one joint; ``borrowed``: in words, where its gain comes from if its own data do not tell it."""
    p = s.problem
    V = covariance(p, s.now.fit)
    given = nominal_fit(s)
    found = tuple(_finding(s, law, V) for law in s.now.laws if not law.number)
    remains = black_box(p, s.now.fit)
    verdict, why = _verdict(s, given, bool(found), remains)
    errors = {"nominal": figures(s, given), "refitted": figures(s, _as_numbers(s)), "corrected": figures(s, s.now.fit)}
    refused = tuple(f"{k}: {v}" for k, v in s.refusals.items() if k not in {x.key for x in s.now.laws})
    motion = Motion.SLIDE if p.slide else Motion.HINGE
    own = {OWN[n.slot][0]: _estimate(p, n, float(x), float(V[i, i]), motion)
           for i, (n, x) in enumerate(zip(s.now.fit.numbers, s.now.fit.x, strict=True)) if n.slot in OWN}  # fmt: skip
    own |= _ratios(s, V, motion)
    nominal = {OWN[n.slot][0]: _file_value(s, n) for n in s.now.fit.numbers if n.slot in OWN}
    factor = weight_factor(s, V)
    if factor is not None:
        own, nominal = own | {FACTOR: factor}, nominal | {FACTOR: 1.0}
    result = JointResult(
        p.name, "m" if p.slide else "rad", verdict, _sentence(why, errors[_shown(verdict)], remains, borrowed, p.slide), found,
        errors, own,
        {**nominal}, remains, refused, tuple(_traces(s, given)), determined(p, s.now.fit),
    )  # fmt: skip
    if verdict is Verdict.PARAMETERS_ONLY and _is_met(s, given) and not changed(s, result, scale):
        # no number that can be told differs, and the file leaves noise, or nothing that a black-box model predicts
        told = _sentence(STARTS[Verdict.NO_MISMATCH], errors["nominal"], remains, borrowed, p.slide)
        return dataclasses.replace(result, verdict=Verdict.NO_MISMATCH, summary=told)
    if verdict is Verdict.NO_MISMATCH and np.any(s.problem.masses):
        # the joint alone tells no difference, but under the masses that the robot carries its numbers are others
        other = dataclasses.replace(
            result, verdict=Verdict.PARAMETERS_ONLY,
            summary=_sentence(STARTS[Verdict.PARAMETERS_ONLY], errors["corrected"], remains, borrowed, p.slide),
        )  # fmt: skip
        return other if changed(s, other, scale) else result
    return result


def _at_noise(s: JointSearch, f: Fit) -> bool:
    """Whether a fit leaves an error near the noise, on fitted and held-out samples."""
    p = s.problem
    return f.rms(p.held) < AT_NOISE * p.noise and f.rms(p.fitted) < AT_NOISE * p.noise


def _is_met(s: JointSearch, f: Fit) -> bool:
    """Whether a fit leaves an error near the noise, or one of which a black-box model predicts no more than it may."""
    if _at_noise(s, f):
        return True
    share, p_value = black_box(s.problem, f)
    return share <= s.options.remains or (p_value >= 0.05 and tells(s.problem, f.error, f.weights))


def _as_numbers(s: JointSearch) -> Fit:
    """The fit in which only numbers of the robot differ: without laws, or with those that are numbers."""
    return s.now.fit if s.now.laws and all(law.number for law in s.now.laws) else s.refitted.fit


def _file_value(s: JointSearch, n: Number) -> float:
    p = s.problem.nominal
    return float(p[SLOT["kv"]] + p[SLOT["damping"]]) if n.slot == "damp" else float(p[SLOT[n.slot]])


def _estimate(problem: object, n: Number, x: float, variance: float, motion: Motion) -> Estimate:
    half = 1.96 * math.sqrt(max(variance, 0.0))
    return Estimate(n.value(x), (n.value(x - half), n.value(x + half)), OWN[n.slot][1].unit(motion))


def _ratios(s: JointSearch, V: np.ndarray, motion: Motion) -> dict[str, Estimate]:
    """Friction and damping over the gain, which command and position tell without a scale."""
    at = {n.slot: i for i, n in enumerate(s.now.fit.numbers)}
    out: dict[str, Estimate] = {}
    if "kp" not in at:
        return out
    for slot, name, unit in (("friction", "friction / kp", Quantity.ANGLE), ("damp", "(kv + damping) / kp", Quantity.TIME)):
        if slot in at and s.now.fit.numbers[at[slot]].log:
            i, k = at[slot], at["kp"]
            half = 1.96 * math.sqrt(max(V[i, i] + V[k, k] - 2 * V[i, k], 0.0))
            if half > UNTOLD:
                continue
            value = float(s.now.fit.x[i] - s.now.fit.x[k])
            out[name] = Estimate(math.exp(value), (math.exp(value - half), math.exp(value + half)), unit.unit(motion))
    return out


def _values(s: JointSearch, law: ServoLaw, x: np.ndarray) -> dict[str, tuple[float, Quantity]]:
    p = slots_of(s.problem, s.now.fit.numbers, x, s.now.fit.slots)
    return law.values(dict(zip(SLOTS, map(float, p), strict=True)))


def _finding(s: JointSearch, law: ServoLaw, V: np.ndarray) -> RobotFinding:
    """A law with the intervals of its parameters by the delta method, its evidence and its equivalents."""
    x = s.now.fit.x
    motion = Motion.SLIDE if s.problem.slide else Motion.HINGE
    parameters: dict[str, Estimate] = {}
    for name, (value, quantity) in _values(s, law, x).items():
        gradient = np.zeros(len(x))
        for i in range(len(x)):
            step = np.zeros(len(x))
            step[i] = 1e-4
            high, low = (_values(s, law, y)[name][0] for y in (x + step, x - step))
            change = math.remainder(high - low, 2 * math.pi) if quantity is Quantity.PHASE else high - low
            gradient[i] = change / 2e-4
        half = 1.96 * math.sqrt(max(float(gradient @ V @ gradient), 0.0))
        logs = value > 0 and quantity is not Quantity.PHASE and half < value * 3
        low, high = (value * math.exp(-half / value), value * math.exp(half / value)) if logs else (value - half, value + half)
        parameters[name] = Estimate(value, (low, high), quantity.unit(motion))
    without = _without(s, law)
    step_ = s.step(without, s.now)
    before, after = (held_out(s.problem, y.fit.error, s.weights) for y in (without, s.now))
    evidence = {
        "held_out_error_before": before.rms, "held_out_error_after": after.rms,
        "p_value": min(1.0, step_.held.p_value * s.multiplicity(law)), "delta_chi2": s.gain(without.fit, s.now.fit, "fitted"),
        "hypotheses": s.multiplicity(law),
    }  # fmt: skip
    name = s.problem.name
    sentence = f"{law.sentence} {s.clock}" if law.is_delay and s.clock else law.sentence
    return RobotFinding(
        law.id, name, name, sentence, parameters, evidence, tuple(s.alike.get(law.key, ())), law.form, law.source, law.place
    )


def _without(s: JointSearch, law: ServoLaw) -> Structure:
    """The structure without one law, fitted."""
    rest = tuple(x for x in s.now.laws if x is not law)
    return s.without.get(law.key) or s.fitted(rest, s.refitted.fit.slots if not rest else s.cleared(rest))


STARTS = {
    Verdict.NO_MISMATCH: "The file as given does as well as one with its numbers refitted.",
    Verdict.PARAMETERS_ONLY: "The structure is right, its numbers are not.",
    Verdict.MISSING_PHYSICS: "Physics is missing at this joint.",
    Verdict.UNEXPLAINED: "Structure remains that none of the known effects accounts for.",
}
FEW = (
    "The error is above the noise of the position, a black-box model predicts part of it, and the held-out samples are too few "
    "to tell whether that is chance: record longer."
)
NOT_CARRIED = (
    "Refitted, the numbers of the file take most of the error on the fitted samples and none on the held-out ones: the "
    "structure of the file does not describe both."
)


def _verdict(s: JointSearch, given: Fit, found: bool, remains: tuple[float, float]) -> tuple[Verdict, str]:
    """Structure that a black-box model predicts, else effects, changed numbers, or nothing; and why, in words.

    Every answer but `unexplained` needs an error at the noise, or one of which a black-box model predicts no more than it may,
    by a test that could have shown more; that the file stands needs a refit that takes no more than `MOST` of its squared error
    where it is fitted.
    """
    p = s.problem
    if remains[0] > s.options.remains and not _at_noise(s, s.now.fit):
        if remains[1] < 0.05:
            return Verdict.UNEXPLAINED, STARTS[Verdict.UNEXPLAINED]
        if not tells(p, s.now.fit.error, s.now.fit.weights):
            return Verdict.UNEXPLAINED, FEW
    if found:
        return Verdict.MISSING_PHYSICS, STARTS[Verdict.MISSING_PHYSICS]
    best = _as_numbers(s)
    test = compare(*(held_out(p, x.error, s.weights, given.error - best.error, best.error) for x in (given, best)))
    if test.relative_gain > s.options.material and test.p_value < s.options.p_enter:
        return Verdict.PARAMETERS_ONLY, STARTS[Verdict.PARAMETERS_ONLY]
    if not _at_noise(s, given) and best.rms(p.fitted) ** 2 < (1.0 - MOST) * given.rms(p.fitted) ** 2:
        return Verdict.UNEXPLAINED, NOT_CARRIED
    return Verdict.NO_MISMATCH, STARTS[Verdict.NO_MISMATCH]


def _shown(verdict: Verdict) -> str:
    """Whose error the sentence of a verdict states: where nothing differs, that of the file."""
    return "nominal" if verdict is Verdict.NO_MISMATCH else "corrected"


def _sentence(start: str, fit: FitFigures, remains: tuple[float, float], borrowed: str, slide: bool) -> str:
    """Why a joint has its verdict, with the error that is left."""
    unit, factor = ("mm", 1e3) if slide else ("mrad", 1e3)
    left = f"{factor * fit.rms:.2f} {unit} rms is left on the fitted samples and {factor * fit.held_out_rms:.2f} {unit} held out"
    black = f"a black-box model predicts {100 * max(remains[0], 0.0):.1f} % of the held-out squared error"
    return f"{start} {left}; {black}.{' ' + borrowed if borrowed else ''}"


def changed(s: JointSearch, result: JointResult, scale: Scale) -> tuple[str, ...]:
    """In words, which of the file's numbers at this joint differ.

    One differs when it has changed by more than `SMALL`, its interval leaves the file's value out and the held-out error
    grows, by more than
    `RobotOptions.material` of its
    square, with the number held at the file's value and all others refitted.
    """
    if result.verdict is Verdict.NO_MISMATCH:
        return ()
    out = weight_line(result)
    for n in s.now.fit.numbers:
        name = OWN[n.slot][0] if n.slot in OWN else ""
        if name not in result.nominal_parameters or name not in result.linear_parameters:
            continue
        e, was = result.linear_parameters[name], result.nominal_parameters[name]
        own = n.slot in {x.slot for law in s.now.laws for x in law.numbers}
        bounded = e.value >= n.upper  # faster than the samples show: no value
        if (
            own
            or bounded
            or abs(e.value - was) < SMALL * abs(was)
            or e.ci95[0] <= was <= e.ci95[1]
            or (not scale.identifiable and n.slot == "armature")
            or not _matters(s, n, was)
        ):
            continue
        only = "" if scale.identifiable or n.slot == "zero" else " (by the scale that is assumed)"
        out.append(f"{name} of {result.joint}: {was:.4g} -> {e.value:.4g} {e.unit} [{e.ci95[0]:.4g}, {e.ci95[1]:.4g}]{only}")
    return tuple(out)


def _matters(s: JointSearch, n: Number, was: float) -> bool:
    """Whether a number held at the file's value costs held-out error, all others refitted."""
    others = tuple(x for x in s.now.fit.numbers if x is not n)
    base = slots_of(s.problem, (n,), np.array([n.coded(was)]), s.now.fit.slots)
    less = fit(s.problem, others, base, s.weights, QUICK)
    difference = less.error - s.now.fit.error
    test = compare(*(held_out(s.problem, x.error, s.weights, difference, s.now.fit.error) for x in (less, s.now.fit)))
    return test.relative_gain > s.options.material and test.p_value < s.options.p_enter


def _traces(s: JointSearch, given: Fit) -> list[Trace]:
    """Measured position and what the models give, by recording."""
    p, out = s.problem, []
    angle, speed = ("m", "m/s") if p.slide else ("rad", "rad/s")
    for k, (source, role) in enumerate(p.sources):
        part = p.part(k)
        counted = (p.fitted | p.held)[part]
        if not counted.any():
            continue
        every = max(1, (part.stop - part.start) // DRAWN)
        keep = slice(part.start, part.stop, every)
        t = np.arange(part.stop - part.start)[::every] * p.dt
        nominal, refitted, corrected = (p.angle[keep] - f.error[keep] for f in (given, s.refitted.fit, s.now.fit))
        velocity = np.gradient(p.angle[keep], every * p.dt) if len(t) > 1 else np.zeros_like(t)
        states = {"position": (p.angle[keep], angle), "velocity": (velocity, speed), "command": (p.first[keep], angle)}
        out.append(Trace(source, role, t, p.angle[keep], nominal, refitted, corrected, counted[::every], states))
    return out
