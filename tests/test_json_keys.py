"""Every key that the reference names stands in a file that is written."""

from __future__ import annotations

import numpy as np
import pytest

import simgap
from simgap.api.keys import FILES

DT = 0.004


@pytest.fixture(scope="module")
def log():
    t = np.arange(0, 3, DT)
    torque = 1.5 * np.sin(2 * np.pi * (0.3 + 0.5 * t) * t)
    run = simgap.simulate("pendulum", torque, dt=DT, effects=[simgap.effects["torque_offset"](place="motor", torque_Nm=0.5)])
    noise = 0.01 * np.random.default_rng(0).standard_normal(t.size)
    return {"time_s": t, "torque_Nm": torque, "velocity_rad_s": run.velocity + noise}


def has(values, key):
    """Whether a dotted key, ``[]`` for the first of a list, stands in JSON values."""
    for part in key.split("."):
        name = part.removesuffix("[]")
        if name not in values:
            return False
        values = values[name]
        if part.endswith("[]"):
            values = values[0]
    return True


def test_the_keys_of_a_diagnosis_and_a_check(log):
    told = simgap.diagnose(log, "pendulum", effects=["torque_offset"]).as_dict()
    assert [k for k in FILES["diagnosis.json"][1] if not has(told, k)] == []
    checked = simgap.check(log, "pendulum").as_dict()
    assert set(FILES["check.json"][1]) <= set(checked)


def test_the_keys_of_an_identification(log):
    told = simgap.identify(log, orders=(1, 1, 1, 1, 1), decimate=1, cutoff=None).as_dict()
    assert set(FILES["identification.json"][1]) <= set(told)
