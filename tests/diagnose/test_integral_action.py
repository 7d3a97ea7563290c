"""Integral action of a servo in logs of plain MuJoCo: named, its gain found, corrected.xml stepped from the start found."""

from __future__ import annotations

import json
import math

import pytest
from click.testing import CliRunner

from diagnose.options import Options
from lab.real_use.pid import PidCase, draw, make_files
from simgap.cli import cli
from simgap.pipeline import diagnose_files

FEW = ("integral_action", "coulomb_friction", "actuator_lag")


def case(begin: str, kind: str = "integral", machine: str = "pendulum") -> PidCase:
    return PidCase(0, machine, 100.0, "sines", "noise", begin, False, kind, 11)


def diagnosed(folder, of: PidCase, model: str = "nominal"):
    given, truth = make_files(of, folder)
    logs = [folder / f"{name}.csv" for name in ("estimation", "held_out")]
    options = Options(jobs=1, effects=FEW)
    result = diagnose_files(logs[:1], folder / f"{model}.xml", folder / "out", logs[1:], options, progress=False, accept_log=True)
    return result, given, truth


@pytest.mark.slow
@pytest.mark.parametrize(
    ("begin", "machine"),
    [("rest", "pendulum"), ("motion", "pendulum"), ("motion", "geared")],
)
def test_it_is_named_from_a_start_at_rest_under_gravity_and_in_motion(tmp_path, begin, machine):
    result, _, truth = diagnosed(tmp_path, case(begin, machine=machine))
    assert [f.effect for f in result.findings] == ["integral_action"]
    found = result.findings[0].parameters
    assert found["gain_Nm_rad_s"].value == pytest.approx(truth.ki / truth.gear**2, rel=0.02)
    assert found["gain_Nm_rad_s"].unit == "N m/(rad s)"
    assert result.verdict.value == "missing_physics"
    assert result.fit["corrected"].held_out_rms < 1.1 * result.noise_floor, "by plain MuJoCo"


@pytest.mark.slow
def test_a_file_with_ki_is_no_mismatch_and_other_gains_are_parameters(tmp_path):
    result, *_ = diagnosed(tmp_path / "same", case("rest"), model="true")
    assert result.verdict.value == "no_mismatch"
    result, *_ = diagnosed(tmp_path / "gains", case("motion", kind="gains"))
    assert (result.verdict.value, result.findings) == ("parameters_only", ())


def test_replay_starts_the_integral_as_the_recording_does(tmp_path):
    """Of the held-out recording, whose start is another; beside it plain MuJoCo on the same start."""
    make_files(case("rest"), tmp_path)
    told = CliRunner().invoke(
        cli, ["replay", str(tmp_path / "true.xml"), str(tmp_path / "held_out.csv"), "--out", str(tmp_path / "p.csv"), "--json"]
    )
    assert told.exit_code == 0, told.output
    said = json.loads(told.output)
    (name, force), *_ = said["start"]["states"]
    assert name == "integral_action@actuator.start_Nm"
    assert force != 0.0
    assert said["nrmse"] < 0.01
    assert said["plain_mujoco_rms"] < 1.1 * said["rms"]


def test_the_sample_is_even_in_what_it_lacks():
    cases = draw(24, 5)
    assert sum(c.kind == "integral" for c in cases) == 12
    assert {c.kind for c in cases} == {"integral", "nothing", "gains", "friction", "limit", "delay"}
    assert math.isclose(len({c.seed for c in cases}), 24)


@pytest.mark.slow
def test_it_is_tried_where_a_score_test_misjudges_it(tmp_path):
    """Gains fitted without it are twice the true ones, about which its response is nearly theirs."""
    of = PidCase(1, "pendulum", 100.0, "sines", "encoder", "rest", False, "integral", draw(24, 74101)[1].seed)
    result, _, truth = diagnosed(tmp_path, of)
    assert [f.effect for f in result.findings] == ["integral_action"]
    assert result.findings[0].parameters["gain_Nm_rad_s"].value == pytest.approx(truth.ki, rel=0.02)
