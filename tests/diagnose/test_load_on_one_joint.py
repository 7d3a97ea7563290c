"""Friction in proportion to the drive's torque, on a servo whose model is one rigid body: found from command and angle."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from diagnose.options import Options
from diagnose.result import Finding, Verdict
from diagnose.verdict.notes import _of_the_load
from mjsim.mjcf import load_axis
from mjsim.recording import Recording
from simgap.pipeline import diagnose_recordings

INERTIA, KP, KV, DAMPING, WEIGHT = 0.0826, 40.0, 1.5, 0.07, 2.4525
MODEL = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="RK4"/><worldbody>
<body name="link"><joint name="j" axis="0 1 0" damping=".07" armature=".02"/>
<inertial pos="0 0 -.25" mass="1" diaginertia=".0001 .0001 .0001"/></body></worldbody>
<actuator><position name="drive" joint="j" kp="40" kv="1.5"/></actuator></mujoco>"""


@njit
def _turned(command, dt, parts, share, level, creep):
    """Angle (N,) under a friction level + share |T|, by symplectic Euler steps: Moreau's rule, or tanh(v / creep)."""
    q, v, out, h = command[0], 0.0, np.zeros(len(command)), dt / parts
    for i in range(len(command)):
        out[i] = q
        for _ in range(parts):
            torque = 40.0 * (command[i] - q) - 1.5 * v
            force = torque - 0.07 * v - 2.4525 * math.sin(q)
            friction = level + share * abs(torque)
            if creep > 0.0:
                force -= friction * math.tanh(v / creep)
                v += h * force / 0.0826
            else:
                v += h * force / 0.0826
                v = math.copysign(max(abs(v) - h * friction / 0.0826, 0.0), v)
            q += h * v
    return out


def _command(t: np.ndarray, seed: int, fast: bool) -> np.ndarray:
    rng = np.random.default_rng(seed)
    if not fast:
        return 0.9 + 0.7 * np.sin(2 * np.pi * 0.11 * t + rng.uniform(0, 6.28)) + 0.1 * np.sin(2 * np.pi * 0.31 * t)
    tones = 0.2 * (12.0 ** (np.arange(5) / 4))
    wave = sum(0.4 / (1 + 0.5 * i) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for i, f in enumerate(tones))
    return np.where((t // 2.5).astype(int) % 2 == 0, wave, np.repeat(rng.uniform(-0.8, 0.8, len(t)), 80)[: len(t)])


def _log(seed: int, share: float, level: float, *, creep: float = 0.0, fast: bool = True, count: int = 1000) -> Recording:
    dt, rng = 0.01, np.random.default_rng(seed)
    t = dt * np.arange(count)
    command = _command(t, seed, fast)
    angle = _turned(command, dt, 2000, share, level, creep) + 1e-4 * rng.standard_normal(count)
    return Recording(t, np.full(count, np.nan), None, angle, dt, command=command)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "servo.xml"
    path.write_text(MODEL, encoding="utf-8")
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "level", "creep", "law"),
    [
        (0.2, 0.0, 0.0, ""),
        (0.2, 0.2, 0.0, "load_dependent_friction_with_constant_part"),
        (0.15, 0.1, 0.003, "load_dependent_friction_with_creep"),
    ],
    ids=["share", "share and level", "share and level that creep"],
)
def test_it_is_found_with_its_numbers(tmp_path: Path, model: Path, share: float, level: float, creep: float, law: str) -> None:
    logs = [_log(seed, share, level, creep=creep) for seed in (1, 2)]
    found = diagnose_recordings(logs[:1], model, tmp_path / "out", logs[1:], Options(jobs=1), progress=False, page=False)
    assert found.verdict is Verdict.MISSING_PHYSICS
    (finding,) = found.findings
    assert (finding.effect, finding.form) == ("load_dependent_friction", law)
    assert finding.parameters["coefficient"].value == pytest.approx(share, abs=0.005)
    if level:
        assert finding.parameters["torque_Nm"].value == pytest.approx(level, rel=0.03)
    assert "position_dependent_friction" not in finding.equivalents, "the inertia varies the load apart from the angle"
    assert any("Plain MuJoCo lacks in corrected.xml" in note for note in found.notes)
    again = load_axis(tmp_path / "out" / "corrected.xml")
    assert [e.name() for e in again.effects if e.name() == "load_dependent_friction"]


@pytest.mark.parametrize(
    ("effect", "equivalents", "said"),
    [
        ("position_dependent_friction", ("load_dependent_friction",), "Another load"),
        ("load_dependent_friction", ("position_dependent_friction@motor",), "fast enough for the inertia"),
        ("load_dependent_friction", ("asymmetric_friction",), ""),
        ("coulomb_friction", (), ""),
    ],
)
def test_what_tells_the_load_from_the_angle_is_said_where_either_may_be(
    effect: str, equivalents: tuple[str, ...], said: str
) -> None:
    found = Finding(effect, "motor", "j", "", {}, {}, equivalents=equivalents)
    notes = list(_of_the_load([found]))
    assert [said in note for note in notes] == [True] * bool(said)
