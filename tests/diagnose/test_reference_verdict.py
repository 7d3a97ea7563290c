"""The verdict by the figures of the files in MuJoCo, at the thresholds that decide it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnose.problem.noise_model import KnownNoise
from diagnose.result import Estimate, Finding, FitFigures, Verdict
from diagnose.verdict import reference_verdict
from diagnose.verdict.reference_stage import APART
from diagnose.verdict.reference_verdict import MISSES, Files, by_simulator, gains_little, no_better, nominal_stands

NO, NUMBERS, PHYSICS, UNKNOWN = (
    Verdict.NO_MISMATCH, Verdict.PARAMETERS_ONLY, Verdict.MISSING_PHYSICS, Verdict.UNEXPLAINED
)  # fmt: skip


def fit(rms: float, held_out: float | None = None) -> FitFigures:
    held_out = rms if held_out is None else held_out
    return FitFigures(rms, rms, held_out, held_out)


def finding(kind: str = "physics", effect: str = "coulomb_friction") -> Finding:
    evidence = {"held_out_error_before": 3.0, "held_out_error_after": 1.0}
    return Finding(effect, "motor", "hinge", "", {"torque_Nm": Estimate(0.1, (0.09, 0.11), "N m")}, evidence, kind=kind)


@dataclass(frozen=True)
class Result:
    """What of a diagnosis is looked at and changed."""

    verdict: Verdict
    fit: dict[str, FitFigures]
    surrogate: dict[str, FitFigures] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    linear_parameters: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ("Structure remains in the error.", "kept")
    summary: str = "by the equations"
    unit: str = "rad/s"
    gap_closed: float = 0.9
    next_experiment: str | None = "another"
    map: Any = "map"
    traces: Any = None


class Bench:
    """Figures, noise and chi-squares of the runs "given" and "mended", made up."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.figures = {"given": fit(3.0), "mended": fit(1.0)}
        self.quiet = {"given": False, "mended": True}
        self.chi2 = {("given", "estimation"): 900.0, ("given", "held_out"): 400.0}
        patch = monkeypatch.setattr
        patch(reference_verdict, "figures", lambda cases, runs: self.figures[runs])
        patch(reference_verdict, "at_noise", lambda cases, runs, angles=False: self.quiet[runs])
        patch(reference_verdict, "chi_square", lambda cases, runs, part="estimation": (self.chi2[runs, part], 1000))
        patch(reference_verdict, "with_runs", lambda traces, *_: traces)
        case = SimpleNamespace(held_out=np.arange(500) < 250)
        self.nominal = SimpleNamespace(cases=(case, case), runs="given", apart=2 * APART, simulator=False)

    def judge(self, verdict: Verdict, *, engine: float = 1.0, findings=None, **files: Any) -> Result:
        """`by_simulator` of a diagnosis whose engine leaves so much."""
        found = ((finding(),) if verdict is PHYSICS else ()) if findings is None else findings
        result = Result(verdict, {"nominal": fit(3.0), "refitted": fit(2.0), "corrected": fit(engine)}, findings=found)
        return by_simulator(result, self.nominal, Files(**({"runs": "mended", "lacks": (), "form": "its own form"} | files)))


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


def test_figures_are_those_of_the_files_and_those_of_the_engine_are_kept(bench):
    out = bench.judge(PHYSICS)
    assert (out.fit["nominal"], out.fit["corrected"]) == (bench.figures["given"], bench.figures["mended"])
    assert out.surrogate == {"nominal": fit(3.0), "refitted": fit(2.0), "corrected": fit(1.0)}
    assert out.verdict is PHYSICS
    assert out.notes == ("Structure remains in the error.", "kept")
    assert "Coulomb friction at the motor" in out.summary
    assert "misses by 3, corrected.xml by 1 rad/s, both stepped by MuJoCo" in out.summary


