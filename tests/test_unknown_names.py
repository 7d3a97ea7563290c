"""A name that is not known is told with the nearest one that is, in one line with exit code 2, wherever it stands."""

from __future__ import annotations

from pathlib import Path

import pytest

import simgap


@pytest.mark.parametrize(
    ("words", "nearest"),
    [
        (("diagnoze",), "'diagnose'"),
        (("run", "coulomb2", "--out", "x"), "'coulomb_2'"),
        (("render", "robot_axis", "--out", "x.png"), "'robot_axis1'"),
        (("crosscheck", "robot_axis"), "'robot_axis1'"),
        (("replay", "emp", "log.csv", "--out", "x.csv"), "'emps'"),
        (("identify", "log.csv", "--model", "kuka_axis1", "--out", "x"), "'kuka_kr300_axis1'"),
        (("diagnose", "log.csv", "--model", "robotaxis1", "--out", "x"), "'robot_axis1'"),
        (("diagnose", "log.csv", "--model", "emps", "--out", "x", "--effects", "coulomb"), "'coulomb_friction'"),
        (("effects", "backlach"), "'backlash'"),
        (("data", "emp"), "'emps'"),
        (("run", "step", "--model", "emp", "--out", "x"), "'emps'"),
    ],
)
def test_an_unknown_name_is_told_with_the_nearest(run_cli, words, nearest):
    code, out, err = run_cli(*words)
    assert (code, out) == (2, "")
    assert f"did you mean {nearest}?" in err


LOG = "time_s,torque_Nm,velocity_rad_s\n" + "".join(f"{0.001 * k},{k % 7},{k % 11}\n" for k in range(400))
ROBOT_LOG = "time_s,joint1.angle_rad,joint1.torque_Nm\n" + "".join(f"{0.001 * k},{0.1 * (k % 7)},{k % 11}\n" for k in range(400))


@pytest.mark.parametrize(
    ("words", "nearest"),
    [
        (("diagnose", "log.csv", "--markdow", "emps"), "'--markdown'"),
        (("replay", "emps", "log.csv", "--out", "x.csv", "--engine", "mujocco"), "'mujoco'"),
        (("diagnose", "log.csv", "--model", "emps", "--out", "x", "--judge", "forces"), "'force'"),
        (("proof", "emp", "--out", "x"), "'emps'"),
        (("effects", "colomb"), "'coulomb_friction'"),
        (("render", "emps", "--out", "x.pmg"), "'.png'"),
        (("replay", "emps", "log.csv", "--out", "x.csvv"), "'.csv'"),
        (("identify", "log.csv", "--out", "x", "--input", "torqu_Nm"), "'torque_Nm'"),
        (("check", "log.cvs", "--model", "robot_axis1"), "'log.csv'"),
        (("check", "log.csv", "--model", "owm.xml"), "'own.xml'"),
        (("gate", "emps", "log.csv", "--baseline", "diagnosys.json"), "'diagnosis.json'"),
        (("identify", "log.csv", "--model", "owm.xml", "--out", "x"), "'own.xml'"),
        (("fleet", "log*.csv", "--model", "pendulum", "--out", "x", "--effects", "coulomb"), "'coulomb_friction'"),
        (("benchmark", "--out", "x", "--levels", "plan:4"), "'plain'"),
        (("diagnose", "robot.csv", "--model", "arm3", "--out", "x", "--joint", "joint11"), "'joint1'"),
    ],
)
def test_an_unknown_option_value_file_or_column_is_told_with_the_nearest(run_cli, words, nearest):
    Path("log.csv").write_text(LOG)
    Path("robot.csv").write_text(ROBOT_LOG)
    Path("own.xml").write_text("<mujoco/>")
    Path("diagnosis.json").write_text("{}")
    code, out, err = run_cli(*words)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert f"id you mean {nearest}?" in err


@pytest.mark.parametrize(
    ("text", "nearest"),
    [
        ('[recording]\ntorque = { column = "torque_Nm", unit = "Nmm" }\n', "'Nm'"),
        ('[recording]\ntorque = { column = "torque_Mn" }\n', "'torque_Nm'"),
        ('[recording]\ntorqe = { column = "torque_Nm" }\n', "'torque'"),
        ('[recording]\ntorque = { colum = "torque_Nm" }\n', "'column'"),
        ('[recording]\nhold = "hold"\n', "'held'"),
        ('[recordings]\nhold = "held"\n', "'recording'"),
        ('[experiment]\nlop = "open"\n', "'loop'"),
        ('[experiment]\nloop = "opened"\n', "'open'"),
        ('[experiment]\njudge = "motions"\n', "'motion'"),
        ('[joints.motor]\ntorqe = "torque_Nm"\n', "'torque'"),
    ],
)
def test_an_unknown_name_in_a_binding_is_told_with_the_nearest(run_cli, text, nearest):
    Path("log.csv").write_text(LOG)
    Path("log.toml").write_text(text)
    code, out, err = run_cli("check", "log.csv", "--model", "robot_axis1")
    assert (code, out) == (2, "")
    assert f"did you mean {nearest}?" in err


