"""An effect against the step of the encoder: errors within half a step ask for no effect."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.evidence.outcome import PASS, Pair, Veto
from diagnose.evidence.rivals.quantisation import beyond_the_step, no_reading_of_the_encoder, within_the_step
from diagnose.thresholds import SMALL

N, STEP = 4000, 1.5e-3
TIME = 0.01 * np.arange(N)
MOTION = 0.3 * np.sin(0.9 * TIME) * (np.sin(0.2 * TIME) > 0)


def fitter(errors, *, channel="angle", step=STEP):
    """What the test asks of a fitter, of recordings of encoders of a step whose models miss ``errors``."""
    recordings = []
    for e in errors:
        angle = step * np.round((MOTION + e) / step) if step else MOTION + e + 1e-4 * np.random.default_rng(1).standard_normal(N)
        recordings.append(SimpleNamespace(recording=SimpleNamespace(angle=angle), error=angle - MOTION))
    return SimpleNamespace(
        view=SimpleNamespace(channel=channel), experiments=recordings[:1], held_out=recordings[1:],
        own_values=lambda h, f, e: ("axis", None), error=lambda axis, e, start: e.error, counted=lambda e: np.full(N, True),
    )  # fmt: skip


ANY = SimpleNamespace(hypothesis=None)


@pytest.mark.parametrize("shift", [0.05, 0.2, 0.4, 2.0])
def test_what_lies_beyond_a_step_is_the_error_of_the_model(shift):
    """Readings of a motion that is off by part of a step err by up to that beyond half a step: its cube over three."""
    expected = 12.0 * (shift**3 / 3.0 if shift < 1 else 1.0 / 12.0 + (shift - 0.5) ** 2)
    moving = fitter([np.full(N, shift * STEP)])
    moving.counted = lambda e: np.abs(np.gradient(MOTION)) > 0.6 * STEP  # all parts of a step occur
    assert beyond_the_step(moving, ANY) == pytest.approx(expected, rel=0.15, abs=2e-3)


def test_the_recording_that_shows_most_counts_and_a_true_model_has_nothing_beyond():
    assert beyond_the_step(fitter([np.zeros(N)] * 2), ANY) == pytest.approx(0.0, abs=1e-9)
    one = beyond_the_step(fitter([np.zeros(N), np.full(N, 0.8 * STEP)]), ANY)
    assert one == beyond_the_step(fitter([np.full(N, 0.8 * STEP), np.zeros(N)]), ANY) > SMALL


def test_it_is_asked_of_an_angle_with_a_step():
    assert beyond_the_step(fitter([np.zeros(N)], channel="velocity"), ANY) == math.inf
    assert beyond_the_step(fitter([np.zeros(N)], step=0.0), ANY) == math.inf
    stopped = fitter([np.zeros(N)])
    stopped.error = lambda *_: None
    assert beyond_the_step(stopped, ANY) == math.inf


@pytest.mark.parametrize(
    ("beyond", "outcome"), [(SMALL, PASS), (0.9 * SMALL, Veto("quantisation", {"beyond": 0.9 * SMALL, "needed": SMALL}))]
)
def test_an_effect_needs_an_error_beyond_the_step_and_that_is_measured_once(beyond, outcome):
    before = SimpleNamespace(key=(), chi2=1.0)
    context = SimpleNamespace(fitter=None, memo=SimpleNamespace(beyond={((), 1.0): beyond}))
    assert no_reading_of_the_encoder(context, Pair(before, SimpleNamespace(key=("a",)))) == outcome


@pytest.mark.parametrize(("shifts", "channel", "within"), [
    ([0.0, 0.0], "angle", True), ([0.0, 0.8], "angle", False), ([0.0, 0.0], "velocity", False), ([], "angle", False),
])  # fmt: skip
def test_a_diagnosis_is_within_the_step_where_every_recording_is(shifts, channel, within):
    traces = []
    for shift in shifts:
        measured = STEP * np.round(MOTION / STEP)
        traces.append(SimpleNamespace(measured=measured, corrected=MOTION - shift * STEP, counted=np.full(N, True)))
    assert within_the_step(SimpleNamespace(channel=channel, traces=tuple(traces))) is within
