"""Mutate functions, run the tests that call them, and print which mutants no test notices.

    python -m lab.mutation diagnose.evidence.held_out
    python -m lab.mutation diagnose.verdict.decide:decide --tests tests/diagnose/test_decide.py --out out/mutants.jsonl

Without ``--tests``, the files of tests that import one of the modules are run. With ``--out``, each answer is written as it is
found; the next run takes over what was killed, as long as the function is the same, and asks again only about the others.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import random
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from lab.mutation.mutants import Mutant, function_at, functions_of, mutants_of
from lab.mutation.run import Outcome, judge, tests_of, tests_that_import

__all__ = ["main"]

ROOT = Path(__file__).resolve().parents[2]


@click.command()
@click.argument("names", nargs=-1, required=True, metavar="MODULE[:FUNCTION]...")
@click.option("--tests", multiple=True, help="Files or names of tests; else the files that import a module.")
@click.option(
    "--most", default=8.0, show_default=True, help="CPU time of a test, and of those of one mutant, quickest first [s]."
)
@click.option("--least-cpu", default=10.0, show_default=True, help="CPU time that a mutant may take beyond its tests' own [s].")
@click.option("--limit", default=3600.0, show_default=True, help="Stop after so many seconds.")
@click.option("--sample", type=int, help="Draw so many of all mutants, by the seed.")
@click.option("--seed", default=0, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), help="File to write answers to, and to go on from.")
def main(
    names: Sequence[str],
    tests: Sequence[str],
    most: float,
    least_cpu: float,
    limit: float,
    sample: int | None,
    seed: int,
    out: Path | None,
) -> None:
    """Print the mutants of the functions that survive, and the share that was killed, by module."""
    functions = [pair for name in names for pair in _functions(name)]
    mutants = [m for module, name in functions for m in mutants_of(module, name)]
    if sample is not None and sample < len(mutants):
        mutants = random.Random(seed).sample(mutants, sample)
    known = _killed_before(out)
    files = list(tests) or tests_that_import(sorted({module for module, _ in functions}), ROOT)
    if not files:
        raise click.ClickException("no file of tests imports these modules; name one by --tests")
    click.echo(f"{len(mutants)} mutants of {len(functions)} functions; tests in {len(files)} files")
    found = tests_of(functions, files, most)
    click.echo(f"{len(found.seconds)} tests of less than {most:g} s")
    start = time.monotonic()
    outcomes: list[Outcome] = []
    for mutant in mutants:
        if _identity(mutant) in known:
            outcomes.append(Outcome(mutant, "failed"))
            continue
        if time.monotonic() - start > limit:
            break
        outcomes.append(judge(mutant, found, most, least_cpu))
        if not outcomes[-1].killed:
            click.echo(f"{outcomes[-1].how}: {mutant.module}:{mutant.line} {mutant.function}: {mutant.change}")
        if out is not None:
            _write(out, outcomes[-1])
    for line in _table(outcomes, len(mutants)):
        click.echo(line)


def _functions(name: str) -> list[tuple[str, str]]:
    module, _, function = name.partition(":")
    return [(module, function)] if function else [(module, f) for f in functions_of(module)]


def _identity(mutant: Mutant) -> str:
    """A hash of what was changed, and where in which text of the function."""
    function = function_at(mutant.module, mutant.function)
    lines, first = inspect.getsourcelines(function)
    text = json.dumps([mutant.module, mutant.function, mutant.change, mutant.line - first, lines])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _killed_before(out: Path | None) -> set[str]:
    if out is None or not out.is_file():
        return set()
    rows = [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]
    return {row["id"] for row in rows if row["how"] in ("failed", "ran away")}


def _write(out: Path, outcome: Outcome) -> None:
    m = outcome.mutant
    out.parent.mkdir(parents=True, exist_ok=True)
    row = {"id": _identity(m), "module": m.module, "function": m.function, "line": m.line, "change": m.change, "how": outcome.how}
    with out.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def _table(outcomes: Sequence[Outcome], asked: int) -> Iterator[str]:
    """Killed of all, by module and in all."""
    modules = sorted({o.mutant.module for o in outcomes})
    for module in (*modules, None):
        own = [o for o in outcomes if module is None or o.mutant.module == module]
        if own:
            how = Counter(o.how for o in own)
            killed = sum(o.killed for o in own)
            rest = ", ".join(f"{count} {name}" for name, count in how.most_common() if name != "failed")
            yield f"{module or 'all'}: {killed} of {len(own)} killed ({killed / len(own):.0%}){'; ' + rest if rest else ''}"
    if len(outcomes) < asked:
        yield f"{asked - len(outcomes)} mutants not looked at: --limit"
