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
