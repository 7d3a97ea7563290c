"""How the command of a servo goes between samples, where nobody stated it: plain MuJoCo at a tenth of the sample time."""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from diagnose.fit.command_hold import hold_instead, is_assumed, shown_hold
from diagnose.options import Options
from diagnose.result import Estimate, Verdict
from mjsim.effects import effect_class
from mjsim.hold import within
from mjsim.mjcf import load_axis
from mjsim.recording import Recording
from simgap import servo_log
from tests.mjsim.servo_logs import PENDULUM, command, model, write

DT, FINER, SECONDS = 0.02, 10, 10.0
LEAD = 0.05  # [s] by which a velocity feedforward lets the joint act ahead


@cache
def log(hold: str, seed: int, *, friction: float = 0.0, lead: float = 0.0) -> Recording:
    """A log at 50 Hz of a servo whose setpoints go between samples as ``hold`` says; ``lead``: of a velocity feedforward [s]."""
    m = mujoco.MjModel.from_xml_string(model(PENDULUM, friction=friction, kp=10.0, timestep=DT / FINER))
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    u = command(SECONDS, DT, seed)
    fine = within(u, DT, hold, FINER)
    fine = fine + lead * np.gradient(fine, DT / FINER)
    angle = np.empty(len(u))
    d.qpos[0] = u[0]
    for k, target in enumerate(fine):
        if k % FINER == 0:
            angle[k // FINER] = d.qpos[0]
        d.ctrl[0] = target
        mujoco.mj_step(m, d)
    angle += 2e-4 * rng.standard_normal(len(u))
    time = np.arange(len(u)) * DT
    return Recording(time, np.full(len(u), np.nan), None, angle, DT, command=u)


@pytest.fixture(scope="module")
def axis(tmp_path_factory):
    return load_axis(write(tmp_path_factory.mktemp("hold") / "servo.xml", PENDULUM))


@pytest.mark.parametrize(
    ("hold", "friction"),
    [
        ("held", 0.0),
        ("linear", 0.05),
        pytest.param("linear", 0.0, marks=pytest.mark.slow),
        pytest.param("mean", 0.0, marks=pytest.mark.slow),
        pytest.param("held", 0.05, marks=pytest.mark.slow),
    ],
)
def test_the_hold_is_found_with_and_without_dry_friction(axis, hold, friction):
    assert shown_hold(axis, [log(hold, 1, friction=friction)], [log(hold, 2, friction=friction)], math.inf) == hold


@pytest.mark.slow
def test_a_velocity_feedforward_is_no_hold(axis):
    assert shown_hold(axis, [log("linear", 1, lead=LEAD)], [log("linear", 2, lead=LEAD)], math.inf) == "held"


@pytest.mark.parametrize(("hold", "lead", "taken"), [("linear", 0.0, "linear"), ("held", LEAD, "held")])
def test_a_hold_takes_the_place_of_an_effect_that_explains_no_more(axis, hold, lead, taken):
    logs = [log(hold, 1, lead=lead)], [log(hold, 2, lead=lead)]
    ahead = effect_class("velocity_feedforward")(place="actuator", gain_Nms_rad=10.0 * max(lead, DT / 2))
    assert hold_instead(axis.with_effects([ahead]), [axis], *logs, math.inf) == taken


def test_a_stated_hold_stays():
    given = log("linear", 1)
    assert is_assumed([given])
    assert not is_assumed([given, dataclasses.replace(given, hold_stated=True)])
    assert not is_assumed([dataclasses.replace(given, hold="linear")])


def found(verdict=Verdict.MISSING_PHYSICS, rms=1.0, held_out=None, findings=()):
    fit = SimpleNamespace(rms=rms * 2e-4, held_out_rms=(held_out or rms) * 2e-4)
    return SimpleNamespace(verdict=verdict, fit={"corrected": fit}, noise_floor=2e-4, findings=findings, channel="velocity")


@pytest.fixture
def beside(monkeypatch, axis):
    """`hold_beside` of a log of an axis, with what it asks for in the place of fits."""
    given = log("held", 1)

    def ask(result, physics=(), **answers):
        monkeypatch.setattr(servo_log, "corrected_axis", lambda nominal, _: nominal)
        monkeypatch.setattr(servo_log, "as_fitted", lambda _: {})
        monkeypatch.setattr(servo_log, "physics_found", lambda _: list(physics))
        for name in ("shown_hold", "hold_instead", "_searched_hold"):
            monkeypatch.setattr(servo_log, name, lambda *_, name=name: answers.get(name, "held"))
        hold = answers.get("own", "held")
        stated = dataclasses.replace(given, hold=hold, hold_stated=answers.get("stated", False))
        if answers.get("structure_alone"):
            return servo_log.another_hold(axis, [stated], [stated], Options())(result)
        return servo_log.hold_beside(result, axis, [stated], [stated], Options())

    return ask


EFFECT = effect_class("velocity_feedforward")(place="actuator", gain_Nms_rad=0.1)


@pytest.mark.parametrize(
    ("verdict", "rms", "asked"),
    [(Verdict.UNEXPLAINED, 1.0, True), (Verdict.MISSING_PHYSICS, 1.3, True), (Verdict.MISSING_PHYSICS, 1.0, False)],
)
def test_the_hold_is_asked_for_again_where_effects_leave_more_than_noise(beside, verdict, rms, asked):
    asked_for = "linear" if asked else "held"
    assert beside(found(verdict, rms), [EFFECT], shown_hold="linear") == asked_for
    assert beside(found(verdict, rms), _searched_hold="linear") == asked_for
    assert beside(found(verdict, rms), [EFFECT], shown_hold="linear", stated=True) == "held"


def test_a_hold_is_compared_with_an_effect_where_one_was_found(beside):
    assert beside(found(), [EFFECT], hold_instead="linear") == "linear"
    assert beside(found(), hold_instead="linear") == "held"


def test_a_structure_alone_shows_another_hold_without_a_search(beside):
    assert beside(found(), [EFFECT], structure_alone=True, hold_instead="linear")
    assert not beside(found(Verdict.UNEXPLAINED, 3.0), [EFFECT], structure_alone=True, _searched_hold="linear")
    assert not beside(found(), [EFFECT], structure_alone=True, hold_instead="linear", stated=True)


def test_a_hold_that_was_found_gives_way_to_one_that_leaves_less(beside):
    far = found(Verdict.UNEXPLAINED, 3.0)
    assert beside(far, own="linear", _searched_hold="held") == "held"
    assert beside(far, own="linear", shown_hold="mean", hold_instead="mean", _searched_hold="linear") == "linear"


@pytest.mark.parametrize(
    ("rms", "held_out", "taken"),
    [
        (0.86, 0.86, "linear"),
        (0.87, 0.87, "held"),
        (1.0, 0.7, "linear"),
        (1.0, 0.71, "held"),
        (1.01, 0.5, "held"),
        (0.5, 1.01, "held"),
    ],
)
def test_a_short_search_has_to_leave_a_quarter_less_of_all_samples(monkeypatch, axis, rms, held_out, taken):
    efforts = []

    def search(nominal, recordings, held, options, say, surpassed):
        efforts.append(options.effort)
        assert held[0].hold == recordings[0].hold
        return found(rms=rms if recordings[0].hold == "linear" else 1.1, held_out=held_out)

    monkeypatch.setattr(servo_log, "diagnose", search)
    logs = [log("held", 1)]
    assert servo_log._searched_hold(found(), axis, logs, logs, Options(effort=2.0), lambda _: None) == taken
    assert efforts == [0.5, 0.5]


@pytest.mark.parametrize(
    ("own", "of", "samples", "taken"),
    [("held", "linear", 0.74, "held"), ("held", "linear", 0.76, "linear"), ("linear", "mean", 0.74, "linear"),
     ("held", "mean", 1.24, "held"), ("held", "mean", 1.26, "mean"), ("linear", "held", 0.3, "held")],
)  # fmt: skip
def test_a_lag_that_makes_up_for_an_earlier_command_is_no_evidence_for_it(monkeypatch, axis, own, of, samples, taken):
    """What it has beyond the shift has to be long enough to be named by the present hold: a quarter of a sample."""
    lag = SimpleNamespace(law="sensor_lag", parameters={"time_constant_s": Estimate(samples * DT, (0.0, 1.0), "s")})

    def search(nominal, recordings, held, options, say, surpassed):
        return found(rms=0.5 if recordings[0].hold == of else 1.0, findings=[lag])

    monkeypatch.setattr(servo_log, "diagnose", search)
    logs = [dataclasses.replace(log("held", 1), hold=own)]
    assert servo_log._searched_hold(found(), axis, logs, logs, Options(), lambda _: None) == taken


@pytest.mark.parametrize(
    ("own", "samples", "taken"),
    [("mean", 0.52, "linear"), ("mean", 0.24, "mean"), ("mean", 0.76, "mean"), ("mean", 1.0, "mean"), ("linear", 0.5, "linear"),
     ("linear", 0.0, "linear"), ("held", 0.5, "held")],
)  # fmt: skip
def test_a_lag_that_makes_a_command_act_as_by_another_hold_is_that_hold(axis, own, samples, taken):
    lag = SimpleNamespace(law="actuator_lag", parameters={"time_constant_s": Estimate(samples * DT, (0.0, 1.0), "s")})
    result = found(findings=[lag] if samples else [])
    logs = [dataclasses.replace(log("held", 1), hold=own)]
    assert servo_log.later_hold(result, logs) == taken
    assert servo_log.later_hold(result, [dataclasses.replace(logs[0], hold_stated=True)]) == own
