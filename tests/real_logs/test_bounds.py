"""A number of the model at its bound is no finding, and no all-clear."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from twins import motor, recording

from diagnose.evidence.intervals import at_bounds
from diagnose.pipeline import Options, diagnose
from diagnose.result import Verdict
from mjsim.axis import Axis, Body, Chain


@pytest.mark.parametrize(("x", "said"), [(1.0, ("Jm",)), (-1.0, ("Jm",)), (0.99, ()), (0.0, ())])
def test_inertias_and_stiffnesses_at_a_bound_are_told(x, said):
    entries = (SimpleNamespace(owner="", log=True, name="Jm"), SimpleNamespace(owner="", log=False, name="fm"))
    bounds = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    f = SimpleNamespace(hypothesis=SimpleNamespace(entries=entries, bounds=bounds), fit=SimpleNamespace(x=np.array([x, 1.0])))
    assert at_bounds(f) == said


def test_a_model_twenty_times_too_light_is_no_all_clear():
    light = Axis(Chain((Body("motor", 0.012 / 20, 0.05, "j"),), ()))
    logs = [recording(250.0, *motor(s, 250.0, 3.0, level=0.0), f"{s}.csv") for s in (1, 2)]
    result = diagnose(light, logs[:1], logs[1:], Options(jobs=1, effects=("torque_offset",)))
    assert result.verdict is Verdict.UNEXPLAINED
    assert any(n.startswith("Jm stands at its bound") for n in result.notes)
