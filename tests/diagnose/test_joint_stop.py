"""A stop of the joint is named with its angles where the motion strikes it, and nothing is where it does not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnose.check.stops import VISITS, stops_of
from diagnose.data.experiment import prepare
from diagnose.data.scales import scales_by_place
from diagnose.options import Options
from diagnose.pipeline import diagnose
from diagnose.result import Verdict
from mjsim.axis import Axis, Body, Chain
from mjsim.chain import Limit
from mjsim.effects import effect_class
from mjsim.effects.joint_stop import JointStop
from mjsim.effects.soft_stop import FAR
from mjsim.mjcf import load_model, write_corrected
from mjsim.mjcf.faithful import write_as_author
from mjsim.mjcf.joint_limit import limit_of
from mjsim.ode import simulate
from mjsim.recording import Recording

DT = 4e-3
NOMINAL = Axis(Chain((Body("motor", 0.05, 0.06, "j"),), ()), ())
STOP = JointStop(lower_rad=-0.5, upper_rad=0.8, time_constant_s=0.02, damping_ratio=0.6)
LIMIT = STOP.limit(NOMINAL.chain)
ONLY = Options(jobs=1, effects=("joint_stop", "actuator_saturation", "coulomb_friction", "torque_offset"))


def log(axis: Axis, seed: int, samples: int = 1500) -> Recording:
    rng, t = np.random.default_rng(seed), DT * np.arange(samples)
    tones = [(f, rng.uniform(0.2, 0.5), rng.uniform(0, 6)) for f in (0.3, 0.7, 1.3, 2.3)]
    u = sum(a * np.sin(2 * np.pi * f * t + p) for f, a, p in tones) * np.minimum(t, 1)
    run = simulate(axis, u, DT)
    noise = rng.standard_normal((2, len(t)))
    return Recording(t, u, run.velocity + 0.005 * noise[0], run.angle + 2e-4 * noise[1], DT, source=f"log_{seed}.csv")


def test_a_stop_is_named_with_its_values() -> None:
    result = diagnose(NOMINAL, [log(NOMINAL + STOP, 1, 1000)], [log(NOMINAL + STOP, 2, 1000)], ONLY)
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert [f.effect for f in result.findings] == ["joint_stop"]
    values = result.findings[0].parameters
    assert values["lower_rad"].value == pytest.approx(STOP.lower_rad, abs=2e-3)
    assert values["upper_rad"].value == pytest.approx(STOP.upper_rad, abs=2e-3)
    assert values["time_constant_s"].value == pytest.approx(STOP.time_constant_s, rel=0.03)
    assert values["damping_ratio"].value == pytest.approx(STOP.damping_ratio, rel=0.05)


def test_a_limited_torque_is_no_stop() -> None:
    limited = NOMINAL + effect_class("actuator_saturation")(limit_Nm=0.3)
    result = diagnose(NOMINAL, [log(limited, 1, 1000)], [log(limited, 2, 1000)], ONLY)
    assert [f.effect for f in result.findings] == ["actuator_saturation"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "angle"), [("upper_joint_stop", 0.25), ("lower_joint_stop", -0.3)])
def test_a_stop_at_one_end_is_named_by_its_end(name: str, angle: float) -> None:
    weighed = NOMINAL + effect_class("gravity_load")(place="arm", torque_Nm=1.0, phase_rad=0.0)
    true = weighed + effect_class(name)(angle_rad=angle, time_constant_s=0.02, damping_ratio=0.6)
    options = dataclasses.replace(ONLY, effects=("joint_stop", "lower_joint_stop", "upper_joint_stop", "actuator_saturation"))
    result = diagnose(weighed, [log(true, 1)], [log(true, 2)], options)
    assert [f.effect for f in result.findings] == [name]
    assert result.findings[0].parameters["angle_rad"].value == pytest.approx(angle, abs=2e-3)


def test_the_other_end_is_that_of_the_file() -> None:
    limit = Limit(-0.9, 0.9, 1e3, 50.0)
    body = dataclasses.replace(NOMINAL.chain.bodies[0], limit=limit)
    chain = dataclasses.replace(NOMINAL.chain, bodies=(body,))
    numbers = {"angle_rad": 0.3, "time_constant_s": 0.02, "damping_ratio": 1.0}
    (port,) = effect_class("upper_joint_stop")(**numbers).ports(chain)
    assert (port.limit.lower, port.limit.upper) == (-0.9, 0.3)
    (port,) = effect_class("lower_joint_stop")(**numbers).ports(chain)
    assert (port.limit.lower, port.limit.upper) == (0.3, 0.9)
    (port,) = effect_class("upper_joint_stop")(**numbers).ports(NOMINAL.chain)
    assert port.limit.lower == -FAR


@pytest.mark.parametrize(("reach", "sides"), [(1.02, ()), (0.5, (-1, 1))])
def test_a_stop_is_looked_for_where_the_motion_strikes_one(reach: float, sides: tuple[int, ...]) -> None:
    free = log(NOMINAL, 1)
    assert free.angle is not None
    ends = {"lower_rad": float(np.min(free.angle)) * reach, "upper_rad": float(np.max(free.angle)) * reach}
    ends["lower_rad"] -= 0.02 * float(np.ptp(free.angle)) * (reach > 1)
    recording = log(NOMINAL + STOP.with_values(ends), 1)
    stops = scales_by_place(NOMINAL, prepare(recording))["motor"].stops
    assert stops is not None
    assert tuple(side for side, _, _ in stops) == sides
    for side, angle, _ in stops:
        assert angle == pytest.approx(ends["upper_rad" if side > 0 else "lower_rad"], abs=0.02 * float(np.ptp(free.angle)))
    scales = dataclasses.replace(scales_by_place(NOMINAL, prepare(recording))["motor"], stops=stops)
    assert bool(JointStop.starts(scales)) is bool(sides)


@pytest.mark.parametrize(("visits", "found"), [(VISITS - 1, False), (VISITS, True)])
def test_ends_count_from_so_many_visits_on(visits: int, found: bool) -> None:
    """A joint that moves at a constant speed and is turned back at one end or the other within a fortieth of a second."""
    t = 1e-3 * np.arange(1000 * visits + 25)
    q = np.convolve(np.interp((t + 0.5) % 2.0, [0.0, 1.0, 2.0], [-1.0, 1.0, -1.0]), np.ones(25) / 25, "valid")
    assert bool(stops_of(q, np.gradient(q, 1e-3), 1e-3)) is found


def test_swings_of_every_size_have_no_stop() -> None:
    rng, t = np.random.default_rng(0), 2e-3 * np.arange(10000)
    q = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) / f for f in (0.3, 0.8, 1.9, 4.1))
    assert stops_of(q, np.gradient(q, 2e-3), 2e-3) == ()


def test_stops_that_have_passed_each_other_are_taken_in_order() -> None:
    turned = STOP.with_values({"lower_rad": 0.8, "upper_rad": -0.5})
    assert turned.limit(NOMINAL.chain) == LIMIT
    assert STOP.with_values({"upper_rad": -0.5}).limit(NOMINAL.chain).upper > -0.5


@pytest.mark.parametrize(
    ("compiler", "joint"),
    [('angle="radian"', ""), ("", ""), ('angle="radian"', 'range="-1 1" margin=".02"'), ("", 'ref="10" range="-30 40"')],
)
def test_a_stop_is_written_as_the_range_of_the_joint(tmp_path, compiler: str, joint: str) -> None:
    (tmp_path / "model.xml").write_text(f"""<mujoco><compiler {compiler}/><option gravity="0 0 0"/><worldbody><body name="b">
        <joint name="j" axis="0 1 0" damping=".06" {joint}/>
        <inertial pos="0 0 0" mass="1" diaginertia=".05 .05 .05"/></body></worldbody>
        <actuator><motor name="u" joint="j"/></actuator></mujoco>""")
    axis = load_model(tmp_path / "model.xml").axis
    write_corrected(tmp_path / "model.xml", axis + STOP, tmp_path / "corrected.xml")
    back = load_model(tmp_path / "corrected.xml")
    assert back.axis == axis + STOP
    found = limit_of(back)
    assert found is not None
    assert (found.lower, found.upper) == pytest.approx((STOP.lower_rad, STOP.upper_rad))
    assert (found.stiffness, found.damping) == pytest.approx((LIMIT.stiffness, LIMIT.damping))
    assert found.impedance == LIMIT.impedance
    write_corrected(tmp_path / "corrected.xml", axis, tmp_path / "taken_back.xml")
    assert limit_of(load_model(tmp_path / "taken_back.xml")) == limit_of(load_model(tmp_path / "model.xml"))


def test_the_authors_settings_of_limits_leave_a_stop_that_was_found(tmp_path) -> None:
    """The author's range is another one: how stiff the stop is was fitted, and stays."""
    model, out = tmp_path / "model.xml", tmp_path / "corrected.xml"
    model.write_text("""<mujoco><compiler angle="radian"/><worldbody><body>
        <joint name="j" axis="0 0 1" limited="true" range="-2 2"/>
        <inertial pos="0 0 0" mass="1" diaginertia=".05 .05 .05"/></body></worldbody>
        <actuator><motor name="u" joint="j"/></actuator></mujoco>""")
    axis = load_model(model).axis + STOP
    assert write_as_author(model, axis, out) == ()
    found = limit_of(load_model(out))
    assert found is not None
    assert (found.stiffness, found.damping) == pytest.approx((LIMIT.stiffness, LIMIT.damping))


def test_short_impacts_are_stops() -> None:
    """Fewer samples than the strongest fiftieth, and far stronger than all others."""
    t = 1e-3 * np.arange(8000)
    q = np.abs(np.sin(2 * np.pi * 0.4 * t)) + 0.05 * np.sin(2 * np.pi * 3.1 * t)
    q = np.convolve(q, np.ones(4) / 4, "same")[10:-10]
    found = stops_of(-q, np.gradient(-q, 1e-3), 1e-3)
    assert found[-1][:2] == (1, pytest.approx(0.0, abs=0.06))
