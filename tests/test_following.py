"""Progress where lines stay: of one stage and the same best no more than one line in a while."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from diagnose.progress import Step
from mjsim import notices
from simgap.cli import COMPILING
from simgap.following import following


def test_compiling_beside_the_search_is_told_once_in_a_while(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("simgap.following.time.monotonic", lambda: now[0])
    with following(True) as tell:
        for k in range(40):  # 40 functions within 20 s, while the search goes on
            now[0] = 0.5 * k
            tell(Step("compile", f"the simulation: {k} functions so far"))
            tell(Step("search", "add to the nominal model"))
    said = capsys.readouterr().err.splitlines()
    assert [line.split()[3] for line in said] == ["compile:", "search:", "compile:", "search:"]


def test_who_listens_is_told_once_and_not_where_another_follows():
    told = []
    notices.tell_compiling(lambda kept: told.append(kept))
    with notices.quiet():
        notices.compiling()
    assert told == []
    notices.compiling()
    notices.compiling()
    assert told == [True]


CODE = """
from mjsim.compiled import compiled
from mjsim.notices import tell_compiling
from simgap.cli import COMPILING
tell_compiling(lambda kept: print(COMPILING))
@compiled(cache=True)
def twice(x):
    return 2 * x
print(twice(1.0), twice(2.0))
"""


def test_a_function_that_is_not_on_disk_is_told(tmp_path):
    """The first time it is compiled, and said; the second time it is read."""
    (tmp_path / "code.py").write_text(CODE)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    said = [
        subprocess.run(
            [sys.executable, "code.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    ]
    assert said == [f"{COMPILING}\n2.0 4.0\n", "2.0 4.0\n"]


@pytest.fixture(autouse=True)
def _nobody_listens():
    yield
    notices._LISTENERS.clear()
