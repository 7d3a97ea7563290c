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
from diagnose.json_file import json_text
from diagnose.report.schema import diagnosis_schema, schema_of
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


@pytest.mark.parametrize("words", [(), ("diagnosis",), ("check",), ("identification",)])
def test_the_command_prints_it(words: tuple[str, ...]) -> None:
    result = CliRunner().invoke(cli, ["schema", *words])
    assert result.exit_code == 0
    assert json.loads(result.output) == schema_of(words[0] if words else "diagnosis")
    jsonschema.Draft202012Validator.check_schema(json.loads(result.output))


def save(log: dict[str, np.ndarray], path: Path) -> str:
    np.savetxt(path, np.column_stack(list(log.values())), delimiter=",", header=",".join(log), comments="")
    return str(path)


def strict(text: str) -> Any:
    """JSON as its standard has it: without NaN."""

    def refuse(name: str) -> None:
        raise ValueError(name)

    return json.loads(text, parse_constant=refuse)


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["right", "turned"])
def test_a_check(tmp_path: Path, sign: float) -> None:
    log = save(pendulum(sign), tmp_path / "log.csv")
    said = CliRunner().invoke(cli, ["check", log, "--model", "pendulum", "--json", "--out", str(tmp_path / "out")])
    told = strict(said.output)
    assert told["verdict"] == ("ready" if sign > 0 else "fix")
    check = jsonschema.Draft202012Validator(schema_of("check"))
    check.validate(told)
    check.validate(strict((tmp_path / "out" / "check.json").read_text(encoding="utf-8")))
    assert not check.is_valid(told | {"verdict": "fine"})


def test_a_check_of_a_robot(tmp_path: Path) -> None:
    t = 0.01 * np.arange(400)
    log = {"time_s": t} | {f"joint{k}.angle_rad": 0.3 * np.sin(k * t) for k in (1, 2, 3)}
    log |= {f"joint{k}.torque_Nm": np.cos(k * t) for k in (1, 2, 3)}
    said = CliRunner().invoke(cli, ["check", save(log, tmp_path / "log.csv"), "--model", "arm3", "--json"])
    jsonschema.Draft202012Validator(schema_of("check")).validate(strict(said.output))


def test_an_identification(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    torque = rng.standard_normal(N)
    velocity = simgap.simulate("pendulum", torque, dt=0.004).velocity + 0.01 * rng.standard_normal(N)
    log = save({"time_s": 0.004 * np.arange(N), "torque_Nm": torque, "velocity_rad_s": velocity}, tmp_path / "log.csv")
    words = ["--orders", "2,1,1,2,1", "--decimate", "1", "--out", str(tmp_path / "out"), "--json"]
    said = CliRunner().invoke(cli, ["identify", log, *words])
    told = strict(said.output)
    identification = jsonschema.Draft202012Validator(schema_of("identification"))
    identification.validate(told)
    identification.validate(strict((tmp_path / "out" / "identification.json").read_text(encoding="utf-8")))
    assert not identification.is_valid(told | {"C": [2.0, 0.1]})


def test_a_number_that_is_none_is_null() -> None:
    assert strict(json_text({"a": [float("nan"), np.float64("inf"), 1.5], "b": {"c": -float("inf")}})) == {
        "a": [None, None, 1.5], "b": {"c": None},
    }  # fmt: skip
