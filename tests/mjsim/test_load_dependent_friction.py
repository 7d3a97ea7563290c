"""Load-dependent friction of one rigid body: the load is the torque of its drive."""

from __future__ import annotations

import numpy as np
import pytest
from servo_logs import PENDULUM, model

from mjsim import accurate, ode
from mjsim.axis import Axis, Body, Chain
from mjsim.chain import Coupling
from mjsim.effects import NotApplicableError, effect_class
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.mujoco_run import lacking
from mjsim.ode import inverse, simulate
from mjsim.servo import Servo

J, DAMPING, DT = 0.02, 0.05, 0.01
TIME = DT * np.arange(60)
SQUARE = 0.5 * np.sign(np.sin(2 * np.pi * 1.3 * TIME + 0.1))
FRICTION = effect_class("load_dependent_friction")
WEIGHT = effect_class("gravity_load")


def axis(
    c: float, *effects, gain: float = 1.0, servo: Servo | None = None, viscous: float = DAMPING, driven: bool = True
) -> Axis:
    chain = Chain((Body("motor", J, viscous, "j"),), (), gain=gain, servo=servo, driven=driven)
    return Axis(chain, (FRICTION(coefficient=c), *effects))


def written_out(u: np.ndarray, c: float, kp: float, kv: float, limit: float, fine: int = 1000) -> np.ndarray:
    """Angle (N,) of a position servo by RK4 in steps of DT / fine, the law written out; no weight, hence no rest."""
    h = DT / fine

    def rates(q: float, v: float, target: float) -> tuple[float, float]:
        force = min(max(kp * (target - q) - kv * v, -limit), limit)
        return v, (force - c * abs(force) * ((v > 0) - (v < 0)) - DAMPING * v) / J

    q, v, out = 0.0, 1e-9, []
    for target in u.tolist():
        out.append(q)
        for _ in range(fine):
            k1 = rates(q, v, target)
            k2 = rates(q + h / 2 * k1[0], v + h / 2 * k1[1], target)
            k3 = rates(q + h / 2 * k2[0], v + h / 2 * k2[1], target)
            k4 = rates(q + h * k3[0], v + h * k3[1], target)
            q += h / 6 * (k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0])
            v += h / 6 * (k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1])
    return np.array(out)


@pytest.mark.parametrize("limit", [np.inf, 2.0])
def test_under_a_servo_the_load_is_the_force_of_the_servo_within_its_limit(limit):
    servo = Servo(10.0, 0.3, limit=limit)
    run = simulate(axis(0.3, servo=servo), SQUARE, DT)
    truth = written_out(SQUARE, 0.3, 10.0, 0.3, limit)
    assert np.std(run.angle - truth) < FRICTION.tolerance * np.std(truth)
    fine = simulate(axis(0.3, servo=servo), SQUARE, DT, substeps=16)
    np.testing.assert_allclose(fine.angle, truth, atol=3e-5)  # the reference smears the jump of the friction over 10 us
    assert np.std(run.angle - simulate(axis(0.0, servo=servo), SQUARE, DT).angle) > 0.02, "the law acts"


@pytest.mark.parametrize("gain", [1.0, 3.0, -2.0])
def test_under_a_torque_both_realisations_agree(gain):
    t = 5e-4 * np.arange(3000)
    u = 2.0 * np.sin(8.0 * t) + 0.7 * np.sin(20.0 * t + 1.0)
    found = axis(0.2, WEIGHT(torque_Nm=1.0, phase_rad=0.3), gain=gain)
    truth = simulate(found, u, 5e-4, substeps=16).velocity
    bare = simulate(found.without(found.effects[0].key), u, 5e-4).velocity
    assert np.std(truth - bare) > 0.1 * np.std(bare)
    for run in (simulate(found, u, 5e-4), accurate.simulate(found, u, 5e-4)):
        assert np.std(run.velocity - truth) < 1e-6 * np.std(truth)


def test_a_constant_torque_is_less_by_its_share():
    run = simulate(axis(0.25, gain=2.0, viscous=0.0), np.full(50, 1.5), DT)
    np.testing.assert_allclose(run.velocity, 0.75 * 3.0 / J * DT * np.arange(50), rtol=1e-9)


