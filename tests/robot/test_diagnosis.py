"""Diagnosis of robots from logs of a plant that shares no code with it."""

from __future__ import annotations

import dataclasses
import json
import re

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

from diagnose.result import Verdict
from diagnose.robot.laws import identifiers
from diagnose.robot.motion import derivative, prepare
from diagnose.robot.options import RobotOptions
from diagnose.robot.physical import consistent, physical
from diagnose.robot.pipeline import diagnose_robot
from diagnose.robot.problem import Term, build
from diagnose.robot.solve import covariance, held_out, solve, weigh
from diagnose.robot.state import Selection, screen
from lab.robot import cases
from lab.robot.arm import three_axes
from lab.robot.cases import Case, draw, write_log
from mjsim.errors import CheckError, InputError
from mjsim.robot.model import load_robot, robot_from
from mjsim.robot.recording import load_robot_recording
from mjsim.robot.write import carried_effects
from simgap.commands.gate import command as gate
from simgap.commands.replay import command as replay
from simgap.robot import LATE, diagnose_robot_files, is_robot
from tests.commands import refused

LAWS = ("coulomb_friction", "torque_offset", "quadratic_friction", "load_dependent_friction")


def friction(level, joint):
    return cases.Law("coulomb_friction", joint, {"torque_Nm": level}, lambda q, v, T, t: level * np.sign(v))


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """``case(*laws, true=arm)``: a folder with the nominal three-joint arm and two logs of the true one."""

    def make(*laws, true=None, seed=77):
        folder = tmp_path_factory.mktemp("case")
        arm = three_axes()
        concealed = Case("single", seed, arm, true or arm, laws, ())
        (folder / "arm.xml").write_text(arm.mjcf("arm"))
        for index, name in enumerate(("a.csv", "b.csv")):
            write_log(concealed, folder / name, index)
        return folder

    return make


@pytest.fixture(scope="module")
def plain(case):
    """The folder of an arm that is as its model."""
    return case()


@pytest.fixture(scope="module")
def rubbed(case):
    """The folder of an arm with dry friction at the second joint."""
    return case(friction(0.8, 1))


@pytest.fixture(scope="module")
def rubbing(rubbed):
    """Dry friction at the second joint, and its diagnosis among a few laws."""
    log, held_out, model = (rubbed / name for name in ("a.csv", "b.csv", "arm.xml"))
    return rubbed, diagnose_robot_files([log], model, rubbed / "out", [held_out], RobotOptions(effects=LAWS))


def test_dry_friction_is_named_at_its_joint_and_nowhere_else(rubbing):
    _, d = rubbing
    assert d.verdict is Verdict.MISSING_PHYSICS
    assert [(f.effect, f.joint) for f in d.findings] == [("coulomb_friction", "joint2")]
    e = d.findings[0].parameters["torque_Nm"]
    assert e.ci95[0] < 0.8 < e.ci95[1]
    assert e.ci95[1] - e.ci95[0] < 0.05 * e.value
    assert d.joints["joint1"].verdict is Verdict.NO_MISMATCH


def test_the_corrected_file_does_it_in_plain_mujoco(rubbing):
    folder, d = rubbing
    model = mujoco.MjModel.from_xml_path(str(folder / "out" / "corrected.xml"))
    assert model.dof_frictionloss[1] == pytest.approx(0.8, rel=0.01)
    assert model.dof_frictionloss[0] == 0
    fit = d.joints["joint2"].fit
    assert fit["corrected"].held_out_rms < 0.2 * fit["nominal"].held_out_rms
    assert fit["surrogate"].held_out_rms < 0.2 * fit["nominal"].held_out_rms
    assert carried_effects(folder / "out" / "corrected.xml") == []
    rows = d.closed_loop["joints"]["joint2"]  # the torque that a tracking loop has to give beside the logged ones
    assert [r["role"] for r in rows] == ["estimation", "held-out"]
    assert all(r["corrected_rms"] < 0.1 * r["nominal_rms"] for r in rows)


