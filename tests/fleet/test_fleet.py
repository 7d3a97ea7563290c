"""A fleet: its plan, its records, its table, what the table shows, and the runs on a Dask cluster."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from browser import WINDOWS, looks_right

from mjsim.errors import InputError
from simgap.fleet.page import headline, write_page
from simgap.fleet.plan import Job, Settings, jobs, select
from simgap.fleet.run import done, forget_failed, run
from simgap.fleet.table import COLUMNS, read_records, rows, write_parquet
from simgap.fleet.task import diagnose_one, place, record_of, write_record
from simgap.fleet.trends import drifts, outliers, to_record_again
from tests.commands import refused

MODEL = """<mujoco><option timestep="0.004" integrator="implicitfast"/><worldbody><body name="rod"><joint name="hinge" axis="0 1 0" damping="0.05"/>
<geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass="1"/></body></worldbody>
<actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""  # noqa: E501


def write_log(path: Path, friction: float, seed: int, seconds: float = 4.0) -> Path:
    import mujoco

    model = mujoco.MjModel.from_xml_string(MODEL.replace('damping="0.05"', f'damping="0.05" frictionloss="{friction}"'))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    n = int(seconds / 0.004)
    t = 0.004 * np.arange(n)
    torque = 1.5 * np.sin(2 * np.pi * (0.3 + 0.3 * t) * t + rng.uniform(0, 1))
    out = np.empty((n, 2))
    for i in range(n):
        out[i] = data.qpos[0], data.qvel[0]
        data.ctrl[0] = torque[i]
        mujoco.mj_step(model, data)
    out += rng.standard_normal((n, 2)) * (1e-4, 3e-3)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack([t, torque, out[:, 1], out[:, 0]]), delimiter=",", comments="", fmt="%.7g",
               header="time_s,torque_Nm,velocity_rad_s,angle_rad")  # fmt: skip
    return path


def model_in(folder: Path) -> Path:
    path = folder / "pendulum.xml"
    path.write_text(MODEL)
    return path


def test_the_plan_tells_robots_and_dates(tmp_path):
    model = model_in(tmp_path)
    for name in ("arm1/2026-03-01.csv", "arm1/log_20260302T1530.csv", "arm2/plain.csv", "arm2/plain.toml"):
        path = tmp_path / "logs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")
    found = jobs(str(tmp_path / "logs/**/*"), model, Settings())
    assert [j.robot for j in found] == ["arm1", "arm1", "arm2"]
    assert [j.date for j in found][:2] == ["2026-03-01T00:00:00+00:00", "2026-03-02T15:30:00+00:00"]
    assert len({j.key for j in found}) == 3
    assert select(found, {found[0].key}) == found[1:]
    other = jobs(str(tmp_path / "logs/**/*"), model, Settings(seed=1))
    assert not {j.key for j in other} & {j.key for j in found}
    named = jobs(str(tmp_path / "logs/*/log*.csv"), model, Settings(), r"log_(?P<date>\d{8})T(?P<robot>\d+)")
    assert (named[0].robot, named[0].date) == ("1530", "2026-03-02T00:00:00+00:00")


@pytest.mark.parametrize(
    ("pattern", "robot", "said"),
    [
        ("nothing*", "", "no file matches"),
        ("*.xml", "(", "no regular expression"),
        ("*.xml", "arm", "no group"),
        ("*.xml", "(?P<robot>zz)", "does not match"),
    ],
)
def test_a_plan_that_cannot_be_made(tmp_path, pattern, robot, said):
    model = model_in(tmp_path)
    with pytest.raises(InputError, match=said):
        jobs(str(tmp_path / pattern), model, Settings(), robot)


