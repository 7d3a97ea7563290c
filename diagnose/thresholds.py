"""Every number by which a diagnosis decides: levels of decisions, costs, numerical tolerances.

Each has its value, unit, what it decides or how it is derived, and the test file that exercises it; `TABLE` lists them by name.
The prices of an effect stand with the noise model (`diagnose.problem.noise_model`), the levels that a user may set with the
options (`diagnose.options`).
"""

from __future__ import annotations

import math
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


# Levels of decisions: levels of tests and of decisions
FASTEST = _number("FASTEST", LEVEL, 0.85, "of Nyquist", "above it a smooth motion has no power: noise alone", "noise")
NOISE_BY_SPECTRUM = _number(
    "NOISE_BY_SPECTRUM", LEVEL, 0.5, "of the level by differences", "700 white samples give no such ratio by chance", "noise"
)
NOISE_STANDS_OUT = _number("NOISE_STANDS_OUT", LEVEL, 4.0, "standard errors", "6e-5 two-sided, over 16 bands 1e-3", "noise")
NOISE_COLOURED = _number(
    "NOISE_COLOURED", LEVEL, 1.5, "of the white level", "the white level itself is known to some percent", "noise"
)
FOLLOWS_WEIGHT = _number(
    "FOLLOWS_WEIGHT",
    LEVEL,
    0.9,
    "correlation",
    "four fifths of the variation: one stands for the other",
    "real_logs/test_weight",
)
VARIES = _number("VARIES", LEVEL, 0.05, "of the mean", "less is constant", "real_logs/test_weight")
AS_FLAT = _number(
    "AS_FLAT", LEVEL, 0.5, "of an exponent", "a level known to some percent grows as little", "real_logs/test_content"
)
SENSOR_SHARE = _number(
    "SENSOR_SHARE", LEVEL, 1e-3, "of the torque's power", "that the encoder's noise may make in the band of a force view", "view"
)
FILTERED_RISE = _number(
    "FILTERED_RISE",
    LEVEL,
    3.0,
    "times the noise by the fastest part",
    "a whitening filter of a few lags makes up for less",
    "real_logs/test_content",
)
FILTERED_NOISE = _number(
    "FILTERED_NOISE",
    LEVEL,
    0.02,
    "of the spread",
    "more is motion at the end of the band",
    "real_logs/test_content",
)
REPEATS_BY_CHANCE = _number(
    "REPEATS_BY_CHANCE",
    LEVEL,
    3.0,
    "of the repeats that quantisation explains",
    "times the count that quantisation explains and its standard deviation",
    "experiment",
)
CLIPPED = _number("CLIPPED", LEVEL, 0.05, "of the samples", "at a limit, from which a recording is refused", "experiment")
DERIVED_VELOCITY = _number(
    "DERIVED_VELOCITY",
    LEVEL,
    0.05,
    "of the noise rms",
    "a velocity so close to its angle's differences was computed from them",
    "experiment",
)
LINE = _number(
    "LINE",
    LEVEL,
    40.0,
    "power over the surroundings",
    "1e-13 by chance for N(0, 1) in quadrature, over 1e4 frequencies",
    "scales",
)
SWING = _number("SWING", LEVEL, 3.0, "log of growth", "errors 20 times as large at the end of a recording", "flow")
LEAST_DELIVERED = _number(
    "LEAST_DELIVERED", LEVEL, 0.05, "of the commanded variation", "an actuator that delivers less moves nothing", "view"
)
OBSERVER_NOISE = _number(
    "OBSERVER_NOISE", LEVEL, 2.0, "times the sensor noise", "by which the observer gain may shake a model", "led"
)
UNEXPLAINED = _number(
    "UNEXPLAINED", LEVEL, 1.04, "chi2 / n", "4 sqrt(2 / n) at 20,000 samples: four standard deviations", "search"
)
FAR = _number("FAR", LEVEL, 3.0, "chi2 / n", "an error 1.4 times the noise beside it: other physics is missing", "search")
SAME = _number("SAME", LEVEL, 0.002, "log chi2", "0.1 % of an error: one minimum", "search")
WRONG = _number(
    "WRONG", LEVEL, 2.0, "chi2 / n", "under a gain, at first: something else is missing than moments of events", "led"
)
LOST = _number("LOST", LEVEL, 1.2, "times the least cost", "an event at another moment costs more", "led")
MODELS_APART = _number("MODELS_APART", LEVEL, 0.15, "of the noise rms", "2 % of its variance: not yet material", "search")
PREDICTED = _number("PREDICTED", LEVEL, 0.05, "of the held-out samples", "by which a nonsmooth model may be judged", "search")
CLEAR_GAIN = _number(
    "CLEAR_GAIN", LEVEL, 10.0, "times the material gain", "on the estimation data, where held-out data may be too few", "search"
)
GAIN_RATIO = _number(
    "GAIN_RATIO", LEVEL, 4.0, "ratio of logarithmic gains", "two standard deviations at 15 independent samples each", "search"
)
NEXT_TO_NOTHING = _number("NEXT_TO_NOTHING", LEVEL, 0.01, "of an excess above noise", "a tenth of its rms", "search")
LAW_ERROR = _number(
    "LAW_ERROR",
    LEVEL,
    (0.01, 0.02),
    "of a change of chi2 by law",
    "that the better law may still miss: of all, and of what is below the noise",
    "search",
)
COLOURED = _number("COLOURED", LEVEL, 0.01, "of a residual's variance", "predictable from its past, at 24 lags", "search")
ABOVE_NOISE = _number(
    "ABOVE_NOISE", LEVEL, 1.05, "chi2 / n", "beyond it a residual is more than the noise that it was taken for", "search"
)
BELOW_NOISE = _number("BELOW_NOISE", LEVEL, 0.95, "chi2 / n", "below it, less", "search")
FAIR = _number("FAIR", LEVEL, 0.25, "of a gain", "half its rms: more than moments of events", "led")
BEATS_ENCODER = _number("BEATS_ENCODER", LEVEL, 0.02, "of a gain", "two laws of one motion are not closer", "encoder")
ANSWERED = _number(
    "ANSWERED",
    LEVEL,
    0.5,
    "of the squared error",
    "more is no servo's answer to unknown torques (lab/speed/servo_axes.py)",
    "servo",
)
TAKEN_BY_FEW_PERIODS = _number(
    "TAKEN_BY_FEW_PERIODS", LEVEL, 0.8, "of the squared error", "no sine of a few periods takes that by chance", "servo"
)
ORDER_BY_CHANCE = _number("ORDER_BY_CHANCE", LEVEL, 0.01, "p-value", "over all orders looked at", "force_orders")
HOPE = _number("HOPE", LEVEL, 2.0, "times a linear gain", "that a rival may still come to", "search")
ALIKE_C = _number("ALIKE_C", LEVEL, 10.0, "C", "a likelihood ratio of 150", "search")
LEAVES_MUCH = _number("LEAVES_MUCH", LEVEL, 1.5, "chi2 / n", "an excess of half the noise", "search")
SECANT_ERROR = _number("SECANT_ERROR", LEVEL, 100.0, "chi2", "by which a secant may misjudge a confounder", "search")
SLACK = _number("SLACK", LEVEL, 0.02, "of a gain", "the same of a large one", "search")
NEARLY = _number("NEARLY", LEVEL, 2.0, "times chi2", "a simpler form to build on", "search")
ONE_MOTION = _number("ONE_MOTION", LEVEL, 1e-3, "log chi2", "half of SAME: one motion, made at another place", "search")
LEADS_NOWHERE = _number("LEADS_NOWHERE", LEVEL, 0.7, "times chi2", "of the round before", "led_search")
REFINED_BELOW = _number("REFINED_BELOW", LEVEL, 40.0, "chi2 / n", "ten times LACKS", "led_search")
MOMENTS = _number("MOMENTS", LEVEL, 1.2, "chi2 / n", "that wrong moments of events leave", "led_search")
RELEASED_WITHIN = _number(
    "RELEASED_WITHIN", LEVEL, 2.0, "times the least chi2", "structures that are fitted to the free run as well", "led_search"
)
CRAWLS = _number("CRAWLS", LEVEL, 0.01, "log chi2 an iteration", "FORMS of it do not bring it near", "search")
ELSEWHERE = _number("ELSEWHERE", LEVEL, 2.0, "times chi2", "a warm start from there leads to no better minimum", "search")
REFITTED_WITHIN = _number("REFITTED_WITHIN", LEVEL, 3.0, "times chi2", "rivals that are fitted again", "search")
HALF = _number("HALF", LEVEL, 0.5, "of a weight", "below which a new one is worth the fits", "search")
EXPLAINS_MUCH = _number("EXPLAINS_MUCH", LEVEL, 0.33, "of chi2", "what the best addition leaves", "search")
BEHIND = _number(
    "BEHIND", LEVEL, (3.0, 1.5, 1.1), "times chi2", "rivals extended: much left, coloured noise, noise alone", "search"
)
BETTER_NUMBERS = _number("BETTER_NUMBERS", LEVEL, 0.9, "times chi2", "another base to build on", "search")
ORDERS_FROM = _number("ORDERS_FROM", LEVEL, 1.02, "chi2 / n", "two standard deviations at 20,000 samples", "search")
LACKS = _number("LACKS", LEVEL, 4.0, "chi2 / n", "twice the noise rms: no wrong moment leaves that under a close gain", "led")
STAYS = _number("STAYS", LEVEL, 0.5, "of the excess above noise", "under an observer gain", "led")
RESTARTED_BELOW = _number("RESTARTED_BELOW", LEVEL, 2.0, "chi2 / n", "lower minima about a fit are looked for", "led")
RIVAL = _number("RIVAL", LEVEL, 0.1, "log chi2", "two effects that a structure could not tell apart", "led")
LITTLE = _number("LITTLE", LEVEL, 0.02, "log chi2", "next to nothing", "led")
NEARBY = _number("NEARBY", LEVEL, 1.5, "times chi2", "a nonsmooth structure may be the best", "led")
SMOOTH = _number("SMOOTH", LEVEL, 1.005, "chi2 / n", "half a standard deviation: nothing to gain", "led")
SAME_SIZE = _number("SAME_SIZE", LEVEL, 0.5, "C", "a structure of the same size must be ahead", "search")
INEXACT = _number("INEXACT", LEVEL, 0.5, "of chi2", "an inexact law leaves no more", "search")
PROMISING = _number("PROMISING", LEVEL, 0.33, "of chi2", "promised to be left", "search")
HOPEFUL = _number("HOPEFUL", LEVEL, 0.4, "of the entry", "that a refinement must promise", "search")
FROM_AFAR = _number("FROM_AFAR", LEVEL, 1.2, "times chi2", "of a base, above which its numbers may lead elsewhere", "search")
OTHER_ORDER = _number("OTHER_ORDER", LEVEL, 0.02, "relative", "two orders", "search")
WRONG_SIGN = _number("WRONG_SIGN", LEVEL, 0.3, "of a gain", "counted for an amplitude of the wrong sign", "flow")
REFUSED = _number("REFUSED", LEVEL, 4.0, "entries", "a refused structure may bear out another filter", "passes")
TAKEN = _number("TAKEN", LEVEL, 4.0, "noise variances", "noise taken for response: at most twice its rms", "passes")
OFFSET = _number("OFFSET", LEVEL, 0.01, "of the mean square", "in a mean", "passes")
MOVED = _number("MOVED", LEVEL, 1e-3, "of a number", "another guess of it", "minima")
MISFIT = _number("MISFIT", LEVEL, 3.0, "chi2 / n", "FAR: nominal numbers guide the search", "passes")
BETTER = _number("BETTER", LEVEL, 0.9, "times chi2", "another minimum of the nominal structure", "passes")
GONE = _number("GONE", LEVEL, math.log(1.5), "log of a ratio", "a number that stands in for a missing body", "passes")
PROMISED = _number("PROMISED", LEVEL, 0.3, "of a promised gain", "a rival is short of it", "passes")
LEAVES = _number("LEAVES", LEVEL, 1.1, "chi2 / n", "an excess that a part of the samples tells", "look")
FAITHFUL = _number(
    "FAITHFUL", LEVEL, (0.5, 0.05), "of the excess above noise", "by which a decimated run may differ: smooth, nonsmooth", "look"
)
MIMIC = _number("MIMIC", LEVEL, 2e-3, "of a direction", "that the model's own numbers leave", "torque_map")
RICHER = _number("RICHER", LEVEL, 0.05, "of the cross-validated cost", "that a second variable must save", "torque_map")
MAP_FAR = _number("MAP_FAR", LEVEL, 1.25, "times a screened cost", "of the best fitted map", "torque_map")
MAP_MATERIAL = _number("MAP_MATERIAL", LEVEL, 0.02, "of the held-out squared error", "that a map must gain", "torque_map")
P_MAP = _number("P_MAP", LEVEL, 0.01, "p-value", "of that gain, over the maps tried", "torque_map")
SECOND_MATERIAL = _number(
    "SECOND_MATERIAL", LEVEL, 0.10, "of the held-out squared difference", "less is encoder error", "second_encoder"
)
SECOND_P = _number("SECOND_P", LEVEL, 0.01, "p-value", "times the number of terms", "second_encoder")
FURTHER = _number("FURTHER", LEVEL, 3.0, "times the travel", "an experiment that goes further is not asked for", "flow")
TWO_SIDED = _number("TWO_SIDED", LEVEL, 1.96, "standard errors", "half a 95 % interval of a normal distribution", "intervals")
HIGHEST_TRIAL = _number(
    "HIGHEST_TRIAL", COST, 60.0, "Hz", "top of a proposed chirp, at most a tenth of the sampling rate", "flow"
)
REACHED = _number(
    "REACHED", LEVEL, 0.98, "of the force limit", "from which the nominal run of a servo determines the limit", "servo_logs"
)
POWER = _number(
    "POWER", LEVEL, 20.0, "material errors", "that the nominal model must leave for a test to mean something", "astray"
)
HELD_OUT_SHOWS = _number(
    "HELD_OUT_SHOWS", LEVEL, 1.1, "of the noise rms", "a held-out error of a model that leaves none where it was fitted", "flow"
)

