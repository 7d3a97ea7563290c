"""Memory and time of the choice of stretches of long recordings: files of given lengths, each read in a process of its own.

    python lab/speed/long.py --hours 0.25 1 24 --formats npz parquet csv --work out/long --out long.json

A recording is 2 kHz of a rigid axis (inertia, viscous friction, Coulomb friction that falls with time), written block by block.
Seconds are of the wall; memory is the largest resident set of the process that reads.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

RATE = 2000.0
BLOCK = 240_000
NAMES = ("time_s", "torque_Nm", "velocity_rad_s", "angle_rad")
READ = """
import json, resource, sys, time
from pathlib import Path
from mjsim.models import shipped_model
from simgap.long_logs import load_all
began = time.perf_counter()
loaded = load_all([Path(sys.argv[1])], [], shipped_model("robot_axis1"))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
count = sum(len(s.chosen) for s in loaded.stretches)
print(json.dumps({"seconds": time.perf_counter() - began, "peak_MB": peak * 1024 / 1e6, "stretches": count}))
"""


def blocks(rows: int) -> Iterator[dict[str, np.ndarray]]:
    """Columns of the recording, at most `BLOCK` rows at a time."""
    rng = np.random.default_rng(0)
    for first in range(0, rows, BLOCK):
        t = np.arange(first, min(rows, first + BLOCK)) / RATE
        slow = 2 * np.pi * 0.01 * t
        phase = 2 * np.pi * t + 3.0 * np.sin(slow)
        rate = 2 * np.pi * (1.0 + 0.03 * np.cos(slow))
        v, a = 8.0 * np.sin(phase), 8.0 * rate * np.cos(phase)
        coulomb = 0.05 * (1.0 + np.exp(-t / 3600.0))
        torque = 0.01 * a + 0.02 * v + coulomb * np.tanh(v / 0.05)
        yield {
            "time_s": t,
            "torque_Nm": torque + 1e-3 * rng.standard_normal(len(t)),
            "velocity_rad_s": v + 1e-2 * rng.standard_normal(len(t)),
            "angle_rad": -8.0 / rate * np.cos(phase) + 1e-5 * rng.standard_normal(len(t)),
        }


def write_npz(path: Path, rows: int) -> None:
    header = {"descr": "<f8", "fortran_order": False, "shape": (rows,)}
    with zipfile.ZipFile(path, "w", allowZip64=True) as archive:
        for name in NAMES:  # a member of a ZIP archive is written as a whole: the blocks are made again for each column
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array_header_1_0(stream, header)
                for block in blocks(rows):
                    stream.write(block[name].tobytes())


def write_parquet(path: Path, rows: int) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetWriter(path, pa.schema([(n, pa.float64()) for n in NAMES])) as writer:
        for block in blocks(rows):
            writer.write_table(pa.table(block))


def write_csv(path: Path, rows: int) -> None:
    with path.open("w") as handle:
        handle.write(",".join(NAMES) + "\n")
        for block in blocks(rows):
            np.savetxt(handle, np.column_stack([block[n] for n in NAMES]), fmt="%.9g", delimiter=",")


WRITERS = {"npz": write_npz, "parquet": write_parquet, "csv": write_csv}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, nargs="+", default=[0.25, 1.0])
    parser.add_argument("--formats", nargs="+", choices=WRITERS, default=["npz", "parquet", "csv"])
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    told = []
    for kind in args.formats:
        for hours in args.hours:
            rows, path = round(hours * 3600 * RATE), args.work / f"long.{kind}"
            began = time.perf_counter()
            WRITERS[kind](path, rows)
            wrote, size = time.perf_counter() - began, path.stat().st_size
            done = subprocess.run([sys.executable, "-c", READ, str(path)], capture_output=True, text=True)
            path.unlink()
            row = {"format": kind, "hours": hours, "samples": rows, "file_GB": size / 1e9, "write_s": wrote}
            row |= json.loads(done.stdout) if done.returncode == 0 else {"fault": done.stderr.splitlines()[-1]}
            print(json.dumps(row), flush=True)
            told.append(row)
    if args.out:
        args.out.write_text(json.dumps(told, indent=2) + "\n")


if __name__ == "__main__":
    main()