def test_a_record_of_each_kind(tmp_path):
    model = model_in(tmp_path)
    write_log(tmp_path / "a" / "good.csv", 0.2, 0, 2.4)
    (tmp_path / "a" / "bad.csv").write_text("time_s,torque_Nm\n0,x\n")
    bad, good = jobs(str(tmp_path / "a/*.csv"), model, Settings(effects=("coulomb_friction",)))
    record = record_of(bad, tmp_path)
    assert "number" in record["refused"]
    (row,) = rows(record)
    assert row["verdict"] == "refused"
    assert diagnose_one(good, str(tmp_path)) == good.key
    path = place(tmp_path, good.key)
    before = path.stat().st_mtime_ns
    diagnose_one(good, str(tmp_path))
    assert path.stat().st_mtime_ns == before
    (record,) = read_records(tmp_path, [good.key, "missing"])
    (row,) = rows(record)
    assert (row["effect"], row["verdict"], row["robot"]) == ("coulomb_friction", "missing_physics", "a")
    assert row["low"] < row["value"] < row["high"]
    assert row["value"] == pytest.approx(0.2, rel=0.05)
    assert done(tmp_path) == {good.key}


def test_a_fault_is_a_record(tmp_path, monkeypatch):
    job = jobs(str(model_in(tmp_path)), tmp_path / "pendulum.xml", Settings())[0]
    monkeypatch.setattr("simgap.fleet.task._diagnosis", lambda job, folder: 1 / 0)
    record = record_of(job, tmp_path)
    assert record["fault"] == "ZeroDivisionError: division by zero"
    assert rows(record)[0]["verdict"] == "failed"


def fails_with(monkeypatch, error: Exception) -> None:
    def fail(job, folder):
        raise error

    monkeypatch.setattr("simgap.fleet.task._diagnosis", fail)


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "No space left on device"), OSError(errno.EACCES, "denied", "pendulum.xml")]
)
def test_a_place_that_cannot_be_used_is_no_record(tmp_path, monkeypatch, error):
    """A full disk, or a model that cannot be read, says nothing of the recording: the next run diagnoses it."""
    job = jobs(str(model_in(tmp_path)), tmp_path / "pendulum.xml", Settings())[0]
    job = dataclasses.replace(job, log="a.csv")
    fails_with(monkeypatch, error)
    with pytest.raises(OSError, match=error.strerror):
        diagnose_one(job, str(tmp_path / "out"))
    assert not done(tmp_path / "out")


def test_a_recording_that_the_system_refuses_is_refused(tmp_path, monkeypatch):
    job = jobs(str(model_in(tmp_path)), tmp_path / "pendulum.xml", Settings())[0]
    for at in (job.log, str(Path(job.log).with_suffix(".toml"))):
        fails_with(monkeypatch, PermissionError(errno.EACCES, "Permission denied", at))
        (found,) = rows(record_of(job, tmp_path))
        assert found["verdict"] == "refused"
        assert found["problem"].startswith(f"{job.log}: Permission denied; expected a file that can be read")


def test_a_run_stops_where_its_folder_cannot_be_written(tmp_path, monkeypatch):
    """The error of the worker is that of the run; none of the recordings has a record."""
    distributed = pytest.importorskip("distributed")

    @contextlib.contextmanager
    def in_threads(scheduler, workers, memory):
        with distributed.Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None) as client:
            yield client

    planned = [Job(f"{k:024}", f"{k}.csv", "m.xml", "r", "", Settings()) for k in range(8)]
    fails_with(monkeypatch, OSError(errno.ENOSPC, "No space left on device", "out/records"))
    monkeypatch.setattr("simgap.fleet.run._client", in_threads)
    with pytest.raises(InputError, match="out: the fleet is not finished: out/records: No space left on device"):
        run(planned, tmp_path / "out")
    assert not done(tmp_path / "out")


@pytest.mark.parametrize("memory", ["lots", "-1", "nan"])
def test_a_limit_of_memory_that_is_none(simgap, tmp_path, memory):
    pytest.importorskip("distributed")
    (tmp_path / "a.csv").write_text("a")
    model_in(tmp_path)
    refused(
        simgap("fleet", "a.csv", "--model", "pendulum.xml", "--out", "out", "--quiet", "--memory", memory),
        f"--memory: {memory!r}",
    )


