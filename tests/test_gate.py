"""`simgap gate`: an unchanged model passes, a worse one fails with exit 1, what cannot be compared is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from diagnose.options import Options
from mjsim.errors import CheckError, InputError
from mjsim.mjcf import load_axis
from mjsim.ode import simulate
from mjsim.recording import load
from simgap.commands.gate import command
from simgap.pipeline import diagnose_files

MODEL = """<mujoco><compiler autolimits="false"/><option gravity="0 0 0"/><worldbody><body name="disc">
<joint name="motor" type="hinge" damping="{damping}"/><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body>
</worldbody><actuator><motor name="motor_torque" joint="motor"/></actuator></mujoco>"""
DT, N, NOISE = 1e-3, 2000, 0.05


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two recordings of a disc whose damping is twice that of model.xml, and the baseline of model.xml on them."""
    (tmp_path / "model.xml").write_text(MODEL.format(damping=0.03))
    (tmp_path / "true.xml").write_text(MODEL.format(damping=0.06))
    (tmp_path / "worse.xml").write_text(MODEL.format(damping=0.02))
    t = DT * np.arange(N)
    rms = []
    for i, name in enumerate(("a.csv", "b.csv")):
        u = np.sin(2 * np.pi * (1 + i + 2 * t) * t)
        rng = np.random.default_rng(i)
        v = simulate(load_axis(tmp_path / "true.xml"), u, DT).velocity + NOISE * rng.standard_normal(N)
        table = np.column_stack([t, u, v])
        np.savetxt(tmp_path / name, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s", comments="")
        e = v - simulate(load_axis(tmp_path / "model.xml"), u, DT).velocity
        rms.append(float(np.sqrt(np.mean(e**2))))
    baseline(tmp_path, rms)
    return tmp_path


def baseline(folder: Path, rms: list[float], roles: tuple[str, str] = ("estimation", "held-out")) -> None:
    fit = {"rms": rms[0], "held_out_rms": rms[-1]}
    recordings = [
        {"file": n, "sha256": load(folder / n).sha256, "role": r} for n, r in zip(("a.csv", "b.csv"), roles, strict=True)
    ]
    told = {"fit": {"nominal": fit}, "recordings": recordings, "judged_on": {"view": "motion (free run)", "unit": "rad/s"}}
    (folder / "diagnosis.json").write_text(json.dumps(told))


def gate(folder: Path, model: str, *more: str):
    words = [str(folder / model), str(folder / "a.csv"), str(folder / "b.csv"), "--baseline", str(folder / "diagnosis.json")]
    return CliRunner().invoke(command, [*words, "--json", *more])


def test_an_unchanged_model_passes(folder):
    ended = gate(folder, "model.xml")
    assert ended.exit_code == 0, ended.exception
    told = json.loads(ended.stdout)
    assert told["passed"]
    assert [c["role"] for c in told["checks"]] == ["estimation", "held-out"]
    for check in told["checks"]:
        assert check["ratio"] == pytest.approx(1.0, abs=1e-3)


def test_a_better_model_passes_and_a_worse_one_fails(folder):
    assert gate(folder, "true.xml").exit_code == 0
    ended = gate(folder, "worse.xml")
    assert isinstance(ended.exception, CheckError)
    told = json.loads(ended.stdout)
    assert not told["passed"]
    assert all(c["grew"] for c in told["checks"])


def test_the_tolerance_decides(folder):
    growth = max(c["ratio"] for c in json.loads(gate(folder, "worse.xml").stdout)["checks"]) - 1
    assert isinstance(gate(folder, "worse.xml", "--tolerance", f"{0.99 * growth}").exception, CheckError)
    assert gate(folder, "worse.xml", "--tolerance", f"{1.01 * growth}").exit_code == 0


def test_recordings_of_one_role_are_compared_together(folder):
    """The baseline has one figure for them: alone, one would fail and the other pass by their different motions."""
    told = [c["baseline_rms"] for c in json.loads(gate(folder, "model.xml").stdout)["checks"]]
    pooled = math.sqrt(sum(r**2 for r in told) / 2)
    baseline(folder, [pooled], ("estimation", "estimation"))
    checks = json.loads(gate(folder, "model.xml").stdout)["checks"]
    assert [c["recordings"] for c in checks] == [["a.csv", "b.csv"]]
    assert checks[0]["ratio"] == pytest.approx(1.0, abs=1e-3)


def test_blocks_that_were_held_out(folder):
    """Without a held-out recording the baseline has two figures of one recording: blocks of it, weighted by their length."""
    from diagnose.data.experiment import hold_out_blocks

    record = load(folder / "a.csv")
    error = record.velocity - simulate(load_axis(folder / "model.xml"), record.torque, DT).velocity
    rms = [float(np.sqrt(np.mean(error[mask] ** 2))) for mask in hold_out_blocks(record)]
    baseline(folder, rms)
    path = folder / "diagnosis.json"
    told = json.loads(path.read_text())
    told["recordings"][1]["sha256"] = told["recordings"][0]["sha256"]
    path.write_text(json.dumps(told))
    ended = CliRunner().invoke(command, [str(folder / "model.xml"), str(folder / "a.csv"), "--baseline", str(path), "--json"])
    assert json.loads(ended.stdout)["checks"][0]["ratio"] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "not valid JSON"),
        ("[]", "not a diagnosis"),
        ("{}", "not a diagnosis"),
        ('{"fit": {"nominal": 3}}', "not a diagnosis"),
    ],
)
def test_a_baseline_that_is_none(folder, text, said):
    (folder / "diagnosis.json").write_text(text)
    ended = gate(folder, "model.xml")
    assert isinstance(ended.exception, InputError)
    assert said in str(ended.exception)
    (folder / "diagnosis.json").unlink()
    assert "no such file" in str(gate(folder, "model.xml").exception)


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory) -> Path:
    """A recording and its diagnosis, whose figures are those of MuJoCo; ``soft.xml`` differs in the timestep alone."""
    folder = tmp_path_factory.mktemp("diagnosed")
    given = MODEL.format(damping=0.03)
    (folder / "model.xml").write_text(given)
    (folder / "worse.xml").write_text(MODEL.format(damping=0.02))
    (folder / "coarse.xml").write_text(given.replace("<option ", '<option timestep="0.05" '))
    t = DT * np.arange(N)
    u = np.sin(2 * np.pi * (1 + 2 * t) * t)
    v = simulate(load_axis(folder / "model.xml"), u, DT).velocity + 0.005 * np.random.default_rng(0).standard_normal(N)
    table = np.column_stack([t, u, v])
    np.savetxt(folder / "a.csv", table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s", comments="")
    few = Options(effects=("torque_offset",))
    diagnose_files([folder / "a.csv"], folder / "model.xml", folder / "report", (), few, progress=False, page=False)
    return folder


def of_diagnosed(folder: Path, model: str, *more: str):
    words = [str(folder / model), str(folder / "a.csv"), "--baseline", str(folder / "report" / "diagnosis.json"), "--json"]
    return CliRunner().invoke(command, [*words, *more])


@pytest.mark.parametrize(("model", "against"), [("model.xml", "nominal"), ("report/corrected.xml", "corrected")])
def test_the_model_of_a_diagnosis_has_the_figures_of_the_diagnosis(diagnosed, model, against):
    ended = of_diagnosed(diagnosed, model, "--against", against)
    assert ended.exit_code == 0, ended.exception
    (check,) = json.loads(ended.stdout)["checks"]
    assert check["role"] == "estimation + held-out"
    assert check["ratio"] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("model", ["worse.xml", "coarse.xml"])
def test_numbers_and_settings_of_the_simulator_count(diagnosed, model):
    """The baseline is of the file as MuJoCo steps it: a coarse timestep is a worse model."""
    ended = of_diagnosed(diagnosed, model)
    assert isinstance(ended.exception, CheckError), ended.exception


def test_the_summary_for_a_pull_request(diagnosed, tmp_path):
    for model, said in (("model.xml", "no error grew"), ("worse.xml", "1 of 1 errors grew")):
        of_diagnosed(diagnosed, model, "--markdown", str(tmp_path / "new" / "summary.md"))
        text = (tmp_path / "new" / "summary.md").read_text()
        assert said in text
        assert text.count("\n| ") == 2
    refused = of_diagnosed(diagnosed, "model.xml", "--markdown", str(diagnosed / "a.csv"))
    assert "overwrite" in str(refused.exception)


def test_another_recording_is_refused(folder):
    text = (folder / "b.csv").read_text()
    (folder / "b.csv").write_text(text.replace("\n", "\n", 1) + "\n")
    ended = gate(folder, "model.xml")
    assert isinstance(ended.exception, InputError)
    assert "not one of the recordings" in str(ended.exception)


def test_an_input_goes_between_samples_as_the_diagnosis_took_it(folder):
    """Of a recording whose binding states no hold: the file as given then has the figures of the diagnosis."""
    errors = []
    for name in ("a.csv", "b.csv"):
        r = load(folder / name)
        run = simulate(load_axis(folder / "model.xml"), r.torque, DT, hold="linear")
        errors.append(float(np.sqrt(np.mean((r.velocity - run.velocity) ** 2))))
    baseline(folder, errors)
    apart = json.loads(gate(folder, "model.xml").stdout)["checks"][0]["ratio"]
    path = folder / "diagnosis.json"
    told = json.loads(path.read_text())
    for row in told["recordings"]:
        row["hold"] = "linear"
    path.write_text(json.dumps(told))
    ratio = json.loads(gate(folder, "model.xml").stdout)["checks"][0]["ratio"]
    assert ratio == pytest.approx(1.0, abs=1e-6)
    assert abs(apart - 1.0) > 1e-5


def test_a_replay_takes_the_hold_of_the_diagnosis_beside_its_model(folder):
    from simgap.commands.replay import command as replay

    path = folder / "diagnosis.json"
    out = folder / "out.csv"
    words = [str(folder / "model.xml"), str(folder / "a.csv"), "--out", str(out), "--json", "--start", "rest"]
    r = load(folder / "a.csv")
    axis = load_axis(folder / "model.xml")
    for hold in ("held", "linear"):
        told = json.loads(path.read_text())
        told["recordings"][0]["hold"] = hold
        path.write_text(json.dumps(told))
        rms = json.loads(CliRunner().invoke(replay, words).stdout)["rms"]
        error = r.velocity - simulate(axis, r.torque, DT, hold=hold).velocity
        assert rms == pytest.approx(float(np.sqrt(np.mean(error**2))), rel=1e-6)
    path.write_text("[")  # a damaged file beside the model says nothing
    assert CliRunner().invoke(replay, words).exit_code == 0
