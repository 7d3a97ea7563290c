"""``import simgap``: its examples run, files and arrays give the same answers, a robot gives the same kind of object."""

from __future__ import annotations

import doctest
import importlib
import json
import subprocess
import sys
from importlib.resources import files
from importlib.util import find_spec

import mujoco
import numpy as np
import pytest

import simgap
from diagnose.report.schema import diagnosis_schema
from mjsim.models import shipped_model

NAMES = [n for n in simgap.__all__ if n != "__version__"]
LONG = ("Diagnosis", "diagnose")  # what `found` shows as well
DT = 0.004


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in NAMES])
def test_every_name_has_an_example_that_runs(name):
    thing = getattr(simgap, name)
    about = type(thing) if name == "effects" else thing
    module = importlib.import_module(about.__module__)
    tests = [t for t in doctest.DocTestFinder(recurse=False).find(about, name, module=module) if t.examples]
    assert tests, f"simgap.{name} has no example"
    for test in tests:
        ended = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(test)
        assert ended.failed == 0


def test_importing_loads_nothing_heavy():
    code = "import sys, simgap; sys.exit(len([m for m in ('numba', 'mujoco', 'scipy', 'numpy', 'click') if m in sys.modules]))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'dignose'"):
        simgap.dignose  # noqa: B018


@pytest.fixture(scope="module")
def log():
    """Columns of a pendulum with dry friction of 0.3 N m."""
    t = np.arange(0, 3, DT)
    torque = 1.5 * np.sin(2 * np.pi * (0.3 + 0.5 * t) * t)
    friction = simgap.effects["coulomb_friction"](place="motor", torque_Nm=0.3)
    run = simgap.simulate("pendulum", torque, dt=DT, effects=[friction])
    noise = 0.01 * np.random.default_rng(0).standard_normal(t.size)
    return {"time_s": t, "torque_Nm": torque, "velocity_rad_s": run.velocity + noise}


@pytest.fixture(scope="module")
def found(log):
    return simgap.diagnose(log, "pendulum", effects=["coulomb_friction", "torque_offset"])


def test_a_diagnosis_gives_objects(found, tmp_path):
    (finding,) = found.findings
    assert finding.parameters["torque_Nm"].value == pytest.approx(0.3, rel=0.02)
    assert isinstance(found.corrected_model(), mujoco.MjModel)
    spec = found.corrected_spec()
    assert spec.joint("pendulum").frictionloss == pytest.approx(finding.parameters["torque_Nm"].value, rel=0.05)
    assert len(found.plot().axes) == 2
    assert found.report(tmp_path / "report.html").read_text(encoding="utf-8").startswith("<!")
    assert found.as_dict()["findings"][0]["effect"] == "coulomb_friction"
    saved = found.save(tmp_path / "saved")
    assert {p.name for p in saved.iterdir()} == {"diagnosis.json", "corrected.xml", "report.html"}


def test_a_diagnosis_is_a_table(found):
    pytest.importorskip("pandas")
    table = found.to_frame()
    assert list(table["joint"]) == ["pendulum"]
    assert table["low"][0] < table["value"][0] < table["high"][0]


def test_pandas_files_and_arrays_give_the_same(log, tmp_path):
    pandas = pytest.importorskip("pandas")
    pandas.DataFrame(log).to_csv(tmp_path / "log.csv", index=False, float_format="%.17g")
    one, *others = (simgap.load(source) for source in (log, pandas.DataFrame(log), tmp_path / "log.csv"))
    for other in others:
        np.testing.assert_array_equal(other.velocity, one.velocity)
        np.testing.assert_array_equal(other.torque, one.torque)
    assert len(one.sha256) == 64
    pandas.testing.assert_frame_equal(one.to_frame(), pandas.DataFrame(log))


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet", ".mcap"])
def test_what_is_saved_is_read_back(log, tmp_path, suffix):
    if suffix in (".parquet", ".mcap"):
        pytest.importorskip({".parquet": "pyarrow", ".mcap": "mcap"}[suffix])
    one = simgap.load(log)
    one.save(tmp_path / f"log{suffix}")
    again = simgap.load(tmp_path / f"log{suffix}")
    np.testing.assert_allclose(again.velocity, one.velocity, rtol=1e-9)
    assert again.dt == one.dt
    assert [p.name for p in tmp_path.iterdir()] == [f"log{suffix}"]


