"""The lab's drives in Python: their laws, the design of the sample, its score."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest

from lab.real_use.firmware.__main__ import clear, false, line, right, table, write_files
from lab.real_use.firmware.design import ARM, SINGLE, Case, draw
from lab.real_use.firmware.drive import PERIOD, Firmware, Loop
from mjsim.effects.registry import registered
from mjsim.mjcf import load_axis
from mjsim.robot.model import load_robot

STILL = np.zeros(1)


def targets(firmware: Firmware, steps: int) -> np.ndarray:
    """Targets (steps + 1,) after a step of the command to 1, read from the force of a unit gain at rest."""
    loop = Loop(firmware, 1)
    loop.force(np.zeros(1), STILL, STILL)
    return np.array([0.0, *(float(loop.force(np.ones(1), STILL, STILL)[0]) for _ in range(steps))])


def test_a_profile_keeps_its_bounds_and_stops_at_the_command():
    r = targets(Firmware(kp=1.0, kv=0.0, speed=1.5, acceleration=8.0), 1500)
    v = np.diff(r) / PERIOD
    assert np.max(v) == pytest.approx(1.5)
    assert np.max(np.abs(np.diff(v))) <= 8.0 * PERIOD * (1 + 1e-9)
    assert np.max(r) <= 1.0 + 8.0 * PERIOD**2, "it does not overshoot by more than a step"
    assert r[-1] == pytest.approx(1.0, abs=8.0 * PERIOD**2)
    arrival = 1 / 1.5 + 1.5 / 8.0  # of the trapezoid
    assert np.flatnonzero(r > 0.999)[0] * PERIOD == pytest.approx(arrival, abs=0.05)


def test_a_command_acts_after_the_latency_and_slowly_with_a_lag():
    assert np.flatnonzero(targets(Firmware(1.0, 0.0, latency=0.02), 40) > 0.5)[0] == 21
    force = targets(Firmware(1.0, 0.0, lag=0.01), 30)
    assert force[10] == pytest.approx(1 - np.exp(-1.0), abs=0.02)


def test_the_force_stays_under_its_limits():
    assert targets(Firmware(10.0, 0.0, limit=3.0), 3)[-1] == 3.0
    loop = Loop(Firmware(10.0, 0.0, stall=4.0, free_speed=2.0), 1)
    assert loop.force(np.ones(1), STILL, np.ones(1))[0] == pytest.approx(2.0), "half of the stall force at half the free speed"


def test_kinds_come_in_turn_and_have_known_effects():
    for arms, kinds in ((False, SINGLE), (True, ARM)):
        cases = draw(2 * len(kinds), 5, arms)
        assert set(Counter(c.kind for c in cases).values()) == {2}
        assert cases[: len(kinds)] == draw(len(kinds), 5, arms)
    names = {n for sets in SINGLE.values() for s in sets for n in s} | {n for names in ARM.values() for n in names}
    assert names <= set(registered())


@pytest.mark.parametrize(("machine", "kind"), [("slide", "profile"), ("arm", "friction")])
def test_the_users_file_is_one_that_the_tool_reads(tmp_path, monkeypatch, machine, kind):
    case = Case(0, machine, kind, 50.0, "ramps", "encoder", "held", 3)
    monkeypatch.setattr("lab.real_use.firmware.__main__.SECONDS", {50.0: 2.0})
    where, moved = write_files(case, tmp_path)
    assert moved > 0
    assert where == ([(n, "coulomb_friction") for n in ("yaw", "shoulder", "elbow", "wrist")] if machine == "arm" else [])
    model = tmp_path / "model.xml"
    assert load_robot(model).joints == ("yaw", "shoulder", "elbow", "wrist") if machine == "arm" else load_axis(model).chain.servo
    assert np.loadtxt(tmp_path / "held_out.csv", delimiter=",", skiprows=1).shape == (100, 9 if machine == "arm" else 3)


def test_the_score_counts_what_is_said():
    case = dataclasses.asdict(Case(0, "pendulum", "dry_friction", 50.0, "sines", "noise", "held", 1))
    said = {**case, "where": [], "moved": 0.1, "exit": 0, "cpu_seconds": 1.0, "values": [], "equivalents": []}
    good = {**said, "verdict": "missing_physics", "found": [["", "coulomb_friction"]]}
    assert right(good)
    assert not right({**good, "verdict": "unexplained"})
    assert false({**said, "verdict": "missing_physics", "found": [["", "servo_deadband"]]})
    quiet = {**said, "verdict": "no_mismatch", "found": []}
    assert clear(quiet)
    assert not right(quiet)
    assert right({**quiet, "moved": 0.0}), "what was not reached is not there"
    arm = {**quiet, "machine": "arm", "kind": "deadband", "where": [["yaw", "servo_deadband"]]}
    assert right({**arm, "verdict": "missing_physics", "found": [["yaw", "servo_deadband"]]})
    assert false({**arm, "verdict": "missing_physics", "found": [["wrist", "servo_deadband"]]})
    text = table([good, quiet])
    assert "| one joint: right | 1 of 2 |" in text
    assert line(quiet).strip() in text