# Costs: how much work a decision is worth
LONG = _number("LONG", COST, 8.0, "runs", "of the nominal model, that one of a slow structure takes", "search")
FIRST = _number("FIRST", COST, 6, "rivals", "that go on after the first look", "search")
ENTRANT = _number("ENTRANT", COST, 250, "runs", "of a first look", "search")
PORTION = _number("PORTION", COST, 4, "rivals", "at a time where little is left", "search")
SLOW_RUNS = _number("SLOW_RUNS", COST, 100, "runs", "of one that is slow to run, in its own", "search")
HALVINGS = _number(
    "HALVINGS",
    COST,
    ((6, 3, 1.5), (4, 6, 0.4), (3, 20, 0.05)),
    "rivals, iterations, log chi2",
    "how many go on, for how long, how far behind",
    "search",
)
LIKELY = _number("LIKELY", COST, 3, "orders", "to which a position-locked effect may move", "search")
ROUNDS = _number("ROUNDS", COST, 2, "effects", "that are sought", "led_search")
OBSERVER_PART = _number("OBSERVER_PART", COST, 0.5, "of the budget left", "for the search under an observer gain", "led_search")
WIDTH = _number("WIDTH", COST, 6, "rivals", "of a round", "led_search")
MOST_RELEASED = _number("MOST_RELEASED", COST, 3, "structures", "that are fitted to the free run", "led_search")
FORMS = _number("FORMS", COST, 30, "iterations", "of a simpler or poorer structure", "search")
WEIGHED = _number("WEIGHED", COST, 12, "iterations", "under another weight of the prior", "search")
SHORTER = _number("SHORTER", COST, 4, "iterations", "of one that is slow to run", "search")
CREEPS = _number("CREEPS", COST, 2, "effects", "in a row that explain little of much", "search")
SHORT = _number("SHORT", COST, 2.0, "runs", "of the nominal model, of one that is restarted always", "led")
RELEASES = _number("RELEASES", COST, 3, "homotopies", "in a search", "led")
HORIZON_ROUNDS = _number("HORIZON_ROUNDS", COST, 3, "times", "in a row, while it gains", "led")
FEWER = _number("FEWER", COST, 4, "rivals", "beside noise alone", "search")
MOST_FILTERS = _number("MOST_FILTERS", COST, 2, "searches", "on whitened errors", "passes")
SWUNG = _number("SWUNG", COST, 3, "orders", "of a varying inertia", "passes")
STARTS = _number("STARTS", COST, 6, "starts", "of the nominal structure", "passes")
ABOUT = _number("ABOUT", COST, 0.25, "log of a ratio", "their spread", "passes")
MORE = _number("MORE", COST, 2, "starts", "of a rival that is short of its promise", "passes")
BESIDE_NOMINAL = _number("BESIDE_NOMINAL", COST, 3, "rivals", "tried for their promise beside the nominal numbers", "look")
LEAST_SAMPLES = _number("LEAST_SAMPLES", COST, 5000, "samples", "of a first look", "look")
MAP_RUNS = _number("MAP_RUNS", COST, 1500, "runs", "after which no further map is tried", "torque_map")
TRIED = _number("TRIED", COST, 3, "maps", "that are fitted in the model", "torque_map")
TELLING = _number("TELLING", COST, 5000, "samples", "by which maps are screened", "torque_map")
JUDGED = _number("JUDGED", COST, 8, "rivals", "whose held-out error is computed for the report", "report/test_page")
TOLD = _number("TOLD", COST, 3, "refusals", "that are told in words", "real_logs/test_refusals")
LEADING = _number("LEADING", COST, 8, "rivals", "whose refusal is told", "flow")
SECOND_SPLIT = _number(
    "SECOND_SPLIT", COST, 1 / 3, "of the budget", "for a search of another split, whatever the first took", "flow"
)
RUNS = _number("RUNS", COST, 14_000, "runs", "some 20 s for 10 s at 2 kHz on two cores", "led_search")

