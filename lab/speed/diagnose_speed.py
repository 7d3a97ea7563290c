"""Wall time and peak memory of ``simgap diagnose``: ``python lab/speed/diagnose_speed.py [--json FILE]``; exit 1 on a miss.

    python lab/speed/diagnose_speed.py --repeat 3

Four axes of the sealed plant for a fixed seed, each recorded for 10 s and for 20 s at 2 kHz: Coulomb friction, nothing missing,
two effects, Coulomb friction under coloured noise. Each is diagnosed by the command as a user would call it, full library, no
budget, in a process of its own: wall time from call to exit (imports and the loading of compiled code included), processor time
and peak resident memory as the system accounts them. One run ahead of the clock fills the cache of compiled code.

A bar is judged on the slowest of the four axes, each by its median; a gain of ``--jobs 2`` by the sum over the medians of the
axes. What the fastest of the turns gives is told beside it and judges nothing: what else the machine does only adds to a time,
and whichever of two threads it slows delays both. So is what a loop without memory or locks gains from a second thread: where
that is below 1.8 the machine had no second core to give. Then the gain stays open, and so does a wall time that misses, unless
half its processor time misses too. The rival of the gain is what many recordings gain: two diagnoses at once, one job each, over
one after the other.

Starting up (imports, compiled code) and drawing the report take about two seconds that no second core shortens, whatever the
length: ``--seconds 10 20 60`` shows what the gain grows to. For 60 s neither wall time nor memory is asked. What the second core
does for the diagnosis itself is measured apart, in a process that has diagnosed before, as one that serves a thousand logs has.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from second_core import spin_on

from diagnose.pipeline import Options
from diagnose.pipeline import diagnose as search
from lab.benchmark.catalogue import compose, find
from lab.benchmark.experiment import chirp, multisine
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import record
from lab.benchmark.seal import write_motion
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.recording import load

SEED = 20
WALL = {10.0: 30.0, 20.0: 60.0}  # length of the recording: bar [s]
LENGTHS = (*WALL, 60.0)
MEMORY = 1.5  # [GB]
GAIN = 1.7  # of two jobs over one
BUSY = 1.8  # an empty loop gains less from a second thread: the machine is busy
LINEAR = {"Jm": 1.03, "Jg": 0.98, "Ja": 1.04, "fm": 1.05, "kg": 0.97, "ka": 1.02, "dg": 0.95, "da": 1.05}


@dataclass(frozen=True)
class Axis:
    """What is concealed, by effect and place, and the poles of the velocity noise."""

    name: str
    effects: tuple[tuple[str, str, dict[str, float]], ...]
    poles: tuple[complex, ...] = ()


COULOMB = ("coulomb_friction", "motor", {"torque_Nm": 0.08})
AXES = (
    Axis("Coulomb friction", (COULOMB,)),
    Axis("nothing missing", ()),
    Axis("two effects", (COULOMB, ("hardening_stiffness", "arm", {"coefficient_Nm_rad3": 2e9}))),
    Axis("Coulomb friction, coloured noise", (COULOMB,), (0.9 + 0j,)),
)


@dataclass(frozen=True)
class Run:
    """One call of the command: wall and processor time [s], peak resident memory [GB], what it answered."""

    wall: float
    processor: float
    memory: float
    answer: str


def write(folder: Path, axis: Axis, seconds: float) -> tuple[Path, Path]:
    """Record an axis by a chirp, and by a multisine to hold out; the two files."""
    rng = np.random.default_rng([SEED, round(seconds), AXES.index(axis)])
    nominal = Laws()
    laws = nominal._replace(**{n: getattr(nominal, n) * f for n, f in LINEAR.items()})
    for effect, place, values in axis.effects:
        laws = compose(laws, find(effect, place), values)
    measurement = Measurement(velocity_noise=0.05, poles=axis.poles)
    stem = f"{AXES.index(axis)}_{seconds:g}s"
    files = folder / f"{stem}_estimation.csv", folder / f"{stem}_held_out.csv"
    for path, experiment in zip(files, (chirp(seconds, 1.0, 0.5, 30.0), multisine(seconds, 0.6, 0.1, 30.0, rng)), strict=True):
        write_motion(path, record(laws, experiment, measurement, rng))
    return files


def diagnose(files: tuple[Path, Path], jobs: int, out: Path) -> Run:
    """Call the command, wait for it, and ask the system what it took."""
    call = [sys.executable, "-m", "simgap", "diagnose", str(files[0]), "--held-out", str(files[1])]
    call += ["--model", str(shipped_model("robot_axis1")), "--out", str(out), "--jobs", str(jobs), "--quiet"]
    began = time.perf_counter()
    process = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr is not None
    said = process.stderr.read().decode(errors="replace")
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - began
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(call)}: exit {process.returncode}: {said.strip()[-300:]}")
    result = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    found = " + ".join(f"{f['effect']}@{f['place']}" for f in result["findings"])
    unit = 1 if sys.platform == "darwin" else 1024  # ru_maxrss is in bytes there, in KiB elsewhere
    return Run(
        wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * unit / 1e9, " ".join(x for x in (result["verdict"], found) if x)
    )


def two_at_once(files: tuple[Path, Path], folder: Path) -> float:
    """Wall time [s] of two diagnoses of the same recording at once, one job each."""
    began = time.perf_counter()
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda i: diagnose(files, 1, folder / f"out{i}"), range(2)))
    return time.perf_counter() - began


def itself(files: tuple[Path, Path], jobs: int) -> float:
    """Wall time [s] of the diagnosis without start-up, reading and report; in a process of its own, where all code is loaded."""
    model = shipped_model("robot_axis1")
    axis, (estimation, held_out) = load_axis(model), (load(path, model=model) for path in files)
    began = time.perf_counter()
    search(axis, [estimation], [held_out], Options(jobs=jobs), lambda said: None)
    return time.perf_counter() - began


def second_thread() -> float:
    """What an empty loop gains from a second thread."""

    def seconds(threads: int) -> float:
        began = time.perf_counter()
        spin_on(threads)
        return time.perf_counter() - began

    seconds(1)  # compiles
    return min(seconds(1) for _ in range(3)) / min(seconds(2) for _ in range(3))


def measure(lengths: Sequence[float], repeat: int, say: Callable[[str], None]) -> tuple[list[dict], list[float]]:
    """Every axis, length and number of jobs ``repeat`` times, in turns; and the empty loop's gain before each turn."""
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # as its users have it: no command compiles the sources anew
    rows: dict[tuple[float, str, int], list[Run]] = {}
    loaded: dict[tuple[float, str, int], list[float]] = {}
    pairs: dict[tuple[float, str], list[float]] = {}
    machine = []
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as work, ProcessPoolExecutor(1, mp_context=spawn) as one_process:
        folder = Path(work)
        files = {(s, a.name): write(folder, a, s) for s in lengths for a in AXES}
        say("a run ahead of the clock")
        diagnose(files[lengths[0], AXES[0].name], 2, folder / "out")
        one_process.submit(itself, files[lengths[0], AXES[0].name], 2).result()
        for turn in range(repeat):
            machine.append(second_thread())
            for (seconds, name), pair in files.items():
                for jobs in (1, 2):
                    run = diagnose(pair, jobs, folder / "out")
                    rows.setdefault((seconds, name, jobs), []).append(run)
                    alone = one_process.submit(itself, pair, jobs).result()
                    loaded.setdefault((seconds, name, jobs), []).append(alone)
                    said = f"{run.wall:.1f} s, the diagnosis itself {alone:.1f} s  {run.answer}"
                    say(f"{turn + 1}/{repeat}  {seconds:g} s  {name}  --jobs {jobs}: {said}")
                pairs.setdefault((seconds, name), []).append(two_at_once(pair, folder))
                say(f"{turn + 1}/{repeat}  {seconds:g} s  {name}  two at once: {pairs[seconds, name][-1]:.1f} s")
    return [
        {
            "seconds": seconds, "axis": name, "jobs": jobs, "wall_s": statistics.median(r.wall for r in runs),
            "walls_s": [r.wall for r in runs], "two_at_once_s": statistics.median(pairs[seconds, name]),
            "itself_s": statistics.median(loaded[seconds, name, jobs]), "itselfs_s": loaded[seconds, name, jobs],
            "processor_s": statistics.median(r.processor for r in runs),
            "memory_GB": max(r.memory for r in runs), "answer": runs[0].answer,
        }
        for (seconds, name, jobs), runs in rows.items()
    ], machine  # fmt: skip


