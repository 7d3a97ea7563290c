"""Concealed robots: laws of the plants, what their cases hold, and the scores of changed numbers."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.result import Estimate
from lab.robot.cases import KINDS, SECONDS, draw, motion
from lab.robot.sample import PLAN, _numbers, markdown, plan
from lab.robot.servo_cases import KINDS as SERVO_KINDS
from lab.robot.servo_cases import draw_servo, nominal_robot
from lab.robot.servo_plant import simulate


def test_a_spring_holds_part_of_the_weight_of_a_servo_joint():
    """At rest kp (command - q) = weight + spring (q - rest)."""
    robot = nominal_robot(3).with_servo(1, spring=30.0, rest=0.2)
    command = np.tile([0.0, 0.7, 0.4], (400, 1))
    q = simulate(robot, command, 0.01)[-1]
    weight = robot.arm.torque(q[None], np.zeros((1, 3)), np.zeros((1, 3)))[0]
    assert 90.0 * (0.7 - q[1]) == pytest.approx(weight[1] + 30.0 * (q[1] - 0.2), abs=1e-6)
    assert 50.0 * (0.4 - q[2]) == pytest.approx(weight[2], abs=1e-6)


@pytest.mark.parametrize("axes", [3, 6])
def test_compensation_takes_a_part_of_the_weight(axes):
    case = draw_servo(11, "compensation", axes)
    (key,) = case.truth
    assert key == ("gravity_compensation_spring", "joint2")
    servo = case.true.servos[1]
    assert case.truth[key] == {"stiffness_Nm_rad": servo.spring}
    assert case.nominal.servos[1].spring == 0.0
    (law,) = draw(11, "compensation", axes).laws
    assert (law.id, law.joint) == ("gravity_compensation_spring", 1)


@pytest.mark.slow
@pytest.mark.parametrize("axes", [3, 6])
def test_a_steady_load_hardly_varies_and_friction_goes_with_it(axes):
    case = draw(12, "steady_load", axes)
    t = np.arange(0, SECONDS, 0.02)
    q, v, a = motion(case.kind, case.nominal, np.random.default_rng(3), t)
    load = case.true.torque(q, v, a)
    assert np.std(load[:, 1]) < 0.1 * abs(np.mean(load[:, 1]))
    (law,) = case.laws
    friction = law.torque(q[:, 1], v[:, 1], load[:, 1], t)
    np.testing.assert_allclose(friction, law.values["coefficient"] * np.abs(load[:, 1]) * np.sign(v[:, 1]))
    free = motion("single", case.nominal, np.random.default_rng(3), t)
    loaded = case.true.torque(*free)
    assert np.std(loaded[:, 1]) > 3 * np.std(load[:, 1])


def test_a_cable_stiffens_to_one_side():
    (law,) = draw(13, "cable", 6).laws
    assert law.id == "cable_torque"
    torque = law.torque(np.array([-1.0, 0.0, 1.0]), np.zeros(3), np.zeros(3), np.zeros(3))
    assert torque[1] == 0.0
    assert torque[2] > -2 * torque[0] > 0


def test_the_plan_holds_every_kind_and_the_drawn_robots_of_before_stay():
    assert {kind for plant, kind in PLAN if plant == "torque"} == set(KINDS)
    assert {kind for plant, kind in PLAN if plant == "servo"} == set(SERVO_KINDS)
    assert len(plan(1)) == 2 * sum(PLAN.values())
    assert KINDS[:4] == ("nothing", "parameters", "single", "pair")  # the seed of a case is its kind's index
    assert SERVO_KINDS[:6] == ("nothing", "parameters", "single", "pair", "skew", "coupled")


def test_a_table_has_the_kinds_that_are_declared():
    told = {"kind": "cable", "plant": "torque", "found": [], "right": True, "right_or_equivalent": True, "false_names": 0}
    table = markdown([told | {"number_errors": [0.02, 0.04], "numbers_hold": [True, False]}], ("cable", "compensation"))
    assert "| torque | cable | 1 of 6 | 1 (21 to 100 %)" in table
    assert "| servo | compensation | 0 of 6 |" in table
    assert "single" not in table
    assert "1 of 18 planned cases are measured, 17 are missing" in table
    assert "changed numbers 3 %; the intervals hold the truth in 1 of 2" in table
    assert "| servo | single |" in markdown([])


class Told:
    """What a score reads of a diagnosis."""

    def __init__(self, links, kp, armature):
        own = {"kp": Estimate(kp, (kp - 1, kp + 1), "N m/rad"), "armature": Estimate(armature, (0.0, 1.0), "kg m^2")}
        self.links = {k: Estimate(v, (v, v), "kg") for k, v in links.items()}
        self.joints = {f"joint{j}": type("Joint", (), {"linear_parameters": own})() for j in (1, 2, 3)}


def test_changed_numbers_are_scored_and_small_errors_are_not():
    seen = set()
    for seed in range(40):
        case = draw_servo(seed, "parameters", 3)
        what = case.parameters[0].split()[0]
        seen.add(what)
        links = {"forearm.payload": 0.7} if what == "payload" else {f"{n}.mass": 2.0 for n in ("upper_arm", "forearm")}
        numbers = _numbers(case, Told(links, 50.0, 0.1))
        assert len(numbers) == 1, case.parameters
        estimate, truth = numbers[0]
        expected = {"payload": 0.7, "mass": 2.0, "kp": 50.0, "armature": 0.1}[what]
        assert estimate.value == expected
        if what == "mass":
            ((none, mass),) = _numbers(case, Told({}, 50.0, 0.1))
            assert none.value in (2.8, 1.6)
            assert mass / none.value == pytest.approx(float(case.parameters[0].split()[-1]))
        if what == "payload":
            assert f"{truth:.2f}" == case.parameters[0].split()[1]
    assert seen == {"payload", "mass", "kp", "armature"}
