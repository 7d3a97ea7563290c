"""``simgap replay``: the fit of a model with its found physics, the written prediction, and bad input in one line."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from robot_axis import DT, chirp

from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.known_torque import KnownTorque
from mjsim.mjcf import load_axis, write_corrected
from mjsim.models import shipped_model
from mjsim.ode import simulate
from mjsim.recording import load
from simgap.cli import cli


def log(path: Path, axis: Axis, torque: np.ndarray, noise: float = 0.0, **start: np.ndarray) -> Path:
    run = simulate(axis, torque, DT, **start)
    velocity = run.velocity + noise * np.random.default_rng(1).standard_normal(len(torque))
    with path.open("w", newline="") as handle:
        writer = csv.writer(handle)
        writer.writerow(["time_s", "torque_Nm", "velocity_rad_s", "angle_rad"])
        writer.writerows(np.column_stack([run.time, torque, velocity, run.angle]).tolist())
    return path


def replay(*arguments: object) -> dict:
    result = CliRunner().invoke(cli, ["replay", *map(str, arguments), "--json"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return json.loads(result.output)


@pytest.fixture(scope="module")
def nominal() -> Path:
    return shipped_model("robot_axis1")


@pytest.fixture(scope="module")
def found(nominal) -> Axis:
    axis = load_axis(nominal)
    for name, values in (
        ("coulomb_friction", {"torque_Nm": 0.1}),
        ("backlash", {"gap_rad": 5e-4}),
        ("gravity_load", {"torque_Nm": 5.0, "phase_rad": 0.2}),
    ):
        axis += effect_class(name)(**values)
    return axis.with_linear({"Jm": 4.8e-4})


@pytest.mark.parametrize("engine", ["ode", "mujoco"])
def test_found_physics_bring_the_fit_to_the_noise(tmp_path, nominal, found, engine):
    recording = log(tmp_path / "log.csv", found, chirp(2.0), noise=0.05)
    write_corrected(nominal, found, tmp_path / "corrected.xml")
    before = replay(nominal, recording, "--out", tmp_path / "a.csv", "--engine", engine)
    after = replay(tmp_path / "corrected.xml", recording, "--out", tmp_path / "b.csv", "--engine", engine)
    assert set(after) >= {"rms", "nrmse", "fit_percent", "channel"}
    assert after["channel"] == "velocity"
    assert before["rms"] > 20 * after["rms"]
    assert after["rms"] == pytest.approx(0.05, rel=0.05)
    assert after["fit_percent"] == pytest.approx(100 * (1 - after["nrmse"]))
    assert after["effects"] == ["coulomb_friction@motor", "backlash@gearbox", "gravity_load@arm"]
    assert "plain_mujoco_rms" not in after  # MJCF does not express the gap


PENDULUM = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.01"/>
<geom type="sphere" pos="0 0 -0.3" size="0.03" mass="0.3"/></body></worldbody>
<actuator><motor joint="hinge"/></actuator></mujoco>"""


def test_the_error_in_plain_mujoco_stands_beside_that_of_the_equations(tmp_path):
    model, out = tmp_path / "pendulum.xml", ("--out", tmp_path / "p.csv")
    model.write_text(PENDULUM)
    recording = log(tmp_path / "log.csv", load_axis(model), 0.5 * chirp(3.0))
    told = replay(model, recording, *out)
    literal = replay(model, recording, *out, "--engine", "literal")
    assert told["rms"] < 1e-6  # the recording is by the equations
    assert told["plain_mujoco_rms"] == literal["rms"]
    assert literal["rms"] > 100 * told["rms"]  # Euler steps are coarse
    said = CliRunner().invoke(cli, ["replay", str(model), str(recording), "--out", str(tmp_path / "p.csv")]).output
    assert f"options of the file: rms error {literal['rms']:.6g} rad/s" in said


SERVO = '<position joint="hinge" kp="5" kv="0.3"/>'


@pytest.mark.parametrize("hold", ["held", "linear"])
def test_a_known_torque_acts_in_plain_mujoco_too(tmp_path, hold):
    """Of a torque drive by each engine, and of a servo; without the column the error is that of the torque."""
    dt, count = 0.002, 500
    time = dt * np.arange(count)
    known, u = 0.3 * np.sin(9.0 * time), 0.2 * np.sin(5.0 * time)
    for actuator, input_ in (('<motor joint="hinge"/>', "torque"), (SERVO, "command")):
        model, recording = tmp_path / f"{input_}.xml", tmp_path / f"{input_}.csv"
        model.write_text(PENDULUM.replace('<motor joint="hinge"/>', actuator).replace('timestep="0.002"', 'timestep="0.0001"'))
        run = simulate(load_axis(model) + KnownTorque.of(known, dt), u, dt, hold=hold if input_ == "command" else "held")
        unit = {"torque": "Nm", "command": "rad"}[input_]
        table = np.column_stack([run.time, u, run.velocity, run.angle, known])
        np.savetxt(recording, table, delimiter=",", header="t,u,v,q,g", comments="", fmt="%.17g")
        columns = f'[recording]\ntime = "t"\n{input_} = {{ column = "u", unit = "{unit}" }}\n'
        columns += f'velocity = "v"\nangle = "q"\nhold = "{hold}"\n'
        binding = recording.with_suffix(".toml")
        binding.write_text(columns)
        without = replay(model, recording, "--out", tmp_path / "p.csv")
        binding.write_text(columns + 'known_torque = "g"\n')
        for engine in ("ode", "literal") + (("mujoco",) if input_ == "torque" else ()):
            told = replay(model, recording, "--out", tmp_path / "p.csv", "--engine", engine)
            assert told["rms"] < 0.02 * without["rms"], (input_, engine)
            if engine == "ode":
                assert told["plain_mujoco_rms"] < 0.02 * without["plain_mujoco_rms"]


