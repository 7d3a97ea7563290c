"""Rival arms: what each one is made of, what is skipped and what breaks, and how they are scored beside the diagnosis."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from ident import Decimation, IOData, decimate
from lab.benchmark import cases, sized
from lab.benchmark.arms import ARMS, Answer, Arm, Task, parse_arms
from lab.benchmark.arms.box_jenkins import noise_gain
from lab.benchmark.arms.sparse import TERMS, free_run, responses
from lab.benchmark.experiment import chirp, draw_experiment, multisine
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import Motion, record
from lab.benchmark.score_rivals import first_cases, score_rivals
from lab.study.pipeline import BETTER
from mjsim.errors import InputError
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate
from mjsim.recording import Recording
from simgap.commands.benchmark import command, run_arms, seal

MODEL = shipped_model("robot_axis1")
NOISE = 0.05


def recording(motion: Motion) -> Recording:
    return Recording(motion.time, motion.torque, motion.velocity, motion.angle, 1 / 2000)


def task(laws: Laws, seconds: float = 3.0, diagnosis: dict[str, Any] | None = None) -> Task:
    rng = np.random.default_rng(8)
    measurement = Measurement(velocity_noise=NOISE)
    first = record(laws, chirp(seconds, 1.0, 0.5, 30.0), measurement, rng)
    second = record(laws, multisine(seconds, 0.6, 0.5, 30.0, rng), measurement, rng)
    return Task(MODEL, load_axis(MODEL), recording(first), recording(second), diagnosis or {})


@pytest.fixture(scope="module")
def plain() -> Task:
    return task(Laws())


def test_arms_are_asked_for_by_name() -> None:
    assert parse_arms(None) == parse_arms("none") == ()
    assert [a.id for a in parse_arms("all")] == list(ARMS)
    assert [a.id for a in parse_arms("sparse, refitted,sparse")] == ["sparse", "refitted"]
    with pytest.raises(InputError, match="stepwise_bic"):
        parse_arms("sysid,sysyd")
    assert all(
        a.id in command.get_help(command.make_context("benchmark", ["--out", "x"])).replace("\n", "") for a in ARMS.values()
    )


def test_what_breaks_is_an_answer_and_what_is_not_installed_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(_: Task) -> Answer:
        raise ValueError("no such luck")

    answer = Arm("x", "X", breaks).run(task(Laws(), 0.5))
    assert answer["error"] == "ValueError: no such luck"
    assert answer["seconds"] >= 0
    assert Arm("x", "X", breaks, needs=("json", "simgap_no_such_module")).lacks() == ("simgap_no_such_module",)
    for module in (cases, sized):
        monkeypatch.setattr(module, "draw_experiment", partial(draw_experiment, seconds=2.0))
    seal(tmp_path, {"nothing": 1}, 4)
    (ran,) = run_arms(tmp_path, [Arm("x", "X", breaks, needs=("simgap_no_such_module",))], ["001"], {"001": {}})
    assert "simgap[bench]" in ran["skipped"]
    assert not ran["answers"]
    assert "Method x skipped: simgap_no_such_module not installed" in capsys.readouterr().err


def test_the_refitted_model_is_taken_from_the_diagnosis_or_fitted(plain: Task) -> None:
    known = replace(plain, diagnosis={"fit": {"refitted": {"held_out_rms": 0.123}}})
    assert ARMS["refitted"].run(known)["held_out_rms"] == 0.123
    fitted = ARMS["refitted"].run(plain)
    assert fitted["held_out_rms"] == pytest.approx(NOISE, rel=0.03)
    assert fitted["refitted_rms"] == fitted["held_out_rms"]
    assert fitted["named"] is None


def test_what_the_filter_leaves_of_white_noise() -> None:
    e = np.random.default_rng(1).standard_normal(400_000)
    through = decimate(IOData(e, e, 1 / 2000), Decimation(BETTER.decimate)).y
    assert noise_gain(BETTER) == pytest.approx(float(np.std(through)), rel=0.01)
    assert noise_gain(replace(BETTER, decimate=1)) == 1.0


def test_the_black_box_is_judged_at_its_own_rate(plain: Task) -> None:
    answer = ARMS["box_jenkins"].run(plain)
    # the true structure, judged alike, leaves the noise that passes the filter
    assert answer["refitted_rms"] == pytest.approx(NOISE * answer["noise_gain"], rel=0.1)
    assert answer["held_out_rms"] >= 0.95 * answer["refitted_rms"]


@pytest.mark.slow
def test_the_sparse_model_runs_as_the_axis_does(plain: Task) -> None:
    axis, r = plain.nominal, plain.estimation
    none = np.zeros(len(TERMS))
    run = free_run(axis.chain, r, none)
    assert run is not None
    exact = simulate(axis, r.torque, r.dt).velocity
    np.testing.assert_allclose(run, exact, atol=1e-6 * np.abs(exact).max())
    # a torque of -c v is a viscosity of c more, to first order in the substep over which it is held
    c = none.copy()
    c[TERMS.index("v")] = -0.01
    run = free_run(axis.chain, r, c)
    assert run is not None
    exact = simulate(axis.with_linear({"fm": 0.0455}), r.torque, r.dt).velocity
    np.testing.assert_allclose(run, exact, atol=2e-3 * np.abs(exact).max())
    # the response to the commanded torque itself is the free run
    np.testing.assert_allclose(responses(axis.chain, r)[:, TERMS.index("u")], free_run(axis.chain, r, none), atol=1e-6)
    c[TERMS.index("v")] = 1.0
    assert free_run(axis.chain, r, c) is None  # diverges


def test_sparse_regression_finds_a_term_and_keeps_quiet_without_one(plain: Task) -> None:
    pytest.importorskip("pysindy")
    quiet = ARMS["sparse"].run(plain)
    assert quiet["named"] == ()
    assert quiet["held_out_rms"] == quiet["refitted_rms"]
    found = ARMS["sparse"].run(task(Laws()._replace(coulomb_m=0.1), 10.0))
    assert "tanh(v / v0)" in found["named"]
    assert found["held_out_rms"] < 0.8 * found["refitted_rms"]


@pytest.mark.slow
def test_stepwise_bic_names_what_is_there() -> None:
    answer = ARMS["stepwise_bic"].run(task(Laws()._replace(coulomb_m=0.1)))
    assert any(n.endswith("friction@motor") for n in answer["named"])
    assert answer["held_out_rms"] == pytest.approx(NOISE, rel=0.05)
    assert answer["refitted_rms"] > 2 * answer["held_out_rms"]


@pytest.mark.slow
def test_sysid_fits_the_linear_parameters() -> None:
    sysid = ARMS["sysid"]
    if sysid.lacks():
        pytest.skip(f"{', '.join(sysid.lacks())} not installed: the bench extra")
    answer = sysid.run(task(Laws()._replace(Jm=1.1 * Laws().Jm, fm=1.2 * Laws().fm)))
    assert answer["held_out_rms"] == pytest.approx(NOISE, rel=0.03)
    factors = dict(part.split(" x ") for part in answer["note"].split(", "))
    assert float(factors["fm"]) == pytest.approx(1.2, rel=0.03)


def test_the_first_cases_of_each_level() -> None:
    levels = ["plain", "nothing", "plain", "plain", "nothing"]
    truths = {f"{i:03d}": {"level": level} for i, level in enumerate(levels)}
    assert first_cases(truths, 2) == ["000", "001", "002", "004"]


def truth(level: str, effects: tuple[str, ...] = (), noise_kind: str = "white") -> dict[str, Any]:
    names = [e.partition("@")[0] for e in effects]
    return {
        "level": level, "verdict": "missing_physics" if effects else "no_mismatch", "effects": names, "noise_kind": noise_kind,
        "where": dict(e.split("@") for e in effects), "parameters": {n: {} for n in names},
        "law": dict.fromkeys(names, "contract"), "velocity_noise_rms_rad_s": 0.1,
    }  # fmt: skip


def result(verdict: str, effects: tuple[str, ...], refitted: float, corrected: float) -> dict[str, Any]:
    findings = [{"effect": e.split("@")[0], "place": e.split("@")[1], "parameters": {}, "equivalents": []} for e in effects]
    fit = {"refitted": {"rms": refitted, "held_out_rms": refitted}, "corrected": {"rms": corrected, "held_out_rms": corrected}}
    return {"verdict": verdict, "findings": findings, "fit": fit, "seconds": 1.0}


def test_rivals_beside_the_diagnosis() -> None:
    cf = ("coulomb_friction@motor",)
    truths = {"1": truth("plain", cf), "2": truth("nothing"), "3": truth("nothing", noise_kind="ar1")}
    results = {
        "1": result("missing_physics", cf, 0.5, 0.1),
        "2": result("no_mismatch", (), 0.1, 0.1),
        "3": {"error": "InputError: x"},
    }

    def answer(held: float, named: list[str] | None, refit: float, gain: float = 1.0) -> dict[str, Any]:
        return {"held_out_rms": held, "refitted_rms": refit, "noise_gain": gain, "named": named, "note": "", "seconds": 2.0}

    named = {"1": answer(0.11, [*cf], 0.5), "2": answer(0.12, ["backlash@arm"], 0.1), "3": answer(0.1, [], 0.1)}
    box = {"1": answer(0.04, None, 0.2, 0.4), "2": {"error": "E", "seconds": 0.1}, "3": answer(0.08, None, 0.04, 0.4)}
    ran = [
        {"id": "bic", "what": "BIC", "names": "effects", "skipped": "", "answers": named},
        {"id": "box", "what": "Box", "names": "", "skipped": "", "answers": box},
        {"id": "gone", "what": "Gone", "names": "terms", "skipped": "not installed", "answers": {}},
    ]
    table = json.loads(json.dumps(score_rivals(truths, results, ["1", "2", "3"], ran)))
    own, bic, black, gone = table["arms"]
    assert table["levels"] == ["plain", "nothing"]
    assert own["levels"]["plain"]["over_noise"] == pytest.approx(1.0)
    assert own["levels"]["plain"]["over_refitted"] == pytest.approx(0.2)
    assert (own["false_alarms"]["n"], own["false_alarms"]["hits"], own["right"]["hits"]) == (1, 0, 1)
    assert list(own["failed"]) == ["3"]
    assert (bic["false_alarms"]["n"], bic["false_alarms"]["hits"], bic["claimed"]["hits"], bic["right"]["hits"]) == (2, 1, 1, 1)
    assert bic["false_alarms"]["ci95"][0] == pytest.approx(1 - math.sqrt(0.975))
    # filtered white noise is known, filtered coloured noise is not; the ratio to the refit always is
    assert black["levels"]["plain"]["over_noise"] == pytest.approx(1.0)
    assert math.isnan(black["levels"]["nothing"]["over_noise"])
    assert black["levels"]["nothing"]["over_refitted"] == pytest.approx(2.0)
    assert black["failed"] == {"2": "E"}
    assert black["false_alarms"] is black["right"] is None
    assert gone["all"]["n"] == 0


@pytest.mark.slow
def test_the_command_runs_arms_and_goes_on_where_it_stopped(tmp_path: Path) -> None:
    out = tmp_path / "b"
    arguments = ["--out", str(out), "--levels", "nothing:2", "--seed", "3", "--jobs", "1", "--arm-cases", "1"]
    done = CliRunner().invoke(command, [*arguments, "--arms", "refitted,box_jenkins"])
    assert done.exit_code == 0, done.output
    table = json.loads((out / "benchmark.json").read_text())["rivals"]
    assert [a["id"] for a in table["arms"]] == ["simgap", "refitted", "box_jenkins"]
    assert table["cases"] == ["001"]
    page = (out / "benchmark.html").read_text()
    assert "Other ways to model the same recordings" in page
    assert ARMS["sysid"].what in page  # among those that were not run
    again = CliRunner().invoke(command, [*arguments, "--arms", "box_jenkins"])
    assert "1 of 1 cases were finished by box_jenkins in an earlier run" in again.output


def test_the_page_and_the_terminal_show_the_rivals(capsys: pytest.CaptureFixture[str]) -> None:
    from diagnose.report.components import data_table, theme_button
    from diagnose.report.document import document
    from diagnose.report.figures import number, percent
    from lab.benchmark.page import Manner, render_page
    from lab.benchmark.resume import plain as to_json
    from lab.benchmark.score_table import summarise
    from simgap.commands.benchmark import _show

    truths = {"1": truth("nothing"), "2": truth("nothing", noise_kind="ar1")}
    results = {n: result("no_mismatch", (), 0.1, 0.1) for n in truths}
    bic = {
        "1": {"held_out_rms": 0.1, "refitted_rms": 0.1, "noise_gain": 1.0, "named": ["x@y"], "seconds": 1.0},
        "2": {"error": "E"},
    }
    ran = [
        {"id": "bic", "what": "The BIC arm", "names": "effects", "skipped": "", "answers": bic},
        {"id": "gone", "what": "The missing arm", "names": "", "skipped": "pysindy not installed", "answers": {}},
    ]
    rivals = {**score_rivals(truths, results, list(truths), ran), "cases_a_level": 2}
    about = {"grade": "quick", "seed": 1, "counts": {}, "envelope_sha256": "0" * 64, "versions": {}, "budget_s": None}
    summary = to_json({**about, **summarise(truths, results), "rivals": rivals, "arms_missing": ["Another arm"]})
    page, _ = render_page(summary, Manner(number, percent, str, data_table, theme_button(), document))
    for text in ("The BIC arm", "skipped: pysindy not installed", "--arms bic,gone --arm-cases 2", "Another arm", "failed in 1"):
        assert text in page
    _show(summary, Path("out"))
    assert "1 of 1" in capsys.readouterr().out
