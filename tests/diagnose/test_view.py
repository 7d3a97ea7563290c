"""Judged by force: with the true physics in the model, the torque along the motion is the torque that was commanded."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.experiment import prepare
from diagnose.view import ForceView, clean_band
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


def test_the_band_ends_where_the_encoder_makes_torque_of_its_own():
    axis = load_axis(shipped_model("emps"))
    force = chirp(8.0, DT, 60.0, 0.5, 12.0)
    run = simulate(axis, force, DT)
    fine, coarse = (Recording(run.time, force, None, step * np.round(run.angle / step), DT) for step in (1e-8, 2e-5))
    assert clean_band(axis, fine) == pytest.approx(0.1 / DT)
    assert 12.0 < clean_band(axis, coarse) < 60.0
