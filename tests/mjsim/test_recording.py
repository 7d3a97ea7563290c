"""Recordings: every format, the bindings, and bad input in one line that names file, row or key, and what to do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mjsim.errors import InputError
from mjsim.recording import Binding, load

N = 50
TIME = np.arange(N) * 1e-3
COLUMNS = {"time_s": TIME, "torque_Nm": np.sin(TIME), "velocity_rad_s": np.cos(TIME), "angle_rad": TIME**2}


def write_csv(path: Path, columns=COLUMNS) -> Path:
    rows = np.column_stack(list(columns.values()))
    path.write_text(",".join(columns) + "\n" + "\n".join(",".join(f"{v:.17g}" for v in row) for row in rows) + "\n")
    return path


def write_mat(path: Path) -> Path:
    from scipy.io import savemat

    savemat(path, dict(COLUMNS))
    return path


def write_npz(path: Path) -> Path:
    np.savez(path, **COLUMNS)
    return path


def write_parquet(path: Path) -> Path:
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(arrow.table({**COLUMNS, "note": ["x"] * N}), path)
    return path


def mcap(path: Path, messages, encoding: str = "json") -> Path:
    """Messages: (topic, time [s], content)."""
    writing = pytest.importorskip("mcap.writer")
    with path.open("wb") as handle:
        writer = writing.Writer(handle)
        writer.start()
        schema = writer.register_schema("log", "jsonschema", b"{}")
        channels: dict[str, int] = {}
        for topic, at, content in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, encoding, schema)
            nanoseconds = 1_700_000_000_000_000_000 + round(at * 1e9)
            writer.add_message(channels[topic], nanoseconds, json.dumps(content).encode(), nanoseconds)
        writer.finish()
    return path


def write_mcap(path: Path) -> Path:
    rows = zip(*COLUMNS.values(), strict=True)
    return mcap(path, [("/axis", r[0], dict(zip(COLUMNS, map(float, r), strict=True))) for r in rows])


WRITERS = {".csv": write_csv, ".mat": write_mat, ".npz": write_npz, ".parquet": write_parquet, ".mcap": write_mcap}


@pytest.mark.parametrize("kind", WRITERS)
def test_every_format_gives_the_same_recording(tmp_path, kind):
    r = load(WRITERS[kind](tmp_path / f"log{kind}"))
    assert r.dt == 1e-3
    assert np.array_equal(r.torque, COLUMNS["torque_Nm"])
    assert np.array_equal(r.velocity, COLUMNS["velocity_rad_s"])
    assert np.array_equal(r.angle, COLUMNS["angle_rad"])
    assert len(r.sha256) == 64
    with pytest.raises(ValueError, match="read-only"):
        r.torque[0] = 1.0


def test_mcap_topics_are_joined_by_their_own_time(tmp_path):
    messages = []
    for t, u, v in zip(TIME, np.sin(TIME), np.cos(TIME), strict=True):
        messages += [("/command", t, {"effort": {"motor": u}}), ("/joint_states", t, {"velocity": [v, 2 * v]})]
    path = mcap(tmp_path / "log.mcap", messages)
    path.with_suffix(".toml").write_text(
        '[recording]\ntime = "command.log_time"\ntorque = "effort.motor"\nvelocity = "joint_states.velocity.1"\n'
    )
    r = load(path)
    assert r.dt == 1e-3
    assert np.array_equal(r.torque, np.sin(TIME))
    assert np.array_equal(r.velocity, 2 * np.cos(TIME))


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_that_is_not_what_its_name_says(tmp_path, kind):
    path = tmp_path / f"log{kind}"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 4)
    with pytest.raises(InputError) as caught:
        load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", WRITERS)
def test_an_empty_file(tmp_path, kind):
    (tmp_path / f"log{kind}").write_bytes(b"")
    with pytest.raises(InputError, match="the file is empty"):
        load(tmp_path / f"log{kind}")


@pytest.mark.parametrize("package", ["pyarrow", "mcap.reader"])
def test_a_missing_package_is_one_line(tmp_path, monkeypatch, package):
    import importlib

    kind = ".parquet" if package == "pyarrow" else ".mcap"
    path = WRITERS[kind](tmp_path / f"log{kind}")
    real = importlib.import_module

    def absent(name, *more):
        if name == package:
            raise ImportError(name)
        return real(name, *more)

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(InputError, match=rf"package '{package.partition('.')[0]}' .* pip install 'simgap\[formats\]'"):
        load(path)


def test_mcap_in_another_encoding(tmp_path):
    told = r"no topic can be read \('axis': messages encoded as 'flatbuffer'\); expected messages in JSON, Protobuf or of ROS 2"
    with pytest.raises(InputError, match=told):
        load(mcap(tmp_path / "log.mcap", [("/axis", 0.0, {"x": 1})], encoding="flatbuffer"))


def test_mcap_with_a_field_that_is_missing_in_some_messages(tmp_path):
    rows = [dict(zip(COLUMNS, map(float, r), strict=True)) for r in zip(*COLUMNS.values(), strict=True)]
    del rows[7]["torque_Nm"]
    with pytest.raises(InputError, match="torque is not finite in sample 8"):
        load(mcap(tmp_path / "log.mcap", [("/axis", r["time_s"], r) for r in rows]))


def test_an_empty_parquet_cell_names_row_and_column(tmp_path):
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(arrow.table({"time_s": [0.0, 0.1, 0.2], "torque_Nm": [1.0, None, 2.0]}), tmp_path / "log.parquet")
    with pytest.raises(InputError, match="row 2, column 'torque_Nm' is empty"):
        load(tmp_path / "log.parquet")


HEAD = "time_s,torque_Nm,velocity_rad_s\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "time_s,velocity_rad_s\n0,1\n1,2\n",
            "no column 'torque_Nm' for torque; expected one of the columns time_s",
        ),
        ("time_s,torque_Nm\n0,1\n1,2\n", "neither velocity nor angle"),
        (HEAD + "0,1,2\n1,x,2\n", "row 3, column 'torque_Nm': 'x'; expected a number"),
        (HEAD + "0,1,2\n1,2\n", "row 3 has 2 cells"),
        (HEAD + "0,1,2\n1,nan,2\n", "torque is not finite in row 3"),
        (HEAD + "0,1,2\n1,2,2\n1,2,2\n", "time does not increase at row 4"),
        (HEAD + "0,1,2\n1,2,2\n2,1,1\n3,1,1\n4.5,2,2\n5.5,2,2\n", "sample time"),
        (HEAD, "a header and no data"),
        ("1,2,3\n4,5,6\n", "row 1 holds numbers"),
        ("a,a\n1,2\n", "repeated column name"),
        (HEAD + "0,1,2\n", "1 samples; expected at least two"),
    ],
)
def test_a_bad_table_is_one_line(tmp_path, text, said):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        load(tmp_path / "log.csv")
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "log.csv") in str(caught.value)


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        (
            '[recording]\ntorque = {column = "torque_Nm", unit = "furlong"}',
            "unit 'furlong' is not known; expected one of Nm",
        ),
        ('[recording]\ntorque = {column = "torque_Nm", unit = "rad/s"}', "unit 'rad/s' measures velocity"),
        ('[recording]\ntorque = {column = "torque_Nm", unit = "V"}', "unit 'V' has no gain"),
        ('[recording]\ntorqe = "torque_Nm"', "key 'torqe' is not known"),
        ('[recording]\ntorque = {unit = "Nm"}', "no column named"),
        ('[recording]\ntorque = {column = "torque_Nm", row = 0}', "row 0 of 'torque_Nm'"),
        ("[recording", "not valid TOML"),
        ('[experiment]\nloop = "ajar"', "'ajar'; expected open or closed"),
    ],
)
def test_a_bad_binding_is_one_line(tmp_path, toml, said):
    write_csv(tmp_path / "log.csv").with_suffix(".toml").write_text(toml)
    with pytest.raises(InputError, match=said) as caught:
        load(tmp_path / "log.csv")
    assert "\n" not in str(caught.value)


def test_units_and_gains_make_si(tmp_path):
    path = write_csv(
        tmp_path / "log.csv", {"ms": 1e3 * TIME, "volt": np.ones(N), "rpm": np.full(N, 60.0), "deg": np.full(N, 180.0)}
    )
    path.with_suffix(".toml").write_text(
        '[recording]\ntime = {column = "ms", unit = "ms"}\ntorque = {column = "volt", unit = "V", gain = 35.1506}\n'
        'velocity = {column = "rpm", unit = "rpm"}\nangle = {column = "deg", unit = "deg"}\n[experiment]\njudge = "force"\n'
    )
    r = load(path)
    assert r.dt == 1e-3
    assert r.torque[0] == 35.1506
    assert r.velocity[0] == pytest.approx(2 * np.pi)
    assert r.angle[0] == pytest.approx(np.pi)
    assert (r.loop, r.judge) == (None, "force")


def test_the_binding_beside_the_recording_comes_before_that_beside_the_model(tmp_path):
    from mjsim.recording import find_binding

    recording, model = tmp_path / "log.csv", tmp_path / "m.xml"
    assert find_binding(recording, model).source == Binding.default().source
    model.with_suffix(".toml").write_text('[recording]\ntorque = "u"\n')
    assert find_binding(recording, model).channels["torque"].column == "u"
    recording.with_suffix(".toml").write_text('[recording]\ntorque = "w"\n')
    assert find_binding(recording, model).channels["torque"].column == "w"


def test_the_shipped_bindings_are_valid():
    from mjsim.models import shipped_model

    emps = Binding.from_toml(shipped_model("emps").with_suffix(".toml"))
    kuka = Binding.from_toml(shipped_model("kuka_kr300_axis1").with_suffix(".toml"))
    axis = Binding.from_toml(shipped_model("robot_axis1").with_suffix(".toml"))
    assert emps is not None
    assert (emps.loop, emps.judge, emps.channels["torque"].gain) == ("closed", "force", 35.1506)
    assert kuka is not None
    assert (kuka.loop, kuka.judge, kuka.channels["second_angle"].row) == ("closed", "force", 0)
    assert axis is not None
    assert {k: c.column for k, c in axis.channels.items()} == {k: c.column for k, c in Binding.default().channels.items()}


def test_slicing_keeps_every_channel(tmp_path):
    cut = load(write_csv(tmp_path / "log.csv")).slice(10, 20)
    assert len(cut) == 10
    assert cut.time[0] == pytest.approx(0.01)
    assert len(cut.columns["angle_rad"]) == 10


@pytest.mark.parametrize(("unit", "scale"), [("A", 1.0), ("mA", 1e-3), ("V", 1.0), ("mV", 1e-3)])
def test_the_gain_of_a_current_or_voltage_is_per_ampere_or_volt(tmp_path: Path, unit: str, scale: float) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{0.01 * i},{100 * (i % 7)},{0.1 * i}" for i in range(20)]
    path.write_text("\n".join(["time_s,u,velocity_rad_s", *rows]) + "\n", encoding="utf-8")
    beside = (
        f'[recording]\ntime = "time_s"\nvelocity = "velocity_rad_s"\ntorque = {{column = "u", unit = "{unit}", gain = 0.12}}\n'
    )
    path.with_suffix(".toml").write_text(beside, encoding="utf-8")
    assert load(path).torque == pytest.approx([0.12 * scale * 100 * (i % 7) for i in range(20)])
