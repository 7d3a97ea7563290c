"""Seal: write cases as recordings without a hint, and their truth as an envelope whose hash is published beforehand."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import numpy as np

from lab.benchmark.cases import LEVELS, Case, effects_of, make_case
from lab.benchmark.plant import Motion
from mjsim.errors import InputError

__all__ = ["envelope_hash", "open_envelope", "write_cases", "write_motion"]

VERSION = 6  # of the generator: raise it when the same seed gives other recordings


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _write(path: Path, data: bytes) -> None:
    """Write under another name first, so that nothing half-written is left under the final one."""
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_bytes(data)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _csv(motion: Motion) -> bytes:
    rows = ["time_s,torque_Nm,velocity_rad_s,angle_rad"]
    rows += [
        f"{t:.4f},{u:.7g},{v:.7g},{a:.8g}"
        for t, u, v, a in zip(motion.time, motion.torque, motion.velocity, motion.angle, strict=True)
    ]
    return ("\n".join(rows) + "\n").encode()


def write_motion(path: Path, motion: Motion) -> str:
    """Write a recording as CSV; the SHA-256 of the file."""
    data = _csv(motion)
    _write(path, data)
    return _digest(data)


def envelope_hash(path: Path) -> str:
    """SHA-256 of an envelope file."""
    return _digest(path.read_bytes())


def open_envelope(recordings: Path, truth: Path) -> dict[str, dict[str, Any]]:
    """The truth of every case, after its hash and those of the recordings agree with the manifest."""
    manifest = json.loads((recordings / "manifest.json").read_text())
    if envelope_hash(truth) != manifest["envelope_sha256"]:
        raise InputError(truth, "the file with the truth was changed after it was written", manifest["envelope_sha256"])
    for name, digest in manifest["recordings"].items():
        if _digest((recordings / name).read_bytes()) != digest:
            raise InputError(recordings / name, "the recording was changed after it was written", digest)
    cases: dict[str, dict[str, Any]] = json.loads(truth.read_text())["cases"]
    return cases


def _seal_case(task: tuple[Path, str, str, int, int]) -> tuple[str, Mapping[str, object], dict[str, str], float]:
    """Draw and write one case: its name, its truth, the hashes of its recordings, seconds."""
    out, name, level, k, seed = task
    began = time.perf_counter()
    which = list(LEVELS).index(level)
    turn = np.random.default_rng([seed, which, 2**31]).permutation(effects_of(level)).tolist()
    case: Case = make_case(level, np.random.default_rng([seed, which, k]), turn[k % len(turn)] if turn else None)
    digests = {}
    for motion, part in ((case.estimation, "estimation"), (case.held_out, "held_out")):
        digests[f"{name}_{part}.csv"] = write_motion(out / f"{name}_{part}.csv", motion)
    return name, {**case.truth, "seed": [seed, which, k]}, digests, time.perf_counter() - began


def write_cases(
    out: Path,
    truth: Path,
    counts: Mapping[str, int] | Sequence[tuple[str, int]],
    seed: int,
    *,
    jobs: int = 1,
    say: bool = False,
) -> str:
    """Draw cases and write ``out/NNN_estimation.csv``, ``out/NNN_held_out.csv``, ``out/manifest.json``, ``truth``.

    The effects of a level take turns. The cases are shuffled, so that a number says nothing; each has a generator of its
    own, seeded by (seed, level, index), so that a case does not depend on the others, nor on the number of processes
    (``jobs``). Returns the SHA-256 of the envelope, which the manifest carries.
    """
    counts = dict(counts)
    for level in counts:
        if level not in LEVELS:
            raise InputError("levels", f"{level!r} is not known", f"one of {', '.join(LEVELS)}")
    if truth.resolve().is_relative_to(out.resolve()):
        raise InputError(truth, "the file with the truth is in the folder of the recordings", "another folder")
    out.mkdir(parents=True, exist_ok=True)
    truth.parent.mkdir(parents=True, exist_ok=True)
    drawn = [(level, k) for level, count in counts.items() for k in range(count)]
    order = np.random.default_rng([seed, 2**31]).permutation(len(drawn))
    truths: dict[str, Mapping[str, object]] = {}
    digests: dict[str, str] = {}
    tasks = [(out, f"{number + 1:03d}", *drawn[job], seed) for number, job in enumerate(order)]
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) if jobs > 1 else nullcontext() as pool:
        for number, (name, truth_, files, seconds) in enumerate((pool.map if pool else map)(_seal_case, tasks)):
            truths[name] = truth_
            digests.update(files)
            if say:
                click.echo(f"{number + 1}/{len(drawn)} simulated in {seconds:.1f} s", err=True)
    envelope = json.dumps({"generator": VERSION, "seed": seed, "cases": truths}, indent=1).encode() + b"\n"
    _write(truth, envelope)
    digest = _digest(envelope)
    manifest = {"generator": VERSION, "cases": list(truths), "recordings": digests, "envelope_sha256": digest}
    _write(out / "manifest.json", json.dumps(manifest, indent=1).encode() + b"\n")
    return digest


@click.command()
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Directory of the recordings.")
@click.option("--truth", type=click.Path(path_type=Path), help="Envelope file [OUT_truth/truth.json].")
@click.option("--levels", default=",".join(LEVELS), show_default=True, help="Levels, or LEVEL:COUNT, with commas.")
@click.option("--count", default=20, show_default=True, help="Cases of each level without a count.")
@click.option("--seed", default=1, show_default=True)
def main(out: Path, truth: Path | None, levels: str, count: int, seed: int) -> None:
    """Seal recordings with concealed effects.

    Example: python -m lab.benchmark.seal --out DIR --levels plain:40,nothing --count 20 --seed 1
    """
    counts: dict[str, int] = {}
    for item in levels.split(","):
        name, _, number = item.strip().partition(":")
        if number and not number.isdigit():
            raise click.UsageError(f"--levels: {item!r} is not LEVEL:COUNT")
        counts[name] = int(number) if number else count
    path = truth or out.with_name(out.name + "_truth") / "truth.json"
    try:
        digest = write_cases(out, path, counts, seed, say=True)
    except InputError as error:
        raise click.UsageError(str(error)) from error
    click.echo(f"sha256 {digest}  {path}")


if __name__ == "__main__":
    main()
