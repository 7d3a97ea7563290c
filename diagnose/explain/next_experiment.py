"""The experiment that tells rivals apart: the excitation or load under which their predictions differ most."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from diagnose.check.relation import TOP
from diagnose.data.experiment import measured_angle
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.result import Finding
from diagnose.thresholds import TWICE
from mjsim.axis import Axis
from mjsim.ode import DivergedError, simulate
from mjsim.recording import Recording

__all__ = ["next_experiment"]


def next_experiment(fitter: Fitter, rivals: Iterable[Fitted], best: Fitted, findings: Sequence[Finding]) -> str | None:
    """Name the excitation or load, of a few simple ones, under which the equivalents differ most.

    None when there is nothing to tell. One that takes the axis much further than it went is not asked for.
    """
    pairs = []
    for f in findings:
        for name in f.equivalents:
            rival = _rival_of(rivals, best, f, name)
            if rival is not None:
                pairs.append((f, name, rival))
    if not pairs or fitter.view.channel == "torque":
        return None if not pairs else "Repeat the experiment at half and at twice the speed, and with another load."
    r = fitter.experiments[0].recording
    trials = _trials(r, servo=best.axis.chain.servo is not None)
    travel = float(np.ptp(measured_angle(r)))
    out = []
    for finding, name, rival in pairs[:3]:
        scores = {}
        for label, (drive, load) in trials.items():
            told_apart = _apart(r, (best.axis, rival.axis), drive, load)
            if told_apart is not None and told_apart[1] < TWICE * travel:
                scores[label] = told_apart[0] / fitter.experiments[0].sigma
        pair = f"{finding.effect.replace('_', ' ')} from {name.replace('_', ' ')}"
        label = max(scores, key=lambda k: scores[k], default="")
        if not scores:
            out.append(f"What was tried to tell {pair} takes the axis much further than it went: measure at another place.")
        elif scores[label] < 0.05:
            out.append(f"No excitation and no load that was tried tells {pair}: measure at another place.")
        else:
            out.append(f"To tell {pair}, record {label}: their predictions then differ by {scores[label]:.2g} times the noise.")
    return " ".join(out) or None


def _trials(r: Recording, *, servo: bool) -> dict[str, tuple[np.ndarray, float]]:
    """Inputs (N,), each with its load over that of the recording, by what they are; a command is scaled about where it starts."""
    t = r.time - r.time[0]
    drive = r.input
    first = float(drive[0]) if servo else 0.0
    level = float(np.sqrt(np.mean((drive - first) ** 2)))
    top = min(TOP, 0.1 / r.dt)
    chirp = np.sin(2 * np.pi * (0.3 * t + 0.5 * (top - 0.3) / max(r.duration, 1e-9) * t**2))
    triangle = (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * 0.2 * t))
    trials = {
        "the same excitation at a quarter of the amplitude": (first + 0.25 * (drive - first), 1.0),
        "the same excitation at half the amplitude": (first + 0.5 * (drive - first), 1.0),
        "the same excitation at twice the amplitude": (first + 2.0 * (drive - first), 1.0),
        f"the same excitation on top of a constant torque of {0.5 * level:.3g}": (drive + 0.5 * level, 1.0),
        f"a chirp from 0.3 to {top:.3g} Hz of amplitude {1.4 * level:.3g}": (first + 1.4 * level * chirp, 1.0),
        f"a slow triangle (0.2 Hz) of amplitude {1.5 * level:.3g}": (first + 1.5 * level * triangle, 1.0),
        "the same excitation with half the load": (drive, 0.5),
        "the same excitation with half as much load again": (drive, 1.5),
    }
    return {k: v for k, v in trials.items() if not (servo and "constant torque" in k)}


def _apart(r: Recording, axes: tuple[Axis, Axis], drive: np.ndarray, load: float) -> tuple[float, float] | None:
    """Rms by which two axes differ in the compared channel, and the longer travel; None where one cannot be run."""
    chain = axes[0].chain
    start, before = None, 0.0
    if chain.servo is not None:
        start, before = np.zeros((2, len(chain.bodies))), float(r.input[0])
        start[0] = [float(measured_angle(r)[0]) * chain.total_ratio(i) for i in range(len(chain.bodies))]
    try:
        a, b = (simulate(_loaded(x, load), drive, r.dt, initial=start, before=before, hold=r.hold) for x in axes)
    except (DivergedError, ValueError):
        return None
    error = a.velocity - b.velocity if chain.servo is None else a.angle - b.angle
    return float(np.sqrt(np.mean(error**2))), max(float(np.ptp(a.angle)), float(np.ptp(b.angle)))


def _loaded(axis: Axis, load: float) -> Axis:
    """The axis with another load: the inertia of the last body, and the weight that is known to hang on it, times ``load``."""
    if load == 1.0:
        return axis
    *others, last = axis.chain.bodies
    chain = dataclasses.replace(axis.chain, bodies=(*others, dataclasses.replace(last, inertia=load * last.inertia)))
    return dataclasses.replace(axis, chain=chain, effects=tuple(e.with_load(load) for e in axis.effects))


def _rival_of(rivals: Iterable[Fitted], best: Fitted, finding: Finding, name: str) -> Fitted | None:
    rest = {k for k in best.key if k != f"{finding.law}@{finding.place}"}
    for f in rivals:
        others = set(f.key) - rest
        if rest <= set(f.key) and len(f.key) == len(best.key) and any(k == name or k.split("@")[0] == name for k in others):
            return f
    return None
