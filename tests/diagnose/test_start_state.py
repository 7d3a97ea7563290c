"""Recordings that start in motion: each has its own start, in the fit, on held-out recordings and in MuJoCo."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from click.testing import CliRunner

import simgap
from diagnose.data.experiment import prepare
from diagnose.data.split import split
from diagnose.fit.fitter import Fitter
from diagnose.problem.view import MotionView
from diagnose.thresholds import SIGMAS
from diagnose.verdict.reference import cases_of, chi_square, noise_level
from diagnose.verdict.reference_runs import run_files, starts_of
from mjsim.axis import Axis, Body, Chain
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from mjsim.plant import ChainPlant, MujocoPlant, Start
from mjsim.recording import Recording
from simgap.cli import cli

HUB, LINK, STIFFNESS, DAMPING, VISCOUS = 1.0e-3, 1.5e-3, 0.5, 1e-3, 0.02  # SI, a ruler on a motor
DT, NOISE = 4e-3, 0.02
RIGID = Axis(Chain((Body("arm", HUB + LINK, VISCOUS, "hub"),), ()))


def stepped(rate, x, t, dt, parts=10):
    """States (N, s) at the times t (N,), by RK4 with ``parts`` steps a sample."""
    out, h = [], dt / parts
    for i in range(len(t)):
        out.append(x)
        for _ in range(parts):
            a = rate(x, i)
            b = rate(x + h / 2 * a, i)
            c = rate(x + h / 2 * b, i)
            d = rate(x + h * c, i)
            x = x + h / 6 * (a + 2 * b + 2 * c + d)
    return np.array(out)


def flexible_log(skip, seed=0, seconds=2.0):
    """A chirp on hub and link from rest, of which the first ``skip`` seconds are cut off."""
    t = DT * np.arange(round((seconds + skip) / DT))
    u = 0.05 * np.sin(2 * math.pi * (0.5 * t + 1.2 * t**2))

    def rate(x, i):
        torque = STIFFNESS * (x[0] - x[1]) + DAMPING * (x[2] - x[3])
        return np.array([x[2], x[3], (u[i] - VISCOUS * x[2] - torque) / HUB, torque / LINK])

    x = stepped(rate, np.zeros(4), t, DT)
    first = round(skip / DT)
    v = x[first:, 2] + NOISE * np.random.default_rng(seed).standard_normal(len(t) - first)
    return Recording(t[: len(v)], u[first:].copy(), v, None, DT, source=f"log{seed}.csv"), x[first]


def test_a_flexible_link_is_found_in_a_log_that_is_cut_in_two():
    """The mode, a quarter off at first, comes to the noise and to 2 % of the truth, and to the noise of a held-out log."""
    (fitted, x), (other, _) = flexible_log(0.5), flexible_log(0.8, seed=1, seconds=1.5)
    estimation, held_out = split([fitted], [other])
    fitter = Fitter(RIGID, MotionView.of(RIGID, [fitted, other]), estimation, held_out, jobs=1)
    mode = effect_class("extra_flexible_mode")(
        place="arm", inertia_kgm2=0.8 * LINK, stiffness_Nm_rad=0.75 * STIFFNESS, damping_Nms_rad=2e-3
    )
    f = fitter.fit(fitter.hypothesis((mode,)))
    (found,) = f.effects
    assert f.chi2 <= noise_level(f.n)
    assert found.stiffness_Nm_rad == pytest.approx(STIFFNESS, rel=0.02)
    assert found.inertia_kgm2 == pytest.approx(LINK, rel=0.02)
    angles, speeds = f.hypothesis.initial(f.fit.x, 0)
    assert angles[0] - angles[1] == pytest.approx(x[0] - x[1], abs=0.002)
    assert speeds == pytest.approx(x[2:], abs=NOISE)
    held = fitter.validate(f)
    assert held.chi2 <= noise_level(int(np.sum(held.n)))


def test_a_log_from_rest_has_no_free_start_and_a_hidden_motion_is_seen():
    assert not prepare(flexible_log(0.0)[0]).moving
    log, _ = flexible_log(0.0, seconds=4.0)
    turn = 100 + int(np.argmin(np.abs(log.velocity[100:500])))  # the hub stands, and the torque that acts there bends the link
    cut = log.slice(turn, turn + 400)
    assert abs(cut.velocity[0]) < NOISE
    assert prepare(cut).moving


PENDULUM = """<mujoco><option timestep="0.002" integrator="RK4" gravity="0 0 -9.81"/><worldbody><body>
  <joint name="pivot" type="hinge" axis="0 1 0" damping="0.004"/>
  <inertial pos="0 0 -0.09" mass="0.77" diaginertia="0.001 0.001 0.001"/></body></worldbody></mujoco>"""


def swing(seed):
    """A free pendulum from mid swing, its angle alone recorded, with 3 mrad of noise and 100 Hz; its first angle and speed."""
    t, inertia = 0.01 * np.arange(500), 0.001 + 0.77 * 0.09**2

    def rate(x, _):
        return np.array([x[1], (-0.004 * x[1] - 0.77 * 9.81 * 0.09 * math.sin(x[0])) / inertia])

    x = stepped(rate, np.array([0.3, -5.0]), t, 0.01)
    q = x[:, 0] + 3e-3 * np.random.default_rng(seed).standard_normal(len(t))
    return Recording(t, np.zeros(len(t)), None, q, 0.01, source=f"swing{seed}.csv", driven=False)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_swing_that_starts_from_a_noisy_angle(seed, tmp_path):
    """MuJoCo's run is at the noise from a start within four standard errors of the truth, which the first samples do not tell."""
    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM, encoding="utf-8")
    cases = cases_of([swing(seed)], [])
    (start,) = starts_of(load_axis(path), cases)
    deviation = 3e-3 * math.sqrt(2.0 * 2.0 / 500)  # of an amplitude by so many samples, twice for there being a phase
    assert start.angle == pytest.approx(0.3, abs=SIGMAS * 3e-3)
    assert start.velocity == pytest.approx(-5.0, abs=SIGMAS * 10.0 * 10 * deviation)
    runs = run_files([MujocoPlant.load(path)], cases, 1)[0]
    for part in ("estimation", "held_out"):
        chi2, n = chi_square(cases, runs, part)
        assert chi2 <= noise_level(n)


