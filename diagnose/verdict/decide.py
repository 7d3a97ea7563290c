"""Decisions after the search: intervals, p-values, equivalents, what the angle channel rules out, what to measure next."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from diagnose.data.experiment import Experiment, measured_angle
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.result import Estimate, Finding
from diagnose.structure.search import ALIKE_C, Search
from mjsim.axis import Axis
from mjsim.effects import Effect, registered
from mjsim.ode import DivergedError, simulate

__all__ = ["equivalents", "estimates", "excluded_by_angle", "next_experiment", "p_values", "unphysical"]

BLOCKS = 16  # of a recording: five errors from so few are 1.6e-4 by Student's distribution
FURTHER = 3.0  # times the travel of the recording: an excitation that takes the axis further is not asked for


def estimates(fitted: Fitted, fitter: Fitter, owner: str) -> dict[str, Estimate]:
    """Values with 95 % intervals of the parameters of one owner ("" the linear structure, else an effect's key).

    A phase is given within half a turn of zero: a fit may have gone round.
    """
    errors = fitted.standard_errors(fitter.noise_known)
    out = {}
    motion = fitter.nominal.chain.motion
    for e, x, s in zip(fitted.hypothesis.entries, fitted.fit.x, errors, strict=True):
        if e.owner != owner or e.recording > 0 or e.name == "initial_velocity":
            continue
        value = e.si(float(x))
        if e.name == "phase_rad":
            value = math.remainder(value, 2 * math.pi)
        out[e.name] = Estimate(value, (value - 1.96 * float(s), value + 1.96 * float(s)), e.quantity.unit(motion))
    return out


def p_values(search: Search, poorer: Fitted, richer: Fitted) -> tuple[float, float, float]:
    """(held-out one-sided p, estimation likelihood-ratio p, gain of chi-square in units of the richer model's variance)."""
    from scipy.special import chdtrc

    held = search.compared(poorer, richer).p_value
    gain = richer.n * math.log(poorer.chi2 / richer.chi2)
    extra = max(1, len(richer.hypothesis.entries) - len(poorer.hypothesis.entries))
    return held, float(chdtrc(extra, max(gain, 0.0))), gain


def equivalents(search: Search, best: Fitted, effect: Effect, margin: float = ALIKE_C) -> tuple[str, ...]:
    """Identifiers that could stand in this effect's place: same rest of the structure, criterion within ``margin``.

    A margin of 10 in C is a likelihood ratio of 150; two structures closer than that are not told apart. One that merely
    refines the effect, and gains nothing by it, is not an equivalent.
    """
    rest = {k for k in best.key if k != effect.key}
    out = []
    for f in search.pool.values():
        others = set(f.key) - rest
        if len(f.key) != len(best.key) or len(others) != 1 or not rest <= set(f.key):
            continue
        (key,) = others
        if key == effect.key or search.ahead(best, f) > margin:
            continue
        rival = next(e for e in f.effects if e.key == key)
        if rival.name() == effect.name() and rival.place == effect.place:
            continue
        if effect.id in type(rival).refines and len(f.hypothesis.entries) > len(best.hypothesis.entries):
            continue
        out.append((search.criterion(f), rival.name() if rival.name() != effect.name() else rival.key))
    return tuple(dict.fromkeys(name for _, name in sorted(out)))


def excluded_by_angle(experiments: Sequence[Experiment]) -> dict[str, str]:
    """Effects that the angle channel contradicts without any model: each with the effect beside which alone it may stand, or "".

    An offset of the velocity sensor shows as its drift from the angle; where it does, the axis itself does not move so, as by
    an offset of the torque it would: that may be there as well, but not in place of it.
    """
    verdicts = []
    for experiment in experiments:
        r = experiment.recording
        if r.velocity is None or r.angle is None or len(r) < 100:
            continue
        d = r.velocity[:-1] * 0.5 + r.velocity[1:] * 0.5 - np.diff(r.angle) / r.dt
        if np.std(d) < 1e-9 * np.std(r.velocity):
            continue  # one channel was computed from the other
        # mean of v minus slope of q; its error from what blocks of the recording differ by, since noise may be coloured
        blocks = [float(np.mean(b)) for b in np.array_split(d, BLOCKS)]
        error = float(np.std(blocks, ddof=1)) / math.sqrt(BLOCKS) + 1e-4 * float(np.std(r.velocity)) / math.sqrt(len(r))
        offset = float(np.mean(d))
        verdicts.append(abs(offset) > 5 * error)
    known = registered()
    shown = [name for name, cls in known.items() if cls.shown_by_angle]
    if verdicts and all(verdicts):
        return {name: other for name, cls in known.items() for other in cls.taken_for if other in shown}
    return dict.fromkeys(shown, "") if verdicts and not any(verdicts) else {}


def unphysical(axis: Axis) -> tuple[str, ...]:
    """Nominal values that no passive mechanism has."""
    out = [
        f"The nominal damping at {c.joint!r} is negative ({c.damping:g}): no passive spring has that. It may stand for a delay, "
        "for friction or for a further mode that was left out when it was identified."
        for c in axis.chain.couplings
        if c.damping < 0
    ]
    out += [
        f"The nominal viscous friction at {b.joint!r} is negative ({b.viscous:g})." for b in axis.chain.bodies if b.viscous < 0
    ]
    return tuple(out)


def next_experiment(fitter: Fitter, search: Search, best: Fitted, findings: Sequence[Finding]) -> str | None:
    """Name the excitation or load, of a few simple ones, under which the equivalents differ most.

    None when there is nothing to tell. One that takes the axis much further than it went is not asked for.
    """
    pairs = []
    for f in findings:
        for name in f.equivalents:
            rival = _rival_of(search, best, f, name)
            if rival is not None:
                pairs.append((f, name, rival))
    if not pairs or fitter.view.channel != "velocity":
        return None if not pairs else "Repeat the experiment at half and at twice the speed, and with another load."
    r = fitter.experiments[0].recording
    t = r.time - r.time[0]
    level = float(np.sqrt(np.mean(r.torque**2)))
    chirp = np.sin(2 * np.pi * (0.3 * t + 0.5 * (60.0 - 0.3) / max(r.duration, 1e-9) * t**2))
    triangle = (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * 0.2 * t))
    trials: dict[str, tuple[np.ndarray, float]] = {  # the torque, and the load over that of the recording
        "the same excitation at a quarter of the amplitude": (0.25 * r.torque, 1.0),
        "the same excitation at half the amplitude": (0.5 * r.torque, 1.0),
        "the same excitation at twice the amplitude": (2.0 * r.torque, 1.0),
        f"the same excitation on top of a constant torque of {0.5 * level:.3g}": (r.torque + 0.5 * level, 1.0),
        f"a chirp from 0.3 to 60 Hz of amplitude {1.4 * level:.3g}": (1.4 * level * chirp, 1.0),
        f"a slow triangle (0.2 Hz) of amplitude {1.5 * level:.3g}": (1.5 * level * triangle, 1.0),
        "the same excitation with half the load": (r.torque, 0.5),
        "the same excitation with half as much load again": (r.torque, 1.5),
    }
    travel = float(np.ptp(measured_angle(r)))
    out = []
    for finding, name, rival in pairs[:3]:
        scores = {}
        for label, (torque, load) in trials.items():
            try:
                a = simulate(_loaded(best.axis, load), torque, r.dt)
                b = simulate(_loaded(rival.axis, load), torque, r.dt)
            except (DivergedError, ValueError):
                continue
            if max(float(np.ptp(a.angle)), float(np.ptp(b.angle))) < FURTHER * travel:
                scores[label] = float(np.sqrt(np.mean((a.velocity - b.velocity) ** 2))) / fitter.experiments[0].sigma
        pair = f"{finding.effect.replace('_', ' ')} from {name.replace('_', ' ')}"
        label = max(scores, key=lambda k: scores[k], default="")
        if not scores:
            out.append(f"What was tried to tell {pair} takes the axis much further than it went: measure at another place.")
        elif scores[label] < 0.05:
            out.append(f"No excitation and no load that was tried tells {pair}: measure at another place.")
        else:
            out.append(f"To tell {pair}, record {label}: their predictions then differ by {scores[label]:.2g} times the noise.")
    return " ".join(out) or None


def _loaded(axis: Axis, load: float) -> Axis:
    """The axis with another load: the inertia of the last body, and the weight that is known to hang on it, times ``load``."""
    if load == 1.0:
        return axis
    *others, last = axis.chain.bodies
    chain = dataclasses.replace(axis.chain, bodies=(*others, dataclasses.replace(last, inertia=load * last.inertia)))
    return dataclasses.replace(axis, chain=chain, effects=tuple(e.with_load(load) for e in axis.effects))


def _rival_of(search: Search, best: Fitted, finding: Finding, name: str) -> Fitted | None:
    rest = {k for k in best.key if k != f"{finding.law}@{finding.place}"}
    for f in search.pool.values():
        others = set(f.key) - rest
        if rest <= set(f.key) and len(f.key) == len(best.key) and any(k == name or k.split("@")[0] == name for k in others):
            return f
    return None
