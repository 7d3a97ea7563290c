"""``simgap check``, and the check as the first stage of ``simgap diagnose``: exit codes, files, page."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

MODEL = """<mujoco><compiler angle="radian"/><default><geom contype="0" conaffinity="0"/></default>
<worldbody><body name="bob"><joint name="pivot" axis="0 1 0" damping="0.08" frictionloss="0.1"/>
<inertial pos="0 0 -0.4" mass="1.02" diaginertia="0.0168 0.0168 0.0168"/></body></worldbody>
<actuator><motor name="m" joint="pivot"/></actuator></mujoco>"""


@pytest.fixture
def files(tmp_path, log):
    """A model, and ``write(name, recording)`` -> path of a CSV."""
    model = tmp_path / "pendulum.xml"
    model.write_text(MODEL, encoding="utf-8")

    def write(name, recording):
        table = np.column_stack([recording.time, recording.torque, recording.velocity, recording.angle])
        path = tmp_path / name
        np.savetxt(path, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="", fmt="%.12g")
        return path

    return model, write


@pytest.fixture
def run(run_cli):
    """``run("check", ...)`` -> (exit code, standard output, standard error)."""
    return run_cli


def turned(recording):
    import dataclasses

    return dataclasses.replace(recording, torque=-recording.torque)


def test_a_sound_log(run, files, log, tmp_path):
    model, write = files
    code, out, err = run("check", write("a.csv", log()), "--model", model, "--out", tmp_path / "out")
    assert (code, err) == (0, "")
    assert "ready" in out
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["check.html", "check.json"]
    written = json.loads((tmp_path / "out" / "check.json").read_text())
    assert written["verdict"] == "ready"
    assert written["problems"] == []
    assert written["measured"]["a.csv"]["inertia_ratio"]["value"] == pytest.approx(1.1, abs=0.1)


def test_a_wrong_log_is_exit_1_with_every_field_of_the_contract(run, files, log):
    model, write = files
    code, out, err = run("check", write("a.csv", log()), write("b.csv", turned(log(seed=1))), "--model", model, "--json")
    assert (code, err) == (1, "")
    said = json.loads(out)
    assert said["verdict"] == "fix"
    assert [(p["channel"], p["problem"], p["recording"]) for p in said["problems"]] == [("torque", "sign", "b.csv")]
    assert {"channel", "problem", "value", "unit", "advice"} <= set(said["problems"][0])


def test_the_page_stands_alone(run, files, log, tmp_path):
    model, write = files
    run("check", write("<b>.csv", turned(log())), "--model", model, "--out", tmp_path / "out")
    page = (tmp_path / "out" / "check.html").read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>")
    assert "<b>.csv" not in page
    page = re.sub(r"<script.*?</script>", "", page, flags=re.S)
    assert not re.search(r"(?:src|href)=\"(?!#)", page)
    assert " style=" not in page
    assert page.count("<svg") == page.count("</svg>") == 4
    assert "Fix first" in page


def test_jittering_stamps_are_read_and_named(run, files, log):
    import dataclasses

    model, write = files
    r = log()
    shaken = dataclasses.replace(r, time=r.time + 0.2 * r.dt * np.random.default_rng(0).uniform(-1, 1, len(r)))
    code, out, _ = run("check", write("a.csv", shaken), "--model", model, "--json")
    assert code == 0
    assert [p["problem"] for p in json.loads(out)["problems"]] == ["jitter"]


@pytest.mark.parametrize(
    ("change", "says"),
    [(lambda r: r.time[::-1], "time does not increase"), (lambda r: np.where(r.time > 1, np.nan, r.time), "not finite")],
)
def test_bad_input_is_exit_2(change, says, run, files, log, tmp_path):
    import dataclasses

    model, write = files
    path = write("a.csv", dataclasses.replace(log(), time=change(log())))
    code, out, err = run("check", path, "--model", model, "--out", tmp_path / "out")
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert says in err
    assert not (tmp_path / "out").exists()


def test_an_unwritable_folder_is_exit_2(run, files, log, tmp_path):
    model, write = files
    (tmp_path / "taken").write_text("a file", encoding="utf-8")
    code, _, err = run("check", write("a.csv", log()), "--model", model, "--out", tmp_path / "taken")
    assert code == 2
    assert len(err.splitlines()) == 1


def test_a_diagnosis_of_a_wrong_log_names_the_log(run, files, log, tmp_path):
    model, write = files
    code, out, _ = run(
        "diagnose", write("a.csv", turned(log())), "--model", model, "--out", tmp_path / "d", "--json", "--quiet", "--jobs", 1
    )
    said = json.loads(out)
    assert code == 0
    assert said["verdict"] == "unexplained"
    assert said["findings"] == []
    assert "opposite sign" in said["summary"]
    assert said["log"]["verdict"] == "fix"
    assert "gain = -1" in said["next_experiment"]
    page = (tmp_path / "d" / "report.html").read_text(encoding="utf-8")
    assert "The log" in page
    assert sorted(p.name for p in (tmp_path / "d").iterdir()) == ["corrected.xml", "diagnosis.json", "report.html"]


@pytest.mark.slow
def test_the_log_can_be_accepted_all_the_same(run, files, log, tmp_path):
    model, write = files
    code, out, err = run(
        "diagnose", write("a.csv", log(late=0.02)), "--model", model, "--out", tmp_path / "d", "--json", "--quiet", "--jobs", 1,
        "--accept-log", "--effects", "time_delay", "--effort", "0.02",
    )  # fmt: skip
    assert code == 0, err
    said = json.loads(out)
    assert said["log"]["verdict"] == "fix"
    assert said["fit"]
