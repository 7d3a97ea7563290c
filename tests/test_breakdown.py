"""What breaks a command in the middle: no memory, SIGTERM, no folder for compiled code, physics that diverges, a fault."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lab.kill import EFFECT, MODEL, write_log
from simgap import cli

ROOT = Path(cli.__file__).resolve().parent.parent
DIAGNOSE = ["diagnose", "a.npz", "--model", "pendulum.xml", "--effects", EFFECT, "--quiet", "--out", "out"]

# the CALL-th run of the fitting engine raises ERROR
BROKEN = """
import sys
import diagnose.problem.view as view, diagnose.data.runs as runs
from mjsim import ode
from simgap import cli
simulate, count = ode.simulate, 0
def broken(*words, **more):
    global count
    count += 1
    if count >= CALL:
        raise ERROR
    return simulate(*words, **more)
view.simulate = runs.simulate = broken
cli.main()
"""

# the diagnosis breaks once corrected.xml has been written and judged
JUDGED = """
import simgap.pipeline as pipeline
from simgap import cli
judge = pipeline.write_judged
def broken(*words):
    judge(*words)
    raise MemoryError("made")
pipeline.write_judged = broken
cli.main()
"""

# only 16 MB more than the process has once its libraries are loaded
SHORT = """
import resource, sys
import diagnose.pipeline, simgap.api.identifying, simgap.commands.identify, mjsim.readers, scipy.signal, matplotlib.pyplot
from simgap import cli
pages = int(open("/proc/self/statm").read().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (16 << 20),) * 2)
cli.main()
"""

READ_ONLY = """
import errno, tempfile
def refuse(*words, **more):
    raise OSError(errno.EROFS, "Read-only file system")
tempfile.TemporaryFile = refuse  # by which numba looks whether it may write into a folder
"""

LAW = """
from mjsim.compiled import compiled, kept_at
from mjsim.notices import tell_compiling
tell_compiling(lambda kept: print("kept" if kept else "for this run alone"))
@compiled()
def twice(x):
    return 2 * x
print(twice(1.0), twice(2.0), kept_at(twice))
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "pendulum.xml").write_text(MODEL)
    write_log(tmp_path / "a.npz", 0.15, 0, 500)
    return tmp_path


def run(
    folder: Path, *words: str, code: str = "from simgap import cli; cli.main()", **more: str
) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(ROOT), *sys.path])} | more
    return subprocess.run([sys.executable, "-c", code, *words], cwd=folder, env=environment, capture_output=True, text=True,
                          timeout=900, check=False)  # fmt: skip


def line(ended: subprocess.CompletedProcess[str], code: int, *parts: str) -> None:
    """One line on standard error that holds the parts, and the exit code."""
    assert ended.returncode == code, ended.stderr
    assert "Traceback" not in ended.stderr
    said = ended.stderr.strip().splitlines()
    assert len(said) == 1, said
    for part in parts:
        assert part in said[0]


@pytest.mark.parametrize(
    ("error", "call", "code", "parts"),
    [
        pytest.param(
            "MemoryError('unable to allocate 3 GiB')",
            20,
            2,
            ("not enough memory", "3 GiB", "--jobs"),
            marks=pytest.mark.slow,
        ),
        ("ode.DivergedError('left the finite numbers at 0.5 s')", 1, 2, ("pendulum.xml", "diverges", "at 0.5 s")),
        pytest.param(
            "ZeroDivisionError('made')",
            20,
            1,
            ("ZeroDivisionError", "made", "a fault of simgap", "SIMGAP_TRACEBACK"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_diagnosis_that_breaks_in_the_middle(folder, error, call, code, parts):
    """One line, and nothing under a final name."""
    line(run(folder, *DIAGNOSE, code=BROKEN.replace("CALL", str(call)).replace("ERROR", error)), code, *parts)
    assert {p.name for p in folder.glob("out/*")} <= {"state.jsonl"}


@pytest.mark.slow
def test_a_model_that_is_still_judged_has_not_its_final_name(folder):
    """In the course of it the file is written several times."""
    line(run(folder, *DIAGNOSE, code=JUDGED), 2, "not enough memory (made)")
    assert {p.name for p in folder.glob("out/*")} <= {"state.jsonl"}


@pytest.mark.slow
def test_the_traceback_of_a_fault_is_shown_on_request(folder):
    ended = run(folder, *DIAGNOSE, code=BROKEN.replace("CALL", "1").replace("ERROR", "ZeroDivisionError"), SIMGAP_TRACEBACK="1")
    assert "Traceback" in ended.stderr


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of the address space and /proc are Linux's")
def test_a_limit_on_memory(folder):
    """A recording that is larger than what the process may still take."""
    t = 1e-3 * np.arange(4_000_000)
    np.savez(folder / "large.npz", time_s=t, torque_Nm=t, velocity_rad_s=t, angle_rad=t)
    line(run(folder, "identify", "large.npz", "--out", "out", code=SHORT), 2, "not enough memory")
    assert not (folder / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("group", [True, False], ids=["group", "process"])
def test_sigterm_while_a_film_is_drawn(tmp_path, group):
    """The command ends by one line; the encoder, which may end before it, makes no difference. No part is left."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    words = [sys.executable, "-m", "simgap", "render", "emps", "--out", "film.mp4"]
    with subprocess.Popen(
        words, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        began = time.monotonic()
        while not list(tmp_path.glob(".film.*")) and process.poll() is None and time.monotonic() - began < 120:
            time.sleep(0.02)
        (os.killpg if group else os.kill)(process.pid, signal.SIGTERM)
        _, err = process.communicate(timeout=60)
    if "no off-screen OpenGL" in err:
        pytest.skip("nothing can be drawn here")
    assert process.returncode == cli.TERMINATED, err
    assert err.strip() == "simgap: terminated"
    assert not list(tmp_path.iterdir())


def test_compiled_code_without_a_folder_that_can_be_written(tmp_path):
    """Neither NUMBA_CACHE_DIR nor the folders beside the source and of the user: compiled for this run, and said."""
    (tmp_path / "law.py").write_text(LAW)
    (tmp_path / "sitecustomize.py").write_text(READ_ONLY)
    nowhere = {"HOME": "/proc/nowhere", "XDG_CACHE_HOME": "/proc/nowhere", "NUMBA_CACHE_DIR": "/proc/nowhere"}
    ended = run(tmp_path, code="import law", **nowhere)
    assert ended.stdout == "for this run alone\n2.0 4.0 None\n", ended.stderr
    ended = run(tmp_path, "doctor", **nowhere)
    assert "no folder can be written" in ended.stderr + ended.stdout
    assert "Traceback" not in ended.stderr
