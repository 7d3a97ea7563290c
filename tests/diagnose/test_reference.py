"""The user's MuJoCo file as the judge: its figures, the settings that act like physics, the verdict that the figures bear."""

from __future__ import annotations

import dataclasses
import json
import math
from functools import cache, partial
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from diagnose.pipeline import Options, diagnose
from diagnose.result import FitFigures, Verdict
from diagnose.thresholds import SIGMAS
from diagnose.verdict import numerics
from diagnose.verdict.reference import Run, beyond, cases_of, chi_square, figures, noise_level
from diagnose.verdict.reference_fit import refit_in_simulator, uncertainties
from diagnose.verdict.reference_runs import run_files, run_watched, starts_of, too_far
from diagnose.verdict.reference_stage import APART, by_other_friction, compare_nominal
from diagnose.verdict.reference_verdict import Files, by_simulator, no_better, nominal_stands
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis, write_corrected
from mjsim.mjcf.adjust import adjust
from mjsim.mjcf.faithful import Faithful, write_as_author, write_faithful
from mjsim.plant import MujocoPlant
from mjsim.plant.settings import altered, mended
from mjsim.recording import Recording
from simgap.bench import Bench
from simgap.judging import _author_or_mended, _soft_or_not
from simgap.pipeline import diagnose_files

