"""The report's claims, each with a criterion in numbers, and the rule that makes a verdict of the map.

One set of thresholds serves all claims, so that none is fitted to its own result: a frequency has moved when it moves by more
than 1 % (0.17 to 0.33 Hz here, what a reader sees in a printed Bode plot); "a bit" is from 0.2 to 5 %; a magnitude has changed
when it changes by more than 1 dB; "much" is 6 dB.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from lab.study.cell import GRID_HZ, Feature, Result, band, features_of
from lab.study.plants import FEATURE_NAMES, nominal, response

__all__ = [
    "AGREED",
    "CLAIMS",
    "DECIDING",
    "THRESHOLDS",
    "Claim",
    "Group",
    "Outcome",
    "Reading",
    "Thresholds",
    "Verdict",
    "VoidError",
    "ask",
    "judge",
    "physical_features",
]


@dataclass(frozen=True)
class Thresholds:
    """moved [%]: a frequency has moved. bit [%]: by a bit. changed [dB]: a magnitude has changed. much [dB]: by much."""

    moved: float = 1.0
    bit: tuple[float, float] = (0.2, 5.0)
    changed: float = 1.0
    much: float = 6.0

    def times(self, factor: float) -> Thresholds:
        """All of them wider or narrower, to see how much a verdict owes to them."""
        return Thresholds(
            factor * self.moved, (factor * self.bit[0], factor * self.bit[1]), factor * self.changed, factor * self.much
        )


THRESHOLDS = Thresholds()
AGREED = 0.9
"""Share of the deciding variants, in both families, from which on a claim holds; 1 - AGREED, below which it fails."""
DECIDING = 1 / 3
"""A family in which fewer variants than this share decide has no vote."""

Group = Mapping[str, Result]
"""Results of all cases under one variant, by the name of the case."""


class VoidError(Exception):
    """The variant cannot answer: the motor sticks, or the model has no such peak to compare with."""


@dataclass(frozen=True)
class Outcome:
    """Whether the criterion is met (None: the variant cannot say), and the figures behind it."""

    met: bool | None
    values: Mapping[str, Any]


class Verdict(Enum):
    """Over the whole map."""

    HOLDS = "holds"
    FAILS = "fails"
    DEPENDS = "depends"


class Reading(Enum):
    """What a claim about the second peak rests on."""

    PHYSICS = "physics: it is there too when the excitation reaches the peak and the model can place it"
    ARTEFACT = "extrapolation artefact: seen only where the second peak lies outside the excitation or the model misplaces it"
    ABSENT = "not there: neither with the peak extrapolated nor with it inside the excitation"


@dataclass(frozen=True)
class Claim:
    """A sentence of the report, its criterion in words and the same as a function of one variant's results."""

    id: str
    text: str
    criterion: str
    test: Callable[[Group, Thresholds], tuple[bool, dict[str, Any]]]
    second_peak: bool = False


def ask(claim: Claim, group: Group, thresholds: Thresholds = THRESHOLDS) -> Outcome:
    """Put a claim to one variant."""
    try:
        met, values = claim.test(group, thresholds)
    except VoidError as why:
        return Outcome(None, {"void": str(why)})
    return Outcome(met, {k: round(v, 4) if isinstance(v, float) else v for k, v in values.items()})


def judge(met: Mapping[str, list[bool | None]]) -> tuple[Verdict, dict[str, float]]:
    """The verdict from the answers by family, and each family's share of yes."""
    shares: dict[str, float] = {}
    for family, answers in met.items():
        decided = [a for a in answers if a is not None]
        if answers and len(decided) >= DECIDING * len(answers) and decided:
            shares[family] = sum(decided) / len(decided)
    if shares and all(s >= AGREED for s in shares.values()):
        return Verdict.HOLDS, shares
    if shares and all(s <= 1 - AGREED + 1e-12 for s in shares.values()):
        return Verdict.FAILS, shares
    return Verdict.DEPENDS, shares


def _result(g: Group, plant: str) -> Result:
    if g[plant].void:
        raise VoidError(f"{plant}: {g[plant].void}")
    return g[plant]


def _feature(g: Group, plant: str, name: str) -> Feature:
    found = _result(g, plant).features.get(name)
    if found is None:
        raise VoidError(f"{plant}: its model has no {name.replace('_', ' ')}")
    return found


def _moved(g: Group, base: str, plant: str, name: str) -> float:
    """Shift of a feature's frequency [%]."""
    return 100.0 * (_feature(g, plant, name).hz / _feature(g, base, name).hz - 1.0)


