"""A position command bound as torque against the torque of the same servo, on pendulums and free inertias."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from diagnose.check import LogVerdict, Machine, check_log
from mjsim.axis import Axis, Body, Chain
from mjsim.effects import effect_class
from mjsim.recording import Recording

DT, SECONDS, PARTS = 0.01, 10.0, 20
TONES = (0.2, 0.43, 0.9, 1.7, 3.1)
# inertia, viscous and dry friction, weight of the model; stiffness of the servo: over it, inertia or weight is near the model's
MACHINES = {
    "pendulum": ((0.18, 0.08, 0.1, 4.0), 7.1),
    "pendulum, weight near its inertia's unit": ((0.9, 0.3, 0.1, 1.2), 36.0),
    "pendulum, stiff servo": ((0.9, 0.3, 0.1, 1.2), 600.0),
    "light pendulum": ((0.02, 0.02, 0.02, 0.6), 3.2),
    "free inertia, stiffness 1": ((0.02, 0.02, 0.02, 0.0), 1.0),
    "free inertia": ((0.18, 0.08, 0.1, 0.0), 30.0),
}
QUICK = ("pendulum", "free inertia")  # one with weight and one without


@cache
def _servo(numbers: tuple[float, ...], stiffness: float, seed: int) -> tuple[np.ndarray, ...]:
    """Command, torque, velocity and angle (N,) of a servo with damping 0.7 on a joint whose numbers are 10 % off."""
    inertia, viscous, dry, weight = np.array(numbers) * (1.1, 0.9, 1.2, 1.1)
    count, rng = round(SECONDS / DT), np.random.default_rng(seed)
    t, phase = DT * np.arange(count), rng.uniform(0, 2 * np.pi, len(TONES))
    command = np.sum([0.5 / (i + 1) * np.sin(2 * np.pi * f * t + phase[i]) for i, f in enumerate(TONES)], axis=0)
    command -= command[0]
    damping, h = 1.4 * np.sqrt(inertia * stiffness), DT / PARTS
    q, v, rows = 0.0, 0.0, []
    for r in command:
        mean, at = 0.0, (v, q)
        for _ in range(PARTS):
            u = stiffness * (r - q) - damping * v
            mean += u / PARTS
            v += h * (u - viscous * v - dry * np.tanh(v / 0.01) - weight * np.sin(q)) / inertia
            q += h * v
        rows.append((mean, *at))
    u, v, q = np.array(rows).T
    return command, u, v + 0.01 * np.std(v) * rng.standard_normal(count), q + 0.001 * np.std(q) * rng.standard_normal(count)


def _log(inputs: np.ndarray, v: np.ndarray | None, q: np.ndarray, name: str) -> Recording:
    units = {"torque": "Nm", "velocity": "rad/s", "angle": "rad"}
    return Recording(DT * np.arange(len(q)), inputs, v, q, DT, source=name, units=units)


def _machine(inertia: float, viscous: float, dry: float, weight: float) -> Machine:
    effects = [effect_class("coulomb_friction")(place="motor", torque_Nm=dry)]
    if weight:
        effects.append(effect_class("gravity_load")(place="arm", torque_Nm=weight, phase_rad=0.0))
    return Machine(Axis(Chain((Body("motor", inertia, viscous, "pivot"),), ()), tuple(effects)), None)


@pytest.mark.parametrize(
    ("name", "has_velocity"),
    [
        *((name, True) for name in MACHINES),
        *((name, False) for name in QUICK),
        *(pytest.param(name, False, marks=pytest.mark.slow) for name in MACHINES if name not in QUICK),
    ],
)
def test_a_command_bound_as_torque_is_named_and_its_torque_is_not(name: str, has_velocity: bool) -> None:
    numbers, stiffness = MACHINES[name]
    logs = [_servo(numbers, stiffness, seed) for seed in (1, 2)]
    for column in (0, 1):
        recordings = [_log(x[column], x[2] if has_velocity else None, x[3], f"{i}.csv") for i, x in enumerate(logs)]
        found = check_log(_machine(*numbers), recordings)
        named = [p for p in found.problems if p.problem == "command_as_torque"]
        assert len(named) == (len(logs) if column == 0 else 0), [p.sentence for p in found.problems]
        if column == 0:
            assert found.verdict is LogVerdict.FIX
            assert all("position command" in p.advice for p in named)


def test_a_weight_a_quarter_of_the_models_is_no_command() -> None:
    """A quasi-static torque of 1 N m times the sine of the angle follows the angle with slope 1."""
    _, u, v, q = _servo((0.02, 0.02, 0.02, 1.0), 30.0, 1)
    found = check_log(_machine(0.02, 0.02, 0.02, 4.0), [_log(u, v, q, "a.csv")])
    assert "command_as_torque" not in {p.problem for p in found.problems}