def test_a_robot_is_replayed_with_what_its_file_carries(rubbing, tmp_path):
    folder, _ = rubbing
    out = tmp_path / "prediction.csv"
    found = CliRunner().invoke(replay, [str(folder / "out/corrected.xml"), str(folder / "b.csv"), "--out", str(out), "--json"])
    assert found.exit_code == 0, found.output
    told = json.loads(found.output)
    assert set(told["joints"]) == {"joint1", "joint2", "joint3"}
    assert told["fit_percent"] > 99
    assert "joint2.tracking_Nm" in out.read_text().splitlines()[0]


def test_a_robot_is_replayed_with_the_hold_that_its_diagnosis_took(rubbing, tmp_path):
    folder, _ = rubbing
    beside = tmp_path / "corrected.xml"
    beside.write_bytes((folder / "out/corrected.xml").read_bytes())
    told = json.loads((folder / "out/diagnosis.json").read_text())
    for row in told["recordings"]:
        assert row["hold"] != "mean"
        row["hold"] = "mean"
    (tmp_path / "diagnosis.json").write_text(json.dumps(told))
    (tmp_path / "b.csv").write_bytes((folder / "b.csv").read_bytes())
    bound = (folder / "b.toml").read_text()
    (tmp_path / "b.toml").write_text("".join(line for line in bound.splitlines(True) if not line.startswith("hold")))
    found = CliRunner().invoke(replay, [str(beside), str(tmp_path / "b.csv"), "--out", str(tmp_path / "p.csv")])
    assert found.exit_code == 0, found.exception
    assert "as in the diagnosis of this recording: mean" in found.stdout


def test_a_gate_passes_the_files_of_a_diagnosis_and_stops_a_worse_one(rubbing, tmp_path):
    folder, _ = rubbing

    def gated(model, against):
        words = [str(model), str(folder / "a.csv"), str(folder / "b.csv"), "--baseline", str(folder / "out/diagnosis.json")]
        return CliRunner().invoke(gate, [*words, "--against", against, "--json"])

    for model, against in ((folder / "arm.xml", "nominal"), (folder / "out/corrected.xml", "corrected")):
        ended = gated(model, against)
        assert ended.exit_code == 0, ended.exception
        checks = json.loads(ended.stdout)["checks"]
        assert {(c["joint"], c["role"]) for c in checks} == {
            (f"joint{k}", role) for k in (1, 2, 3) for role in ("estimation", "held-out")
        }
        assert [c["ratio"] for c in checks] == pytest.approx([1.0] * 6, abs=1e-6)
        assert {c["unit"] for c in checks} == {"N m"}
    worse = tmp_path / "worse.xml"
    worse.write_text(re.sub(r'frictionloss="[^"]*"', 'frictionloss="0.1"', (folder / "out/corrected.xml").read_text()))
    ended = gated(worse, "corrected")
    assert isinstance(ended.exception, CheckError)
    assert {c["joint"] for c in json.loads(ended.stdout)["checks"] if c["grew"]} >= {"joint2"}


def test_the_folder_holds_what_the_contract_says(rubbing):
    folder, _ = rubbing
    told = json.loads((folder / "out" / "diagnosis.json").read_text())
    assert told["verdict"] == "missing_physics"
    (finding,) = told["findings"]
    assert finding["joint"] == "joint2"
    assert finding["element"] == "joint2"
    assert set(finding["parameters"]["torque_Nm"]) == {"value", "ci95", "unit"}
    assert finding["evidence"]["p_value"] < 0.01
    assert set(told["joints"]) == {"joint1", "joint2", "joint3"}
    for joint in told["joints"].values():
        assert {"verdict", "findings", "fit", "linear_parameters"} <= set(joint)
        assert {"nominal", "refitted", "corrected", "surrogate"} == set(joint["fit"])
    conditioning = told["conditioning"]
    assert conditioning["numbers"] == len(told["nominal_parameters"])
    assert len(told["base_parameters"]) <= conditioning["rank"] < conditioning["numbers"]
    assert len(conditioning["undetermined"]) == conditioning["numbers"] - conditioning["rank"]
    assert [r["role"] for r in told["recordings"]] == ["estimation", "held-out"]
    page = (folder / "out" / "report.html").read_text()
    assert "Coulomb friction" in page
    assert "default-src 'none'" in page  # it loads nothing
    page = re.sub(r"<script.*?</script>", "", page, flags=re.S)
    assert not re.search(r"(?:src|href)=\"(?!#|data:)", page)
    assert "&lt;" not in page  # markup that was escaped


