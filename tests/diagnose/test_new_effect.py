"""The worked example of docs/adding_an_effect.md: one file, and simgap finds it, names it, writes it and runs it."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import mjsim.effects.registry as registry
from diagnose.pipeline import Options, diagnose
from diagnose.result import Verdict
from mjsim.effects import registered
from mjsim.mjcf import load_axis, write_corrected
from mjsim.models import shipped_model
from mjsim.ode import simulate
from simgap.pipeline import corrected_axis

PAGE = Path(__file__).resolve().parents[2] / "docs" / "adding_an_effect.md"


@pytest.fixture
def cubic_drag(tmp_path, monkeypatch):
    """The code block of the page as a module of its own; the registry is left as it was."""
    monkeypatch.setattr(registry, "_REGISTRY", dict(registered()))
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    path = tmp_path / "cubic_drag.py"
    path.write_text(code, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("cubic_drag", path)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "cubic_drag", module)
    spec.loader.exec_module(module)
    return registered()["cubic_drag"]


def test_an_effect_added_by_one_file_is_found(cubic_drag, pair, robot, tmp_path):
    assert "cubic_drag" not in {c.id for c in cubic_drag.__mro__[1:] if hasattr(c, "id")}
    estimation, held_out = pair(cubic_drag(torque_Nm=0.02), seconds=1.0)
    among = ("cubic_drag", "quadratic_friction", "coulomb_friction", "time_delay")
    result = diagnose(robot, [estimation], [held_out], Options(jobs=1, effects=among))
    assert result.verdict is Verdict.MISSING_PHYSICS
    (finding,) = result.findings
    assert (finding.effect, finding.place) == ("cubic_drag", "motor")
    assert finding.parameters["torque_Nm"].value == pytest.approx(0.02, rel=0.03)
    assert "cube of the speed" in finding.sentence
    assert json.dumps(result.as_dict(), default=float)

    path = tmp_path / "corrected.xml"
    write_corrected(shipped_model("robot_axis1"), corrected_axis(robot, result), path)
    again = load_axis(path)
    (effect,) = again.effects
    assert effect.values["torque_Nm"] == pytest.approx(finding.parameters["torque_Nm"].value)
    run = simulate(again, held_out.torque, held_out.dt)
    assert np.std(run.velocity - held_out.velocity) < 0.06, "free run down to the noise of 0.05 rad/s"
