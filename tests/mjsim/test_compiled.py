"""Code that is on disk is loaded without what only compiling needs, and compiling works after it as before."""

from __future__ import annotations

import gc
import subprocess
import sys
from pathlib import Path

import pytest
from numba import njit
from numba.core import event
from numba.core.errors import TypingError

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
    run("-c", code)  # where it was not yet compiled it is now
    assert run("-c", code) == "False"


def test_functions_and_callbacks_are_compiled_after_others_were_loaded_and_kept(tmp_path: Path):
    module = tmp_path / "new.py"
    module.write_text(NEW)
    assert run(str(module)) == "15.0 1.5 0 0"
    assert run(str(module)) == "15.0 1.5 1 1"


def test_a_law_is_found_on_disk_by_a_process_that_compiles_nothing():
    code = f"import sys, {creep.__name__} as m; print(m.torque.address != 0, 'numba.np.linalg' in sys.modules)"
    run("-c", code)
    assert run("-c", code) == "True False"


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