@pytest.mark.parametrize(("torque", "moves"), [(1.3, 1), (1.2, 0), (0.85, 0), (0.8, -1)])
def test_it_holds_a_weight_while_the_torque_is_within_its_share_of_it(torque, moves):
    """c = 0.2 and a weight W = 1: at rest for W / (1 + c) < T < W / (1 - c), 0.833 to 1.25."""
    found = axis(0.2, WEIGHT(torque_Nm=1.0, phase_rad=np.pi / 2))
    for engine in (simulate, accurate.simulate):
        assert np.sign(engine(found, np.full(20, torque), DT).velocity[-1]) == moves


def test_integral_action_is_part_of_the_drives_torque():
    integral = effect_class("integral_action")(gain_Nm_rad_s=0.0, start_Nm=2.0)
    run = simulate(axis(0.25, integral, servo=Servo(10.0, 0.3)), np.zeros(2), 1e-6)
    assert run.velocity[1] == pytest.approx(0.75 * 2.0 / J * 1e-6, rel=1e-4)


@pytest.mark.parametrize("servo", [None, Servo(10.0, 0.3)], ids=["torque", "servo"])
@pytest.mark.parametrize("c", [0.2, 0.9])
def test_inverse_dynamics_find_the_torque_that_drives_its_own_friction(c, servo):
    """T - c |T| sign(v) = J a + f v + weight, solved by hand: T = A / (1 - c) where A drives the motion, A / (1 + c) else."""
    t = 5e-4 * np.arange(3000)
    q, v = 0.6 * np.sin(3 * t) + 0.2 * np.sin(7 * t + 1), 1.8 * np.cos(3 * t) + 1.4 * np.cos(7 * t + 1)
    a = -5.4 * np.sin(3 * t) - 9.8 * np.sin(7 * t + 1)
    found = axis(c, WEIGHT(torque_Nm=1.0, phase_rad=0.0), gain=2.0, servo=servo)
    u = inverse(found, q, v, a, 5e-4)
    torque = 2.0 * u if servo is None else 2.0 * (10.0 * (u - 2.0 * q) - 0.3 * 2.0 * v)
    asked = J * a + DAMPING * v + np.sin(q)
    expected = np.where(asked * v > 0, asked / (1 - c), asked / (1 + c))
    np.testing.assert_allclose(torque, expected, atol=1e-9 * np.max(np.abs(expected)))


def test_an_axis_without_a_drive_has_no_load():
    with pytest.raises(NotApplicableError, match="no actuator"):
        FRICTION(coefficient=0.1).ports(axis(0.1, driven=False).chain)
    with pytest.raises(NotApplicableError, match="gearbox"):
        FRICTION(place="gearbox", coefficient=0.1).ports(axis(0.1).chain)


def test_with_a_coupling_the_load_is_that_of_the_coupling():
    """A stiff coupling carries the torque that moves the body behind it, and not that of the drive."""
    bodies = (Body("motor", 0.015, 0.0, "m"), Body("arm", 0.005, 0.0, "a"))
    chain = Chain(bodies, (Coupling("gearbox", 1.0, 2000.0, 0.5, "a"),))
    run = ode.simulate(Axis(chain, (FRICTION(coefficient=0.4),)), np.ones(400), 1e-3)
    # J_m a = T - S - c S, S = J_a a
    assert run.velocity[-1] == pytest.approx(1.0 / (0.015 + 1.4 * 0.005) * 0.399, rel=2e-3)


def test_a_servo_file_carries_it(tmp_path):
    """MJCF has no element for it: simgap reads it back, plain MuJoCo steps the rest and is said to lack it."""
    path = tmp_path / "pendulum.xml"
    path.write_text(model(PENDULUM), encoding="utf-8")
    found = load_axis(path) + FRICTION(coefficient=0.2)
    written = write_corrected(path, found, tmp_path / "corrected.xml")
    assert [line for line in written.lacks if "load dependent friction" in line]
    again = load_model(written.path)
    assert [e for e in again.axis.effects if e.id == FRICTION.id] == [FRICTION(coefficient=0.2)]
    assert lacking(again)
    np.testing.assert_allclose(simulate(again.axis, SQUARE, DT).angle, simulate(found, SQUARE, DT).angle, atol=1e-9)
