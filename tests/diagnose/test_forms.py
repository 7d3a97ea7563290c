"""Another law for the same effect: it is sought where the contract's own leaves something, and named by the contract's name."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.data.experiment import prepare
from diagnose.data.scales import scales_by_place
from diagnose.fit.fitter import Fitter
from diagnose.pipeline import Options, diagnose
from diagnose.problem.hypothesis import make
from diagnose.problem.view import MotionView
from diagnose.result import Verdict
from diagnose.structure.budget import SearchOptions
from diagnose.structure.candidates import Candidate
from diagnose.structure.search import Search
from diagnose.verdict.findings import merged
from lab.benchmark.catalogue import compose, find
from lab.benchmark.experiment import chirp as sealed_chirp
from lab.benchmark.laws import GAP_IMPACT, Laws
from mjsim.effects import Effect, effect_class, registered
from mjsim.excitation import chirp
from mjsim.ode import simulate
from mjsim.recording import Recording

DT, N = 1e-3, 8_000
LUGRE = {"torque_Nm": 0.1, "stiffness_Nm_rad": 1.0, "damping_Nms_rad": 0.01}


def two_chirps(plant, seed, noise, low, *chirps, n=N):
    """A recording for each (amplitude [N m], highest frequency [Hz]), from ``low`` [Hz]; noise in rad/s and 1e-4 rad."""
    rng = np.random.default_rng(seed)
    out = []
    for amplitude, top in chirps:
        torque = chirp(n * DT, DT, amplitude, low, top)
        run = simulate(plant, torque, DT)
        velocity = run.velocity + noise * rng.standard_normal(n)
        out.append(Recording(run.time, torque, velocity, run.angle + 1e-4 * rng.standard_normal(n), DT))
    return out


@pytest.fixture(scope="module")
def damped(robot):
    """Two chirps of an axis whose bristle is damped, as the contract's presliding friction has it not."""
    plant = robot + effect_class("presliding_friction_with_damping")(**LUGRE)
    return two_chirps(plant, 5, 0.02, 0.5, (0.5, 20.0), (0.35, 30.0), n=5_000)


def test_every_form_is_of_an_effect_of_the_contract():
    forms = [cls for cls in registered().values() if cls.form_of]
    assert forms
    for cls in forms:
        assert cls.name() == cls.form_of
        assert cls.form_of in cls.refines
        assert not effect_class(cls.form_of).form_of
        assert set(effect_class(cls.form_of).places) >= set(cls.places)


@pytest.mark.slow
def test_a_form_is_named_by_the_contract(robot, damped):
    only = ("coulomb_friction", "presliding_friction")
    found = diagnose(robot, damped[:1], damped[1:], Options(effects=only, jobs=1))
    assert found.verdict is Verdict.MISSING_PHYSICS
    (finding,) = found.findings
    assert (finding.effect, finding.law) == ("presliding_friction", "presliding_friction_with_damping")
    assert finding.equivalents == ()
    assert finding.parameters["damping_Nms_rad"].value == pytest.approx(0.01, rel=0.1)
    assert finding.parameters["stiffness_Nm_rad"].value == pytest.approx(1.0, rel=0.05)
    told = found.as_dict()["findings"][0]
    assert (told["effect"], told["law"]) == ("presliding_friction", "presliding_friction_with_damping")


@pytest.mark.slow
def test_friction_that_fades_in_is_coulomb_friction_and_no_bristle(robot):
    """Near standstill a damped bristle comes close to it, and neither holds the axis nor gives it a spring."""
    plant = robot + effect_class("coulomb_friction_with_creep")(torque_Nm=0.1, creep_velocity_rad_s=1.0)
    pair = two_chirps(plant, 6, 0.02, 0.5, (0.5, 20.0), (0.35, 30.0))
    only = ("coulomb_friction", "presliding_friction", "stribeck_friction", "torque_offset")
    found = diagnose(robot, pair[:1], pair[1:], Options(effects=only, jobs=1))
    assert found.verdict is Verdict.MISSING_PHYSICS
    (finding,) = found.findings
    assert (finding.effect, finding.place, finding.law) == ("coulomb_friction", "motor", "coulomb_friction_with_creep")
    assert finding.parameters["torque_Nm"].value == pytest.approx(0.1, rel=0.01)
    assert finding.parameters["creep_velocity_rad_s"].value == pytest.approx(1.0, rel=0.05)


