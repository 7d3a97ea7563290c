"""Many diagnoses in one process, or many recordings in one fleet: does the memory grow?

    python -m lab.soak diagnose --count 500
    python -m lab.soak fleet --count 1000 --workers 1

Each recording is 1 s of a pendulum with Coulomb friction. The resident set is read after each diagnosis (for ``fleet``: of the
command and of its workers together, once a second). The growth is the slope of a straight line through the last two thirds of
the curve, by Theil and Sen: the median of the slopes of all pairs of points, with its 95 % interval (`scipy.stats.theilslopes`),
which a single step does not sway. Prints one line of JSON. Exit code 1 where the interval lies above ``--allowed`` as a whole, or
where the table of the fleet does not hold each recording once. ``--curve`` is written as it grows; ``--folder`` keeps the records
of a fleet, from which the next run continues.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import click
import numpy as np
from scipy.stats import theilslopes

from lab.kill import EFFECT, MODEL, write_log

__all__ = ["Curve", "Growth", "growth", "lost_or_repeated", "main", "resident"]

WARM = 1 / 3
"""Part of a curve in which caches fill, which is left out."""
FEWEST = 10
"""Diagnoses without which there is no curve."""


@dataclass(frozen=True)
class Growth:
    """Of the resident set over the number of diagnoses: slope and its 95 % interval [kB each], first and last size [MB]."""

    command: str
    count: int
    seconds: float
    slope_kb: float
    ci95: tuple[float, float]
    first_mb: float
    last_mb: float
    largest_mb: float
    lost_or_repeated: int = 0


def resident(pid: int) -> int:
    """Resident set of a process and of those that it started [kB]; 0 where it has ended. Linux only."""
    try:
        own = int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024
        tasks = list(Path(f"/proc/{pid}/task").iterdir())  # a child belongs to the thread that started it
        children = [child for task in tasks for child in (task / "children").read_text().split()]
    except (OSError, IndexError):
        return 0
    return own + sum(resident(int(child)) for child in children)


def growth(command: str, curve: list[tuple[float, float]], seconds: float) -> Growth:
    """The growth of a curve of (diagnoses, resident set [kB])."""
    done, size = np.array(curve).T
    late = done >= WARM * done[-1]
    few = np.unique(np.linspace(0, late.sum() - 1, 400).astype(int))
    slope, _, low, high = theilslopes(size[late][few], done[late][few])
    mb = [float(x) / 1024 for x in (size[0], size[-1], size.max())]
    return Growth(command, int(done[-1]), seconds, float(slope), (float(low), float(high)), mb[0], mb[1], mb[2])


class Curve:
    """Points of (diagnoses, resident set [kB]), written to a CSV file as they come."""

    def __init__(self, kept: Path | None) -> None:
        self.points: list[tuple[float, float]] = []
        self.kept = kept
        if kept is not None:
            kept.write_text("diagnoses,resident_kB\n")

    def add(self, done: float, size: float) -> None:
        """One more point."""
        self.points.append((done, size))
        if self.kept is not None:
            with self.kept.open("a") as handle:
                handle.write(f"{done:.9g},{size:.9g}\n")


def _diagnoses(folder: Path, count: int, limit: float, curve: Curve) -> None:
    """The same few recordings again and again, so that what grows is no work for the data."""
    import simgap

    logs = [folder / f"{i}.npz" for i in range(4)]
    for i, log in enumerate(logs):
        write_log(log, 0.1 + 0.05 * i, i, 250)
    began = time.perf_counter()
    for i in range(count):
        if i >= FEWEST and time.perf_counter() - began > limit:
            break
        simgap.diagnose(logs[i % len(logs)], folder / "pendulum.xml", effects=(EFFECT,), seed=i)
        curve.add(i + 1.0, float(resident(os.getpid())))


def _fleet(folder: Path, count: int, workers: int, curve: Curve) -> None:
    logs = [folder / f"logs/robot{i % 10}/{i:06d}.npz" for i in range(count)]
    for i, log in enumerate(logs):
        if not log.exists():
            write_log(log, 0.1 + 0.01 * (i % 10), i, 250)
    words = [
        sys.executable, "-m", "simgap", "fleet", "logs/*/*.npz", "--model", "pendulum.xml", "--effects", EFFECT,
        "--out", "out", "--workers", str(workers), "--quiet",
    ]  # fmt: skip
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).resolve().parents[1]), *sys.path])}
    process = subprocess.Popen(words, cwd=folder, env=environment)
    while process.poll() is None:
        time.sleep(1.0)
        done = sum(1 for _ in (folder / "out" / "records").glob("*/*.json"))
        if done and (size := resident(process.pid)):
            curve.add(float(done), float(size))
    if process.returncode:
        raise click.ClickException(f"simgap fleet ended with {process.returncode}")


def lost_or_repeated(folder: Path, count: int) -> int:
    """How many of the recordings do not stand in the table of the fleet with a verdict, and how many rows are too many.

    Each recording has one finding or none, with one parameter, hence one row.
    """
    import pyarrow.parquet as pq

    from simgap.fleet.table import NONE

    table = pq.read_table(folder / "out" / "fleet.parquet", columns=["log", "verdict"]).to_pylist()
    told = Counter(Path(row["log"]).stem for row in table if row["verdict"] not in (None, *NONE.values()))
    return sum(abs(told[f"{i:06d}"] - 1) for i in range(count)) + len(table) - told.total()


@click.command()
@click.argument("command", type=click.Choice(["diagnose", "fleet"]))
@click.option("--count", default=500, show_default=True, type=click.IntRange(FEWEST), help="Diagnoses.")
@click.option("--limit", default=float("inf"), help="Begin no further diagnosis after so many seconds (diagnose).")
@click.option("--workers", default=1, show_default=True, help="Of the fleet.")
@click.option("--allowed", default=20.0, show_default=True, help="Growth of one diagnosis that is no fault [kB].")
@click.option("--curve", "kept", type=click.Path(path_type=Path), help="Write the curve to this CSV file.")
@click.option("--folder", type=click.Path(path_type=Path), help="Of recordings and records (default: a temporary one).")
def main(command: str, count: int, limit: float, workers: int, allowed: float, kept: Path | None, folder: Path | None) -> None:
    """Diagnose many short recordings and print how the resident set grows."""
    with contextlib.nullcontext(folder) if folder else tempfile.TemporaryDirectory() as name:
        place, began, curve, wrong = Path(name), time.perf_counter(), Curve(kept), 0
        place.mkdir(parents=True, exist_ok=True)
        (place / "pendulum.xml").write_text(MODEL)
        if command == "diagnose":
            _diagnoses(place, count, limit, curve)
        else:
            _fleet(place, count, workers, curve)
            wrong = lost_or_repeated(place, count)
        found = replace(growth(command, curve.points, time.perf_counter() - began), lost_or_repeated=wrong)
    click.echo(json.dumps(asdict(found)))
    sys.exit(int(found.ci95[0] > allowed or wrong > 0))


if __name__ == "__main__":
    main()