def test_an_mcap_file_is_read_by_the_library_of_its_makers(log, tmp_path):
    """As Foxglove and PlotJuggler read it: one topic, JSON messages with a JSON Schema, stamps in nanoseconds."""
    reader = pytest.importorskip("mcap.reader")
    jsonschema = pytest.importorskip("jsonschema")
    simgap.load(log).save(tmp_path / "log.mcap")
    with (tmp_path / "log.mcap").open("rb") as file:
        messages = list(reader.make_reader(file).iter_messages())
    assert len(messages) == len(log["time_s"])
    schema, channel, message = messages[5]
    assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
    assert message.log_time == round(1e9 * log["time_s"][5])
    told = json.loads(message.data)
    jsonschema.validate(told, json.loads(schema.data))
    assert told["velocity_rad_s"] == pytest.approx(log["velocity_rad_s"][5])


@pytest.mark.slow
def test_a_log_of_the_model_itself_without_noise():
    """Nothing is left of the nominal model: no error to divide by."""
    t = np.arange(0, 3, DT)
    run = simgap.simulate("pendulum", 3 * np.sin(2 * np.pi * (0.3 + 0.5 * t) * t), dt=DT)
    assert simgap.diagnose(run, "pendulum", effects=["torque_offset"]).findings == ()


def test_the_command_of_a_servo_is_followed_from_rest():
    spec = simgap.Model("pendulum").spec
    spec.actuator("torque").set_to_position(kp=200.0, kv=10.0)
    run = simgap.simulate(spec, np.full(1000, 0.2), dt=DT)
    assert run.angle[0] == 0.0
    assert run.angle[-1] == pytest.approx(0.2, abs=0.01)
    assert list(run.signals())[:2] == ["time_s", "command_rad"]


def test_a_model_can_be_a_specification():
    spec = mujoco.MjSpec.from_file(str(shipped_model("pendulum")))
    spec.joint("pendulum").damping = [0.2, 0.0, 0.0]
    assert simgap.Model(spec).parameters["fm"] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: simgap.load({"t": [0.0, 1.0]}), "no column 'time_s'"),
        (lambda: simgap.load({"t": ["a", "b"]}), "holds no numbers"),
        (lambda: simgap.load(3), "a file, a mapping of arrays"),
        (lambda: simgap.load("nowhere.csv"), "no such file"),
        (lambda: simgap.Model("pendulun"), "did you mean 'pendulum'"),
        (lambda: simgap.simulate("pendulum", [0.0, 1.0]), "dt"),
        (lambda: simgap.simulate("pendulum", [0.0, 1.0], 0.01, engine="fast"), "engine"),
        (lambda: simgap.diagnose({"t": [0.0]}, "pendulum", effects=["coulomb"]), "unknown effect"),
        (lambda: simgap.diagnose([], "pendulum"), "at least one"),
    ],
)
def test_what_cannot_be_used_is_told_in_one_line(call, told):
    with pytest.raises(simgap.InputError, match=told) as error:
        call()
    assert "\n" not in str(error.value)


def test_a_robot_gives_the_same_kind_of_object(tmp_path):
    from lab.robot.cases import draw, write_log

    case = draw(1, "single", 3)
    path = tmp_path / "log.csv"
    write_log(case, path, 0)
    found = simgap.diagnose(path, "arm3", effects=["coulomb_friction"])
    assert isinstance(found, simgap.Diagnosis)
    assert set(found.by_joint()) == set(simgap.Model("arm3").joints)
    assert found.corrected_model().nv == 3
    assert found.plot().axes
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(found.as_dict(), diagnosis_schema())
    assert found.report(tmp_path / "report.html").read_text(encoding="utf-8").startswith("<!")
    assert found.summary_file(tmp_path / "summary.md").read_text(encoding="utf-8").startswith("## ")
    assert found.plot()._repr_png_().startswith(b"\x89PNG")
    if find_spec("pandas"):
        assert {"joint", "effect", "value"} <= set(found.to_frame().columns)


def test_identification_gives_objects_of_python_control(log):
    control = pytest.importorskip("control")
    fitted = simgap.identify(log, orders=(1, 1, 1, 1, 1), decimate=1, cutoff=None)
    for system in (fitted.transfer_function(), fitted.noise_transfer_function()):
        assert isinstance(system, control.TransferFunction)
        assert system.dt == pytest.approx(DT)
    _, step = control.step_response(fitted.transfer_function(), T=DT * np.arange(50))
    assert np.isfinite(step).all()


def test_the_package_says_that_it_is_typed():
    assert (files("simgap") / "py.typed").is_file()
