"""``simgap benchmark``: it goes on where it stopped, refuses another plan, and does the whole job on two cases."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner

from lab.benchmark import cases, sized
from lab.benchmark.experiment import draw_experiment
from mjsim.errors import InputError
from simgap.cli import COMMANDS
from simgap.commands import benchmark
from simgap.commands.benchmark import command, diagnose_all, diagnose_case, seal


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("benchmark")
    with pytest.MonkeyPatch.context() as patch:
        for module in (cases, sized):
            patch.setattr(module, "draw_experiment", partial(draw_experiment, seconds=2.0))
        seal(out, {"nothing": 3}, 4)
    return out


def test_it_is_a_command() -> None:
    assert "benchmark" in COMMANDS
    assert "Example:" in CliRunner().invoke(command, ["--help"]).output


@pytest.mark.slow
def test_sealing_again_finds_the_same_envelope_and_refuses_another_plan(sealed: Path) -> None:
    manifest = json.loads((sealed / "recordings" / "manifest.json").read_text())
    before = (sealed / "recordings" / "001_estimation.csv").stat().st_mtime_ns
    assert seal(sealed, {"nothing": 3}, 4) == manifest["envelope_sha256"]
    assert (sealed / "recordings" / "001_estimation.csv").stat().st_mtime_ns == before
    with pytest.raises(InputError, match="another benchmark"):
        seal(sealed, {"nothing": 3}, 5)


def test_what_is_done_is_kept(sealed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def work(recordings: Path, name: str, seconds: float, threads: int) -> dict:
        assert sorted(p.name for p in recordings.iterdir() if name in p.name) == [
            f"{name}_estimation.csv",
            f"{name}_held_out.csv",
        ]
        if len(asked) == 2 and name not in asked:
            raise KeyboardInterrupt
        asked.append(name)
        return {"verdict": "no_mismatch", "seconds": float("nan")}

    with pytest.raises(KeyboardInterrupt):
        diagnose_all(sealed, work=work)
    assert len(asked) == 2
    assert len(list((sealed / "diagnoses").iterdir())) == 2
    first = asked.copy()
    asked.clear()
    results = diagnose_all(sealed, work=work)
    assert set(asked) == {"001", "002", "003"} - set(first)
    assert list(results) == ["001", "002", "003"]
    assert results["001"]["seconds"] is None

    # a result that is torn, of another recording or by other code is computed again
    (sealed / "diagnoses" / "001.json").write_text("{")
    other = json.loads((sealed / "diagnoses" / "002.json").read_text())
    other["sealed"]["002_held_out.csv"] = "0"
    (sealed / "diagnoses" / "002.json").write_text(json.dumps(other))
    asked.clear()
    diagnose_all(sealed, work=work)
    assert asked == ["001", "002"]
    asked.clear()
    with pytest.raises(KeyboardInterrupt):
        diagnose_all(sealed, seconds=9.0, work=work)
    assert asked == ["001", "002"]
    monkeypatch.setattr(benchmark, "stamp", lambda: "other code")
    asked.clear()
    with pytest.raises(KeyboardInterrupt):
        diagnose_all(sealed, work=work)
    assert asked == ["001", "002"]


def test_a_case_that_breaks_is_a_result(tmp_path: Path) -> None:
    (tmp_path / "001_estimation.csv").write_text("nothing of use\n")
    assert "InputError" in diagnose_case(tmp_path, "001")["error"]


def test_bad_levels_are_one_line() -> None:
    result = CliRunner().invoke(command, ["--out", "x", "--levels", "plane:2"])
    assert isinstance(result.exception, InputError)
    assert "plain" in str(result.exception)


@pytest.mark.slow
def test_the_whole_job_on_two_cases(tmp_path: Path) -> None:
    out = tmp_path / "b"
    arguments = ["--out", str(out), "--levels", "plain:1,nothing:1", "--seed", "3", "--jobs", "1"]
    result = CliRunner().invoke(command, arguments)
    assert result.exit_code == 0, result.output
    summary = json.loads((out / "benchmark.json").read_text())
    assert summary["n"] == 2
    assert not summary["errors"]
    assert summary["envelope_sha256"] in result.output
    assert "<svg" in (out / "benchmark.html").read_text()
    assert (out / "pictures" / "levels.svg").exists()
    again = CliRunner().invoke(command, [*arguments, "--json"])
    assert again.exit_code == 0
    assert json.loads(again.stdout)["right"] == summary["right"]
