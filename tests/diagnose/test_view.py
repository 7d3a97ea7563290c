"""Judged by force: with the true physics in the model, the torque along the motion is the torque that was commanded."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.problem.choose_view import clean_band
from diagnose.problem.view import ForceView
from mjsim.effects import effect_class
from mjsim.excitation import chirp
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate
from mjsim.recording import Recording

DT = 1e-3


@pytest.mark.parametrize(
    ("effect", "place", "value"),
    [
        ("time_delay", "actuator", {"delay_s": 4.3e-3}),
        ("time_delay", "sensor", {"delay_s": 4.3e-3}),
        ("actuator_lag", "actuator", {"time_constant_s": 4.3e-3}),
        ("sensor_lag", "sensor", {"time_constant_s": 4.3e-3}),
    ],
)
def test_signal_path(effect, place, value):
    """A lag is a lag and no delay of the same length. (What is left is the curvature of the command within a sample.)"""
    axis = load_axis(shipped_model("emps"))
    late = effect_class(effect)(place=place, **value)
    force = chirp(8.0, DT, 60.0, 0.5, 12.0)
    run = simulate(axis + late, force, DT)
    experiment = prepare(Recording(run.time, force, None, run.angle, DT, judge="force"))
    view = ForceView(decimate=1)
    keep = view.counts(experiment)

    def missed(model):
        s = view.signals(model, experiment, None)
        assert s is not None
        return float(np.sqrt(np.mean((s.measured - s.predicted)[keep] ** 2)))

    length = next(iter(value.values()))
    other = {
        "time_delay": ("actuator_lag", "actuator", "time_constant_s"),
        "actuator_lag": ("time_delay", "actuator", "delay_s"),
        "sensor_lag": ("time_delay", "sensor", "delay_s"),
    }[effect]
    rival = effect_class(other[0])(place=other[1], **{other[2]: length})
    assert missed(axis + late) < 0.01 * missed(axis)
    assert missed(axis + late) < 0.5 * missed(axis + rival)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("actuator_deadzone", {"half_width_Nm": 4.0}),
        ("torque_gain_droop", {"coefficient_per_Nm2": 2e-5}),
        ("actuator_saturation", {"limit_Nm": 45.0}),
    ],
)
def test_an_actuator_that_errs(effect, values):
    """With its law in the model the force is explained; without it, it is not."""
    axis = load_axis(shipped_model("emps"))
    erring = axis + effect_class(effect)(place="actuator", **values)
    force = chirp(8.0, DT, 60.0, 0.5, 12.0)
    run = simulate(erring, force, DT)
    experiment = prepare(Recording(run.time, force, None, run.angle, DT, judge="force"))
    view = ForceView(decimate=1)
    keep = view.counts(experiment)

    def missed(model):
        s = view.signals(model, experiment, None)
        assert s is not None
        return float(np.sqrt(np.mean((s.measured - s.predicted)[keep] ** 2)))

    assert missed(erring) < 0.15 * missed(axis)


@pytest.mark.parametrize(
    ("effect", "name", "values"),
    [
        ("actuator_saturation", "limit_Nm", (30.0, 3.0, 0.3)),
        ("actuator_deadzone", "half_width_Nm", (30.0, 80.0, 800.0)),
        ("actuator_lag", "time_constant_s", (0.05, 0.5, 5.0)),
        ("torque_gain_droop", "coefficient_per_Nm2", (1e-5, 1e-4, 2.5e-4)),
    ],
)
def test_an_actuator_that_delivers_nothing_explains_nothing(effect, name, values):
    """On axis 5 of a KUKA KR300 a limit of 0.2 mN m had left the force nothing to be wrong by."""
    axis = load_axis(shipped_model("emps"))
    rng = np.random.default_rng(0)
    force = chirp(8.0, DT, 60.0, 0.5, 12.0)
    run = simulate(axis, force + 20.0 * np.sin(2.0 * np.arange(len(force)) * DT), DT)  # a force that nobody recorded
    experiment = prepare(Recording(run.time, force + rng.standard_normal(len(force)), None, run.angle, DT, judge="force"))
    view = ForceView(decimate=5)
    keep = view.counts(experiment)
    plain = view.signals(axis, experiment, None)
    assert plain is not None
    left = float(np.sqrt(np.mean((plain.measured - plain.predicted)[keep] ** 2)))
    for value in values:
        s = view.signals(axis + effect_class(effect)(place="actuator", **{name: value}), experiment, None)
        assert s is None or float(np.sqrt(np.mean((s.measured - s.predicted)[keep] ** 2))) > 0.9 * left


def test_the_rate_of_an_angle_has_no_offset():
    """On a servo axis a weight had been called an offset of a velocity that nobody measured."""
    axis = load_axis(shipped_model("emps"))
    off = axis + effect_class("sensor_offset")(place="sensor", value=0.05)
    force = chirp(8.0, DT, 60.0, 0.5, 12.0)
    run = simulate(axis, force, DT)
    for angle, velocity in ((run.angle, None), (None, run.velocity + 0.05)):
        experiment = prepare(Recording(run.time, force, velocity, angle, DT, judge="force"))
        view = ForceView(decimate=1)
        keep = view.counts(experiment)
        missed = []
        for model in (axis, off):
            s = view.signals(model, experiment, None)
            assert s is not None
            missed.append(float(np.std(s.measured)) ** -1 * float(np.sqrt(np.mean((s.measured - s.predicted)[keep] ** 2))))
        if velocity is None:
            assert missed[0] == missed[1] < 0.01
        else:
            assert missed[1] < 0.01 < missed[0]


def test_the_band_ends_where_the_encoder_makes_torque_of_its_own():
    axis = load_axis(shipped_model("emps"))
    force = chirp(8.0, DT, 60.0, 0.5, 12.0)
    run = simulate(axis, force, DT)
    fine, coarse = (Recording(run.time, force, None, step * np.round(run.angle / step), DT) for step in (1e-8, 2e-5))
    assert clean_band(axis, fine) == pytest.approx(0.1 / DT)
    assert 12.0 < clean_band(axis, coarse) < 60.0
