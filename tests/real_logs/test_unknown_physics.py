"""The machines of `lab.unknown_physics` move, and each kind of physics changes their motion."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from lab.unknown_physics import machines
from lab.unknown_physics.machines import FORMS, KINDS, write_case


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_changes_the_motion(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(machines, "SECONDS", 2.0)
    noise = write_case(kind, FORMS[0], 3, tmp_path / "with")
    monkeypatch.setitem(KINDS, "nothing", machines._nothing)
    write_case("nothing", FORMS[0], 3, tmp_path / "without")
    logs = [np.genfromtxt(tmp_path / one / "held_out.csv", delimiter=",", names=True) for one in ("with", "without")]
    assert np.sqrt(np.mean((logs[0]["velocity_rad_s"] - logs[1]["velocity_rad_s"]) ** 2)) > 2 * noise
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "with" / "model.xml")).nv == 1
