"""``python -m lab.panel``: run, compare, ablate, kernels."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from ident.serial import write_atomic
from lab.benchmark.resume import plain
from lab.panel.ablate import ablate, ablation_table
from lab.panel.catalogue import all_cases, choose, quick_cases, select, strata
from lab.panel.compare import compare, markdown
from lab.panel.kernels import KERNELS, differs, under_kernels
from lab.panel.record import read_answers, write_answers
from lab.panel.rules import RULES, patches_of, rules_of
from lab.panel.run import LIMIT, Ran, Setting, run_cases
from lab.panel.tree import Tree, at_commit, checkout, here
from mjsim.errors import InputError

__all__ = ["main"]

PANEL = Path("out") / "panel"
CAP = 50.0  # [s] of CPU time: seven such cases fill half of what two cores have in six minutes


def _say(text: str) -> None:
    click.echo(text, err=True)


@contextmanager
def _code(tree: Path | None, commit: str | None, cache: Path) -> Iterator[Tree]:
    """The code that is run: this checkout unless another one, or a commit, is named."""
    if tree is not None and commit is not None:
        raise InputError("--tree and --commit", "both are given", "one of them")
    if commit is None:
        yield checkout(tree or here())
    else:
        with at_commit(commit, cache.parent / "trees") as there:
            yield there


def _cases(quick: bool, names: tuple[str, ...]) -> list[Any]:
    if names:
        return select(names)
    return quick_cases() if quick else list(all_cases())


OPTIONS = (
    click.option("--quick", is_flag=True, help="The quick subset only."),
    click.option("--case", "names", multiple=True, help="This case only; may be repeated."),
    click.option("--tree", type=click.Path(path_type=Path, exists=True, file_okay=False), help="Checkout to run [this one]."),
    click.option("--commit", help="Run this commit, in a git worktree that is removed at the end."),
    click.option("--jobs", type=click.IntRange(1, 256), default=os.cpu_count() or 1, show_default=True, help="Processes."),
    click.option("--cache", type=click.Path(path_type=Path), default=PANEL / "cases", show_default=True, help="Files of cases."),
    click.option("--limit", type=click.FloatRange(1), default=LIMIT, show_default=True, help="Seconds until a case is an error."),
)


def _with_options(command: Callable[..., Any]) -> Callable[..., Any]:
    for option in reversed(OPTIONS):
        command = option(command)
    return command


@click.group()
def panel() -> None:
    """Regression panel: the same recordings by another commit, or by one rule less."""


@panel.command("list")
@click.option("--quick", is_flag=True, help="The quick subset only.")
def list_(quick: bool) -> None:
    """Names of the cases, with origin and level."""
    for case in _cases(quick, ()):
        click.echo(f"{case.id}  {case.stratum}")


@panel.command()
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the records.")
@_with_options
@click.option("--again", is_flag=True, help="Cases that ended with an error are run again.")
@click.option("--watch", is_flag=True, help="Count in which cases each rule of the search acts.")
@click.option("--answers", type=click.Path(path_type=Path, dir_okay=False), help="Also write them to this file, one line a case.")
def run(
    out: Path, quick: bool, names: tuple[str, ...], tree: Path | None, commit: str | None, jobs: int, cache: Path, limit: float,
    again: bool, watch: bool, answers: Path | None,
) -> None:  # fmt: skip
    """Diagnose the cases; the same call goes on where it was broken off.

    Example: python -m lab.panel run --quick --commit HEAD~1 --out out/panel/before
    """
    with _code(tree, commit, cache) as code:
        setting = Setting(code, cache, limit=limit, again=again, watched=patches_of(RULES.values()) if watch else {})
        ran = run_cases(_cases(quick, names), out, setting, jobs, _say)
        _summary(ran)
        for name in RULES if watch else ():
            cases = sorted(r.case for r in ran.records.values() if r.acted.get(name))
            click.echo(f"{name} acts in {len(cases)} cases: {', '.join(cases)}")
        if answers is not None:
            write_answers(answers, list(ran.records.values()), {"commit": code.commit})


def _summary(ran: Ran) -> None:
    records = list(ran.records.values())
    known = [r for r in records if r.good is not None]
    click.echo(
        f"{len(records)} answers, {ran.kept} of them from before; right {sum(bool(r.good) for r in known)} of {len(known)}"
    )
    for name, why in sorted(ran.absent.items()):
        click.echo(f"{name} was left out: {why}")


@panel.command("compare")
@click.argument("before", type=click.Path(path_type=Path))
@click.argument("after", type=click.Path(path_type=Path))
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), help="Write all figures to this file.")
@click.option("--markdown", "text_file", type=click.Path(path_type=Path, dir_okay=False), help="Write the tables to this file.")
def compare_(before: Path, after: Path, json_file: Path | None, text_file: Path | None) -> None:
    """Compare two runs, or files of answers, case by case; exit 1 on a significant loss or more false alarms.

    Example: python -m lab.panel compare lab/panel/answers/a8a8fdb.json out/panel/now
    """
    found = compare(read_answers(before), read_answers(after))
    text = markdown(found, _called(before), _called(after))
    click.echo(text)
    if text_file is not None:
        write_atomic(text_file, text)
    if json_file is not None:
        write_atomic(json_file, json.dumps(plain(found.as_dict()), indent=1) + "\n")
    if found.fails:
        sys.exit(1)


def _called(path: Path) -> str:
    return path.stem if path.suffix == ".json" else path.name


@panel.command("ablate")
@click.argument("names_of_rules", metavar="RULE...", nargs=-1)
@click.option("--list", "show", is_flag=True, help="Print the rules, and what each does.")
@click.option("--every", is_flag=True, help="Every rule, one after the other.")
@click.option("--out", type=click.Path(path_type=Path), default=PANEL / "ablation", show_default=True, help="Folder of the runs.")
@_with_options
def ablate_(
    names_of_rules: tuple[str, ...], show: bool, every: bool, out: Path, quick: bool, names: tuple[str, ...], tree: Path | None,
    commit: str | None, jobs: int, cache: Path, limit: float,
) -> None:  # fmt: skip
    """Switch rules off, one at a time, and say what each changes.

    Example: python -m lab.panel ablate model_variants decimation --quick
    """
    if show:
        for rule in RULES.values():
            click.echo(f"{rule.name:20s} {rule.what}")
        return
    rules = list(RULES.values()) if every else rules_of(names_of_rules)
    if not rules:
        raise InputError("ablate", "no rule is named", f"one of {', '.join(RULES)}", "name rules, or give --every")
    with _code(tree, commit, cache) as code:
        found = ablate(rules, _cases(quick, names), out, Setting(code, cache, limit=limit), jobs, _say)
    click.echo(ablation_table(found))


@panel.command("kernels")
@click.option("--kernels", "kernels", multiple=True, default=KERNELS, show_default=True, help="OPENBLAS_CORETYPE; two or more.")
@click.option("--out", type=click.Path(path_type=Path), default=PANEL / "kernels", show_default=True, help="Folder of the runs.")
@_with_options
def kernels_(
    kernels: tuple[str, ...], out: Path, quick: bool, names: tuple[str, ...], tree: Path | None, commit: str | None, jobs: int,
    cache: Path, limit: float,
) -> None:  # fmt: skip
    """Diagnose the cases under several kernels of OpenBLAS and compare the answers; exit 1 where one depends on them.

    Example: python -m lab.panel kernels --quick
    """
    if len(set(kernels)) < 2:
        raise InputError("--kernels", ", ".join(kernels), "two different ones", f"such as {' and '.join(KERNELS)}")
    with _code(tree, commit, cache) as code:
        found = under_kernels(kernels, _cases(quick, names), out, Setting(code, cache, limit=limit), jobs, _say)
    for name, comparison in found.items():
        click.echo(markdown(comparison, kernels[0], name))
    if differs(found):
        sys.exit(1)


@panel.command("collect")
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
def collect(folder: Path, file: Path) -> None:
    """Write the answers of a run, finished or not, to a file: one line a case.

    Example: python -m lab.panel collect out/panel/now lab/panel/answers/abc123.json
    """
    records = list(read_answers(folder).values())
    commits = sorted({r.commit for r in records})
    if len(commits) != 1:
        raise InputError(folder, f"answers of {', '.join(commits)}", "one commit", "run the cases again by one of them")
    write_answers(file, records, {"commit": commits[0], "of": len(all_cases())})
    click.echo(f"{len(records)} of {len(all_cases())} answers, commit {commits[0]}")


@panel.command("choose")
@click.argument("answers", type=click.Path(path_type=Path, exists=True))
@click.option("--cap", type=click.FloatRange(0), default=CAP, show_default=True, help="Seconds of CPU time a case may take.")
def choose_(answers: Path, cap: float) -> None:
    """Print the quick subset that follows from measured times: the first cases of each stratum in the order of a hash.

    Example: python -m lab.panel choose lab/panel/answers/a8a8fdb.json
    """
    measured = {name: r.cpu_seconds for name, r in read_answers(answers).items()}
    chosen = choose(strata(), measured, cap)
    click.echo(json.dumps(chosen, indent=1))
    known = [measured[name] for name in chosen if name in measured]
    _say(f"{len(chosen)} cases, {sum(known):.0f} s of CPU time for the {len(known)} that were measured")


def main() -> None:
    """The command line: exit 1 on a loss, 2 on bad input, with one line that says what."""
    try:
        panel(prog_name="python -m lab.panel")
    except InputError as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(2)