@pytest.mark.slow
def test_a_payload_is_a_number_and_no_physics(case, tmp_path):
    folder = case(true=three_axes().with_payload(0.8, (0.2, 0.01, 0.02)))
    d = diagnose_robot_files(
        [folder / "a.csv"], folder / "arm.xml", tmp_path, [folder / "b.csv"], RobotOptions(effects=LAWS), page=False
    )
    assert d.verdict is Verdict.PARAMETERS_ONLY
    assert not d.findings
    assert any("forearm" in line for line in d.changed)
    mass = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml")).body_mass
    assert mass[3] == pytest.approx(2.4, rel=0.2)


@pytest.mark.slow
def test_what_mjcf_has_no_element_for_is_carried(case, tmp_path):
    offset = cases.Law("torque_offset", 2, {}, lambda q, v, T, t: np.full(len(q), -0.4))
    folder = case(offset)
    d = diagnose_robot_files(
        [folder / "a.csv"], folder / "arm.xml", tmp_path, [folder / "b.csv"], RobotOptions(effects=LAWS), page=False
    )
    assert [(f.effect, f.joint) for f in d.findings] == [("torque_offset", "joint3")]
    (kept,) = carried_effects(tmp_path / "corrected.xml")
    assert kept["joint"] == "joint3"
    assert kept["parameters"]["torque_Nm"] == pytest.approx(0.4, rel=0.01)


def test_blocks_are_held_out_where_there_is_no_other_recording(plain):
    robot = load_robot(plain / "arm.xml")
    r = load_robot_recording(plain / "a.csv", robot)
    m = prepare(robot, r, r.joints, 15.0, split=True)
    assert m.held.mean() == pytest.approx(0.3, abs=0.02)
    d = diagnose_robot(robot, [r], options=RobotOptions(effects=LAWS)).diagnosis
    assert d.verdict is Verdict.NO_MISMATCH


def test_the_budget_of_time_ends_the_search(rubbing):
    folder, whole = rubbing
    options = RobotOptions(effects=LAWS, until=0.0)
    d = diagnose_robot_files([folder / "a.csv"], folder / "arm.xml", folder / "late", [folder / "b.csv"], options, page=False)
    assert not d.findings
    assert LATE in d.notes
    assert LATE not in whole.notes


@pytest.mark.parametrize("rows", [2, 15])
def test_a_log_of_few_rows_is_refused(simgap, plain, rows):
    """Fewer samples than the low-pass of the check needs."""
    short = plain / f"short{rows}.csv"
    short.write_text("".join((plain / "a.csv").read_text().splitlines(keepends=True)[: rows + 1]))
    for words in (("check",), ("diagnose", "--out", "out", "--quiet")):
        refused(simgap(words[0], str(short), "--model", str(plain / "arm.xml"), *words[1:]), f"{rows} samples", "more than 15")


def test_joints_are_chosen_by_name(plain):
    robot = load_robot(plain / "arm.xml")
    r = load_robot_recording(plain / "a.csv", robot)
    with pytest.raises(InputError, match="'elbow' is not in the model"):
        diagnose_robot(robot, [r], options=RobotOptions(joints=("elbow",)))
    still = dataclasses.replace(r, angle=np.column_stack([r.angle[:, 0], np.zeros((len(r), 2))]))
    with pytest.raises(InputError, match="'joint2' does not move"):
        diagnose_robot(robot, [still], options=RobotOptions(joints=("joint2",)))
    with pytest.raises(InputError, match="no joint has a torque"):
        diagnose_robot(robot, [dataclasses.replace(r, torque=None)])


