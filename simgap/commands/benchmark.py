"""``simgap benchmark``: seal recordings with concealed effects, diagnose them, open the envelope, score."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

__all__ = ["command", "diagnose_all", "diagnose_case", "seal"]


Work = Callable[[Path, str, float], dict[str, Any]]  # (recordings, case, seconds) -> diagnosis.json


@click.command("benchmark", epilog="Example: simgap benchmark --out out/benchmark --grade quick --jobs 2")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for recordings, envelope, results and page.")
@click.option("--grade", default="quick", show_default=True, type=click.Choice(["quick", "full"]), help="24 or some 500 cases.")
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0), help="Draws every case.")
@click.option("--jobs", type=click.IntRange(1, 256), help="Processes side by side (default: two, or one on one core).")
@click.option("--levels", help="Only these, LEVEL or LEVEL:COUNT with commas, e.g. plain:4,nothing:2.")
@click.option(
    "--budget",
    type=click.FloatRange(0),
    help="Seconds a case may search, 0: no limit (default: 120 for quick, no limit for full).",
)
@click.option("--json", "as_json", is_flag=True, help="Print benchmark.json on standard output.")
def command(out: Path, grade: str, seed: int, jobs: int | None, levels: str | None, budget: float | None, as_json: bool) -> None:
    """Measure how often the diagnosis is right, how small an effect it sees, and how often it cries wolf.

    A generator with its own laws and solver writes recordings; the truth goes into an envelope whose SHA-256 is printed before
    any diagnosis begins. Each case is diagnosed from its CSV files and the nominal model alone. Then the envelope is
    opened and the findings are scored. A run that was broken off goes on where it stopped. A case whose budget is spent tries no
    further structure: on a slow machine a budget can change the answer, so the full grade has none.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    import json
    import math

    from ident.serial import write_atomic
    from simgap.benchmark.grade import BUDGETS, parse_levels
    from simgap.benchmark.score_table import summarise
    from simgap.benchmark.seal import open_envelope

    counts = parse_levels(levels, grade)
    digest = seal(out, counts, seed)
    click.echo(f"Envelope sealed before any diagnosis: SHA-256 {digest}", err=as_json)
    seconds = BUDGETS[grade] if budget is None else budget or math.inf
    results = diagnose_all(out, jobs or min(2, os.cpu_count() or 1), seconds)
    truths = open_envelope(out / "recordings", out / "envelope" / "truth.json")
    versions: dict[str, str] = next((r["versions"] for r in results.values() if "versions" in r), {})
    about = {"grade": grade, "seed": seed, "counts": counts, "envelope_sha256": digest, "versions": versions, "budget_s": seconds}
    summary = _plain({**about, **summarise(truths, results)})
    _page(out, summary)
    write_atomic(out / "benchmark.json", json.dumps(summary, indent=1) + "\n")
    if as_json:
        click.echo(json.dumps(summary, indent=1))
    else:
        _show(summary, out)


def seal(out: Path, counts: dict[str, int], seed: int) -> str:
    """Write recordings and envelope, or find those of an earlier run by the same plan; the envelope's SHA-256."""
    import json

    from ident.serial import write_atomic
    from mjsim.errors import InputError
    from simgap.benchmark.seal import VERSION, write_cases

    plan_file, manifest = out / "plan.json", out / "recordings" / "manifest.json"
    plan = {"generator": VERSION, "seed": seed, "counts": counts}
    try:
        out.mkdir(parents=True, exist_ok=True)
        if plan_file.exists() and json.loads(plan_file.read_text(encoding="utf-8")) != plan:
            raise InputError(plan_file, "the folder holds another benchmark", f"the plan {plan}", "choose another --out")
        if manifest.exists() and plan_file.exists():
            return str(json.loads(manifest.read_text(encoding="utf-8"))["envelope_sha256"])
        write_atomic(plan_file, json.dumps(plan, indent=1) + "\n")
        click.echo(f"Sealing {sum(counts.values())} cases", err=True)
        return write_cases(out / "recordings", out / "envelope" / "truth.json", counts, seed, say=True)
    except OSError as error:
        raise InputError(out, f"cannot write there ({error.strerror})", "a folder that can be written") from None


def stamp() -> str:
    """Hash of what a diagnosis follows from besides the recordings: the model, the code, the libraries."""
    import hashlib
    import platform
    from importlib.metadata import version

    import diagnose
    import mjsim
    from mjsim.models import shipped_model

    digest = hashlib.sha256(shipped_model("robot_axis1").read_bytes())
    for package in (mjsim, diagnose):
        root = Path(str(package.__file__)).parent
        for path in sorted(p for p in root.rglob("*.py") if "report" not in p.parts):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    for text in (platform.python_version(), *(version(n) for n in ("numpy", "scipy", "numba", "mujoco"))):
        digest.update(text.encode())
    return digest.hexdigest()


