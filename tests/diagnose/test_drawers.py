"""Pictures drawn by processes of their own: the same text in the same order, whatever becomes of the processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from diagnose.drawers import Drawers, draw_here
from diagnose.report import pictures
from diagnose.result import StateShare

X = np.linspace(-1.0, 1.0, 20)


def drawing(name: str) -> partial:
    share = StateShare("velocity", "rad/s", 0.5, X, X**3, 0.1 + 0 * X)
    return partial(pictures.states, [share], "N m", name)


@pytest.fixture(scope="module")
def two():
    with Drawers(2) as drawers:
        yield drawers


def test_the_same_pictures_in_the_same_order(two: Drawers) -> None:
    wanted = [drawing("a"), partial(pictures.states, [], "N m", "none"), drawing("b"), drawing("c")]
    drawn = two(wanted)
    assert drawn == draw_here(wanted)
    assert drawn[1] is None
    assert 'id="a-' in str(drawn[0])
    assert 'id="b-' in str(drawn[2])


def test_other_processes_draw_unless_there_is_one_job(two: Drawers) -> None:
    ids = two([os.getpid] * 6)
    assert os.getpid() not in ids
    with Drawers(1) as alone:
        assert alone([os.getpid]) == [os.getpid()]


def test_an_error_of_the_drawing_is_raised_as_if_drawn_here(two: Drawers) -> None:
    with pytest.raises(ValueError, match="no such colour"):
        two([drawing("a"), partial(float, "no such colour")])
    assert two([drawing("a")]) == draw_here([drawing("a")])  # and the processes go on


def test_what_no_other_process_can_be_told_is_drawn_here(two: Drawers) -> None:
    assert two([lambda: "here", drawing("a")]) == ["here", drawing("a")()]


def test_pictures_of_processes_that_have_ended_are_drawn_here() -> None:
    with Drawers(2) as drawers:
        assert drawers([drawing("a")]) == [drawing("a")()]
        for process in drawers._processes:
            process.kill()
            process.wait()
        wanted = [drawing("a"), drawing("b"), drawing("c")]
        assert drawers(wanted) == draw_here(wanted)


def test_no_process_outlives_the_drawing() -> None:
    with Drawers(2) as drawers:
        drawers._starting.join()
        processes = list(drawers._processes)
    assert len(processes) == 2
    assert all(p.returncode is not None for p in processes)
    with Drawers(2):
        pass  # ended while they load


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_interrupted_command_leaves_no_process_and_says_nothing_of_them(tmp_path: Path) -> None:
    code = (
        "import time; from diagnose.drawers import Drawers\n"
        "with Drawers(2) as d:\n    d._starting.join(); print(*[p.pid for p in d._processes], flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert parent.stdout is not None
    pids = [int(p) for p in parent.stdout.readline().split()]
    os.killpg(parent.pid, signal.SIGINT)
    _, said = parent.communicate(timeout=30)
    assert said.count("Traceback") == 1  # the parent's own
    assert len(pids) == 2
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
