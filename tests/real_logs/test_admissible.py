"""Numbers that a recording cannot show are no finding: each effect declares its ranges, and they are checked before naming."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.data.scales import reversals
from diagnose.fit.least_squares import Status
from diagnose.problem.view import MotionView
from diagnose.verdict.determined import determined
from mjsim.effects import Scales, effect_class, registered

SCALES = Scales(
    torque=1.0, max_torque=3.0, velocity=2.0, max_velocity=6.0, deflection=1e-3, inertia=0.02, stiffness=1e3, travel=4.0,
    input=1.0, max_input=3.0, output=2.0, dt=1e-3, duration=10.0, turns=(2.0, 3.0), steps=(0.6,), move=0.5,
    acceleration=20.0,
)  # fmt: skip


def broken(name, scales=SCALES, place="", **values):
    return [r.what for r in effect_class(name)(place=place, **values).admissible(scales) if not r.holds]


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("sensor_quantisation", {"step": 0.6}, {"step": 21.0}),
        ("friction_drift", {"time_constant_s": 3.0}, {"time_constant_s": 0.08}),
        ("friction_drift", {"relative_change": 1.5}, {"relative_change": 72.0}),
        ("friction_drift", {"relative_change": -0.5}, {"relative_change": -0.95}),
        ("asymmetric_friction", {"asymmetry_Nm": -0.2}, {"asymmetry_Nm": 0.7}),
        ("torque_ripple", {"cycles_per_rev": 2 * math.pi / 4.0 * 1.05}, {"cycles_per_rev": 0.001}),
        ("torque_ripple", {"cycles_per_rev": 1000.0}, {"cycles_per_rev": 2000.0}),
        ("position_dependent_friction", {"cycles_per_rev": 4.0}, {"cycles_per_rev": 1.2}),
        ("presliding_friction", {"stiffness_Nm_rad": 1.0}, {"stiffness_Nm_rad": 0.01}),
        ("stribeck_friction", {"stribeck_velocity_rad_s": 5.0}, {"stribeck_velocity_rad_s": 50.0}),
        ("backlash", {"gap_rad": 0.1}, {"gap_rad": 5.0}),
        ("torque_speed_limit", {"no_load_speed_rad_s": 2.1}, {"no_load_speed_rad_s": 1.9}),
        ("load_dependent_friction", {"coefficient": 0.02}, {"coefficient": 0.002}),
        ("load_dependent_friction_with_constant_part", {"coefficient": 0.02}, {"coefficient": 0.002}),
        ("load_dependent_friction_with_creep", {"coefficient": 0.02}, {"coefficient": 0.002}),
        ("time_delay", {"delay_s": 0.02}, {"delay_s": 0.8}),
        ("actuator_lag", {"time_constant_s": 0.05}, {"time_constant_s": 4.0}),
        ("torque_gain_droop", {"coefficient_per_Nm2": 0.05}, {"coefficient_per_Nm2": 724.0}),
        ("actuator_saturation", {"limit_Nm": 2.0}, {"limit_Nm": 5.0}),
        ("extra_flexible_mode", {"stiffness_Nm_rad": 100.0}, {"stiffness_Nm_rad": 1e6}),
    ],
)
def test_a_number_beyond_what_the_recording_shows_is_told(name, good, bad):
    values = {s.name: 0.5 for s in effect_class(name).specs()}
    if name == "friction_drift":
        values["time_constant_s"] = 3.0
    if name == "extra_flexible_mode":
        values["inertia_kgm2"] = 0.01
    assert broken(name, **{**values, **good}) == []
    assert len(broken(name, **{**values, **bad})) == 1


@pytest.mark.parametrize(
    ("name", "number"), [("time_delay", "delay_s"), ("actuator_lag", "time_constant_s"), ("sensor_lag", "time_constant_s")]
)
def test_what_an_unstated_input_leaves_open_is_no_delay(name, number):
    place = "sensor" if name == "sensor_lag" else "actuator"
    assert broken(name, place=place, **{number: 0.2 * SCALES.dt}) == []
    unknown = dataclasses.replace(SCALES, hold_stated=False)
    assert len(broken(name, unknown, place=place, **{number: 0.2 * SCALES.dt})) == 1
    assert broken(name, unknown, place=place, **{number: 0.3 * SCALES.dt}) == []


def test_half_a_period_of_a_whole_order_is_enough():
    scales = dataclasses.replace(SCALES, travel=0.6 * math.pi, turns=(2.0, 3.0))
    assert broken("torque_ripple", scales, amplitude_Nm=0.1, cycles_per_rev=2.0, phase_rad=0.0) == []
    assert broken("torque_ripple", scales, amplitude_Nm=0.1, cycles_per_rev=2.4, phase_rad=0.0) == ["spatial frequency"]


def test_a_step_needs_samples_that_come_in_steps():
    scales = dataclasses.replace(SCALES, steps=())
    assert broken("sensor_quantisation", scales, step=0.6) == ["step"]
    assert broken("sensor_quantisation", step=0.7) == []


def test_every_effect_is_admissible_at_a_start_of_a_fit():
    for cls in registered().values():
        for place in cls.places:
            effects = [cls(place=place, **v) for v in cls.starts(SCALES)]
            assert any(all(r.holds for r in e.admissible(SCALES)) for e in effects), f"{cls.id}@{place}"


def test_reversals_are_counted_beyond_the_noise():
    rng = np.random.default_rng(0)
    t = np.arange(5000) / 500
    assert reversals(np.sin(2 * np.pi * 0.5 * t + 0.3) + 0.02 * rng.standard_normal(len(t))) == 10
    assert reversals(2.0 + 0.1 * rng.standard_normal(1000)) == 0


class _Search:
    """A search whose best structure is a ripple of a thousandth of a turn; without it nothing is left to name."""

    def __init__(self, ripple, rivals=()):
        self.fitter = SimpleNamespace(
            scales=dict.fromkeys(("motor",), SCALES),
            view=MotionView(),
            experiments=(SimpleNamespace(recording=SimpleNamespace(dt=SCALES.dt)),),
            scales_for=lambda cls, place: SCALES,
            refined=lambda f: f,
            noise=None,
            map=lambda tasks: [t() for t in tasks],
        )
        bare = self.fitted(())
        self.pruning = SimpleNamespace(
            without=lambda best, effect: bare, simplified=lambda best, effect: [], limits=lambda *_: []
        )
        self.options, self.nominal = SimpleNamespace(width=10), lambda: bare
        self.tested = 1
        self.context = SimpleNamespace(
            gain=lambda before, after: before.chi2 - after.chi2, compared=lambda *_: SimpleNamespace(p_value=0.001)
        )
        self.state = SimpleNamespace(admitted=lambda ids: True)
        self.fits = {f.key: f for f in (self.fitted((ripple,), 10.0), *rivals)}
        self.significance = SimpleNamespace(significant=lambda before, after: after.chi2 < 40.0)

    @staticmethod
    def fitted(effects, chi2=100.0):
        hypothesis = SimpleNamespace(entries=(), size=0, bounds=(np.zeros(0), np.zeros(0)))
        fit = SimpleNamespace(x=np.zeros(0), status=Status.CONVERGED)
        return SimpleNamespace(
            effects=effects, key=tuple(e.key for e in effects), chi2=chi2, n=100, ok=True, hypothesis=hypothesis, fit=fit,
            axis=SimpleNamespace(chain=SimpleNamespace(servo=None)),
            standard_errors=lambda noise: np.zeros(0),
        )  # fmt: skip

    def criterion(self, f):
        return f.chi2

    def polish(self, f):
        return f

    def nominal(self):
        return self.fitted(())


def test_what_cannot_be_shown_gives_way_to_a_significant_rival_or_to_nothing():
    ripple = effect_class("torque_ripple")(amplitude_Nm=0.1, cycles_per_rev=0.001, phase_rad=0.0)
    friction = effect_class("coulomb_friction")(torque_Nm=0.1)
    best = _Search.fitted((ripple,), 10.0)
    left, said = determined(_Search(ripple), best)
    assert left.effects == ()
    assert said[0].startswith(
        "Torque ripple at the motor is not named: its spatial frequency of 0.001 lies outside 1.57 to 1.57e+03"
    )
    assert said[0].endswith("it is left out.")
    for chi2, names in ((30.0, ("coulomb_friction@motor",)), (50.0, ())):
        rival = _Search.fitted((friction,), chi2)
        left, _ = determined(_Search(ripple, (rival,)), best)
        assert left.key == names
