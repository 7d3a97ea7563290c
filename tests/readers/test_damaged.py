"""Damaged, oversized and misleading files: a table or one clear line, and no more memory than what is asked for."""

from __future__ import annotations

import io
import json
import struct
import zipfile

import numpy as np
import pytest
import scipy.io
from robot_logs import write_bag, write_mcap, write_rosbag2

from mjsim.errors import InputError
from mjsim.readers import read_table, table
from mjsim.readers.mat_elements import check_elements

N = 64
COLUMNS = {"time_s": np.arange(N) * 1e-3, "torque_Nm": np.sin(np.arange(N)), "angle_rad": np.cos(np.arange(N))}


def csv_bytes() -> bytes:
    rows = "\n".join(",".join(f"{x:.9g}" for x in row) for row in zip(*COLUMNS.values(), strict=True))
    return (",".join(COLUMNS) + "\n" + rows + "\n").encode()


def npz_bytes() -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **COLUMNS)
    return out.getvalue()


def mat_bytes() -> bytes:
    out = io.BytesIO()
    scipy.io.savemat(out, {"rec": COLUMNS, **COLUMNS}, do_compression=True)
    return out.getvalue()


def parquet_bytes() -> bytes:
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    out = io.BytesIO()
    parquet.write_table(arrow.table(COLUMNS), out)
    return out.getvalue()


def mcap_bytes(data: bytes | None = None) -> bytes:
    writer = pytest.importorskip("mcap.writer")
    out = io.BytesIO()
    log = writer.Writer(out)
    log.start()
    channel = log.register_channel("joint", "json", log.register_schema("s", "jsonschema", b"{}"))
    for i in range(N):
        row = json.dumps({k: float(v[i]) for k, v in COLUMNS.items()}).encode() if data is None else data
        log.add_message(channel, i * 1000000, row, i * 1000000)
    log.finish()
    return out.getvalue()


WRITERS = {".csv": csv_bytes, ".npz": npz_bytes, ".mat": mat_bytes, ".parquet": parquet_bytes, ".mcap": mcap_bytes}


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """A copy with a few bytes changed, a part cut out, doubled or cut off."""
    out = bytearray(data)
    kind = rng.integers(5)
    a, b = sorted(rng.integers(0, len(out), 2))
    if kind == 0:
        del out[a : min(b, a + 50)]
    elif kind == 1:
        out[a:a] = out[a : min(b, a + 50)]
    elif kind == 2:
        del out[a:]
    else:
        for at in rng.integers(0, len(out), rng.integers(1, 8)):
            out[at] = rng.integers(256)
    return bytes(out)


def refusal(path) -> str | None:
    """What a file is refused with; None where all its columns can be read."""
    try:
        columns = read_table(path)
        assert all(np.asarray(columns[name]).dtype == float for name in columns)
    except InputError as error:
        return str(error)
    return None


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("suffix", WRITERS)
def test_a_damaged_file_is_read_or_told_in_one_line(suffix, tmp_path):
    data, rng, refused = WRITERS[suffix](), np.random.default_rng(20), 0
    for i in range(150):
        path = tmp_path / f"log{i}{suffix}"
        path.write_bytes(mutated(data, rng))
        told = refusal(path)
        refused += told is not None
        assert told is None or ("\n" not in told and len(told) < 1000)
    assert refused > 10


def mat73(path):
    with pytest.importorskip("h5py").File(path, "w") as file:
        for name, values in COLUMNS.items():
            file.create_dataset(name, data=values, compression="gzip")


def db3(path):
    folder = path.with_suffix(".folder")
    write_rosbag2(folder)
    next(folder.glob("*.db3")).rename(path)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("suffix", "write"), [(".mat", mat73), (".bag", write_bag), (".db3", db3), (".mcap", write_mcap)])
def test_a_damaged_log_of_a_robot_is_read_or_told_in_one_line(suffix, write, tmp_path):
    write(tmp_path / f"whole{suffix}")
    data, rng, refused = (tmp_path / f"whole{suffix}").read_bytes(), np.random.default_rng(21), 0
    for i in range(60):
        path = tmp_path / f"log{i}{suffix}"
        path.write_bytes(mutated(data, rng))
        told = refusal(path)
        refused += told is not None
        assert told is None or ("\n" not in told and len(told) < 1000)
    assert refused > 5


