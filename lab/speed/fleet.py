"""Speed and memory of ``simgap fleet``: one worker beside two, and the growth of one process over many recordings.

    python lab/speed/fleet.py --logs 24 --repeats 200 --out fleet.json

Recordings: 4 s at 250 Hz of a pendulum with Coulomb friction, stepped by plain MuJoCo. Seconds are of the wall; memory is the
resident set of the process after a tenth of the recordings and after the last one. ``cpu_s`` is the processor time of the client
and of its workers, load the mean number of processes that ran or waited in the minute before. Where other work loads the machine,
the wall tells little: ``serial`` is the processor time of the client alone over that of all, which a second worker cannot take,
and 1 / (serial + (1 - serial) / 2) the speed-up that it allows.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np

from simgap.fleet.plan import Job, Settings, jobs
from simgap.fleet.run import run
from simgap.fleet.task import place, record_of

MODEL = """<mujoco><option timestep="0.004" integrator="implicitfast"/><worldbody><body name="rod">
<joint name="hinge" axis="0 1 0" damping="0.05"/><geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass="1"/></body>
</worldbody>
<actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
DT, SECONDS = 0.004, 4.0


def write_log(path: Path, friction: float, seed: int) -> None:
    model = mujoco.MjModel.from_xml_string(MODEL.replace('damping="0.05"', f'damping="0.05" frictionloss="{friction}"'))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    t = DT * np.arange(int(SECONDS / DT))
    torque = 1.5 * np.sin(2 * np.pi * (0.3 + 0.3 * t) * t + rng.uniform(0, 1))
    motion = np.empty((len(t), 2))
    for i, u in enumerate(torque):
        motion[i] = data.qpos[0], data.qvel[0]
        data.ctrl[0] = u
        mujoco.mj_step(model, data)
    motion += rng.standard_normal(motion.shape) * (1e-4, 3e-3)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, time_s=t, torque_Nm=torque, velocity_rad_s=motion[:, 1], angle_rad=motion[:, 0])


def plan(folder: Path, count: int) -> list[Job]:
    model = folder / "pendulum.xml"
    model.write_text(MODEL)
    for i in range(count):
        write_log(folder / f"logs/robot{i % 6}/2026-01-{1 + i // 6:02d}.npz", 0.1 + 0.03 * (i % 6), i)
    return jobs(str(folder / "logs/*/*.npz"), model, Settings(effects=("coulomb_friction",)))


def resident() -> float:
    """Resident set of this process [MB]."""
    with open("/proc/self/statm") as handle:
        return int(handle.read().split()[1]) * 4096 / 1e6


def _cpu() -> float:
    """Processor time of this process and of those that have ended [s]."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=24)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        planned = plan(folder, args.logs)
        record_of(planned[0], folder)  # what is compiled once on a machine
        wall, cpu, load, serial = {}, {}, {}, {}
        for workers in (1, 2):
            load[workers] = os.getloadavg()[0]
            began, client, all_of_it = time.perf_counter(), time.process_time(), _cpu()
            run(planned, folder / f"out{workers}", workers=workers)
            wall[workers], cpu[workers] = time.perf_counter() - began, _cpu() - all_of_it
            serial[workers] = (time.process_time() - client) / cpu[workers]
        records = [place(folder / "out2", j.key) for j in planned]
        size = statistics.median(p.stat().st_size for p in records)
        seconds, memory = [], []
        for i in range(args.repeats):
            seconds.append(record_of(planned[i % len(planned)], folder)["seconds"])
            memory.append(resident())
    tenth = max(1, args.repeats // 10)
    told = {
        "logs": args.logs, "wall_s": wall, "cpu_s": cpu, "load": load, "serial": serial, "speed_up": wall[1] / wall[2],
        "record_bytes": size, "repeats": args.repeats,
        "seconds_median": statistics.median(seconds), "memory_MB": {"after_a_tenth": memory[tenth - 1], "at_the_end": memory[-1]},
    }  # fmt: skip
    print(json.dumps(told, indent=2))
    if args.out:
        args.out.write_text(json.dumps(told, indent=2) + "\n")


if __name__ == "__main__":
    main()
