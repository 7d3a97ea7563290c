"""Bindings and logs that no one means: TOML that is none, sizes that no quantity has, names that are told twice."""

from __future__ import annotations

import io
import math
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from mjsim import toml
from mjsim.errors import InputError
from mjsim.models import shipped_model
from mjsim.readers import read_table
from mjsim.recording import load
from mjsim.robot.binding import RobotBinding, find_robot_binding
from mjsim.timebase import DIGITS, LARGEST, need_numbers
from mjsim.toml import lies_at, toml_at, toml_of
from simgap import cli

N = 64
COLUMNS = {"time_s": np.arange(N) * 1e-3, "torque_Nm": np.sin(np.arange(N)), "angle_rad": np.cos(np.arange(N))}


def log(folder: Path, name: str = "log.csv", **changed: np.ndarray) -> Path:
    columns = COLUMNS | changed
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / name, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return folder / name


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = " + 3000 * "[" + 3000 * "]", "nested too deep"),
        ("[recording]\ntorque = {column = 'a', gain = " + 5000 * "9" + "}", "digits"),
        ("[recording]\ntorque = 1 2", "at line 2"),
        ("[recording]\ntorque = 'a\0b'", "character"),
    ],
)
def test_toml_that_is_none_is_one_line(tmp_path, text, said):
    (tmp_path / "log.toml").write_text(text)
    for read in (lambda: toml_at(tmp_path / "log.toml"), lambda: toml_of(text, "it"), lambda: load(log(tmp_path))):
        with pytest.raises(InputError, match=f"not valid TOML .*{said}") as error:
            read()
        assert len(str(error.value).splitlines()) == 1
        assert "set_int_max_str_digits" not in str(error.value)


def test_the_limit_of_a_toml_file(tmp_path, monkeypatch):
    path = tmp_path / "log.toml"
    path.write_text("# comment\n")
    monkeypatch.setattr(toml, "MOST_BYTES", path.stat().st_size)
    assert toml_at(path) == {}
    monkeypatch.setattr(toml, "MOST_BYTES", path.stat().st_size - 1)
    with pytest.raises(InputError, match="more than 9 bytes"):
        toml_at(path)
    path.write_bytes(b"\xe9")
    with pytest.raises(InputError, match="not valid TOML"):
        toml_at(path)
    with pytest.raises(InputError, match="cannot be read"):
        toml_at(tmp_path / "nowhere.toml")


@pytest.mark.parametrize("kind", ["pipe", "folder", "dangling", "loop", "device"])
def test_a_binding_that_is_no_file_is_not_read_as_none(tmp_path, kind):
    """A link that leads nowhere is a binding that was lost: the columns would mean something else."""
    path = tmp_path / "log.toml"
    assert not lies_at(path)
    make = {
        "pipe": lambda: os.mkfifo(path), "folder": path.mkdir, "dangling": lambda: path.symlink_to("nowhere"),
        "loop": lambda: path.symlink_to(path.name), "device": lambda: path.symlink_to("/dev/zero"),
    }  # fmt: skip
    make[kind]()
    for read in (lambda: load(log(tmp_path)), lambda: find_robot_binding(log(tmp_path))):
        with pytest.raises(InputError, match="not a regular file"):
            read()


@pytest.mark.parametrize(
    "payload",
    ["{body = 'a', mass = nan}", "{body = 'a', mass = true}", "{body = 'a', mass = -1}",
     "{body = 'a', mass = 1, pos = ['x', 0, 0]}",
     "{body = 'a', mass = 1, pos = [0, inf, 0]}", "{body = 'a', mass = 1, pos = [0, 0]}", f"{{body = 'a', mass = {400 * '9'}}}"],
)  # fmt: skip
def test_a_payload_has_a_mass_and_a_place(tmp_path, payload):
    path = tmp_path / "log.toml"
    path.write_text(f"[experiment]\npayload = {payload}\n")
    with pytest.raises(InputError, match="payload"):
        RobotBinding.from_toml(path)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_largest_and_smallest_values_of_a_channel(sign):
    path = Path("log.csv")
    for good in (LARGEST, 1 / LARGEST, 0.0, 1.0):
        need_numbers(path, "torque", np.array([0.0, sign * good]))
    need_numbers(path, "torque", np.array([1.0, 1e-300]))  # a small value beside others is one
    need_numbers(path, "torque", np.array([]))
    for bad in (1.01 * LARGEST, 0.99 / LARGEST, 1e308, 5e-324):
        with pytest.raises(InputError, match=f"torque is .* in row 3, its largest value; expected 1e-{DIGITS} to 1e{DIGITS}"):
            need_numbers(path, "torque", np.array([0.0, sign * bad]))
    for none in (math.nan, math.inf, -math.inf):
        with pytest.raises(InputError, match="torque is not finite in row 3"):
            need_numbers(path, "torque", np.array([0.0, none]))


def test_a_size_counts_after_its_gain(tmp_path):
    (tmp_path / "log.toml").write_text("[recording]\ntorque = {column = 'torque_Nm', gain = 1e308}\n")
    with pytest.raises(InputError, match="its largest value"):
        load(log(tmp_path))
    (tmp_path / "log.toml").unlink()
    with pytest.raises(InputError, match=r"angle is 1\.00e\+300|angle is 1e\+300"):
        load(log(tmp_path, angle_rad=np.full(N, 1e300)))


def test_an_array_that_an_archive_holds_twice(tmp_path):
    path = tmp_path / "log.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name, values in COLUMNS.items():
            out = io.BytesIO()
            np.save(out, values)
            archive.writestr(f"{name}.npy", out.getvalue())
    assert set(read_table(path)) == set(COLUMNS)
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("angle_rad.npy", b"other")
    with pytest.raises(InputError, match=r"'angle_rad\.npy' twice"):
        read_table(path)


def test_the_name_of_a_log_does_not_reach_the_terminal_as_it_is(tmp_path, monkeypatch, capfd):
    evil = log(tmp_path, "a\x1b[31m\x07.csv")
    monkeypatch.setattr("sys.argv", ["simgap", "check", str(evil), "--model", str(shipped_model("pendulum"))])
    with pytest.raises(SystemExit):
        cli.main()
    said = "".join(capfd.readouterr())
    assert "\\x1b" in said
    assert not {"\x1b", "\x07"} & set(said)