def test_links_are_kept_physical(plain):
    """Of a log whose torques no robot gives, the least-squares links are no bodies; the nearest ones that are, are found."""
    robot = load_robot(plain / "arm.xml")
    r = load_robot_recording(plain / "a.csv", robot)
    turned = dataclasses.replace(r, torque=-0.5 * r.torque)
    p = build(robot, [prepare(robot, turned, r.joints, 15.0, split=True)], [0, 1, 2], LAWS)
    weights, free = weigh(p, (), p.rows(p.nominal))
    assert not consistent(p, free.theta)
    held = physical(p, free, weights)
    assert consistent(p, held.theta)
    # it is the least: no step towards the free solution or the nominal that stays physical costs less
    cost = [_cost(p, weights, held.theta)]
    for towards in (free.theta, p.nominal):
        step = held.theta + 1e-3 * (towards - held.theta)
        if consistent(p, step):
            cost.append(_cost(p, weights, step))
    assert min(cost) >= cost[0] - 0.2


@pytest.mark.parametrize("strength", [1e12, 1e18, 1e24])
def test_laws_are_screened_where_a_link_is_at_the_wall_of_the_barrier(rubbed, strength):
    """The barrier's curvature is of low rank and many orders above all else; dry friction still promises most."""
    robot = load_robot(rubbed / "arm.xml")
    r = load_robot_recording(rubbed / "a.csv", robot)
    p = build(robot, [prepare(robot, r, r.joints, 15.0, split=True)], [0, 1, 2], LAWS)
    rows = p.rows(p.nominal)
    weights, free = weigh(p, (), rows)
    normals = np.random.default_rng(3).standard_normal((2, 10))
    stiffness = np.zeros((len(p.names), len(p.names)))
    stiffness[:10, :10] = strength * normals.T @ normals
    s = Selection(p, RobotOptions(), rows, weights, dataclasses.replace(free, stiffness=stiffness))
    promised = screen(s, s.solution, 1)
    assert np.all(np.isfinite([gain for gain, _ in promised]))
    assert promised[0][1].law.id == "coulomb_friction"


@pytest.mark.parametrize(
    ("turned", "surer"),
    [
        (-5.0, 1.0),
        pytest.param(-2.0, 30.0, marks=pytest.mark.slow),
        pytest.param(-0.5, 1e3, marks=pytest.mark.slow),
        (-0.02, 1e3),
    ],
)
def test_torques_that_no_robot_gives_leave_bodies_and_finite_promises(plain, turned, surer):
    """Links are pushed to the wall of the barrier; surer: factor of the weights of all rows."""
    robot = load_robot(plain / "arm.xml")
    r = load_robot_recording(plain / "a.csv", robot)
    other = dataclasses.replace(r, torque=turned * r.torque)
    p = build(robot, [prepare(robot, other, r.joints, 15.0, split=True)], [0, 1, 2], LAWS)
    rows = p.rows(p.nominal)
    weights, free = weigh(p, (), rows)
    weights = {j: surer * w for j, w in weights.items()}
    held = physical(p, free, weights)
    assert consistent(p, held.theta)
    s = Selection(p, RobotOptions(), rows, weights, held)
    assert np.all(np.isfinite([gain for j in p.joints for gain, _ in screen(s, held, j)]))


def _cost(p, weights, theta):
    x = (theta - p.nominal) / p.scale
    return float(x @ x) + sum(weights[j] ** 2 * float(np.sum((p.fitted[j].y - p.grams[j][0] @ x) ** 2)) for j in p.joints)


def test_columns_are_filtered_as_the_torque_is(rubbed):
    """Without noise and with the true laws the residual is that of the filter alone."""
    robot = load_robot(rubbed / "arm.xml")
    r = load_robot_recording(rubbed / "a.csv", robot)
    p = build(robot, [prepare(robot, r, r.joints, 12.0, split=True)], [0, 1, 2], LAWS)
    rows = p.rows(p.nominal)
    term = Term(1, next(law for law in p.laws[1] if law.id == "coulomb_friction"), 0.0)
    weights, s = weigh(p, (term,), rows)
    assert s.coefficients[0][0] == pytest.approx(0.8, rel=5e-3)
    assert held_out(p, s, weights, 1).nrmse < 0.01
    without = solve(p, (), weights, rows)
    assert held_out(p, without, weights, 1).nrmse > 5 * held_out(p, s, weights, 1).nrmse


