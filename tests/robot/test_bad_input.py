"""What a user may get wrong with a robot: each ends with one line on standard error and exit code 2."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

T = 0.01 * np.arange(600)
MOTION = {f"joint{k}": 0.3 * np.sin((1 + k) * T) for k in (1, 2, 3)}


def robot_log(**changes: np.ndarray | None) -> dict[str, np.ndarray]:
    """Columns of a log of arm3 by torque; a change that is None leaves a column out."""
    columns = {"time_s": T}
    for k, (joint, q) in enumerate(MOTION.items()):
        columns |= {f"{joint}.angle_rad": q, f"{joint}.torque_Nm": np.cos((2 + k) * T)}
    columns |= {name.replace("__", "."): c for name, c in changes.items()}
    return {name: c for name, c in columns.items() if c is not None}


COMMANDS = {f"joint{k}__command_rad": MOTION[f"joint{k}"] for k in (1, 2, 3)}
AXIS = {"time_s": T, "torque_Nm": np.cos(T), "angle_rad": 0.3 * np.sin(T), "velocity_rad_s": 0.3 * np.cos(T)}
CASES = {
    "joint that is not in the model": (
        robot_log(elbow__angle_rad=MOTION["joint1"]), "arm3", (),
        ("log.csv", "joint 'elbow' is not in the model", "one of joint1, joint2, joint3"),
    ),
    "joint that resembles one": (
        robot_log(join2__angle_rad=MOTION["joint1"]), "arm3", (), ("did you mean 'joint2'?",)
    ),
    "named joint that is not in the log": (
        robot_log(joint2__angle_rad=None, joint2__torque_Nm=None), "arm3", ("--joint", "joint2"),
        ("log.csv: joint 'joint2' has no torque in the log",),
    ),
    "no joint with a torque": (
        robot_log(**{f"joint{k}__torque_Nm": None for k in (1, 2, 3)}), "arm3", (),
        ("log.csv: no joint has a torque and moves", "joint1.torque_Nm"),
    ),
    "motion beyond the limits": (
        robot_log(joint2__angle_rad=12 * MOTION["joint2"]), "arm3", (),
        ("log.csv: joint2 is at", "-1.8 to 1.8, the joint's range"),
    ),
    "commands of joints swapped": (
        robot_log(**COMMANDS | {"joint1__command_rad": MOTION["joint2"], "joint2__command_rad": MOTION["joint1"]}), "arm3", (),
        ("the command of joint1 goes with the position of joint2", "swap the columns"),
    ),
    "log of one axis for a robot": (AXIS, "arm3", (), ("log.csv: no column of a joint", "joint1.angle_rad")),
    "comparison that is chosen": (robot_log(), "arm3", ("--judge", "motion"), ("--judge: motion", "leave it out")),
    "log of one axis with a joint": (
        AXIS, "pendulum", ("--joint", "pendulum"),
        ("--joint: 'pendulum', and log.csv names no joints", "JOINT.angle_rad", "leave it out"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_each_is_one_line_with_exit_code_two(name, run_cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    columns, model, words, said = CASES[name]
    monkeypatch.chdir(tmp_path)
    table = np.column_stack(list(columns.values()))
    np.savetxt("log.csv", table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    code, _, err = run_cli("diagnose", "log.csv", "--model", model, *words, "--out", "out", "--quiet")
    assert code == 2
    assert len(err.splitlines()) == 1
    for part in said:
        assert part in err
    assert not Path("out/diagnosis.json").exists()
