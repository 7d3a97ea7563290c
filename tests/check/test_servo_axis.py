"""The check of one axis under a servo: its position against its command, in the axis' own names of channels."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

import simgap
from mjsim.errors import InputError
from simgap.commands.check import command as check_command
from tests.mjsim.servo_logs import GEARED, PENDULUM, model, record, write

DT, TIMESTEP = 0.01, 2e-3
ELASTIC = """<mujoco><option timestep="0.001" integrator="implicitfast" gravity="0 0 0"/><worldbody><body name="rotor">
<joint name="drive" axis="0 0 1" damping="0.1"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/><body name="link">
<joint name="flex" axis="0 0 1" stiffness="500" damping="0.5"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
</body></body></worldbody><actuator><position name="servo" joint="drive" kp="40" kv="4"/></actuator></mujoco>"""


def columns(recording):
    names = {"time_s": "time", "command_rad": "command", "angle_rad": "angle"}
    return {column: np.array(getattr(recording, name)) for column, name in names.items()}


WHICH = {"pendulum": (PENDULUM, 1.0), "geared": (GEARED, 20.0)}
# of what takes a diagnosis or several checks
AXES = pytest.mark.parametrize("axis", ["pendulum", pytest.param("geared", marks=pytest.mark.slow)], indirect=True)


@pytest.fixture(scope="module", params=WHICH)
def axis(request, tmp_path_factory):
    """(model, columns) of a servo whose friction the file lacks; the command of the geared one is in units of the actuator."""
    template, gear = WHICH[request.param]
    path = write(tmp_path_factory.mktemp("axis") / "servo.xml", template, timestep=TIMESTEP)
    friction = 0.02 if template == PENDULUM else 0.01
    return path, columns(record(model(template, friction=friction, timestep=TIMESTEP), seconds=12.0, gear=gear))


def found(log, path):
    return [(p.channel, p.problem) for p in simgap.check(log, path).to_fix()]


def test_a_sound_log_is_ready(axis):
    path, log = axis
    check = simgap.check(log, path)
    assert check.verdict.value == "ready", check.problems
    assert "takes the position of the joint" in check.understood["servo"]
    assert "angle over command" in check.measured["memory"]["axis"]


def test_what_was_guessed_in_reading_is_understood(axis, tmp_path):
    path, log = axis
    names = {"time_s": "time [ms]", "command_rad": "command [rad]", "angle_rad": "angle [rad]"}
    table = np.column_stack([1e3 * log["time_s"], log["command_rad"], log["angle_rad"]])
    np.savetxt(tmp_path / "log.csv", table, delimiter=";", header=";".join(names.values()), comments="")
    told = simgap.check(tmp_path / "log.csv", path).understood["log"]
    assert "separated by semicolons" in told
    assert "time = 'time [ms]' [ms]" in told


@pytest.mark.parametrize(
    ("channel", "change", "problem"),
    [
        ("angle_rad", lambda x: -x, ("angle", "sign")),
        ("angle_rad", np.degrees, ("angle", "unit")),
        ("command_rad", np.degrees, ("angle", "unit")),
        ("angle_rad", lambda x: np.clip(x, np.quantile(x, 0.2), np.inf), ("angle", "clipping")),
        ("angle_rad", lambda x: np.concatenate([x[20:], np.full(20, x[-1])]), ("angle", "skew")),
        ("time_s", lambda x: 1e3 * x, ("time", "unit")),
    ],
)
def test_a_fault_of_the_log_is_named(axis, channel, change, problem):
    path, log = axis
    assert found(log | {channel: change(log[channel])}, path) == [problem]


def test_an_elastic_chain_under_a_servo(tmp_path):
    path = tmp_path / "elastic.xml"
    path.write_text(ELASTIC)
    t = np.arange(0, 10, DT)
    command = 0.6 * np.sin(2 * np.pi * 0.4 * t) + 0.3 * np.sin(2 * np.pi * 1.1 * t + 1)
    run = simgap.simulate(path, command, dt=DT)
    log = {"time_s": t, "command_rad": command, "angle_rad": run.angle + 2e-4 * np.random.default_rng(0).standard_normal(t.size)}
    assert simgap.check(log, path).verdict.value == "ready"
    assert found(log | {"angle_rad": -log["angle_rad"]}, path) == [("angle", "sign")]


def test_a_log_without_a_command_is_refused_with_what_the_servo_needs(axis):
    path, log = axis
    with pytest.raises(InputError, match="'servo' of the model is a servo; expected a column command_rad"):
        simgap.check({"time_s": log["time_s"], "torque_Nm": log["command_rad"], "angle_rad": log["angle_rad"]}, path)


@AXES
def test_the_command_line_checks_a_servo(axis, tmp_path):
    path, log = axis
    for name, change, code in (("good", 1.0, 0), ("bad", -1.0, 1)):
        table = np.column_stack([log["time_s"], log["command_rad"], change * log["angle_rad"]])
        np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",", header="time_s,command_rad,angle_rad", comments="")
        words = [str(tmp_path / f"{name}.csv"), "--model", str(path), "--out", str(tmp_path / name)]
        ended = CliRunner().invoke(check_command, words)
        assert ended.exit_code == code, ended.output
        assert ("Excitation" in ended.output) == (code == 0)
        written = json.loads((tmp_path / name / "check.json").read_text())
        assert written["verdict"] == ("fix" if code else "ready")
    page = (tmp_path / "good" / "check.html").read_text()
    assert "Does each position follow its command" in page
    assert "Do torque and motion" not in page
    assert "Command." in page
    assert "Angle." in page


@AXES
@pytest.mark.parametrize("sign", [pytest.param(1.0, marks=pytest.mark.slow), -1.0])
def test_a_diagnosis_begins_with_the_check(axis, tmp_path, sign):
    path, log = axis
    found = simgap.diagnose(
        log | {"angle_rad": sign * log["angle_rad"]}, path, out=tmp_path / "d", jobs=1, effects=["servo_deadband"], effort=0.02
    )
    said = json.loads((tmp_path / "d" / "diagnosis.json").read_text())
    assert said["log"]["verdict"] == ("ready" if sign > 0 else "fix")
    if sign < 0:
        assert [(p["channel"], p["problem"]) for p in said["log"]["problems"]] == [("angle", "sign")]
        assert (found.verdict.value, said["findings"]) == ("unexplained", [])
        assert "opposite sign" in said["summary"]
        assert "reverse the sign of angle" in said["next_experiment"]


@AXES
def test_what_the_motion_of_a_servo_can_show(axis):
    path, log = axis
    can = {e.family.split(" at ")[0]: e.identifiable for e in simgap.check(log, path).excitation}
    assert can["servo"]
    assert can["friction"]
    assert not can["position-locked effects"]
    gear = round(np.ptp(log["command_rad"]) / np.ptp(log["angle_rad"]))
    ramp = {"time_s": log["time_s"], "command_rad": 0.02 * gear * log["time_s"], "angle_rad": 0.02 * log["time_s"] - 1e-4}
    ramp["angle_rad"] = ramp["angle_rad"] + 1e-5 * np.random.default_rng(0).standard_normal(len(log["time_s"]))
    one_way = {e.family.split(" at ")[0]: e for e in simgap.check(ramp, path).excitation}
    assert not one_way["friction"].identifiable
    assert "one way" in one_way["friction"].sentence


@AXES
def test_a_servo_that_is_ahead_of_its_model_may_have_a_feedforward(axis):
    path, log = axis
    late = round(simgap.check(log, path).measured["memory"]["axis"]["angle over command"]["delay"] / DT)
    for shift, severity in ((late, "limits"), (late + 8, "fix")):  # at its command, and ahead of it
        moved = np.concatenate([log["angle_rad"][shift:], np.full(shift, log["angle_rad"][-1])])
        (skew,) = [p for p in simgap.check(log | {"angle_rad": moved}, path).problems if p.problem == "skew"]
        assert skew.severity.value == severity
        assert ("feedforward" in skew.sentence) == (severity == "limits")