def test_the_phase_of_gravity_does_not_follow_the_noise_of_the_first_angle(tmp_path):
    """A first angle that is 10 mrad off, over three times its noise, moves the phase by less than a tenth of that.

    And the phase, zero in truth, is known by the mean of the 500 angles, whose standard error is .13 mrad.
    """
    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM, encoding="utf-8")
    axis, phases = load_axis(path), []
    for off in (0.0, 0.01):
        r = swing(1)
        r.angle.flags.writeable = True
        r.angle[0] += off
        (experiment,) = (prepare(r),)
        fitter = Fitter(axis, MotionView.of(axis, [r]), (experiment,), (experiment,), jobs=1)
        f = fitter.fit(fitter.hypothesis(()))
        phases.append(f.carried[0].values["phase_rad"])
    assert abs(phases[1] - phases[0]) < 0.001
    assert abs(phases[0]) < SIGMAS * 2.0 * 3e-3 / math.sqrt(500)


def test_a_replay_starts_in_the_state_that_suits_the_recording(tmp_path):
    """It follows a swing to its noise, in the channel that was recorded, and tells where it started."""
    model, path, r = tmp_path / "pendulum.xml", tmp_path / "swing.csv", swing(1)
    model.write_text(PENDULUM, encoding="utf-8")
    np.savetxt(path, np.column_stack([r.time, r.angle]), delimiter=",", header="time_s,angle_rad", comments="")
    result = CliRunner().invoke(cli, ["replay", str(model), str(path), "--out", str(tmp_path / "out.csv"), "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.output)
    assert told["channel"] == "angle"
    assert told["rms"] <= 1.1 * 3e-3
    assert told["start"]["velocity"] == pytest.approx(-5.0, abs=0.05)
    recorded = CliRunner().invoke(
        cli, ["replay", str(model), str(path), "--out", str(tmp_path / "out.csv"), "--start", "recorded", "--json"]
    )
    assert json.loads(recorded.output)["rms"] > told["rms"]


TWO = """<mujoco><option timestep="0.001" integrator="RK4"/><worldbody><body>
  <joint name="hub" type="hinge" axis="0 0 1" damping="0.02"/><inertial pos="0 0 0" mass="1" diaginertia="0.001 0.001 0.001"/>
  <body><joint name="link" type="hinge" axis="0 0 1" stiffness="0.5" damping="0.001"/>
    <inertial pos="0 0 0" mass="1" diaginertia="0.0015 0.0015 0.0015"/></body></body></worldbody>
  <actuator><motor name="drive" joint="hub"/></actuator></mujoco>"""


def test_both_plants_start_from_a_deflection(tmp_path):
    path = tmp_path / "two.xml"
    path.write_text(TWO, encoding="utf-8")
    start = Start(0.2, -0.5, deflections=(0.05,), rates=(1.5,))
    u = np.zeros((300, 1))
    literal, analytic = (plant.run(u, DT, start=start) for plant in (MujocoPlant.load(path), ChainPlant(load_axis(path))))
    assert np.ptp(literal[:, 0]) > 1.0
    np.testing.assert_allclose(literal, analytic, atol=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_a_response_that_begins_late_starts_from_rest(seed):
    """No parabola through ten samples, of which six are at rest, has their speed at the first."""
    t = 0.006 * np.arange(300)
    speed = np.where(t > 0.037, 8.0 * (1 - np.exp(-8.0 * (t - 0.037))), 0.0) + 0.02 * np.random.default_rng(seed).standard_normal(
        300
    )
    torque = 0.5 + 0.1 * np.sin(5 * t)
    r = simgap.load({"time_s": t, "torque_Nm": torque, "velocity_rad_s": speed})
    assert not prepare(r).moving
    assert prepare(dataclasses.replace(r, velocity=speed + 2.0)).moving
