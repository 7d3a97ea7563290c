"""A diagnosis followed on standard error: one moving line on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from diagnose.progress import Step

__all__ = ["following"]

SPARING = 15.0  # seconds between two lines of one stage, where lines stay


@contextmanager
def following(on: bool | None, recalled: int = 0) -> Iterator[Callable[[Step], None]]:
    """What to call with each step; ``on``: True: all of them, None: that something is compiled, once, False: nothing.

    ``recalled``: fits that an earlier run left.
    """
    if on is None:
        yield _compiling()
        return
    if not on:
        yield lambda _: None
        return
    if recalled:
        print(f"simgap: going on with {recalled} fits of the run that was broken off", file=sys.stderr)
    if not sys.stderr.isatty():
        yield _lines()
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("reading", total=None)
        yield lambda step: bar.update(task, description=escape(str(step)))


def _compiling() -> Callable[[Step], None]:
    """One line when something is compiled, which takes long enough to wonder."""
    told = False

    def tell(step: Step) -> None:
        nonlocal told
        if step.stage == "compile" and not told:
            told = True
            print(f"simgap: {step}", file=sys.stderr, flush=True)

    return tell


def _lines() -> Callable[[Step], None]:
    """A line when the stage or the best changes, and otherwise no more than one in a while; of compiling always that few."""
    began = time.monotonic()
    told: dict[str, float] = {}

    def tell(step: Step) -> None:
        now = time.monotonic() - began
        head = step.stage if step.stage == "compile" else f"{step.stage} {step.what} {step.best}"
        if now - told.get(head, -SPARING) < SPARING:
            return
        told[head] = now
        print(f"simgap: {now:4.0f} s  {step}", file=sys.stderr, flush=True)

    return tell