def recorded(tmp_path: Path, *without: str) -> list[Job]:
    """A fleet of two recordings with records: those named in ``without`` have a reason in place of a diagnosis."""
    model = model_in(tmp_path)
    for name in ("a", "b"):
        (tmp_path / f"{name}.csv").write_text(name)
    planned = jobs("*.csv", model, Settings())
    for job, kind in zip(planned, (*without, "", ""), strict=False):
        record = {kind: "too short"} if kind else {"diagnosis": {"verdict": "no_mismatch"}}
        write_record(place(tmp_path / "out", job.key), {"job": job.as_dict(), "seconds": 0.0, **record})
    return planned


def test_exit_codes(simgap, tmp_path):
    words = ("fleet", "*.csv", "--model", "pendulum.xml", "--out", "out", "--quiet")
    recorded(tmp_path)
    assert simgap(*words, "--require-all")[0] == 0
    recorded(tmp_path, "refused")
    code, out, err = simgap(*words)
    assert (code, err) == (0, "")
    assert "1 refused" in out
    code, out, err = simgap(*words, "--require-all", "--json")
    assert code == 1
    assert json.loads(out)["verdicts"] == {"refused": 1, "no_mismatch": 1}
    assert err == "simgap: *.csv: 1 of 2 recordings could not be diagnosed; a.csv: too short\n"
    recorded(tmp_path, "refused", "refused")
    refused(simgap(*words), "*.csv: none of its recordings could be diagnosed; a.csv: too short; out/fleet.html has all reasons")
    assert (tmp_path / "out/fleet.html").exists()
    assert (tmp_path / "out/fleet.parquet").exists()


def test_what_failed_is_tried_again(simgap, tmp_path):
    failed, good = recorded(tmp_path, "fault")
    assert forget_failed([failed, good], tmp_path / "out") == 1
    assert done(tmp_path / "out") == {good.key}


def row(robot: str, day: int, value: float | None, error: float = 0.01, **more) -> dict:
    base = dict.fromkeys(COLUMNS) | {
        "robot": robot, "date": f"2026-01-{day:02d}T00:00:00+00:00", "log": f"{robot}/{day}.csv", "key": f"{robot}{day}",
        "joint": "", "verdict": "missing_physics", "effect": "coulomb_friction", "place": "motor", "parameter": "torque_Nm",
        "value": value, "unit": "N m",
    }  # fmt: skip
    if value is not None:
        base |= {"low": value - 1.96 * error, "high": value + 1.96 * error}
    return base | more


def test_drift_is_found_where_it_is():
    rng = np.random.default_rng(0)
    still = [row(f"s{i}", d, 0.3 + 0.01 * rng.standard_normal()) for i in range(20) for d in range(1, 11)]
    assert drifts(still) == []
    moving = [row("worn", d, 0.3 + 0.01 * d + 0.01 * rng.standard_normal()) for d in range(1, 11)]
    (found,) = drifts([*still, *moving])
    assert found.robot == "worn"
    assert found.low < 0.01 < found.high
    assert drifts([row("few", d, 0.1 * d) for d in (1, 2, 3)]) == []


def test_scatter_beyond_the_intervals_is_no_drift():
    values = [0.3, 0.5, 0.2, 0.45, 0.31, 0.52]
    assert drifts([row("r", d + 1, v, error=1e-4) for d, v in enumerate(values)]) == []


def test_the_robot_that_is_unlike_the_others():
    table = [row(f"r{i}", d, v) for i, v in enumerate((0.30, 0.31, 0.29, 0.32, 0.30, 0.9)) for d in (1, 2)]
    (found,) = outliers(table)
    assert (found.robot, found.value) == ("r5", 0.9)
    assert outliers(table[:8]) == []


def test_what_has_to_be_recorded_again():
    table = [row("a", 1, 0.3), row("b", 1, None, verdict="refused", effect=None, problem="too short"),
             row("b", 2, None, verdict="unexplained", effect=None, next_experiment="more torque")]  # fmt: skip
    assert to_record_again(table) == [("b", "b/1.csv", "refused", "too short"), ("b", "b/2.csv", "unexplained", "more torque")]
    assert headline(table) == "1 missing physics, 1 refused, 1 unexplained"


