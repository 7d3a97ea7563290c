"""Servos in the plant: the law, its limits and its dead band against a fine reference; read from and written to MJCF."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from servo_logs import GEARED, PENDULUM, model, record, write

from mjsim import accurate, reference
from mjsim.axis import Axis, Body, Chain
from mjsim.effects import NotApplicableError, effect_class, registered
from mjsim.errors import InputError
from mjsim.hold import between, slewed
from mjsim.mjcf import load_axis, write_corrected
from mjsim.ode import simulate, work_done
from mjsim.servo import Servo, Target

DT = 0.01
TIME = DT * np.arange(120)
SQUARE = 0.5 * np.sign(np.sin(2 * np.pi * 1.3 * TIME + 0.1))
WAVE = np.sin(2 * np.pi * 0.7 * TIME)


def axis(servo: Servo, *effects, gain: float = 1.0) -> Axis:
    return Axis(Chain((Body("motor", 0.02, 0.05, "j"),), (), gain=gain, servo=servo), effects)


def written_out(u, hold, *, kp=10.0, kv=0.3, limit=np.inf, band=0.0, stall=np.inf, no_load=1.0, fine=500):
    """Angle (N,) by RK4 in steps of DT / fine, the law written out."""
    start, slope = between(u, DT, hold)
    h = DT / fine

    def rates(q, v, c):
        e = c - q
        e -= min(max(e, -band), band)
        force = kp * e - kv * v
        force = min(max(force, -limit), limit)
        if stall < np.inf:
            force = min(max(force, -stall * (1 + v / no_load)), stall * (1 - v / no_load))
        return v, (force - 0.05 * v) / 0.02

    q, v, out = 0.0, 0.0, []
    for a, b in zip(start.tolist(), slope.tolist(), strict=True):
        out.append(q)
        for i in range(fine):
            c = a + b * h * i, a + b * h * (i + 0.5), a + b * h * (i + 1.0)
            k1 = rates(q, v, c[0])
            k2 = rates(q + h / 2 * k1[0], v + h / 2 * k1[1], c[1])
            k3 = rates(q + h / 2 * k2[0], v + h / 2 * k2[1], c[1])
            k4 = rates(q + h * k3[0], v + h * k3[1], c[2])
            q += h / 6 * (k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0])
            v += h / 6 * (k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1])
    return np.array(out)


@pytest.mark.parametrize("hold", ["held", "linear", "mean"])
def test_the_linear_servo_is_exact_for_every_hold(hold):
    run = simulate(axis(Servo(10.0, 0.3)), WAVE, DT, hold=hold)
    np.testing.assert_allclose(run.angle, written_out(WAVE, hold, fine=60), atol=1e-8)  # of the reference: (h w)^4


@pytest.mark.parametrize(
    ("servo", "effects", "law"),
    [
        (Servo(10.0, 0.3, limit=1.5), {}, {"limit": 1.5}),
        (Servo(10.0, 0.3), {"servo_deadband": {"half_width_rad": 0.1}}, {"band": 0.1}),
        (Servo(10.0, 0.3, limit=1.5), {"servo_deadband": {"half_width_rad": 0.1}}, {"limit": 1.5, "band": 0.1}),
        (
            Servo(10.0, 0.3), {"torque_speed_limit": {"stall_torque_Nm": 2.0, "no_load_speed_rad_s": 6.0}},
            {"stall": 2.0, "no_load": 6.0},
        ),
        (Servo(10.0, 0.3), {"actuator_saturation": {"limit_Nm": 1.5}}, {"limit": 1.5}),
    ],
    ids=["limit", "deadband", "both", "torque-speed", "saturation"],
)  # fmt: skip
@pytest.mark.parametrize("hold", [pytest.param("held", marks=pytest.mark.slow), "linear"])
def test_limits_and_dead_band_are_events(servo, effects, law, hold):
    found = axis(servo, *(effect_class(name)(**values) for name, values in effects.items()))
    u = SQUARE[:50]
    run = simulate(found, u, DT, hold=hold)
    # the reference smears a kink over a step: h^2 of a jump of the slope
    np.testing.assert_allclose(run.angle, written_out(u, hold, **law), atol=2e-6)
    assert np.std(simulate(axis(Servo(10.0, 0.3)), u, DT, hold=hold).angle - run.angle) > 1e-3, "the law acts"


def test_a_velocity_servo_and_an_integrated_one_follow_their_speed():
    speed = axis(Servo(0.0, 1.0, Target.VELOCITY))
    run = simulate(speed, np.full(400, 0.5), DT)
    assert run.velocity[-1] == pytest.approx(0.5 / 1.05, rel=1e-9)  # of the damping beside kv
    integrated = simulate(axis(Servo(10.0, 0.3, Target.INTEGRATED)), np.full(400, 0.5), DT)
    assert integrated.velocity[-1] == pytest.approx(0.5, rel=1e-6)


def test_gear_zero_and_range_of_the_command():
    geared = simulate(axis(Servo(10.0 / 25, 0.3 / 25), gain=5.0), 5 * WAVE, DT).angle
    np.testing.assert_allclose(geared, simulate(axis(Servo(10.0, 0.3)), WAVE, DT).angle, atol=1e-12)
    shifted = simulate(axis(Servo(10.0, 0.3, zero=0.1)), WAVE + 0.1, DT).angle
    np.testing.assert_allclose(shifted, simulate(axis(Servo(10.0, 0.3)), WAVE, DT).angle, atol=1e-12)
    cut = simulate(axis(Servo(10.0, 0.3, low=-0.2, high=0.3)), WAVE, DT).angle
    np.testing.assert_allclose(cut, simulate(axis(Servo(10.0, 0.3)), np.clip(WAVE, -0.2, 0.3), DT).angle, atol=1e-12)


def test_its_gains_are_parameters_of_the_model_unless_they_are_held():
    free = axis(Servo(10.0, 0.3, limit=2.0))
    assert [p.name for p in free.chain.linear_parameters()] == ["Jm", "fm", "kp", "kv", "limit", "zero"]
    held = dataclasses.replace(free.chain, held=("Jm", "kv"))
    assert [p.name for p in held.linear_parameters()] == ["fm", "kp", "limit", "zero"]
    assert held.with_linear({"kp": 4.0, "limit": 1.0}).servo == Servo(4.0, 0.3, limit=1.0)


def test_a_slew_limit_reaches_a_step_when_it_may_and_keeps_a_slow_command():
    start, slope = slewed(np.full(5, 0.25), DT, 10.0, "held")
    assert np.array_equal(start, np.full(5, 0.25))
    assert not slope.any()
    step = np.array([0.0, 0.25, 0.25, 0.25, 0.25, 0.25])
    start, slope = slewed(step, DT, 10.0, "held")
    np.testing.assert_allclose(start[:3], [0.0, 0.0, 0.1])
    np.testing.assert_allclose(slope[1:3], 10.0)
    assert start[3] + 0.5 * DT * slope[3] == pytest.approx(0.25 - 0.05 * 0.25)  # mean of half a sample of ramp, half of rest
    np.testing.assert_allclose(start[4:], 0.25)
    fast = axis(Servo(10.0, 0.3), effect_class("velocity_limit")(limit_rad_s=1e8))
    np.testing.assert_allclose(simulate(fast, WAVE, DT).angle, simulate(axis(Servo(10.0, 0.3)), WAVE, DT).angle, atol=1e-7)


@pytest.mark.parametrize(("hold", "error"), [("held", 1e-10), ("linear", 1e-10), ("mean", 2e-4)])
@pytest.mark.parametrize("rate", [100, 200])
def test_a_fine_run_logged_slowly_is_met_by_its_hold(hold, error, rate):
    """2 kHz, logged at 100 and 200 Hz, the input held, in straight lines, or averaged; "mean" errs by the second difference."""
    chain = Axis(Chain((Body("motor", 0.02, 0.05, "j"),), ()))
    each = 2000 // rate
    fine = np.sin(2 * np.pi * 3.0 * np.arange(2000) / 2000) + 0.3 * np.sin(2 * np.pi * 7.0 * np.arange(2000) / 2000)
    if hold == "held":
        fine = np.repeat(fine[::each], each)
        logged = fine[::each]
    elif hold == "linear":
        at = np.arange(2000)
        logged = fine[::each]
        fine = np.interp(at, at[::each], logged)
        fine[at[::each][-1] :] = logged[-1]
    else:
        logged = np.concatenate([fine[:1], fine.reshape(-1, each).mean(axis=1)[:-1]])  # of the interval before a row
    truth = simulate(chain, fine, 1 / 2000, hold="linear" if hold == "linear" else "held").velocity[::each]
    known = slice(None) if hold != "mean" else slice(-1)  # the mean of the last interval has no row
    run = simulate(chain, logged, 1 / rate, hold=hold).velocity
    assert np.max(np.abs(run - truth)[known]) < error * np.max(np.abs(truth))
    if hold != "held":
        wrong = simulate(chain, logged, 1 / rate).velocity
        assert np.max(np.abs(wrong - truth)) > 50 * np.max(np.abs(run - truth)[known])


@pytest.mark.parametrize(("template", "gear"), [(PENDULUM, 1.0), (GEARED, 20.0)])
@pytest.mark.parametrize("hold", ["held", "linear"])
def test_it_runs_as_plain_mujoco_does(tmp_path, template, gear, hold):
    found = load_axis(write(tmp_path / "m.xml", template))
    log = record(model(template), seconds=5, step=0, noise=0.0, gear=gear, hold=hold)
    run = simulate(found, log.input, log.dt, initial=np.array([[log.angle[0]], [0.0]]), hold=hold)
    assert np.std(run.angle - log.angle) < 5e-5 * np.std(log.angle) + (1e-4 if hold == "linear" else 0.0)


@pytest.mark.parametrize(
    ("actuator", "servo"),
    [
        ('<position name="s" joint="hinge" kp="8" kv="0.3" forcerange="-2 2"/>', Servo(8.0, 0.3, limit=2.0)),
        ('<velocity name="s" joint="hinge" kv="0.7"/>', Servo(0.0, 0.7, Target.VELOCITY)),
        ('<intvelocity name="s" joint="hinge" kp="8" kv="0.3" actrange="-9 9"/>', Servo(8.0, 0.3, Target.INTEGRATED)),
        (
            '<general name="s" joint="hinge" gainprm="4" biastype="affine" biasprm="0.8 -8 -0.3" ctrlrange="-1 2"/>',
            Servo(8.0, 0.3, zero=-0.1, scale=0.5, low=-1.0, high=2.0),
        ),
    ],
    ids=["position", "velocity", "intvelocity", "general"],
)  # fmt: skip
def test_every_kind_of_mjcf_is_read_and_written_back(tmp_path, actuator, servo):
    text = model(PENDULUM)
    start, end = text.index("<position"), text.index("/>", text.index("<position")) + 2
    path = tmp_path / "m.xml"
    path.write_text(text[:start] + actuator + text[end:])
    found = load_axis(path)
    assert dataclasses.astuple(found.chain.servo) == pytest.approx(dataclasses.astuple(servo), abs=1e-12)
    name = "kv" if servo.target is Target.VELOCITY else "kp"
    changed = found.with_linear({name: 5.0, "zero": 0.02})
    write_corrected(path, changed, tmp_path / "c.xml")
    again = load_axis(tmp_path / "c.xml")
    assert dataclasses.astuple(again.chain.servo) == pytest.approx(dataclasses.astuple(changed.chain.servo), abs=1e-12)
    write_corrected(tmp_path / "c.xml", found, tmp_path / "back.xml")
    assert load_axis(tmp_path / "back.xml").chain.servo == found.chain.servo


def test_a_law_that_is_none_of_these_is_refused_in_one_line(tmp_path):
    text = model(PENDULUM).replace('<position name="servo" joint="hinge" kp="8.0" kv="0.3"/>',
                                   '<general name="s" joint="hinge" gainprm="4" biastype="affine" biasprm="0 8 0"/>')  # fmt: skip
    (tmp_path / "m.xml").write_text(text)
    with pytest.raises(InputError, match="pushes away from the command"):
        load_axis(tmp_path / "m.xml")


def test_effects_of_a_servo_have_no_place_on_a_torque_drive():
    bare = Chain((Body("motor", 0.02, 0.05, "j"),), ())
    for name, values in (("servo_deadband", {"half_width_rad": 0.1}), ("velocity_limit", {"limit_rad_s": 1.0})):
        with pytest.raises(NotApplicableError):
            effect_class(name)(**values).ports(bare)
    with pytest.raises(NotApplicableError):
        effect_class("torque_gain_droop")(coefficient_per_Nm2=0.1).ports(axis(Servo(10.0, 0.3)).chain)


@pytest.mark.parametrize("name", [n for n, cls in registered().items() if cls.family == "servo"])
def test_what_a_servo_has_survives_the_round_trip(tmp_path, name):
    path = write(tmp_path / "m.xml", PENDULUM)
    cls = effect_class(name)
    changed = (load_axis(path) + cls(**{s.name: 0.5 for s in cls.specs()})).with_linear({"kp": 6.0, "Jm": 0.03})
    written = write_corrected(path, changed, tmp_path / "c.xml")
    assert load_axis(tmp_path / "c.xml") == changed
    assert len(written.lacks) == (0 if name in ("velocity_limit", "integral_action") else 1)
    write_corrected(tmp_path / "c.xml", load_axis(path), tmp_path / "back.xml")
    assert load_axis(tmp_path / "back.xml") == load_axis(path)


@pytest.mark.parametrize("engine", [accurate.simulate, reference.simulate])
def test_engines_that_know_torques_only_refuse_a_servo(engine):
    with pytest.raises(NotApplicableError, match="servo"):
        engine(axis(Servo(10.0, 0.3)), WAVE, DT)


def test_a_law_over_the_angle_takes_the_steps_that_the_speed_asks_for():
    """Without a known speed 100 rad/s is supposed, which is some thirty times that of this motion."""
    ripple = effect_class("torque_ripple")(amplitude_Nm=0.05, cycles_per_rev=8.0, phase_rad=0.3)
    model, speed = axis(Servo(10.0, 0.3), ripple), 2 * np.pi * 0.7
    work, angles = [], []
    for known in (None, speed):
        before = work_done()
        angles.append(simulate(model, WAVE, DT, speed=known).angle)
        work.append(work_done() - before)
    assert work[1] < 0.25 * work[0]
    assert np.std(angles[1] - angles[0]) < 1e-5 * np.std(angles[0])
