"""`lab.mutation`: what is changed in a function, and which mutants a weak test lets pass."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from lab.mutation.mutants import function_at, functions_of, marked, mutants_of

ROOT = Path(__file__).resolve().parents[1]
TINY = '''
class Level:
    @property
    def double(self) -> int:
        return 2 * self.value

    value = 3


def above(x: float, level: float = 1.0) -> bool:
    """Text with a < b."""
    return x > level and not x == 7


def never_called():
    return -1


def loop():
    n = 0
    while n < 3:
        n += 1
    return n
'''


@pytest.fixture
def tiny(tmp_path, monkeypatch, request):
    name = f"tiny_{request.node.name.split('[')[0]}"
    (tmp_path / f"{name}.py").write_text(TINY)
    monkeypatch.syspath_prepend(tmp_path)
    yield name
    sys.modules.pop(name, None)


def test_functions_of_a_module_are_found(tiny):
    assert functions_of(tiny) == ["Level.double", "above", "never_called", "loop"]
    with pytest.raises(ValueError, match="no function below"):
        function_at(tiny, "below")


def test_operators_numbers_and_conditions_are_changed_one_at_a_time(tiny):
    changes = [(m.line, m.change) for m in mutants_of(tiny, "above")]
    assert changes == [
        (12, "x > level and (not x == 7) -> x > level or not x == 7"),
        (12, "x > level -> x >= level"),
        (12, "x > level -> x <= level"),
        (12, "not x == 7 -> x == 7"),
        (12, "x == 7 -> x != 7"),
        (12, "7 -> 8"),
    ]


def test_a_mutant_runs_in_place_of_the_function(tiny):
    above, double = function_at(tiny, "above"), function_at(tiny, "Level.double")
    by_change = {m.change: m for m in mutants_of(tiny, "above")}
    assert not above(1.0)
    above.__code__ = by_change["x > level -> x >= level"].code
    assert above(1.0), "default values stay"
    owner = type("Owner", (), {"value": 3})
    double.__code__ = next(m.code for m in mutants_of(tiny, "Level.double") if m.change == "2 -> 3")
    assert double(owner()) == 9
    above.__code__ = marked(tiny, "above", "1 / 0")
    with pytest.raises(ZeroDivisionError):
        above(1.0)


@pytest.mark.slow
def test_the_command_tells_what_survives(tmp_path):
    """A test that sees one side of a level alone, a function that no test calls, a loop that does not end."""
    (tmp_path / "tiny.py").write_text(TINY)
    (tmp_path / "test_tiny.py").write_text(
        "import tiny\n\ndef test_above():\n    assert tiny.above(2.0)\n    assert not tiny.above(0.5)\n\n"
        "def test_loop():\n    assert tiny.loop() == 3\n"
    )
    command = [sys.executable, "-m", "lab.mutation", "tiny:above", "tiny:never_called", "tiny:loop", "--tests", "test_tiny.py"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(tmp_path)))}
    out = tmp_path / "mutants.jsonl"

    def run(*more):
        done = subprocess.run(
            [*command, "--out", str(out), *more], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout

    said = run("--least-cpu", "1")
    assert "survived: tiny:12 above: x > level -> x >= level" in said
    assert "survived: tiny:12 above: 7 -> 8" in said
    assert "not called: tiny:16 never_called" in said
    assert "2 tests of less than" in said
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    assert {(r["function"], r["change"]): r["how"] for r in rows}["loop", "n += 1 -> n -= 1"] == "ran away"
    killed = sum(r["how"] in ("failed", "ran away") for r in rows)
    assert f"all: {killed} of {len(rows)} killed" in said
    run()
    assert len(out.read_text().splitlines()) == 2 * len(rows) - killed, "what was killed is not asked again"
