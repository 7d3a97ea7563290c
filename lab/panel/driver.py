"""Diagnoses case after case in one process, with the code of the checkout that PYTHONPATH names.

It is run by its path and knows nothing of the project but ``simgap.pipeline.diagnose_files``, the files of its contract, and
where simulations are counted, so that it runs in any commit. Its argument is JSON: ``tree``, the checkout, ``patches``, and
``watched``, the rules whose acts are counted. It answers a line of JSON on standard output to a line of JSON on standard input.
"""

from __future__ import annotations

import contextlib
import copy
import importlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

__all__ = ["main", "resolve", "switched_off", "watched"]


def resolve(target: str) -> tuple[Any, str]:
    """(owner, attribute) of a dotted path, of which the longest importable part is the module. Raises LookupError."""
    parts = target.split(".")
    for cut in range(len(parts) - 1, 0, -1):
        try:
            owner: Any = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError as error:
            if error.name is None or not f"{'.'.join(parts[:cut])}.".startswith(f"{error.name}."):
                raise  # the module is there, and something that it needs is not
            continue
        for name in parts[cut:-1]:
            if not hasattr(owner, name):
                raise LookupError(f"{target}: there is no {name!r} any more")
            owner = getattr(owner, name)
        if parts[-1] not in (vars(owner) if isinstance(owner, type) else dir(owner)):
            raise LookupError(f"{target}: there is no {parts[-1]!r} any more")
        return owner, parts[-1]
    raise LookupError(f"{target}: no such module")


def _neutral(patch: Mapping[str, Any], old: Any) -> Any:
    """What takes the place of ``old``.

    A ``value``; or a function that ``returns`` a value, a list anew at each call, what stands under a dotted path (``named``), or
    an ``argument``, or a tuple of some.
    """
    if "value" in patch:
        if callable(old):
            raise LookupError(f"{patch['target']}: a function now, and no constant")
        return type(old)(patch["value"]) if old is not None and patch["value"] is not None else patch["value"]
    if not callable(old):
        raise LookupError(f"{patch['target']}: a constant now, and no function")
    if "argument" in patch:
        place = patch["argument"]
        if isinstance(place, list):
            return lambda *given, **_: tuple(given[k] for k in place)
        return lambda *given, **_: given[place]
    if "named" in patch:
        owner, name = resolve(patch["named"])
        return lambda *_, **__: getattr(owner, name)
    return lambda *_, **__: copy.copy(patch["returns"])


def _same(found: Any, neutral: Any) -> bool:
    """Whether an answer is the neutral one: the object itself, or an equal number or list."""
    return found is neutral or (isinstance(neutral, int | float | list) and type(found) is type(neutral) and found == neutral)


@contextlib.contextmanager
def watched(rules: Mapping[str, Sequence[Mapping[str, Any]]], counts: dict[str, int]) -> Iterator[None]:
    """Count, by rule, the calls of its functions whose answer is not the neutral one; everything is as it was at the end.

    A rule that is a constant is not counted. Raises LookupError when a name no longer exists or is of another kind.
    """
    found = []
    for rule, patches in rules.items():
        for patch in patches:
            owner, name = resolve(patch["target"])
            kept = vars(owner)[name] if isinstance(owner, type) else getattr(owner, name)
            neutral = _neutral(patch, kept)
            if "value" not in patch:
                found.append((owner, name, kept, neutral, rule))

    def counting(old: Callable[..., Any], neutral: Callable[..., Any], rule: str) -> Callable[..., Any]:
        def call(*given: Any, **named: Any) -> Any:
            answer = old(*given, **named)
            if not _same(answer, neutral(*given, **named)):
                counts[rule] = counts.get(rule, 0) + 1
            return answer

        return call

    try:
        for owner, name, old, neutral, rule in found:
            setattr(owner, name, counting(old, neutral, rule))
        yield
    finally:
        for owner, name, old, *_ in reversed(found):
            setattr(owner, name, old)


@contextlib.contextmanager
def switched_off(patches: Sequence[Mapping[str, Any]]) -> Iterator[None]:
    """Replace each ``target`` (dotted path) by its neutral value; everything is as it was at the end.

    All are looked up before the first is replaced. Raises LookupError when a name no longer exists or is of another kind.
    """
    found = []
    for patch in patches:
        owner, name = resolve(patch["target"])
        kept = vars(owner)[name] if isinstance(owner, type) else getattr(owner, name)
        found.append((owner, name, kept, _neutral(patch, kept)))
    try:
        for owner, name, _, new in found:
            setattr(owner, name, new)
        yield
    finally:
        for owner, name, old, _ in reversed(found):
            setattr(owner, name, old)


def _counter() -> Callable[[], int | None]:
    """A function that gives the simulations taken since it was last called, None where this commit does not count them.

    ``diagnosis.json`` does not carry the number; the fitter of a diagnosis has it when it is closed.
    """
    taken: list[int] = []
    for name in ("diagnose.fit.fitter", "diagnose.fitter"):
        with contextlib.suppress(ModuleNotFoundError):
            fitter: Any = importlib.import_module(name).Fitter
            close = fitter.close

            def counted(self: Any, close: Callable[[Any], None] = close) -> None:
                taken.append(int(self.runs))
                close(self)

            fitter.close = counted
            break

    def since() -> int | None:
        total = sum(taken) if taken else None
        taken.clear()
        return total

    return since


def _without_page() -> None:
    """The page is no part of an answer, and drawing it takes longer than many a diagnosis."""
    with contextlib.suppress(ImportError, AttributeError):
        report: Any = importlib.import_module("diagnose.report")
        report.write_report = lambda *_, **__: None


def _diagnose(asked: Mapping[str, Any], count: Callable[[], int | None]) -> dict[str, Any]:
    """One case: ``seconds``, ``cpu_seconds``, ``simulations``, and ``error`` where there is one."""
    pipeline: Any = importlib.import_module("simgap.pipeline")
    folder = Path(asked["folder"])
    began, cpu = time.monotonic(), time.process_time()
    said: dict[str, Any] = {}
    try:
        pipeline.diagnose_files(
            [folder / name for name in asked["estimation"]], folder / asked["model"], Path(asked["out"]),
            [folder / name for name in asked["held_out"]], pipeline.Options(jobs=1, **asked["options"]), progress=False,
        )  # fmt: skip
    except Exception as error:  # a case that breaks is an answer of its own, and must not end the run
        said["error"] = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    return {**said, "seconds": time.monotonic() - began, "cpu_seconds": time.process_time() - cpu, "simulations": count()}


def main() -> None:
    """Answer until standard input ends."""
    asked = json.loads(sys.argv[1])
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a commit prints does not mix with the answers
    try:
        pipeline = importlib.import_module("simgap.pipeline")
        where = Path(str(pipeline.__file__)).resolve()
        if not where.is_relative_to(Path(asked["tree"]).resolve()):
            raise LookupError(f"simgap is imported from {where.parent}, not from the checkout")
        count = _counter()
        _without_page()
        acted: dict[str, int] = {}
        with switched_off(asked["patches"]), watched(asked.get("watched", {}), acted):
            print(json.dumps({"ready": True}), file=answers, flush=True)
            for line in sys.stdin:
                acted.clear()
                print(json.dumps({**_diagnose(json.loads(line), count), "acted": acted}), file=answers, flush=True)
    except (LookupError, ImportError) as error:
        print(json.dumps({"ready": False, "error": str(error)}), file=answers, flush=True)


if __name__ == "__main__":
    main()