@pytest.mark.parametrize("which", ["rms", "held_out"])
@pytest.mark.parametrize(
    ("factor", "warned"), [(0.999 * MISSES, False), (MISSES, False), (1.001 * MISSES, True), (math.inf, True)]
)
def test_a_file_that_misses_what_the_engine_reaches_is_warned_of(bench, which, factor, warned):
    bench.figures["mended"] = fit(factor, 1.0) if which == "rms" else fit(1.0, factor)
    out = bench.judge(PHYSICS)
    assert any(n.startswith("Warning: corrected.xml") for n in out.notes) is warned
    assert out.verdict is PHYSICS
    assert any("infinite (it diverges)" in n for n in out.notes) is (warned and factor == math.inf)


def test_held_out_data_that_are_not_there_are_not_missed(bench):
    bench.figures["mended"] = fit(1.0, math.nan)
    result = Result(PHYSICS, {"nominal": fit(3.0), "refitted": fit(2.0), "corrected": fit(1.0, math.nan)}, findings=(finding(),))
    out = by_simulator(result, bench.nominal, Files("mended", (), "form"))
    assert not any("Warning" in n for n in out.notes)


def test_why_a_file_misses_is_said(bench):
    bench.figures["mended"], bench.quiet["mended"] = fit(2.0), False
    assert "cannot be followed for long" in bench.judge(PHYSICS, sensitive=True).notes[0]
    warned = bench.judge(PHYSICS, notes=("told",))
    assert "does not step what was found" in warned.notes[0]
    assert warned.notes[1:] == ("told", "Structure remains in the error.", "kept")
    lacking = bench.judge(PHYSICS, lacks=("an encoder error",), notes=("first",))
    assert lacking.notes[0] == "first"
    assert lacking.notes[1].startswith(
        "Plain MuJoCo lacks in corrected.xml: an encoder error. Its held-out error there is 2 rad/s"
    )
    assert not any("Warning" in n for n in lacking.notes)
    assert "by 1 in simgap's replay" in lacking.summary
    bench.figures["mended"] = fit(1.0)
    assert not any("lacks" in n for n in bench.judge(PHYSICS, lacks=("an encoder error",)).notes)


def test_parameters_that_the_file_does_not_reach_are_not_explained(bench):
    """Beyond the noise, with nothing that MJCF lacks and no motion that cannot be followed."""
    bench.figures = {"given": fit(3.0), "mended": fit(1.2)}
    bench.quiet = {"given": False, "mended": False}
    out = bench.judge(NUMBERS)
    assert out.verdict is UNKNOWN
    assert "(held-out error 1 rad/s)" in out.summary
    assert bench.judge(PHYSICS).verdict is PHYSICS  # an effect keeps its name
    assert bench.judge(NUMBERS, sensitive=True).verdict is NUMBERS
    assert bench.judge(NUMBERS, lacks=("an encoder error",)).verdict is NUMBERS
    bench.quiet["mended"] = True
    assert bench.judge(NUMBERS).verdict is NUMBERS
    bench.figures["mended"], bench.quiet["mended"] = fit(1.0), False
    assert bench.judge(NUMBERS).verdict is NUMBERS


@pytest.mark.parametrize(("factor", "worse"), [(0.999, False), (1.001, True)])
def test_a_file_that_is_worse_than_the_one_as_given_explains_nothing(bench, factor, worse):
    bench.figures["mended"], bench.quiet["mended"] = fit(3.0 * MISSES * factor), False
    verdict = bench.judge(NUMBERS, engine=3.3)
    assert verdict.verdict is (UNKNOWN if worse else NUMBERS)
    assert ("file misses held-out recordings by" in verdict.summary) is worse
    assert bench.judge(NUMBERS, engine=3.3, lacks=("an encoder error",)).verdict is NUMBERS
    assert bench.judge(PHYSICS, engine=3.3).verdict is PHYSICS
    bench.quiet["mended"] = True
    assert bench.judge(NUMBERS, engine=3.3).verdict is NUMBERS


def test_nothing_is_missing_and_the_file_is_off(bench):
    out = bench.judge(NO)
    assert out.verdict is NUMBERS
    assert "file as given, stepped by MuJoCo, misses it by 3 rad/s on held-out data, corrected.xml by 1" in out.summary


