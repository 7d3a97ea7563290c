"""The experiment that tells rivals apart: the excitation or load under which their predictions differ most."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from diagnose.data.experiment import measured_angle
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.result import Finding
from diagnose.thresholds import FURTHER
from mjsim.axis import Axis
from mjsim.ode import DivergedError, simulate

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


def _rival_of(rivals: Iterable[Fitted], best: Fitted, finding: Finding, name: str) -> Fitted | None:
    rest = {k for k in best.key if k != f"{finding.law}@{finding.place}"}
    for f in rivals:
        others = set(f.key) - rest
        if rest <= set(f.key) and len(f.key) == len(best.key) and any(k == name or k.split("@")[0] == name for k in others):
            return f
    return None
