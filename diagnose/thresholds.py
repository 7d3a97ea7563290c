"""Every number by which a diagnosis decides: levels of decisions, costs, numerical tolerances, and what is derived from these.

Each has its value, unit, what it decides or how it is derived, and the test file that exercises it; `TABLE` lists them by name.
The prices of an effect stand with the noise model (`diagnose.problem.noise_model`), the levels that a user may set with the
options (`diagnose.options`).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeVar

__all__ = ["TABLE", "Threshold"]  # and every number below, by its name

T = TypeVar("T")
LEVEL, COST, NUMERIC = "level of a decision", "cost", "numerical tolerance"
DERIVED = "derived from other numbers of the table"


@dataclass(frozen=True)
class Threshold:
    """A number, or a few that belong together.

    why: what it decides, or how it is derived; test: the test file that exercises it.
    """

    kind: str
    value: Any
    unit: str
    why: str
    test: str


_table: dict[str, Threshold] = {}
TABLE = MappingProxyType(_table)
"""All of them by name."""


def _number(name: str, kind: str, value: T, unit: str, why: str, test: str) -> T:
    if name in _table:
        raise ValueError(f"threshold {name} stands in the table twice")
    file = test if "/" in test else f"diagnose/test_{test}"
    _table[name] = Threshold(kind, value, unit, why, f"tests/{file}.py")
    return value


# Levels of decisions: of residuals, of shares, of tests
UNEXPLAINED = _number(
    "UNEXPLAINED", LEVEL, 1.04, "chi2 / n", "4 sqrt(2 / n) at 20,000 samples: four standard deviations above the noise", "search"
)
TWICE = _number(
    "TWICE",
    LEVEL,
    2.0,
    "ratio",
    "what is known roughly is known to a factor of two: nominal numbers, a noise level, the gain that a linear model predicts",
    "search",
)
LARGE = _number(
    "LARGE",
    DERIVED,
    1 + 1 / TWICE,
    "chi2 / n",
    "the noise and an error of half its variance; a score test there is no longer accurate",
    "search",
)
FAR = _number("FAR", DERIVED, 1 + TWICE, "chi2 / n", "the noise and an error of twice its variance, 1.4 times its rms", "search")
EQUIVALENT = _number("EQUIVALENT", LEVEL, 10.0, "C", "a likelihood ratio of 150", "search")
MATERIAL = _number(
    "MATERIAL", LEVEL, 0.02, "of a squared error", "a smaller change matters to no prediction: 1 % of an rms error", "search"
)
SMALL = _number("SMALL", LEVEL, 0.05, "of samples or of a level", "negligible, or too few to judge by", "experiment")
FAIR = _number("FAIR", DERIVED, 1 / TWICE**2, "of a gain", "half its rms: more than the time of one event can give", "observer")
MOST = _number(
    "MOST",
    LEVEL,
    0.5,
    "of a squared error",
    "more than the answer of a servo to unmodelled torques (lab/speed/servo_axes.py)",
    "servo",
)
CLEAR = _number(
    "CLEAR", LEVEL, 10.0, "times a material gain", "where the held-out data are few, or a nonsmooth run diverges", "search"
)
SAME = _number(
    "SAME",
    DERIVED,
    MATERIAL / CLEAR,
    "log chi2",
    "clearly less than material, 0.1 % of an error: one minimum, one direction, the end of a fit that leaves more than noise",
    "search",
)
NEARLY_ALL = _number("NEARLY_ALL", LEVEL, 0.8, "of a squared error", "no sine of a few periods takes that by chance", "evidence")
FAMILY = _number(
    "FAMILY", LEVEL, 0.05, "p-value", "of any false name by the held-out data, over all hypotheses (Bonferroni)", "findings"
)
ALPHA = _number("ALPHA", LEVEL, 0.01, "p-value", "of a test, over all hypotheses that it was asked about", "force_orders")
SIGMAS = _number("SIGMAS", LEVEL, 4.0, "standard errors", "6e-5 two-sided, over 16 bands 1e-3", "noise")
LINE = _number(
    "LINE",
    LEVEL,
    40.0,
    "power over the surroundings",
    "1e-13 by chance for N(0, 1) in quadrature, over 1e4 frequencies",
    "scales",
)
SENSOR_SHARE = _number(
    "SENSOR_SHARE",
    DERIVED,
    SMALL * MATERIAL,
    "of the torque's power",
    "that the encoder's noise may make in the band of a force view: a small part of a material change",
    "view",
)

# Costs: how much work a decision is worth
HALVINGS = _number(
    "HALVINGS",
    COST,
    ((6, 3, 1.5), (4, 6, 0.4), (3, 20, 0.05)),
    "rivals, iterations, log chi2",
    "how many go on, for how long, how far behind",
    "search",
)
LEADING = _number(
    "LEADING",
    DERIVED,
    HALVINGS[-1][0],
    "of a ranking",
    "as many as the last rung fits: maps, orders and rivals that are tried, refusals reported",
    "graph",
)
SECOND_SPLIT = _number(
    "SECOND_SPLIT",
    COST,
    1 / 3,
    "of the budget",
    "for a search of another split, or tied to the recorded angle, whatever the first took",
    "flow",
)
ONE_FIT = _number(
    "ONE_FIT",
    DERIVED,
    1 / LEADING,
    "of the budget",
    "that one fit may take: those of the last rung together take it all",
    "moves",
)
RUNS = _number("RUNS", COST, 14_000, "runs", "some 20 s for 10 s at 2 kHz on two cores", "budget")
LONGEST = _number(
    "LONGEST", COST, 240_000, "samples", "2 min at 2 kHz: 2 GB; of a longer recording stretches are fitted", "stretches"
)
STRETCH_COUNT = _number("STRETCH_COUNT", COST, 12, "stretches", "eight fitted, four held out: 5 s each at 2 kHz", "stretches")
LEAST_SAMPLES = _number(
    "LEAST_SAMPLES",
    DERIVED,
    round(2 / MATERIAL**2),
    "samples",
    "that tell a screened candidate: the mean square of white samples has the relative deviation sqrt(2 / n) = MATERIAL",
    "screening",
)

# Numerics: tolerances, grids and filters
FASTEST = _number("FASTEST", NUMERIC, 0.85, "of Nyquist", "above it a smooth motion has no power: noise alone", "noise")
SEGMENT = _number("SEGMENT", NUMERIC, 1024, "samples", "2 Hz apart at 2 kHz", "noise")
BANDS = _number("BANDS", NUMERIC, 16, "bands", "of the spectrum, up to half the Nyquist frequency", "noise")
TURNS = _number(
    "TURNS",
    NUMERIC,
    (1.0, 2.0, 3.0, 4.0, 6.0, 8.0),
    "orders",
    "eccentricity, coupling, pole pairs, and their multiples",
    "scales",
)
DITHER = _number("DITHER", NUMERIC, (0.01, 0.1, 0.2, 0.3, 0.45), "steps", "beyond 0.6 rounding acts as white noise", "screening")
MOST_SUBSTEPS = _number(
    "MOST_SUBSTEPS", NUMERIC, 12, "steps a sample", "a fit that needs more has reached an implausibly stiff model", "screening"
)
ENGINE = _number("ENGINE", NUMERIC, 0.007, "of the noise rms", "error of the fitting engine, or of the plant's own", "search")
ANEW = _number("ANEW", NUMERIC, 5, "iterations", "by secants before the Jacobian is computed anew", "search")
HORIZONS = _number(
    "HORIZONS",
    NUMERIC,
    (0.04, 0.06, 0.1, 0.16, 0.25, 0.4, 0.63, 1.0),
    "of a recording",
    "each about 1.6 times the last",
    "horizons",
)
ORDERS_BESIDE = _number("ORDERS_BESIDE", NUMERIC, 12, "orders", "each side, a quarter of a line's width apart", "encoder")
MOST_ORDERS = _number("MOST_ORDERS", NUMERIC, 2000, "orders", "looked at", "force_orders")
NEIGHBOURS = _number("NEIGHBOURS", NUMERIC, 1.5, "ratio of orders", "within which orders are neighbours", "force_orders")
WINDOWS = _number(
    "WINDOWS", NUMERIC, (0.02, 0.006, 0.002), "s", "long ones hold little noise, short ones fast motion", "missed_motion"
)
FINER = _number("FINER", NUMERIC, 3, "parts of a block", "0.08 s of 10 s: longer than whitened noise remembers", "search")
COARSE = _number("COARSE", NUMERIC, 0.33, "rad", "a step of the fastest motion when candidates are screened", "screening")
INTERVALS = _number("INTERVALS", NUMERIC, (12, 5), "intervals", "of a map of one variable, and of each of two", "torque_map")
FOLDS = _number("FOLDS", NUMERIC, 5, "folds", "of a cross-validation", "torque_map")
AHEAD_SECONDS = _number("AHEAD_SECONDS", NUMERIC, (0.005, 0.05, 0.25), "s", "how far ahead predictions are judged", "ahead")
OBSERVER_GAINS = _number(
    "OBSERVER_GAINS",
    NUMERIC,
    (30.0, 100.0, 300.0),
    "1/s",
    "memories of 33 to 3 ms, under which nonsmooth structures are fitted and compared",
    "observer",
)
TAPS = _number(
    "TAPS", NUMERIC, 40, "taps", "of a filter between sensors (20 ms at 2 kHz) and of the whitening of a torque", "noise"
)
FEW_TAPS = _number("FEW_TAPS", NUMERIC, 8, "taps", "ahead, between sensors; to level the spectrum of a residual", "orders")
BLOCKS = _number("BLOCKS", NUMERIC, 40, "blocks", "of a recording, for paired tests and cross-validation", "second_encoder")
ROUNDING = _number("ROUNDING", NUMERIC, 1e-10, "relative", "of a sum of squares or a second difference: rounding", "torque_map")
FEWEST = _number(
    "FEWEST",
    DERIVED,
    round(1 / (2 * SMALL**2)),
    "samples",
    "of all recordings that are fitted, or of a first part: the rms of white samples has the relative deviation "
    "1 / sqrt(2 n) = SMALL",
    "experiment",
)
SHORTEST = _number(
    "SHORTEST",
    DERIVED,
    round(1 / (2 * (TWICE * SMALL) ** 2)),
    "samples",
    "of one of several recordings: the rms of its noise, which weighs it against the others, is known to TWICE SMALL",
    "short_recordings",
)
