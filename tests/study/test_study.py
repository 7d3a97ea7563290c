"""The study: features, criteria, the rule that makes verdicts, the store, the pages, and tiny cells end to end."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import looks_right

from lab.study import claims as c
from lab.study.cell import GRID_HZ, Cell, Experiment, Feature, Result, analyse, log, run_cell
from lab.study.damping import first_zero, second_mode_hz, study_damping
from lab.study.ledger import claims_json, ledger, say
from lab.study.pipeline import BETTER, FAITHFUL, LADDER
from lab.study.plants import FEATURE_NAMES, PLANTS, build, nominal, response
from lab.study.robot import recorded_robot, robot_models
from lab.study.store import Store, compute
from lab.study.variants import AMPLITUDES, BASE, BASE_BETTER, robustness_map
from mjsim.errors import InputError

EXACT = {n: f.hz for n, f in c.physical_features().items()}
TINY = Experiment(duration=5.0, high_hz=45.0)


def a_result(phase: float = -100.0, db: float = 20.0, low: float = 28.0, **hz: float) -> Result:
    features = {n: Feature(EXACT[n] * (1 + hz.get(n, 0.0) / 100), db) for n in FEATURE_NAMES}
    size = GRID_HZ.size
    return Result("", features, low, 32.9, 1.6, (db,) * size, (phase,) * size, 99.0, "converged", 0.1)


def a_group(**changed: Result) -> dict[str, Result]:
    return {p: changed.get(p, a_result()) for p in PLANTS}


def claim(name: str) -> c.Claim:
    return next(x for x in c.CLAIMS if x.id == name)


def test_every_claim_of_the_report_is_there_once() -> None:
    wanted = ["L1", "L2", "F1", "F2", "F3", "F4", "F5", "S1", "S2", "B1", "B2", "B3", "I1", "I2", "I3", "I4", "X1", "X2"]
    assert [x.id for x in c.CLAIMS] == wanted


def test_exact_features_are_the_published_models() -> None:
    assert (
        pytest.approx({"first_notch": 17.10, "first_peak": 25.01, "second_notch": 29.26, "second_peak": 33.34}, abs=0.01) == EXACT
    )
    assert second_mode_hz() == pytest.approx(32.89, abs=0.01)


def test_the_zero_of_the_first_notch_is_on_the_right_because_of_dg() -> None:
    assert first_zero(nominal()).real == pytest.approx(1.597, abs=1e-3)
    assert first_zero(build(PLANTS["damping_positive"])).real < 0


def test_response_agrees_with_a_long_sine_in_the_ode() -> None:
    from mjsim.ode import simulate

    f, dt = 12.0, 5e-4
    t = dt * np.arange(round(6.0 / dt))
    velocity = simulate(nominal(), np.sin(2 * np.pi * f * t), dt).velocity[-2000:]  # twelve whole periods
    tail = t[-2000:] - dt / 2  # the torque is held over a sample
    found = 2 * np.mean((velocity - velocity.mean()) * np.exp(-2j * np.pi * f * tail)) * 1j
    assert found == pytest.approx(response(nominal(), np.array([f]))[0], rel=0.02)


@pytest.mark.parametrize(
    ("name", "group", "met"),
    [
        ("L1", a_group(), True),
        ("L1", a_group(linear=a_result(second_peak=5.0)), False),
        ("L2", a_group(damping_positive=a_result(phase=200.0)), True),
        ("L2", a_group(damping_positive=a_result(phase=200.0), coulomb_3=a_result(phase=150.0)), False),
        ("L2", a_group(), False),
        ("F1", a_group(coulomb_1=a_result(low=27.5), coulomb_2=a_result(low=27), coulomb_3=a_result(low=23)), True),
        ("F1", a_group(), False),
        ("F2", a_group(), True),
        ("F2", a_group(coulomb_2=a_result(first_peak=-1.5)), False),
        ("F3", a_group(coulomb_3=a_result(second_notch=2, second_peak=2)), True),
        ("F3", a_group(coulomb_3=a_result(second_notch=2)), False),
        ("F4", a_group(coulomb_1=a_result(second_peak=-1), coulomb_2=a_result(second_peak=-2)), True),
        ("F4", a_group(), False),
        ("F5", a_group(coulomb_1=a_result(db=30)), True),
        ("F5", a_group(coulomb_1=a_result(db=24)), False),
        ("S1", a_group(), True),
        ("S1", a_group(static_2=a_result(db=22)), False),
        ("S2", a_group(static_5=a_result(db=18)), True),
        ("S2", a_group(), False),
        ("B2", a_group(), True),
        ("B2", a_group(gap_5=a_result(second_peak=3)), False),
        ("B3", a_group(gap_10=a_result(phase=40.0)), True),
        ("B3", a_group(), False),
        ("I1", a_group(), True),
        ("I1", a_group(torque_20=a_result(first_notch=-4)), False),
        ("I3", a_group(torque_50=a_result(second_peak=2)), False),
        ("I4", a_group(), True),
        ("X1", a_group(), True),
        ("X1", a_group(gap_10=a_result(first_notch=-20)), False),
        ("X2", a_group(), False),
    ],
)  # fmt: skip
def test_criteria(name: str, group: dict[str, Result], met: bool) -> None:
    outcome = c.ask(claim(name), group)
    assert outcome.met is met
    assert outcome.values


def test_falling_features() -> None:
    moved = {f"gap_{g}": a_result(first_notch=-s, first_peak=-s, second_notch=-s) for g, s in ((1, 0.5), (5, 2.0), (10, 4.0))}
    assert c.ask(claim("B1"), a_group(**moved)).met is True
    moved["gap_5"] = a_result(first_notch=-2.0, first_peak=-0.1, second_notch=-2.0)
    assert c.ask(claim("B1"), a_group(**moved)).met is False


def test_what_cannot_be_said_is_void() -> None:
    stuck = c.ask(claim("F1"), a_group(coulomb_3=Result(void="the motor hardly breaks away at this torque")))
    assert stuck.met is None
    assert "breaks away" in stuck.values["void"]
    gone = a_result()
    gone = dataclasses.replace(gone, features={**gone.features, "second_peak": None})
    assert c.ask(claim("B2"), a_group(gap_1=gone)).met is None
    assert c.ask(claim("X1"), a_group(gap_1=gone)).met is False  # a feature that vanishes is what X1 denies


def test_the_rule_of_verdicts() -> None:
    yes: list[bool | None] = [True] * 9
    assert c.judge({"report": [*yes, False], "better": yes})[0] is c.Verdict.HOLDS
    assert c.judge({"report": [False] * 9 + [True], "better": [False]})[0] is c.Verdict.FAILS
    assert c.judge({"report": yes, "better": [False] * 5})[0] is c.Verdict.DEPENDS
    verdict, shares = c.judge({"report": [None] * 9 + [True], "better": [False] * 5})
    assert (verdict, shares) == (c.Verdict.FAILS, {"better": 0.0})  # too few of the report's decide
    assert c.judge({"report": [None], "better": [None]})[0] is c.Verdict.DEPENDS


def test_the_map_covers_what_it_should() -> None:
    variants = robustness_map()
    assert variants[:2] == (BASE, BASE_BETTER)
    for family in ("report", "better"):
        mine = [v.experiment for v in variants if v.family == family]
        assert {e.amplitude for e in mine} == set(AMPLITUDES)
        assert {e.high_hz for e in mine} == {30.0, 45.0}
        assert {e.engine for e in mine} == {"accurate", "ode"}
        assert len({e.duration for e in mine}) == len({e.noise for e in mine}) == 3
        assert len({v.pipeline.orders for v in variants if v.family == family}) == 3
        labels = [v.changed for v in variants if v.family == family]
        assert len(set(labels)) == len(labels)
    assert BASE.cell("linear").experiment.engine == "literal"
    assert len(robustness_map(quick=True)) == 6
    assert LADDER[0][1] is FAITHFUL
    assert LADDER[-1][1] is BETTER


def test_a_cell_is_kept_resumed_and_told_apart_by_its_inputs(tmp_path: Path) -> None:
    cell = Cell("linear", TINY, BETTER)
    store = Store(tmp_path / "cells", "stamp")
    ticks: list[int] = []
    first = compute([cell, cell], store, tick=ticks.append)[cell]
    assert ticks == [0, 1]
    assert store.get(cell) == first
    assert compute([cell], store)[cell] == first
    assert store.get(dataclasses.replace(cell, plant="gap_1")) is None
    assert Store(store.folder, "other code").get(cell) is None
    store.path(cell.inputs()).write_text('{"half')
    assert store.get(cell) is None
    names = dataclasses.replace(cell, pipeline=dataclasses.replace(BETTER, name="another"))
    assert store.path(names.inputs()) == store.path(cell.inputs())


def test_the_better_pipeline_finds_the_second_peak() -> None:
    better = run_cell(Cell("linear", TINY, BETTER))
    peak = better.features["second_peak"]
    assert peak is not None
    assert peak.hz == pytest.approx(EXACT["second_peak"], rel=0.003)
    assert better.second_mode_hz == pytest.approx(32.89, rel=0.005)
    assert better.zero_real is not None
    assert better.zero_real > 0
    faithful = run_cell(Cell("linear", dataclasses.replace(TINY, duration=10.0, high_hz=30.0), FAITHFUL))
    wrong = faithful.features["second_peak"]
    assert wrong is None or abs(wrong.hz / EXACT["second_peak"] - 1) > 0.03


def test_a_motor_that_sticks_is_void() -> None:
    assert "breaks away" in run_cell(Cell("coulomb_3", Experiment(amplitude=0.25, duration=3.0))).void


def test_engines_agree_and_scaling_is_exact() -> None:
    e = Experiment(duration=1.0, noise=0.0)
    ode = log(PLANTS["gap_5"], e)[1]
    accurate = log(PLANTS["gap_5"], dataclasses.replace(e, engine="accurate"))[1]
    assert np.sqrt(np.mean((ode - accurate) ** 2) / np.mean(ode**2)) < 1e-5
    less = log(PLANTS["torque_20"], e)[1]
    np.testing.assert_allclose(5 * less, ode, atol=1e-6 * np.max(np.abs(ode)))
    literal = log(PLANTS["linear"], dataclasses.replace(e, engine="literal"))[1]
    linear = log(PLANTS["linear"], e)[1]
    assert np.sqrt(np.mean((literal - linear) ** 2) / np.mean(linear**2)) < 1e-4
    with pytest.raises(ValueError, match="choose from"):
        log(PLANTS["linear"], dataclasses.replace(e, engine="none"))


def test_ledger_and_schema() -> None:
    group = a_group(coulomb_1=a_result(db=30))
    groups = {v: a_group() for v in robustness_map(quick=True)} | {BASE: group}
    entries = ledger(groups)
    out = json.loads(json.dumps(claims_json(entries, {"L1": {"more": 1.0}})))
    assert {x["verdict"] for x in out} <= {"holds", "fails", "depends"}
    assert all(x["values"]["report"] and x["criterion"] for x in out)
    assert out[0]["values"]["more"] == 1.0
    f5 = next(e for e in entries if e.claim.id == "F5")
    assert f5.count("report") == (1, 2, 0)
    assert "only with base" in f5.sentence()
    assert f5.readings == {"": c.Reading.ARTEFACT}
    assert f5.artefact
    x2 = next(e for e in entries if e.claim.id == "X2")
    assert set(x2.readings) == {"friction_moves_second_peak", "backlash_keeps_second_peak"}
    assert say({"second_peak_percent": -0.5, "lost": [], "x_hz": 2.0}) == "second peak -0.50 %; lost: none; x 2.00 Hz"


def test_an_internal_delay_is_the_equivalent_and_a_late_torque_is_mistaken_for_it() -> None:
    found = study_damping(quick=True)
    assert found.spring_delay_s == pytest.approx(62 / 1.5e5)
    assert found.spring_delay_error < 0.005
    assert found.without_delay["relative_error"] > 0.03
    assert found.mistaken_for is not None
    assert -2e-3 < found.mistaken_for < 0


def a_log(path: Path, dt: float, seconds: float, column: str = "velocity_rad_s") -> Path:
    from mjsim.excitation import chirp
    from mjsim.ode import simulate

    torque = chirp(seconds, dt, 2.0, 0.5, 45.0)
    run = simulate(nominal(), torque, dt)
    values = run.velocity if column == "velocity_rad_s" else run.angle
    np.savetxt(path, np.column_stack([run.time, torque, values]), delimiter=",", header=f"time_s,torque_Nm,{column}", comments="")
    return path


@pytest.mark.parametrize("column", [pytest.param("velocity_rad_s", marks=pytest.mark.slow), "angle_rad"])
def test_a_recording_takes_the_robots_place(tmp_path: Path, column: str) -> None:
    robot = recorded_robot(a_log(tmp_path / "log.csv", 1e-3, 8.0, column))
    result = robot_models(robot, (BETTER,))[0]
    found, model = (r.features["first_peak"] for r in (result.robot, result.model))
    assert found is not None
    assert model is not None
    assert found.hz == pytest.approx(model.hz, rel=0.01)


def test_bad_recordings_are_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"at most 2\.5 ms"):
        recorded_robot(a_log(tmp_path / "slow.csv", 1e-2, 8.0))
    short = recorded_robot(a_log(tmp_path / "short.csv", 5e-4, 0.3))
    with pytest.raises(InputError, match="samples"):
        robot_models(short, (FAITHFUL,))
    with pytest.raises(InputError, match="no such file"):
        recorded_robot(tmp_path / "none.csv")


def test_data_without_a_model_are_void() -> None:
    assert "constant" in analyse(np.ones(4000), np.zeros(4000), 5e-4, FAITHFUL, "still").void


def test_a_run_that_was_broken_off_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lab.study import store as module

    cells = [Cell(p, TINY, BETTER) for p in ("linear", "gap_1", "gap_5")]
    store = Store(tmp_path / "cells", "stamp")
    real, asked = module.run_cell, []

    def run(cell: Cell) -> Result:
        asked.append(cell.plant)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return real(cell)

    monkeypatch.setattr(module, "run_cell", run)
    with pytest.raises(KeyboardInterrupt):
        compute(cells, store)
    assert len(list(store.folder.iterdir())) == 1
    ticks: list[int] = []
    assert set(compute(cells, store, tick=ticks.append)) == set(cells)
    assert asked == ["linear", "gap_1", "gap_1", "gap_5"]
    assert ticks == [1, 2, 3]


@pytest.mark.slow
def test_a_worker_ends_with_the_run_that_started_it() -> None:
    """One whose parent was killed would wait for work for ever."""
    import subprocess
    import sys

    code = "import time; from lab.study.store import _end_with; _end_with({}); time.sleep({}); print('done')"
    alone = subprocess.run([sys.executable, "-c", code.format(1, 60)], capture_output=True, timeout=50, check=False)
    assert alone.returncode == 1
    kept = subprocess.run([sys.executable, "-c", code.format("__import__('os').getppid()", 2)], capture_output=True, check=False)
    assert kept.stdout.strip() == b"done"


def test_progress_is_told_where_no_terminal_is(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from lab.study import show

    now = [0.0]
    monkeypatch.setattr(show.time, "monotonic", lambda: now[0])
    with show.progress() as say:
        for done in range(11):
            say("fit", 50 + done, 60)
            now[0] += 4.0
        say("pages", 0, 0)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "simgap:    0 s  fit  50 of 60"
    assert lines[1] == "simgap:   12 s  fit  53 of 60, about 28 s left"
    assert lines[-2:] == ["simgap:   40 s  fit  60 of 60", "simgap:   44 s  pages"]
    assert len(lines) == 6


@pytest.mark.slow
def test_the_study_end_to_end(browser: Any, tmp_path: Path) -> None:
    from click.testing import CliRunner

    from simgap.commands.study import command

    out, docs = tmp_path / "study", tmp_path / "docs" / "study.md"
    given = CliRunner().invoke(command, ["--out", str(out), "--jobs", "2", "--quick", "--docs", str(docs)])
    assert given.exit_code == 0, given.output
    found = json.loads((out / "claims.json").read_text())
    assert [x["id"] for x in found] == [x.id for x in c.CLAIMS]
    assert all(x["verdict"] in ("holds", "fails", "depends") and x["values"] and x["criterion"] for x in found)
    for n in range(3, 9):
        for kind in ("png", "pdf", "csv"):
            assert (out / f"figure{n}.{kind}").stat().st_size > 1000
    text = docs.read_text()
    assert all(f"### {x.id}:" in text for x in c.CLAIMS)
    assert "figure10_robustness.png" in text
    assert (docs.with_suffix("") / "figure5.png").is_file()
    again = CliRunner().invoke(command, ["--out", str(out), "--jobs", "1", "--quick"])
    assert "0 of them new" in again.output.replace("\n", " ")
    assert not list(out.glob(".*"))
    looks_right(browser, out / "study.html")
