"""A hypothesis as a vector and back: every number finds its place, whatever the effects, the recordings and the values."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diagnose.data.experiment import prepare
from diagnose.data.scales import PLACES, scales_by_place
from diagnose.problem.hypothesis import Entry, Hypothesis, make
from diagnose.problem.start_state import Begin
from mjsim.effects import NotApplicableError, registered
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.quantity import Quantity

AXIS = load_axis(shipped_model("robot_axis1"))
CHOICES = [(n, p) for n, c in registered().items() for p in c.places]


@pytest.fixture(scope="module")
def scales(record):
    return scales_by_place(AXIS, prepare(record(seconds=1.0)), (1.0,))


def lay_out(scales, chosen, recordings=1, moving=False, varies=()):
    effects = tuple(
        make(n, p, registered()[n].starts(dataclasses.replace(scales[p], orders=(1.0,), stops=None))[0])
        for n, p in dict.fromkeys(chosen)
    )
    return Hypothesis.build(
        AXIS, effects, scales, recordings, (Begin(True, 0.3, 1e-4) if moving else Begin(False),) * recordings, varies=varies
    )


@settings(max_examples=80, deadline=None)
@given(chosen=st.lists(st.sampled_from(CHOICES), max_size=3, unique=True), recordings=st.integers(1, 3), moving=st.booleans(),
       seed=st.integers(0, 10**6))  # fmt: skip
def test_vector_to_axis_and_back(scales, chosen, recordings, moving, seed):
    h = lay_out(scales, chosen, recordings, moving)
    lower, upper = h.bounds
    rng = np.random.default_rng(seed)
    x = np.clip(h.start + rng.normal(0, 0.3, len(h.start)), lower, upper)
    assert len(h.entries) == len(lower) == len({e.label for e in h.entries})
    values = h.values(x)
    for r in range(recordings):
        axis = h.axis(x, r)
        back = {p.name: p.value for p in axis.chain.linear_parameters()}
        for name, value in back.items():
            assert value == pytest.approx(values["", name, -1])
        for e in axis.effects:
            for name, value in e.values.items():
                owner = (e.key, name, r) if (e.key, name, r) in values else (e.key, name, -1)
                assert value == pytest.approx(values[owner])
        assert (h.initial(x, r) is not None) == moving
    for e, v in zip(h.entries, x, strict=True):
        assert e.scaled(e.si(float(v))) == pytest.approx(float(v), rel=1e-9, abs=1e-12)


@settings(max_examples=30, deadline=None)
@given(chosen=st.lists(st.sampled_from(CHOICES), max_size=2, unique=True))
def test_the_slope_of_an_entry_is_its_derivative(scales, chosen):
    h = lay_out(scales, chosen)
    for e, x in zip(h.entries, h.start, strict=True):
        step = 1e-6
        assert e.slope(float(x)) == pytest.approx((e.si(float(x) + step) - e.si(float(x) - step)) / (2 * step), rel=1e-6)


def test_the_start_is_the_nominal_axis(scales):
    h = lay_out(scales, ())
    assert h.axis(h.start) == AXIS
    assert h.initial(h.start, 0) is None


def test_phases_and_named_parameters_belong_to_each_recording(scales):
    h = lay_out(scales, [("torque_ripple", "motor")], recordings=2, varies=("Jm",))
    labels = [e.label for e in h.entries]
    assert {"Jm#0", "Jm#1", "torque_ripple@motor.phase_rad#0", "torque_ripple@motor.phase_rad#1"} <= set(labels)
    assert "torque_ripple@motor.amplitude_Nm" in labels
    x = h.start.copy()
    x[labels.index("Jm#1")] += 0.1
    assert h.axis(x, 0).chain.bodies[0].inertia == AXIS.chain.bodies[0].inertia
    assert h.axis(x, 1).chain.bodies[0].inertia > AXIS.chain.bodies[0].inertia


def test_a_recording_in_motion_starts_with_the_whole_chain_in_motion(scales):
    h = lay_out(scales, (), moving=True)
    angles, speeds = h.initial(h.start, 0)
    assert speeds[0] == pytest.approx(0.3)
    np.testing.assert_allclose(speeds, speeds[0] * np.array([1, 1 / 118, 1 / 118]))
    assert not angles.any()


def test_each_further_body_starts_with_a_deflection_and_a_rate_of_its_own(scales):
    h = lay_out(scales, [("extra_flexible_mode", "arm")], moving=True)
    labels = [e.label for e in h.entries]
    x = h.start.copy()
    for name, value in (("deflection2", 0.01), ("deflection_rate3", 0.2)):
        i = labels.index(f"initial_{name}#0")
        x[i] = h.entries[i].scaled(value)
    angles, speeds = h.initial(x, 0)
    np.testing.assert_allclose(angles, [0, 0, -0.01, -0.01])
    np.testing.assert_allclose(speeds, [0.3, 0.3 / 118, 0.3 / 118, 0.3 / 118 - 0.2])


def test_numbers_of_a_start_are_no_part_of_a_structure_and_have_a_prior(scales):
    rest, moving = (lay_out(scales, [("extra_flexible_mode", "arm")], moving=m) for m in (False, True))
    assert moving.size == rest.size == len(rest.entries)
    assert moving.start_numbers == 7  # the speed, and two of each of three couplings
    assert moving.prior_terms[0] == rest.prior_terms[0]  # residuals of all structures have one length
    assert len(moving.prior_terms[1]) == len(rest.prior_terms[1]) + 6


def test_the_start_angle_is_free_where_a_torque_depends_on_it(scales):
    free = [
        {e.name for e in lay_out(scales, chosen, moving=True).entries if e.of_start} for chosen in ([], [("gravity_load", "arm")])
    ]
    assert "initial_angle" not in free[0]
    assert "initial_angle" in free[1]


def test_effects_without_a_place_are_seen():
    emps = load_axis(shipped_model("emps"))
    backlash = make("backlash", "gearbox", {"gap_rad": 1e-4})
    with pytest.raises(NotApplicableError):
        backlash.ports(emps.chain)
    assert set(PLACES) == {"motor", "gearbox", "arm", "actuator", "sensor"}


def test_start_values_are_clipped_into_their_bounds():
    assert make("coulomb_friction", "motor", {"torque_Nm": -1.0}).values == {"torque_Nm": 0.0}


def test_what_is_over_at_the_start_of_a_recording_is_no_drift(scales):
    drift = make("friction_drift", "motor", {"torque_Nm": 0.1, "relative_change": 0.5, "time_constant_s": 1e-3})
    h = Hypothesis.build(AXIS, (drift,), scales, 1, (Begin(False),))
    entry = next(e for e in h.entries if e.name == "time_constant_s")
    assert entry.lower == entry.start == pytest.approx(0.02 * scales["motor"].duration)


def test_a_number_at_its_bound_is_within_it():
    """A sharpness of 30 came back as 30.000000000000004, which the law refuses: a case ended with an error."""
    for scale in np.geomspace(0.3, 70.0, 400):
        entry = Entry("", "sharpness", Quantity.RATIO, float(scale), 1.0, 30.0, 5.0, log=True)
        assert entry.si(entry.scaled(30.0)) == 30.0
        assert entry.si(entry.scaled(1.0)) == 1.0
        assert entry.si(entry.scaled(5.0)) == pytest.approx(5.0)
