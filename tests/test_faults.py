"""Faults around the command line: inputs as outputs, closed pipes, odd names."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import pytest

import simgap as api
from mjsim.errors import InputError
from mjsim.models import shipped_model
from simgap import cli
from simgap.sole import sole
from tests.commands import ROOT, command, recording, refused


def test_an_output_that_is_an_input(simgap):
    log = recording(Path("log.csv"))
    before = log.read_bytes()
    refused(simgap("replay", "robot_axis1", "log.csv", "--out", "log.csv"), "--out", "would overwrite", "log.csv")
    Path("link.csv").hardlink_to(log)
    refused(simgap("replay", "robot_axis1", "log.csv", "--out", "link.csv"), "would overwrite")
    assert log.read_bytes() == before


@pytest.mark.parametrize("name", ["corrected.xml", "mapped.xml"])
def test_a_diagnosis_beside_its_own_model(simgap, name):
    recording(Path("log.csv"))
    model = Path(name)
    model.write_bytes(shipped_model("robot_axis1").read_bytes())
    refused(simgap("diagnose", "log.csv", "--model", name, "--out", "."), "would overwrite", name)
    assert model.read_bytes() == shipped_model("robot_axis1").read_bytes()


def test_a_scenario_of_the_same_name_as_its_log(simgap):
    Path("step.toml").write_text('model = "emps"\n[excitation]\nkind = "step"\namplitude = 1\n')
    refused(simgap("run", "step.toml", "--out", "."), "would overwrite", "step.toml")


@pytest.mark.parametrize(
    "words",
    [
        ("run", "--list"),
        pytest.param(("effects", "--json"), marks=pytest.mark.slow),
        pytest.param(("check", "log.csv", "--model", "robot_axis1"), marks=pytest.mark.slow),
    ],
)
def test_a_reader_that_goes_away(tmp_path, words):
    """A pipe without a reader ends the command as SIGPIPE would, and quietly."""
    recording(tmp_path / "log.csv")
    with command(*words, cwd=tmp_path) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        err = process.stderr.read()
        assert process.wait(60) == cli.CLOSED
    assert err == ""


@pytest.mark.parametrize("closed", [pytest.param((1,), marks=pytest.mark.slow), (0, 1, 2)], ids=["output", "all"])
def test_standard_streams_that_are_closed(tmp_path, closed):
    """Results go to their files; no file takes the descriptor of a stream."""
    recording(tmp_path / "log.csv")
    words = ("replay", "robot_axis1", "log.csv", "--out", "p.csv")
    with command(*words, cwd=tmp_path, preexec_fn=lambda: [os.close(number) for number in closed]) as process:
        _, err = process.communicate(timeout=300)
    assert process.returncode == 0
    assert all("compiling" in line for line in err.splitlines()), err
    assert (tmp_path / "p.csv").read_text().startswith("time_s,")


def test_control_characters_do_not_reach_the_terminal(simgap):
    evil = "velo\x1b[31mcity\x07\u202e"
    recording(Path("log.csv"), velocity=evil)
    for words in (
        ("identify", "log.csv", "--output", "nothing", "--out", "out"),
        ("diagnose", "log.csv", "--model", "robot_axis1", "--out", "out"),
        ("run", evil, "--out", "out"),
        (evil,),
        ("render", evil, "--out", "film.png"),
    ):
        code, out, err = simgap(*words)
        assert code in (0, 2)
        assert not {"\x1b", "\x07", "\u202e"} & set(out + err)
    code, out, err = simgap("identify", "log.csv", "--output", evil, "--decimate", "1", "--orders", "1,1,1,1,1", "--out", "out")
    assert not {"\x1b", "\x07", "\u202e"} & set(out + err)


def test_a_message_has_a_length(simgap):
    code, _, err = simgap("render", "x" * 50_000, "--out", "film.png")
    assert code == 2
    assert len(err) < 2200


@pytest.mark.slow
def test_a_missing_library_for_drawing_breaks_only_what_draws(tmp_path):
    """MUJOCO_GL names a library that is not there: a command that draws nothing runs, one that draws says what is missing."""
    log = recording(tmp_path / "log.csv")
    missing = {"MUJOCO_GL": "osmesa", "PYOPENGL_PLATFORM": "", "LD_LIBRARY_PATH": ""}
    missing["PYTHONPATH"] = os.pathsep.join([str(tmp_path), str(ROOT), *sys.path])
    (tmp_path / "sitecustomize.py").write_text(  # where OSMesa is installed, it is hidden
        "import ctypes.util as u\nfound = u.find_library\nu.find_library = lambda n: None if n == 'OSMesa' else found(n)\n"
    )
    ended = command("replay", "emps", str(log), "--out", "p.csv", "--engine", "mujoco", cwd=tmp_path, env=missing)
    out, err = ended.communicate(timeout=300)
    assert "GL" not in err, err
    assert "Traceback" not in err
    ended = command("render", "emps", "--out", "film.png", cwd=tmp_path, env=missing)
    out, err = ended.communicate(timeout=300)
    refused((ended.returncode, out, err), "no off-screen OpenGL", "libosmesa6")
    assert not (tmp_path / "film.png").exists()


def test_the_choice_of_a_renderer_is_kept_for_what_draws():
    environ = {"MUJOCO_GL": "osmesa"}
    cli.defer_rendering(environ)
    assert environ == {"MUJOCO_GL": "disable", "SIMGAP_GL": "osmesa"}
    cli.defer_rendering(environ)
    assert environ["SIMGAP_GL"] == "osmesa"
    cli.defer_rendering(empty := {})
    assert empty == {}


def test_two_diagnoses_from_python_into_one_folder(tmp_path):
    log = recording(tmp_path / "log.csv")
    with sole(tmp_path / "out"), pytest.raises(InputError, match="another run writes"):
        api.diagnose(log, "robot_axis1", out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_run_that_was_killed_does_not_hold_its_folder(tmp_path):
    holds = f"from simgap.sole import sole\nwith sole(Path({str(tmp_path / 'out')!r})):\n print(1, flush=True)\n time.sleep(60)"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    words = [sys.executable, "-c", f"import time\nfrom pathlib import Path\n{holds}"]
    first = subprocess.Popen(words, stdout=subprocess.PIPE, env=environment)
    assert first.stdout is not None
    assert first.stdout.readline() == b"1\n"
    with pytest.raises(InputError, match="another run"), sole(tmp_path / "out"):
        pass
    first.kill()
    first.wait()
    first.stdout.close()
    with sole(tmp_path / "out"):
        pass


def test_a_folder_for_locks_that_is_not_there_stops_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    with sole(tmp_path / "out"), sole(tmp_path / "out"):
        pass


@pytest.mark.parametrize(("package", "code"), [("mjsim", 1), ("elsewhere", 0)])
def test_a_numerical_warning_of_this_code_is_no_result(simgap, monkeypatch, package, code):
    """NumPy warns of an overflow in a module of this project: one line and exit code 1; in another one the command goes on."""
    made = {"np": np, "__name__": f"{package}.made"}
    exec("def overflow(*_, **__):\n    return np.float64(1e300) * np.float64(1e300)", made)
    monkeypatch.setattr("simgap.commands.effects.command.callback", made["overflow"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ended, _, err = simgap("effects")
    assert ended == code, err
    if code:
        assert len(err.splitlines()) == 1
        assert "overflow" in err
        assert "no result" in err
