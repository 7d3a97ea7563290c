"""``simgap benchmark``: simulate recordings with hidden effects, diagnose them, and score the findings against the truth."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simgap.arguments import Amount, Choice, OutputFolder, take_file, take_folder

if TYPE_CHECKING:
    from lab.benchmark.arms import Arm

__all__ = ["command", "diagnose_all", "diagnose_case", "run_arm", "run_arms", "seal"]


Work = Callable[[Path, str, float, int], dict[str, Any]]  # (recordings, case, seconds, threads) -> diagnosis.json


@click.command("benchmark", epilog="Example: simgap benchmark --out out/benchmark --grade quick --jobs 2")
@click.option("--out", required=True, type=OutputFolder(), help="Folder for recordings, truth, results and page.")
@click.option(
    "--grade", default="quick", show_default=True, type=Choice(["quick", "full"]), help="quick: 25 cases. full: about 660."
)
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0), help="Seed of all cases.")
@click.option("--jobs", type=click.IntRange(1, 256), help="Number of processes (default: two, or one on one core).")
@click.option(
    "--threads",
    default=1,
    show_default=True,
    type=click.IntRange(1, 256),
    help="Threads of one diagnosis. The answer does not depend on their number.",
)
@click.option("--levels", help="Only these levels: LEVEL or LEVEL:COUNT with commas, e.g. plain:4,nothing:2.")
@click.option(
    "--budget",
    type=Amount(0),
    help="Seconds after which the search of a case starts no further fit, 0: no limit (default: 120 for quick, none for full).",
)
@click.option(
    "--first",
    type=click.IntRange(1),
    help="Diagnose and score only this many cases, the first ones. The order is random, so they are a sample of all.",
)
@click.option(
    "--skip",
    default=0,
    show_default=True,
    type=click.IntRange(0),
    help="Skip this many cases, the first ones: those that were examined during development.",
)
@click.option(
    "--arms",
    "arm_list",
    default="none",
    show_default=True,
    help="Other methods to run on the same recordings: all, none, or some of refitted, sysid, box_jenkins, sparse, stepwise_bic.",
)
@click.option(
    "--arm-cases", default=3, show_default=True, type=click.IntRange(1), help="Cases of each level for the other methods."
)
@click.option(
    "--calibration",
    type=click.Path(path_type=Path),
    help="Write the false-alarm rate to this file; diagnoses print that of diagnose/verdict/calibration.json in a checkout.",
)
@click.option("--json", "as_json", is_flag=True, help="Print benchmark.json on standard output.")
def command(
    out: Path,
    grade: str,
    seed: int,
    jobs: int | None,
    threads: int,
    levels: str | None,
    budget: float | None,
    first: int | None,
    skip: int,
    arm_list: str,
    arm_cases: int,
    calibration: Path | None,
    as_json: bool,
) -> None:
    """Measure the rate of correct diagnoses, the smallest effect that is detected, and the false-positive rate.

    A simulator with its own laws and solver writes the recordings. The truth is kept in a separate file whose SHA-256 is
    printed before the first diagnosis. Each case is diagnosed from its CSV files and the nominal model alone. Then the
    findings are scored against the truth. An interrupted run continues where it stopped. On a slow machine a time budget can
    change an answer, so the full grade has none.

    The other methods are optional: `mujoco.sysid` alone takes half a minute per case. They run on the first cases of each
    level, from the same files as the diagnosis.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    import json
    import math

    from ident.serial import write_atomic
    from lab.benchmark.arms import ARMS, parse_arms
    from lab.benchmark.grade import BUDGETS, parse_levels
    from lab.benchmark.resume import plain
    from lab.benchmark.score_rivals import first_cases, score_rivals
    from lab.benchmark.score_table import summarise
    from lab.benchmark.seal import open_envelope

    take_folder(out)
    if calibration is not None:
        take_file(calibration, "choose another --calibration")
    counts, arms = parse_levels(levels, grade), parse_arms(arm_list)
    digest = seal(out, counts, seed, jobs or min(2, os.cpu_count() or 1))
    click.echo(f"Truth written before the first diagnosis: SHA-256 {digest}", err=as_json)
    seconds = BUDGETS[grade] if budget is None else budget or math.inf
    processes = jobs or min(2, os.cpu_count() or 1)
    results = diagnose_all(out, processes, seconds, first=first, skip=skip, threads=threads)
    opened = open_envelope(out / "recordings", out / "envelope" / "truth.json")
    truths = {name: opened[name] for name in results}
    versions: dict[str, str] = next((r["versions"] for r in results.values() if "versions" in r), {})
    about = {
        "grade": grade,
        "seed": seed,
        "counts": counts,
        "first": first,
        "skip": skip,
        "envelope_sha256": digest,
        "versions": versions,
        "budget_s": seconds,
    }
    names = first_cases(truths, arm_cases)
    ran = run_arms(out, arms, names, results, processes)
    rivals = {**score_rivals(truths, results, names, ran), "cases_a_level": arm_cases} if ran else None
    missing = [a.what for a in ARMS.values() if a not in arms]
    summary = plain({**about, **summarise(truths, results), "rivals": rivals, "arms_missing": missing})
    _page(out, summary)
    write_atomic(out / "benchmark.json", json.dumps(summary, indent=1) + "\n")
    if calibration is not None:
        write_atomic(calibration, json.dumps(_calibration(summary), indent=1) + "\n")
    if as_json:
        click.echo(json.dumps(summary, indent=1))
    else:
        _show(summary, out)