@pytest.mark.parametrize("suffix", WRITERS)
def test_an_intact_file_gives_its_columns(suffix, tmp_path):
    path = tmp_path / f"log{suffix}"
    path.write_bytes(WRITERS[suffix]())
    columns = read_table(path)
    for name, values in COLUMNS.items():
        assert columns.shapes[name] == (N,)
        np.testing.assert_allclose(columns[name], values, atol=1e-8)


def test_a_member_that_is_not_asked_for_is_not_read(tmp_path, monkeypatch):
    """Its header declares 3.2 GB; the columns beside it are read all the same, and it is refused by its size."""
    path = tmp_path / "log.npz"
    np.savez(path, **COLUMNS)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (700_000_000,)})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("huge.npy", header.getvalue())
    columns = read_table(path)
    np.testing.assert_array_equal(columns["torque_Nm"], COLUMNS["torque_Nm"])
    with pytest.raises(InputError, match=r"'huge' holds 5\.6e"):
        columns["huge"]


@pytest.mark.parametrize("suffix", [".npz", ".parquet"])
def test_the_limit_of_a_column(suffix, tmp_path, monkeypatch):
    path = tmp_path / f"log{suffix}"
    path.write_bytes(WRITERS[suffix]())
    monkeypatch.setattr(table, "MOST_BYTES", 8 * N)
    assert len(read_table(path)["angle_rad"]) == N
    monkeypatch.setattr(table, "MOST_BYTES", 8 * N - 1)
    with pytest.raises(InputError, match="cut the recording"):
        read_table(path)["angle_rad"]


def test_a_mat_file_that_expands_beyond_the_limit(tmp_path, monkeypatch):
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"zeros": np.zeros(200_000)}, do_compression=True)
    monkeypatch.setattr("mjsim.readers.mat.MOST_BYTES", 1_000_000)
    monkeypatch.setattr(table, "MOST_BYTES", 1_000_000)
    with pytest.raises(InputError, match="holds"):
        read_table(path)


@pytest.mark.parametrize(
    "data", [b'{"a": ' + b"[" * 100_000 + b"]" * 100_000 + b"}", b'{"a": 1' + b"0" * 400 + b"}", b"\xff\xfe", b"{"],
    ids=["deep", "large", "no text", "cut off"],
)  # fmt: skip
def test_json_that_is_no_record(data, tmp_path):
    path = tmp_path / "log.mcap"
    path.write_bytes(mcap_bytes(data))
    with pytest.raises(InputError, match="not a readable MCAP"):
        read_table(path)


