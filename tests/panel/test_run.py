"""Runs: resumed by case and code, with a record for what fails; by a checkout that only looks like this project."""

from __future__ import annotations

import json
import subprocess

import pytest

from lab.panel import kernels
from lab.panel.ablate import ablate, ablation_table
from lab.panel.case import Case, Content
from lab.panel.kernels import KERNELS, VARIABLE, differs, under_kernels
from lab.panel.record import read_answers
from lab.panel.rules import Rule
from lab.panel.run import Setting, run_cases
from lab.panel.tree import Tree, at_commit, checkout
from mjsim.errors import InputError

# what the driver needs of a commit: the contract's function, its options, and a fitter that counts
PIPELINE = """
import json
from dataclasses import dataclass
from diagnose.fitter import Fitter

NAMES = ["coulomb_friction"]

@dataclass
class Options:
    jobs: int = 2
    depth: int = 3

def named():
    return NAMES

def diagnose_files(recordings, model, out, held_out, options, *, progress=True):
    said = recordings[0].read_text().strip()
    print("noise on standard output")
    fitter = Fitter(int(said) if said.isdigit() else 0)
    fitter.close()
    if said == "die":
        raise SystemExit(3)
    if said == "hang":
        import time
        time.sleep(60)
    if not said.isdigit():
        raise ValueError(said)
    effects = [] if said == "0" else named()
    findings = [{"effect": e, "place": "motor", "parameters": {}, "equivalents": []} for e in effects]
    fit = {n: {"held_out_rms": 1.0} for n in ("nominal", "refitted", "corrected")} | {"noise_floor": {"rms": 1.0}}
    verdict = "missing_physics" if findings else "no_mismatch"
    out.mkdir(parents=True)
    (out / "diagnosis.json").write_text(
        json.dumps({"verdict": verdict, "findings": findings, "linear_parameters": {}, "fit": fit}))
"""
FITTER = """
class Fitter:
    def __init__(self, runs):
        self.runs = runs

    def close(self):
        pass
"""


@pytest.fixture
def tree(tmp_path):
    folder = tmp_path / "tree"
    for name, text in (("simgap/pipeline.py", PIPELINE), ("diagnose/fitter.py", FITTER)):
        path = folder / name
        path.parent.mkdir(parents=True)
        path.write_text(text)
        (path.parent / "__init__.py").write_text("")
    return Tree(folder, "abc", "stamp")


class Maker:
    """Writes one line; makers go to a process of their own, so that they are no closures."""

    def __init__(self, text, expected=True):
        self.text, self.expected = text, expected

    def __call__(self, folder):
        if self.text == "absent":
            raise InputError("log.csv", "no local copy")
        (folder / "log.csv").write_text(self.text)
        (folder / "m.xml").write_text("")
        right = {"verdicts": ["missing_physics"], "effects": [["coulomb_friction"]]}
        return Content(("log.csv",), (), "m.xml", expected=right if self.expected else None)


@pytest.fixture
def run(tree, tmp_path, monkeypatch):
    # cases are made here, and not in processes, which could not load this file
    from concurrent.futures import ThreadPoolExecutor

    monkeypatch.setattr("lab.panel.run.ProcessPoolExecutor", lambda jobs, mp_context: ThreadPoolExecutor(jobs))

    def go(texts, out="out", **changes):
        cases = [Case(name, "example", "x", Maker(text)) for name, text in texts.items()]
        setting = Setting(**{"tree": tree, "cache": tmp_path / "cases", **changes})
        return run_cases(cases, tmp_path / out, setting, 1)

    return go


def test_answers_errors_and_absent_recordings(run, tmp_path):
    ran = run({"good": "120", "bad": "it is broken", "dead": "die", "nothing": "0", "away": "absent"})
    assert {k: r.outcome for k, r in ran.records.items()} == {
        "good": "right", "bad": "error", "dead": "error", "nothing": "missed"
    }  # fmt: skip
    assert ran.records["good"].simulations == 120
    assert ran.records["good"].commit == "abc"
    assert ran.records["bad"].error == "ValueError: it is broken"
    assert "ended with 3" in ran.records["dead"].error
    assert list(ran.absent) == ["away"]
    assert set(read_answers(tmp_path / "out")) == {"good", "bad", "dead", "nothing"}
    assert list((tmp_path / "out" / "work").iterdir()) == []


def test_a_case_over_its_limit_is_an_error_and_the_next_goes_on(run):
    ran = run({"slow": "hang", "good": "1"}, limit=1.5)
    assert "no answer within" in ran.records["slow"].error
    assert ran.records["good"].outcome == "right"


def test_a_run_goes_on_where_it_was_broken_off(run, tree, tmp_path):
    assert run({"a": "1"}).kept == 0
    ran = run({"a": "1", "b": "2"})
    assert (ran.kept, sorted(ran.records)) == (1, ["a", "b"])
    other = Tree(tree.folder, "def", "another stamp")
    assert run({"a": "1", "b": "2"}, tree=other).kept == 0  # answers of other code are computed again
    path = tmp_path / "out" / "records" / "a.json"
    path.write_text(path.read_text()[:20])
    assert run({"a": "1", "b": "2"}, tree=other).kept == 1


