"""Code that is on disk is loaded without what only compiling needs, and compiling works after it as before."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba import config, njit
from numba.core import event
from numba.core.errors import TypingError

from mjsim import compiled as module
from mjsim.compiled import compiled, kept_at
from mjsim.effects import coulomb_friction_with_creep as creep

NEW = """
import ctypes
import numpy as np
from numba import types
from mjsim.compiled import callback, compiled
from mjsim.ode import load_kernel

load_kernel(3)

@compiled()
def norm(a):
    return np.linalg.norm(np.sort(a)[1:])

def half(x):
    return 0.5 * x

call = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
made = callback(half, types.float64, types.float64)
print(norm(np.array([9.0, 2.0, 12.0])), call(made.address)(3.0), sum(norm.stats.cache_hits.values()), made.cache_hits)
"""


def run(*call: str) -> str:
    done = subprocess.run([sys.executable, *call], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_what_is_on_disk_is_loaded_without_the_tables_of_the_compiler():
    code = "import sys; from mjsim.ode import load_kernel; load_kernel(3); print('numba.np.linalg' in sys.modules)"
    assert "False" in (run("-c", code) for _ in range(2)), "where it is not yet compiled the first compiles it"


@pytest.mark.slow
def test_functions_and_callbacks_are_compiled_after_others_were_loaded_and_kept(tmp_path: Path):
    module = tmp_path / "new.py"
    module.write_text(NEW)
    assert run(str(module)) == "15.0 1.5 0 0"
    assert run(str(module)) == "15.0 1.5 1 1"


def test_a_law_is_found_on_disk_by_a_process_that_compiles_nothing():
    code = f"import sys, {creep.__name__} as m; print(m.torque.address != 0, 'numba.np.linalg' in sys.modules)"
    assert "True False" in (run("-c", code) for _ in range(2)), "where it is not yet compiled the first compiles it"


def test_the_collector_rests_while_numba_compiles_and_runs_after_it():
    class Ran(event.Listener):
        """Whether the collector ran as each compilation began."""

        def on_start(self, started):
            found.append(gc.isenabled())

        def on_end(self, ended):
            pass

    found: list[bool] = []
    inner = njit(lambda x: x + 1.0)
    outer = njit(lambda x: 2.0 * inner(x))
    wrong = njit(lambda x: inner(x) + undefined)  # type: ignore[name-defined]  # noqa: F821
    assert gc.isenabled()
    with event.install_listener("numba:compile", Ran()):
        assert outer(1.0) == 4.0
        assert gc.isenabled()
        with pytest.raises(TypingError):
            wrong(1.0)
    assert found == [False, False, False]
    assert gc.isenabled()
    gc.disable()
    try:
        njit(lambda x: x - 1.0)(1.0)
        assert not gc.isenabled()
    finally:
        gc.enable()


BOTH = """
import sys, time
from numba.core import event
from mjsim import compiled as module

class Slow(event.Listener):
    def on_start(self, started):
        print("compiles", flush=True)
        time.sleep(float(sys.argv[1]))
    def on_end(self, ended):
        pass

@module.compiled()
def inner(x):
    return x + 1.0

@module.compiled()
def outer(x):
    return 2.0 * inner(x)

print("ready", flush=True)
sys.stdin.readline()
with event.install_listener("numba:compile", Slow()):
    print(outer(1.0), flush=True)
"""


@pytest.fixture
def started(tmp_path: Path):
    """``started(slow)``: a process that calls two functions after a line; each compiles ``slow`` s longer."""
    (tmp_path / "both.py").write_text(BOTH)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    processes: list[subprocess.Popen[str]] = []

    def start(slow: float) -> subprocess.Popen[str]:
        call = [sys.executable, "both.py", str(slow)]
        process = subprocess.Popen(call, cwd=tmp_path, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        processes.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        return process

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def go(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()


def said(process: subprocess.Popen[str]) -> list[str]:
    return process.communicate(timeout=120)[0].split()


def test_of_two_processes_that_need_a_function_one_compiles_it(started, tmp_path: Path):
    one, other = started(1.0), started(1.0)
    go(one)
    go(other)
    assert sorted([said(one), said(other)]) == [["4.0"], ["compiles", "compiles", "4.0"]]
    assert list(tmp_path.rglob("*.lock")) == []


@pytest.mark.slow
def test_a_process_that_is_killed_while_it_compiles_keeps_nobody_waiting(started):
    one, other = started(60.0), started(0.0)
    go(one)
    assert one.stdout is not None
    assert one.stdout.readline() == "compiles\n"
    go(other)
    one.kill()
    assert said(other) == ["compiles", "compiles", "4.0"]


def test_where_files_cannot_be_locked_nobody_waits(tmp_path: Path, monkeypatch):
    held = module._Lock(tmp_path / "lock")
    monkeypatch.setattr(module, "fcntl", None)
    assert module._Lock(tmp_path / "lock").descriptor < 0
    held.free()
    monkeypatch.undo()
    (tmp_path / "file").touch()
    assert module._Lock(tmp_path / "file" / "lock").descriptor < 0  # no folder can be made there


def test_a_process_that_is_suspended_while_it_compiles_is_waited_for_that_long(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(module, "LONGEST", 0.1)
    held = module._Lock(tmp_path / "lock")
    assert held.descriptor >= 0
    assert module._Lock(tmp_path / "lock").descriptor < 0
    held.free()
    free = module._Lock(tmp_path / "lock")
    assert free.descriptor >= 0
    free.free()


def test_what_cannot_be_compiled_frees_its_lock(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))

    @compiled()
    def wrong(x):
        return x + undefined  # type: ignore[name-defined]  # noqa: F821

    for _ in range(2):
        with pytest.raises(TypingError):
            wrong(1.0)
    assert wrong._cache._locks == []
    assert kept_at(wrong).startswith(str(tmp_path))
    assert list(tmp_path.rglob("*.lock")) == []
