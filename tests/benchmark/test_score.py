"""Scoring by hand-made truths and findings: every way in which a case can end, the bars, power, arms, the page."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import WINDOWS, looks_right

from diagnose.report.components import data_table, theme_button
from diagnose.report.document import document
from lab.benchmark.cases import LEVELS
from lab.benchmark.grade import GRADES, Status, bars, fraction, parse_levels
from lab.benchmark.laws import Laws
from lab.benchmark.page import Manner, render_page
from lab.benchmark.page_pictures import OUTCOMES
from lab.benchmark.power import power_curve, power_curves, shares
from lab.benchmark.refit import LINEAR
from lab.benchmark.score import Outcome, alternatives, score_case
from lab.benchmark.score_arms import bic_result, refitted_result, score_arms
from lab.benchmark.score_table import summarise
from mjsim.errors import InputError

NOISE = 0.1


def truth(level: str, *keys: str, change: float = 1.0, **more: Any) -> dict[str, Any]:
    effects = [k.partition("@")[0] for k in keys]
    verdict = {"nothing": "no_mismatch", "parameters_only": "parameters_only", "out_of_library": "unexplained"}
    return {
        "level": level,
        "verdict": verdict.get(level, "missing_physics"),
        "effects": effects,
        "where": {k.partition("@")[0]: k.partition("@")[2] for k in keys},
        "parameters": {e: {"torque_Nm": 2.0} for e in effects},
        "law": dict.fromkeys(effects, "contract"),
        "size": {e: {"raw": 3.0, "after_refit": 2.0, "distinct": 1.0} for e in effects},
        "velocity_noise_rms_rad_s": NOISE,
        "noise_kind": "white",
        "linear_parameters": {n: getattr(Laws(), n) * change for n in LINEAR},
        **more,
    }


def finding(key: str, *equivalents: str, value: float = 2.02, ci: tuple[float, float] = (1.9, 2.1)) -> dict[str, Any]:
    effect, _, place = key.partition("@")
    parameters = {"torque_Nm": {"value": value, "ci95": list(ci), "unit": "N m"}}
    return {"effect": effect, "place": place, "parameters": parameters, "equivalents": list(equivalents)}


def said(verdict: str, *findings: dict[str, Any], after: float = 0.1, before: float = 0.3) -> dict[str, Any]:
    fit = {k: {"rms": v, "held_out_rms": v} for k, v in (("nominal", 1.0), ("refitted", before), ("corrected", after))}
    return {
        "verdict": verdict,
        "findings": list(findings),
        "fit": fit,
        "seconds": 2.0,
        "linear_parameters": {"Jm": {"value": Laws().Jm, "ci95": [0.9 * Laws().Jm, 1.1 * Laws().Jm]}},
    }


def logged(result: dict[str, Any], problem: str) -> dict[str, Any]:
    return {**result, "log": {"problems": [{"problem": problem, "recording": "a.csv"}]}}


CF, TO, AF, DA, DS = (
    "coulomb_friction@motor", "torque_offset@motor", "asymmetric_friction@motor", "time_delay@actuator", "time_delay@sensor",
)  # fmt: skip
MP, UN, NO, PO = "missing_physics", "unexplained", "no_mismatch", "parameters_only"

ENDS = [
    (truth("plain", CF), said(MP, finding(CF)), Outcome.RIGHT),
    (truth("plain", CF), said(MP, finding("static_friction@motor", "coulomb_friction")), Outcome.EQUIVALENT),
    (truth("plain", AF), said(MP, finding(TO), finding(CF)), Outcome.EQUIVALENT),
    (truth("two_effects", TO, CF), said(MP, finding(AF)), Outcome.EQUIVALENT),
    (truth("plain", CF), said(MP, finding(CF), finding("backlash@arm")), Outcome.EXTRA),
    (truth("two_effects", CF, DA), said(MP, finding(CF)), Outcome.PART),
    (truth("two_effects", CF, DA), said(MP, finding(DS), finding(CF)), Outcome.RIGHT),
    (truth("plain", CF), said(MP, finding("backlash@arm")), Outcome.WRONG_NAME),
    (truth("plain", CF), said(NO), Outcome.MISSED),
    (truth("plain", CF), said(PO), Outcome.MISSED),
    (truth("plain", CF), said(UN, finding(CF)), Outcome.UNEXPLAINED),
    (truth("plain", CF), {"error": "InputError: diverged"}, Outcome.ERROR),
    (truth("out_of_library", "held_rows@sensor"), said(UN), Outcome.RIGHT),
    (truth("out_of_library", "held_rows@sensor"), said(MP, finding(CF)), Outcome.WRONG_NAME),
    (truth("out_of_library", "held_rows@sensor"), said(NO), Outcome.MISSED),
    (truth("out_of_library", "held_rows@sensor"), logged(said(PO), "duplicated_rows"), Outcome.RIGHT),
    (truth("out_of_library", "held_rows@sensor"), logged(said(PO), "clipped"), Outcome.MISSED),
    (truth("out_of_library", "held_rows@sensor"), logged(said(MP, finding(CF)), "duplicated_rows"), Outcome.WRONG_NAME),
    (truth("plain", CF), logged(said(PO), "duplicated_rows"), Outcome.MISSED),
    (truth("out_of_library", "held_rows@sensor"), {**said(UN), "log": None}, Outcome.RIGHT),
    (truth("nothing"), said(NO), Outcome.RIGHT),
    (truth("nothing"), said(PO), Outcome.RIGHT),
    (truth("nothing"), said(MP, finding(CF)), Outcome.FALSE_ALARM),
    (truth("nothing"), said(UN), Outcome.UNEXPLAINED),
    (truth("parameters_only", change=1.05), said(NO), Outcome.RIGHT),
    (truth("parameters_only", change=1.2), said(NO), Outcome.SMALL),
    (truth("parameters_only", change=1.2), said(PO), Outcome.RIGHT),
    (truth("parameters_only", change=1.2), said(MP, finding(CF)), Outcome.FALSE_ALARM),
]


@pytest.mark.parametrize(("concealed", "result", "outcome"), ENDS)
def test_every_end(concealed: dict, result: dict, outcome: Outcome) -> None:
    score = score_case("001", concealed, result)
    assert score.outcome is outcome
    assert score.outcome.good == (outcome in (Outcome.RIGHT, Outcome.EQUIVALENT))
    assert outcome.value in OUTCOMES  # every end has a colour
    if outcome.good:
        assert score.verdict_right
        assert score.named or score.level == "out_of_library"


def test_equivalents_go_both_ways_and_together() -> None:
    assert alternatives([AF]) == {frozenset({AF}), frozenset({CF, TO})}
    assert frozenset({AF}) in alternatives([CF, TO])
    assert frozenset({CF, TO}) in alternatives([AF, TO])
    assert alternatives([DA]) == {frozenset({DA}), frozenset({DS})}
    assert frozenset({"a@b"}) in alternatives([CF], {CF: [["a@b"]]})


def test_a_place_counts_up_to_equivalents() -> None:
    assert score_case("1", truth("plain", DA), said(MP, finding(DS))).places == ((DA, True),)
    wrong = score_case("1", truth("plain", CF), said(MP, finding("coulomb_friction@arm")))
    assert wrong.places == ((CF, False),)
    assert wrong.outcome is Outcome.RIGHT  # the name is right; the place is scored by itself
    assert not wrong.parameters  # the torque at another place is another quantity
    left_open = score_case("1", truth("plain", CF), said(MP, finding("coulomb_friction@arm", CF)))
    assert left_open.places == ((CF, True),)


def test_parameters_and_phases() -> None:
    (p,) = score_case("1", truth("plain", CF), said(MP, finding(CF))).parameters
    assert (p.error, p.inside, p.counted) == (pytest.approx(0.01), True, True)
    (p,) = score_case("1", truth("plain", CF), said(MP, finding(CF, value=3.0, ci=(2.9, 3.1)))).parameters
    assert (p.error, p.inside) == (pytest.approx(0.5), False)
    turn = truth("plain", "torque_ripple@motor")
    turn["parameters"] = {"torque_ripple": {"phase_rad": 3.1, "cycles_per_rev": 4.0}}
    f = finding("torque_ripple@motor")
    f["parameters"] = {
        "phase_rad": {"value": -3.1, "ci95": [-3.3, -2.9]},
        "cycles_per_rev": {"value": 4.0, "ci95": [None, None]},
    }
    phase, cycles = score_case("1", turn, said(MP, f)).parameters
    assert phase.error == pytest.approx(2 * math.pi - 6.2)
    assert phase.inside
    assert (cycles.inside, cycles.counted) == (None, False)


def test_the_gap_is_measured_by_the_true_noise() -> None:
    assert score_case("1", truth("plain", CF), said(MP, finding(CF), after=0.12)).gap == pytest.approx(0.9)
    assert score_case("1", truth("plain", CF), said(NO, after=0.3)).gap == 0.0
    assert math.isnan(score_case("1", truth("plain", CF), said(NO, before=0.1005)).gap)


def test_bars_hold_fail_and_ask_for_more() -> None:
    right = [score_case(str(i), truth("plain", CF), said(MP, finding(CF))) for i in range(40)]
    calm = [score_case(str(i), truth("nothing"), said(NO)) for i in range(180)]
    wolf = [score_case(str(i), truth("nothing"), said(MP, finding(CF))) for i in range(10)]

    def status(cases: list) -> dict[str, Status]:
        return {b.id: b.status for b in bars(cases)}

    some = status(right + calm)
    assert some["plain"] is some["false_alarms"] is some["false_alarms_limit"] is some["gap_closed"] is Status.HOLDS
    assert some["pairs"] is some["hidden"] is some["out_of_library"] is Status.TOO_FEW
    assert some["coverage"] is Status.FAILS  # 40 of 40: the intervals are too wide
    assert status(calm + wolf)["false_alarms"] is Status.FAILS
    assert status(calm + wolf)["false_alarms_limit"] is Status.FAILS
    assert status(calm[:20])["false_alarms_limit"] is Status.TOO_FEW
    assert all(b.status is Status.TOO_FEW for b in bars([]))
    assert not next(b for b in bars(calm[:20]) if b.id == "false_alarms").certain


def test_hidden_effects_count_from_three_tenths_of_the_noise() -> None:
    faint = truth("under_noise", CF, size={"coulomb_friction": {"raw": 0.9, "after_refit": 0.2, "distinct": 0.2}})
    cases = [score_case("1", faint, said(NO)), score_case("2", truth("behind_refit", CF), said(MP, finding(CF)))]
    hidden = next(b for b in bars(cases) if b.id == "hidden")
    assert (hidden.n, hidden.value) == (1, 1.0)


def test_clopper_pearson() -> None:
    value, (low, high) = fraction(0, 91)
    assert value == low == 0.0
    assert high == pytest.approx(1 - 0.025 ** (1 / 91))
    assert math.isnan(fraction(0, 0)[0])
    # the full grade bears two false alarms
    nulls = GRADES["full"]["nothing"] + GRADES["full"]["parameters_only"]
    assert fraction(2, nulls)[1][1] <= 0.04


def test_levels_by_hand() -> None:
    assert parse_levels(None, "quick") == GRADES["quick"]
    assert parse_levels("plain:7, nothing", "full") == {"plain": 7, "nothing": 90}
    assert sum(GRADES["full"].values()) >= 300
    assert all(set(g) == set(LEVELS) for g in GRADES.values())
    for bad in ("plane:3", "plain:0", "plain:x", ""):
        with pytest.raises(InputError):
            parse_levels(bad, "quick")


def test_a_power_curve_finds_its_points() -> None:
    rng = np.random.default_rng(4)
    sizes = 10 ** rng.uniform(-2, 1, 2500)
    seen = rng.random(2500) < 1 / (1 + (sizes / 0.2) ** -2)
    curve = power_curve(sizes.tolist(), seen.tolist())
    assert curve.at50 == pytest.approx(0.2, rel=0.08)
    assert curve.at90 == pytest.approx(0.6, rel=0.12)  # odds 9 at 3 times the size
    assert curve.at50_ci95[0] < 0.2 < curve.at50_ci95[1]
    assert curve.at90_ci95[0] < 0.6 < curve.at90_ci95[1]
    assert curve.chance(np.array([curve.at50, curve.at90])) == pytest.approx([0.5, 0.9])
    apart = power_curve([0.1, 0.2, 0.3, 0.4, 1.0, 2.0, 3.0, 4.0], [False] * 4 + [True] * 4)
    assert 0.4 < apart.at50 < 1.0
    assert apart.at50_ci95[0] < 0.4 < 1.0 < apart.at50_ci95[1]  # eight cases say little
    bins = shares(sizes.tolist(), seen.tolist())
    assert sum(b.n for b in bins) == 2500
    assert sum(b.seen for b in bins) == seen.sum()
    assert all(a.high <= b.low for a, b in itertools.pairwise(bins))
    inside = [b.ci95[0] <= np.mean(curve.chance(np.geomspace(b.low, b.high, 50))) <= b.ci95[1] for b in bins]
    assert sum(inside) >= len(bins) - 1
    assert shares([1.0] * 15, [True] * 15) == ()
    for sizes_, seen_, word in (
        ([], [], "no cases"),
        ([1.0, 2.0], [True, True], "all 2"),
        ([1.0, 2.0], [False] * 2, "none of 2"),
        ([1.0, 2.0], [False, True], "too few"),
        ([1.0, 2, 3, 4, 5, 6, 7, 8], [True] * 4 + [False] * 4, "does not grow"),
    ):
        assert word in power_curve(sizes_, seen_).note


def test_intervals_of_few_cases_are_open_rather_than_wrong() -> None:
    sizes = [0.1, 0.2, 0.3, 0.4, 1.0, 2.0, 3.0, 4.0]
    vague = power_curve(sizes, [False, True, True, False, True, False, True, True])
    assert vague.at90_ci95[1] == math.inf
    assert vague.at90 > vague.at50
    blank = power_curve([1.0, 2.0], [False, True])
    assert math.isnan(blank.at50_ci95[0])


def _groups(rng: np.random.Generator, slope: float, count: int) -> tuple[dict, dict[str, float]]:
    """Groups of a few cases about middles of their own [decades]."""
    groups, middles = {}, {}
    for i in range(count):
        middles[str(i)] = middle = rng.normal(-1.2, 0.4)
        x = rng.uniform(-2.0, 0.5, rng.integers(5, 14))
        groups[str(i)] = ((10**x).tolist(), (rng.random(len(x)) < 1 / (1 + np.exp(-slope * (x - middle)))).tolist())
    return groups, middles


def test_groups_share_a_slope_and_have_points_of_their_own() -> None:
    rng = np.random.default_rng(7)
    groups, middles = _groups(rng, 5.0, 12)
    groups["all"] = ([0.05, 0.1, 0.2, 0.4, 0.8], [True] * 5)
    groups["none"] = ([0.01, 0.02], [False, False])
    groups["few"] = ([0.01, 0.02], [False, True])
    curves = power_curves(groups)
    slopes = {c.slope for c in curves.values() if not c.note}
    assert len(slopes) == 1
    assert slopes.pop() == pytest.approx(5.0, rel=0.5)
    for name, middle in middles.items():
        c = curves[name]
        if not c.note:
            assert math.log10(c.at50) == pytest.approx(middle, abs=0.5)
            assert c.chance(np.array([c.at50, c.at90])) == pytest.approx([0.5, 0.9], abs=0.01)
            assert c.at50_ci95[0] < c.at50 < c.at50_ci95[1]
    assert "all 5" in curves["all"].note
    assert curves["all"].at50_ci95[0] == 0.0  # none was missed: no limit from below
    assert 0.01 < curves["all"].at50_ci95[1] < 0.2
    assert "none of 2" in curves["none"].note
    assert "too few" in curves["few"].note
    assert "too few" in power_curves({"a": ([1.0, 2.0, 3.0, 4.0], [False, True, False, True])})["a"].note
    assert power_curves({"a": ([], [])})["a"].note == "no cases"


@pytest.mark.slow
def test_intervals_of_groups_hold_the_truth() -> None:
    rng = np.random.default_rng(3)
    held50, held90, n = 0, 0, 0
    for _ in range(30):
        groups, middles = _groups(rng, 5.0, 10)
        for name, c in power_curves(groups).items():
            if not math.isnan(c.at50_ci95[0]):
                n += 1
                held50 += c.at50_ci95[0] <= 10 ** middles[name] <= c.at50_ci95[1]
                held90 += c.at90_ci95[0] <= 10 ** (middles[name] + math.log(9) / 5) <= c.at90_ci95[1]
    assert n > 250
    for held in (held50, held90):
        low, high = fraction(held, n)[1]
        assert low <= 0.97
        assert high >= 0.93


@pytest.mark.slow
def test_intervals_of_the_points_hold_the_truth() -> None:
    rng = np.random.default_rng(11)
    held50, held90, n = 0, 0, 0
    for _ in range(300):
        sizes = 10 ** rng.uniform(-1.5, 1, 40)
        curve = power_curve(sizes.tolist(), (rng.random(40) < 1 / (1 + (sizes / 0.2) ** -2)).tolist())
        if curve.note:
            continue
        n += 1
        held50 += curve.at50_ci95[0] <= 0.2 <= curve.at50_ci95[1]
        held90 += curve.at90_ci95[0] <= 0.6 <= curve.at90_ci95[1]
    assert n > 280
    for held in (held50, held90):  # 95 % lies within the interval of the share that was found
        low, high = fraction(held, n)[1]
        assert low - 0.01 <= 0.95 <= high + 0.01


def test_arms() -> None:
    rivals = [
        {"effects": [CF], "parameters": 9, "rms": 0.100, "held_out_rms": 0.1, "criterion": 0.0},
        {"effects": [CF, TO], "parameters": 10, "rms": 0.0998, "held_out_rms": 0.11, "criterion": 4.0},
    ]
    result = {**said(MP, finding(CF)), "rivals": rivals, "rows": 10000}
    assert refitted_result(result)["verdict"] == "parameters_only"
    crowded = bic_result(result, 10000)
    assert crowded is not None
    assert [f["effect"] for f in crowded["findings"]] == ["coulomb_friction", "torque_offset"]
    spare = bic_result(result, 100)
    assert spare is not None
    assert [f["effect"] for f in spare["findings"]] == ["coulomb_friction"]
    nothing = bic_result({**said(NO, before=0.1), "rivals": [], "rows": 100}, 100)
    assert nothing is not None
    assert nothing["verdict"] == "no_mismatch"
    (_, _, refitted), (_, _, bic) = score_arms(
        {"a": truth("plain", CF), "b": truth("plain", CF)}, {"a": result, "b": {"error": "x"}}
    )
    assert [c.outcome for c in refitted] == [Outcome.MISSED]
    assert [c.outcome for c in bic] == [Outcome.EXTRA]


def _manner() -> Manner:
    def plain(x: float | None, *_: int) -> str:
        return "–" if x is None else f"{x:g}"

    return Manner(plain, plain, str, data_table, theme_button(), document)


def test_the_figures_are_json_and_the_page_stands_alone() -> None:
    truths = {f"{i:03d}": t for i, (t, _, _) in enumerate(ENDS)}
    results = {f"{i:03d}": r for i, (_, r, _) in enumerate(ENDS)}
    summary = summarise(truths, results)
    assert summary["n"] == len(ENDS)
    assert summary["right"]["hits"] == sum(o.good for *_, o in ENDS)
    assert summary["nulls"]["false_alarms"]["hits"] == 2
    assert summary["nulls"]["unexplained"]["hits"] == 1
    assert list(summary["errors"]) == ["011"]
    counts = np.array(summary["confusion"]["counts"])
    assert counts.sum() == sum(len(t["effects"]) < 2 for t in truths.values())
    about = {
        "grade": "quick",
        "seed": 1,
        "counts": {"plain": 2},
        "envelope_sha256": "0" * 64,
        "versions": {"simgap": "0"},
        "budget_s": 120.0,
    }
    plain = json.loads(json.dumps({**about, **summary}).replace("NaN", "null"))
    page, pictures = render_page(plain, _manner())
    assert set(pictures) >= {"levels", "power", "effects"}
    assert ("power_by_effect" in pictures) != ("curve of its own" in page)
    assert all(p.startswith("<?xml") for p in pictures.values())
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org/2000/svg", "")
    assert page.count("<script>") == 1  # the switch of colours
    assert "unsafe-inline" not in page
    assert " style=" not in page
    for anchor in ("bars", "levels", "power", "nulls", "numbers", "confusion", "arms", "wrong", "how"):
        assert f'id="{anchor}"' in page


@WINDOWS
def test_the_page_in_a_browser(browser: Any, tmp_path: Path, widths: tuple[int, ...]) -> None:
    summary = summarise({f"{i:03d}": t for i, (t, _, _) in enumerate(ENDS)}, {f"{i:03d}": r for i, (_, r, _) in enumerate(ENDS)})
    about = {"grade": "quick", "seed": 1, "counts": {}, "envelope_sha256": "0" * 64, "versions": {}, "budget_s": None}
    page, _ = render_page(json.loads(json.dumps({**about, **summary}).replace("NaN", "null")), _manner())
    (tmp_path / "benchmark.html").write_text(page, encoding="utf-8")
    looks_right(browser, tmp_path / "benchmark.html", widths=widths)


def test_a_page_of_nulls_alone() -> None:
    summary = summarise({"1": truth("nothing")}, {"1": said(NO)})
    about = {"grade": "quick", "seed": 1, "counts": {}, "envelope_sha256": "0" * 64, "versions": {}, "budget_s": None}
    page, pictures = render_page(json.loads(json.dumps({**about, **summary}).replace("NaN", "null")), _manner())
    assert set(pictures) == {"levels"}
    assert "No single effects" in page


def test_a_first_case_that_broke_does_not_hide_how_long_the_others_took():
    """It has no seconds; as the largest of all they could not be printed, at the end of a long run."""
    truths = {"1": truth("nothing"), "2": truth("nothing")}
    took = summarise(truths, {"1": {"error": "ValueError: x"}, "2": {**said(NO), "seconds": 40.0}})["seconds"]
    assert took == {"median": 40.0, "worst": 40.0, "sum": 40.0, "slow": 1}
