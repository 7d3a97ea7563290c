"""Kill a command at random moments, look at what it leaves, and let it run again.

    python -m lab.kill diagnose --count 100
    python -m lab.kill fleet --count 20
    python -m lab.kill study --count 20 --within 30
    python -m lab.kill benchmark --count 20

The command runs as a process group of its own, which receives SIGKILL after a uniform random part of the time that a whole
run takes, or of ``--within`` seconds: a long command then receives many kills before it ends. After each kill, a file under a
final name has the bytes of the reference (a run that was let alone) but for times. The next run continues in the same folder;
each that ends gives all files of the reference, and the folder is emptied. Two runs that are let alone are compared first.
Exit code 1 where something differs.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import click
import numpy as np

__all__ = ["EFFECT", "Outcome", "contents", "differences", "kill", "main", "write_log"]

MODEL = """<mujoco><option timestep="0.004" integrator="implicitfast"/><worldbody><body name="rod">
<joint name="hinge" axis="0 1 0" damping="0.05"/><geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass="1"/></body>
</worldbody>
<actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
EFFECT = "coulomb_friction"
TIMES = (
    (rb'"seconds": ?[0-9.e+-]+', b'"seconds": 0'),
    (rb"; [0-9.]+ s; python", b"; 0 s; python"),
    (rb'"(median|worst|sum)": ?[0-9.e+-]+(?=,\n   ?"(worst|sum|slow)")', rb'"\1": 0'),  # `seconds` of benchmark.json
    (rb'"slow": ?[0-9]+', b'"slow": 0'),  # cases that take more than a minute
    (rb'data-label="Seconds" class="n">[0-9.]+<', b'data-label="Seconds" class="n">0<'),
    (rb"Seconds a case: median [0-9.]+, worst [0-9.]+", b"Seconds a case: median 0, worst 0"),
)


@dataclass
class Outcome:
    """Figures: kills, runs that ended (each compared), seconds of a whole run, what differed."""

    command: str
    kills: int = 0
    ended: int = 0
    whole_s: float = 0.0
    wrong: list[str] = field(default_factory=list)


