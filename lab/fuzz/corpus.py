"""Small valid files of each kind, made by code: what mutation starts from."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["SEEDS"]

N = 16
COLUMNS = {"time_s": np.arange(N) * 1e-3, "torque_Nm": np.sin(np.arange(N)), "angle_rad": np.cos(np.arange(N))}

BINDING = b"""[recording]
time = "time_s"
torque = {column = "torque_Nm", unit = "Nm", gain = 2.0}
angle = {column = "angle_rad", unit = "rad"}
hold = "linear"
jitter = 0.1
"""


def _csv() -> list[bytes]:
    rows = [",".join(f"{x:.6g}" for x in row) for row in zip(*COLUMNS.values(), strict=True)]
    quoted = ['"' + row.replace(",", '","') + '"' for row in rows]
    return ["\n".join([",".join(COLUMNS), *r, ""]).encode() for r in (rows, quoted)] + [b"a;b\n1,5;2\n2,5;3\n"]


def _npz() -> list[bytes]:
    out = []
    for save in (np.savez, np.savez_compressed):
        stream = io.BytesIO()
        save(stream, **COLUMNS)  # type: ignore[arg-type]
        out.append(stream.getvalue())
    return out


def _mat() -> list[bytes]:
    import scipy.io

    out = []
    for form, packed in (("5", False), ("5", True), ("4", False)):
        stream = io.BytesIO()
        scipy.io.savemat(stream, COLUMNS if form == "4" else {"rec": COLUMNS, **COLUMNS}, format=form, do_compression=packed)
        out.append(stream.getvalue())
    return out


def _hdf5() -> list[bytes]:
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, values in COLUMNS.items():
            file.create_dataset(name, data=values, compression="gzip")
    return [stream.getvalue()]


def _parquet() -> list[bytes]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    stream = io.BytesIO()
    pq.write_table(pa.table(COLUMNS), stream)
    return [stream.getvalue()]


def _mcap() -> list[bytes]:
    from mcap.writer import Writer

    stream = io.BytesIO()
    log = Writer(stream)
    log.start()
    channel = log.register_channel("joint", "json", log.register_schema("s", "jsonschema", b"{}"))
    for i in range(N):
        row = json.dumps({name: float(v[i]) for name, v in COLUMNS.items()}).encode()
        log.add_message(channel, i * 1000000, row, i * 1000000)
    log.finish()
    return [stream.getvalue()]


def _mjcf() -> list[bytes]:
    from mjsim.models import shipped_model

    return [shipped_model(name).read_bytes() for name in ("robot_axis1", "pendulum", "emps")]


def _corrected() -> list[bytes]:
    from mjsim.effects import effect_class
    from mjsim.mjcf import load_axis, write_corrected
    from mjsim.models import shipped_model

    nominal = shipped_model("robot_axis1")
    make: Any = effect_class("backlash")
    axis = load_axis(nominal)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "corrected.xml"
        write_corrected(nominal, axis + make(place="gearbox", gap_rad=5e-4), out)
        return [out.read_bytes()]


def _baseline() -> list[bytes]:
    recordings = [{"file": f"{n}.csv", "sha256": str(n) * 64, "role": r} for n, r in enumerate(("estimation", "held-out"))]
    told = {
        "fit": {"corrected": {"rms": 1e-3, "held_out_rms": None}}, "judged_on": {"view": "motion", "unit": "rad"},
        "recordings": recordings,
    }  # fmt: skip
    rows = [{"file": "0.csv", "role": "estimation", "moves": True, "corrected_rms": 1e-3}]
    return [json.dumps(d).encode() for d in (told, told | {"closed_loop": {"joints": {"hinge": rows}}})]


def _ledger() -> list[bytes]:
    from diagnose.fit.ledger import FORMAT, checksum

    one = float(1).hex()
    said = {"key": "a", "x": [one, one], "cost": one, "status": "CONVERGED", "iterations": 3, "gain": one, "n": 9, "work": 4}
    head = {"format": FORMAT, "follows": "this"}
    return [(json.dumps(head) + "\n" + json.dumps(said | {"check": checksum(said)}) + "\n").encode()]


SEEDS: dict[str, Callable[[], list[bytes]]] = {
    "csv": _csv, "npz": _npz, "mat": _mat, "hdf5": _hdf5, "parquet": _parquet, "mcap": _mcap, "toml": lambda: [BINDING],
    "mjcf": _mjcf, "corrected": _corrected, "baseline": _baseline, "ledger": _ledger,
}  # fmt: skip
"""Files of each reader that is fuzzed."""
