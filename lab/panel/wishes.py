"""Open wishes: machines of the sealed plant like some on which a diagnosis has erred, for a rule that answers others too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lab.benchmark.experiment import Experiment, chirp, multisine, trapezoid
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import record
from lab.benchmark.refit import LINEAR
from lab.benchmark.resume import plain
from lab.benchmark.seal import write_motion
from lab.panel.case import Case, Content
from lab.panel.shipped import copy_model

__all__ = ["wish_cases"]

SPREAD = 0.03  # relative half-width of the linear parameters about the nominal ones


@dataclass(frozen=True)
class Wish:
    """What is concealed (fields of `Laws`, and the effects that these are) and which experiments show it."""

    laws: Mapping[str, float]
    effects: Mapping[str, tuple[str, Mapping[str, float]]]  # effect -> place, parameters
    excitation: str
    noise: float = 0.05  # rms of the velocity noise [rad/s]


WISHES = {
    "weight": Wish(
        {"gravity": 12.0, "gravity_phase": 0.6},
        {"gravity_load": ("arm", {"torque_Nm": 12.0, "phase_rad": 0.6})},
        "multisine",
    ),
    "drift": Wish(
        {"coulomb_m": 0.12, "drift_change": 0.6, "drift_time": 6.0},
        {"friction_drift": ("motor", {"torque_Nm": 0.12, "relative_change": 0.6, "time_constant_s": 6.0})},
        "chirp",
    ),
    "backlash_ripple": Wish(
        {"gap_g": 5e-4, "ripple_amplitude": 0.05, "ripple_cycles": 6.0, "ripple_phase": 1.0},
        {
            "backlash": ("gearbox", {"gap_rad": 5e-4}),
            "torque_ripple": ("motor", {"amplitude_Nm": 0.05, "cycles_per_rev": 6.0, "phase_rad": 1.0}),
        },
        "trapezoid",
    ),
}


def _experiments(excitation: str, rng: np.random.Generator) -> tuple[Experiment, Experiment]:
    """Ten seconds for the fit and ten held out, of about the same strength."""
    if excitation == "trapezoid":
        return trapezoid(10.0, 15.0, 0.08, 0.1, True, rng), trapezoid(10.0, 12.0, 0.08, 0.1, True, rng)
    swept, broad = chirp(10.0, 1.0, 0.5, 30.0), multisine(10.0, 0.6, 0.1, 30.0, rng)
    return (swept, broad) if excitation == "chirp" else (broad, swept)


def _make(name: str, folder: Path) -> Content:
    wish = WISHES[name]
    rng = np.random.default_rng([42, list(WISHES).index(name)])
    nominal = Laws()
    linear = {n: getattr(nominal, n) * (1 + SPREAD * float(rng.uniform(-1, 1))) for n in LINEAR}
    laws = nominal._replace(**linear, **wish.laws)
    parts = ("estimation.csv", "held_out.csv")
    for part, experiment in zip(parts, _experiments(wish.excitation, rng), strict=True):
        write_motion(folder / part, record(laws, experiment, Measurement(velocity_noise=wish.noise), rng))
    truth: dict[str, Any] = {
        "level": "plain" if len(wish.effects) == 1 else "two_effects",
        "verdict": "missing_physics",
        "effects": list(wish.effects),
        "where": {e: place for e, (place, _) in wish.effects.items()},
        "parameters": {e: dict(p) for e, (_, p) in wish.effects.items()},
        "law": dict.fromkeys(wish.effects, "contract"),
        "velocity_noise_rms_rad_s": wish.noise,
        "closed_loop": wish.excitation == "trapezoid",
        "excitation": wish.excitation,
        "linear_parameters": linear,
    }
    return Content(parts[:1], parts[1:], copy_model("robot_axis1", folder), truth=plain(truth))


def wish_cases() -> list[Case]:
    """The three cases."""
    return [Case(f"wish_{name}", "wish", "wish", partial(_make, name)) for name in WISHES]
