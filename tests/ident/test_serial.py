"""Files that belong together are written together; a recording becomes data; roots carry their errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ident import IOData, PolyModel, Structure, bj, pole_zero
from ident.serial import write_set
from mjsim.errors import InputError
from mjsim.recording import Recording, load


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_a_set_is_written_whole(tmp_path):
    out = tmp_path / "a" / "b"
    write_set({out / "x": "new", out / "sub" / "y": b"\x00"})
    assert (out / "x").read_text() == "new"
    assert (out / "sub" / "y").read_bytes() == b"\x00"
    write_set({out / "x": "newer"})
    assert (out / "x").read_text() == "newer"
    assert names(out) == ["sub", "x"]


@pytest.mark.parametrize("fails", [1, 2, 3])
@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
@pytest.mark.parametrize("step", ["write_bytes", "replace"])
def test_a_failure_in_the_middle_leaves_what_was_there(tmp_path, monkeypatch, fails, error, step):
    out = tmp_path / "out"
    old, fresh = {out / n: f"old {n}" for n in "xyz"}, {out / n: f"new {n}" for n in "xyz"}
    write_set(old)
    real, calls = getattr(Path, step), [0]

    def sometimes(self, *args):
        calls[0] += 1
        if calls[0] == fails:
            raise error("disk full")
        return real(self, *args)

    with monkeypatch.context() as patch:
        patch.setattr(Path, step, sometimes)
        with pytest.raises(error):
            write_set(fresh)
    assert names(out) == ["x", "y", "z"]
    assert [(out / n).read_text() for n in "xyz"] == ["old x", "old y", "old z"]


def test_a_failure_takes_away_the_folder_that_was_made(tmp_path):
    (tmp_path / "there").write_text("a file")
    with pytest.raises(FileExistsError):
        write_set({tmp_path / "out" / "x": "1", tmp_path / "there" / "y": "2"})
    assert names(tmp_path) == ["there"]


def a_recording(**more):
    t = 0.01 * np.arange(50)
    arrays = {"torque": np.sin(t), "velocity": np.cos(t), "angle": t}
    return Recording(time=t, **(arrays | more), dt=0.01, source="log.csv", columns={"current_A": 2 * t})


def test_a_recording_becomes_data():
    data = IOData.from_recording(a_recording(units={"torque": "N", "velocity": "m/s"}))
    assert (data.u_name, data.u_unit, data.y_name, data.y_unit) == ("torque", "N", "velocity", "m/s")
    assert (data.dt, data.source, len(data)) == (0.01, "log.csv", 50)
    assert IOData.from_recording(a_recording(velocity=None)).y_name == "angle"
    other = IOData.from_recording(a_recording(), "current_A", "angle")
    assert (other.u_name, other.u_unit, other.u[1]) == ("current_A", "A", 0.02)
    with pytest.raises(InputError, match=r"log\.csv: no column 'x'"):
        IOData.from_recording(a_recording(), "x")


def test_units_come_from_the_binding(tmp_path):
    path = tmp_path / "log.csv"
    t = 0.01 * np.arange(30)
    np.savetxt(path, np.column_stack([t, np.sin(t), t]), delimiter=",", header="time_s,torque_Nm,angle_rad", comments="")
    assert IOData.from_recording(load(path)).u_unit == "Nm"
    (tmp_path / "log.toml").write_text(
        '[recording]\ntime="time_s"\ntorque={column="torque_Nm",unit="V",gain=35.0}\nangle={column="angle_rad",unit="mm"}\n'
    )
    data = IOData.from_recording(load(path))
    assert (data.u_unit, data.y_unit) == ("", "m")
    assert data.y[-1] == pytest.approx(29e-5)


def test_errors_of_frequency_and_damping_are_those_of_finite_differences():
    f, dt = np.real(np.poly([0.9 * np.exp(0.4j), 0.9 * np.exp(-0.4j)])), 0.01
    covariance = np.zeros((3, 3))
    covariance[1:, 1:] = [[4e-6, -3e-6], [-3e-6, 5e-6]]

    def root(f):
        return pole_zero(PolyModel(Structure.oe(1, 2, 1), dt, [1], [1], [1], [1], f, covariance=covariance)).poles[0]

    def slope(name):
        return np.array([(getattr(root(f + h), name) - getattr(root(f - h), name)) / 2e-7 for h in 1e-7 * np.eye(3)[1:]])

    at = root(f)
    for value, error in (("frequency_hz", "frequency_std_hz"), ("damping", "damping_std")):
        g = slope(value)
        assert getattr(at, error) == pytest.approx(np.sqrt(g @ covariance[1:, 1:] @ g), rel=1e-4)


@pytest.mark.slow
def test_errors_of_the_natural_frequency_cover(bj_truth):
    truth = pole_zero(bj_truth.model).poles[0]
    scores = []
    for seed in range(200):
        found = pole_zero(bj(bj_truth.record(2000, 3000 + seed), (2, 2, 2, 2, 1)).model).poles[0]
        scores.append((found.frequency_hz - truth.frequency_hz) / found.frequency_std_hz)
    assert 0.9 < np.std(scores) < 1.1