def _raised(g: Group, base: str, plant: str, name: str) -> float:
    """Change of a feature's magnitude [dB]."""
    return _feature(g, plant, name).db - _feature(g, base, name).db


def _rms_db(g: Group, a: str, b: str, low: float = 1.0, high: float = 30.0) -> float:
    """Root mean square difference of two magnitudes between low and high [Hz], in dB on a log axis."""
    inside = band(GRID_HZ, low, high)
    da, db = (np.asarray(_result(g, p).magnitude_db)[inside] for p in (a, b))
    return float(np.sqrt(np.mean((da - db) ** 2)))


def _mean_db(g: Group, a: str, b: str, low: float, high: float) -> float:
    inside = band(GRID_HZ, low, high)
    da, db = (np.asarray(_result(g, p).magnitude_db)[inside] for p in (a, b))
    return float(np.mean(db - da))


def _top_phase(g: Group, plant: str) -> float:
    """Largest phase [deg] between 8 and 29 Hz."""
    inside = band(GRID_HZ, 8.0, 29.0)
    return float(np.max(np.asarray(_result(g, plant).phase_deg)[inside]))


def _falls(values: list[float], by: float) -> bool:
    """Whether every next value is lower, the last by more than ``by`` below the first."""
    return all(b < a for a, b in pairwise(values)) and values[0] - values[-1] > by


@cache
def physical_features() -> dict[str, Feature]:
    """Peaks and notches of the linear model's exact response."""
    from ident import Bode

    f = np.geomspace(0.4, 99.0, 20001)
    found = features_of(Bode(f, response(nominal(), f), 0 * f, 0 * f).extrema())
    assert all(found.values())
    return {k: v for k, v in found.items() if v is not None}


BOTH_NOTCHES_AND_FIRST_PEAK = ("first_notch", "first_peak", "second_notch")


