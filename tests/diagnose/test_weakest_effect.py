"""The weakest of several effects is left out where the user's simulator follows the recordings as well without it."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import pytest
from rotor_log import rotor_log

from diagnose.problem.noise_model import KnownNoise
from diagnose.result import Estimate, Finding
from diagnose.thresholds import SMALL
from diagnose.verdict.reference_fit import refit_in_simulator
from diagnose.verdict.reference_runs import run_files, starts_of
from diagnose.verdict.reference_stage import compare_nominal
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from mjsim.mjcf.faithful import AUTHOR, Faithful, write_as_author
from mjsim.plant import MujocoPlant
from simgap import weakest_effect
from simgap.weakest_effect import _gain, _weakest, without_weakest

SLED = """<mujoco><option timestep="0.005" integrator="Euler" gravity="0 0 0"/><worldbody><body name="rotor">
  <joint name="hinge" axis="0 0 1" damping="0.4" stiffness="{stiffness}"/>
  <geom type="cylinder" size=".2 .05" mass="5"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""


def log(seed, *, drag=0.0):
    """A recording of the rotor on a spring; ``drag``: coefficient of friction by the square of the velocity."""
    return rotor_log(SLED.format(stiffness=3.0), seed, drag)


def finding(effect, before, after):
    parameters = {name: Estimate(value, (0.9 * value, 1.1 * value), "") for name, value in effect.values.items()}
    evidence = {"held_out_error_before": before, "held_out_error_after": after}
    return Finding(effect.id, effect.place, "hinge", "", parameters, evidence)


@dataclass(frozen=True)
class Found:
    """What of a diagnosis is looked at."""

    findings: tuple[Finding, ...]
    notes: tuple[str, ...] = ()


@pytest.fixture
def asked(tmp_path):
    """Asks about drag beside a spring: (without_weakest, file before, file after)."""

    def ask(drag, share, in_log=0.0):
        path, out = tmp_path / "sled.xml", tmp_path / "corrected.xml"
        path.write_text(SLED.format(stiffness=0.0), encoding="utf-8")
        given = load_axis(path)
        spring = effect_class("joint_spring")(stiffness_Nm_rad=2.9, torque_at_zero_Nm=0.0)
        weak = effect_class("quadratic_friction")(coefficient_Nm_s2_rad2=drag)
        axis = given.with_effects([*given.effects, spring, weak])
        nominal = compare_nominal(path, given, [log(1, drag=in_log)], [log(2, drag=in_log)], 1)
        assert nominal is not None
        write = partial(write_as_author, path)
        form = Faithful(AUTHOR, math.nan, write(axis, out), write)
        runs = refitted(axis, write, nominal, tmp_path)
        before = out.read_bytes()
        found = Found((finding(spring, 1.0, 0.1), finding(weak, 1.0, math.sqrt(1.0 - share))))
        return without_weakest(given, axis, found, nominal, form, runs, out, 1), before, out.read_bytes()

    return ask


def refitted(axis, write, nominal, folder):
    """Runs of the file with both effects at the numbers that MuJoCo asks for."""
    best = refit_in_simulator(axis, write, "both.xml", nominal.cases, starts_of(axis, nominal.cases), 1)
    write(best.axis, folder / "both.xml")
    return run_files([MujocoPlant.load(folder / "both.xml")], nominal.cases, 1)[0]


@pytest.mark.slow
def test_a_stand_in_for_how_the_simulator_steps_is_left_out(asked):
    less, before, after = asked(0.002, 0.5 * SMALL)
    assert less is not None
    result, axis, runs = less
    assert [f.effect for f in result.findings] == ["joint_spring"]
    assert [e.id for e in axis.effects] == ["joint_spring"]
    assert result.findings[0].parameters["stiffness_Nm_rad"].value == 2.9  # that of the equations
    assert axis.effects[0].stiffness_Nm_rad == pytest.approx(3.0, rel=0.01)  # that of the file
    assert "quadratic friction at the motor is not named" in result.notes[0].lower()
    assert after != before
    assert all(r is not None for r in runs)


@pytest.mark.slow
def test_an_effect_that_is_in_the_recordings_stays(asked):
    less, before, after = asked(0.05, 0.5 * SMALL, in_log=0.05)
    assert less is None
    assert after == before


@pytest.mark.slow
def test_an_effect_that_explains_more_than_a_little_is_not_asked_about(asked):
    less, before, after = asked(0.002, 1.01 * SMALL)
    assert less is None
    assert after == before


SPRING = effect_class("joint_spring")(stiffness_Nm_rad=2.9, torque_at_zero_Nm=0.0)
DRAG = effect_class("quadratic_friction")(coefficient_Nm_s2_rad2=0.002)
PLAIN = SimpleNamespace(effects=(), kept_beside=lambda _: ())


