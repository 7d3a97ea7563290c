"""What ends the diagnosis of a servo robot: the budget of time, a log that is too short, a fault."""

from __future__ import annotations

import pytest

from diagnose.robot.options import RobotOptions
from lab.robot.arm import three_axes
from lab.robot.servo_plant import ServoJoint, ServoRobot, servo_mjcf, write_servo_log
from mjsim.errors import InputError
from simgap.robot import LATE, diagnose_robot_files

NOMINAL = ServoRobot(three_axes(), tuple(ServoJoint(kp, kv) for kp, kv in ((60.0, 6.0), (90.0, 8.0), (50.0, 4.0))))


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    """Dry friction at the second joint: the nominal file and two logs."""
    out = tmp_path_factory.mktemp("servo")
    (out / "arm.xml").write_text(servo_mjcf(NOMINAL))
    for seed, name in ((1, "a"), (2, "b")):
        write_servo_log(NOMINAL.with_servo(1, friction=1.0), out / f"{name}.csv", seed, 16.0)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("late", [True, False])
def test_the_budget_of_time_ends_the_search(rubbing, late):
    options = RobotOptions(joints=("joint2",), effects=("coulomb_friction",), **({"until": 0.0} if late else {}))
    d = diagnose_robot_files([rubbing / "a.csv"], rubbing / "arm.xml", rubbing / "out", [rubbing / "b.csv"], options, page=False)
    assert [f.effect for f in d.findings] == ([] if late else ["coulomb_friction"])
    assert (LATE in d.notes) is late


@pytest.mark.slow
def test_a_model_that_is_still_judged_has_not_its_final_name(rubbing, monkeypatch):
    def broken(*asked):
        assert asked[2].is_file()
        raise MemoryError

    monkeypatch.setattr("simgap.robot_servos.judge_servos", broken)
    with pytest.raises(MemoryError):
        diagnose_robot_files([rubbing / "a.csv"], rubbing / "arm.xml", rubbing / "broken", options=RobotOptions(until=0.0))
    assert not list((rubbing / "broken").iterdir())


def test_joints_that_hardly_move_are_refused_in_one_line(tmp_path):
    (tmp_path / "arm.xml").write_text(servo_mjcf(NOMINAL))
    write_servo_log(NOMINAL.with_servo(1, friction=1.0), tmp_path / "short.csv", 1, 2.6)
    with pytest.raises(InputError, match=r"short.csv: no joint has enough samples in motion; expected 200 fitted"):
        diagnose_robot_files([tmp_path / "short.csv"], tmp_path / "arm.xml", tmp_path / "out")