def diagnose_case(recordings: Path, name: str, seconds: float = float("inf")) -> dict[str, Any]:
    """Diagnose one case from its two CSV files and the shipped nominal model; a failure is a result with ``error``."""
    from diagnose.flow import Options, diagnose
    from mjsim.mjcf import load_axis
    from mjsim.models import shipped_model
    from mjsim.recording import load

    model = shipped_model("robot_axis1")
    try:
        estimation, held_out = (load(recordings / f"{name}_{part}.csv", model=model) for part in ("estimation", "held_out"))
        result = diagnose(load_axis(model), [estimation], [held_out], Options(jobs=1, seconds=seconds)).as_dict()
    except Exception as error:  # one case that breaks must not end the run; it is counted as wrong and listed
        return {"error": f"{type(error).__name__}: {error}"}
    return {**result, "rows": len(estimation)}


def diagnose_all(out: Path, jobs: int = 1, seconds: float = float("inf"), work: Work = diagnose_case) -> dict[str, dict]:
    """Results of all cases by name; those that stand in ``out/diagnoses``, by this code and budget, are not computed again."""
    import json

    from ident.serial import write_atomic

    recordings, folder, mark = out / "recordings", out / "diagnoses", f"{stamp()} {seconds:g} s"
    manifest = json.loads((recordings / "manifest.json").read_text(encoding="utf-8"))
    sealed = {n: {k: v for k, v in manifest["recordings"].items() if k.startswith(f"{n}_")} for n in manifest["cases"]}
    done: dict[str, dict] = {}
    other = 0
    for name in sealed:
        try:
            kept = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
            if kept["stamp"] == mark and kept["sealed"] == sealed[name]:
                done[name] = kept["result"]
            else:
                other += 1
        except (OSError, ValueError, KeyError, TypeError):
            continue
    if done:
        click.echo(f"{len(done)} of {len(sealed)} cases were diagnosed before", err=True)
    if other:
        click.echo(f"{other} results are of other code or another budget and are computed again", err=True)

    def keep(name: str, result: dict[str, Any]) -> None:
        done[name] = _plain(result)
        kept = {"case": name, "stamp": mark, "sealed": sealed[name], "result": done[name]}
        write_atomic(folder / f"{name}.json", json.dumps(kept, indent=1) + "\n")

    left = [n for n in sealed if n not in done]
    with _bar(len(sealed), len(done)) as tick:
        for name, result in _each(recordings, left, jobs, seconds, work):
            keep(name, result)
            tick(f"case {name}: {result.get('verdict', 'error')}")
    return {n: done[n] for n in sealed}


def _each(recordings: Path, names: list[str], jobs: int, seconds: float, work: Work) -> Iterator[tuple[str, dict[str, Any]]]:
    """Results as they come, ``jobs`` processes side by side."""
    if jobs <= 1 or len(names) < 2:
        for name in names:
            yield name, work(recordings, name, seconds)
        return
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before the workers import numpy
        os.environ.setdefault(variable, "1")
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(work, recordings, n, seconds): n for n in names}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@contextmanager
def _bar(total: int, done: int) -> Iterator[Callable[[str], None]]:
    """Progress on standard error."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("diagnosing", total=total, completed=done)
        yield lambda text: bar.update(task, description=text, advance=1)


def _plain(value: Any) -> Any:
    """JSON has no numpy numbers and no numbers that are not finite."""
    import math

    import numpy as np

    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _page(out: Path, summary: dict[str, Any]) -> None:
    """The page and its pictures, in the manner of the diagnosis report."""
    from importlib.resources import files

    from diagnose.report.figures import number, percent
    from diagnose.report.words import effect_name
    from ident.serial import write_atomic
    from simgap.benchmark.page import Manner, render_page

    css = (files("diagnose.report") / "page.css").read_text(encoding="utf-8")
    page, pictures = render_page(summary, Manner(css, number, percent, effect_name))
    for name, picture in pictures.items():
        write_atomic(out / "pictures" / f"{name}.svg", picture)
    write_atomic(out / "benchmark.html", page)


def _show(summary: dict[str, Any], out: Path) -> None:
    """Bars and levels on the terminal."""
    from rich.console import Console
    from rich.table import Table

    from diagnose.report.figures import percent

    console = Console()
    table = Table("bar", "asked", "figure", "95 % interval", "of", "")
    colours = {"holds": "green", "fails": "red"}
    for b in summary["bars"]:
        limits = " … ".join(percent(x) for x in b["interval"]) if b["share"] and b["interval"] else ""
        colour = colours.get(b["status"], "yellow")
        table.add_row(b["text"], b["asked"], percent(b["value"]), limits, str(b["n"]), f"[{colour}]{b['status']}[/{colour}]")
    console.print(table)
    table = Table("level", "cases", "verdict right", "verdict and effect right", "how they ended")
    for level, x in summary["levels"].items():
        ended = ", ".join(f"{k} {v}" for k, v in x["outcomes"].items())
        table.add_row(level, str(x["right"]["n"]), percent(x["verdict"]["share"]), percent(x["right"]["share"]), ended)
    console.print(table)
    for name, text in summary["errors"].items():
        console.print(f"case {name} could not be diagnosed: {text}", highlight=False)
    console.print(f"Page: {out / 'benchmark.html'}   ({summary['seconds']['median'] or 0:.0f} s a case)", highlight=False)
