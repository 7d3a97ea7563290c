"""Recordings of known truth, short and made on the spot; which tests are the long proofs is said by the mark ``slow``."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

# one thread for the linear algebra: threads of its own would fight those of the search
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest

from lab.benchmark.experiment import RATE, Experiment
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import record as plant_record
from mjsim.axis import Axis
from mjsim.effects import Effect
from mjsim.excitation import chirp
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate
from mjsim.recording import Recording
from simgap import cli

DT = 5e-4
NOISE = 0.05  # rms of the velocity noise [rad/s]
CHANGED = {"Jm": 4.7e-4, "fm": 0.0345, "kg": 1.46e5, "ka": 0.458e5, "Ja": 1.66}  # an axis is never quite its data sheet

Record = Callable[..., Recording]

# Where nothing is compiled yet, these compile most of what all tests run. The first worker begins with the first tuple and the
# last with the second: they compile different functions, since one that needs what the other compiles waits for it.
COMPILES = (
    ("tests/mjsim/test_crosscheck.py",),
    (
        "tests/ident/test_tools.py",
        "tests/mjsim/test_servo.py",
        "tests/mjsim/test_joint_limit.py",
        "tests/mjsim/test_plants.py",
    ),
)


def pytest_collection_finish() -> None:
    """Python's collector of cycles looks no more at what stays to the end: modules, syntax trees, the items themselves."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Place `COMPILES` where the first and the last of xdist's workers begin, which take consecutive parts of equal length."""
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if workers < 2:
        return
    groups: tuple[list[pytest.Item], ...] = ([], [], [])
    for item in items:
        file = item.nodeid.split("::")[0]
        groups[next((k for k, files in enumerate(COMPILES) if file in files), 2)].append(item)
    first, last, rest = groups
    last.sort(key=lambda item: COMPILES[1].index(item.nodeid.split("::")[0]))
    at = 0  # the number of tests ahead of the last worker's, as xdist shares them out
    for k in range(workers - 1):
        at += (len(items) - at) // (workers - k)
    ahead = max(at - len(first), 0)
    items[:] = [*first, *rest[:ahead], *last, *rest[ahead:]]


@pytest.fixture(scope="session")
def robot() -> Axis:
    """The nominal robot axis, from its MJCF."""
    return load_axis(shipped_model("robot_axis1"))


@pytest.fixture(scope="session")
def record(robot: Axis) -> Record:
    """``record(Effect, ..., seconds=2, seed=0, amplitude=1, noise=0.05, changed=True)``: a chirp from 0.5 to 30 Hz at 2 kHz.

    The angle carries 1e-4 rad of noise, as an encoder of the motor does.
    """

    def make(*effects: Effect, seconds: float = 2.0, seed: int = 0, amplitude: float = 1.0, noise: float = NOISE,
             changed: bool = True, axis: Axis | None = None, top: float = 30.0) -> Recording:  # fmt: skip
        plant = axis or (robot.with_linear(CHANGED) if changed else robot)
        for e in effects:
            plant = plant + e
        torque = chirp(seconds, DT, amplitude, 0.5, top)
        run = simulate(plant, torque, DT)
        rng = np.random.default_rng(seed)
        return Recording(
            run.time, torque, run.velocity + noise * rng.standard_normal(len(torque)),
            run.angle + 1e-4 * rng.standard_normal(len(torque)), DT, source=f"synthetic_{seed}.csv",
        )  # fmt: skip

    return make


@pytest.fixture(scope="session")
def pair(record: Record) -> Callable[..., tuple[Recording, Recording]]:
    """Two recordings of the same axis on other noise and another excitation: for the fit, and held out."""

    def make(*effects: Effect, **options: float) -> tuple[Recording, Recording]:
        first = record(*effects, **options)
        other = record(*effects, **{"seed": 1, "top": 24.0, **options, "amplitude": 0.8 * options.get("amplitude", 1.0)})
        return first, other

    return make


@pytest.fixture(scope="session")
def sealed() -> Callable[..., list[Recording]]:
    """``sealed(laws, experiments, seed, noise=0.05)``: recordings of the benchmark's plant, whose laws and solver are its own."""

    def make(laws: Laws, experiments: Sequence[Experiment], seed: int, noise: float = NOISE) -> list[Recording]:
        rng = np.random.default_rng(seed)
        motions = [plant_record(laws, e, Measurement(velocity_noise=noise), rng) for e in experiments]
        return [Recording(m.time, m.torque, m.velocity, m.angle, 1 / RATE) for m in motions]

    return make


@pytest.fixture(scope="session")
def local_copy() -> Callable[..., Path]:
    """``local_copy("emps", "DATA_EMPS.mat")``: a file of a local copy of recordings that are not part of the project, else skip.

    Looked for under the folder SIMGAP_DATA names, else in ``shared`` beside the checkout.
    """

    def find(folder: str, file: str) -> Path:
        beside = Path(__file__).resolve().parents[2] / "shared"
        given = os.environ.get("SIMGAP_DATA")
        for top in (Path(given) if given else beside, beside):
            for path in (top / folder / file, top / "real" / folder / file, top / file):
                if path.is_file():
                    return path
        pytest.skip(f"no local copy of {folder}/{file}: set SIMGAP_DATA to the folder that holds it")

    return find


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """One headless Chromium for all tests of pages."""
    from browser import started

    with started() as found:
        yield found


@pytest.fixture(autouse=True)
def _compile_without_a_word(monkeypatch):
    """What a test expects on standard error does not depend on what this machine has compiled before."""
    monkeypatch.setattr(cli, "tell_compiling", lambda listener: None)


@pytest.fixture
def run_cli(monkeypatch, capsys, tmp_path):
    """``run_cli("data", ...)`` -> (exit code, standard output, standard error), in an empty folder and with an empty cache."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("SIMGAP_DATA", raising=False)

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["simgap", *map(str, words)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        return int(ended.value.code or 0), said.out, said.err

    return call


@pytest.fixture
def simgap(monkeypatch, capfd, tmp_path):
    """``simgap("run", ...)`` -> (exit code, standard output, standard error), in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["simgap", *words])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capfd.readouterr()
        return int(ended.value.code or 0), said.out, said.err

    return call
