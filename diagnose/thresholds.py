"""Every number by which a diagnosis decides: levels of decisions, costs, numerical tolerances.

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
LARGE = _number(
    "LARGE", LEVEL, 1.5, "chi2 / n", "an excess of half the noise variance; a score test there is no longer accurate", "search"
)
FAR = _number("FAR", LEVEL, 3.0, "chi2 / n", "an error 1.4 times the noise beside it; three times what chance explains", "search")
NEARLY = _number("NEARLY", LEVEL, 2.0, "times chi2", "of structures whose neighbours are tried", "search")
SAME = _number("SAME", LEVEL, 0.002, "log chi2", "0.1 % of an error: one minimum", "search")
RIVAL = _number("RIVAL", LEVEL, 0.1, "log chi2", "confounders beside a simpler structure", "graph")
EQUIVALENT = _number("EQUIVALENT", LEVEL, 10.0, "C", "a likelihood ratio of 150", "search")
HOPE = _number(
    "HOPE", LEVEL, 2.0, "times a predicted gain", "bound of what a fit may gain where its linear prediction is poor", "search"
)
MATERIAL = _number(
    "MATERIAL", LEVEL, 0.02, "of a squared error", "a smaller change matters to no prediction: 1 % of an rms error", "search"
)
SMALL = _number("SMALL", LEVEL, 0.05, "of samples or of a level", "negligible, or too few to judge by", "experiment")
FAIR = _number("FAIR", LEVEL, 0.25, "of a gain", "half its rms: more than the time of one event can give", "observer")
MOST = _number(
    "MOST",
    LEVEL,
    0.5,
    "of a squared error",
    "more than the answer of a servo to unmodelled torques (lab/speed/servo_axes.py)",
    "servo",
)
TAKEN_BY_FEW_PERIODS = _number(
    "TAKEN_BY_FEW_PERIODS", LEVEL, 0.8, "of a squared error", "no sine of a few periods takes that by chance", "servo"
)
CLEAR = _number(
    "CLEAR", LEVEL, 10.0, "times a material gain", "where the held-out data are few, or a nonsmooth run diverges", "search"
)
GAIN_RATIO = _number(
    "GAIN_RATIO", LEVEL, 4.0, "ratio of logarithmic gains", "two standard deviations at 15 independent samples each", "search"
)
ALPHA = _number("ALPHA", LEVEL, 0.01, "p-value", "of a test, over all hypotheses that it was asked about", "force_orders")
NOISE_STANDS_OUT = _number("NOISE_STANDS_OUT", LEVEL, 4.0, "standard errors", "6e-5 two-sided, over 16 bands 1e-3", "noise")
LINE = _number(
    "LINE",
    LEVEL,
    40.0,
    "power over the surroundings",
    "1e-13 by chance for N(0, 1) in quadrature, over 1e4 frequencies",
    "scales",
)
SWING = _number("SWING", LEVEL, 3.0, "log of growth", "errors 20 times as large at the end of a recording", "flow")
TWICE_NOISE = _number(
    "TWICE_NOISE", LEVEL, 2.0, "times the sensor noise", "more is no noise; more may not enter by an observer gain", "observer"
)
FOLLOWS_WEIGHT = _number(
    "FOLLOWS_WEIGHT", LEVEL, 0.9, "correlation", "four fifths of the variation: one stands for the other", "real_logs/test_weight"
)
AS_FLAT = _number(
    "AS_FLAT", LEVEL, 1.25, "exponent of the rate", "white noise has 0, what is motion 2 and more", "real_logs/test_content"
)
SENSOR_SHARE = _number(
    "SENSOR_SHARE", LEVEL, 1e-3, "of the torque's power", "that the encoder's noise may make in the band of a force view", "view"
)

# Costs: how much work a decision is worth
LONG = _number("LONG", COST, 8.0, "runs", "of the nominal model, that one of a slow structure takes", "search")
HALVINGS = _number(
    "HALVINGS",
    COST,
    ((6, 3, 1.5), (4, 6, 0.4), (3, 20, 0.05)),
    "rivals, iterations, log chi2",
    "how many go on, for how long, how far behind",
    "search",
)
FORMS = _number("FORMS", COST, 30, "iterations", "of a simpler or poorer structure", "search")
FEWER = _number("FEWER", COST, 4, "rivals", "beside noise alone", "search")
MOST_FILTERS = _number("MOST_FILTERS", COST, 2, "searches", "on whitened errors", "passes")
MAP_RUNS = _number("MAP_RUNS", COST, 1500, "runs", "after which no further map is tried", "torque_map")
TRIED = _number("TRIED", COST, 3, "maps", "that are fitted in the model", "torque_map")
SECOND_SPLIT = _number(
    "SECOND_SPLIT",
    COST,
    1 / 3,
    "of the budget",
    "for a search of another split, or tied to the recorded angle, whatever the first took",
    "flow",
)
RUNS = _number("RUNS", COST, 14_000, "runs", "some 20 s for 10 s at 2 kHz on two cores", "budget")
HIGHEST_TRIAL = _number(
    "HIGHEST_TRIAL", COST, 60.0, "Hz", "top of a proposed chirp, at most a tenth of the sampling rate", "flow"
)
LONGEST = _number(
    "LONGEST", COST, 240_000, "samples", "2 min at 2 kHz: 2 GB; of a longer recording stretches are fitted", "stretches"
)
STRETCH_SAMPLES = _number(
    "STRETCH_SAMPLES", COST, 120_000, "samples", "in all stretches of a recording: 1 min at 2 kHz", "stretches"
)
STRETCH_COUNT = _number("STRETCH_COUNT", COST, 12, "stretches", "eight fitted, four held out: 5 s each at 2 kHz", "stretches")
STRETCH_FRESH = _number(
    "STRETCH_FRESH", COST, 0.5, "of the best gain", "for a part of the recording that has no stretch yet", "stretches"
)
STRETCH_BLOCKS = _number(
    "STRETCH_BLOCKS", COST, 512, "blocks", "of a stretch: means of 16 samples, as fast as friction acts", "stretches"
)
MAP_FAR = _number(
    "MAP_FAR", COST, 1.25, "times a screened cost", "of the best fitted map, beyond which no further map is fitted", "torque_map"
)
FURTHER = _number("FURTHER", COST, 3.0, "times the travel", "an experiment that goes further is not proposed", "flow")
ORDERS_TRIED = _number(
    "ORDERS_TRIED", COST, 3, "orders", "to which a position-locked effect may move; of a varying inertia", "search"
)
STARTS = _number("STARTS", COST, 6, "starts", "of the nominal structure", "horizons")
ABOUT = _number("ABOUT", COST, 0.25, "log of a ratio", "their spread", "horizons")
LEAST_SAMPLES = _number("LEAST_SAMPLES", COST, 5000, "samples", "that tell a screened candidate: a noise rms to 1 %", "screening")
SHOWN = _number("SHOWN", COST, 8, "rivals", "whose held-out error and refusal are reported", "report/test_page")
KEPT_TORQUES = _number("KEPT_TORQUES", COST, 8, "arrays", "structures that are fitted at a time", "screening")
TOLD = _number("TOLD", COST, 3, "refusals", "that are told in words", "real_logs/test_refusals")

# Numerics: tolerances, grids and filters
FASTEST = _number("FASTEST", NUMERIC, 0.85, "of Nyquist", "above it a smooth motion has no power: noise alone", "noise")
SEGMENT = _number("SEGMENT", NUMERIC, 1024, "samples", "2 Hz apart at 2 kHz", "noise")
BANDS = _number("BANDS", NUMERIC, 16, "bands", "of the spectrum, up to half the Nyquist frequency", "noise")
FEWEST_SEGMENTS = _number("FEWEST_SEGMENTS", NUMERIC, 8, "segments", "at least, for a coherence", "noise")
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
    "MOST_SUBSTEPS", NUMERIC, 12, "steps a sample", "a fit that wanders to a stiffer model has left the plausible", "screening"
)
STIFFER = _number("STIFFER", NUMERIC, 3, "times the nominal stiffness", "or one that is stiffer than that", "screening")
PRIOR = _number(
    "PRIOR", NUMERIC, 0.5, "relative standard deviation", "a nominal number is right within a factor of two", "search"
)
GUIDE = _number("GUIDE", NUMERIC, 0.2, "relative standard deviation", "of nominal numbers beside a large misfit", "whiten")
ENGINE = _number("ENGINE", NUMERIC, 0.007, "of the noise rms", "error of the fitting engine, or of the plant's own", "search")
ROUGHLY = _number("ROUGHLY", NUMERIC, 0.0002, "relative gain of an iteration", "far below SAME", "search")
RK4 = _number("RK4", NUMERIC, 3.5, "times a product", "of a step that laws make nonlinear", "search")
ANEW = _number("ANEW", NUMERIC, 5, "iterations", "by secants before the Jacobian is computed anew", "search")
ANEWS = _number("ANEWS", NUMERIC, 3, "times", "that it is computed anew", "search")
HORIZONS = _number(
    "HORIZONS", NUMERIC, (0.04, 0.06, 0.1, 0.16, 0.25, 0.4, 0.63), "of a recording", "each about 1.6 times the last", "horizons"
)
GRID = _number("GRID", NUMERIC, 2**14, "frequencies", "finer than any resonance of 24 lags", "whiten")
ORDERS_BESIDE = _number("ORDERS_BESIDE", NUMERIC, 12, "orders", "each side, a quarter of a line's width apart", "encoder")
MOST_ORDERS = _number("MOST_ORDERS", NUMERIC, 2000, "orders", "looked at", "force_orders")
NEIGHBOURS = _number("NEIGHBOURS", NUMERIC, 1.5, "ratio of orders", "within which orders are neighbours", "force_orders")
FEW_PERIODS = _number(
    "FEW_PERIODS",
    NUMERIC,
    5 / (1.5 - 1 / 1.5),
    "periods over the travel",
    "fewer leave an order without two neighbours",
    "force_orders",
)
UNSURE = _number("UNSURE", NUMERIC, 2, "orders", "of so few periods that are tried", "force_orders")
WINDOWS = _number(
    "WINDOWS", NUMERIC, (0.02, 0.006, 0.002), "s", "long ones hold little noise, short ones fast motion", "missed_motion"
)
OFFSET_BLOCKS = _number("OFFSET_BLOCKS", NUMERIC, 16, "blocks", "five standard errors of 16 are 1.6e-4 by Student", "flow")
FINER = _number("FINER", NUMERIC, 3, "parts of a block", "0.08 s of 10 s: longer than whitened noise remembers", "search")
COARSE = _number("COARSE", NUMERIC, 0.33, "rad", "a step of the fastest motion in a first look", "screening")
INTERVALS = _number("INTERVALS", NUMERIC, (12, 5), "intervals", "of a map of one variable, and of each of two", "torque_map")
FOLDS = _number("FOLDS", NUMERIC, 5, "folds", "of a cross-validation", "torque_map")
RIDGE = _number("RIDGE", NUMERIC, 1e-06, "of a column's square", "what other stretches do not show stays zero", "torque_map")
AHEAD_SECONDS = _number("AHEAD_SECONDS", NUMERIC, (0.005, 0.05, 0.25), "s", "how far ahead predictions are judged", "ahead")
AHEAD_ORDER = _number("AHEAD_ORDER", NUMERIC, 300, "lags", "white noise hides a slow error from a short model", "ahead")
TWO_SIDED = _number("TWO_SIDED", NUMERIC, 1.96, "standard errors", "half a 95 % interval of a normal distribution", "intervals")
MIMIC = _number("MIMIC", NUMERIC, 0.002, "of a direction", "that the model's own numbers leave", "torque_map")
SECANT_ERROR = _number("SECANT_ERROR", NUMERIC, 100.0, "chi2", "by which a secant may misjudge a confounder", "search")
SAME_SIZE = _number("SAME_SIZE", NUMERIC, 0.5, "C", "a structure of the same size must be ahead", "search")
OTHER_ORDER = _number("OTHER_ORDER", NUMERIC, 0.02, "relative", "two orders", "search")
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
STALLED = _number("STALLED", NUMERIC, 0.01, "relative gain of an iteration", "where a fit far from the noise ends", "torque_map")
ROUNDING = _number("ROUNDING", NUMERIC, 1e-10, "relative", "of a sum of squares or a second difference: rounding", "torque_map")
FACTORS = _number(
    "FACTORS",
    NUMERIC,
    (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 32, 40, 50, 64, 80, 100),
    "samples",
    "by which a filtered log is sampled more slowly",
    "real_logs/test_content",
)
FEWEST_LEFT = _number("FEWEST_LEFT", NUMERIC, 250, "samples", "of a slower recording", "real_logs/test_content")
NO_SENSOR = _number(
    "NO_SENSOR", NUMERIC, 1e-5, "of a channel's spread", "noise that no sensor of a machine reaches: 17 bits", "experiment"
)
AT_BOUND = _number("AT_BOUND", NUMERIC, 1e-6, "log of a ratio", "a number stands at its bound", "real_logs/test_bounds")
SOME_ANGLES = _number("SOME_ANGLES", NUMERIC, 200, "angles", "at which laws are compared", "real_logs/test_weight")
