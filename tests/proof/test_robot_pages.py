"""The pages of real robots: what they print is what the diagnosis holds."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from diagnose.result import Estimate, FitFigures, Verdict
from lab.proof.kuka_robot import kuka_robot_page
from lab.proof.so101 import JOINT_BY_JOINT, so101_page
from lab.robot.so101 import FITTED, summary_rows
from mjsim.errors import InputError


def row(name, role, nominal, corrected, moves=True):
    return {"file": f"{name}.parquet", "role": role, "moves": moves, "nominal_rms": nominal, "corrected_rms": corrected}


def finding(effect, value):
    return SimpleNamespace(effect=effect, parameters={"torque_Nm": Estimate(value, (0.9 * value, 1.1 * value), "N m")})


def servo_diagnosis(corrected):
    rows = [row("a", "estimation", 0.05, 0.01), row("b", "held-out", 0.02, corrected), row("c", "held-out", 0.03, 1.0, False)]
    joints = {
        n: SimpleNamespace(verdict=Verdict.MISSING_PHYSICS, findings=[finding("coulomb_friction", 0.2)]) for n in JOINT_BY_JOINT
    }
    return SimpleNamespace(
        closed_loop={"joints": dict.fromkeys(JOINT_BY_JOINT, rows)}, joints=joints, changed=("kp of x: 1 -> 2",),
        notes=("x: a note",), seconds=1.0,
        recordings=({"file": "a.parquet", "role": "estimation", "sha256": "ab" * 32},),
    )  # fmt: skip


@pytest.mark.parametrize(("corrected", "beaten"), [(0.0012, 6), (0.0042, 2), (0.5, 0)])
def test_joints_below_the_hand_fits_are_counted(tmp_path, monkeypatch, corrected, beaten):
    for name in (*FITTED, "b"):
        (tmp_path / f"{name}.parquet").write_bytes(b"")
    monkeypatch.setattr("lab.proof.so101.diagnose_robot_files", lambda *_, **__: servo_diagnosis(corrected))
    page = so101_page(tmp_path, print)
    assert page.figures["below_joint_by_joint"] == beaten
    assert f"below it at {beaten} of 6 joints" in page.text
    assert f"| 20.00 | {1e3 * corrected:.2f} | 1 |" in page.text
    assert "| a (fitted) | 50.0 → 10.0 |" in page.text
    assert "| c | – |" in page.text
    assert summary_rows(servo_diagnosis(corrected))[0][1:] == (20.0, pytest.approx(1e3 * corrected), 1)


def test_recordings_that_are_missing_are_named(tmp_path):
    with pytest.raises(InputError, match="friction_gravity"):
        so101_page(tmp_path, print)
    for name in FITTED:
        (tmp_path / f"{name}.parquet").write_bytes(b"")
    with pytest.raises(InputError, match="no recording that is not fitted"):
        so101_page(tmp_path, print)


def test_axes_that_are_a_third_lower_are_counted(tmp_path, monkeypatch):
    def axis(k):
        corrected = 0.199 if k < 5 else 0.201
        fit = {x: FitFigures(1.0, 1.0, 1.0, e) for x, e in (("nominal", 0.9), ("refitted", 0.3), ("corrected", corrected))}
        found = [finding("coulomb_friction", 100.0)] if k else []
        return SimpleNamespace(
            verdict=Verdict.MISSING_PHYSICS, findings=found, fit=fit, remains=(-1.0, 1.0),
            linear_parameters={"damping": Estimate(10.0, (9.0, 11.0), "N m s/rad")},
        )  # fmt: skip

    d = SimpleNamespace(
        joints={f"axis{k + 1}": axis(k) for k in range(6)}, changed=("payload or mass of link6: 18 -> 170 kg",), base=(),
        recordings=(), seconds=1.0,
    )  # fmt: skip
    monkeypatch.setattr("lab.proof.kuka_robot.diagnose_robot_files", lambda *_, **__: d)
    page = kuka_robot_page({"estimation": tmp_path, "held-out": tmp_path}, print)
    assert "lower by a third or more on 5 of 6 axes" in page.text
    assert "named on 5 of 6 axes" in page.text
    assert page.figures["axes"]["axis1"]["coulomb_Nm"] is None
    assert page.figures["axes"]["axis6"]["ratio"] == pytest.approx(0.67)
    assert page.figures["payload"].startswith("payload")
