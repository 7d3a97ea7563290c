"""The criterion and what is asked of it, of structures as plain data."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from diagnose.evidence.context import Context
from diagnose.problem.noise_model import KnownNoise, ModelError
from diagnose.thresholds import MATERIAL, UNEXPLAINED
from mjsim.effects import effect_class

PRICE, ENTRY = KnownNoise.prices.price, KnownNoise.prices.entry
ABOVE, BELOW = UNEXPLAINED, 2.0 - UNEXPLAINED  # of the noise variance
COULOMB = effect_class("coulomb_friction")(torque_Nm=0.1)
AT_ARM = effect_class("coulomb_friction")(place="arm", torque_Nm=0.1)


def structure(*effects, chi2=1000.0, n=1000, numbers=0):
    return SimpleNamespace(
        effects=effects, key=tuple(sorted(e.key for e in effects)), chi2=chi2, n=n, ok=True,
        hypothesis=SimpleNamespace(size=numbers, start_numbers=0), fit=SimpleNamespace(x=None),
    )  # fmt: skip


def context(noise=None, length=0.0, **more):
    noise = noise or KnownNoise()
    fitter = SimpleNamespace(
        noise=noise, misfit=lambda f: f.chi2 / f.n, length=lambda hypothesis, x: length, map=lambda tasks: [t() for t in tasks]
    )
    return Context(fitter, noise.prices, **more)


def test_the_criterion_is_the_logarithm_of_chi_square_and_a_price():
    c = context(effective=0.25)
    assert c.criterion(structure(chi2=math.e * 1000, numbers=3)) == pytest.approx(250 + 3 * PRICE)
    assert c.criterion(structure(chi2=0.0)) < -1e5, "a residual of zero is no error"
    first, last = structure(COULOMB), structure(AT_ARM)
    assert c.criterion(last) - c.criterion(first) == len(type(COULOMB).places) - 1 == 2, "the first place of its list stands"


def test_a_gain_counts_the_effective_sample_size():
    poorer, richer = structure(chi2=1000 * math.exp(0.5), numbers=2), structure(COULOMB, chi2=1000.0, numbers=5)
    plain, weighed = context(), context(share_between=lambda a, b: 0.1 if (a, b) == (poorer, richer) else math.nan)
    assert plain.gain(poorer, richer) == pytest.approx(500 - 3 * PRICE) == plain.criterion(poorer) - plain.criterion(richer)
    assert weighed.gain(poorer, richer) == pytest.approx(50 - 3 * PRICE)
    elsewhere = structure(AT_ARM, chi2=1000.0, numbers=5)
    weighed = context(share_between=lambda a, b: 0.1)
    assert weighed.gain(poorer, elsewhere) == pytest.approx(50 - 3 * PRICE - 2)
    assert weighed.gain(elsewhere, poorer) == pytest.approx(-50 + 3 * PRICE + 2)
    assert plain.ahead(richer, poorer) == pytest.approx(500 - 3 * PRICE)
    nothing = structure(COULOMB, chi2=0.0, numbers=5)
    assert weighed.gain(poorer, nothing) > 5e4, "a residual of zero is no error"
    assert weighed.gain(nothing, poorer) < -5e4


def test_two_structures_are_compared_from_what_they_have_in_common():
    """Each against the largest structure in both, by what samples are worth to tell it from that."""
    delay, offset = effect_class("time_delay")(place="actuator", delay_s=1e-3), effect_class("torque_offset")(torque_Nm=0.1)
    common = structure(COULOMB, chi2=1000 * math.exp(0.4), numbers=2)
    one, other = (structure(COULOMB, e, chi2=1000 * math.exp(x), numbers=3) for e, x in ((delay, 0.0), (offset, 0.1)))
    c = context(share_between=lambda poorer, richer: 0.2 if richer is other else 0.1)
    assert c.ahead(one, other) == pytest.approx(c.criterion(other) - c.criterion(one)), "nothing is in both"
    c.fits.keep(common)
    ranks = type(delay).places.index(delay.place) - type(offset).places.index(offset.place)
    assert c.ahead(one, other) == pytest.approx(1000 * (0.1 * 0.4 - 0.2 * 0.3) - ranks)
    assert c.ahead(one, common) == pytest.approx(40 - PRICE - type(delay).places.index(delay.place))
    assert c.ahead(common, one) == -c.ahead(one, common)


@pytest.mark.parametrize(("ratio", "visible"), [(ABOVE + 1e-6, True), (ABOVE, False), (BELOW, False)])
def test_what_leaves_noise_alone_lacks_nothing_to_be_seen(ratio, visible):
    assert context().visible(structure(chi2=1000.0 * ratio)) is visible
    assert context(ModelError()).visible(structure(chi2=1000.0 * ratio)), "it cannot be known"


@pytest.mark.parametrize(("chi2", "low"), [(BELOW * 1000 - 0.1, True), (BELOW * 1000, False)])
def test_what_leaves_less_than_noise_lacks_what_has_a_colour(monkeypatch, chi2, low):
    for filter_, coloured in ((object(), True), (None, False)):
        monkeypatch.setattr("diagnose.evidence.context.whitening_filter", lambda *_, material, f=filter_: f)
        assert context().visible(structure(chi2=chi2)) is (low and coloured)


@pytest.mark.parametrize("spread", [0.0, 400.0, 5000.0])
def test_a_score_test_must_exceed_the_error_of_a_law(monkeypatch, spread):
    """A part of what another law changed; half the residual at the most."""
    law = effect_class("coulomb_friction_with_creep")(torque_Nm=0.1, creep_velocity_rad_s=1.0)
    base, c = structure(law, COULOMB, chi2=2000.0), context()
    c.fits.keep(structure(COULOMB, effect_class("coulomb_friction")(torque_Nm=0.2), chi2=2000.0 + spread))
    expected = MATERIAL * spread
    assert c.law_error(base) == pytest.approx(expected)
    assert c.law_error(structure(COULOMB)) == 0.0
    assert c.floor(base) == pytest.approx(max(0.4 * ENTRY, -1000.0 * math.log(1.0 - expected / 2000.0)))
    monkeypatch.setattr(Context, "law_error", lambda self, f: 1e9)
    assert c.floor(base) == pytest.approx(1000.0 * math.log(2.0))
    half = context(effective=0.5)
    assert half.floor(base) == pytest.approx(500.0 * math.log(2.0))
