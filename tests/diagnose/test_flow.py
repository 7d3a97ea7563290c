"""From recordings of known truth to a verdict: nothing is named where nothing is; what is there is named, placed, measured."""

from __future__ import annotations

import csv
import dataclasses
import json
import math
import subprocess
import sys

import numpy as np
import pytest
import scipy.signal
from robot_axis import effect

from diagnose.data.experiment import prepare
from diagnose.evidence.sensor_offset import excluded_by_angle
from diagnose.fit.fitter import Fitter
from diagnose.pipeline import Options, diagnose
from diagnose.problem.choose_view import choose_view, growth_when_held
from diagnose.problem.view import ForceView, MotionView
from diagnose.result import Verdict
from diagnose.structure.candidates import candidates, conflicts
from diagnose.structure.score import screen
from mjsim.effects import registered
from mjsim.errors import InputError
from mjsim.excitation import Cascade, close_loop, trapezoids
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate
from mjsim.recording import Recording
from simgap.pipeline import diagnose_files

COULOMB = effect("coulomb_friction", torque_Nm=0.1)
BACKLASH = effect("backlash", gap_rad=2e-4)
FEW = ("coulomb_friction", "backlash", "hardening_stiffness", "torque_offset", "time_delay", "quadratic_friction")


@pytest.fixture(scope="module")
def with_coulomb(pair):
    """Recordings with Coulomb friction concealed."""
    return pair(COULOMB, seconds=2.0)


def test_nothing_is_named_where_parameters_alone_differ(pair, robot):
    estimation, held_out = pair()
    result = diagnose(robot, [estimation], [held_out], Options(jobs=1))
    assert result.verdict is Verdict.PARAMETERS_ONLY
    assert result.findings == ()
    assert result.linear_parameters["Jm"].value == pytest.approx(4.7e-4, rel=0.02)
    assert result.fit["refitted"].held_out_rms == pytest.approx(0.05, rel=0.05)


def test_nothing_is_found_where_nothing_differs(pair, robot):
    estimation, held_out = pair(changed=False)
    result = diagnose(robot, [estimation], [held_out], Options(jobs=1))
    assert result.verdict is Verdict.NO_MISMATCH
    assert result.findings == ()
    assert math.isnan(result.gap_closed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(11, 18))
def test_no_false_alarm_on_other_noise(pair, robot, seed):
    estimation, held_out = pair(seed=seed)
    result = diagnose(robot, [estimation], [held_out], Options(jobs=1))
    assert result.findings == ()


@pytest.mark.parametrize("effects", [FEW, pytest.param((), marks=pytest.mark.slow)], ids=["few", "all"])
def test_coulomb_friction_is_found(with_coulomb, robot, effects):
    estimation, held_out = with_coulomb
    result = diagnose(robot, [estimation], [held_out], Options(jobs=1, effects=effects))
    assert result.verdict is Verdict.MISSING_PHYSICS
    (finding,) = result.findings
    assert (finding.effect, finding.place, finding.element) == ("coulomb_friction", "motor", "motor")
    estimate = finding.parameters["torque_Nm"]
    assert estimate.value == pytest.approx(0.1, rel=0.03)
    assert estimate.ci95[0] < 0.1 < estimate.ci95[1]
    assert estimate.unit == "N m"
    evidence = finding.evidence
    assert evidence["held_out_error_after"] == pytest.approx(0.05, rel=0.05)
    assert evidence["held_out_error_before"] > 5 * evidence["held_out_error_after"]
    assert evidence["p_value"] < 1e-3
    assert result.gap_closed > 0.97


@pytest.mark.slow
def test_the_answer_does_not_depend_on_the_number_of_threads(with_coulomb, robot):
    estimation, held_out = with_coulomb
    one, two = (diagnose(robot, [estimation], [held_out], Options(jobs=jobs, effects=FEW)) for jobs in (1, 2))

    def answer(result):
        said = result.as_dict()
        del said["seconds"]
        return said

    assert json.dumps(answer(one), default=float) == json.dumps(answer(two), default=float)


@pytest.mark.slow
def test_backlash_is_found(pair, robot):
    estimation, held_out = pair(BACKLASH)
    result = diagnose(robot, [estimation], [held_out], Options(jobs=1, effects=FEW))
    assert result.verdict is Verdict.MISSING_PHYSICS
    (finding,) = result.findings
    assert (finding.effect, finding.place) == ("backlash", "gearbox")
    assert finding.element == "gearbox"
    assert finding.parameters["gap_rad"].value == pytest.approx(2e-4, rel=0.03)