def _calibration(summary: dict[str, Any]) -> dict[str, Any]:
    """The false-alarm rate that a diagnosis prints, and its source."""
    from mjsim.errors import InputError

    rate = next(b for b in summary["bars"] if b["id"] == "false_alarms")
    if not rate["n"]:
        raise InputError("--levels", "no case without a missing effect", "nothing and parameters_only", "add these levels")
    low, high = rate["interval"]
    return {
        "share": rate["value"], "low": low, "high": high, "alarms": round(rate["value"] * rate["n"]), "recordings": rate["n"],
        "seed": summary["seed"], "envelope_sha256": summary["envelope_sha256"],
    }  # fmt: skip


def seal(out: Path, counts: dict[str, int], seed: int, jobs: int = 1) -> str:
    """Write recordings and envelope, or find those of an earlier run by the same plan; the envelope's SHA-256."""
    import json

    from ident.serial import write_atomic
    from lab.benchmark.seal import VERSION, write_cases
    from mjsim.errors import InputError

    plan_file, manifest = out / "plan.json", out / "recordings" / "manifest.json"
    plan = {"generator": VERSION, "seed": seed, "counts": counts}
    try:
        out.mkdir(parents=True, exist_ok=True)
        if plan_file.exists() and json.loads(plan_file.read_text(encoding="utf-8")) != plan:
            raise InputError(
                plan_file, "the folder holds the results of another benchmark", f"the plan {plan}", "choose another --out"
            )
        if manifest.exists() and plan_file.exists():
            return str(json.loads(manifest.read_text(encoding="utf-8"))["envelope_sha256"])
        write_atomic(plan_file, json.dumps(plan, indent=1) + "\n")
        click.echo(f"Simulating {sum(counts.values())} cases", err=True)
        return write_cases(out / "recordings", out / "envelope" / "truth.json", counts, seed, jobs=jobs, say=True)
    except OSError as error:
        raise InputError(out, f"cannot be written ({error.strerror})", "a writable folder") from None


def stamp(*, arms: bool = False) -> str:
    """Hash of what a diagnosis, or an arm, follows from besides the recordings: the model, the code, the libraries."""
    import hashlib
    import platform
    from importlib.metadata import PackageNotFoundError, version

    import diagnose
    import ident
    import mjsim
    from lab.benchmark import arms as rivals
    from lab.study import pipeline
    from mjsim.models import shipped_model

    digest = hashlib.sha256(shipped_model("robot_axis1").read_bytes())
    files = [Path(str(package.__file__)).parent for package in ((mjsim, diagnose, ident, rivals) if arms else (mjsim, diagnose))]
    for root in (*files, *((Path(pipeline.__file__),) if arms else ())):
        for path in [root] if root.is_file() else sorted(p for p in root.rglob("*.py") if "report" not in p.parts):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    digest.update(platform.python_version().encode())
    for name in ("numpy", "scipy", "numba", "mujoco", *(("pysindy",) if arms else ())):
        try:
            digest.update(version(name).encode())
        except PackageNotFoundError:
            digest.update(b"none")
    return digest.hexdigest()


def diagnose_case(recordings: Path, name: str, seconds: float = float("inf"), threads: int = 1) -> dict[str, Any]:
    """Diagnose one case from its two CSV files and the shipped nominal model; a failure is a result with ``error``."""
    from diagnose.pipeline import Options, diagnose
    from mjsim.mjcf import load_axis
    from mjsim.models import shipped_model
    from mjsim.recording import load

    model = shipped_model("robot_axis1")
    try:
        estimation, held_out = (load(recordings / f"{name}_{part}.csv", model=model) for part in ("estimation", "held_out"))
        result = diagnose(load_axis(model), [estimation], [held_out], Options(jobs=threads, seconds=seconds)).as_dict()
    except Exception as error:  # one case that breaks must not end the run; it is counted as wrong and listed
        return {"error": f"{type(error).__name__}: {error}"}
    return {**result, "rows": len(estimation)}


def diagnose_all(
    out: Path, jobs: int = 1, seconds: float = float("inf"), work: Work = diagnose_case, first: int | None = None,
    skip: int = 0, threads: int = 1,
) -> dict[str, dict[str, Any]]:  # fmt: skip
    """Results of all cases, or the ``first`` so many after the ``skip`` first ones, by name.

    Those that stand in ``out/diagnoses``, by this code and budget, are not computed again.
    """
    from lab.benchmark.resume import Job, Shelf, sealed_hashes

    recordings = out / "recordings"
    sealed = sealed_hashes(recordings)
    shelf = Shelf(out / "diagnoses", f"{stamp()} {seconds:g} s", sealed)
    return shelf.results([Job(n, work, (recordings, n, seconds, threads)) for n in list(sealed)[skip:][:first]], jobs)