def _l1(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    values: dict[str, Any] = {}
    exact, r = physical_features(), _result(g, "linear")
    for name in FEATURE_NAMES:
        found = r.features.get(name)
        values[f"{name}_hz"] = None if found is None else found.hz
        values[f"{name}_off_percent"] = None if found is None else 100 * (found.hz / exact[name].hz - 1)
        values[f"{name}_in_place"] = found is not None and abs(values[f"{name}_off_percent"]) <= t.moved
    return all(values[f"{n}_in_place"] for n in FEATURE_NAMES), values


NONLINEAR = ("coulomb_1", "coulomb_2", "coulomb_3", "static_2", "static_5", "gap_1", "gap_5", "gap_10", "torque_50", "torque_20")


def _l2(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    at = int(np.argmin(np.abs(GRID_HZ - 20.5)))  # midway between first notch and first peak
    base = _result(g, "linear").phase_deg[at]
    by_sign = _result(g, "damping_positive").phase_deg[at] - base
    others = {p: g[p].phase_deg[at] - base for p in NONLINEAR if not g[p].void}
    alike = sorted(p for p, d in others.items() if abs(d) > 180.0)
    values = {
        "phase_linear_deg": base, "change_by_sign_of_dg_deg": by_sign,
        "magnitude_rms_db": _rms_db(g, "linear", "damping_positive"),
        "other_causes_of_the_same_change": alike, "sign_of_dg_turns_the_phase": abs(by_sign) > 180.0,
        "nothing_else_turns_it": not alike,
    }  # fmt: skip
    return abs(by_sign) > 180.0 and not alike, values


def _f1(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    cases = ("linear", "coulomb_1", "coulomb_2", "coulomb_3")
    low = [_result(g, c).low_db for c in cases]
    return _falls(low, t.changed), {f"{c}_db": v for c, v in zip(cases, low, strict=True)}


def _f2(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    moved = {
        f"{c}_{n}_percent": _moved(g, "linear", c, n)
        for c in ("coulomb_1", "coulomb_2", "coulomb_3")
        for n in ("first_notch", "first_peak")
    }
    parts = {f"{n}_kept": all(abs(v) <= t.moved for k, v in moved.items() if n in k) for n in ("first_notch", "first_peak")}
    return all(parts.values()), parts | moved


def _f3(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    moved = {f"{n}_percent": _moved(g, "linear", "coulomb_3", n) for n in ("second_notch", "second_peak")}
    parts = {f"{n}_higher": moved[f"{n}_percent"] > t.moved for n in ("second_notch", "second_peak")}
    return all(parts.values()), parts | moved


def _f4(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    moved = {f"{c}_percent": _moved(g, "linear", c, "second_peak") for c in ("coulomb_1", "coulomb_2")}
    return all(t.bit[0] <= -v <= t.bit[1] for v in moved.values()), moved


def _f5(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    raised = _raised(g, "linear", "coulomb_1", "second_peak")
    return raised > t.much, {"second_peak_db": raised}


def _s1(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    values = {"magnitude_rms_db": _rms_db(g, "coulomb_2", "static_2")}
    values |= {f"{n}_percent": _moved(g, "coulomb_2", "static_2", n) for n in FEATURE_NAMES}
    return values["magnitude_rms_db"] <= t.changed and all(abs(values[f"{n}_percent"]) <= t.moved for n in FEATURE_NAMES), values


def _s2(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    raised = _raised(g, "coulomb_2", "static_5", "second_peak")
    return raised < -t.changed, {"second_peak_db": raised}


def _fall(g: Group, t: Thresholds, cases: tuple[str, ...]) -> tuple[bool, dict[str, Any]]:
    values: dict[str, Any] = {}
    for name in BOTH_NOTCHES_AND_FIRST_PEAK:
        hz = [_feature(g, c, name).hz for c in cases]
        values |= {f"{c}_{name}_hz": v for c, v in zip(cases, hz, strict=True)}
        values[f"{name}_falls"] = _falls(hz, t.moved / 100 * hz[0])
    return all(values[f"{n}_falls"] for n in BOTH_NOTCHES_AND_FIRST_PEAK), values


def _keeps(g: Group, t: Thresholds, cases: tuple[str, ...]) -> tuple[bool, dict[str, Any]]:
    moved = {f"{c}_percent": _moved(g, cases[0], c, "second_peak") for c in cases[1:]}
    return all(abs(v) <= t.moved for v in moved.values()), moved


GAPS = ("linear", "gap_1", "gap_5", "gap_10")
TORQUES = ("gap_1", "torque_50", "torque_20")


def _b3(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    values: dict[str, Any] = {f"{c}_phase_deg": _top_phase(g, c) for c in GAPS}
    values |= {f"{c}_zero_real": g[c].zero_real for c in GAPS}
    return values["linear_phase_deg"] <= 0.0 < values["gap_10_phase_deg"], values


def _i1(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    values: dict[str, Any] = {}
    for less, larger in (("torque_50", "gap_2"), ("torque_20", "gap_5")):
        for n in BOTH_NOTCHES_AND_FIRST_PEAK:
            values[f"{less}_against_{larger}_{n}_percent"] = _moved(g, larger, less, n)
    return all(abs(v) <= t.moved for v in values.values()), values


def _i4(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    values = {"magnitude_rms_db": _rms_db(g, "gap_5", "torque_20")}
    values |= {f"{n}_percent": _moved(g, "gap_5", "torque_20", n) for n in BOTH_NOTCHES_AND_FIRST_PEAK}
    return values["magnitude_rms_db"] <= t.changed and all(
        abs(values[f"{n}_percent"]) <= t.moved for n in BOTH_NOTCHES_AND_FIRST_PEAK
    ), values


SIMILAR = 15.0
"""A feature is still the same one [%]."""


def _x1(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    for name in FEATURE_NAMES:
        _feature(g, "linear", name)
    lost, far = [], 0.0
    for plant in NONLINEAR:
        if g[plant].void:
            continue
        for name in FEATURE_NAMES:
            if g[plant].features.get(name) is None:
                lost.append(f"{plant}: {name}")
            else:
                shift = _moved(g, "linear", plant, name)
                far = shift if abs(shift) > abs(far) else far
    turned = [p for p in NONLINEAR if (z := g[p].zero_real) is not None and z * (_result(g, "linear").zero_real or math.nan) < 0]
    values = {"largest_shift_percent": far, "lost": lost, "first_notch_changes_phase_character": turned}
    return not lost and abs(far) <= SIMILAR, values


def _x2(g: Group, t: Thresholds) -> tuple[bool, dict[str, Any]]:
    bands = {"1_5": (1.0, 5.0), "5_12": (5.0, 12.0), "20_29": (20.0, 29.0)}
    values: dict[str, Any] = {f"friction_{k}_hz_db": _mean_db(g, "linear", "coulomb_3", *b) for k, b in bands.items()}
    values |= {f"friction_{n}_percent": _moved(g, "linear", "coulomb_3", n) for n in FEATURE_NAMES}
    values |= {f"backlash_{n}_percent": _moved(g, "linear", "gap_10", n) for n in FEATURE_NAMES}
    friction_everywhere = all(abs(values[f"friction_{k}_hz_db"]) > t.changed for k in bands)
    friction_peak = abs(values["friction_second_peak_percent"]) > t.moved
    backlash_three = all(abs(values[f"backlash_{n}_percent"]) > t.moved for n in BOTH_NOTCHES_AND_FIRST_PEAK)
    backlash_peak = abs(values["backlash_second_peak_percent"]) <= t.moved
    parts = {
        "friction_changes_amplitude_everywhere": friction_everywhere, "friction_moves_second_peak": friction_peak,
        "backlash_moves_notches_and_first_peak": backlash_three, "backlash_keeps_second_peak": backlash_peak,
    }  # fmt: skip
    return all(parts.values()), parts | values


CLAIMS: tuple[Claim, ...] = (
    Claim("L1", "The linear model's Box-Jenkins Bode plot has two notches and two peaks where the physics puts them.",
          "all four within 1 % of the exact response's", _l1, second_peak=True),
    Claim("L2", "The phase difference to a robot comes from the negative damping coefficient.",
          "turning the sign of dg turns the phase between first notch and first peak by more than 180 deg, and none of the "
          "friction and backlash cases, dg left negative, does the same", _l2),
    Claim("F1", "The low-frequency amplitude falls as Coulomb friction grows.",
          "mean magnitude over 1 to 3 Hz falls from case to case, by more than 1 dB from linear to case 3", _f1),
    Claim("F2", "First notch and first peak keep their frequency under Coulomb friction.",
          "both within 1 % of the linear case in cases 1, 2 and 3", _f2),
    Claim("F3", "Second notch and second peak are higher in frequency in case 3 than in the linear case.",
          "both higher by more than 1 %", _f3, second_peak=True),
    Claim("F4", "The second peak is a bit lower in frequency in cases 1 and 2.",
          "lower by 0.2 to 5 % in both", _f4, second_peak=True),
    Claim("F5", "The second peak's amplitude is much higher in case 1 than in the linear case.",
          "higher by more than 6 dB", _f5, second_peak=True),
    Claim("S1", "Static friction with peak 2 changes very little.",
          "rms difference to peak 1 over 1 to 30 Hz at most 1 dB, all four features within 1 %", _s1),
    Claim("S2", "With peak 5 the second peak's amplitude is lower.",
          "lower by more than 1 dB than with peak 1", _s2, second_peak=True),
    Claim("B1", "First notch, second notch and first peak fall in frequency as the gap grows.",
          "each falls from 0 to 1e-4, 5e-4, 1e-3 rad, by more than 1 % in all", lambda g, t: _fall(g, t, GAPS)),
    Claim("B2", "The second peak keeps its frequency under backlash.",
          "within 1 % of no backlash at each gap", lambda g, t: _keeps(g, t, GAPS), second_peak=True),
    Claim("B3", "With a larger gap the phase becomes positive.",
          "largest phase in 8 to 29 Hz at most 0 without gap, above 0 at 1e-3 rad", _b3),
    Claim("I1", "Less input torque at a fixed gap acts like a larger gap.",
          "both notches and the first peak at 50 % (20 %) torque within 1 % of those at twice (five times) the gap", _i1),
    Claim("I2", "First notch, second notch and first peak fall as the torque falls.",
          "each falls from 100 to 50 to 20 % torque, by more than 1 % in all", lambda g, t: _fall(g, t, TORQUES)),
    Claim("I3", "The second peak keeps its frequency as the torque falls.",
          "within 1 % of that at 100 % torque", lambda g, t: _keeps(g, t, TORQUES), second_peak=True),
    Claim("I4", "b = 5e-4 at 100 % and b = 1e-4 at 20 % torque are hardly different.",
          "rms difference over 1 to 30 Hz at most 1 dB, both notches and the first peak within 1 %", _i4),
    Claim("X1", "Nonlinearities do not change the basic characteristics of the black-box models.",
          "every nonlinear case has notch, peak, notch, peak in this order, each within 15 % of the linear case", _x1,
          second_peak=True),
    Claim("X2", "Friction affects the amplitude over the whole range and the frequency of the second peak; backlash the two "
          "notches and the first peak.",
          "case 3 changes the mean magnitude by more than 1 dB in 1-5, 5-12 and 20-29 Hz and moves the second peak by more than "
          "1 %; a gap of 1e-3 rad moves both notches and the first peak by more than 1 %, the second peak by less", _x2,
          second_peak=True),
)  # fmt: skip