@pytest.mark.slow
def test_a_transmission_error_is_found(pair, robot):
    estimation, held_out = pair(effect("transmission_error", amplitude_rad=2e-4, cycles_per_rev=4.0, phase_rad=0.5), seconds=4.0)
    result = diagnose(robot, [estimation], [held_out], Options(jobs=1, effects=(*FEW, "transmission_error")))
    (finding,) = result.findings
    assert (finding.effect, finding.place) == ("transmission_error", "gearbox")
    assert finding.parameters["amplitude_rad"].value == pytest.approx(2e-4, rel=0.03)
    assert finding.parameters["cycles_per_rev"].value == pytest.approx(4.0, rel=0.01)


@pytest.mark.slow  # a pair is found in test_search.py
def test_two_effects_are_told_apart(pair, robot):
    delay = effect("time_delay", place="actuator", delay_s=2e-3)
    estimation, held_out = pair(COULOMB, delay)
    result = diagnose(robot, [estimation], [held_out], Options(jobs=1, effects=FEW))
    assert {f.effect for f in result.findings} == {"coulomb_friction", "time_delay"}
    found = {f.effect: f for f in result.findings}
    assert found["coulomb_friction"].parameters["torque_Nm"].value == pytest.approx(0.1, rel=0.03)
    assert found["time_delay"].parameters["delay_s"].value == pytest.approx(2e-3, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("torque", [0.05, 0.3])
def test_what_no_candidate_explains_is_said_to_be_unexplained(pair, robot, torque):
    """Friction is concealed and no friction may be named: structure remains, and is said to."""
    estimation, held_out = pair(effect("coulomb_friction", torque_Nm=torque), seconds=2.5)
    result = diagnose(robot, [estimation], [held_out], Options(jobs=1, effects=("sensor_offset",)))
    assert result.verdict is Verdict.UNEXPLAINED
    assert "structure remains" in result.summary
    assert result.findings == ()


def test_the_screen_ranks_the_truth_first(with_coulomb, robot):
    estimation, held_out = with_coulomb
    fitter = Fitter(robot, MotionView(), (prepare(estimation),), (prepare(held_out),), 1)
    base = fitter.fit(fitter.hypothesis(()))
    ranked = screen(fitter, base, candidates(fitter))
    assert ranked[0].gain >= ranked[-1].gain
    assert "friction" in ranked[0].candidate.id
    assert ranked[0].gain > 0.5 * base.chi2, "a linear model of the response takes most of the mismatch"


def test_candidates_are_what_the_chain_offers(with_coulomb, robot):
    estimation, held_out = with_coulomb
    fitter = Fitter(robot, MotionView(), (prepare(estimation),), (prepare(held_out),), 1)
    offered = {c.key for c in candidates(fitter)}
    position_locked = {n for n, c in registered().items() if not c.starts(fitter.scales[c.places[0]])}
    of_servos = {n for n, c in registered().items() if c.family == "servo"}
    of_rigid = {n for n, c in registered().items() if c.rigid}
    none = position_locked | of_servos | of_rigid
    assert offered == {f"{n}@{p}" for n, c in registered().items() for p in c.places if n not in none}
    refined = next(c for c in candidates(fitter) if c.id == "stribeck_friction")
    assert conflicts(refined, (COULOMB,))
    assert not conflicts(refined, (BACKLASH,))
    with pytest.raises(KeyError, match="choose from"):
        candidates(fitter, ("warp_drive",))


@pytest.mark.slow
def test_without_a_held_out_recording_blocks_are_held_out(record, robot):
    result = diagnose(robot, [record(COULOMB, seconds=4.0)], (), Options(jobs=1, effects=FEW))
    (finding,) = result.findings
    assert finding.effect == "coulomb_friction"
    assert {r["role"] for r in result.recordings} == {"estimation", "held-out"}


def slide(friction, seed, speed):
    """A recording of the EMPS slide under a position loop: angle in steps of 5e-8 m, 0.5 N of noise on the force."""
    axis = load_axis(shipped_model("emps")).with_linear({"Jm": 97.0, "fm": 205.0}) + friction
    reference = trapezoids(12.0, 1e-3, speed, 0.4, 0.6, 0.1)
    force = close_loop(axis, reference, 1e-3, Cascade(160.0, 8000.0, 0.0, 1000.0))
    run = simulate(axis, force, 1e-3)
    rng = np.random.default_rng(seed)
    logged = force + 0.5 * rng.standard_normal(len(force))
    return Recording(run.time, logged, None, 5e-8 * np.round(run.angle / 5e-8), 1e-3, source=f"slide_{seed}.csv", loop="closed")


@pytest.mark.slow
def test_asymmetric_friction_of_a_slide_judged_by_force():
    friction = effect("asymmetric_friction", torque_Nm=20.0, asymmetry_Nm=3.0)
    axis = load_axis(shipped_model("emps"))
    laws = ("coulomb_friction", "asymmetric_friction", "stribeck_friction", "torque_offset")
    result = diagnose(axis, [slide(friction, 0, 0.1)], [slide(friction, 1, 0.07)], Options(jobs=1, effects=laws))
    assert result.view.startswith("force")
    assert result.unit == "N"
    assert result.verdict is Verdict.MISSING_PHYSICS
    (finding,) = result.findings
    assert (finding.effect, finding.place, finding.element) == ("asymmetric_friction", "motor", "carriage")
    assert finding.parameters["torque_Nm"].unit == "N"
    assert finding.parameters["torque_Nm"].value == pytest.approx(20.0, rel=0.02)
    assert finding.parameters["asymmetry_Nm"].value == pytest.approx(3.0, rel=0.03)
    assert result.linear_parameters["Jm"].value == pytest.approx(97.0, rel=0.02)
    assert result.linear_parameters["fm"].value == pytest.approx(205.0, rel=0.03)


@pytest.mark.parametrize("judge", ["motion", "force"])
def test_a_torque_of_the_other_sign_is_said_to_be_one(judge):
    axis = load_axis(shipped_model("emps"))
    force = 100.0 * np.sign(np.sin(np.arange(4000) * 1e-3 * 2 * np.pi))
    run = simulate(axis, force, 1e-3)
    flipped = Recording(run.time, -force, run.velocity, run.angle, 1e-3, source="flipped.csv")
    with pytest.raises(InputError, match=r"flipped\.csv: the axis moves against its torque"):
        diagnose(axis, [flipped], options=Options(jobs=1, judge=judge))


def test_the_view_is_chosen_by_what_is_asked_bound_or_recorded(record):
    r = record(seconds=1.0)
    assert isinstance(choose_view([r], None), MotionView)
    assert isinstance(choose_view([r], "force"), ForceView)
    angle_only = Recording(r.time, r.torque, None, r.angle, r.dt)
    assert isinstance(choose_view([angle_only], None), ForceView)
    assert isinstance(choose_view([Recording(r.time, r.torque, r.velocity, r.angle, r.dt, judge="force")], None), ForceView)


def test_a_mechanism_that_swings_up_when_its_motor_is_held_is_judged_by_motion(record, robot):
    """The published gearbox has negative damping: moved as recorded for some seconds, it needs any torque whatever."""
    r = record(seconds=3.0)
    angle_only = Recording(r.time, r.torque, None, r.angle, r.dt)
    assert growth_when_held(robot) == pytest.approx(1.5968, rel=1e-3)
    assert isinstance(choose_view([angle_only], None, robot), MotionView)
    with pytest.raises(InputError, match=r"swings up by 1\.6 1/s"):
        choose_view([angle_only], "force", robot)
    damped = robot.with_linear({"dg": 62.0})
    assert growth_when_held(damped) < 0
    assert isinstance(choose_view([angle_only], None, damped), ForceView)


@pytest.mark.slow
def test_a_position_alone_will_do(pair, record, robot):
    """Its differences are judged, averaged as the measured ones are, and weighed by the noise that they make of the angle's."""
    alone = [dataclasses.replace(record(seed=seed), velocity=None) for seed in range(8)]
    assert np.mean([prepare(r).sigma for r in alone]) == pytest.approx(1e-4 / (math.sqrt(2) * alone[0].dt), rel=0.03)
    for hidden, expected in (((), []), ((COULOMB,), ["coulomb_friction"])):
        first, other = (dataclasses.replace(r, velocity=None) for r in pair(*hidden))
        result = diagnose(robot, [first], [other], Options(jobs=1, effects=FEW))
        assert [f.effect for f in result.findings] == expected
        if expected:
            assert result.findings[0].parameters["torque_Nm"].value == pytest.approx(0.1, rel=0.02)


def write(path, r):
    with path.open("w", newline="", encoding="utf-8") as handle:
        rows = csv.writer(handle)
        rows.writerow(["time_s", "torque_Nm", "velocity_rad_s", "angle_rad"])
        rows.writerows(zip(r.time, r.torque, r.velocity, r.angle, strict=True))
    return path


def number(value, *, null=False):
    assert (value is None and null) or isinstance(value, int | float), value


def check_estimate(e):
    assert {"value", "ci95", "unit"} <= set(e)
    number(e["value"])
    assert len(e["ci95"]) == 2
    assert isinstance(e["unit"], str)


def check_contract(said):
    """Every key of diagnosis.json that the contract names, with its kind."""
    assert said["verdict"] in {"no_mismatch", "parameters_only", "missing_physics", "unexplained"}
    if said["verdict"] in ("no_mismatch", "parameters_only"):
        assert said["findings"] == []
    for f in said["findings"]:
        assert f["effect"] in registered()
        assert f["place"] in {"motor", "gearbox", "arm", "actuator", "sensor"}
        assert f["element"]
        assert f["sentence"].endswith(".")
        for e in f["parameters"].values():
            check_estimate(e)
        assert {"held_out_error_before", "held_out_error_after", "p_value"} <= set(f["evidence"])
        for value in f["evidence"].values():
            number(value)
        assert set(f["equivalents"]) <= set(registered()) | {f"{n}@{p}" for n, c in registered().items() for p in c.places}
    assert {"time", "frequency", "state"} <= set(said["mismatch"])
    for axis in ("time", "frequency", "state"):
        assert isinstance(said["mismatch"][axis], list)
        for interval in said["mismatch"][axis]:
            number(interval["share"])
    for e in said["linear_parameters"].values():
        check_estimate(e)
    for model in ("nominal", "refitted", "corrected"):
        assert {"rms", "nrmse", "held_out_rms", "held_out_nrmse"} <= set(said["fit"][model])
    number(said["fit"]["noise_floor"]["rms"], null=True)
    assert said["next_experiment"] is None or isinstance(said["next_experiment"], str)
    assert isinstance(said["seed"], int)
    assert {"python", "simgap", "mujoco"} <= set(said["versions"])
    for r in said["recordings"]:
        assert len(r["sha256"]) == 64
        assert r["file"]
    number(said["seconds"])


def test_files_in_a_folder_with_the_contracts_json_out(pair, tmp_path):
    estimation, held_out = pair(COULOMB, seconds=1.0)
    one, two = write(tmp_path / "log.csv", estimation), write(tmp_path / "other.csv", held_out)
    out = tmp_path / "report"
    result = diagnose_files([one], shipped_model("robot_axis1"), out, [two], Options(jobs=1, effects=FEW, seed=5), progress=False)
    assert {p.name for p in out.iterdir()} == {"corrected.xml", "diagnosis.json", "report.html"}
    said = json.loads((out / "diagnosis.json").read_text())
    check_contract(said)
    assert said["seed"] == 5
    assert [r["file"] for r in said["recordings"]] == ["log.csv", "other.csv"]
    assert said["findings"][0]["effect"] == "coulomb_friction"
    corrected = load_axis(out / "corrected.xml")
    assert corrected.effects[0].values["torque_Nm"] == pytest.approx(result.findings[0].parameters["torque_Nm"].value)
    run = simulate(corrected, held_out.torque, held_out.dt)
    assert np.std(run.velocity - held_out.velocity) == pytest.approx(said["fit"]["corrected"]["held_out_rms"], rel=0.01)


@pytest.mark.slow
def test_a_command_loads_neither_scipy_signal_nor_scipy_stats(pair, tmp_path):
    """They take half a second to load, and a second core is of no help."""
    one, two = (write(tmp_path / f"{name}.csv", r) for name, r in zip("ab", pair(COULOMB, seconds=0.5), strict=True))
    files = [one, "--held-out", two, "--model", shipped_model("robot_axis1"), "--out", tmp_path / "out"]
    call = ["diagnose", *files, "--effects", "coulomb_friction", "--jobs", "2", "--json", "--quiet"]
    code = (
        "import sys; from simgap.cli import main\ntry: main()\n"
        "finally: print(*(m for m in ('scipy.signal', 'scipy.stats') if m in sys.modules), file=sys.stderr)"
    )
    ended = subprocess.run([sys.executable, "-c", code, *map(str, call)], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["verdict"] == "missing_physics"
    assert not ended.stderr.split()


@pytest.mark.slow
def test_a_ripple_is_found_without_an_angle_channel(pair, robot):
    """The orders are then looked for over the integral of the velocity."""
    ripple = effect("torque_ripple", amplitude_Nm=0.04, cycles_per_rev=6.3, phase_rad=0.5)
    estimation, held_out = (dataclasses.replace(r, angle=None) for r in pair(ripple, seconds=4.0))
    result = diagnose(robot, [estimation], [held_out], Options(jobs=1, effects=(*FEW, "torque_ripple")))
    (finding,) = result.findings
    assert (finding.effect, finding.place) == ("torque_ripple", "motor")
    assert finding.parameters["cycles_per_rev"].value == pytest.approx(6.3, rel=0.01)
    assert finding.parameters["amplitude_Nm"].value == pytest.approx(0.04, rel=0.05)


def test_what_the_angle_says_of_an_offset(pair, record):
    """A velocity that drifts from the angle has an offset; beside it the torque may have one as well, and not in its place."""
    sound, off = record(), record(effect("sensor_offset", place="sensor", value=0.4))
    assert excluded_by_angle([prepare(sound)]) == {"sensor_offset": ""}
    assert excluded_by_angle([prepare(off)]) == {"torque_offset": "sensor_offset"}
    assert excluded_by_angle([prepare(sound), prepare(off)]) == {}
    assert excluded_by_angle([prepare(dataclasses.replace(off, angle=None))]) == {}


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(s, marks=pytest.mark.slow) for s in range(2, 8))])
def test_slow_noise_of_the_velocity_is_no_offset(record, seed):
    """Its mean was judged as that of white noise: in every second recording the sensor seemed to have an offset."""
    noise = scipy.signal.lfilter([1.0], [1.0, -0.95], 0.02 * np.random.default_rng(seed).standard_normal(20_000))
    quiet = record(noise=0.0, seconds=10.0)
    noisy = dataclasses.replace(quiet, velocity=quiet.velocity + noise)
    assert excluded_by_angle([prepare(noisy)]) == {"sensor_offset": ""}
    drifting = dataclasses.replace(noisy, velocity=noisy.velocity + 0.2)
    assert excluded_by_angle([prepare(drifting)]) == {"torque_offset": "sensor_offset"}