def test_derivatives_are_those_of_a_sine():
    t = 0.01 * np.arange(400)
    x = np.sin(2 * np.pi * 5 * t)[:, None]
    inner = slice(10, -10)
    w = 2 * np.pi * 5
    np.testing.assert_allclose(derivative(x, 0.01)[inner, 0], w * np.cos(w * t)[inner], rtol=1e-5, atol=1e-4 * w)
    np.testing.assert_allclose(derivative(x, 0.01, second=True)[inner], -(w**2) * x[inner], rtol=1e-5, atol=1e-4 * w**2)


def test_several_driven_joints_make_a_robot(plain, tmp_path):
    assert is_robot([plain / "a.csv"], plain / "arm.xml")
    one = tmp_path / "one.csv"
    one.write_text("time_s,torque_Nm,velocity_rad_s\n0,0,0\n")
    axis = tmp_path / "axis.xml"
    axis.write_text(
        '<mujoco><worldbody><body><joint name="a"/><geom size=".1"/></body></worldbody>'
        '<actuator><motor joint="a"/></actuator></mujoco>'
    )
    assert not is_robot([one], axis)
    axis.write_text(axis.read_text().replace('<motor joint="a"/>', ""))
    assert not is_robot([one], axis)
    assert is_robot([plain / "a.csv"], axis)


def test_the_cases_are_the_same_for_a_seed(tmp_path):
    logs = []
    for name in ("x.csv", "y.csv"):
        write_log(draw(5, "single", 3), tmp_path / name, 0)
        logs.append((tmp_path / name).read_bytes())
    assert logs[0] == logs[1]
    robot = robot_from(mujoco.MjModel.from_xml_string(three_axes().mjcf("arm")))
    r = load_robot_recording(tmp_path / "x.csv", robot)
    assert np.all(np.abs(r.angle) <= [link.limit for link in three_axes().links])
    assert r.hold == "linear"


def test_the_identifiers_are_those_of_the_contract():
    assert {"coulomb_friction", "load_dependent_friction", "coupled_transmission", "cable_torque"} <= set(identifiers())


@pytest.mark.slow
def test_quadratic_friction_is_written_natively(case, tmp_path):
    drag = cases.Law("quadratic_friction", 0, {}, lambda q, v, T, t: 0.2 * v * np.abs(v))
    folder = case(drag)
    d = diagnose_robot_files(
        [folder / "a.csv"], folder / "arm.xml", tmp_path, [folder / "b.csv"], RobotOptions(effects=LAWS), page=False
    )
    assert [(f.effect, f.joint) for f in d.findings] == [("quadratic_friction", "joint1")]
    assert d.joints["joint1"].fit["corrected"].held_out_rms < 1.1 * d.joints["joint1"].fit["surrogate"].held_out_rms
    assert carried_effects(tmp_path / "corrected.xml") == []


def test_standard_errors_are_the_spread_over_noise(case):
    """Of an offset, which lies at frequencies from which least squares takes most of the noise out of the residual."""
    offset = cases.Law("torque_offset", 2, {}, lambda q, v, T, t: np.full(len(q), 0.3))
    folder = case(offset)
    robot = load_robot(folder / "arm.xml")
    r = load_robot_recording(folder / "a.csv", robot)
    rng = np.random.default_rng(5)
    values, errors = [], []
    for _ in range(16):
        noise = 0.02 * np.std(r.torque, axis=0) * rng.standard_normal(r.torque.shape)
        motion = prepare(robot, dataclasses.replace(r, torque=r.torque + noise), r.joints, 15.0)
        p = build(robot, [motion], [0, 1, 2], ("torque_offset",))
        rows = p.rows(p.nominal)
        weights, s = weigh(p, (Term(2, p.laws[2][0], 0.0),), rows)
        V, (own,) = covariance(p, s, weights, rows)
        values.append(s.coefficients[0][0])
        errors.append(float(np.sqrt(V[own, own][0, 0])))
    # the standard deviation of 16 draws is within 0.55 and 1.5 of the true one at 99.8 % (chi-square of 15)
    assert 0.55 < np.std(values, ddof=1) / np.mean(errors) < 1.5
    assert abs(np.mean(values) - 0.3) < 4 * np.mean(errors) / 4