def test_an_error_is_kept_unless_it_is_asked_for_again(run):
    run({"a": "it is broken"})
    assert run({"a": "it is broken"}).kept == 1
    assert run({"a": "it is broken"}, again=True).kept == 0


def test_a_record_of_other_files_is_computed_again(run, tmp_path):
    run({"a": "1"})
    assert run({"a": "2"}, cache=tmp_path / "other").kept == 0


def test_a_checkout_that_is_not_the_one_imported_is_refused(run, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"imported from|No module"):
        run({"a": "1"}, tree=Tree(tmp_path / "empty", "abc", "stamp"))


def test_ablation_compares_with_everything_on(run, tree, tmp_path):
    rule = Rule("names", "effects are named", ({"target": "simgap.pipeline.named", "returns": ["backlash"]},))
    cases = [Case(name, "example", "x", Maker(text)) for name, text in (("a", "1"), ("b", "0"))]
    found = ablate([rule], cases, tmp_path / "ablation", Setting(tree, tmp_path / "cases"), 1, lambda _: None)
    assert (found["names"].gained, found["names"].lost) == (0, 1)
    assert "| names | 0 | 1 |" in ablation_table(found)
    assert json.loads((tmp_path / "ablation" / "ablation.json").read_text())["rules"]["names"]["lost"] == 1
    gone = Rule("gone", "no more", ({"target": "simgap.pipeline.gone", "returns": None},))
    with pytest.raises(InputError, match="'gone'"):
        ablate([gone], cases, tmp_path / "ablation", Setting(tree, tmp_path / "cases"), 1, lambda _: None)


def test_a_folder_is_no_checkout_without_the_pipeline(tmp_path):
    with pytest.raises(InputError, match=r"pipeline\.py"):
        checkout(tmp_path)


def git(folder, *words):
    author = ["-c", "user.name=x", "-c", "user.email=x@example.com"]
    return subprocess.run(["git", "-C", str(folder), *author, *words], check=True, capture_output=True, text=True).stdout


def test_the_commit_of_a_changed_checkout_is_marked(tree):
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "first"]):
        git(tree.folder, *words)
    clean = checkout(tree.folder)
    assert not clean.commit.endswith("+")
    (tree.folder / "simgap" / "pipeline.py").write_text(PIPELINE + "\n")
    changed = checkout(tree.folder)
    assert changed.commit == clean.commit + "+"
    assert changed.stamp != clean.stamp


def test_a_commit_is_run_in_a_worktree_that_is_removed(run, tree, tmp_path, monkeypatch):
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "first"]):
        git(tree.folder, *words)
    (tree.folder / "simgap" / "pipeline.py").write_text(PIPELINE.replace("coulomb_friction", "backlash"))
    git(tree.folder, "commit", "-qam", "second")
    monkeypatch.setattr("lab.panel.tree.here", lambda: tree.folder)
    for revision, outcome in (("HEAD~1", "right"), ("HEAD", "wrong name")):
        with at_commit(revision, tmp_path / "trees") as code:
            assert code.commit == git(tree.folder, "rev-parse", "--short=9", revision).strip()
            assert run({"a": "1"}, tree=code).records["a"].outcome == outcome
        assert not code.folder.exists()
    assert len(git(tree.folder, "worktree", "list").splitlines()) == 1
    with pytest.raises(InputError, match="git rev-parse"), at_commit("no-such-commit", tmp_path / "trees"):
        pass


def test_answers_that_depend_on_the_kernels_of_the_linear_algebra_are_told(run, tree, tmp_path, monkeypatch):
    """The first kernels are compared with the others; a run under one is not taken for a run under another."""
    cases = [Case(name, "example", "x", Maker(text)) for name, text in (("a", "7"), ("b", "8"))]
    setting = Setting(tree, tmp_path / "cases")
    monkeypatch.setattr(kernels, "kernels_in_use", lambda name: name)

    def go():
        return under_kernels(KERNELS, cases, tmp_path / "kernels", setting, 1, lambda text: None)

    found = go()
    assert list(found) == ["Sandybridge"]
    assert found["Sandybridge"].cases == 2
    assert not differs(found)
    text = PIPELINE.replace("return NAMES", f"import os; return NAMES if os.environ['{VARIABLE}'] == 'Haswell' else []")
    (tree.folder / "simgap" / "pipeline.py").write_text(text)
    assert not differs(go()), "what is known of one code is kept"
    setting = Setting(Tree(tree.folder, "abc", "another stamp"), tmp_path / "cases")
    found = go()
    assert differs(found)
    assert [c.case for c in found["Sandybridge"].changes] == ["a", "b"]
    assert "lost" in (tmp_path / "kernels" / "Sandybridge" / "comparison.md").read_text()


def test_kernels_that_are_not_used_are_refused(tree, tmp_path, monkeypatch):
    """OpenBLAS takes those of the processor for a name that it does not know: nothing would be compared."""
    monkeypatch.setattr(kernels, "kernels_in_use", lambda name: "SkylakeX")
    with pytest.raises(InputError, match="Haswell is asked for and SkylakeX is used"):
        under_kernels(KERNELS, [], tmp_path, Setting(tree, tmp_path), 1, lambda text: None)
