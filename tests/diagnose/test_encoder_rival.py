"""An effect against an encoder that errs: what it must gain over that, and beside it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.evidence.encoder import whole_orders
from diagnose.evidence.outcome import PASS, Pair, Veto
from diagnose.evidence.rivals import encoder
from diagnose.evidence.rivals.encoder import no_error_of_the_encoder
from diagnose.problem.noise_model import KnownNoise, ModelError
from diagnose.thresholds import MATERIAL
from mjsim.effects import effect_class

RIPPLE = effect_class("torque_ripple")(amplitude_Nm=1.0, cycles_per_rev=4.0, phase_rad=0.0)
COULOMB = effect_class("coulomb_friction")(torque_Nm=0.1)
ENTRY = KnownNoise.prices.entry


def structure(*effects, chi2):
    return SimpleNamespace(effects=effects, key=tuple(sorted(e.key for e in effects)), chi2=chi2)


@pytest.fixture
def judged(monkeypatch):
    """``judged(gain, own, beside)``: the outcome for an effect that gains so much, the encoder of its order, it beside that."""
    asked = []

    def judge(gain, own=0.0, beside=1e9, noise=None, before=(), after=(RIPPLE,), context=None):
        monkeypatch.setattr(encoder, "encoder_gain", lambda fitter, poorer, effect: asked.append("own") or own)
        monkeypatch.setattr(encoder, "gain_with_encoder_error", lambda fitter, poorer, richer: asked.append("beside") or beside)
        noise = noise or KnownNoise()
        context = context or SimpleNamespace(
            prices=noise.prices, fitter=SimpleNamespace(noise=noise), memo=SimpleNamespace(encoder={})
        )
        poorer, richer = structure(*before, chi2=1e6 + gain), structure(*after, chi2=1e6)
        judge.context = context
        return no_error_of_the_encoder(context, Pair(poorer, richer))

    judge.asked = asked
    return judge


@pytest.mark.parametrize("gain", [100.0, 1e5])
def test_an_effect_must_beat_the_encoder_of_its_order(judged, gain):
    """By the entry, or by a fiftieth of its gain where that is more."""
    over = max(ENTRY, MATERIAL * gain)
    assert judged(gain, own=gain - over) is PASS
    refused = judged(gain, own=gain - over + 0.01)
    assert refused == Veto("encoder", {"gain": gain, "needed": pytest.approx(gain + 0.01)})
    assert judged.asked == ["own", "beside", "own"], "what is refused already is not fitted beside an encoder"


def test_an_effect_must_gain_its_entry_beside_an_encoder_that_errs(judged):
    assert judged(1000.0, beside=ENTRY) is PASS
    assert judged(1000.0, beside=ENTRY - 0.01) == Veto("encoder", {"gain": ENTRY - 0.01, "needed": ENTRY})


def test_answers_are_kept(judged):
    assert judged(1000.0) is PASS
    assert judged(1000.0, own=1e9, context=judged.context) is PASS
    assert judged.asked == ["own", "beside"]
    assert judged(2000.0, own=1e9, context=judged.context) != PASS, "of other fits they are others"


def test_one_added_effect_is_compared_where_the_noise_is_known(judged):
    refused = {"own": 1e9, "gain": 1000.0}
    assert judged(**refused, noise=ModelError()) is PASS
    assert judged(**refused, after=(RIPPLE, COULOMB)) is PASS, "two at once"
    assert judged(**refused, before=(COULOMB,), after=(RIPPLE,)) is PASS, "in place of another"
    assert judged(**refused, before=(RIPPLE, COULOMB), after=(RIPPLE,)) is PASS, "one less"
    assert judged.asked == []
    assert judged(**refused, before=(COULOMB,), after=(COULOMB, RIPPLE)) != PASS


@pytest.mark.parametrize(("travel", "count"), [(1.01, 8), (1.0, 7), (0.51, 7), (0.13, 1), (0.12, 0)])
def test_whole_orders_have_a_period_over_the_travel(travel, count):
    """Orders 1 to 8 of a turn, in parts of it: an order n needs more than 1 / n."""
    shown = whole_orders(2 * np.pi * travel * np.array([0.0, 0.3, 1.0]))
    assert shown == [float(n) for n in range(9 - count, 9)]
