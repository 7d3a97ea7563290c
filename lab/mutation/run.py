"""Runs the tests that call a function on each of its mutants, every mutant in a process of its own.

A process is a fork of one that has imported the project: a mutant costs the tests' own time and no start. The tests are run once
on the unchanged code, which tells the functions that each of them calls, and how long it takes.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import resource
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

from lab.mutation.mutants import Mutant, function_at, marked
from mjsim.errors import InputError

__all__ = ["Outcome", "Tests", "judge", "tests_of", "tests_that_import"]

CPU_RATIO = 3.0  # times the tests' own time, beyond the start: a mutant that takes more has run away
WALL_RATIO = 20.0  # of the CPU limit: one that waits for ever
_seen: set[str] = set()


@final
@dataclass(frozen=True)
class Outcome:
    """Whether a test noticed a mutant, and how: ``failed``, ``ran away``, ``survived`` or ``not called`` by any test."""

    mutant: Mutant
    how: str
    seconds: float = 0.0

    @property
    def killed(self) -> bool:
        """Whether a test noticed it."""
        return self.how in ("failed", "ran away")


@final
@dataclass
class Tests:
    """Tests that pass on the unchanged code: CPU time [s] of each, and the functions that it calls."""

    seconds: dict[str, float] = field(default_factory=dict)
    calls: dict[str, list[str]] = field(default_factory=dict)

    def of(self, function: str, most: float) -> list[str]:
        """Tests that call a function, quickest first, until their time reaches ``most`` [s]."""
        out: list[str] = []
        spent = 0.0
        for test in sorted((t for t, called in self.calls.items() if function in called), key=lambda t: self.seconds[t]):
            spent += self.seconds[test]
            if out and spent > most:
                break
            out.append(test)
        return out


@final
class _Recorder:
    """A plugin of pytest that notes what each test calls, and its CPU time; a test is skipped when it takes ``most`` seconds."""

    def __init__(self, tests: Tests, most: float) -> None:
        self.tests, self.most = tests, most
        self.start = 0.0
        signal.signal(signal.SIGPROF, _skip)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        _seen.clear()
        self.start = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, self.most)

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0.0)

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.when == "call" and report.passed:
            self.tests.seconds[report.nodeid] = time.process_time() - self.start
            self.tests.calls[report.nodeid] = sorted(_seen)


def _skip(*_: object) -> None:
    import pytest

    pytest.skip("it takes too long to be run for each mutant")


def see(function: str) -> None:
    """Note that a function was called."""
    _seen.add(function)


def tests_that_import(modules: Sequence[str], root: Path) -> list[str]:
    """Files of tests that import one of the modules."""
    named = re.compile("|".join(rf"\bfrom {re.escape(m)} import|\bimport {re.escape(m)}\b" for m in modules))
    files = sorted((root / "tests").rglob("test_*.py"))
    return [p.relative_to(root).as_posix() for p in files if named.search(p.read_text(encoding="utf-8"))]


def tests_of(functions: Sequence[tuple[str, str]], files: Sequence[str], most: float) -> Tests:
    """The tests of the files that take less than ``most`` seconds, and which of the functions (module, name) each calls."""

    def work() -> dict[str, Any]:
        for module, name in functions:
            call = f"__import__('lab.mutation.run', fromlist=['see']).see('{module}:{name}')"
            function_at(module, name).__code__ = marked(module, name, call)
        tests = Tests()
        code = _pytest([*files], [_Recorder(tests, most)])
        return {"code": int(code), "seconds": tests.seconds, "calls": tests.calls}

    with contextlib.redirect_stdout(io.StringIO()):
        _pytest(["--collect-only", *files], [])  # imports once what each process would import
    _, answer = _forked(work, 3600.0)
    if answer is None or answer["code"] != 0:
        raise InputError("tests", "they fail on the unchanged code", "tests that pass", " ".join(files))
    return Tests(answer["seconds"], answer["calls"])


def judge(mutant: Mutant, tests: Tests, most: float, least_cpu: float) -> Outcome:
    """Run the tests that call a mutant's function, up to ``most`` seconds of them, until one fails.

    least_cpu: CPU time [s] beyond the tests' own that a process may take to start and to end.
    """
    chosen = tests.of(f"{mutant.module}:{mutant.function}", most)
    if not chosen:
        return Outcome(mutant, "not called")

    def work() -> dict[str, Any]:
        function_at(mutant.module, mutant.function).__code__ = mutant.code
        return {"code": int(_pytest(["-x", *chosen], []))}

    start = time.perf_counter()
    limit = least_cpu + CPU_RATIO * sum(tests.seconds[t] for t in chosen)
    ended, answer = _forked(work, limit)
    how = "ran away" if not ended else "failed" if answer is None or answer["code"] != 0 else "survived"
    return Outcome(mutant, how, time.perf_counter() - start)


def _pytest(arguments: Sequence[str], plugins: Sequence[object]) -> int:
    import pytest

    quiet = ["-q", "--no-header", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist"]
    return int(pytest.main([*quiet, *arguments], plugins=list(plugins)))


def _forked(work: Callable[[], dict[str, Any]], limit: float) -> tuple[bool, dict[str, Any] | None]:
    """What a forked process answers, None where it breaks down; and whether it ended within a limit of CPU time [s]."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        _child(work, writing, limit)
    os.close(writing)
    last = time.monotonic() + WALL_RATIO * limit
    try:
        while not (ended := os.waitpid(child, os.WNOHANG))[0]:
            if time.monotonic() > last:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
                return False, None
            time.sleep(0.02)
        with os.fdopen(reading, encoding="utf-8", closefd=False) as pipe:
            text = pipe.read()
    finally:
        os.close(reading)
    if os.WIFSIGNALED(ended[1]) and os.WTERMSIG(ended[1]) in (signal.SIGXCPU, signal.SIGKILL):
        return False, None
    return True, json.loads(text) if text else None


def _child(work: Callable[[], dict[str, Any]], writing: int, limit: float) -> None:
    """Work in silence and leave, without what an interpreter does at its end."""
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(limit), math.ceil(limit) + 1))
        null = os.open(os.devnull, os.O_RDWR)
        for number in (0, 1, 2):
            os.dup2(null, number)
        sys.stdout = sys.stderr = io.StringIO()
        answer = json.dumps(work()).encode()
        os.set_blocking(writing, True)
        with os.fdopen(writing, "wb") as pipe:
            pipe.write(answer)
    finally:
        os._exit(0)
