"""A diagnosis that is broken off leaves what it has fitted, and the same command goes on from there to the same end."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest
from click.testing import CliRunner
from robot_axis import effect

import simgap.pipeline as pipeline
from diagnose.data.experiment import prepare
from diagnose.fit.fitter import Fitter
from diagnose.fit.least_squares import Fit, Linearised, Status
from diagnose.fit.ledger import FORMAT, Ledger, checksum, fingerprint
from diagnose.pipeline import Options, diagnose
from diagnose.problem.view import MotionView
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from simgap.cli import cli

FEW = ("coulomb_friction", "torque_offset", "time_delay", "stribeck_friction")
FIT = Fit(np.array([1 / 3, -0.0]), 0.1, Linearised.known(np.zeros(3), np.zeros((3, 2))), Status.BUDGET, 3, np.inf)


def answer(result):
    said = result.as_dict()
    del said["seconds"]
    return json.dumps(said, default=float)


class Broken(Ledger):
    """Breaks the diagnosis off after so many fits, as Ctrl-C does."""

    left = 0

    def keep(self, key, fit, n, runs):
        if self.left == 0:
            raise KeyboardInterrupt
        self.left -= 1
        super().keep(key, fit, n, runs)


@pytest.fixture(scope="module")
def recordings(pair):
    """One to fit and one that is held out."""
    stribeck = effect("stribeck_friction", torque_Nm=0.08, extra_static_torque_Nm=0.05, stribeck_velocity_rad_s=3.0)
    return pair(stribeck, seconds=1.5)


@pytest.fixture(scope="module")
def whole(recordings, robot):
    """(recordings, options, answer without interruption, its number of fits)."""
    options = Options(jobs=1, effects=FEW)
    counted = Counted()
    result = diagnose(robot, recordings[:1], recordings[1:], options, ledger=counted)
    return recordings, options, answer(result), counted.kept


class Counted:
    """A ledger that knows nothing and counts."""

    kept = 0

    def recall(self, key):
        return None

    def keep(self, key, fit, n, runs):
        self.kept += 1


@pytest.mark.slow
def test_remembering_changes_nothing(whole, robot):
    recordings, options, expected, _ = whole
    assert answer(diagnose(robot, recordings[:1], recordings[1:], options)) == expected


@pytest.mark.parametrize(
    ("share", "jobs"),
    [
        pytest.param(0.2, 1, marks=pytest.mark.slow),
        pytest.param(0.7, 1, marks=pytest.mark.slow),
        pytest.param(0.95, 2, marks=pytest.mark.slow),
    ],
)
def test_the_end_is_the_same_as_without_the_interruption(whole, robot, tmp_path, share, jobs):
    recordings, options, expected, count = whole
    options = dataclasses.replace(options, jobs=jobs)
    ledger = Broken(tmp_path / "state.jsonl", "this")
    ledger.left = int(share * count)
    with pytest.raises(KeyboardInterrupt):
        diagnose(robot, recordings[:1], recordings[1:], options, ledger=ledger)
    ledger.close()
    again = Ledger(tmp_path / "state.jsonl", "this")
    known = int(share * count) - (jobs - 1)  # another thread may be at the point of writing when the file is closed
    assert again.recalled >= known
    assert answer(diagnose(robot, recordings[:1], recordings[1:], options, ledger=again)) == expected
    assert again.size - again.recalled < count - known + 1, "what was known was not fitted again"


@pytest.mark.slow
def test_a_known_search_is_not_fitted_again(whole, robot, tmp_path, monkeypatch):
    recordings, options, expected, count = whole
    ledger = Ledger(tmp_path / "state.jsonl", "this")
    diagnose(robot, recordings[:1], recordings[1:], options, ledger=ledger)
    again = Ledger(tmp_path / "state.jsonl", "this")
    assert again.recalled == ledger.size == count
    asked = []
    recall = again.recall
    monkeypatch.setattr(again, "recall", lambda key: asked.append(key) or recall(key))
    assert answer(diagnose(robot, recordings[:1], recordings[1:], options, ledger=again)) == expected
    assert again.size == count
    assert set(asked) <= set(again._known)


@pytest.mark.slow
def test_a_second_search_over_all_recordings_is_remembered_too(whole, robot, tmp_path, monkeypatch):
    (estimation, held_out), options, *_ = whole
    options = dataclasses.replace(options, effects=("stribeck_friction",))
    monkeypatch.setattr("diagnose.pipeline.only_held_out_shows", lambda result: True)
    ledger = Ledger(tmp_path / "state.jsonl", "this")
    first = diagnose(robot, [estimation], [held_out], options, ledger=ledger)
    assert any(note.startswith("The estimation recordings fit without it") for note in first.notes)
    again = Ledger(tmp_path / "state.jsonl", "this")
    assert answer(diagnose(robot, [estimation], [held_out], options, ledger=again)) == answer(first)
    assert again.size == again.recalled == ledger.size


@pytest.mark.parametrize("damage", [lambda line: line.replace('"n": 9', '"n": 8'), lambda line: "[" * 100_000 + "\n"])
def test_a_line_that_was_altered_is_dropped(tmp_path, damage):
    path, one = tmp_path / "state.jsonl", float(1).hex()
    said = {"x": [one], "cost": one, "status": "CONVERGED", "iterations": 3, "gain": one, "n": 9, "work": 4}
    lines = [json.dumps(s | {"check": checksum(s)}) + "\n" for s in ({"key": k, **said} for k in "ab")]
    head = json.dumps({"format": FORMAT, "follows": "this"}) + "\n"
    path.write_text(head + "".join(lines))
    assert Ledger(path, "this").size == 2
    path.write_text(head + lines[0] + damage(lines[1]))
    ledger = Ledger(path, "this")
    assert ledger.recall("a") is not None
    assert ledger.size == 1
    assert path.read_text() == head + lines[0]


def test_other_samples_of_a_recording_are_another_fit(recordings, robot, tmp_path):
    estimation, held_out = recordings
    ledger = Ledger(tmp_path / "state.jsonl", "this")
    whole_of_it = prepare(estimation)
    half = dataclasses.replace(whole_of_it, counts=whole_of_it.counts & (np.arange(len(estimation)) % 2 == 0))
    for experiment in (whole_of_it, half):
        fitter = Fitter(robot, MotionView(), (experiment,), (prepare(held_out),), 1, ledger=ledger)
        fitter = Fitter.of(dataclasses.replace(fitter.problem, sigmas={id(experiment): 1.0}), fitter.engine)
        fitter.fit(fitter.hypothesis(()), iterations=1)
    assert ledger.size == 2


def test_a_fit_that_is_recalled_is_the_fit(recordings, robot, tmp_path):
    estimation, held_out = recordings
    ledger = Ledger(tmp_path / "state.jsonl", "this")

    def fits(ledger):
        fitter = Fitter(robot, MotionView(), (prepare(estimation),), (prepare(held_out),), 1, ledger=ledger)
        base = fitter.fit(fitter.hypothesis(()), iterations=5)
        h = fitter.hypothesis((effect("coulomb_friction", torque_Nm=0.05),), base.linear)
        return base, fitter.fit(h, iterations=3, neighbour=base, secant=True), fitter.runs

    first, second = fits(ledger), fits(Ledger(tmp_path / "state.jsonl", "this"))
    assert first[2] == second[2], "a budget of runs counts what was recalled"
    for a, b in zip(first[:2], second[:2], strict=True):
        np.testing.assert_array_equal(a.fit.x, b.fit.x)
        np.testing.assert_array_equal(a.fit.residual, b.fit.residual)
        np.testing.assert_array_equal(a.fit.J, b.fit.J)
        assert (a.fit.cost, a.fit.status, a.fit.iterations, a.n) == (b.fit.cost, b.fit.status, b.fit.iterations, b.n)


def test_lines_come_back_to_the_last_digit_and_a_cut_one_is_dropped(tmp_path):
    path = tmp_path / "deep" / "state.jsonl"
    ledger = Ledger(path, "this")
    assert not path.parent.exists(), "nothing is made before there is a fit"
    for key in ("a", "b", "a"):
        ledger.keep(key, FIT, 7, 11)
    text = path.read_text()
    assert len(text.splitlines()) == 3
    path.write_text(text[:-20])
    again = Ledger(path, "this")
    assert again.recalled == 1
    known = again.recall("a")
    assert known is not None
    assert [v.hex() for v in known.x] == [v.hex() for v in FIT.x]
    assert (known.cost, known.status, known.n, known.work) == (0.1, Status.BUDGET, 7, 11)
    assert known.predicted_gain == np.inf
    again.keep("b", FIT, 7, 11)
    assert Ledger(path, "this").recalled == 2
    assert [p.name for p in path.parent.iterdir()] == ["state.jsonl"]


def test_what_follows_from_something_else_is_not_used(tmp_path):
    path = tmp_path / "state.jsonl"
    Ledger(path, "this").keep("a", FIT, 7, 11)
    other = Ledger(path, "that")
    assert other.recall("a") is None
    other.keep("c", FIT, 7, 11)
    assert Ledger(path, "this").recalled == 0
    assert Ledger(path, "that").recalled == 1
    path.write_bytes(b"\xff\xfe rubbish")
    assert Ledger(path, "this").recalled == 0
    ledger = Ledger(tmp_path / "a" / "b" / "state.jsonl", "this")
    ledger.keep("a", FIT, 7, 11)
    ledger.discard()
    ledger.keep("b", FIT, 7, 11)
    assert not (tmp_path / "a").exists()


def test_the_hash_sees_what_a_fit_follows_from(pair, robot):
    one, two = pair(seconds=1.0)
    known = {fingerprint(robot, (one,), Options())}
    known.add(fingerprint(robot, (two,), Options()))
    known.add(fingerprint(robot, (one, two), Options()))
    known.add(fingerprint(robot.with_linear({"Jm": 4.5e-4}), (one,), Options()))
    known.add(fingerprint(robot, (one,), Options(depth=1)))
    assert len(known) == 5
    same = dataclasses.replace(one, torque=np.array(one.torque))
    assert fingerprint(robot, (same,), Options()) in known


def write(path, r):
    rows = np.column_stack([r.time, r.torque, r.velocity, r.angle])
    np.savetxt(path, rows, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="", fmt="%.17g")
    return path


@pytest.fixture
def files(recordings, tmp_path):
    estimation, held_out = recordings
    return write(tmp_path / "log.csv", estimation), write(tmp_path / "other.csv", held_out)


def command(files, out, *more):
    model = str(shipped_model("robot_axis1"))
    return [
        "diagnose", str(files[0]), "--held-out", str(files[1]), "--model", model, "--out", str(out), "--effects", ",".join(FEW),
        "--jobs", "1", "--quiet", *more,
    ]  # fmt: skip


@pytest.mark.slow
def test_the_command_says_how_to_go_on_and_leaves_nothing_half_written(pair, tmp_path, monkeypatch):
    out, straight = tmp_path / "report", tmp_path / "straight"
    recordings = pair(effect("torque_offset", torque_Nm=0.05), seconds=1.0)
    files = [write(tmp_path / name, r) for name, r in zip(("log.csv", "other.csv"), recordings, strict=True)]
    fewer = ("--effects", "torque_offset")
    assert CliRunner().invoke(cli, command(files, straight, *fewer)).exit_code == 0
    Broken.left = 6
    with monkeypatch.context() as m:
        m.setattr(pipeline, "Ledger", Broken)
        broken = CliRunner().invoke(cli, command(files, out, *fewer))
    assert broken.exit_code == 130
    assert broken.stderr.strip().splitlines() == [
        f"simgap: interrupted; the fits are kept in {out / 'state.jsonl'}: the same command continues"
    ]
    assert [p.name for p in out.iterdir()] == ["state.jsonl"]
    assert CliRunner().invoke(cli, command(files, out, *fewer)).exit_code == 0
    left = {p.name for p in out.iterdir()}
    assert left == {p.name for p in straight.iterdir()} >= {"corrected.xml", "diagnosis.json", "report.html"}
    assert "state.jsonl" not in left
    one, two = (json.loads((folder / "diagnosis.json").read_text()) for folder in (straight, out))
    assert {**one, "seconds": 0} == {**two, "seconds": 0}
    assert (straight / "corrected.xml").read_text() == (out / "corrected.xml").read_text()


def test_interrupted_before_the_first_fit_nothing_is_there(files, tmp_path, monkeypatch):
    Broken.left = 0
    monkeypatch.setattr(pipeline, "Ledger", Broken)
    broken = CliRunner().invoke(cli, command(files, tmp_path / "report"))
    assert broken.exit_code == 130
    assert "nothing was written" in broken.stderr
    assert not (tmp_path / "report").exists()


@pytest.mark.slow
def test_bad_input_leaves_no_state(files, tmp_path):
    axis = load_axis(shipped_model("robot_axis1"))
    assert axis.chain.couplings[0].damping < 0
    model = tmp_path / "wild.xml"
    text = shipped_model("robot_axis1").read_text().replace('damping="-62"', 'damping="-62000"')
    assert "-62000" in text
    model.write_text(text)
    arguments = command(files, tmp_path / "report")
    arguments[arguments.index("--model") + 1] = str(model)
    answer = CliRunner().invoke(cli, arguments)
    assert answer.exit_code != 0
    assert not (tmp_path / "report" / "state.jsonl").exists()


@pytest.mark.slow
def test_ctrl_c_on_the_running_command(files, tmp_path):
    out = tmp_path / "report"
    process = [sys.executable, "-m", "simgap", *command(files, out)]
    # a shell that puts its jobs in the background has them ignore the signal, and they hand that on
    running = subprocess.Popen(
        process, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    end = time.monotonic() + 120
    while time.monotonic() < end and not ((out / "state.jsonl").exists() and (out / "state.jsonl").stat().st_size > 3000):
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130, said
    assert "the same command continues" in said
    assert len(said.strip().splitlines()) == 1
    assert [p.name for p in out.iterdir()] == ["state.jsonl"]
    assert subprocess.run(process, check=False).returncode == 0
    assert {p.name for p in out.iterdir()} == {"corrected.xml", "diagnosis.json", "report.html"}
