"""Cases of the panel: their names, files that are the same each time, and the truth beside them."""

from __future__ import annotations

import json
from functools import partial

import pytest

from lab.benchmark.seal import write_cases
from lab.panel import local
from lab.panel.case import Case, Content, case_hash, materialise
from lab.panel.catalogue import all_cases, choose, quick_cases, select, strata
from lab.panel.practice import practice_truth
from lab.panel.sealed import _make, numbered
from lab.panel.shipped import copy_model
from mjsim.errors import InputError


def small(folder, text="1\n"):
    (folder / "log.csv").write_text(text)
    return Content(("log.csv",), (), copy_model("emps", folder), truth={"level": "plain"})


def test_a_case_is_written_once_and_read_back(tmp_path):
    made = []

    def make(folder):
        made.append(folder)
        return small(folder)

    case = Case("one", "example", "plain", make)
    first, again = (materialise(case, tmp_path) for _ in range(2))
    assert len(made) == 1
    assert first == again
    assert sorted(p.name for p in (tmp_path / "one").iterdir()) == ["case.json", "emps.toml", "emps.xml", "log.csv"]
    assert [p.name for p in tmp_path.iterdir()] == ["one"]


def test_the_hash_follows_from_the_files_and_not_from_the_truth(tmp_path):
    def hash_of(name, **changes):
        folder = tmp_path / name
        folder.mkdir()
        content = small(folder, changes.pop("text", "1\n"))
        return case_hash(folder, Content(**{**vars(content), **changes}))

    same = hash_of("a")
    assert hash_of("b", truth=None) == same
    assert hash_of("c", text="2\n") != same
    assert hash_of("d", options={"depth": 2}) != same
    assert hash_of("e", held_out=("log.csv",)) != same


def test_nothing_stands_under_the_name_of_a_case_that_cannot_be_made(tmp_path):
    def make(folder):
        small(folder)
        raise InputError("log.csv", "no local copy")

    with pytest.raises(InputError, match="no local copy"):
        materialise(Case("one", "real", "x", make), tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_sealed_case_has_the_number_and_the_bytes_of_the_benchmark(tmp_path):
    write_cases(tmp_path / "sealed", tmp_path / "envelope" / "truth.json", {"nothing": 1, "parameters_only": 1}, 5)
    truths = json.loads((tmp_path / "envelope" / "truth.json").read_text())["cases"]
    for number, (level, index) in numbered(5, "nothing:1,parameters_only:1").items():
        case = Case(f"s5_{number}", "sealed", level, partial(_make, 5, level, index))
        files = materialise(case, tmp_path / "cases")
        for part in ("estimation", "held_out"):
            ours, theirs = files.folder / f"{part}.csv", tmp_path / "sealed" / f"{number}_{part}.csv"
            assert ours.read_bytes() == theirs.read_bytes()
        assert files.content.truth == truths[number]


def test_names_are_unique_and_the_quick_subset_is_of_the_strata():
    cases = all_cases()
    assert len({c.id for c in cases}) == len(cases)
    assert sum(c.origin == "sealed" for c in cases) == 252 + 252 + 40
    quick = quick_cases()
    assert 35 <= len(quick) <= 50
    counts = {s: sum(c.stratum == s for c in quick) for s in strata()}
    assert counts == strata()


def test_a_case_that_takes_too_long_gives_its_place_to_the_next():
    stratum = next(s for s in strata() if s == "sealed/plain")
    first, second, third = choose({stratum: 3}, {}, 30.0)
    assert choose({stratum: 2}, {first: 30.1}, 30.0) == [second, third]
    assert choose({stratum: 2}, {first: 30.0}, 30.0) == [first, second]


def test_a_name_that_is_not_in_the_panel_is_refused():
    with pytest.raises(InputError, match="not in the panel"):
        select(["s9999_001"])


def test_practice_answers_get_level_verdict_and_places():
    said = practice_truth({"effects": ["backlash", "torque_ripple"], "where": {"backlash": "arm"}, "parameters": {}})
    assert (said["level"], said["verdict"]) == ("two_effects", "missing_physics")
    assert said["where"] == {"backlash": "arm", "torque_ripple": "motor"}
    assert practice_truth({"effects": [], "where": {}, "parameters": {}})["verdict"] == "parameters_only"


def test_a_recording_that_is_not_on_this_machine_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("SIMGAP_DATA", str(tmp_path))
    with pytest.raises(InputError, match="SIMGAP_DATA"):
        local.local_copy("no_such_set", "no_such_file")
    (tmp_path / "file.csv").write_text("1")
    assert local.local_copy("some_set", "file.csv") == tmp_path / "file.csv"
