"""Pictures drawn by a process of their own and its forks: the same text in the same order, whatever becomes of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest

from diagnose.report import pictures
from diagnose.report.render_worker import Drawers, draw_here
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


def elsewhere(pid: int, do: partial) -> str:
    return str(do()) if os.getpid() != pid else "here"


def test_pictures_of_a_process_that_has_ended_are_drawn_here() -> None:
    with Drawers(2) as drawers:
        wanted = [drawing("a"), partial(elsewhere, os.getpid(), partial(os._exit, 1)), drawing("b")]
        assert drawers(wanted) == [drawing("a")(), "here", drawing("b")()]
        assert drawers._process is not None
        drawers._process.kill()
        drawers._process.wait()
        wanted = [drawing("a"), drawing("b"), drawing("c")]
        assert drawers(wanted) == draw_here(wanted)


def at_work(group: int) -> int:
    """Processes of a group, but those that have ended and that nobody has asked after."""
    listed = subprocess.run(["ps", "-e", "-o", "pgid=,stat="], capture_output=True, text=True, check=True).stdout
    return sum(int(of) == group and not state.startswith("Z") for of, state in map(str.split, listed.splitlines()))


def test_it_may_be_closed_while_it_loads() -> None:
    drawers = Drawers(2)
    process = drawers._process
    assert process is not None
    drawers.close()
    assert process.returncode is not None
    drawers.close()


@pytest.mark.skipif(sys.platform != "linux", reason="forks draw on Linux")
def test_a_command_that_is_interrupted_while_it_draws_leaves_no_process_and_says_nothing_of_them() -> None:
    code = (
        "import signal, time; from functools import partial; from diagnose.report.render_worker import Drawers\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell has it ignored in a background job
        "with Drawers(2) as d:\n    print(d._process.pid, flush=True); d([partial(time.sleep, 60)] * 2)"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert parent.stdout is not None
    group = int(parent.stdout.readline())
    deadline = time.monotonic() + 60
    while at_work(group) < 3:
        assert time.monotonic() < deadline, "the pictures are not drawn side by side"
        time.sleep(0.02)
    os.killpg(parent.pid, signal.SIGINT)
    _, said = parent.communicate(timeout=30)
    assert said.count("Traceback") == 1  # the parent's own
    while at_work(group):  # what was killed takes a moment
        assert time.monotonic() < deadline, "processes outlive the command"
        time.sleep(0.02)
