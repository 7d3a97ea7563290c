"""What is written as diagnosis.json is what the published schema says."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner
from synthetic import synthetic

import simgap
from diagnose.report.schema import diagnosis_schema
from diagnose.result import Estimate, FitFigures, Verdict
from diagnose.robot.result import JointResult, RobotDiagnosis, RobotFinding
from simgap.cli import cli

N = 750


@pytest.fixture(scope="module")
def validator() -> jsonschema.Draft202012Validator:
    jsonschema.Draft202012Validator.check_schema(diagnosis_schema())
    return jsonschema.Draft202012Validator(diagnosis_schema())


def pendulum(sign: float = 1.0) -> dict[str, np.ndarray]:
    """A log of the pendulum: right, or with its velocity turned."""
    t = 0.004 * np.arange(N)
    torque = 3 * np.sin(2 * np.pi * (0.3 + 0.5 * t) * t)
    run = simgap.simulate("pendulum", torque, dt=0.004)
    velocity = run.velocity + 0.01 * np.random.default_rng(1).standard_normal(N)
    return {"time_s": t, "torque_Nm": torque, "velocity_rad_s": sign * velocity}


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["right", "turned"])
def test_a_diagnosis(validator: jsonschema.Draft202012Validator, tmp_path: Path, sign: float) -> None:
    simgap.diagnose(pendulum(sign), "pendulum", out=tmp_path, effects=["torque_offset"])
    written = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert written["verdict"] == ("no_mismatch" if sign > 0 else "unexplained")
    validator.validate(written)


def test_a_diagnosis_with_every_part(validator: jsonschema.Draft202012Validator, tmp_path: Path) -> None:
    synthetic(2_500).write_json(tmp_path / "diagnosis.json")
    validator.validate(json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8")))


def test_a_robot(validator: jsonschema.Draft202012Validator, tmp_path: Path) -> None:
    e, f = Estimate(1.0, (0.9, 1.1), "N m"), FitFigures(0.1, 0.2, 0.1, 0.2)
    finding = RobotFinding("coulomb_friction", "elbow", "elbow", "Friction.", {"torque_Nm": e}, {"delta_chi2": 9.0})
    joint = JointResult(
        "elbow", "N m", Verdict.MISSING_PHYSICS, "Friction is missing.", (finding,), {"nominal": f}, {"armature": e},
        {"armature": 1.0}, (0.0, 1.0), (),
    )  # fmt: skip
    robot = RobotDiagnosis(
        Verdict.MISSING_PHYSICS, "Friction is missing.", {"elbow": joint}, {"nominal": f, "surrogate": f}, {"arm.mass": e},
        {"arm.mass": 1.0}, (), (), (), 3, 20.0, ({"file": "a.csv", "sha256": "0", "role": "estimation"},), 0, 1.0, {},
    )  # fmt: skip
    robot.write_json(tmp_path / "diagnosis.json")
    validator.validate(json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("verdict",), "fine"),
        (("findings", 0, "parameters", "torque_Nm", "ci95"), [1.0]),
        (("fit", "nominal", "rms"), "0.1"),
        (("mismatch", "time", 0, "share"), 1.5),
        (("findings", 0, "sentence"), None),
    ],
)
def test_other_values_are_refused(validator: jsonschema.Draft202012Validator, path: tuple[Any, ...], value: Any) -> None:
    d = json.loads(json.dumps(synthetic(2_500).as_dict(), default=float))
    assert validator.is_valid(d)
    broken = copy.deepcopy(d)
    part: Any = broken
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    assert not validator.is_valid(broken)


def test_the_command_prints_it() -> None:
    result = CliRunner().invoke(cli, ["schema"])
    assert result.exit_code == 0
    assert json.loads(result.output) == diagnosis_schema()
