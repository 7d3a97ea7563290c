"""Step responses that are logged from the step on: the input of each is constant, and the axis starts at rest."""

from __future__ import annotations

import numpy as np
import pytest

import simgap
from diagnose.check import Severity
from diagnose.pipeline import Options
from diagnose.result import Verdict
from simgap.pipeline import diagnose_recordings

DT, N, NOISE, FRICTION = 0.005, 400, 0.05, 0.05
MOTOR = """<mujoco><option timestep="0.0005" gravity="0 0 0" integrator="RK4"/><worldbody><body name="shaft">
<joint name="shaft" axis="0 0 1" damping=".04"/><inertial pos="0 0 0" mass=".1" diaginertia=".0025 .0025 .0025"/></body>
</worldbody><actuator><motor name="motor" joint="shaft"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("steps") / "motor.xml"
    path.write_text(MOTOR, encoding="utf-8")
    return path


def step(model, torque, seed, rest=0):
    """The response to a torque, with Coulomb friction, from so many samples after the step on."""
    run = simgap.simulate(
        model, np.full(N + rest, torque), dt=DT, effects=[simgap.effects["coulomb_friction"](place="motor", torque_Nm=FRICTION)]
    )
    velocity = np.array(run.velocity)[rest:] + NOISE * np.random.default_rng(seed).standard_normal(N)
    columns = {"time_s": DT * np.arange(N), "torque_Nm": np.full(N, torque), "velocity_rad_s": velocity}
    return simgap.load(columns, name=f"step {torque}")


def test_friction_is_found_in_steps_from_rest(model, tmp_path):
    """A dead zone makes the same motion; the one of which MJCF has an element is named, and the other beside it."""
    few = Options(effects=("coulomb_friction", "actuator_deadzone"))
    logs, held = [step(model, 0.6, 1), step(model, -0.24, 2)], [step(model, 0.45, 3), step(model, -0.36, 4)]
    result = diagnose_recordings(logs, model, tmp_path, held, few, progress=False, page=False)
    assert result.verdict is Verdict.MISSING_PHYSICS
    (found,) = result.findings
    assert (found.effect, found.equivalents) == ("coulomb_friction", ("actuator_deadzone",))
    assert found.parameters["torque_Nm"].value == pytest.approx(FRICTION, rel=0.05)


@pytest.mark.parametrize(
    ("torque", "rest", "severity"),
    [(0.6, 0, Severity.LIMITS), (0.6, 4, Severity.FIX), (0.6, N, Severity.FIX), (0.02, 0, Severity.FIX)],
)
def test_a_constant_input_is_taken_for_a_step_of_an_axis_that_starts_at_rest_and_moves(model, torque, rest, severity):
    log = step(model, torque, 1, rest)
    (problem,) = (p for p in simgap.check(log, model).problems if p.problem == "constant_input")
    assert problem.severity is severity


@pytest.mark.parametrize(
    ("wave", "constant"),
    [(lambda t: 0.5 * np.sin(6 * t), 0.6), (lambda t: 0.5 * np.ones_like(t), -0.6)],
    ids=["turns", "against"],
)
def test_a_column_that_is_constant_while_another_torque_moves_the_axis_is_no_step(model, wave, constant):
    """What another torque does turns back, or goes the other way, which a step does not."""
    t = DT * np.arange(N)
    run = simgap.simulate(model, wave(t), dt=DT)
    columns = {"time_s": t, "torque_Nm": np.full(N, constant), "velocity_rad_s": np.array(run.velocity)}
    (problem,) = (p for p in simgap.check(simgap.load(columns), model).problems if p.problem == "constant_input")
    assert problem.severity is Severity.FIX