@pytest.mark.slow
def test_tustins_law_is_stribeck_friction_and_nothing_beside_it(robot):
    """The extra level fades by the speed and not by its square: quadratic friction made up for that before."""
    values = {"torque_Nm": 0.1, "extra_static_torque_Nm": 0.08, "stribeck_velocity_rad_s": 3.0, "exponent": 1.0}
    plant = robot + effect_class("stribeck_friction_with_exponent")(**values)
    pair = two_chirps(plant, 9, 0.03, 0.3, (0.7, 15.0), (0.5, 20.0))
    only = ("coulomb_friction", "stribeck_friction", "quadratic_friction", "torque_offset")
    found = diagnose(robot, pair[:1], pair[1:], Options(effects=only, jobs=1))
    assert found.verdict is Verdict.MISSING_PHYSICS
    (finding,) = found.findings
    assert (finding.effect, finding.law) == ("stribeck_friction", "stribeck_friction_with_exponent")
    for name, value in values.items():
        assert finding.parameters[name].value == pytest.approx(value, rel=0.1)


@pytest.mark.slow
def test_friction_and_an_offset_are_not_held_by_asymmetric_friction(robot):
    """Asymmetric friction fits the pair best at first: taken apart, its friction is refined beside the offset."""
    stribeck = {"torque_Nm": 0.13, "extra_static_torque_Nm": 0.06, "stribeck_velocity_rad_s": 4.0}
    plant = robot + effect_class("stribeck_friction")(**stribeck) + effect_class("torque_offset")(torque_Nm=-0.04)
    pair = two_chirps(plant, 7, 0.05, 0.3, (0.5, 15.0), (0.4, 20.0))
    only = ("coulomb_friction", "asymmetric_friction", "stribeck_friction", "torque_offset", "quadratic_friction")
    found = diagnose(robot, pair[:1], pair[1:], Options(effects=only, jobs=1))
    assert found.verdict is Verdict.MISSING_PHYSICS
    assert {f.effect for f in found.findings} == {"stribeck_friction", "torque_offset"}
    values = {n: e.value for f in found.findings for n, e in f.parameters.items() if f.effect == "stribeck_friction"}
    for name, value in stribeck.items():
        assert values[name] == pytest.approx(value, rel=0.1)


def test_parts_make_the_same_motion(robot):
    torque = chirp(2.0, DT, 0.5, 0.5, 20.0)
    for cls in registered().values():
        if cls.parts is Effect.parts:
            continue
        scales = scales_by_place(
            robot, prepare(Recording(DT * np.arange(2000), torque, simulate(robot, torque, DT).velocity, None, DT))
        )
        whole = make(cls.id, cls.places[0], cls.starts(scales[cls.places[0]])[0])
        apart = robot
        for part in whole.parts():
            apart = apart + part
        assert whole.parts()[0].id in cls.refines
        assert cls.whole(whole.parts()[::-1]) == whole
        assert cls.whole(whole.parts()[:1]) is None
        one, other = (simulate(axis, torque, DT).velocity for axis in (robot + whole, apart))
        assert np.std(one - other) < 1e-3 * np.std(one)


def test_limits_are_where_a_law_goes(robot):
    """As the speed over which it fades goes to zero Stribeck friction is static friction, and no sooner."""
    torque = chirp(2.0, DT, 0.5, 0.5, 20.0)
    level = {"torque_Nm": 0.1, "extra_static_torque_Nm": 0.05}
    for width, near in ((1e-4, True), (1.0, False)):
        law = effect_class("stribeck_friction")(**level, stribeck_velocity_rad_s=width)
        (limit,) = law.limits()
        assert len(limit.values) < len(law.values)
        assert limit.id not in type(law).refines
        one, other = (simulate(robot + e, torque, DT).velocity for e in (law, limit))
        assert bool(np.std(one - other) < 0.01 * np.std(one)) is near
    assert (
        effect_class("stribeck_friction")(torque_Nm=0.0, extra_static_torque_Nm=1.0, stribeck_velocity_rad_s=1.0).limits() == ()
    )
    assert effect_class("coulomb_friction")(torque_Nm=0.1).limits() == ()