def test_the_literal_engine_says_what_it_lacks(tmp_path, nominal, found):
    recording = log(tmp_path / "log.csv", found, chirp(0.5))
    write_corrected(nominal, found, tmp_path / "corrected.xml")
    result = replay(tmp_path / "corrected.xml", recording, "--out", tmp_path / "p.csv", "--engine", "literal")
    assert [line.split(":")[0] for line in result["lacks"]] == ["backlash at the gearbox", "gravity load at the arm"]


@pytest.mark.slow
def test_the_literal_nominal_model_meets_the_bar(tmp_path, nominal):
    recording = log(tmp_path / "log.csv", load_axis(nominal), chirp())
    result = replay(nominal, recording, "--out", tmp_path / "p.csv", "--engine", "literal")
    assert result["nrmse"] <= 1e-5


def test_the_prediction_is_a_recording(tmp_path, nominal):
    recording = log(tmp_path / "log.csv", load_axis(nominal), chirp(0.5))
    replay(nominal, recording, "--out", tmp_path / "deep" / "p.csv")
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["p.csv"]
    back, given = load(tmp_path / "deep" / "p.csv"), load(recording)
    assert back.dt == given.dt
    assert np.allclose(back.velocity, given.velocity, rtol=1e-9, atol=1e-9)
    assert np.allclose(back.angle, given.angle, rtol=1e-9, atol=1e-9)


def test_a_recording_that_begins_in_motion(tmp_path, nominal):
    axis = load_axis(nominal)
    ratios = np.array([1.0, 1 / 118, 1 / 118])
    recording = log(tmp_path / "log.csv", axis, chirp(2.0), 0.01, initial=np.array([0.4 * ratios, 20.0 * ratios]))
    assert replay(nominal, recording, "--out", tmp_path / "p.csv")["fit_percent"] > 99.5
    assert replay(nominal, recording, "--out", tmp_path / "p.csv", "--start", "rest")["fit_percent"] < 90


def test_position_locked_effects_follow_the_recorded_angle(tmp_path, nominal):
    ripple = effect_class("torque_ripple")(amplitude_Nm=0.05, cycles_per_rev=8.0, phase_rad=0.3)
    recording = log(tmp_path / "log.csv", load_axis(nominal) + ripple, chirp(2.0))
    # a model that drifts away: the ripple must not drift with it
    axis = (load_axis(nominal) + ripple).with_linear({"fm": 0.036})
    write_corrected(nominal, axis, tmp_path / "m.xml")
    with_angle = replay(tmp_path / "m.xml", recording, "--out", tmp_path / "p.csv")["rms"]
    (tmp_path / "log.toml").write_text('[recording]\ntime = "time_s"\ntorque = "torque_Nm"\nvelocity = "velocity_rad_s"\n')
    without = replay(tmp_path / "m.xml", recording, "--out", tmp_path / "p.csv")["rms"]
    assert with_angle < without


def test_the_binding_travels_inside_the_corrected_file(tmp_path):
    emps = shipped_model("emps")
    write_corrected(emps, load_axis(emps), tmp_path / "corrected.xml")
    from scipy.io import savemat

    t = np.arange(2000) * 1e-3
    volt = np.sin(2 * np.pi * 2 * t)
    run = simulate(load_axis(emps), 35.1506 * volt, 1e-3)
    savemat(tmp_path / "DATA.mat", {"t": t, "vir": volt, "qm": run.angle})
    result = replay(tmp_path / "corrected.xml", tmp_path / "DATA.mat", "--out", tmp_path / "p.csv")
    assert result["channel"] == "angle"
    assert result["fit_percent"] > 99.9
    assert result["force"]["relative"] < 0.01  # the binding says that such recordings are judged on force
    assert (tmp_path / "p.csv").read_text().splitlines()[0] == "time_s,torque_N,velocity_m_s,angle_m"


def test_bad_input_is_one_line_and_exit_2(simgap, tmp_path, nominal):
    recording = log(tmp_path / "log.csv", load_axis(nominal), chirp(0.05))
    (tmp_path / "bad.xml").write_text("<mujoco><worldbody>")
    for model, file in ((tmp_path / "none.xml", recording), (nominal, tmp_path / "none.csv"), (tmp_path / "bad.xml", recording)):
        code, out, err = simgap("replay", str(model), str(file), "--out", "p.csv")
        assert (code, out) == (2, "")
        assert len(err.strip().splitlines()) == 1
        assert err.startswith("simgap: ")
        assert not (tmp_path / "p.csv").exists()
    (tmp_path / "file").write_text("")
    code, _, err = simgap("replay", str(nominal), str(recording), "--out", "file/p.csv")
    assert (code, len(err.strip().splitlines())) == (2, 1)


def test_help_shows_an_example():
    result = CliRunner().invoke(cli, ["replay", "--help"])
    assert "Example: simgap replay" in " ".join(result.output.split())
