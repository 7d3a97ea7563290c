"""The worked examples keep what they say (`make proof`)."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from diagnose.result import Verdict

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"

pytestmark = pytest.mark.slow


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_hidden_flexibility(tmp_path):
    """Friction and delay in the spring's place leave more than the noise; the mode is named with its inertia and stiffness."""
    module = example("hidden_flexibility")
    naive, result = module.main(tmp_path)
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert [f.effect for f in result.findings] == ["extra_flexible_mode"]
    values = {n: e.value for n, e in result.findings[0].parameters.items()}
    assert values["inertia_kgm2"] == pytest.approx(module.LINK, rel=0.03)
    assert values["stiffness_Nm_rad"] == pytest.approx(module.SPRING, rel=0.03)
    assert result.fit["corrected"].held_out_rms == pytest.approx(module.NOISE, rel=0.05)
    assert naive.fit["corrected"].held_out_rms > 2 * module.NOISE


def test_stiction(tmp_path):
    """The peak at rest is named and measured; one level for rest and motion leaves more than the noise."""
    module = example("stiction")
    level, result = module.main(tmp_path)
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert [f.effect for f in result.findings] == ["static_friction"]
    values = {n: e.value for n, e in result.findings[0].parameters.items()}
    assert values["torque_Nm"] == pytest.approx(module.LEVEL, rel=0.02)
    assert values["peak"] == pytest.approx(module.PEAK, rel=0.05)
    # simgap's replay has the peak, which plain MuJoCo lacks in corrected.xml
    assert level.surrogate["corrected"].held_out_rms > 2 * result.surrogate["corrected"].held_out_rms
    assert result.surrogate["corrected"].held_out_rms == pytest.approx(module.NOISE, rel=0.05)


def test_servo_backlash(tmp_path):
    """The gap is named under feedback, within a tenth although contact follows another law."""
    module = example("servo_backlash")
    result = module.main(tmp_path)
    found = {f.effect: f for f in result.findings}
    assert "backlash" in found
    assert found["backlash"].parameters["gap_rad"].value == pytest.approx(module.GAP, rel=0.1)


def test_one_rig_cannot_tell(tmp_path):
    """Where the transmitted torque does not change, the two frictions are equivalents and another load is asked for."""
    alone = example("load_friction").main(tmp_path)
    assert alone.verdict is Verdict.MISSING_PHYSICS
    (finding,) = alone.findings
    names = {finding.effect, *finding.equivalents}
    assert {"load_dependent_friction", "coulomb_friction"} <= {n.partition("@")[0] for n in names}
    assert "load" in alone.next_experiment.partition("record ")[2]
