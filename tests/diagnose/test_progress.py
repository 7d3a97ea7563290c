"""Whoever waits is told: stage, rivals left, the best so far, how long about; sparingly where lines stay, never when quiet."""

from __future__ import annotations

import re

import numpy as np
import pytest
from click.testing import CliRunner
from numba import njit
from robot_axis import effect

from diagnose.pipeline import Options, diagnose
from diagnose.progress import Progress, Step
from mjsim.models import shipped_model
from simgap.cli import cli
from simgap.following import following
from simgap.pipeline import _compiling_told

FEW = ("coulomb_friction", "torque_offset", "time_delay")


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def test_the_time_left_is_that_of_the_stage_by_its_pace():
    clock, steps = Clock(), []
    p = Progress(steps.append, clock)
    p.stage("search", "add to the nominal model")
    assert (steps[-1].left, steps[-1].seconds) == (None, None)
    clock.now = 15.0
    p.rivals(10)
    assert steps[-1].seconds is None, "no rival is done yet"
    for _ in range(4):
        clock.now += 6.0
        p.rival()
    assert (steps[-1].left, steps[-1].seconds) == (6, pytest.approx(36.0))
    p.stage("validate")
    assert (steps[-1].left, steps[-1].seconds) == (None, None)


def test_a_step_is_one_line():
    assert str(Step("compare")) == "compare"
    step = Step("search", "round 2", 7, "backlash@gearbox", 48.0)
    assert str(step) == "search: round 2; 7 rivals left; best so far backlash@gearbox; about 50 s left"
    assert str(Step("search", left=1, seconds=400.0)) == "search; 1 rival left; about 420 s left"
    assert "about 1 s left" in str(Step("search", seconds=0.01))


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_diagnosis_tells_what_it_is_at(pair, robot, jobs):
    estimation, held_out = pair(effect("coulomb_friction", torque_Nm=0.1))
    steps: list[Step] = []
    diagnose(robot, [estimation], [held_out], Options(jobs=jobs, effects=FEW), steps.append)
    stages = list(dict.fromkeys(s.stage for s in steps))
    assert stages == ["compare", "search", "validate"]
    assert any(s.left == 0 for s in steps)
    assert max(s.left for s in steps if s.left is not None) > 2
    assert re.fullmatch(r"coulomb_friction@motor \([\d.]+ % of the refitted nominal's error\)", steps[-1].best)
    assert any(s.seconds is not None for s in steps)
    assert all(s.seconds is None or np.isfinite(s.seconds) for s in steps)


def test_lines_are_few_where_they_stay(capsys):
    with following(True, recalled=3) as tell:
        for left in range(100, 0, -1):
            tell(Step("search", "round 1", left))
        tell(Step("search", "round 1", 1, "backlash@arm"))
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert "going on with 3 fits" in lines[0]
    assert lines[1].endswith("search: round 1; 100 rivals left")
    assert "best so far backlash@arm" in lines[2]
    with following(False) as tell:
        tell(Step("search"))
    assert capsys.readouterr().err == ""


def test_a_terminal_shows_one_moving_line(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with following(True) as tell:
        tell(Step("search", "round [1]", 4))
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("quiet", [False, True])
def test_the_command_is_quiet_when_asked(pair, tmp_path, quiet):
    for name, r in zip(("log.csv", "other.csv"), pair(effect("coulomb_friction", torque_Nm=0.1), seconds=0.5), strict=True):
        rows = np.column_stack([r.time, r.torque, r.velocity, r.angle])
        header = "time_s,torque_Nm,velocity_rad_s,angle_rad"
        np.savetxt(tmp_path / name, rows, delimiter=",", header=header, comments="")
    arguments = [
        "diagnose", str(tmp_path / "log.csv"), "--held-out", str(tmp_path / "other.csv"), "--jobs", "1", "--effects",
        "coulomb_friction", "--model", str(shipped_model("robot_axis1")), "--out", str(tmp_path / "report"),
        *(("--quiet",) if quiet else ()),
    ]  # fmt: skip
    answer = CliRunner().invoke(cli, arguments)
    assert answer.exit_code == 0, answer.output
    assert (answer.stderr == "") is quiet
    assert ("compare: refitting the nominal model" in answer.stderr) is not quiet
    assert ("best so far coulomb_friction@motor" in answer.stderr) is not quiet


def test_compiling_is_told_and_how_far():
    """Where compiled code is not on disk yet the first answer takes a minute longer, and a silent tool would look stuck."""
    told: list[Step] = []
    with _compiling_told(told.append):
        for factor in (2.0, 3.0):
            njit(lambda x, factor=factor: factor * x)(1.0)
    assert {s.stage for s in told} == {"compile"}
    assert "so far" not in told[0].what
    assert told[-1].what.endswith("2 functions so far")
    count = len(told)
    with _compiling_told(told.append):
        pass
    njit(lambda x: x)(1.0)
    assert len(told) == count


def test_one_line_says_that_something_is_compiled_where_nothing_else_is_followed(capsys):
    with following(None) as say:
        for step in (Step("compare"), Step("compile", "the simulation"), Step("compile", "more"), Step("search")):
            say(step)
    assert capsys.readouterr().err == "simgap: compile: the simulation\n"