def run_arm(identifier: str, recordings: Path, name: str, diagnosis: dict[str, Any]) -> dict[str, Any]:
    """One rival on one case, from its two CSV files and the shipped nominal model; a failure is a result with ``error``."""
    from lab.benchmark.arms import ARMS, Task
    from mjsim.mjcf import load_axis
    from mjsim.models import shipped_model
    from mjsim.recording import load

    model = shipped_model("robot_axis1")
    estimation, held_out = (load(recordings / f"{name}_{part}.csv", model=model) for part in ("estimation", "held_out"))
    return ARMS[identifier].run(Task(model, load_axis(model), estimation, held_out, diagnosis))


def run_arms(
    out: Path, arms: Sequence[Arm], names: Sequence[str], results: dict[str, dict[str, Any]], jobs: int = 1
) -> list[dict[str, Any]]:
    """Each arm on the cases ``names``, kept in ``out/arms``: plain values for the scorer, and why one was skipped."""
    from lab.benchmark.resume import Job, Shelf, sealed_hashes

    recordings, ran = out / "recordings", []
    sealed = sealed_hashes(recordings)
    for arm in arms:
        about = {"id": arm.id, "what": arm.what, "names": arm.names, "skipped": "", "answers": {}}
        if arm.lacks():
            about["skipped"] = f"{', '.join(arm.lacks())} not installed (pip install 'simgap[bench]')"
            click.echo(f"Method {arm.id} skipped: {about['skipped']}", err=True)
        else:
            shelf = Shelf(out / "arms" / arm.id, stamp(arms=True), sealed, f"method {arm.id}", f"finished by {arm.id}")
            todo = [Job(n, run_arm, (arm.id, recordings, n, {"fit": results[n].get("fit", {})})) for n in names]
            about["answers"] = shelf.results(todo, jobs)
        ran.append(about)
    return ran


def _page(out: Path, summary: dict[str, Any]) -> None:
    """The page and its pictures, in the manner of the diagnosis report."""
    from diagnose.report.components import data_table, theme_button
    from diagnose.report.document import document
    from diagnose.report.figures import number, percent
    from diagnose.report.words import effect_name
    from ident.serial import write_atomic
    from lab.benchmark.page import Manner, render_page

    manner = Manner(number, percent, effect_name, data_table, theme_button(), document)
    page, pictures = render_page(summary, manner)
    for name, picture in pictures.items():
        write_atomic(out / "pictures" / f"{name}.svg", picture)
    write_atomic(out / "benchmark.html", page)


def _show(summary: dict[str, Any], out: Path) -> None:
    """Bars and levels on the terminal."""
    from rich.console import Console
    from rich.table import Table

    from diagnose.report.figures import percent
    from lab.benchmark.score_table import SLOW

    console = Console()
    table = Table("criterion", "required", "result", "95 % interval", "cases", "")
    colours = {"holds": "green", "fails": "red"}
    for b in summary["bars"]:
        limits = " … ".join(percent(x) for x in b["interval"]) if b["share"] and b["interval"] else ""
        colour = colours.get(b["status"], "yellow")
        table.add_row(b["text"], b["asked"], percent(b["value"]), limits, str(b["n"]), f"[{colour}]{b['status']}[/{colour}]")
    console.print(table)
    table = Table("level", "cases", "correct verdict", "correct verdict and effect", "outcomes")
    for level, x in summary["levels"].items():
        ended = ", ".join(f"{k} {v}" for k, v in x["outcomes"].items())
        table.add_row(level, str(x["right"]["n"]), percent(x["verdict"]["share"]), percent(x["right"]["share"]), ended)
    console.print(table)
    if summary["rivals"]:
        table = Table("method, on the first cases of each level", "held-out error / noise", "/ refit", "false alarms", "seconds")
        for a in summary["rivals"]["arms"]:
            alarms = a["false_alarms"]
            said = f"{alarms['hits']} of {alarms['n']}" if alarms else ""
            figures = [f"{v:.3g}" if v is not None else "" for v in (a["all"]["over_noise"], a["all"]["over_refitted"])]
            seconds = f"{a['seconds']:.1f}" if a["seconds"] is not None else ""
            table.add_row(a["what"], *(["skipped", "", "", ""] if a["skipped"] else [*figures, said, seconds]))
        console.print(table)
    for name, text in summary["errors"].items():
        console.print(f"case {name} could not be diagnosed: {text}", highlight=False)
    took = summary["seconds"]
    console.print(
        f"Page: {out / 'benchmark.html'}   (a diagnosis took: median {took['median'] or 0:.0f} s, maximum {took['worst']:.0f} s, "
        f"more than {SLOW:.0f} s in {took['slow']} of {summary['n']} cases; --jobs of them run at the same time)",
        highlight=False,
    )