def write_log(path: Path, friction: float, seed: int, rows: int = 1000) -> None:
    """So many rows at 250 Hz of a pendulum with Coulomb friction, stepped by plain MuJoCo."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(MODEL.replace('damping="0.05"', f'damping="0.05" frictionloss="{friction}"'))
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    t = 0.004 * np.arange(rows)
    torque = 1.5 * np.sin(2 * np.pi * (0.3 + 0.3 * t) * t)
    motion = np.empty((len(t), 2))
    for i, u in enumerate(torque):
        motion[i] = data.qpos[0], data.qvel[0]
        data.ctrl[0] = u
        mujoco.mj_step(model, data)
    motion += rng.standard_normal(motion.shape) * (1e-4, 3e-3)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, time_s=t, torque_Nm=torque, velocity_rad_s=motion[:, 1], angle_rad=motion[:, 0])


def _diagnose(folder: Path) -> list[str]:
    write_log(folder / "a.npz", 0.15, 0)
    return ["diagnose", "a.npz", "--model", "pendulum.xml", "--effects", EFFECT]


def _fleet(folder: Path) -> list[str]:
    for i in range(4):
        write_log(folder / f"logs/robot{i % 2}/2026-01-0{1 + i // 2}.npz", 0.1 + 0.05 * (i % 2), i)
    return ["fleet", "logs/*/*.npz", "--model", "pendulum.xml", "--effects", EFFECT, "--quiet"]


def _study(_: Path) -> list[str]:
    return ["study", "--quick", "--jobs", "1"]


def _benchmark(_: Path) -> list[str]:
    return ["benchmark", "--levels", "nothing:1,plain:1", "--jobs", "1", "--budget", "0"]


COMMANDS: Mapping[str, Callable[[Path], list[str]]] = {
    "diagnose": _diagnose, "fleet": _fleet, "study": _study, "benchmark": _benchmark
}  # fmt: skip


def contents(out: Path) -> dict[str, object]:
    """Files under final names: their bytes with times masked, and the rows of a Parquet file without its seconds."""
    found: dict[str, object] = {}
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        name = path.relative_to(out)
        if any(part.startswith(".") for part in name.parts) or path.suffix == ".part" or path.name == "state.jsonl":
            continue
        if path.suffix == ".parquet":
            import pyarrow.parquet as pq

            found[str(name)] = pq.read_table(path).drop_columns(["seconds"]).to_pylist()
            continue
        data = path.read_bytes()
        for pattern, masked in TIMES:
            data = re.sub(pattern, masked, data)
        found[str(name)] = data
    return found


def differences(found: Mapping[str, object], reference: Mapping[str, object], *, whole: bool) -> list[str]:
    """What is found and is not in the reference; of a ``whole`` run also what is missing."""
    wrong = [f"{name}: {'other bytes' if name in reference else 'no such file in the reference'}"
             for name, data in found.items() if reference.get(name) != data]  # fmt: skip
    return wrong + [f"{name}: missing" for name in reference if whole and name not in found]


def kill(name: str, count: int, limit: float, seed: int, folder: Path, within: float = math.inf) -> Outcome:
    """Kill one command ``count`` times, or until ``limit`` seconds are over, and once more let it end.

    ``within`` [s]: the latest moment of a kill; by default the time of a whole run.
    """
    (folder / "pendulum.xml").write_text(MODEL)
    words = [sys.executable, "-m", "simgap", *COMMANDS[name](folder), "--out", "out"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).resolve().parents[1]), *sys.path])}
    out, rng, outcome = folder / "out", np.random.default_rng(seed), Outcome(name)

    def start() -> subprocess.Popen[bytes]:
        return subprocess.Popen(words, cwd=folder, env=environment, start_new_session=True,
                                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip

    def end(code: int) -> None:
        found = [f"exit {code}"] if code else differences(contents(out), reference, whole=True)
        outcome.wrong += [f"run {outcome.ended} that ended: {f}" for f in found]
        outcome.ended += 1
        shutil.rmtree(out, ignore_errors=True)

    before: dict[str, object] = {}
    reference: dict[str, object] = {}
    for _ in range(2):  # the first one compiles what a machine compiles once
        before = contents(out)
        shutil.rmtree(out, ignore_errors=True)
        began = time.perf_counter()
        if start().wait():
            raise click.ClickException(f"{name} does not run to its end on this machine")
        outcome.whole_s = time.perf_counter() - began
    reference = contents(out)
    outcome.wrong += [f"two runs that were let alone: {d}" for d in differences(before, reference, whole=True)]
    shutil.rmtree(out)
    began = time.perf_counter()
    while outcome.kills < count and time.perf_counter() - began < limit:
        process = start()
        try:
            end(process.wait(timeout=float(rng.uniform(0, min(within, outcome.whole_s)))))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            outcome.kills += 1
            outcome.wrong += [f"kill {outcome.kills}: {w}" for w in differences(contents(out), reference, whole=False)]
    end(start().wait())
    return outcome


@click.command()
@click.argument("name", metavar="COMMAND", type=click.Choice(sorted(COMMANDS)), default="diagnose")
@click.option("--count", default=100, show_default=True, help="Kills.")
@click.option("--limit", default=3600.0, show_default=True, help="Stop after so many seconds.")
@click.option("--within", default=math.inf, help="Kill within so many seconds of a start (default: of a whole run).")
@click.option("--seed", default=0, show_default=True, help="Of the moments.")
def main(name: str, count: int, limit: float, within: float, seed: int) -> None:
    """Kill COMMAND at random moments; prints one line of JSON."""
    with tempfile.TemporaryDirectory() as folder:
        outcome = kill(name, count, limit, seed, Path(folder), within)
    click.echo(json.dumps(asdict(outcome)))
    sys.exit(int(bool(outcome.wrong)))


if __name__ == "__main__":
    main()