@pytest.mark.parametrize(
    ("text", "nearest"),
    [
        ('[joints.joint11]\ntorque = "joint1.torque_Nm"\nangle = "joint1.angle_rad"\n', "'joint1'"),
        ('[joints.joint1]\ntorqe = "joint1.torque_Nm"\n', "'torque'"),
        ('[joints.joint1]\ntorque = "joint1.torque_N"\nangle = "joint1.angle_rad"\n', "'joint1.torque_Nm'"),
        ('[joints.joint1]\ntorque = { colum = "joint1.torque_Nm" }\n', "'column'"),
        ('[joint.joint1]\ntorque = "joint1.torque_Nm"\n', "'joints'"),
        ('[recording]\nhold = "meen"\n', "'mean'"),
        ('[experiment]\npayload = { body = "forearmm", mass = 1 }\n', "'forearm'"),
        ('[experiment]\npayload = { bdy = "forearm", mass = 1 }\n', "'body'"),
    ],
)
def test_an_unknown_name_in_the_binding_of_a_robot_is_told_with_the_nearest(run_cli, text, nearest):
    Path("log.csv").write_text(ROBOT_LOG)
    Path("log.toml").write_text(text)
    code, out, err = run_cli("check", "log.csv", "--model", "arm3")
    assert (code, out) == (2, "")
    assert f"did you mean {nearest}?" in err


PENDULUM = (
    '<mujoco><worldbody><body><joint name="hinge"/><geom size="0.1"/></body></worldbody>'
    '<actuator><motor name="drive" joint="hinge"/></actuator><sensor><jointpos name="encoder" joint="hinge"/></sensor></mujoco>'
)


@pytest.mark.parametrize(("bound", "nearest"), [('actuator = "driv"', "'drive'"), ('angle_sensor = "encodr"', "'encoder'")])
def test_an_unknown_element_of_a_model_is_told_with_the_nearest(run_cli, bound, nearest):
    Path("log.csv").write_text(LOG)
    Path("own.xml").write_text(PENDULUM)
    Path("own.toml").write_text(f"[model]\n{bound}\n")
    code, out, err = run_cli("check", "log.csv", "--model", "own.xml")
    assert (code, out) == (2, "")
    assert f"did you mean {nearest}?" in err


CHIRP = '[excitation]\nkind = "chirp"\namplitude = 1.0\nlow_hz = 0.5\nhigh_hz = 30\n'


@pytest.mark.parametrize(
    ("text", "nearest"),
    [
        (f'abuot = "x"\n{CHIRP}', "'about'"),
        (f'engine = "od"\n{CHIRP}', "'ode'"),
        (CHIRP.replace("chirp", "chrip"), "'chirp'"),
        (CHIRP.replace("amplitude", "amplitud"), "'amplitude'"),
        (f"{CHIRP}[noise]\nvelocty = 0.1\n", "'velocity'"),
        (f'{CHIRP}[[effects]]\nid = "coulomb"\n', "'coulomb_friction'"),
        (f'{CHIRP}[[effects]]\nid = "backlash"\ngap = 1e-3\n', "'gap_rad'"),
        (f'{CHIRP}[[effects]]\nid = "backlash"\nplace = "gearbx"\ngap_rad = 1e-3\n', "'gearbox'"),
    ],
)
def test_an_unknown_name_in_a_scenario_is_told_with_the_nearest(run_cli, text, nearest):
    Path("s.toml").write_text(text)
    code, out, err = run_cli("run", "s.toml", "--out", "x")
    assert (code, out) == (2, "")
    assert f"did you mean {nearest}?" in err


def test_an_unknown_name_in_python_is_told_with_the_nearest():
    with pytest.raises(AttributeError, match="did you mean 'diagnose'"):
        _ = simgap.diagnos
    with pytest.raises(KeyError, match="did you mean 'coulomb_friction'"):
        _ = simgap.effects["coulomb"]
    with pytest.raises(ValueError, match="did you mean 'gearbox'"):
        simgap.effects["backlash"](place="gearbx", gap_rad=1e-3)
    with pytest.raises(simgap.InputError, match="did you mean 'force'"):
        simgap.diagnose({"time_s": [0]}, "pendulum", judge="forces")


def test_a_name_that_resembles_none_is_told_with_the_choices(run_cli):
    code, _, err = run_cli("render", "zzzz", "--out", "x.png")
    assert code == 2
    assert "robot_axis1" in err
    assert "did you mean" not in err


def test_a_model_table_beside_a_log_is_refused_and_read_beside_the_model(run_cli):
    """It would be read by nobody; where log and model share the name, it is the model's."""
    Path("log.csv").write_text(LOG)
    Path("log.toml").write_text('[model]\nactuator = "motor"\n')
    code, _, err = run_cli("identify", "log.csv", "--out", "out")
    assert code == 2
    assert "[model] is not read beside a recording" in err
    assert "MODEL.toml" in err
    Path("log.xml").write_text("<mujoco/>")
    code, _, err = run_cli("identify", "log.csv", "--decimate", "1", "--orders", "1,1,1,1,1", "--out", "out")
    assert "[model]" not in err
