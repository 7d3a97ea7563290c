"""Logs of robots and servos: one joint of several, stamps that jitter, commands with stamps of their own, what is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mjsim.errors import InputError
from mjsim.recording import load

N = 400
TIME = 0.02 * np.arange(N)
WAVE = np.sin(3.0 * TIME)


def write(path: Path, columns: dict[str, np.ndarray], toml: str = "") -> Path:
    rows = np.column_stack(list(columns.values()))
    path.write_text(",".join(columns) + "\n" + "\n".join(",".join(f"{v:.17g}" for v in row) for row in rows) + "\n")
    if toml:
        path.with_suffix(".toml").write_text(toml)
    return path


def robot(path: Path, toml: str = "") -> Path:
    columns = {"time_s": TIME}
    for k, joint in enumerate(("pan", "lift"), start=1):
        columns |= {f"{joint}.command_rad": k * WAVE, f"{joint}.angle_rad": k * WAVE + 0.1, f"{joint}.current_A": np.full(N, k)}
    return write(path, columns, toml)


def test_one_joint_of_a_robots_log(tmp_path):
    path = robot(tmp_path / "log.csv")
    lift = load(path, joint="lift")
    assert lift.joint == "lift"
    assert np.array_equal(lift.command, 2 * WAVE)
    assert np.array_equal(lift.input, lift.command)
    assert np.array_equal(lift.current, np.full(N, 2.0))
    assert np.isnan(lift.torque).all(), "the log has no torque, and none is made up"
    assert load(path, prefer="pan").joint == "pan"
    with pytest.raises(InputError, match=r"holds 2 joints.*--joint.*pan, lift"):
        load(path)
    with pytest.raises(InputError, match=r"'elbow' is not in log.csv; expected one of pan, lift"):
        load(path, joint="elbow")


def test_a_single_axis_may_use_the_short_names(tmp_path):
    log = load(write(tmp_path / "log.csv", {"time_s": TIME, "command_rad": WAVE, "angle_rad": WAVE}))
    assert np.array_equal(log.command, WAVE)
    assert log.hold == "held"
    with pytest.raises(InputError, match="names no joints"):
        load(tmp_path / "log.csv", joint="pan")


def test_joints_are_bound_by_toml(tmp_path):
    toml = (
        '[recording]\ntime = "time_s"\nhold = "linear"\n[experiment]\nkp = 12.5\n'
        '[joints.shoulder]\ncommand = {column = "lift.command_rad", unit = "deg"}\nangle = "lift.angle_rad"\n'
        'current = {column = "lift.current_A", unit = "mA"}\n'
    )
    log = load(robot(tmp_path / "log.csv", toml))
    assert log.joint == "shoulder"
    np.testing.assert_allclose(log.command, np.deg2rad(2 * WAVE))
    np.testing.assert_allclose(log.current, 2e-3)
    assert log.hold == "linear"
    assert log.known == {"kp": 12.5}


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        ('[recording]\nhold = "cubic"', "held or linear or mean"),
        ("[recording]\njitter = -1", "a part of the sample time, above zero"),
        ('[joints.pan]\nspeed = "x"', "key 'speed' is not known"),
        ("[experiment]\nkp = 0", "a number above zero"),
        ("[experiment]\npayload = {mass = 1}", "put the payload into the model"),
        ("[experiment]\nsupplyV = 12", "did you mean 'supply_V'"),
        ("[experiment]\nmass = 1", "set the mass in the model"),
        ('[recording]\ncomand = "x"', "did you mean 'command'"),
        ('joints = "pan"', r"a table \[joints\]"),
    ],
)
def test_a_bad_binding_is_one_line(tmp_path, toml, said):
    with pytest.raises(InputError, match=said):
        load(robot(tmp_path / "log.csv", toml))


def test_jitter_is_refused_unless_it_is_declared_and_is_then_resampled_and_said(tmp_path):
    stamps = TIME + 0.002 * np.random.default_rng(0).uniform(-1, 1, N)
    stamps[[0, -1]] = TIME[[0, -1]]
    columns = {"time_s": stamps, "command_rad": np.sin(3.0 * stamps), "angle_rad": np.cos(3.0 * stamps)}
    path = write(tmp_path / "log.csv", columns)
    with pytest.raises(InputError, match=r"jitter = 0.2 resamples them"):
        load(path)
    toml = '[recording]\ntime = "time_s"\ncommand = "command_rad"\nangle = "angle_rad"\njitter = 0.2\nhold = "linear"\n'
    log = load(write(path, columns, toml))
    np.testing.assert_allclose(log.time, TIME, atol=1e-12)
    np.testing.assert_allclose(log.angle, np.cos(3.0 * TIME), atol=1e-6)
    np.testing.assert_allclose(log.command, np.sin(3.0 * TIME), atol=5e-4)
    assert "resampled to one of 20 ms" in log.notes[0]


def test_a_held_command_keeps_its_area_when_it_is_resampled(tmp_path):
    stamps = TIME + 0.002 * np.random.default_rng(1).uniform(-1, 1, N)
    stamps[[0, -1]] = TIME[[0, -1]]
    steps = np.repeat(np.random.default_rng(2).uniform(-1, 1, N // 10), 10)
    toml = '[recording]\ntime = "time_s"\ncommand = "command_rad"\nangle = "angle_rad"\njitter = 0.2\n'
    log = load(write(tmp_path / "log.csv", {"time_s": stamps, "command_rad": steps, "angle_rad": WAVE}, toml))
    area = np.cumsum(steps * np.diff(stamps, append=stamps[-1] + 0.02))
    assert np.max(np.abs(0.02 * np.cumsum(log.command) - area)) < 0.002 * 2
    assert 0.02 * np.sum(log.command) == pytest.approx(area[-1], abs=1e-12)


def test_a_command_with_stamps_of_its_own_is_put_onto_those_of_the_state(tmp_path):
    columns = {"time_s": TIME, "command_time_s": TIME - 0.004, "command_rad": 2.0 * (TIME - 0.004), "angle_rad": WAVE}
    log = load(write(tmp_path / "log.csv", columns))
    np.testing.assert_allclose(log.command[:-1], 2.0 * TIME[:-1], atol=1e-12)
    assert "4 ms (median) before" in log.notes[0]