def test_table_and_page(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    table = [row("<b>x</b>", d, 0.01 * d) for d in range(1, 8)] + [row("y", 1, None, effect=None, verdict="no_mismatch")]
    assert write_parquet(tmp_path / "fleet.parquet", table) == 8
    assert parquet.read_table(tmp_path / "fleet.parquet").column_names == list(COLUMNS)
    write_page(tmp_path / "fleet.html", table, "m.xml")
    text = (tmp_path / "fleet.html").read_text()
    assert "&lt;b&gt;x&lt;/b&gt;" in text
    assert "<b>x" not in text
    assert "<polyline" in text
    assert sorted(p.name for p in tmp_path.iterdir()) == ["fleet.html", "fleet.parquet"]


@WINDOWS
def test_the_page_in_a_browser(browser, tmp_path, widths):
    table = [
        row(f"r{i}", d, v + 0.01 * d * (i == 1)) for i, v in enumerate((0.30, 0.31, 0.29, 0.32, 0.30, 0.9)) for d in range(1, 8)
    ]
    table.append(row("a-robot-with-a-rather-long-name", 1, None, verdict="refused", effect=None, problem="too short"))
    write_page(tmp_path / "fleet.html", table, "m.xml")
    looks_right(browser, tmp_path / "fleet.html", widths=widths)


def test_a_record_is_whole_or_not_there(tmp_path):
    target = tmp_path / "records" / "ab" / "key.json"
    with pytest.raises(TypeError):
        write_record(target, {"a": object()})
    assert list(target.parent.iterdir()) == []


@pytest.mark.slow
def test_a_fleet_survives_killed_workers(tmp_path, monkeypatch):
    """Workers are killed at random while 24 recordings are diagnosed: each has one record, and a rerun does nothing."""
    pytest.importorskip("distributed")
    import psutil

    model = model_in(tmp_path)
    for robot in range(4):
        for day in range(1, 7):
            write_log(tmp_path / f"logs/r{robot}/2026-01-{day:02d}.csv", 0.15 + 0.05 * robot, 10 * robot + day)
    planned = jobs(str(tmp_path / "logs/*/*.csv"), model, Settings(effects=("coulomb_friction",)))
    rng = np.random.default_rng(0)
    stop, killed = threading.Event(), []

    def killer() -> None:
        while not stop.wait(float(rng.uniform(4, 8))) and len(killed) < 3:
            workers = [p for p in psutil.Process().children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]
            if len(workers) > 1:
                victim = workers[int(rng.integers(len(workers)))]
                killed.append(victim.pid)
                os.kill(victim.pid, signal.SIGKILL)

    thread = threading.Thread(target=killer)
    thread.start()
    try:
        assert run(planned, tmp_path / "out", workers=2) == 24
    finally:
        stop.set()
        thread.join()
    assert killed
    assert done(tmp_path / "out") == {j.key for j in planned}
    table = [r for record in read_records(tmp_path / "out", (j.key for j in planned)) for r in rows(record)]
    assert {r["verdict"] for r in table} == {"missing_physics"}
    began = time.perf_counter()
    assert run(planned, tmp_path / "out", workers=2) == 0
    assert time.perf_counter() - began < 1.0
    assert not list((tmp_path / "out").rglob("*.part"))
    assert json.loads(place(tmp_path / "out", planned[0].key).read_text())["job"]["robot"] == "r0"


def test_what_a_killed_worker_left_is_removed(tmp_path):
    """Half a record beside whole ones: the next run removes it, also where nothing is left to do."""
    model = model_in(tmp_path)
    write_log(tmp_path / "logs/r0/2026-01-01.csv", 0.15, 0)
    planned = jobs(str(tmp_path / "logs/*/*.csv"), model, Settings())
    target = place(tmp_path / "out", planned[0].key)
    write_record(target, {"job": planned[0].as_dict(), "refused": "made"})
    target.with_suffix(".123.part").write_text("{")
    assert run(planned, tmp_path / "out") == 0
    assert [p.name for p in target.parent.iterdir()] == [target.name]