def test_parts_that_nothing_tells_from_one_effect_are_named_by_it(robot):
    """An offset that entered first and friction beside it are asymmetric friction; nothing else is put together."""
    asymmetric = effect_class("asymmetric_friction")(torque_Nm=0.1, asymmetry_Nm=0.05)
    torque = chirp(4.0, DT, 0.5, 0.5, 20.0)
    run = simulate(robot + asymmetric, torque, DT)
    noise = 0.02 * np.random.default_rng(8).standard_normal(len(torque))
    experiment = prepare(Recording(run.time, torque, run.velocity + noise, run.angle, DT))
    fitter = Fitter(robot, MotionView(), (experiment,), (experiment,), 1)
    try:
        search = Search(fitter, SearchOptions())
        apart = fitter.fit(fitter.hypothesis(asymmetric.parts()))
        search.state.consider((Candidate("torque_ripple", "motor"),))
        assert merged(search, apart) is apart
        search.state.consider((Candidate("asymmetric_friction", "motor"), Candidate("torque_ripple", "motor")))
        found = merged(search, apart)
        assert found.key == ("asymmetric_friction@motor",)
        assert found.chi2 == pytest.approx(apart.chi2, rel=1e-3)
        (effect,) = found.effects
        assert effect.asymmetry_Nm == pytest.approx(0.05, rel=0.05)
        lone = fitter.fit(fitter.hypothesis(asymmetric.parts()[:1]))
        assert merged(search, lone) is lone
    finally:
        fitter.close()


CHIRPS = sealed_chirp(4.0, 1.0, 0.5, 30.0), sealed_chirp(4.0, 0.8, 0.7, 25.0)


@pytest.mark.slow
def test_a_slider_is_told_as_hysteresis_with_its_corner(robot, sealed):
    """One Maxwell-slip element of another solver: the contract's gradual law leaves three times the noise of it."""
    slip = {"torque_Nm": 4.8, "stiffness_Nm_rad": 1.6e4}
    laws = compose(Laws(), find("hysteresis", "gearbox"), slip)._replace(slip_sharp=1.0)
    pair = sealed(laws, CHIRPS, 11)
    only = ("hysteresis", "hardening_stiffness", "coulomb_friction")
    found = diagnose(robot, pair[:1], pair[1:], Options(effects=only, jobs=1))
    assert found.verdict is Verdict.MISSING_PHYSICS
    (finding,) = found.findings
    assert (finding.effect, finding.place, finding.law) == ("hysteresis", "gearbox", "hysteresis_with_corner")
    assert finding.parameters["sharpness"].value > 5
    for name, value in slip.items():
        assert finding.parameters[name].value == pytest.approx(value, rel=0.05)


@pytest.mark.slow
def test_a_contact_that_damps_by_its_depth_is_told_as_backlash(robot, sealed):
    """A compliant impact of another solver, whose joint has no damping of its own: 73 times the noise variance was left."""
    hidden = {"gap_rad": 2e-4}
    laws = compose(Laws(), find("backlash", "gearbox"), hidden)._replace(gap_law_g=GAP_IMPACT, impact_g=0.5)
    pair = sealed(laws, CHIRPS, 12)
    found = diagnose(robot, pair[:1], pair[1:], Options(effects=("backlash", "hardening_stiffness", "coulomb_friction"), jobs=1))
    assert found.verdict is Verdict.MISSING_PHYSICS
    (finding,) = found.findings
    assert (finding.effect, finding.place, finding.law) == ("backlash", "gearbox", "backlash_with_impact")
    assert finding.parameters["gap_rad"].value == pytest.approx(2e-4, rel=0.02)
    assert finding.parameters["impact_s_rad"].value == pytest.approx(0.5, rel=0.1)


@pytest.mark.slow
def test_a_gear_that_begins_unstrained_is_told_as_transmission_error(robot, sealed):
    """The contract's gear begins strained by its error and rings; another plant's does not: hysteresis was named beside it."""
    hidden = {"amplitude_rad": 8e-5, "cycles_per_rev": 2.0, "phase_rad": 0.9}
    laws = compose(Laws(), find("transmission_error", "gearbox"), hidden)._replace(error_relaxed=1.0)
    pair = sealed(laws, CHIRPS, 13)
    found = diagnose(robot, pair[:1], pair[1:], Options(effects=("transmission_error", "torque_ripple", "hysteresis"), jobs=1))
    assert found.verdict is Verdict.MISSING_PHYSICS
    (finding,) = found.findings
    assert (finding.effect, finding.place, finding.law) == ("transmission_error", "gearbox", "transmission_error_with_strain")
    assert finding.parameters["amplitude_rad"].value == pytest.approx(8e-5, rel=0.02)
    assert finding.parameters["cycles_per_rev"].value == pytest.approx(2.0, rel=0.01)
