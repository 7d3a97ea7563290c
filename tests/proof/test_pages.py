"""The pages of the proof: what is missing is said, and what is written was computed."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.result import Estimate
from lab.proof.concealed import AMPLITUDE, delayed, pushed
from lab.proof.emps import SERVO
from lab.proof.kuka import ripple_by_speed
from lab.proof.page import Page, axes, table, write_page
from lab.proof.servo import Servo, close_position_loop
from lab.proof.so101 import _found
from lab.proof.summary import summary_page
from mjsim.effects import effect_class
from mjsim.errors import InputError
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate
from mjsim.recording import load


def test_what_was_not_run_is_said(tmp_path):
    page = summary_page(tmp_path)
    assert page.text.count("ot run") == 4
    assert page.figures == {"benchmark": False, "emps": False, "kuka": False, "concealed_real": False}


def test_a_benchmark_is_read_and_not_invented(tmp_path):
    share = {"share": True, "interval": [0.0, 0.03], "n": 180}
    bars = [
        {"text": "False alarms", "asked": "at most 2 %", "value": 0.01, "status": "holds", **share},
        {"text": "Median error", "asked": "at most 3 %", "value": 0.05, "status": "fails", **share, "interval": None},
    ]
    rate = {"share": 0.5, "n": 8}
    summary = {
        "n": 8, "grade": "quick", "seed": 3, "counts": {"plain": 8}, "first": None, "envelope_sha256": "ab" * 32, "bars": bars,
        "levels": {"plain": {"right": rate, "verdict": rate}},
        "power": {"named": {"at50": 0.31, "at90": 0.62, "at50_ci95": [0.2, 0.4], "at90_ci95": [0.5, 0.9]}},
    }  # fmt: skip
    path = tmp_path / "benchmark.json"
    path.write_text(json.dumps(summary), encoding="utf-8")
    text = summary_page(tmp_path, path).text
    assert "| False alarms | at most 2 % | 1.0 % | 0.0 % … 3.0 % | 180 | holds |" in text
    assert "Bars that are missed: Median error." in text
    assert "0.31 times the noise" in text
    summary["power"]["named"]["at90_ci95"] = [0.0, None]
    path.write_text(json.dumps(summary), encoding="utf-8")
    assert "intervals of the 50 % and 90 % points are open" in summary_page(tmp_path, path).text
    rate = {"n": 4, "hits": 1, "share": 0.25, "ci95": [0.0, 0.8]}
    arm = {
        "what": "Stepwise",
        "skipped": "",
        "false_alarms": rate,
        "claimed": rate,
        "right": None,
        "seconds": 2.5,
        "failed": {"7": "it broke"},
    }
    skipped = {"what": "Sparse", "skipped": "pysindy not installed", "failed": {}}
    ran = [{**arm, "all": {"over_noise": 1.25, "over_refitted": None}}, skipped]
    path.write_text(json.dumps({**summary, "rivals": {"cases": ["1", "7"], "cases_a_level": 2, "arms": ran}}), encoding="utf-8")
    told = summary_page(tmp_path, path).text
    assert "| Stepwise | 1.25 | – | 1 of 4 | 1 of 4 | – | 2.5 |" in told
    assert "not run: pysindy not installed" in told
    assert "Stepwise broke in 1." in told
    assert "--arms all --arm-cases 2 --out DIR" in told
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "power.svg").write_text("<svg/>", encoding="utf-8")
    pages = tmp_path / "proof"
    assert "](proof/benchmark/power.svg)" in summary_page(pages, path).text
    assert (pages / "benchmark" / "power.svg").read_text(encoding="utf-8") == "<svg/>"
    assert not (pages / "benchmark" / "levels.svg").exists()


def test_a_benchmark_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        summary_page(tmp_path, tmp_path / "none.json")
    (tmp_path / "emps.json").write_text("[", encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read"):
        summary_page(tmp_path)


def test_a_page_is_written_with_its_pictures_and_figures(tmp_path):
    figure, (left,) = axes(3.0, 2.0)
    left.plot([0, 1], [0, 1])
    path = write_page(Page("a", "# A\n", {"line": figure}, {"x": np.float64(1.5), "y": float("nan"), "z": (1, 2)}), tmp_path)
    assert path.read_text(encoding="utf-8") == "# A\n"
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == {"x": 1.5, "y": None, "z": [1, 2]}
    assert (tmp_path / "a" / "line.png").read_bytes()[:4] == b"\x89PNG"
    assert table(["a", "b"], [["1", "2"]]) == "| a | b |\n|---|---|\n| 1 | 2 |"


def test_the_loop_replays_as_a_free_run():
    """What the closed loop commanded, fed to the axis alone, gives the motion that the loop had."""
    axis = load_axis(shipped_model("emps")) + effect_class("coulomb_friction")(torque_Nm=20.0)
    t = 1e-3 * np.arange(1500)
    reference = 0.02 * (1 - np.cos(2 * np.pi * 0.7 * t))
    run = close_position_loop(axis, SERVO, reference, np.zeros_like(t), 1e-3, 0.0)
    free = simulate(axis, run.force, 1e-3)
    assert np.max(np.abs(free.angle - run.position)) < 1e-3 * np.ptp(run.position)
    assert np.max(np.abs(run.position - reference)) < 0.02 * np.ptp(reference)
    # a loop without gain does not follow
    slack = close_position_loop(axis, Servo(0.1, 0.1, 35.0, 10.0), reference, np.zeros_like(t), 1e-3, 0.0)
    assert np.max(np.abs(slack.position - reference)) > 0.5 * np.ptp(reference)


def test_what_is_put_into_real_signals(local_copy):
    recording = load(local_copy("emps", "DATA_EMPS.mat"), model=shipped_model("emps"))
    assert np.max(np.abs(pushed(recording).torque - recording.torque)) == pytest.approx(AMPLITUDE, rel=1e-3)
    late = delayed(recording, 0.004)
    assert np.max(np.abs(late.angle[10:] - recording.angle[6:-4])) < 1e-8  # cubic interpolation of steps of 5e-8 m


def test_ripple_of_a_real_axis_is_found_at_every_speed(local_copy):
    """Published: 8 cycles a turn whose amplitude changes with speed."""
    model = shipped_model("kuka_kr300_axis1")
    axis = load_axis(model) + effect_class("coulomb_friction")(torque_Nm=350.0)
    rows = ripple_by_speed(axis, load(local_copy("kuka_kr300", "rec_FF_A.mat"), model=model))
    fast = [r for r in rows if abs(r["speed"]) > 0.2]
    slow = [r for r in rows if abs(r["speed"]) < 0.12]
    assert min(r["share"] for r in fast) > 0.6
    assert min(r["amplitude_Nm"] for r in fast) > 3 * max(r["amplitude_Nm"] for r in slow)


def test_a_finding_of_a_joint_is_given_with_all_its_numbers():
    both = {"torque_Nm": Estimate(0.5, (-0.1, 1.1), "N m"), "viscous": Estimate(0.2, (0.1, 0.3), "N m s/rad")}
    found = SimpleNamespace(findings=[SimpleNamespace(effect="coupled_transmission", parameters=both)])
    assert _found(found) == "coupled_transmission (torque_Nm 0.5 [-0.1, 1.1], viscous 0.2 [0.1, 0.3])"
    assert _found(SimpleNamespace(findings=[])) == "numbers only"
