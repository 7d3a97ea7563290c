"""Two real machines, diagnosed from inertia and viscous friction alone (`make proof`; skipped where the recordings are not)."""

from __future__ import annotations

import pytest

from diagnose.data.experiment import prepare
from diagnose.explain.second_encoder import judge_second_encoder
from diagnose.pipeline import Options, diagnose
from diagnose.result import Verdict
from lab.proof.emps import LEAD
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.recording import load


def pair(local_copy, folder, *files, model):
    return [load(local_copy(folder, f), model=shipped_model(model)) for f in files]


@pytest.mark.slow
def test_emps_friction_and_one_turn_of_the_screw(local_copy):
    """Asymmetric friction, or Coulomb friction and an offset, and a ripple whose period is the screw's lead."""
    first, second = pair(local_copy, "emps", "DATA_EMPS.mat", "DATA_EMPS_PULSES.mat", model="emps")
    result = diagnose(load_axis(shipped_model("emps")), [first], [second], Options())
    found = {f.effect: f for f in result.findings}
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert set(found) in ({"asymmetric_friction", "torque_ripple"}, {"coulomb_friction", "torque_offset", "torque_ripple"})
    order = found["torque_ripple"].parameters["cycles_per_rev"].value
    assert order == pytest.approx(2 * 3.141592653589793 / LEAD, rel=0.005)
    assert found["torque_ripple"].parameters["amplitude_Nm"].value == pytest.approx(0.8, abs=0.3)


@pytest.mark.slow
def test_kuka_coulomb_and_nothing_else(local_copy):
    """Published for the link: 350.3 N m and 1939.52 N m s/rad; other trajectories, hence the width."""
    first, second = pair(local_copy, "kuka_kr300", "rec_FF_A.mat", "rec_FF_B.mat", model="kuka_kr300_axis1")
    result = diagnose(load_axis(shipped_model("kuka_kr300_axis1")), [first], [second], Options())
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert [f.effect for f in result.findings] == ["coulomb_friction"]
    assert result.findings[0].parameters["torque_Nm"].value == pytest.approx(350.3, rel=0.1)
    assert result.linear_parameters["fm"].value == pytest.approx(1939.52, rel=0.05)
    assert any("delay of the second encoder" in note for note in result.notes)


def test_kuka_second_encoder_is_late_and_has_no_gap(local_copy):
    """Either way round: 3.1 ms, and no backlash, wind-up or hysteresis beside it."""
    recordings = pair(local_copy, "kuka_kr300", "rec_FF_A.mat", "rec_FF_B.mat", model="kuka_kr300_axis1")
    chain = load_axis(shipped_model("kuka_kr300_axis1")).chain
    for a, b in (recordings, recordings[::-1]):
        result = judge_second_encoder(chain, [prepare(a)], [prepare(b)])
        assert result is not None
        assert result.found.terms == ("time_delay",)
        assert result.found.values["time_delay"] == pytest.approx(3.1e-3, abs=1e-4)
        assert result.found.held_out_rms < 0.12 * result.held_out_difference
