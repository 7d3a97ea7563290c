"""Logs of a task that is held up: rows at a steady rate, then a gap in which the input is held and nothing is measured."""

from __future__ import annotations

import re

import numpy as np
import pytest

import simgap
from diagnose.fit.whiten import _order_left
from diagnose.pipeline import Options
from diagnose.result import Verdict
from simgap.pipeline import diagnose_recordings

DT, LOGGED, OF, NOISE = 0.002, 8, 13, 0.05
WHEEL = """<mujoco><option timestep="0.0005" gravity="0 0 0" integrator="RK4"/><worldbody><body name="wheel">
<joint name="wheel" axis="0 1 0" damping="8.7e-4"/><inertial pos="0 0 0" mass=".02" diaginertia="4.5e-5 4.5e-5 4.5e-5"/></body>
</worldbody><actuator><motor name="motor" joint="wheel"/></actuator></mujoco>"""
BINDING = {"time": "time_s", "torque": "torque_Nm", "velocity": "velocity_rad_s"}


def rows(model, seed, n=3000):
    """A wheel with Coulomb friction, of which the model knows nothing; columns (m,) of the rows that were logged."""
    rng, k = np.random.default_rng(seed), np.arange(n)
    logged = k % OF < LOGGED
    torque = 0.03 * np.repeat(rng.uniform(-1, 1, n // 50), 50)
    torque = torque[np.maximum.accumulate(np.where(logged, k, 0))]
    friction = simgap.effects["coulomb_friction"](place="motor", torque_Nm=0.004)
    run = simgap.simulate(model, torque, dt=DT, effects=[friction])
    velocity = np.array(run.velocity) + NOISE * rng.standard_normal(n)
    return {"time_s": (DT * k)[logged], "torque_Nm": torque[logged], "velocity_rad_s": velocity[logged]}


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("gaps") / "wheel.xml"
    path.write_text(WHEEL, encoding="utf-8")
    return path


def test_friction_is_found_in_a_log_with_gaps(model, tmp_path):
    logs = [simgap.load(rows(model, s), binding={"recording": {**BINDING, "jitter": 0.1}}, name=f"log {s}") for s in (1, 2)]
    few = Options(effects=("coulomb_friction",))
    result = diagnose_recordings(logs[:1], model, tmp_path, logs[1:], few, progress=False, page=False)
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert [f.effect for f in result.findings] == ["coulomb_friction"]
    assert result.findings[0].parameters["torque_Nm"].value == pytest.approx(0.004, rel=0.1)


def test_check_takes_a_log_with_gaps_from_end_to_end_once_a_jitter_is_declared(model, tmp_path):
    log, columns = tmp_path / "log.csv", rows(model, 1)
    np.savetxt(log, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    gap = next(p for p in simgap.check(log, model).problems if p.problem == "gap")
    advised = re.search(r"jitter = ([\d.]+)", gap.advice)
    log.with_suffix(".toml").write_text(f'[recording]\njitter = {advised.group(1)}\ntime = "time_s"\n')
    assert simgap.load(log, model=model).duration == pytest.approx(3000 * DT, rel=0.01)
    assert "gap" not in {p.problem for p in simgap.check(log, model).problems}


@pytest.mark.parametrize(("length", "order"), [(8, 4), (1, 0), (60, 24)])
def test_a_whitening_filter_leaves_half_of_the_samples(length, order):
    counts = np.tile(np.repeat([True, False], [length, 5]), 20)
    assert _order_left(counts, 24) == order
