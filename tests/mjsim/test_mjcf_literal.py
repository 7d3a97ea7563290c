"""The literal model in plain MuJoCo against the analytic ODE, and warnings as errors."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
from robot_axis import DT, chirp

from mjsim.axis import Axis
from mjsim.effects import BacklashLaw, effect_class
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.models import shipped_model
from mjsim.mujoco_run import lacking, run_literal, run_signals
from mjsim.ode import DivergedError, simulate


def relative(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2)))


@pytest.fixture(scope="module")
def nominal() -> Path:
    return shipped_model("robot_axis1")


@pytest.fixture(scope="module")
def torque() -> np.ndarray:
    return chirp()


def test_the_nominal_model_is_within_1e_5_of_the_ode_at_half_a_millisecond(nominal):
    torque = chirp(2.0)
    model = load_model(nominal)
    assert model.mjmodel.opt.timestep == 5e-4
    run, ode = run_literal(model, torque, DT), simulate(model.axis, torque, DT, substeps=8)
    assert relative(run.velocity, ode.velocity) <= 1e-5
    assert relative(run.q[:, 2], ode.q[:, 2]) <= 1e-5
    assert relative(run.coupling_torque[:, 0], ode.coupling_torque[:, 0]) <= 1e-4
    assert relative(run.coupling_torque[:, 1], ode.coupling_torque[:, 1]) <= 1e-4


def test_plain_mj_step_gives_the_same_motion(nominal, torque):
    model = mujoco.MjModel.from_xml_path(str(nominal))
    data = mujoco.MjData(model)
    velocity = []
    for u in torque[:400]:
        velocity.append(data.qvel[0])
        data.ctrl[0] = u
        mujoco.mj_step(model, data)
    assert run_literal(nominal, torque[:400], DT).velocity == pytest.approx(velocity, abs=1e-12)


def test_the_arm_sensor_reads_the_absolute_angle(nominal, torque):
    model = mujoco.MjModel.from_xml_path(str(nominal))
    data = mujoco.MjData(model)
    for u in torque[:400]:
        data.ctrl[0] = u
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    expected = simulate(load_axis(nominal), torque[:401], DT).q[400, 2]
    assert data.sensor("arm_angle").data[0] == pytest.approx(expected, rel=1e-3)


# effect, parameters, tolerance of plain MuJoCo at the step that write_corrected chooses (measured, with a factor of about two)
NATIVE = [
    ("actuator_lag", "actuator", {"time_constant_s": 0.004}, 3e-5),
    ("actuator_saturation", "actuator", {"limit_Nm": 0.6}, 2e-5),
    ("asymmetric_friction", "motor", {"torque_Nm": 0.1, "asymmetry_Nm": 0.03}, 1e-3),
    ("backlash", "gearbox", {"gap_rad": 5e-4}, 1e-3),
    ("backlash", "arm", {"gap_rad": 5e-4}, 2e-3),
    ("coulomb_friction", "motor", {"torque_Nm": 0.1}, 1e-3),
    ("coulomb_friction", "gearbox", {"torque_Nm": 10.0}, 1e-3),
    ("coulomb_friction", "arm", {"torque_Nm": 10.0}, 3e-3),
    ("extra_flexible_mode", "arm", {"inertia_kgm2": 0.5, "stiffness_Nm_rad": 2842.0, "damping_Nms_rad": 2.0}, 2e-5),
    ("hardening_stiffness", "gearbox", {"coefficient_Nm_rad3": 1e11}, 2e-5),
    ("hardening_stiffness", "arm", {"coefficient_Nm_rad3": 1e11}, 2e-5),
    ("hysteresis", "gearbox", {"torque_Nm": 20.0, "stiffness_Nm_rad": 2e4}, 2e-3),
    ("presliding_friction", "motor", {"torque_Nm": 0.1, "stiffness_Nm_rad": 2.0}, 1e-3),
    ("presliding_friction_with_damping", "motor", {"torque_Nm": 0.1, "stiffness_Nm_rad": 2.0, "damping_Nms_rad": 0.01}, 1e-3),
    (
        "stribeck_friction_with_bristles",
        "motor",
        {
            "torque_Nm": 0.1,
            "extra_static_torque_Nm": 0.05,
            "stribeck_velocity_rad_s": 2.0,
            "stiffness_Nm_rad": 5.0,
            "damping_Nms_rad": 0.02,
        },
        2e-3,
    ),
    ("quadratic_friction", "motor", {"coefficient_Nm_s2_rad2": 1e-3}, 2e-5),
    ("time_delay", "actuator", {"delay_s": 0.003}, 3e-3),
    ("time_delay", "sensor", {"delay_s": 0.003}, 2e-5),
    ("torque_offset", "motor", {"torque_Nm": 0.05}, 2e-5),
    ("torque_ripple", "motor", {"amplitude_Nm": 0.05, "cycles_per_rev": 8.0, "phase_rad": 0.4}, 2e-5),
]


@pytest.mark.parametrize(("name", "place", "values", "tolerance"), NATIVE)
def test_what_is_written_natively_acts_natively(tmp_path, nominal, name, place, values, tolerance):
    u = chirp(0.6)
    chain = load_axis(nominal).chain
    axis = Axis(chain, (effect_class(name)(place=place, **values),), BacklashLaw.UNGATED)
    assert write_corrected(nominal, axis, tmp_path / "corrected.xml").lacks == ()
    model = load_model(tmp_path / "corrected.xml")
    run = run_literal(model, u, DT)
    ode = simulate(axis, u, DT)
    assert relative(run.velocity, ode.velocity) <= tolerance
    assert relative(ode.velocity, simulate(Axis(chain), u, DT).velocity) > 20 * tolerance  # it is not a trifle
    assert lacking(model) == ()


@pytest.mark.slow
@pytest.mark.parametrize(("level", "bar"), [(0.0355, 5e-4), (0.1, 5e-4), (0.355, 1e-3)])
def test_literal_frictionloss_at_50_microseconds(tmp_path, nominal, torque, level, bar):
    axis = load_axis(nominal) + effect_class("coulomb_friction")(torque_Nm=level)
    write_corrected(nominal, axis, tmp_path / "corrected.xml")
    text = (
        (tmp_path / "corrected.xml")
        .read_text()
        .replace('timestep="0.0001"', 'timestep="5e-05"')
        .replace("-1 -25000", "-1 -50000")
    )
    (tmp_path / "fine.xml").write_text(text)
    assert relative(run_literal(tmp_path / "fine.xml", torque, DT).velocity, simulate(axis, torque, DT).velocity) <= bar


@pytest.mark.slow
@pytest.mark.parametrize("gap", [1e-4, 5e-4, 1e-3])
def test_literal_slack_joint_against_its_own_law(tmp_path, nominal, torque, gap):
    axis = Axis(load_axis(nominal).chain, (effect_class("backlash")(gap_rad=gap),), BacklashLaw.UNGATED)
    write_corrected(nominal, axis, tmp_path / "corrected.xml")
    assert relative(run_literal(tmp_path / "corrected.xml", torque, DT).velocity, simulate(axis, torque, DT).velocity) <= 1e-3


SIGNAL = [
    ("actuator_deadzone", "actuator", {"half_width_Nm": 0.1}),
    ("torque_gain_droop", "actuator", {"coefficient_per_Nm2": 0.1}),
    ("sensor_lag", "sensor", {"time_constant_s": 0.002}),
    ("sensor_offset", "sensor", {"value": 0.5}),
]


@pytest.mark.parametrize(("name", "place", "values"), SIGNAL)
def test_signal_effects_are_laid_around_plain_mujoco(tmp_path, nominal, torque, name, place, values):
    axis = load_axis(nominal) + effect_class(name)(place=place, **values)
    written = write_corrected(nominal, axis, tmp_path / "corrected.xml")
    assert len(written.lacks) == 1  # the file lacks it ...
    model = load_model(tmp_path / "corrected.xml")
    assert lacking(model) == ()  # ... and the run does not
    assert relative(run_signals(model, torque[:1500], DT).velocity, simulate(axis, torque[:1500], DT).velocity) <= 2e-5


@pytest.mark.slow
def test_scaling_torque_and_gap_together_scales_the_motion(tmp_path, nominal, torque):
    runs = []
    for scale in (1.0, 0.2):
        axis = Axis(load_axis(nominal).chain, (effect_class("backlash")(gap_rad=5e-4 * scale),), BacklashLaw.UNGATED)
        write_corrected(nominal, axis, tmp_path / "corrected.xml")
        runs.append(run_literal(tmp_path / "corrected.xml", scale * torque[:4000], DT).velocity / scale)
    assert relative(*runs) <= 1e-9


def test_motion_at_the_start_and_torque_before_it(tmp_path, nominal, torque):
    axis = load_axis(nominal) + effect_class("actuator_lag")(time_constant_s=0.01)
    write_corrected(nominal, axis, tmp_path / "corrected.xml")
    ratios = np.array([1.0, 1 / 118, 1 / 118])
    initial = np.array([0.3 * ratios, 5.0 * ratios])
    run = run_literal(tmp_path / "corrected.xml", torque[:1500], DT, initial=initial, before=0.7)
    ode = simulate(axis, torque[:1500], DT, initial=initial, before=0.7)
    assert relative(run.velocity, ode.velocity) <= 3e-5
    assert run.q[0] == pytest.approx(initial[0])


def test_a_run_is_the_same_whatever_is_kept_in_memory_at_once(nominal, torque, monkeypatch):
    whole = run_literal(nominal, torque[:1000], DT)
    monkeypatch.setattr("mjsim.mujoco_run._CHUNK", 77)
    pieces = run_literal(nominal, torque[:1000], DT)
    assert relative(pieces.velocity, whole.velocity) <= 1e-12


def test_a_step_that_is_too_large_is_an_error_that_names_it(tmp_path, nominal, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    unstable = nominal.read_text().replace('timestep="0.0005"', 'timestep="0.05"')
    (tmp_path / "unstable.xml").write_text(unstable)
    with pytest.raises(DivergedError, match=r"unstable.xml: MuJoCo stopped at 0\.\d+ s at joint .*smaller timestep than 0.05 s"):
        run_literal("unstable.xml", np.ones(2000), 0.05)
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert capfd.readouterr() == ("", "")


def test_the_timestep_of_the_model_is_left_as_it_was(nominal):
    model = load_model(nominal)
    run_literal(model, np.ones(5), 7e-4)
    assert model.mjmodel.opt.timestep == 5e-4


def test_the_slide_runs_too():
    model = load_model(shipped_model("emps"))
    u = 50 * np.sin(np.arange(2000) * 0.01)
    assert relative(run_literal(model, u, 1e-3).velocity, simulate(model.axis, u, 1e-3).velocity) <= 1e-9
    trajectory = run_literal(model, u, 1e-3)
    assert dataclasses.is_dataclass(trajectory)
    assert trajectory.coupling_torque.shape == (2000, 0)