def judge(rows: list[dict], machine: float) -> list[dict]:
    """The bars by the rows."""
    results: list[dict] = []

    def bar(text: str, value: float, want: str, limit: float) -> None:
        results.append({"bar": text, "value": value, "want": want, "limit": limit,
                        "holds": value <= limit if want == "<=" else value >= limit})  # fmt: skip

    def open_(why: str) -> None:
        results[-1]["bar"] += f": not measurable here, {why}"
        results[-1]["holds"] = None

    for seconds in dict.fromkeys(r["seconds"] for r in rows):
        two = [r for r in rows if r["seconds"] == seconds and r["jobs"] == 2]
        one = [r for r in rows if r["seconds"] == seconds and r["jobs"] == 1]
        if seconds in WALL:
            slowest = max(two, key=lambda r: r["wall_s"])
            median = statistics.median(r["wall_s"] for r in two)
            bar(f"{seconds:g} s at 2 kHz, slowest ({slowest['axis']}; median of the axes {median:.1f} s) [s]",
                slowest["wall_s"], "<=", WALL[seconds])  # fmt: skip
            if not results[-1]["holds"] and machine < BUSY and slowest["processor_s"] / 2 <= WALL[seconds]:
                open_(f"{slowest['processor_s']:.1f} s of processor time")
            bar(f"{seconds:g} s, peak memory [GB]", max(r["memory_GB"] for r in (*one, *two)), "<=", MEMORY)
        at_once = 2 * sum(r["wall_s"] for r in one) / sum(r["two_at_once_s"] for r in one)
        beside = f"two diagnoses at once gain {at_once:.2f}, an empty loop {machine:.2f}"
        told = {"walls_s": f"--jobs 2 over --jobs 1 ({beside}; ", "itselfs_s": "the diagnosis itself, two jobs over one ("}
        for walls, text in told.items():
            fastest, median = (
                sum(of(r[walls]) for r in one) / sum(of(r[walls]) for r in two) for of in (min, statistics.median)
            )  # fmt: skip
            bar(f"{seconds:g} s, {text}by the fastest of the turns {fastest:.2f})", median, ">=", GAIN)
            if machine < BUSY:
                open_("the machine has no second core to give")
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=3, help="runs of each, in turns")
    parser.add_argument("--seconds", type=float, nargs="+", default=list(WALL), choices=LENGTHS, help="lengths of the recordings")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    rows, machine = measure(arguments.seconds, arguments.repeat, lambda text: print(text, file=sys.stderr, flush=True))
    for r in rows:
        print(
            f"{r['seconds']:4g} s  --jobs {r['jobs']}  {r['wall_s']:7.1f} s  itself {r['itself_s']:7.1f} s  "
            f"processor {r['processor_s']:7.1f} s  "
            f"{r['memory_GB']:5.2f} GB  {r['axis']}: {r['answer']}"
        )
    for axis in AXES:
        walls = {r["seconds"]: r["wall_s"] for r in rows if (r["axis"], r["jobs"]) == (axis.name, 2)}
        for short, long in pairwise(sorted(walls)):
            print(f"{long / short:g} times the length takes {walls[long] / walls[short]:.2f} times as long: {axis.name}")
    results = judge(rows, statistics.median(machine))
    for r in results:
        said = {True: "holds ", False: "MISSED", None: "open  "}[r["holds"]]
        print(f"{said} {r['value']:8.3g} ({r['want']} {r['limit']:g})  {r['bar']}")
    if arguments.json:
        arguments.json.write_text(json.dumps({"rows": rows, "empty_loop": machine, "bars": results}, indent=2) + "\n")
    sys.exit(0 if all(r["holds"] is not False for r in results) else 1)


if __name__ == "__main__":
    main()