# Numerics: tolerances, grids and filters
CLUSTERS = _number("CLUSTERS", NUMERIC, 40, "stretches", "standard errors to 11 %", "real_logs/test_coverage")
FACTORS = _number(
    "FACTORS",
    NUMERIC,
    (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 32, 40, 50, 64, 80, 100),
    "samples",
    "by which a filtered log is sampled more slowly",
    "real_logs/test_content",
)
FEWEST_LEFT = _number("FEWEST_LEFT", NUMERIC, 250, "samples", "of a slower recording", "real_logs/test_content")
AT_BOUND = _number("AT_BOUND", NUMERIC, 1e-6, "log of a ratio", "a number stands at its bound", "real_logs/test_bounds")
SOME_ANGLES = _number("SOME_ANGLES", NUMERIC, 200, "angles", "at which laws are compared", "real_logs/test_weight")
SEGMENT = _number("SEGMENT", NUMERIC, 1024, "samples", "2 Hz apart at 2 kHz", "noise")
BANDS = _number("BANDS", NUMERIC, 16, "bands", "of the spectrum, up to half the Nyquist frequency", "noise")
FEWEST_SEGMENTS = _number("FEWEST_SEGMENTS", NUMERIC, 8, "segments", "at least, for a coherence", "noise")
SENSOR_TAPS = _number("SENSOR_TAPS", NUMERIC, 40, "samples", "of a filter between the sensors: 20 ms at 2 kHz", "noise")
SENSOR_TAPS_AHEAD = _number("SENSOR_TAPS_AHEAD", NUMERIC, 8, "samples", "of them ahead", "noise")
TURNS = _number(
    "TURNS",
    NUMERIC,
    (1.0, 2.0, 3.0, 4.0, 6.0, 8.0),
    "orders",
    "eccentricity, coupling, pole pairs, and their multiples",
    "scales",
)
DITHER_SAMPLES = _number("DITHER_SAMPLES", NUMERIC, 4000, "samples", "a noise rms to 1 %", "look")
DITHER = _number("DITHER", NUMERIC, (0.01, 0.1, 0.2, 0.3, 0.45), "steps", "beyond 0.6 rounding acts as white noise", "look")
MOST_SUBSTEPS = _number(
    "MOST_SUBSTEPS", NUMERIC, 12, "steps a sample", "a fit that wanders to a stiffer model has left the plausible", "look"
)
STIFFER = _number("STIFFER", NUMERIC, 3, "times the nominal stiffness", "or one that is stiffer than that", "look")
KEPT_TORQUES = _number("KEPT_TORQUES", NUMERIC, 8, "arrays", "structures that are fitted at a time", "look")
PRIOR = _number(
    "PRIOR", NUMERIC, 0.5, "relative standard deviation", "a nominal number is right within a factor of two", "search"
)
ENGINE = _number("ENGINE", NUMERIC, 0.007, "of the noise rms", "error of the fitting engine, or of the plant's own", "search")
ROUGHLY = _number("ROUGHLY", NUMERIC, 2e-4, "relative gain of an iteration", "far below SAME", "search")
RK4 = _number("RK4", NUMERIC, 3.5, "times a product", "of a step that laws make nonlinear", "search")
ANEW = _number("ANEW", NUMERIC, 5, "iterations", "by secants before the Jacobian is computed anew", "search")
ANEWS = _number("ANEWS", NUMERIC, 3, "times", "that it is computed anew", "search")
LEVELS_OFF = _number("LEVELS_OFF", NUMERIC, 1e-3, "relative gain", "half of SAME", "search")
STARTS_FITTED = _number("STARTS_FITTED", NUMERIC, 8, "starts", "of an effect, ranked by cost", "search")
HORIZONS = _number(
    "HORIZONS", NUMERIC, (0.04, 0.06, 0.1, 0.16, 0.25, 0.4, 0.63), "of a recording", "each about 1.6 times the last", "unfolding"
)
GAINS = _number(
    "GAINS",
    NUMERIC,
    (1000.0, 560.0, 300.0, 170.0, 100.0, 56.0, 30.0, 17.0, 10.0, 5.6, 3.0, 1.0, 0.0),
    "1/s",
    "from a memory of 1 ms to the free run, by 1.8",
    "led",
)
FEW_GAINS = _number("FEW_GAINS", NUMERIC, (300.0, 100.0, 30.0, 10.0), "1/s", "the same by 3", "led")
CLOSELY = _number("CLOSELY", NUMERIC, 300.0, "1/s", "a memory of 3 ms: hardly any minima but one", "led")
DRAWS = _number("DRAWS", NUMERIC, 3, "sets", "of points, where an event was lost", "led")
RESTARTS = _number("RESTARTS", NUMERIC, 12, "sets", "of points about a fit", "led")
PATIENCE = _number("PATIENCE", NUMERIC, 3, "sets", "in a row that lead nowhere", "led")
POOLED_SLOWLY = _number(
    "POOLED_SLOWLY", NUMERIC, 0.01, "relative gain of an iteration", "where FAR times the noise is left", "search"
)
GRID = _number("GRID", NUMERIC, 2**14, "frequencies", "finer than any resonance of 24 lags", "whiten")
GUIDE = _number("GUIDE", NUMERIC, 0.2, "relative standard deviation", "of nominal numbers beside a large misfit", "whiten")
PUT_RIGHT = _number("PUT_RIGHT", NUMERIC, 56.0, "1/s", "corrects a model before its next event", "search")
LEAD = _number("LEAD", NUMERIC, 30.0, "1/s", "a memory of 33 ms, under which nonsmooth rivals are judged", "led")
ORDERS_BESIDE = _number("ORDERS_BESIDE", NUMERIC, 12, "orders", "each side, a quarter of a line's width apart", "encoder")
FORCE_TAPS = _number("FORCE_TAPS", NUMERIC, 50, "taps", "of the whitening filter", "force_orders")
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
ORDER_TAPS = _number("ORDER_TAPS", NUMERIC, 8, "taps", "level the residual's spectrum", "orders")
BETWEEN = _number("BETWEEN", NUMERIC, 100.0, "1/s", "between CLOSELY and LEAD", "led")
WIDE = _number("WIDE", NUMERIC, (1e-2, 3e-3), "scaled parameters", "secants wider than the steps of a cost", "led")
COARSE = _number("COARSE", NUMERIC, 0.33, "rad", "a step of the fastest motion in a first look", "look")
INTERVALS = _number("INTERVALS", NUMERIC, (12, 5), "intervals", "of a map of one variable, and of each of two", "torque_map")
FOLDS = _number("FOLDS", NUMERIC, 5, "folds", "of a cross-validation", "torque_map")
STRETCHES = _number("STRETCHES", NUMERIC, 20, "stretches", "of a recording, dealt to the folds", "torque_map")
STRAIGHT = _number("STRAIGHT", NUMERIC, 1e-10, "of a second difference", "a straight line, by rounding", "torque_map")
RIDGE = _number("RIDGE", NUMERIC, 1e-6, "of a column's square", "what other stretches do not show stays zero", "torque_map")
STILL = _number("STILL", NUMERIC, 0.01, "of a cost", "the fit goes on while it falls by more", "torque_map")
SECOND_BLOCKS = _number("SECOND_BLOCKS", NUMERIC, 40, "blocks", "of a recording", "second_encoder")
AHEAD_SECONDS = _number("AHEAD_SECONDS", NUMERIC, (0.005, 0.05, 0.25), "s", "how far ahead predictions are judged", "ahead")
AHEAD_ORDER = _number("AHEAD_ORDER", NUMERIC, 300, "lags", "white noise hides a slow error from a short model", "ahead")
EVENTS = _number(
    "EVENTS", NUMERIC, (30.0, 56.0, 100.0, 170.0), "1/s", "observer gains at which a diverging model is judged", "astray"
)
SCREENED = _number("SCREENED", NUMERIC, 0.15, "of a round", "when its rivals have been screened", "progress")
BEGUN = _number("BEGUN", NUMERIC, 0.75, "of a round", "when each has been begun", "progress")
TAIL = _number("TAIL", NUMERIC, 0.5, "rounds", "what follows the search", "progress")
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