def test_the_gain_of_an_effect():
    assert _gain(finding(DRAG, 2.0, 1.0)) == 0.75
    assert _gain(finding(DRAG, 1.0, 1.0)) == 0.0
    assert _gain(finding(DRAG, 0.0, 1.0)) == 0.0
    assert _gain(dataclasses.replace(finding(DRAG, 1.0, 0.5), evidence={})) == 0.0
    assert _gain(dataclasses.replace(finding(DRAG, 0.5, 0.5), evidence={"held_out_error_before": 0.5})) == 1.0


def test_which_effect_is_the_weakest():
    axis = SimpleNamespace(effects=(SPRING, DRAG))
    weak = finding(DRAG, 1.0, math.sqrt(1 - 0.99 * SMALL))
    strong = finding(SPRING, 1.0, 0.1)
    assert _weakest(PLAIN, axis, Found((strong, weak))) is weak
    assert _weakest(PLAIN, axis, Found((weak, strong))) is weak
    assert _weakest(PLAIN, axis, Found((weak,))) is None
    setting = dataclasses.replace(strong, kind="numerics")
    assert _weakest(PLAIN, axis, Found((setting, weak))) is None  # beside a setting of the simulator it is alone
    assert _weakest(PLAIN, axis, Found((strong, weak, dataclasses.replace(weak, kind="numerics")))) is weak
    assert _weakest(PLAIN, axis, Found((strong, finding(DRAG, 1.0, math.sqrt(1 - 1.01 * SMALL))))) is None
    assert _weakest(PLAIN, SimpleNamespace(effects=(SPRING,)), Found((strong, weak))) is None
    refined = SimpleNamespace(effects=(SPRING,), kept_beside=lambda effects: () if effects == [DRAG] else (SPRING,))
    assert _weakest(refined, axis, Found((strong, weak))) is None  # it took the place of an effect of the file
    kept = SimpleNamespace(effects=(SPRING,), kept_beside=lambda effects: (SPRING,))
    assert _weakest(kept, axis, Found((strong, weak))) is weak


@pytest.fixture
def judged(monkeypatch, tmp_path):
    """`without_weakest` around made-up runs: chi-squares of (fit, estimation, held out) beyond those before, in prices."""
    level = KnownNoise.prices.entry + 0.5 * KnownNoise.prices.price * 2  # a spring has two parameters

    def ask(fit=0.0, estimation=0.0, held_out=0.0, quiet=True, lacks=(), unwritten=()):
        base = {"estimation": 1000.0, "held_out": 500.0}
        after = {"estimation": base["estimation"] + estimation * level, "held_out": base["held_out"] + held_out * level}
        tables = {"before": base, "after": after}
        monkeypatch.setattr(weakest_effect, "chi_square", lambda cases, runs, part: (tables[runs][part], 100))
        monkeypatch.setattr(weakest_effect, "starts_of", lambda *_: [])
        goals = []

        def refit(fewer, write, name, cases, starts, threads, goal):
            goals.append(goal)
            return SimpleNamespace(chi2=base["estimation"] + fit * level, axis=fewer)

        def write(axis, trial):
            trial.write_text("fewer")
            return unwritten

        monkeypatch.setattr(weakest_effect, "refit_in_simulator", refit)
        monkeypatch.setattr(weakest_effect, "run_files", lambda *_: ["after"])
        monkeypatch.setattr(weakest_effect, "at_noise", lambda *_: quiet)
        monkeypatch.setattr(weakest_effect.MujocoPlant, "load", lambda *_: None)
        out = tmp_path / "corrected.xml"
        out.write_text("both")
        axis = SimpleNamespace(effects=(SPRING, DRAG), without=lambda key: key)
        found = Found((finding(DRAG, 1.0, 0.1), finding(SPRING, 1.0, math.sqrt(1 - 0.5 * SMALL))), ("kept",))
        form = SimpleNamespace(lacks=lacks, write=write)
        less = without_weakest(PLAIN, axis, found, SimpleNamespace(cases=()), form, "before", out, 1)
        assert sorted(p.name for p in tmp_path.iterdir()) == ["corrected.xml"]
        assert out.read_text() == ("both" if less is None else "fewer")
        assert goals in ([], [1000.0 + level])
        return less

    return ask


def test_an_effect_is_needed_above_its_price(judged):
    """On estimation and on held-out data, in the fit and in the run of the file, and where it does not come to the noise."""
    less = judged(fit=1.0, estimation=1.0, held_out=1.0)
    assert less is not None
    result, axis, runs = less
    assert (axis, runs) == ("joint_spring@motor", "after")
    assert [f.effect for f in result.findings] == ["quadratic_friction"]
    assert result.notes[0].startswith("Joint spring at the motor is not named")
    assert result.notes[1:] == ("kept",)
    for above in ({"fit": 1.001}, {"estimation": 1.001}, {"held_out": 1.001}, {"quiet": False}):
        assert judged(**above) is None
    assert judged(lacks=("what MJCF lacks",)) is None
    assert judged(unwritten=("what MJCF lacks",)) is None
