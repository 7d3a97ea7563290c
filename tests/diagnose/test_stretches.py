"""Which stretches of a long recording are fitted, and that a file is read window by window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from diagnose.data.stretches import choose, information, informative
from diagnose.thresholds import LONGEST, STRETCH_COUNT
from mjsim.errors import InputError
from mjsim.models import shipped_model
from mjsim.readers.stream import row_count, windows
from mjsim.recording import Recording
from simgap.long_logs import load_all

MODEL = shipped_model("robot_axis1")
ROWS = LONGEST // 2 // STRETCH_COUNT


def table(count: int, dt: float = 1e-3, active=lambda t: np.ones_like(t)) -> dict[str, np.ndarray]:
    """An axis that moves where ``active`` of the time is not zero."""
    rng = np.random.default_rng(1)
    t = dt * np.arange(count)
    on = active(t)
    return {
        "time_s": t,
        "torque_Nm": on * np.cos(3 * t) + 1e-3 * rng.standard_normal(count),
        "velocity_rad_s": on * np.sin(3 * t) + 1e-4 * rng.standard_normal(count),
        "angle_rad": -on * np.cos(3 * t) / 3,
    }


def write(path: Path, columns: dict[str, np.ndarray]) -> Path:
    match path.suffix:
        case ".csv":
            np.savetxt(
                path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt="%.7g"
            )
        case ".npz":
            np.savez_compressed(path, **columns)
        case ".parquet":
            pa = pytest.importorskip("pyarrow")
            pytest.importorskip("pyarrow.parquet").write_table(pa.table(columns), path, row_group_size=777)
    return path


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet"])
def test_windows_are_the_file(tmp_path, suffix):
    columns = table(2500)
    path = write(tmp_path / f"log{suffix}", columns)
    assert row_count(path) == 2500
    parts = list(windows(path, 1000))
    assert [(first, len(part["time_s"])) for first, part in parts] == [(0, 1000), (1000, 1000), (2000, 500)]
    for name, values in columns.items():
        together = np.concatenate([part[name] for _, part in parts])
        np.testing.assert_allclose(together, values, rtol=1e-6 if suffix == ".csv" else 0, atol=1e-7 if suffix == ".csv" else 0)


@pytest.mark.parametrize(("suffix", "said"), [(".csv", "row 2001"), (".npz", "row 1001"), (".parquet", "row")])
def test_a_file_that_breaks_off(tmp_path, suffix, said):
    path = write(tmp_path / f"log{suffix}", table(3000))
    if suffix == ".csv":
        path.write_text(path.read_text().replace("\n2.5,", "\nnonsense,"))
    else:
        data = path.read_bytes()
        middle = len(data) // 2
        path.write_bytes(data[:middle] + bytes(1 + b % 255 for b in data[middle : middle + 4000]) + data[middle + 4000 :])
    with pytest.raises(InputError, match="not readable from row"):
        list(windows(path, 1000))


def test_windows_of_a_csv_with_semicolons_and_decimal_commas(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("a;b\n" + "".join(f"{i},5;{i}\n" for i in range(7)))
    parts = [(first, list(part["a"]), list(part["b"])) for first, part in windows(path, 5)]
    assert parts == [(0, [0.5, 1.5, 2.5, 3.5, 4.5], [0, 1, 2, 3, 4]), (5, [5.5, 6.5], [5, 6])]


def test_a_format_that_is_read_as_a_whole(tmp_path):
    assert row_count(tmp_path / "log.mcap") is None
    (tmp_path / "log.npz").write_bytes(b"no archive")
    assert row_count(tmp_path / "log.npz") is None


def test_the_number_of_csv_rows_is_estimated(tmp_path):
    path = write(tmp_path / "log.csv", table(60_000))
    assert path.stat().st_size > 2**20
    assert row_count(path) == pytest.approx(60_000, rel=0.05)


def test_rest_tells_nothing():
    rest = table(5000, active=np.zeros_like)
    recording = Recording(rest["time_s"], rest["torque_Nm"], rest["velocity_rad_s"], None, 1e-3)
    assert information(recording) is None


def test_the_windows_with_most_information_are_chosen():
    rng = np.random.default_rng(0)
    poor = [np.diag([1.0, 1.0, 1e-3, 1e-3]) * (1 + 0.01 * rng.random()) for _ in range(20)]
    grams = [*poor]
    grams[7] = np.eye(4)
    first, gain = informative(grams, 4)[0]
    assert first == 7
    assert gain > 0
    assert len({i for i, _ in informative(grams, 4)}) == 4


def test_parts_of_the_recording_that_have_none_come_first():
    grams = [np.eye(3)] * 40
    parts = sorted(i * 4 // 40 for i, _ in informative(grams, 4))
    assert parts == [0, 1, 2, 3]
    grams = [np.eye(3) * (100.0 if i < 10 else 1e-6) for i in range(40)]
    assert all(i < 10 for i, _ in informative(grams, 4))


def test_no_window_can_be_used():
    assert informative([None, None], 3) == []
    with pytest.raises(InputError, match="none of its 3 windows"):
        choose("log.csv", "", lambda rows: iter([(0, None), (rows, None), (2 * rows, None)]))


def test_a_long_file_becomes_stretches(tmp_path):
    moves = lambda t: ((t % 60) < 30).astype(float)  # noqa: E731
    columns = table(26 * ROWS, active=moves)
    columns["velocity_rad_s"][5 * ROWS + 17] = np.nan
    path = write(tmp_path / "log.npz", columns)
    loaded = load_all([path], [], MODEL, longest=1000)
    (part,) = loaded.stretches
    assert part.windows == 26
    assert part.unusable >= 1
    assert len(loaded.fitted) == 8
    assert len(loaded.held_out) == 4
    assert len({r.sha256 for r in (*loaded.fitted, *loaded.held_out)}) == 12
    assert all(len(r) == ROWS for r in loaded.fitted)
    assert not any(s.first <= 5 * ROWS + 17 < s.last for s in part.chosen)
    assert "12 stretches of 9.999 s" in part.sentence()


def test_a_long_held_out_file_is_held_out(tmp_path):
    short = write(tmp_path / "short.npz", table(900))
    path = write(tmp_path / "log.npz", table(14 * ROWS))
    loaded = load_all([short], [path], MODEL, longest=1000)
    assert len(loaded.fitted) == 1
    assert len(loaded.held_out) == 12
    columns = table(2000)
    del columns["torque_Nm"]
    bad = write(tmp_path / "bad.npz", columns)
    with pytest.raises(InputError, match="no column 'torque_Nm'"):
        load_all([bad], [], MODEL, longest=1000)
