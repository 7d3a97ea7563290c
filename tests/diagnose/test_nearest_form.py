"""Laws that MJCF lacks: plain MuJoCo gets the nearest structure that it has, refitted, and simgap what was found."""

from __future__ import annotations

import dataclasses
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.options import Options
from diagnose.verdict.reference import chi_square
from diagnose.verdict.reference_stage import compare_nominal
from mjsim.effects import effect_class, registered
from mjsim.errors import InputError
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.mjcf.adjust import carry
from mjsim.mjcf.faithful import Faithful, nearest_native
from mjsim.ode import simulate
from mjsim.recording import Recording
from mjsim.system import assemble
from simgap.bench import Bench
from simgap.nearest_form import AS_GIVEN, with_nearest
from simgap.pipeline import diagnose_files

MODEL = """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="rotor">
  <joint name="hinge" axis="0 0 1" damping=".05"/><inertial pos="0 0 0" mass="1" diaginertia=".07 .07 .07"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
SUBLINEAR = effect_class("sublinear_viscous_friction")(coefficient=0.3, exponent=0.5)
DT, NOISE = 4e-3, 0.01


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "rotor.xml"
    path.write_text(MODEL, encoding="utf-8")
    return path


def log(axis, seed):
    rng, t = np.random.default_rng(seed), DT * np.arange(1500)
    u = sum(0.8 * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in (0.3, 1.1, 4.0))
    run = simulate(assemble(axis), u, DT)
    velocity, angle = run.velocity + NOISE * rng.standard_normal(len(t)), run.angle + 1e-4 * rng.standard_normal(len(t))
    return Recording(t, u, velocity, angle, DT, source=f"{seed}.csv")


@pytest.mark.slow
def test_plain_mujoco_gets_coulomb_friction_and_damping(model, tmp_path):
    axis, files, out = load_axis(model), [], tmp_path / "out"
    for seed in (1, 2):
        r = log(axis + SUBLINEAR, seed)
        files.append(tmp_path / r.source)
        table = np.column_stack([r.time, r.torque, r.velocity, r.angle])
        np.savetxt(files[-1], table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="")
    diagnose_files(files[:1], model, out, files[1:], Options(jobs=1, effects=(SUBLINEAR.id,)), progress=False, page=False)
    said = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    fit = {**said["fit"], "surrogate": said["fit"]["surrogate"]["corrected"]}
    given, mended, engine = (fit[name]["held_out_rms"] for name in ("nominal", "corrected", "surrogate"))
    assert engine < 1.1 * NOISE
    assert NOISE < mended < 10 * NOISE < given / 10
    assert f"corrected.xml by {mended:.4g}" in said["summary"]
    assert f"by {engine:.4g} in simgap's replay" in said["summary"]
    assert any(note.startswith("In corrected.xml, plain MuJoCo has in place") and "Coulomb" in note for note in said["notes"])
    found = load_model(out / "corrected.xml")
    assert [e.id for e in found.axis.effects] == [SUBLINEAR.id]
    assert found.axis.chain.bodies[0].viscous == pytest.approx(0.05, rel=0.1)  # what simgap replays
    assert found.mjmodel.dof_frictionloss[0] > 0.1
    assert found.mjmodel.dof_damping[0] > 0.1
    again = tmp_path / "again.xml"  # a correction of it starts from what its author wrote
    write_corrected(out / "corrected.xml", axis, again)
    assert load_axis(again) == axis
    assert load_model(again).mjmodel.dof_frictionloss[0] == 0.0


def test_the_tangent_of_a_law_at_a_speed(model):
    axis = load_axis(model) + SUBLINEAR
    native = nearest_native(axis, {SUBLINEAR.key}, 4.0)
    (dry,) = native.effects
    assert dry.id == "coulomb_friction"
    added = native.chain.bodies[0].viscous - 0.05
    assert dry.torque_Nm + added * 4.0 == pytest.approx(0.3 * 2.0)
    assert added == pytest.approx(0.3 * 0.5 / 2.0)
    assert nearest_native(axis, (), 4.0) == axis


def test_what_comes_near_has_native_values(model):
    """Of every effect that declares something, at a rotor and at a coupling."""
    chains = [load_axis(model).chain, load_axis("models/robot_axis1.xml").chain]
    seen = set()
    for cls in registered().values():
        for chain in chains:
            numbers = {s.name: min(max(0.5, s.lower), s.upper) for s in cls.specs()}
            effect = next((e for p in cls.places if chain.body((e := cls(place=p, **numbers)).place) is not None), None)
            try:
                found = effect and effect.ports(chain) and effect.nearest(chain, 1.0)
            except ValueError:
                continue
            if found:
                seen.add(cls.id)
                assert not effect.native(chain).values
                assert all(e.native(found[0]).values and not e.native(found[0]).lacks for e in found[1])
    assert SUBLINEAR.id in seen
    assert len(seen) == 3


def bench(model, tmp_path):
    axis = load_axis(model)
    logs = [log(axis + SUBLINEAR, seed) for seed in (1, 2)]
    nominal = compare_nominal(model, axis, logs[:1], logs[1:], 1)
    found = axis + SUBLINEAR
    b = Bench(model, axis, found, SimpleNamespace(), nominal, tmp_path / "corrected.xml", 1)
    lacks = write_corrected(model, found, b.out).lacks
    return b, Faithful("plain", 0.0, lacks, None)


def test_a_form_that_follows_worse_than_the_file_as_given_is_not_written(model, tmp_path):
    b, form = bench(model, tmp_path)
    bad = [dataclasses.replace(r, velocity=2.0 * r.velocity + 9.0) for r in b.nominal.runs]

    def settle(other):
        write_corrected(model, other.axis, other.out)
        return Faithful("nearest", 0.0, (), None), bad

    written, runs, notes = with_nearest(b, form, bad, settle)
    assert written.form == "as given"
    assert runs is b.nominal.runs
    assert notes == (AS_GIVEN,)
    assert load_axis(b.out) == b.axis
    assert load_model(b.out).mjmodel.dof_frictionloss[0] == 0.0
    assert load_model(b.out).mjmodel.dof_damping[0] == 0.05


def test_the_better_form_counts_and_a_file_that_lacks_nothing_stays(model, tmp_path):
    b, form = bench(model, tmp_path)
    as_it_is = b.out.read_bytes()
    runs = b.run(b.out)

    def refuse(other):
        raise InputError("file", "no", "yes", "other")

    assert with_nearest(b, form, b.nominal.runs, refuse)[1] is b.nominal.runs
    assert b.out.read_bytes() == as_it_is
    better = [dataclasses.replace(r, velocity=c.measured) for r, c in zip(b.nominal.runs, b.nominal.cases, strict=True)]
    assert chi_square(b.nominal.cases, better)[0] == 0.0

    def settle(other):
        write_corrected(model, other.axis, other.out)
        return Faithful("nearest", 0.0, (), None), better

    written, after, notes = with_nearest(b, form, runs, settle)
    assert (written.form, written.lacks, after) == ("nearest", form.lacks, better)
    assert "Coulomb" in notes[0]
    assert load_axis(b.out) == b.axis
    whole = dataclasses.replace(form, lacks=())
    assert with_nearest(b, whole, runs, refuse) == (whole, runs, ())
    assert not list(tmp_path.glob(".*part*"))


def test_a_file_that_carries_nothing_cannot_carry_more(model):
    with pytest.raises(InputError, match="carries no correction"):
        carry(model, load_axis(model), ())
    assert math.isfinite(load_axis(model).chain.bodies[0].viscous)
