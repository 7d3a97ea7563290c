"""Logs of a task that is held up: rows at a steady rate, then a gap in which the input is held and nothing is measured."""

from __future__ import annotations

import dataclasses
import json
import re
from functools import cache

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

import simgap
from diagnose.data.gap_input import _cubic, _line, as_moved, with_input_in_gaps
from diagnose.data.split import split
from diagnose.fit.fitter import Fitter
from diagnose.fit.whiten import _order_left
from diagnose.pipeline import Options
from diagnose.problem.choose_view import choose_view, with_samples
from diagnose.result import Verdict
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from mjsim.recording import load
from mjsim.render.take import Rig, simulated
from simgap.cli import cli
from simgap.pipeline import diagnose_recordings

DT, LOGGED, OF, NOISE = 0.002, 8, 13, 0.05
WHEEL = """<mujoco><option timestep="0.0005" gravity="0 0 0" integrator="RK4"/><worldbody><body name="wheel">
<joint name="wheel" axis="0 1 0" damping="8.7e-4"/><inertial pos="0 0 0" mass=".02" diaginertia="4.5e-5 4.5e-5 4.5e-5"/></body>
</worldbody><actuator><motor name="motor" joint="wheel"/></actuator></mujoco>"""
ARM = """<mujoco><option timestep="0.001" integrator="{integrator}"/><worldbody><body name="arm" pos="0 0 1">
<joint name="hinge" axis="0 1 0" damping=".03" frictionloss="{friction}" solreffriction="-1 -2000"
solimpfriction=".9999 .9999 .001 .5 2"/><inertial pos="0 0 -.4" mass=".8" diaginertia=".03 .03 .03"/></body></worldbody>
<actuator><motor name="m" joint="hinge"/></actuator></mujoco>"""
BINDING = {"time": "time_s", "torque": "torque_Nm", "velocity": "velocity_rad_s"}


