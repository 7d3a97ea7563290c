"""Every registered effect in MuJoCo against the analytic equations, within the tolerance that the effect declares."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from robot_axis import DT, axis, chirp, effect

from mjsim import accurate, ode, reference
from mjsim.crosscheck import Report, Row, Status, check_all, effect_cases, energy_error, plot, table
from mjsim.effects import registered
from mjsim.errors import CheckError
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate
from simgap.commands import crosscheck as face

ROBOT = load_axis(shipped_model("robot_axis1"))
U = chirp(3.0)
CASES, SKIPPED = effect_cases(ROBOT, U)


def test_every_registered_effect_has_a_case_at_every_place() -> None:
    servo = {f"{n}@{p}" for n, cls in registered().items() for p in cls.places if cls.family == "servo"}
    assert {key for key, _ in SKIPPED} == servo, "tests/mjsim/test_servo.py holds those against a reference of their own"
    assert {c.axis.effects[0].key for c in CASES} == {f"{n}@{p}" for n, cls in registered().items() for p in cls.places} - servo


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_both_realisations_agree(case: object) -> None:
    exact = reference.not_affine(case.axis) is None  # type: ignore[attr-defined]
    model = case.axis  # type: ignore[attr-defined]
    truth = reference.simulate(model, U, DT) if exact else ode.simulate(model, U, DT, substeps=16)
    assert np.ptp(truth.velocity) > 0
    for run, limit in ((accurate.simulate(model, U, DT), case.accurate), (ode.simulate(model, U, DT), case.kernel)):  # type: ignore[attr-defined]
        error = np.sqrt(np.mean((run.velocity - truth.velocity) ** 2) / np.mean(truth.velocity**2))
        assert error < limit


def test_the_effects_are_felt() -> None:
    """A comparison of effects that change nothing would prove nothing."""
    plain = simulate(ROBOT, U, DT).velocity
    for case in CASES:
        changed = simulate(case.axis, U, DT).velocity
        assert np.sqrt(np.mean((changed - plain) ** 2) / np.mean(plain**2)) > 3e-4, case.name


@pytest.mark.parametrize("engine", [reference.simulate, ode.simulate, accurate.simulate])
def test_energy_balances(engine: object) -> None:
    model = axis(effect("coulomb_friction", torque_Nm=0.1), effect("backlash", gap_rad=5e-4)).with_linear({"dg": 0.0})
    start = np.zeros((2, 3))
    start[0, 2] = 0.01
    run = engine(model, np.zeros(2001), 5e-5, initial=start)  # type: ignore[operator]
    assert energy_error(model, run) < 1e-6


def test_a_miss_is_named_and_ends_with_check_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from mjsim.crosscheck import run as module

    strict = [dataclasses.replace(CASES[0], accurate=1e-12, literal=None)]
    monkeypatch.setattr(module, "study_cases", lambda axis: strict)
    monkeypatch.setattr(module, "effect_cases", lambda axis, u: ([], [("nothing@arm", "no place")]))
    monkeypatch.setattr(module, "scaling_row", lambda *a: Row("scaling law", "itself", 0.0, 0.0, ()))
    monkeypatch.setattr(module, "energy_rows", lambda *a: [])
    result = CliRunner().invoke(face.command, ["--out", str(tmp_path), "--duration", "1"])
    assert isinstance(result.exception, CheckError)
    assert "accurate" in str(result.exception)
    assert "not compared: nothing@arm" in result.output
    assert (tmp_path / "crosscheck.png").stat().st_size > 5000
    assert (tmp_path / "crosscheck.json").is_file()


@pytest.mark.slow
def test_the_whole_crosscheck_holds(tmp_path: Path) -> None:
    *rows, report = list(check_all())
    assert isinstance(report, Report)
    assert not report.missed
    assert all(math.isfinite(r.sensitivity) for r in report.rows)
    assert all(c.status is not Status.CHAOTIC for r in report.rows for c in r.cells)
    assert len(table(report.rows)) > len(rows)
    plot(report, tmp_path / "all.png")
