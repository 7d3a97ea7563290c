"""One experiment of a MAT file that holds several, an acceleration, and headers in inches and pounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.io import savemat

import simgap
from mjsim.errors import InputError
from mjsim.readers import digest, read_table
from mjsim.readers.headers import guess
from mjsim.readers.mat import _Columns, _need_one
from mjsim.recording import load

N = 300
TIME = 0.01 * np.arange(N)


def log(k: int) -> dict[str, np.ndarray]:
    return {"time_s": TIME, "torque_Nm": k * np.sin(TIME), "angle_rad": k * np.cos(TIME)}


def structs(path):
    """Two experiments as an array of structs."""
    kinds = [(name, object) for name in log(1)]
    savemat(path, {"run": np.array([tuple(log(k).values()) for k in (1, 2)], dtype=kinds)})
    return path


def bind(path):
    path.with_suffix(".toml").write_text(
        '[recording]\ntime = "run.time_s"\ntorque = "run.torque_Nm"\nangle = "run.angle_rad"\n', encoding="utf-8"
    )


def test_an_experiment_of_an_array_of_structs_is_chosen_by_its_number(tmp_path):
    path = structs(tmp_path / "log.mat")
    bind(path)
    logs = [load(tmp_path / f"log.mat#{k}") for k in (1, 2)]
    for k, r in enumerate(logs, 1):
        np.testing.assert_allclose(r.angle, k * np.cos(TIME))
        assert r.source == f"log.mat#{k}"
    assert len({digest(path), *(r.sha256 for r in logs)}) == 3
    np.testing.assert_allclose(simgap.load(str(tmp_path / "log.mat#2")).torque, 2 * np.sin(TIME))


def test_an_experiment_of_cell_arrays_is_chosen_by_its_number(tmp_path):
    cells = {}
    for name in log(1):
        cells[name] = np.empty(2, object)
        cells[name][:] = [log(1)[name], log(2)[name][:-20]]
    savemat(tmp_path / "log.mat", cells)
    assert len(load(tmp_path / "log.mat#1")) == N
    assert len(load(tmp_path / "log.mat#2")) == N - 20


@pytest.mark.parametrize(
    ("part", "said"),
    [("", "it holds 2 experiments; .*log.mat#1 to log.mat#2"), ("#0", "expected #1 to #2"), ("#3", "it holds 2 experiments")],
)
def test_a_choice_that_the_file_does_not_hold_is_refused_in_one_line(tmp_path, part, said):
    structs(tmp_path / "log.mat")
    with pytest.raises(InputError, match=said) as error:
        load(tmp_path / f"log.mat{part}")
    assert "\n" not in str(error.value)


def test_a_number_of_a_file_with_one_experiment_is_refused(tmp_path):
    savemat(tmp_path / "log.mat", log(1))
    assert len(load(tmp_path / "log.mat")) == N
    with pytest.raises(InputError, match="leave the number out"):
        load(tmp_path / "log.mat#1")


def test_experiments_beside_plain_columns_do_not_stop_these(tmp_path):
    structs(tmp_path / "runs.mat")
    from scipy.io import loadmat

    both = {k: v for k, v in loadmat(tmp_path / "runs.mat").items() if not k.startswith("__")} | log(1)
    savemat(tmp_path / "log.mat", both)
    assert len(load(tmp_path / "log.mat")) == N
    assert "run.time_s" in read_table(tmp_path / "log.mat#2")


def test_an_object_of_a_matlab_class_is_refused_with_what_works(tmp_path):
    MatlabOpaque = type("MatlabOpaque", (np.ndarray,), {})
    held = {"data": np.zeros(1).view(MatlabOpaque)}
    with pytest.raises(InputError, match="save its signals as arrays in MATLAB"):
        _need_one(tmp_path / "log.mat", _Columns({}, [], None), held)


def test_other_formats_have_no_experiments(tmp_path):
    np.savetxt(tmp_path / "log.csv", np.column_stack(list(log(1).values())), delimiter=",", header=",".join(log(1)), comments="")
    with pytest.raises(InputError, match="no such file"):
        load(tmp_path / "log.csv#1")


def test_an_acceleration_is_refused_with_what_works(tmp_path):
    columns = log(1)
    columns["acceleration_rad_s2"] = columns.pop("angle_rad")
    np.savez(tmp_path / "log.npz", **columns)
    with pytest.raises(InputError, match=r"only 'acceleration_rad_s2'.*integrate the acceleration"):
        load(tmp_path / "log.npz")
    (tmp_path / "log.toml").write_text('[recording]\nacceleration = "acceleration_rad_s2"\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"key 'acceleration' is not known.*velocity and angle are fitted"):
        load(tmp_path / "log.npz")


@pytest.mark.parametrize(
    ("header", "channel", "unit"),
    [("Load [kip]", "torque", "kip"), ("stroke_in", "angle", "in"), ("Stroke [inch]", "angle", "in"),
     ("force_lbf", "torque", "lbf"), ("speed_in_s", "velocity", "in/s"), ("Torque [ft-lbf]", "torque", "lbf ft"),
     ("Torque (in-lb)", "torque", "lbf in"),
     ("position [ft]", "angle", "ft"), ("Velocity (ft/s)", "velocity", "ft/s"), ("torque [lbf ft]", "torque", "lbf ft")],
)  # fmt: skip
def test_a_header_states_a_unit_of_inches_and_pounds(header, channel, unit):
    assert guess([header]) == {channel: (header, unit)}


def test_words_of_testing_machines_stand_behind_the_others():
    assert guess(["Torque [N m]", "Load [N m]"]) == {"torque": ("Torque [N m]", "Nm")}


def test_a_log_in_inches_and_kips_is_read_by_its_headers(tmp_path):
    table = np.column_stack([TIME, np.sin(TIME), 3 * np.cos(TIME)])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="Time [s],Load [kip],Stroke [in]", comments="")
    r = load(tmp_path / "log.csv")
    assert r.torque == pytest.approx(4448.2216152605 * np.sin(TIME))
    assert r.angle == pytest.approx(0.0762 * np.cos(TIME))
    assert (r.units["torque"], r.units["angle"]) == ("N", "m")