def test_what_the_equations_leave_open_the_file_explains(bench):
    out = bench.judge(UNKNOWN, engine=5.0)
    assert out.verdict is NUMBERS
    assert out.map is None
    assert "No physics is missing: the numbers of the model were off" in out.summary
    assert out.notes[1:] == ("kept",)
    assert "numerics: with its own form the file follows them, and the equations of motion leave 5 rad/s." in out.notes[0]
    out = bench.judge(UNKNOWN, engine=5.0, findings=(finding(),))
    assert out.verdict is PHYSICS
    assert "The simulation left out Coulomb friction at the motor" in out.summary
    bench.quiet["mended"] = False
    assert bench.judge(UNKNOWN, engine=5.0).verdict is UNKNOWN
    assert bench.judge(NUMBERS, engine=5.0, bears=True).verdict is NUMBERS
    assert "bear the simulator's numerics" in bench.judge(NUMBERS, engine=5.0, bears=True).notes[0]


def test_a_setting_makes_the_difference(bench):
    setting = finding("numerics", "soft_friction")
    out = bench.judge(NUMBERS, numerics=(setting,))
    assert out.verdict is NUMBERS
    assert out.findings == (setting,)
    assert out.summary == (
        "No physics is missing. A setting of the simulator makes a difference, not physics: soft friction. Mended in "
        "corrected.xml, the held-out error is 1 rad/s instead of 3."
    )
    out = bench.judge(PHYSICS, numerics=(setting,))
    assert out.verdict is PHYSICS
    assert out.findings == (finding(), setting)
    assert "left out Coulomb friction" in out.summary
    assert "A setting of the simulator" in out.summary
    bench.quiet["mended"] = False
    out = bench.judge(UNKNOWN, numerics=(setting,))
    assert out.verdict is UNKNOWN
    assert out.summary.startswith("by the equations A setting")


def test_the_file_as_given_stands(bench):
    """Where it is at the noise and no better model pays for its numbers; what the engine had found is a note."""
    bench.quiet["given"] = True
    bench.figures["given"] = fit(1.0)
    out = bench.judge(PHYSICS, notes=("Plain MuJoCo lacks nothing.", "told"))
    assert out.verdict is NO
    assert out.findings == ()
    assert out.fit["corrected"] == out.fit["nominal"]
    assert math.isnan(out.gap_closed)
    assert out.next_experiment is None
    assert out.map is None
    assert out.notes == (
        "The fitting engine alone would have named coulomb friction; the simulator with the file as given needs none of it.",
        "told", "kept",
    )  # fmt: skip
    assert bench.judge(NUMBERS).notes == ("kept",)
    bench.quiet["given"] = False
    assert bench.judge(PHYSICS).verdict is PHYSICS
    kept = bench.judge(PHYSICS, stands=True)
    assert kept.verdict is UNKNOWN
    assert kept.fit["corrected"] == kept.fit["nominal"]


@pytest.mark.parametrize("which", ["gain", "lost"])
@pytest.mark.parametrize(("factor", "stands"), [(0.99, True), (1.01, False)])
def test_a_better_model_pays_for_its_numbers(bench, which, factor, stands):
    """n log of the ratio of the mean squares against the price of two numbers and the entry, on either part of the data."""
    prices = KnownNoise.prices
    level = prices.entry + 0.5 * prices.price * 2
    n = {"gain": 1000, "lost": 500}[which]
    ratio = math.exp(factor * level / (2.0 * n))
    bench.quiet["given"] = True
    best = 0.01
    bench.figures["given"] = fit(best * ratio, best) if which == "gain" else fit(best, best * ratio)
    result = Result(PHYSICS, {"corrected": fit(best)}, findings=(finding(),), linear_parameters={"Jm": None})
    assert nominal_stands(result, bench.nominal) is stands
    engine = replace(result, surrogate={"corrected": fit(best)}, fit={"corrected": fit(1e-9)})
    assert nominal_stands(engine, bench.nominal) is stands