DT, SIGMA = 2e-3, 0.02
STIFF = 'solreffriction="-1 -1000" solimpfriction=".9999 .9999 .001 .5 2"'
PENDULUM = """<mujoco><option timestep="0.001" integrator="Euler"/><worldbody><body name="rod" pos="0 0 1">
  <joint name="hinge" axis="0 1 0" damping="0.05" frictionloss="{friction}" {solver}/>
  <inertial pos="0 0 -.3" mass=".5" diaginertia=".02 .02 .02"/></body></worldbody>
  <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""


def text(friction=0.35, solver=""):
    return PENDULUM.format(friction=friction, solver=solver)


@cache
def log(xml, seed, seconds=4.0):
    """A recording made by plain MuJoCo."""
    m = mujoco.MjModel.from_xml_string(xml)
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    t = DT * np.arange(round(seconds / DT))
    u = 1.2 * np.sin(2 * np.pi * (0.4 + 0.2 * t) * t + seed) * np.minimum(t, 1.0)
    q, v = np.empty(len(t)), np.empty(len(t))
    for k in range(len(t)):
        q[k], v[k], d.ctrl[0] = d.qpos[0], d.qvel[0], u[k]
        mujoco.mj_step(m, d, round(DT / m.opt.timestep))
    noise = rng.standard_normal((2, len(t)))
    return Recording(t, u, v + SIGMA * noise[0], q + 1e-4 * noise[1], DT, source=f"log_{seed}.csv")


@pytest.fixture
def nominal(tmp_path):
    path = tmp_path / "pendulum.xml"
    path.write_text(text(), encoding="utf-8")
    return path


def test_figures_are_those_of_the_file_in_mujoco(nominal):
    cases = cases_of([log(text(), 1)], [log(text(), 2)])
    runs = run_files([MujocoPlant.load(nominal)], cases, 1)[0]
    f = figures(cases, runs)
    assert f.rms == pytest.approx(SIGMA, rel=0.05)
    assert f.held_out_rms == pytest.approx(SIGMA, rel=0.05)
    chi2, n = chi_square(cases, runs)
    assert n == 2000
    assert chi2 / n == pytest.approx((f.rms / cases[0].sigma) ** 2)
    none = [None, runs[1]]
    assert figures(cases, none).rms == math.inf
    assert chi_square(cases, none)[0] == math.inf


def test_blocks_of_one_recording_are_held_out_where_there_is_no_other():
    (case,) = cases_of([log(text(), 1)], [])
    assert not np.any(case.estimation & case.held_out)
    assert np.all(case.estimation | case.held_out)


def test_recordings_bear_the_simulators_friction_where_it_made_them(nominal):
    found = compare_nominal(nominal, load_axis(nominal), [log(text(), 1)], [log(text(), 2)], 1)
    assert found.apart < APART < found.soft  # the friction of the engine is as soft
    assert not found.simulator
    assert not found.corrections()
    assert found.axis.chain.bodies[0].softness is not None
    assert found.other == load_axis(nominal)
    assert "soft" in numerics.note(None, found)
    hard = by_other_friction(found)
    assert hard.axis == load_axis(nominal)
    assert hard.apart > APART


def test_recordings_of_ideal_friction_do_not_and_name_the_setting(nominal):
    axis, stiff = load_axis(nominal), text(solver=STIFF)
    found = compare_nominal(nominal, axis, [log(stiff, 1)], [log(stiff, 2)], 1)
    assert found.apart > APART
    assert not found.simulator
    assert found.axis == axis
    cause = numerics.cause_of(found, 1)
    assert cause is not None
    assert (cause.setting.id, cause.element) == ("soft_friction", "hinge")
    assert cause.left < APART < cause.apart


@pytest.mark.slow
def test_the_difference_is_that_of_the_numerics_and_not_of_what_is_missing(nominal, monkeypatch):
    """Gravity follows the recorded angle in a fit: what is missing there is no difference between the two engines."""
    monkeypatch.setattr("diagnose.verdict.reference_stage.has_soft_friction", lambda model: False)
    truth = text().replace('joint="hinge"', 'joint="hinge" biastype="affine" biasprm="0.15 0 0"').replace("<motor", "<general")
    clean = compare_nominal(nominal, load_axis(nominal), [log(text(), 1)], [log(text(), 2)], 1)
    found = compare_nominal(nominal, load_axis(nominal), [log(truth, 1)], [log(truth, 2)], 1)
    assert clean.simulator
    assert not found.simulator  # far from the noise, the nominal structure does not say whose numerics the recordings have
    for shift, of_clean in zip(found.shifts, clean.shifts, strict=True):
        assert np.std(shift) < 2 * np.std(of_clean)


def test_uncertainty_of_a_run_is_that_of_its_numbers(nominal):
    """On the data that were fitted the mean of diag(J C J') is p / n; others may be less certain."""
    cases = cases_of([log(text(), 1, 3.0)], [log(text(), 2, 3.0)])
    axis = load_axis(nominal)
    fitted, held = uncertainties(axis, cases, [c.start() for c in cases])
    assert fitted**2 * 1500 == pytest.approx(4, rel=0.05)
    assert 0.3 * fitted < held < 3 * fitted


def _noisy_start(first, **changes):
    """A recording with a noisy angle that begins ``first`` standard deviations off."""
    r = log(text(solver=STIFF), 1)
    angle = r.angle + 0.003 * np.random.default_rng(5).standard_normal(len(r))
    angle[0] = 0.003 * first
    return cases_of([dataclasses.replace(r, angle=angle, **changes)], [])


def test_a_start_is_corrected_by_what_its_noise_allows(nominal):
    cases = _noisy_start(3.0)
    ((run,),) = run_files([MujocoPlant.load(nominal)], cases, 1)
    assert abs(run.start.angle) < 0.003
    # errors that are no start's do not move it further than noise does
    cases = _noisy_start(0.0, velocity=log(text(0.8), 3).velocity)
    ((run,),) = run_files([MujocoPlant.load(nominal)], cases, 1)
    assert abs(run.start.angle) < 4.1 * cases[0].spread()[0]


def test_no_difference_is_no_cause(tmp_path):
    path = tmp_path / "stiff.xml"
    path.write_text(text(solver=STIFF).replace("0.001", "0.0001", 1), encoding="utf-8")
    axis = load_axis(path)
    found = compare_nominal(path, axis, [log(text(solver=STIFF), 1, 2.0)], [], 1)
    assert found.apart < APART
    assert numerics.cause_of(found, 1) is None
    assert numerics.note(None, found) == ""


def test_settings_are_mended_in_model_and_file_alike(nominal, tmp_path):
    out = tmp_path / "corrected.xml"
    write_corrected(nominal, load_axis(nominal), out)
    model, edits = mended(MujocoPlant.load(out).model, "soft_friction")
    adjust(out, edits)
    again = MujocoPlant.load(out).model
    assert again.opt.timestep == model.opt.timestep == 1e-4
    assert np.allclose(again.dof_solref, model.dof_solref)
    assert np.allclose(again.dof_solimp, model.dof_solimp)
    as_given = MujocoPlant.load(nominal).model
    assert altered(as_given, model, "soft_friction")
    assert altered(as_given, model, "coarse_timestep")
    assert not altered(as_given, model, "soft_limit")
    assert not altered(model, again, "soft_friction")
    assert mended(model, "soft_limit") is None
    with pytest.raises(KeyError, match="soft_friction"):
        mended(model, "no_such")
    # it is undone with the correction
    back = tmp_path / "back.xml"
    write_corrected(out, load_axis(nominal), back)
    assert MujocoPlant.load(back).model.opt.timestep == 0.001


def test_the_authors_friction_settings_are_kept(nominal, tmp_path):
    out = tmp_path / "corrected.xml"
    axis = load_axis(nominal).with_values({"coulomb_friction@motor.torque_Nm": 0.3})
    write_as_author(nominal, axis, out)
    m, before = MujocoPlant.load(out).model, MujocoPlant.load(nominal).model
    assert m.dof_frictionloss[0] == 0.3
    assert np.array_equal(m.dof_solref, before.dof_solref)
    assert m.opt.timestep == before.opt.timestep


def test_the_first_form_that_is_near_enough_is_written(nominal, tmp_path):
    axis = load_axis(nominal).with_values({"fm": 0.07})
    told = iter([(3.0, False), (0.1, True)])
    form = write_faithful(nominal, axis, tmp_path / "out.xml", lambda _: next(told))
    assert (form.form, form.differs) == ("stiff friction at a long timestep", 0.1)
    told = iter([(3.0, False), (5.0, False), (4.0, False), (3.5, False)])
    form = write_faithful(nominal, axis, tmp_path / "out.xml", lambda _: next(told))
    assert (form.form, form.differs) == ("the author's settings", 3.0)
    assert not list(tmp_path.glob(".out*"))


def test_a_watched_run_stops_where_it_is_of_no_use_and_is_else_the_whole_run(nominal):
    cases = cases_of([log(text(), 1)], [log(text(), 2)])
    plant, starts = MujocoPlant.load(nominal), [c.start() for c in cases]
    runs, whole = run_watched(plant, cases, starts, 1, lambda _: False)
    assert whole
    for run, again in zip(runs, run_files([plant], cases, 1, starts)[0], strict=True):
        assert np.array_equal(run.velocity, again.velocity)
        assert np.array_equal(run.angle, again.angle)
    targets = [r.velocity + SIGMA for r in runs]
    assert not too_far(cases, targets, 1.2)(runs)
    part, whole = run_watched(plant, cases, starts, 1, too_far(cases, targets, 0.5))
    assert not whole
    assert [len(r.velocity) for r in part] == [800, 800]  # the first horizon at which a quarter of the squares is there


def test_chi_square_to_come_is_that_of_noise():
    (case, other) = cases_of([log(text(), 1)], [log(text(), 2)])
    n = len(case.measured)
    so_far = Run(case.measured[: n // 4], np.zeros(n // 4), case.start())  # no error in a quarter
    rest = 0.75 * n
    least = 0.95 * rest - SIGMAS * math.sqrt(2.0 * rest)
    nothing = Run(np.empty(0), np.empty(0), other.start())
    assert beyond([case, other], [so_far, nothing], least - 1.0)
    assert not beyond([case, other], [so_far, nothing], least + 1.0)
    assert noise_level(n) > n


def test_a_refit_that_cannot_come_to_the_noise_is_given_up_on_its_first_part(nominal, monkeypatch):
    nominal.write_text(text(friction=0), encoding="utf-8")
    axis, cases = load_axis(nominal), cases_of([log(text(), 1, 2.0)], [])
    lengths = []
    run = MujocoPlant.run
    monkeypatch.setattr(MujocoPlant, "run", lambda self, u, *a, **k: lengths.append(len(u)) or run(self, u, *a, **k))

    def refit(goal):
        write = partial(write_as_author, nominal)
        return refit_in_simulator(axis, write, "out.xml", cases, [c.start() for c in cases], 1, goal)

    n = int(cases[0].estimation.sum())
    assert refit(noise_level(n)) is None
    assert max(lengths) < len(cases[0].measured)
    assert refit(math.inf).chi2 > noise_level(n)
    assert max(lengths) == len(cases[0].measured)


def test_where_a_run_starts_is_found_by_the_engine(nominal):
    r = log(text(), 1)
    moved = dataclasses.replace(r, angle=r.angle + 3e-4 * (np.arange(len(r)) == 0))
    (case,) = cases_of([moved], [])
    assert case.first(300).measured.shape == (300,)
    assert case.first(10**6) is case
    run = run_files([MujocoPlant.load(nominal)], [case], 1)[0][0]
    (start,) = starts_of(load_axis(nominal), [case])
    assert run.start == start
    assert abs(start.angle) < abs(case.start().angle) or start == case.start()


@pytest.fixture(scope="module")
def judged(pair, robot, tmp_path_factory):
    """(result without findings, nominal comparison) to lay other figures on."""
    nominal = tmp_path_factory.mktemp("judged") / "pendulum.xml"
    nominal.write_text(text(), encoding="utf-8")
    estimation, held_out = pair(seconds=1.5)
    result = diagnose(robot, [estimation], [held_out], Options(jobs=1, effects=("torque_offset",)))
    given = compare_nominal(nominal, load_axis(nominal), [log(text(), 1)], [log(text(), 2)], 1)
    return result, by_other_friction(given)  # beside equations whose friction holds at rest


def test_the_verdict_follows_the_figures(judged):
    result, given = judged
    n = figures(given.cases, given.runs)
    same = FitFigures(n.rms, n.nrmse, n.held_out_rms, n.held_out_nrmse)
    result = dataclasses.replace(result, fit=dict.fromkeys(("nominal", "refitted", "corrected"), same), noise_floor=SIGMA)
    # the file as given is as good as anything
    assert nominal_stands(result, given)
    # a search that had the simulator's numerics has answered that itself
    assert not nominal_stands(result, dataclasses.replace(given, simulator=True))
    out = by_simulator(result, given, Files(given.runs, (), "as given"))
    assert out.verdict is Verdict.NO_MISMATCH
    assert set(out.as_dict()["fit"]) >= {"nominal", "corrected", "surrogate", "noise_floor"}
    # a better model makes it a mismatch; a file that does not reach the engine's error is told, and bears no verdict
    better = FitFigures(0.9 * n.rms, n.nrmse, 0.9 * n.held_out_rms, n.held_out_nrmse)
    result = dataclasses.replace(result, fit={**result.fit, "corrected": better}, noise_floor=0.9 * SIGMA)
    assert not nominal_stands(result, given)
    out = by_simulator(result, given, Files(given.engine, (), "stiff settings"))
    assert out.verdict is Verdict.UNEXPLAINED
    assert out.notes[0].startswith("Warning")
    assert by_simulator(result, given, Files(given.engine, ("it lacks this",), "")).verdict is result.verdict
    # where the smallest change leads elsewhere the file need not reach the engine's error, but it may not be worse than as given
    sensitive = by_simulator(result, given, Files(given.engine, (), "", sensitive=True))
    assert result.verdict is Verdict.PARAMETERS_ONLY or result.verdict is Verdict.NO_MISMATCH
    assert figures(given.cases, given.engine).held_out_rms > 1.1 * n.held_out_rms
    assert sensitive.verdict is Verdict.UNEXPLAINED
    assert "as given by" in sensitive.summary


@pytest.mark.parametrize(("write", "names"), [(write_corrected, ["soft_friction"]), (write_as_author, [])])
def test_a_setting_is_named_where_a_form_changes_it(nominal, monkeypatch, write, names):
    """By which form the file follows the recording: with stiff friction, at any timestep, or with the friction that it had."""
    axis, stiff = load_axis(nominal), text(solver=STIFF)
    given = compare_nominal(nominal, axis, [log(stiff, 1, 2.0)], [log(stiff, 2, 2.0)], 1)
    cause = numerics.cause_of(given, 1)
    result = SimpleNamespace(fit={"corrected": FitFigures(SIGMA, 0.1, SIGMA, 0.1)})
    axis = axis.with_values({"coulomb_friction@motor.torque_Nm": 0.3501})  # as written, else it is left as it is
    bench = Bench(nominal, axis, axis, result, given, nominal.with_name("corrected.xml"), 1)

    def written(bench, out):
        write_corrected(nominal, axis, out)
        runs = bench.run(out)
        write(nominal, axis, out)
        return Faithful("a form", 0.0, (), write_as_author), runs

    monkeypatch.setattr("simgap.judging._write", written)
    monkeypatch.setattr("simgap.judging._polished", lambda bench, form, runs: (form, runs))
    form, runs, found = _author_or_mended(bench, cause)
    assert form.form == "a form"
    assert figures(given.cases, runs).held_out_rms == pytest.approx(SIGMA, rel=0.05)
    assert [f.effect for f in found] == names


@pytest.mark.slow
@pytest.mark.parametrize(("solver", "verdict", "found"), [("", "no_mismatch", []), (STIFF, "parameters_only", ["soft_friction"])])
def test_soft_friction_is_never_called_physics(solver, verdict, found, nominal, tmp_path):
    logs = []
    for seed in (1, 2):
        r = log(text(solver=solver), seed, 8.0)
        logs.append(tmp_path / r.source)
        table = np.column_stack([r.time, r.torque, r.velocity, r.angle])
        np.savetxt(logs[-1], table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="")
    diagnose_files(logs[:1], nominal, tmp_path / "out", logs[1:], Options(jobs=1), progress=False, page=False)
    said = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert said["verdict"] == verdict
    assert [f["effect"] for f in said["findings"]] == found
    assert all(f["class"] == "numerics" for f in said["findings"])
    assert said["fit"]["corrected"]["held_out_rms"] == pytest.approx(SIGMA, rel=0.05)
    cases = cases_of([log(text(solver=solver), 1, 8.0)], [log(text(solver=solver), 2, 8.0)])
    again = figures(cases, run_files([MujocoPlant.load(tmp_path / "out" / "corrected.xml")], cases, 1)[0])
    assert again.held_out_rms == pytest.approx(said["fit"]["corrected"]["held_out_rms"], rel=1e-3)


def test_numbers_do_not_stand_in_for_what_a_file_lacks(nominal, tmp_path):
    """No refit in MuJoCo of a file that lacks a law: simgap's replay, which has it, would be off."""
    out = tmp_path / "corrected.xml"
    axis = load_axis(nominal) + effect_class("position_dependent_friction")(
        torque_Nm=0.1, relative_amplitude=0.5, cycles_per_rev=3.5, phase_rad=0.0
    )
    form = Faithful("stiff settings", 0.0, write_corrected(nominal, axis, out).lacks, write_as_author)
    assert form.lacks
    cases = cases_of([log(text(), 1)], [log(text(), 2)])
    given = compare_nominal(nominal, load_axis(nominal), [c.recording for c in cases[:1]], [cases[1].recording], 1)
    bench = Bench(nominal, load_axis(nominal), axis, None, given, out, 1)
    before = out.read_bytes()
    assert _soft_or_not(bench, form, given.engine) == (form, given.engine)
    assert out.read_bytes() == before


def test_along_an_angle_gravity_follows_it_and_else_the_run(nominal):
    """What differs along the same angle is the numerics of a step, whatever a free run makes of the motion."""
    from diagnose.verdict.reference_start import run_surrogate

    axis = load_axis(nominal)  # a pendulum
    (case,) = cases_of([log(text(), 1, 1.0)], [])
    start = case.start()
    own = run_surrogate(axis, case, start)
    assert own is not None
    along = run_surrogate(axis, case, start, along=own.angle)
    other = run_surrogate(axis, case, start, along=own.angle + 0.5)
    assert along is not None
    assert other is not None
    spread = float(np.std(own.velocity))
    assert np.max(np.abs(along.velocity - own.velocity)) < 0.02 * spread  # held over each sample
    assert np.max(np.abs(other.velocity - own.velocity)) > 0.1 * spread


def test_numbers_that_make_the_file_no_better_are_not_changed(judged):
    result, given = judged
    result = dataclasses.replace(result, verdict=Verdict.PARAMETERS_ONLY, findings=())
    worse = [dataclasses.replace(r, velocity=r.velocity + 0.1 * SIGMA * np.sin(np.arange(len(r.velocity)))) for r in given.runs]
    assert no_better(result, given, given.runs)
    assert no_better(result, given, worse)
    assert not no_better(result, dataclasses.replace(given, runs=worse), given.runs)
    assert no_better(dataclasses.replace(result, verdict=Verdict.UNEXPLAINED), given, worse)
    assert not no_better(dataclasses.replace(result, verdict=Verdict.MISSING_PHYSICS), given, worse)
    far = dataclasses.replace(given, runs=[dataclasses.replace(r, velocity=r.velocity + 3 * SIGMA) for r in given.runs])
    assert no_better(result, far, far.runs), "far from the noise as well"
    assert not no_better(result, far, given.runs)
    kept = by_simulator(result, far, Files(far.runs, (), "as given", stands=True))
    assert kept.verdict is Verdict.UNEXPLAINED
    assert kept.fit["corrected"] == kept.fit["nominal"]
    assert "corrected.xml is the same" in kept.summary
    out = by_simulator(result, given, Files(given.runs, (), "as given", stands=True))
    assert out.verdict is Verdict.NO_MISMATCH
