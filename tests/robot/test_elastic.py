"""Joint flexibility by force: the plant, the deflection, and a flexible joint that is named with its stiffness."""

from __future__ import annotations

import json

import numpy as np
import pytest

from diagnose.robot.elastic import deflected
from diagnose.robot.laws import FLEXIBLE
from diagnose.robot.motion import prepare
from lab.robot.cases import Case, draw, write_log
from lab.robot.measure import one
from mjsim.robot.model import load_robot
from mjsim.robot.recording import load_robot_recording
from mjsim.robot.rows import link_rows

STIFF = 150.0  # [N m/rad]: the forearm swings with some 9 Hz


@pytest.fixture(scope="module")
def case():
    rigid = draw(41, "nothing", 3)
    return Case("flexible", 41, rigid.nominal, rigid.true, (), (), {2: STIFF})


@pytest.fixture(scope="module")
def log(case, tmp_path_factory):
    path = tmp_path_factory.mktemp("flexible") / "a.csv"
    write_log(case, path, 0)
    return path


def test_the_motor_is_ahead_of_its_link_by_the_torque_of_the_link(case, log, tmp_path):
    rigid = Case("flexible", 41, case.nominal, case.true, (), (), {2: 1e12})
    write_log(rigid, tmp_path / "stiff.csv", 0)
    soft, stiff = (np.loadtxt(path, delimiter=",", skiprows=1) for path in (log, tmp_path / "stiff.csv"))
    ahead, torque = soft[:, 3] - stiff[:, 3], stiff[:, 6]
    np.testing.assert_allclose(soft[:, 1:3], stiff[:, 1:3], atol=1e-12)
    # beside the rotor's and the damping's part the torque is that of the link
    slope = float(ahead @ torque / (torque @ torque))
    assert 1.0 / slope == pytest.approx(STIFF, rel=0.3)
    assert draw(41, "flexible", 6).stiffness.keys() <= {0, 1, 2}


def test_links_lag_behind_motors_by_their_own_torque(case, log, tmp_path):
    (tmp_path / "arm.xml").write_text(case.nominal.mjcf("arm"))
    robot = load_robot(tmp_path / "arm.xml")
    r = load_robot_recording(log, robot, model=tmp_path / "arm.xml")
    m = prepare(robot, r, robot.joints, 10.0)
    assert deflected(robot, m, {}, robot.nominal).of_links[0] is m.z
    moved = deflected(robot, m, {2: 1.0 / STIFF}, robot.nominal)
    z, dz, ddz = moved.of_links
    s = np.einsum("nmlk,lk->nm", link_rows(robot, z, dz, ddz), robot.nominal)[:, 2]
    inner = slice(len(s) // 10, -len(s) // 10)
    np.testing.assert_allclose((m.z - z)[inner, 2], s[inner] / STIFF, atol=0.05 * float(np.max(np.abs(s))) / STIFF)
    np.testing.assert_array_equal(z[:, :2], m.z[:, :2])


@pytest.mark.slow
def test_a_flexible_joint_is_named_with_its_stiffness(case, tmp_path):
    found = one(case, tmp_path)
    assert found["found"] == [f"{FLEXIBLE}@joint3"]
    told = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    e = told["findings"][0]["parameters"]["stiffness_Nm_rad"]
    assert e["value"] == pytest.approx(STIFF, rel=0.1)
    assert e["ci95"][0] < STIFF < e["ci95"][1]
    assert e["unit"] == "N m/rad"
    assert any(FLEXIBLE in x for x in told["closed_loop"]["lacking"])
    assert "flexible" in (tmp_path / "out" / "report.html").read_text()
    fit = told["joints"]["joint3"]["fit"]
    assert fit["surrogate"]["held_out_rms"] < 0.9 * fit["refitted"]["held_out_rms"]
