"""A file whose motion amplifies small changes is refitted in its numbers and its start at once."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from types import SimpleNamespace

import pytest
from rotor_log import rotor_log

from diagnose.verdict.reference import Run, at_noise, cases_of, chi_square
from diagnose.verdict.reference_runs import run_files
from mjsim.mjcf import load_axis
from mjsim.mjcf.faithful import AUTHOR, Faithful, write_as_author
from mjsim.plant import MujocoPlant
from simgap import sensitivity
from simgap.bench import Bench
from simgap.sensitivity import refitted_with_starts

PENDULUM = """<mujoco><option timestep="0.005"/><worldbody><body name="rod" pos="0 0 1">
  <joint name="hinge" axis="0 1 0" damping="0.05"/>
  <inertial pos="0 0 -.3" mass=".5" diaginertia=".02 .02 .02"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """What is judged: numbers off by some 1e-4 and starts by three spreads, on two recordings."""
    folder = tmp_path_factory.mktemp("pendulum")
    model, out = folder / "model.xml", folder / "corrected.xml"
    model.write_text(PENDULUM)
    given = load_axis(model)
    cases = cases_of([rotor_log(PENDULUM, 1)], [rotor_log(PENDULUM, 2)])
    axis = given.with_values({p.name: p.value * 1.0002 for p in given.chain.linear_parameters()})
    write = partial(write_as_author, model)
    form = Faithful(AUTHOR, math.nan, write(axis, out), write)
    starts = [dataclasses.replace(c.start(), angle=3.0 * c.spread()[0]) for c in cases]
    runs = run_files([MujocoPlant.load(out)], cases, 1, starts)[0]
    return Bench(model, given, axis, SimpleNamespace(), SimpleNamespace(cases=cases), out, 1), form, runs


@pytest.mark.slow
def test_numbers_and_starts_are_found_at_once(bench):
    b, form, runs = bench
    cases = b.nominal.cases
    assert not at_noise(cases, runs)
    before, file = chi_square(cases, runs)[0], b.out.read_bytes()
    better = refitted_with_starts(b, b.axis, form, runs)
    assert chi_square(cases, better)[0] < 1.05 * len(cases[0].measured) < before
    assert b.out.read_bytes() != file
    assert better[0].start.angle < 0.6 * runs[0].start.angle
    # what cannot be lowered stays as it is
    file = b.out.read_bytes()
    perfect = [Run(c.measured, c.recording.angle, r.start) for c, r in zip(cases, better, strict=True)]
    assert refitted_with_starts(b, b.axis, form, perfect) is None
    assert b.out.read_bytes() == file


@pytest.mark.slow
def test_numbers_that_the_recordings_cannot_tell_stay(bench):
    b, form, runs = bench
    name = b.given.chain.linear_parameters()[0].name
    cases = [dataclasses.replace(c, unshown=(name,)) for c in b.nominal.cases]
    held = dataclasses.replace(b, nominal=SimpleNamespace(cases=cases))
    assert refitted_with_starts(held, b.axis, form, runs) is not None
    now, before = ({p.name: p.value for p in a.chain.linear_parameters()} for a in (load_axis(b.out), b.axis))
    assert now[name] == pytest.approx(before[name], rel=1e-9)
    others = [n for n in now if n != name]
    assert any(now[n] != pytest.approx(before[n], rel=1e-9) for n in others)


def test_no_refit_of_what_lacks_a_law_diverges_or_costs_too_much(bench, monkeypatch):
    b, form, runs = bench
    assert refitted_with_starts(b, b.axis, dataclasses.replace(form, lacks=("a law",)), runs) is None
    assert refitted_with_starts(b, b.axis, form, [None, runs[1]]) is None
    monkeypatch.setattr(sensitivity, "MOST_WORK", 1.0)
    assert refitted_with_starts(b, b.axis, form, runs) is None
