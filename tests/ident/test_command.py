"""``simgap identify`` from the outside."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from mjsim.errors import InputError
from simgap.commands.identify import command


@pytest.fixture
def log(tmp_path, bj_truth):
    data = bj_truth.record(1200, 1)
    path = tmp_path / "log.csv"
    table = np.column_stack([data.time, data.u, data.y])
    np.savetxt(path, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s", comments="", fmt="%.12g")
    return path


def run(*args):
    return CliRunner().invoke(command, [str(a) for a in args], catch_exceptions=True)


def test_writes_model_figures_and_page(log, tmp_path):
    out = tmp_path / "out"
    result = run(log, "--out", out, "--orders", "2,2,2,2,1", "--decimate", 1, "--cutoff", "none", "--validate", log)
    assert result.exit_code == 0, result.output
    assert sorted(p.name for p in out.iterdir()) == ["bode.png", "identification.html", "identification.json", "residuals.png"]
    assert "The model is good" in result.output
    values = json.loads((out / "identification.json").read_text())
    assert values["orders"] == [2, 2, 2, 2, 1]
    assert values["F"][1] == pytest.approx(-1.5, abs=0.05)
    page = (out / "identification.html").read_text()
    assert "The model is good" in page
    assert "http" not in page.replace("http-equiv", "")
    assert "default-src 'none'; script-src 'sha256-" in page
    assert " style=" not in page


def test_json_goes_to_standard_output(log, tmp_path):
    result = run(
        log,
        "--out",
        tmp_path / "out",
        "--orders",
        "2,1,1,2,1",
        "--decimate",
        2,
        "--json",
        "--input",
        "torque_Nm",
        "--output",
        "velocity_rad_s",
    )
    values = json.loads(result.stdout)
    assert values["dt"] == pytest.approx(0.2)
    assert values["input"] == {"name": "torque_Nm", "unit": "Nm"}


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("--orders", "1,2"), "nb,nc,nd,nf,nk"),
        (("--orders", "a,b,c,d,e"), "five whole numbers"),
        (("--cutoff", "2"), "fraction of Nyquist"),
        (("--decimate", "0"), "decimation"),
        (("--decimate", "100"), "samples"),
        (("--input", "nothing"), "nothing"),
        (("--scan", "3"), "LOW:HIGH"),
        (("--scan", "5:2"), "LOW:HIGH"),
        (("--level", "none.csv"), "none.csv"),
        (("--model", "none.xml"), "none.xml: no such file"),
        (("--input", "torque", "--output", "torque"), "both torque"),
    ],
)
def test_bad_use_is_one_line_and_leaves_nothing(log, tmp_path, args, said):
    out = tmp_path / "out"
    result = run(log, "--out", out, *args)
    assert isinstance(result.exception, InputError)
    assert said in str(result.exception)
    assert not out.exists()


def test_a_missing_file_is_one_line(tmp_path):
    result = run(tmp_path / "no.csv", "--out", tmp_path / "out")
    assert isinstance(result.exception, InputError)
    assert "no.csv" in str(result.exception)


@pytest.mark.slow
def test_a_range_of_orders_is_tried_and_pictured(log, tmp_path):
    out = tmp_path / "out"
    result = run(log, "--out", out, "--decimate", 1, "--cutoff", "none", "--scan", "1:4")
    assert result.exit_code == 0, result.output
    values = json.loads((out / "identification.json").read_text())
    assert values["orders"] == [2, 2, 2, 2, 1]
    assert [c["orders"][0] for c in values["orders_tried"]] == [1, 2, 3, 4]
    assert (out / "orders.png").stat().st_size > 1000
    assert "<h2>Orders</h2>" in (out / "identification.html").read_text()


@pytest.mark.slow
def test_another_level_answers_whether_it_is_linear(log, tmp_path, bj_truth):
    data = bj_truth.record(1200, 2)
    for name, law in (("linear", lambda y: y), ("bent", lambda y: y - 0.3 * np.tanh(y))):
        quiet = bj_truth.model.simulate(0.5 * data.u) + 0.3 * np.random.default_rng(5).standard_normal(1200)
        path = tmp_path / f"{name}.csv"
        table = np.column_stack([data.time, 0.5 * data.u, law(quiet)])
        np.savetxt(path, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s", comments="", fmt="%.12g")
        loud = tmp_path / f"loud_{name}.csv"
        table = np.column_stack([data.time, data.u, law(data.y)])
        np.savetxt(loud, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s", comments="", fmt="%.12g")
        args = ("--orders", "2,2,2,2,1", "--decimate", 1, "--cutoff", "none")
        result = run(loud, "--out", tmp_path / name, *args, "--level", path, "--json")
        assert result.exit_code == 0, result.output
        assert json.loads(result.stdout)["amplitude_test"]["nonlinear"] is (name == "bent")


ORDERS = ("--orders", "2,2,2,2,1", "--decimate", 1, "--cutoff", "none")


@pytest.fixture(scope="module")
def sine(tmp_path_factory, bj_truth):
    t = 0.1 * np.arange(400)
    u = np.sin(t)
    path = tmp_path_factory.mktemp("sine") / "sine.csv"
    table = np.column_stack([t, u, bj_truth.model.simulate(u)])
    np.savetxt(path, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s", comments="", fmt="%.12g")
    return path


@pytest.fixture(scope="module")
def told(tmp_path_factory, bj_truth, sine):
    """What is said of a recording that keeps one value for a while, validated on a sine."""
    data = bj_truth.record(1200, 1)
    y = np.array(data.y)
    y[500:540] = y[500]
    path = tmp_path_factory.mktemp("held") / "held.csv"
    table = np.column_stack([data.time, data.u, y])
    np.savetxt(path, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s", comments="", fmt="%.12g")
    return " ".join(run(path, "--out", path.parent / "out", *ORDERS, "--validate", sine).output.split())


def test_what_validates_need_not_excite_every_direction(told, sine, tmp_path):
    assert "On sine.csv its simulation fits" in told
    assert "excites only" in str(run(sine, "--out", tmp_path / "out", *ORDERS).exception)


def test_a_machines_model_names_the_columns(log, tmp_path):
    (tmp_path / "sub").mkdir()
    text = log.read_text().replace("torque_Nm", "force", 1).replace("velocity_rad_s", "speed", 1)
    other = tmp_path / "sub" / "drive.csv"
    other.write_text(text)
    (tmp_path / "machine.toml").write_text(
        '[recording]\ntime="time_s"\ntorque={column="force",unit="N"}\nvelocity={column="speed",unit="m/s"}\n'
    )
    args = ("--orders", "2,2,2,2,1", "--decimate", 1, "--cutoff", "none", "--json")
    result = run(other, "--out", tmp_path / "out", *args, "--model", tmp_path / "machine.xml")
    assert json.loads(result.stdout)["output"] == {"name": "velocity", "unit": "m/s"}


@pytest.mark.slow
def test_a_failure_in_the_middle_leaves_no_half_written_set(log, tmp_path, monkeypatch):
    from pathlib import Path

    out = tmp_path / "out"
    args = ("--orders", "2,2,2,2,1", "--decimate", 1, "--cutoff", "none")
    real, calls = Path.replace, [0]

    def sometimes(self, target):
        calls[0] += 1
        if calls[0] == 3:
            raise OSError(28, "No space left on device")
        return real(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", sometimes)
        result = run(log, "--out", out, *args)
    assert isinstance(result.exception, InputError)
    assert "No space left" in str(result.exception)
    assert not out.exists()
    assert run(log, "--out", out, *args).exit_code == 0


def test_lost_samples_are_told(told):
    assert "velocity keeps one value for 40 samples from sample 501 on" in told


def test_a_long_recording_is_fitted_where_its_output_varies_most(tmp_path, bj_truth, monkeypatch):
    """Of 1200 samples the 400 of a louder input; the simulation is of all of them."""
    import simgap.api.identifying as identifying

    monkeypatch.setattr(identifying, "LONGEST", 400)
    data = bj_truth.record(1200, 1)
    quiet = np.where((np.arange(1200) >= 600) & (np.arange(1200) < 1000), 1.0, 0.05)
    log = {"time_s": data.time, "torque_Nm": quiet * data.u, "velocity_rad_s": quiet * data.y}
    fitted = identifying.identify(log, orders=(2, 2, 2, 2, 1), decimate=1, cutoff=None)
    np.testing.assert_array_equal(fitted.estimate.data.y, log["velocity_rad_s"][600:1000])
    assert len(fitted.comparison.data) == 1200
    assert fitted.preprocessing[-1].startswith(f"fitted to {data.time[600]:.6g} to {data.time[999]:.6g} s, 400 of 1200 samples")
    assert "400 of 1200 samples" in fitted.text()
    monkeypatch.setattr(identifying, "LONGEST", 1200)
    everything = identifying.identify(log, orders=(2, 2, 2, 2, 1), decimate=1, cutoff=None)
    assert len(everything.estimate.data) == 1200
    assert not any("fitted to" in step for step in everything.preprocessing)