def test_when_the_file_as_given_may_stand(bench):
    bench.quiet["given"] = True
    bench.figures["given"] = fit(1.0)
    result = Result(PHYSICS, {"corrected": fit(1.0)}, findings=(finding(),))
    assert nominal_stands(result, bench.nominal)
    bench.nominal.apart = APART  # the search had the same numerics and has answered
    assert not nominal_stands(result, bench.nominal)
    assert nominal_stands(replace(result, verdict=NO), bench.nominal)
    bench.nominal.apart = 1.01 * APART
    assert nominal_stands(result, bench.nominal)
    bench.nominal.simulator = True
    assert not nominal_stands(result, bench.nominal)
    bench.nominal.simulator = False
    bench.chi2["given", "estimation"] = math.inf
    assert not nominal_stands(result, bench.nominal)
    bench.chi2["given", "estimation"] = 900.0
    bench.figures["given"] = fit(1.0, 50.0)
    bench.nominal.cases = (SimpleNamespace(held_out=np.zeros(5, bool)),)
    assert nominal_stands(result, bench.nominal)  # nothing is held out
    bench.figures["given"] = fit(0.0)
    assert nominal_stands(replace(result, fit={"corrected": fit(0.0)}), bench.nominal)


@pytest.mark.parametrize("part", ["estimation", "held_out"])
def test_numbers_that_do_not_help_the_file(bench, part):
    bench.quiet["given"] = True
    bench.chi2 |= {("mended", "estimation"): 900.0, ("mended", "held_out"): 400.0}
    result = Result(NUMBERS, {})
    assert no_better(result, bench.nominal, "mended")
    assert no_better(replace(result, verdict=UNKNOWN), bench.nominal, "mended")
    assert not no_better(replace(result, verdict=NO), bench.nominal, "mended")
    assert not no_better(replace(result, verdict=PHYSICS), bench.nominal, "mended")
    assert not no_better(replace(result, findings=(finding(),)), bench.nominal, "mended")
    bench.chi2["mended", part] -= 1e-6
    assert not no_better(result, bench.nominal, "mended")
    bench.chi2["mended", part] += 1.0
    assert no_better(result, bench.nominal, "mended")
    bench.quiet["given"] = False  # far from the noise as well
    assert no_better(result, bench.nominal, "mended")


@pytest.mark.parametrize("which", ["gain", "lost"])
@pytest.mark.parametrize(("factor", "little"), [(0.99, True), (1.01, False)])
def test_a_corrected_file_pays_for_its_numbers_in_the_simulator(bench, which, factor, little):
    prices = KnownNoise.prices
    level = prices.entry + 0.5 * prices.price * 2
    ratio = math.exp(factor * level / (2.0 * {"gain": 1000, "lost": 500}[which]))
    bench.quiet["given"], bench.nominal.simulator = True, True
    best = 0.01
    bench.figures |= {"given": fit(best * ratio, best) if which == "gain" else fit(best, best * ratio), "mended": fit(best)}
    result = Result(PHYSICS, {"corrected": fit(1e-9)}, findings=(finding(),), linear_parameters={"Jm": None})
    assert gains_little(result, bench.nominal, "mended") is little
    bench.quiet["given"] = False
    assert not gains_little(result, bench.nominal, "mended")


@pytest.mark.parametrize(("factor", "stands"), [(0.99, False), (1.01, True)])
def test_a_given_file_that_predicts_better_stands_whatever_another_gains_where_it_was_fitted(bench, factor, stands):
    prices = KnownNoise.prices
    level = prices.entry + 0.5 * prices.price * 2
    bench.quiet["given"], bench.nominal.simulator = True, True
    ahead, behind = math.exp(-2.0 * level / 2000.0), math.exp(factor * level / 1000.0)
    bench.figures |= {"given": fit(1.0, 1.0), "mended": fit(ahead, behind)}
    result = Result(PHYSICS, {"corrected": fit(1e-9)}, findings=(finding(),), linear_parameters={"Jm": None})
    assert gains_little(result, bench.nominal, "mended") is stands
    bench.figures["mended"] = fit(ahead, math.inf)
    assert gains_little(result, bench.nominal, "mended")
    bench.chi2 |= {("mended", "estimation"): 1.0, ("mended", "held_out"): math.inf}
    assert not no_better(result, bench.nominal, "mended")
    assert no_better(replace(result, verdict=UNKNOWN, findings=()), bench.nominal, "mended")
