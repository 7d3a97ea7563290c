"""Whether an identified model is good, in words."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from ident.checks import missing_bands
from ident.estimate import Estimate, Status, pem
from ident.quality import Quality, input_effect_p, quality
from ident.residuals import ResidualTests, p_text, residual_tests
from mjsim.errors import InputError

__all__ = ["Grade", "Verdict", "alternative", "excited_band", "judge"]


SURE = 0.01
"""p value below which the input is said to have an effect."""
NOISY = 50.0
"""Simulation fit [%] below which a good model's output is mostly noise."""
CLOSE = 80.0
"""Simulation fit [%] from which a model with dependent residuals is still usable."""


class Grade(Enum):
    """The verdict in one word or two."""

    GOOD = "good"
    """Plant and noise model describe the data to within noise."""
    PLANT_GOOD = "plant good, noise model incomplete"
    """Nothing of the input is left in the residuals, but they are not white."""
    INCOMPLETE = "usable with care"
    """The model follows the data closely, yet the residuals still hold something of the input."""
    POOR = "poor"
    """The model does not describe the data."""
    NO_EFFECT = "no effect of the input"
    """The data do not show that the input does anything to the output."""


@dataclass(frozen=True)
class Verdict:
    """grade; sentences: plain words, the first is the verdict; trusted_bands: whether the confidence bands may be believed."""

    grade: Grade
    sentences: tuple[str, ...]
    trusted_bands: bool


def excited_band(estimate: Estimate, floor: float = 1e-3) -> tuple[float, float]:
    """Lowest and highest frequency [Hz] that hold all but ``floor`` of the input's power on either side."""
    u = np.asarray(estimate.data.u) - estimate.data.u.mean()
    power: np.ndarray = np.cumsum(np.abs(np.fft.rfft(u)) ** 2)
    f: np.ndarray = np.fft.rfftfreq(u.size, estimate.data.dt)
    first, last = (int(np.searchsorted(power, s * power[-1])) for s in (floor, 1 - floor))
    return float(f[first]), float(f[min(f.size - 1, last)])


def alternative(estimate: Estimate, figures: Quality) -> str | None:
    """A sentence on the same model with a direct term, if that follows the data much better; None otherwise.

    Decimated or low-passed signals are band-limited, not held between samples: the sampled plant then acts on the
    present input too.
    """
    s = estimate.model.structure
    if s.nk != 1:
        return None
    other = replace(s, nb=s.nb + 1, nk=0)
    try:
        rival = pem(estimate.data, other, estimate.options)
    except InputError:
        return None
    fit = quality(rival).simulation_percent
    if not np.isfinite(fit) or 100 - fit > 0.6 * (100 - figures.simulation_percent) or rival.loss > 0.9 * estimate.loss:
        return None
    orders = ",".join(map(str, other.listed))
    return (
        f"With a direct term (--orders {orders}) the simulation fits {fit:.1f} % instead of "
        f"{figures.simulation_percent:.1f} %: decimated signals are band-limited, not held between samples."
    )


def judge(estimate: Estimate, tests: ResidualTests | None = None, figures: Quality | None = None) -> Verdict:
    """Weigh the input's effect, residual tests, fit and the end of the search.

    The fit that counts is the simulation's: one-step prediction is close to the data for any model when they are sampled fast.
    """
    tests, q = tests or residual_tests(estimate), figures or quality(estimate)
    fit = q.simulation_percent
    unexplained = 100 * min(1.0, max(0.0, 1 - fit / 100) ** 2) if np.isfinite(fit) else 100.0
    s = estimate.model.structure
    words: list[str] = []
    effect_p = input_effect_p(estimate.data)
    if effect_p > SURE:
        grade = Grade.NO_EFFECT
        words.append(
            f"The data do not show that the input does anything to the output ({p_text(effect_p)}): this is no model of a plant. "
            "Check that the right columns were taken, or record with more amplitude or for longer."
        )
    elif tests.independent and tests.white:
        grade = Grade.GOOD
        words.append(f"The model is good: {s} describes the data to within noise.")
    elif tests.independent and fit > 0.0:
        grade = Grade.PLANT_GOOD
        words.append(
            "The plant model is good, the noise model is not complete: the residuals are free of the input, but not white."
        )
    elif fit >= CLOSE:
        grade = Grade.INCOMPLETE
        words.append(
            "The model is usable with care: it follows the data, but the residuals still depend on the input, so something "
            "systematic is missing (a higher order, a delay, or a nonlinearity)."
        )
    else:
        grade = Grade.POOR
        words.append("The model is poor: much of what the input does to the output is not in it.")
    if grade in (Grade.GOOD, Grade.PLANT_GOOD) and fit < NOISY:
        words.append("Most of the output is noise: the plant is known no better than the bands say.")
    words.append(
        f"Simulated from the input alone, it reproduces {fit:.1f} % of the output (NRMSE fit; {unexplained:.2g} % of the "
        f"output's variance is left over); predicted one step ahead, {q.fit_percent:.4g} %."
        if np.isfinite(fit)
        else "Its simulation diverges."
    )
    lags, level = tests.lags, 100 * tests.level
    words.append(
        f"Residuals: {tests.auto_outside} of {lags} lags outside the {level:g} % whiteness bound "
        f"(joint {p_text(tests.whiteness_p)}), "
        f"{tests.cross_outside} of {lags + 1} outside the bound of independence of the input "
        f"(joint {p_text(tests.independence_p)})."
    )
    if tests.feedback:
        words.append(
            f"They also correlate with later inputs ({p_text(tests.feedback_p)}): the data look as if taken under feedback, or "
            "the filter spreads events in time. Under feedback only a complete noise model gives an unbiased plant."
        )
    if tests.mean_p < 0.001:
        words.append("The residuals have an offset: remove the means first (--detrend mean).")
    trusted = grade is Grade.GOOD and estimate.status is not Status.ITERATION_LIMIT
    words.append(
        "The confidence bands may be believed."
        if trusted
        else "The confidence bands assume a complete model, which this is not: read them as a lower limit of the uncertainty."
    )
    low, high = excited_band(estimate)
    words.append(
        f"The input has its power between {low:.3g} and {high:.3g} Hz; what the model says outside is extrapolation."
        if high < 0.97 * estimate.data.nyquist_hz or missing_bands(np.asarray(estimate.data.u), estimate.data.dt)
        else f"The input has power over the whole band up to {estimate.data.nyquist_hz:.3g} Hz."
    )
    if estimate.status is not Status.CONVERGED:
        words.append(f"The search ended with: {estimate.status.value}. {estimate.status.advice}")
    if not estimate.model.stable:
        words.append("The model is not stable.")
    return Verdict(grade, tuple(words), trusted)
