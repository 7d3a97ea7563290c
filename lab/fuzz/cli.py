"""Fuzz a reader with libFuzzer (atheris), and print what it does other than return a result or raise `InputError`.

    python -m lab.fuzz csv --runs 100000
    python -m lab.fuzz mjcf --runs 2000 --limit 120 --keep out/fuzz

Fuzzing runs in a process of its own, on files in memory (/dev/shm) where the system has that: a file on disk costs 6 ms, most
readers less than 1 ms. An exception is counted and its file kept; the run goes on. A crash, a file that takes more
than 10 s and memory beyond the limit end it (libFuzzer's ``-timeout`` and ``-rss_limit_mb``) and keep the file as well.
Exit code 1 where something was found.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass, field
from pathlib import Path

import click

from lab.fuzz.corpus import SEEDS
from lab.fuzz.targets import TARGETS

__all__ = ["Outcome", "fuzz", "main"]

SECONDS = 10
"""Longest time that one file may take [s]."""
MEMORY = Path("/dev/shm")
"""Where Linux keeps files in memory."""


@dataclass(frozen=True)
class Outcome:
    """Figures of a run: executions, results and refusals, slowest file [s], finds (text -> file), how the process ended."""

    reader: str
    runs: int
    valid: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    finds: dict[str, str] = field(default_factory=dict)
    ended: str = ""


def fuzz(reader: str, runs: int, limit: float, memory: int, seed: int, keep: Path) -> Outcome:
    """Fuzz one reader for ``runs`` executions or ``limit`` seconds; ``memory``: limit of the process [MB]."""
    keep.mkdir(parents=True, exist_ok=True)
    folder = MEMORY if os.access(MEMORY, os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=folder) as work:
        corpus, told = Path(work) / "corpus", Path(work) / "told.json"
        corpus.mkdir()
        for i, data in enumerate(SEEDS[reader]()):
            (corpus / f"seed{i}").write_bytes(data)
        words = [
            sys.executable, "-m", "lab.fuzz.worker", reader, str(told), str(keep), f"-runs={runs}",
            f"-max_total_time={limit:.0f}",
            f"-timeout={SECONDS}", f"-rss_limit_mb={memory}", f"-seed={seed}", "-max_len=65536", "-close_fd_mask=1",
            f"-artifact_prefix={keep.resolve()}/{reader}-", str(corpus),
        ]  # fmt: skip
        done = subprocess.run(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace", check=False,
                              env=os.environ | {"TMPDIR": work})  # fmt: skip
        said = json.loads(told.read_text()) if told.is_file() else {"valid": 0, "refused": 0, "slowest_s": 0.0, "finds": {}}
    counted = re.findall(r"^(?:Done |#)(\d+)", done.stderr, re.MULTILINE)
    ended = "" if done.returncode == 0 else (re.findall(r"ERROR: .*|.*Error: .*", done.stderr) or [f"exit {done.returncode}"])[-1]
    return Outcome(reader, max(map(int, counted), default=0), ended=ended, **said)


@click.command()
@click.argument("readers", nargs=-1, required=True, type=click.Choice([*TARGETS, "all"]))
@click.option("--runs", default=100_000, show_default=True, help="Executions of each reader.")
@click.option("--limit", default=3600.0, show_default=True, help="Stop a reader after so many seconds.")
@click.option("--memory", default=2048, show_default=True, help="Largest resident set [MB].")
@click.option("--seed", default=1, show_default=True)
@click.option("--keep", type=click.Path(path_type=Path), default=Path("out/fuzz"), show_default=True, help="Folder of finds.")
def main(readers: tuple[str, ...], runs: int, limit: float, memory: int, seed: int, keep: Path) -> None:
    """Fuzz READERS; prints one line of JSON for each."""
    found = False
    for reader in TARGETS if "all" in readers else readers:
        outcome = fuzz(reader, runs, limit, memory, seed, keep)
        click.echo(json.dumps(asdict(outcome)))
        found |= bool(outcome.finds or outcome.ended)
    sys.exit(int(found))