def rows(model, seed, n=3000):
    """A wheel with Coulomb friction, of which the model knows nothing; columns (m,) of the rows that were logged."""
    rng, k = np.random.default_rng(seed), np.arange(n)
    logged = k % OF < LOGGED
    torque = 0.03 * np.repeat(rng.uniform(-1, 1, n // 50), 50)
    torque = torque[np.maximum.accumulate(np.where(logged, k, 0))]
    friction = simgap.effects["coulomb_friction"](place="motor", torque_Nm=0.004)
    run = simgap.simulate(model, torque, dt=DT, effects=[friction])
    velocity = np.array(run.velocity) + NOISE * rng.standard_normal(n)
    return {"time_s": (DT * k)[logged], "torque_Nm": torque[logged], "velocity_rad_s": velocity[logged]}


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("gaps") / "wheel.xml"
    path.write_text(WHEEL, encoding="utf-8")
    return path


def test_friction_is_found_in_a_log_with_gaps(model, tmp_path):
    logs = [simgap.load(rows(model, s, 2000), binding={"recording": {**BINDING, "jitter": 0.1}}, name=f"log {s}") for s in (1, 2)]
    few = Options(effects=("coulomb_friction",))
    result = diagnose_recordings(logs[:1], model, tmp_path, logs[1:], few, progress=False, page=False)
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert [f.effect for f in result.findings] == ["coulomb_friction"]
    assert result.findings[0].parameters["torque_Nm"].value == pytest.approx(0.004, rel=0.1)


def test_check_takes_a_log_with_gaps_from_end_to_end_once_a_jitter_is_declared(model, tmp_path):
    log, columns = tmp_path / "log.csv", rows(model, 1)
    np.savetxt(log, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    gap = next(p for p in simgap.check(log, model).problems if p.problem == "gap")
    advised = re.search(r"jitter = ([\d.]+)", gap.advice)
    log.with_suffix(".toml").write_text(f'[recording]\njitter = {advised.group(1)}\ntime = "time_s"\n')
    assert simgap.load(log, model=model).duration == pytest.approx(3000 * DT, rel=0.01)
    assert "gap" not in {p.problem for p in simgap.check(log, model).problems}


@pytest.mark.parametrize(("length", "order"), [(8, 4), (1, 0), (60, 24)])
def test_a_whitening_filter_leaves_half_of_the_samples(length, order):
    counts = np.tile(np.repeat([True, False], [length, 5]), 20)
    assert _order_left(counts, 24) == order


@cache
def lossy(seed, *, held=False, gaps=30, friction=0.15, seconds=15.0, dt=0.01, integrator="Euler"):
    """A recording of a pendulum with dry friction in plain MuJoCo, of which a few rows are lost at random places.

    ``held``: the torque stays as it was in the last row until the next one is written; ``integrator``: "RK4", which takes four
    times as long, where friction is measured.
    """
    m = mujoco.MjModel.from_xml_string(ARM.format(friction=friction, integrator=integrator))
    d, rng, n = mujoco.MjData(m), np.random.default_rng(seed), round(seconds / dt)
    logged, t = np.ones(n, bool), dt * np.arange(n)
    for a in rng.choice(np.arange(2, n // 4 - 2), gaps, replace=False):
        logged[4 * a : 4 * a + 1 + rng.integers(2)] = False
    torque = sum(0.5 * np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) for f in np.linspace(0.2, 2.5, 8))
    if held:
        torque = torque[np.maximum.accumulate(np.where(logged, np.arange(n), 0))]
    rows = np.empty((n, 2))
    for k, u in enumerate(torque):
        rows[k], d.ctrl[0] = (d.qpos[0], d.qvel[0]), u
        mujoco.mj_step(m, d, round(dt / m.opt.timestep))
    rows += rng.standard_normal((n, 2)) * [1e-4, 0.02]
    columns = {"time_s": t, "torque_Nm": torque, "angle_rad": rows[:, 0], "velocity_rad_s": rows[:, 1]}
    binding = {"recording": {"time": "time_s", "jitter": 0.1}}
    return simgap.load({k: x[logged] for k, x in columns.items()}, binding=binding, name=f"log {seed}"), torque


@pytest.mark.parametrize("channels", ["both", "angle"])
@pytest.mark.parametrize("held", [False, True])
def test_the_input_in_gaps_is_what_moved_the_axis(channels, held):
    pairs = [lossy(seed, held=held) for seed in (1, 2)]
    logs = [log if channels == "both" else dataclasses.replace(log, velocity=None) for log, _ in pairs]
    fitted, kept, said = with_input_in_gaps(logs[:1], logs[1:])
    assert bool(said) == (not held)
    for log, (_, torque) in zip((*fitted, *kept), pairs, strict=True):
        assert np.max(np.abs(log.torque - torque[: len(log)])) < 0.1
    lengths = sum(len(log) for log in logs)
    assert 0.01 * lengths < sum(log.missing.sum() for log in logs) < 0.05 * lengths


def test_a_log_without_gaps_or_with_too_few_rows_keeps_its_input():
    log = lossy(3, gaps=0)[0]
    assert with_input_in_gaps([log], []) == ([log], [], ())
    short = lossy(4, gaps=3, seconds=0.6)[0]
    assert short.missing is not None
    assert with_input_in_gaps([short], [])[0][0] is short


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(2, 30), marks=pytest.mark.slow)])
@pytest.mark.parametrize("held", [False, True])
def test_one_recording_with_many_short_gaps_is_enough(held, seeds):
    """By single rows beside the gaps two of sixty such recordings are taken for the other kind."""
    taken = [bool(with_input_in_gaps([lossy(seed, held=held, gaps=60)[0]], [])[2]) for seed in seeds]
    assert taken == [not held] * len(seeds)


def test_a_part_of_a_log_may_begin_and_end_in_a_gap():
    log = lossy(5, gaps=60)[0]
    at = np.flatnonzero(log.missing)
    part = log.slice(int(at[0]), int(at[-1]) + 1)
    fitted, _, said = with_input_in_gaps([part], [])
    assert said
    assert np.isfinite(fitted[0].torque).all()
    nothing = dataclasses.replace(log, torque=np.zeros(len(log)), driven=False)
    assert with_input_in_gaps([nothing], []) == ([nothing], [], ())


@pytest.mark.slow
def test_friction_is_found_in_a_log_that_lost_rows(tmp_path):
    """With the input held in the gaps what follows them is off by more than the noise: unexplained, or a law with creep."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(friction=0, integrator="RK4"), encoding="utf-8")
    logs = [lossy(seed, integrator="RK4")[0] for seed in (1, 2)]
    few = Options(jobs=1, effects=("coulomb_friction",))
    result = diagnose_recordings(logs[:1], path, tmp_path / "out", logs[1:], few, progress=False, page=False)
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert [f.law for f in result.findings] == ["coulomb_friction"]
    assert result.findings[0].parameters["torque_Nm"].value == pytest.approx(0.15, rel=0.05)
    assert any("on cubics" in note for note in result.notes)


@pytest.mark.parametrize(("noise", "form", "most"), [(0.0, "on cubics", 0.01), (0.05, "on straight lines", 0.3)])
def test_a_smooth_input_bends_in_the_gaps_and_a_noisy_one_does_not(noise, form, most):
    """Straight lines lie inside a curve, by .02 N m here; a cubic through noise errs more than a line."""
    log, torque = lossy(6, gaps=60)
    recorded = log.torque + noise * np.random.default_rng(6).standard_normal(len(log))
    (filled,), _, (said,) = with_input_in_gaps([dataclasses.replace(log, torque=recorded)], [])
    assert form in said
    missed = np.abs(filled.torque - torque[: len(log)])[log.missing]
    assert np.max(missed) < most
    if not noise:
        there = np.flatnonzero(~log.missing)
        lines = np.interp(np.arange(len(log)), there, torque[there])
        assert np.max(np.abs(lines - torque[: len(log)])) > 2 * most


def test_cubics_through_four_rows_are_exact_for_cubics():
    for n in (2, 3, 7):
        x = np.arange(-1.0, n + 2)
        u = 1.0 + x * (0.3 + x * (-0.2 + 0.05 * x))
        assert _cubic(n) @ u[[0, 1, -2, -1]] == pytest.approx(u[2:-2], rel=1e-12)
        straight = 2.0 - 0.3 * x
        assert _line(n) @ straight[[0, 1, -2, -1]] == pytest.approx(straight[2:-2], rel=1e-12)


@pytest.mark.parametrize("seed", [100, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (102, 104))])
def test_what_the_gaps_hide_of_the_input_does_not_move_friction(seed, tmp_path):
    """On straight lines it is off by .3 to 1.5 standard errors from that by the true input, towards zero."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(friction=0, integrator="RK4"), encoding="utf-8")
    axis, pairs = load_axis(path), [lossy(s, integrator="RK4") for s in (seed, seed + 1)]
    true = [dataclasses.replace(log, torque=torque[: len(log)]) for log, torque in pairs]
    filled = with_input_in_gaps([pairs[0][0]], [pairs[1][0]])
    (best, error), (other, _) = (friction_of(axis, *logs) for logs in (true, (*filled[0], *filled[1])))
    assert abs(other - best) < 0.1 * error
    assert abs(best - 0.15) < 3 * error


@pytest.fixture(scope="module")
def lossy_files(tmp_path_factory):
    """Logs that lost rows, the model that made them, and a baseline of the noise."""
    folder = tmp_path_factory.mktemp("lossy")
    (folder / "arm.xml").write_text(ARM.format(friction=0.15, integrator="RK4"), encoding="utf-8")
    recordings = []
    for name, seed, role in (("a", 1, "estimation"), ("b", 2, "held-out")):
        log, path = lossy(seed, gaps=60, seconds=8.0, integrator="RK4")[0], folder / f"{name}.csv"
        columns = np.column_stack([log.time, log.torque, log.angle, log.velocity])[~log.missing]
        np.savetxt(path, columns, delimiter=",", header="time_s,torque_Nm,angle_rad,velocity_rad_s", comments="")
        path.with_suffix(".toml").write_text('[recording]\ntime = "time_s"\njitter = 0.1\n')
        recordings.append({"file": path.name, "sha256": load(path).sha256, "role": role})
    figures = {"fit": {"nominal": {"rms": 0.02, "held_out_rms": 0.02}}, "recordings": recordings}
    view = {"judged_on": {"view": "motion (free run)", "unit": "rad/s"}}
    (folder / "diagnosis.json").write_text(json.dumps(figures | view))
    return folder


@pytest.mark.slow
def test_replay_and_gate_take_the_input_in_gaps_as_diagnose_does(lossy_files, tmp_path):
    """Held at the last row, the input leaves 1.4 times the noise at the true model."""
    words = [str(lossy_files / "arm.xml"), str(lossy_files / "a.csv")]
    for engine in ("ode", "literal"):
        call = ["replay", *words, "--out", str(tmp_path / "p.csv"), "--engine", engine]
        told = json.loads(CliRunner().invoke(cli, [*call, "--json"]).output)
        assert told["rms"] == pytest.approx(0.02, rel=0.05)
    assert told["rms"] < 0.021
    assert "on cubics" in CliRunner().invoke(cli, call).output
    gate = ["gate", *words, str(lossy_files / "b.csv"), "--baseline", str(lossy_files / "diagnosis.json"), "--json"]
    ratios = [c["ratio"] for c in json.loads(CliRunner().invoke(cli, gate).output)["checks"]]
    assert ratios == pytest.approx([1.0, 1.0], rel=0.05)


def test_a_film_takes_the_input_in_gaps_as_diagnose_does(lossy_files):
    rig, path = Rig.of(lossy_files / "arm.xml"), lossy_files / "a.csv"
    torque = lossy(1, gaps=60, seconds=8.0, integrator="RK4")[1]
    ready = (lambda r: dataclasses.replace(r, torque=torque[: len(r)]), as_moved, lambda r: r)
    true, moved, held = (simulated(rig, path, ready=r).qpos[:, 0] for r in ready)
    assert np.std(moved - true) < 0.05 * np.std(held - true)


def friction_of(axis, fitted, held):
    """Coulomb friction of a pair of recordings, and its standard error [N m]."""
    view = choose_view([fitted, held], None, axis)
    estimation, validation = split([fitted], [held])
    fitter = Fitter(axis, with_samples(view, (*estimation, *validation), axis, None), estimation, validation, 1)
    found = fitter.refined(fitter.fit(fitter.hypothesis((effect_class("coulomb_friction")(place="motor", torque_Nm=0.15),))))
    (at,) = [i for i, e in enumerate(found.hypothesis.entries) if e.name == "torque_Nm" and "coulomb" in e.owner]
    return found.effects[0].values["torque_Nm"], float(found.standard_errors(fitter.noise)[at])
