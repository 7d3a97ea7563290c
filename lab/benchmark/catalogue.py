"""What can be concealed: every effect of the contract at each of its places, the ranges it is drawn from, and its law here.

The ranges are data: one row for each effect and place. `Draw` values are SI; ``of`` multiplies by another parameter of the
same effect or by the largest torque of the experiment (``max_torque``). Numbers are drawn log-uniform unless stated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from lab.benchmark.experiment import log_uniform
from lab.benchmark.laws import GAP_IMPACT, GAP_NO_PULL, Laws
from mjsim.errors import InputError

__all__ = ["CATALOGUE", "EQUIVALENT", "LOG_FAULTS", "OTHER_LAWS", "OUTSIDE", "Draw", "Entry", "compose", "draw", "find"]


@dataclass(frozen=True)
class Draw:
    """How a parameter is drawn: log-uniform within [low, high], with a random sign, uniform, or one of ``choices``."""

    low: float = 0.0
    high: float = 0.0
    signed: bool = False
    uniform: bool = False
    choices: tuple[float, ...] = ()
    of: str = ""


PHASE = Draw(-math.pi, math.pi, uniform=True)
TURNS = Draw(choices=(1.0, 2.0, 3.0, 4.0, 6.0, 8.0))


@dataclass(frozen=True)
class Entry:
    """One effect at one place: parameter ranges, where its parameters enter `Laws`, and what could be mistaken for it.

    ``fixed`` are further fields of `Laws` (the variant of a law); ``rivals`` are fields of simpler effects that a fair test
    of its visibility leaves free; ``derive`` turns drawn numbers into the contract's parameters; ``prefers`` names the
    excitations that can show it.
    """

    effect: str
    place: str
    group: str
    draws: Mapping[str, Draw]
    fields: Mapping[str, str]
    fixed: Mapping[str, float] = field(default_factory=dict)
    rivals: tuple[str, ...] = ()
    derive: Callable[[dict[str, float]], dict[str, float]] | None = None
    prefers: tuple[str, ...] = ()
    law: str = "contract"


def _mode(p: dict[str, float]) -> dict[str, float]:
    """Frequency [Hz] (clamped) and damping ratio to stiffness and damping of the extra mode."""
    w = 2 * math.pi * p["frequency_Hz"]
    J = p["inertia_kgm2"]
    return {"inertia_kgm2": J, "stiffness_Nm_rad": J * w * w, "damping_Nms_rad": 2 * p["ratio"] * J * w}


F = {"torque_Nm": "coulomb_m"}
WIDE = ("trapezoid", "steps", "trapezoid", "multisine")

# fmt: off
CATALOGUE: tuple[Entry, ...] = (
    Entry("coulomb_friction", "motor", "friction", {"torque_Nm": Draw(0.003, 0.4)}, F),
    Entry("coulomb_friction", "gearbox", "friction", {"torque_Nm": Draw(0.5, 30.0)}, {"torque_Nm": "coulomb_g"},
          rivals=("coulomb_m",)),
    Entry("coulomb_friction", "arm", "friction", {"torque_Nm": Draw(0.5, 30.0)}, {"torque_Nm": "coulomb_a"},
          rivals=("coulomb_m",)),
    Entry("static_friction", "motor", "friction", {"torque_Nm": Draw(0.02, 0.25), "peak": Draw(1.4, 5.0)},
          {**F, "peak": "peak_m"}, rivals=("coulomb_m",)),
    Entry("stribeck_friction", "motor", "friction",
          {"torque_Nm": Draw(0.02, 0.2), "extra_static_torque_Nm": Draw(0.02, 0.2),
           "stribeck_velocity_rad_s": Draw(0.5, 8.0)},
          {**F, "extra_static_torque_Nm": "stribeck_extra", "stribeck_velocity_rad_s": "stribeck_speed"},
          rivals=("coulomb_m",)),
    Entry("asymmetric_friction", "motor", "friction",
          {"torque_Nm": Draw(0.02, 0.25), "asymmetry_Nm": Draw(0.1, 0.7, signed=True, of="torque_Nm")},
          {**F, "asymmetry_Nm": "asymmetry_m"}, rivals=("coulomb_m",)),
    Entry("quadratic_friction", "motor", "friction", {"coefficient_Nm_s2_rad2": Draw(1e-5, 1e-3)},
          {"coefficient_Nm_s2_rad2": "quadratic_m"}, rivals=("coulomb_m",)),
    Entry("presliding_friction", "motor", "friction",
          {"torque_Nm": Draw(0.02, 0.3), "stiffness_Nm_rad": Draw(0.2, 20.0)},
          {"torque_Nm": "bristle_level", "stiffness_Nm_rad": "bristle_stiffness"}, rivals=("coulomb_m",)),
    Entry("load_dependent_friction", "motor", "friction", {"coefficient": Draw(0.01, 0.25)}, {"coefficient": "load_m"},
          rivals=("coulomb_m",)),
    Entry("load_dependent_friction", "gearbox", "friction", {"coefficient": Draw(0.01, 0.25)}, {"coefficient": "load_g"},
          rivals=("coulomb_m",)),
    Entry("friction_drift", "motor", "friction",
          {"torque_Nm": Draw(0.03, 0.25), "relative_change": Draw(0.2, 1.5), "time_constant_s": Draw(1.0, 6.0)},
          {**F, "relative_change": "drift_change", "time_constant_s": "drift_time"}, rivals=("coulomb_m",)),
    Entry("position_dependent_friction", "motor", "friction",
          {"torque_Nm": Draw(0.05, 0.3), "relative_amplitude": Draw(0.2, 0.9), "cycles_per_rev": TURNS,
           "phase_rad": PHASE},
          {**F, "relative_amplitude": "place_amplitude", "cycles_per_rev": "place_cycles", "phase_rad": "place_phase"},
          rivals=("coulomb_m",), prefers=WIDE),
    Entry("backlash", "gearbox", "joint", {"gap_rad": Draw(1.5e-5, 1.5e-3)}, {"gap_rad": "gap_g"}),
    Entry("backlash", "arm", "joint", {"gap_rad": Draw(1.5e-5, 1.5e-3)}, {"gap_rad": "gap_a"}),
    Entry("hardening_stiffness", "gearbox", "joint", {"coefficient_Nm_rad3": Draw(3e9, 3e11)},
          {"coefficient_Nm_rad3": "cubic_g"}),
    Entry("hardening_stiffness", "arm", "joint", {"coefficient_Nm_rad3": Draw(1e8, 2e10)},
          {"coefficient_Nm_rad3": "cubic_a"}),
    Entry("hysteresis", "gearbox", "joint",
          {"torque_Nm": Draw(1.0, 60.0), "stiffness_Nm_rad": Draw(1.5e4, 4e5)},
          {"torque_Nm": "slip_torque_g", "stiffness_Nm_rad": "slip_stiffness_g"}),
    Entry("hysteresis", "arm", "joint",
          {"torque_Nm": Draw(1.0, 40.0), "stiffness_Nm_rad": Draw(5e3, 1e5)},
          {"torque_Nm": "slip_torque_a", "stiffness_Nm_rad": "slip_stiffness_a"}),
    Entry("transmission_error", "gearbox", "turn",
          {"amplitude_rad": Draw(3e-6, 3e-4), "cycles_per_rev": Draw(choices=(1.0, 2.0, 3.0, 4.0)), "phase_rad": PHASE},
          {"amplitude_rad": "error_amplitude", "cycles_per_rev": "error_cycles", "phase_rad": "error_phase"},
          prefers=WIDE),
    Entry("torque_ripple", "motor", "turn",
          {"amplitude_Nm": Draw(0.003, 0.3), "cycles_per_rev": TURNS, "phase_rad": PHASE},
          {"amplitude_Nm": "ripple_amplitude", "cycles_per_rev": "ripple_cycles", "phase_rad": "ripple_phase"}),
    Entry("torque_offset", "motor", "offset", {"torque_Nm": Draw(0.002, 0.2, signed=True)}, {"torque_Nm": "offset_m"}),
    Entry("gravity_load", "arm", "offset", {"torque_Nm": Draw(2.0, 60.0), "phase_rad": PHASE},
          {"torque_Nm": "gravity", "phase_rad": "gravity_phase"}, rivals=("offset_m",), prefers=WIDE),
    Entry("extra_flexible_mode", "arm", "mode",
          {"inertia_kgm2": Draw(0.05, 0.8), "frequency_Hz": Draw(6.0, 60.0), "ratio": Draw(0.01, 0.1)},
          {"inertia_kgm2": "Je", "stiffness_Nm_rad": "ke", "damping_Nms_rad": "de"}, derive=_mode),
    Entry("position_dependent_inertia", "arm", "turn",
          {"relative_amplitude": Draw(0.1, 0.8), "cycles_per_rev": Draw(choices=(1.0, 2.0, 3.0, 4.0, 8.0)),
           "phase_rad": PHASE},
          {"relative_amplitude": "inertia_amplitude", "cycles_per_rev": "inertia_cycles", "phase_rad": "inertia_phase"},
          prefers=WIDE),
    Entry("torque_gain_droop", "actuator", "actuator", {"coefficient_per_Nm2": Draw(0.002, 0.15)},
          {"coefficient_per_Nm2": "droop"}),
    Entry("actuator_saturation", "actuator", "actuator", {"limit_Nm": Draw(0.5, 0.98, of="max_torque")},
          {"limit_Nm": "limit"}),
    Entry("actuator_deadzone", "actuator", "actuator", {"half_width_Nm": Draw(0.003, 0.25)},
          {"half_width_Nm": "deadzone"}, rivals=("coulomb_m",)),
    Entry("actuator_lag", "actuator", "actuator", {"time_constant_s": Draw(3e-4, 1e-2)}, {"time_constant_s": "act_lag"},
          rivals=("act_delay",)),
    Entry("time_delay", "actuator", "delay", {"delay_s": Draw(1e-4, 6e-3)}, {"delay_s": "act_delay"}),
    Entry("time_delay", "sensor", "delay", {"delay_s": Draw(1e-4, 6e-3)}, {"delay_s": "sen_delay"}),
    Entry("sensor_lag", "sensor", "sensor", {"time_constant_s": Draw(3e-4, 1e-2)}, {"time_constant_s": "sen_lag"},
          rivals=("act_delay",)),
    Entry("sensor_quantisation", "sensor", "sensor", {"step": Draw(0.1, 1.5)}, {"step": "sen_step"}),
    # no rival: the angle channel tells it from a torque offset
    Entry("sensor_offset", "sensor", "sensor", {"value": Draw(0.01, 1.0, signed=True)}, {"value": "sen_offset"}),
)


def _other(entry: Entry, law: str, fields: Mapping[str, str] | None = None, **fixed: float) -> Entry:
    return Entry(entry.effect, entry.place, entry.group, entry.draws, fields or entry.fields, fixed, entry.rivals,
                 entry.derive, entry.prefers, law)


def find(effect: str, place: str, entries: tuple[Entry, ...] = CATALOGUE) -> Entry:
    """The row of an effect at a place."""
    for entry in entries:
        if (entry.effect, entry.place) == (effect, place):
            return entry
    known = ", ".join(sorted({f"{e.effect} at {e.place}" for e in entries}))
    raise InputError("catalogue", f"no {effect!r} at {place!r}", f"one of {known}")


# What makes the same motion exactly: the first for any motion, the others from rest and by the logged torque, a lag only
# where the axis is linear.
EQUIVALENT: dict[tuple[str, str], tuple[tuple[tuple[str, str], ...], ...]] = {
    ("asymmetric_friction", "motor"): ((("coulomb_friction", "motor"), ("torque_offset", "motor")),),
    ("time_delay", "actuator"): ((("time_delay", "sensor"),),),
    ("time_delay", "sensor"): ((("time_delay", "actuator"),),),
    ("actuator_lag", "actuator"): ((("sensor_lag", "sensor"),),),
    ("sensor_lag", "sensor"): ((("actuator_lag", "actuator"),),),
}

_BRISTLE = {"torque_Nm": "bristle_level"}

# The same effects by another law than the contract's: what a library of such laws can only approximate.
OTHER_LAWS: tuple[Entry, ...] = (
    _other(find("coulomb_friction", "motor"), "LuGre, 400 Nm/rad", _BRISTLE, bristle_stiffness=400.0,
           bristle_damping=0.2),
    _other(find("stribeck_friction", "motor"), "LuGre, 300 Nm/rad",
           {**_BRISTLE, "extra_static_torque_Nm": "bristle_extra", "stribeck_velocity_rad_s": "bristle_speed"},
           bristle_stiffness=300.0, bristle_damping=0.2),
    _other(find("presliding_friction", "motor"), "LuGre with bristle damping", bristle_damping=0.005),
    _other(find("backlash", "gearbox"), "never pulling", gap_law_g=GAP_NO_PULL),
    _other(find("backlash", "gearbox"), "compliant impact (Hunt-Crossley)", gap_law_g=GAP_IMPACT, impact_g=0.5),
    _other(find("backlash", "arm"), "never pulling", gap_law_a=GAP_NO_PULL),
    _other(find("hysteresis", "gearbox"), "one Maxwell-slip element", slip_sharp=1.0),
    _other(find("hysteresis", "arm"), "one Maxwell-slip element", slip_sharp=1.0),
    _other(find("sensor_quantisation", "sensor"), "rounded ahead of the noise", sen_step_first=1.0),
    _other(find("transmission_error", "gearbox"), "unstrained at the start", error_relaxed=1.0),
)


def _cog(p: dict[str, float]) -> dict[str, float]:
    return {**p, "second_cycles": p["first_cycles"] * 0.5 * (1 + math.sqrt(5))}


def _outside(name: str, place: str, draws: Mapping[str, Draw], fields: Mapping[str, str],
             derive: Callable[[dict[str, float]], dict[str, float]] | None = None) -> Entry:
    return Entry(name, place, "outside", draws, fields, derive=derive, law="outside the library")


# What no effect of the contract describes.
OUTSIDE: tuple[Entry, ...] = (
    _outside("speed_load_coupling", "gearbox", {"coefficient_s2_rad2": Draw(2e-4, 4e-3)},
             {"coefficient_s2_rad2": "x_load_speed"}),
    _outside("friction_memory", "motor",
             {"torque_Nm": Draw(0.05, 0.4), "lag_s": Draw(0.01, 0.2), "speed_rad_s": Draw(1.0, 10.0),
              "per_heat_J": Draw(0.01, 0.5), "cooling_s": Draw(1.0, 5.0)},
             {"torque_Nm": "x_lag_level", "lag_s": "x_lag_time", "speed_rad_s": "x_lag_speed", "per_heat_J": "x_heat",
              "cooling_s": "x_heat_time"}),
    _outside("slipping_clutch", "gearbox", {"limit_Nm": Draw(15.0, 250.0)}, {"limit_Nm": "x_clutch"}),
    _outside("speed_grown_cogging", "motor", {"growth_Nms_rad": Draw(0.001, 0.03), "first_cycles": Draw(2.3, 7.1)},
             {"growth_Nms_rad": "x_cog", "first_cycles": "x_cog_first", "second_cycles": "x_cog_second"}, _cog),
    _outside("angle_dependent_stiffness", "arm",
             {"relative_amplitude": Draw(0.05, 0.6), "cycles": Draw(20.0, 200.0), "phase_rad": PHASE},
             {"relative_amplitude": "x_soft", "cycles": "x_soft_cycles", "phase_rad": "x_soft_phase"}),
    _outside("detent_with_memory", "motor",
             {"torque_Nm": Draw(0.02, 0.3), "cycles": Draw(2.0, 10.0), "width_rad": Draw(0.05, 0.6)},
             {"torque_Nm": "x_detent", "cycles": "x_detent_cycles", "width_rad": "x_detent_width"}),
    _outside("thermal_derating", "actuator", {"per_Nm2": Draw(0.02, 0.6), "time_s": Draw(0.5, 5.0)},
             {"per_Nm2": "x_derate", "time_s": "x_derate_time"}),
    _outside("speed_faded_torque", "actuator", {"per_rad_s": Draw(5e-4, 1e-2)}, {"per_rad_s": "x_fade"}),
    _outside("held_rows", "sensor", {"probability": Draw(2e-4, 2e-3), "rows": Draw(5.0, 40.0)}, {}),
)
# fmt: on

# What is a fault of the log rather than of the axis -> its name in ``log.problems`` of diagnosis.json.
LOG_FAULTS: Mapping[str, str] = {"held_rows": "duplicated_rows"}


def draw(entry: Entry, rng: np.random.Generator, max_torque: float) -> dict[str, float]:
    """Draw the contract's parameters of an effect."""
    out: dict[str, float] = {}
    for name, d in entry.draws.items():
        if d.choices:
            x = float(rng.choice(d.choices))
        else:
            x = float(rng.uniform(d.low, d.high)) if d.uniform else log_uniform(rng, d.low, d.high)
        if d.signed:
            x *= float(rng.choice([-1.0, 1.0]))
        if d.of:
            x *= max_torque if d.of == "max_torque" else out[d.of]
        out[name] = x
    return entry.derive(out) if entry.derive else out


def compose(laws: Laws, entry: Entry, parameters: Mapping[str, float]) -> Laws:
    """Add an effect to the plant; a law that is taken already raises."""
    idle = Laws()
    change = {entry.fields[name]: float(value) for name, value in parameters.items() if name in entry.fields}
    change.update(entry.fixed)
    for name in change:
        if getattr(laws, name) != getattr(idle, name):
            raise InputError(entry.effect, f"the law {name!r} is in use", "effects that do not share a law")
    return laws._replace(**change)