@pytest.mark.parametrize(("row", "said"), [("#1,2,3", "row 3"), ("1,0.1#ERR,3", "'0.1#ERR'"), ('"x",2,3', "row 3")])
def test_a_csv_cell_that_is_no_number_is_named(row, said, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("a,b,c\n0,0,0\n" + row + "\n")
    with pytest.raises(InputError, match=said):
        read_table(path)


def test_quoted_numbers_are_numbers(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text('a,b\n"1","2.5"\n3,4\n')
    np.testing.assert_array_equal(read_table(path)["b"], [2.5, 4.0])


def test_an_empty_cell_counts_only_in_a_column_that_is_used(tmp_path):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "log.parquet"
    parquet.write_table(arrow.table({"a": [1.0, 2.0], "b": [1.0, None]}), path)
    columns = read_table(path)
    assert list(columns["a"]) == [1.0, 2.0]
    with pytest.raises(InputError, match="row 2, column 'b' is empty"):
        columns["b"]


def test_a_folder_is_no_recording(tmp_path):
    with pytest.raises(InputError, match="not a regular file"):
        read_table(tmp_path)


VARIANTS = {
    "numbers": COLUMNS, "struct": {"rec": COLUMNS}, "cells": {"c": np.array([np.arange(3.0), np.arange(4)], dtype=object)},
    "sparse": {"s": scipy.sparse.csc_array(np.eye(3)), "x": np.arange(3.0)}, "text": {"t": "name", "x": np.arange(3.0)},
    "complex": {"z": np.arange(3) + 1j, "x": np.arange(3.0)},
}  # fmt: skip


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("name", VARIANTS)
def test_elements_of_intact_mat_files(name, packed, tmp_path):
    scipy.io.savemat(tmp_path / "log.mat", VARIANTS[name], do_compression=packed)
    check_elements(tmp_path / "log.mat")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", VARIANTS)
def test_a_damaged_byte_of_a_mat_file_does_not_end_the_process(name, tmp_path):
    """Each tag of an element is somewhere in the file: every eighth byte takes a type that SciPy has no entry for."""
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, VARIANTS[name])
    data, told = path.read_bytes(), 0
    for at in range(128, len(data), 8):
        for value in (8, 10, 11, 19, 20, 200):
            path.write_bytes(data[:at] + bytes([value]) + data[at + 1 :])
            told += refusal(path) is not None
    assert told > 5


@pytest.mark.parametrize("kind", [0, 8, 10, 11, 19, 20, 255])
def test_a_type_that_a_number_cannot_have(kind, tmp_path):
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"x": np.arange(0.5, 9)})
    data = path.read_bytes()
    at = data.index(np.arange(0.5, 9).tobytes()) - 8
    path.write_bytes(data[:at] + bytes([kind]) + data[at + 1 :])
    with pytest.raises(InputError, match=f"an element has the type {kind}"):
        read_table(path)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("rows", "width", "said"), [(117_569_280, 32, "structs without"), (1, 31, "do not fill"), (1, 0, "do not fill")]
)
def test_a_struct_whose_size_nothing_bounds(rows, width, said, tmp_path):
    """SciPy makes every struct of an array that has no fields, though the file holds 200 bytes."""
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"s": {"x": np.arange(3.0)}})
    data = path.read_bytes()
    dims = data.index(struct.pack("<IIii", 5, 8, 1, 1)) + 8
    data = data[:dims] + struct.pack("<i", rows) + data[dims + 4 :]
    at = data.index(struct.pack("<HH", 5, 4), dims)
    data = data[: at + 4] + struct.pack("<i", width) + data[at + 8 :]
    if rows > 1:  # and no names
        data = data[: at + 8] + struct.pack("<II", 1, 0)
    path.write_bytes(data)
    with pytest.raises(InputError, match=said):
        read_table(path)


def test_an_altered_value_of_an_mcap_file_is_told_by_its_checksum(tmp_path):
    """A digit of a message that was stored plainly: the file is well-formed, and the sum of its chunk is not."""
    writer = pytest.importorskip("mcap.writer")
    out = io.BytesIO()
    log = writer.Writer(out, compression=writer.CompressionType.NONE)
    log.start()
    channel = log.register_channel("joint", "json", log.register_schema("s", "jsonschema", b"{}"))
    for i in range(N):
        row = json.dumps({"time_s": i * 1e-3, "torque_Nm": 1.25, "angle_rad": 0.5}).encode()
        log.add_message(channel, i * 1000000, row, i * 1000000)
    log.finish()
    data = out.getvalue()
    (tmp_path / "log.mcap").write_bytes(data)
    assert refusal(tmp_path / "log.mcap") is None
    assert b"1.25" in data
    (tmp_path / "log.mcap").write_bytes(data.replace(b"1.25", b"1.35", 1))
    told = refusal(tmp_path / "log.mcap")
    assert told is not None
    assert "not a readable MCAP file" in told


@pytest.mark.parametrize("header", ["time_s,torque_Nm,angle_rad,angle_rad", "time_s,torque_Nm,,angle_rad"])
def test_a_column_name_that_is_there_twice_or_empty_is_refused(header, tmp_path):
    (tmp_path / "log.csv").write_text(header + "\n" + "0,0,0,0\n" * 3)
    told = refusal(tmp_path / "log.csv")
    assert told is not None
    assert "empty or repeated column name" in told