@pytest.mark.slow
def test_what_only_the_held_out_recording_exercises_is_sought_in_all(robot, record):
    """A spring that hardens: at a tenth of the torque it does nothing that the fitted recording could show."""
    hardening = effect("hardening_stiffness", place="arm", coefficient_Nm_rad3=2e9)
    quiet, loud = record(hardening, amplitude=0.1, seconds=2.0), record(hardening, amplitude=1.2, seed=1, seconds=2.0)
    result = diagnose(robot, [quiet], [loud], Options(jobs=1, effects=("hardening_stiffness",)))
    assert result.verdict is Verdict.MISSING_PHYSICS
    assert [(f.effect, f.place) for f in result.findings] == [("hardening_stiffness", "arm")]
    assert result.notes[0].startswith("The estimation recordings fit without it")
    assert {r["role"] for r in result.recordings if r["file"] == loud.source} == {"estimation", "held-out"}


@pytest.mark.slow
def test_viscous_friction_that_the_nominal_model_has_not_is_named(robot, pair):
    """Bearings of the arm; where the nominal model has them it is one of its parameters, and no missing physics."""
    chain = robot.chain
    arm = dataclasses.replace(chain.bodies[-1], viscous=150.0)
    damped = dataclasses.replace(robot, chain=dataclasses.replace(chain, bodies=(*chain.bodies[:-1], arm)))
    only = Options(jobs=2, effects=("viscous_friction", "coulomb_friction", "extra_flexible_mode"))
    result = diagnose(robot, *([r] for r in pair(axis=damped)), only)
    assert [(f.effect, f.place) for f in result.findings] == [("viscous_friction", "arm")]
    assert result.findings[0].parameters["coefficient_Nms_rad"].value == pytest.approx(150.0, rel=0.1)
    known = diagnose(damped, *([r] for r in pair(axis=damped)), only)
    assert known.verdict is Verdict.NO_MISMATCH
