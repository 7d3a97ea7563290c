"""Speed of the simulators as ratios within one run: ``python lab/speed/mjsim_speed.py [--json FILE]``; exit 1 on a miss.

Times are the least of several repetitions, taken in turns, so that a busy machine slows both sides of a ratio. Beside the gain of
a second thread stands what a loop without memory or locks gains from it: a machine that has no second core to give shows there.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout as bare
from second_core import spin_on

from mjsim import accurate, crosscheck, ode, reference
from mjsim.axis import Axis
from mjsim.batch import Drive, Engine, rollout
from mjsim.effects import BacklashLaw, effect_class
from mjsim.excitation import chirp
from mjsim.mjcf import load_axis, load_model, write_corrected
from mjsim.models import shipped_model
from mjsim.mujoco_run import run_literal
from mjsim.system import assemble

DT = 5e-4


def fastest(*runs: Callable[[], object], repeat: int = 5) -> list[float]:
    """Least time of each, taken in turns."""
    for run in runs:
        run()
    best = [np.inf] * len(runs)
    for _ in range(repeat):
        for i, run in enumerate(runs):
            start = time.perf_counter()
            run()
            best[i] = min(best[i], time.perf_counter() - start)
    return best


def bare_rollout(model: mujoco.MjModel, torque: np.ndarray, steps: int) -> Callable[[], object]:
    data = mujoco.MjData(model)
    spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, spec))
    mujoco.mj_getState(model, data, state, spec)
    control = np.repeat(torque, steps).reshape(1, -1, 1)
    return lambda: bare.rollout(model, data, state[None], control)


def literal_overhead(results: list[dict]) -> None:
    path = shipped_model("robot_axis1")
    u = chirp(20.0, DT, 2.0, 0.5, 30.0)
    source = load_model(path)
    ours, theirs = fastest(lambda: run_literal(source, u, DT), bare_rollout(source.mjmodel, u, 1))
    results.append({"bar": "literal, 20 s linear, against a bare rollout", "value": ours / theirs, "limit": 1.2, "want": "<=",
                    "seconds": [ours, theirs]})  # fmt: skip


def accurate_speed(results: list[dict]) -> None:
    path = shipped_model("robot_axis1")
    u = chirp(20.0, DT, 2.0, 0.5, 30.0)
    axis = load_axis(path) + effect_class("static_friction")(torque_Nm=0.1, peak=2.0) + effect_class("backlash")(gap_rad=5e-4)
    model = load_model(path).mjmodel
    model.opt.timestep = 2.5e-4
    ours, theirs = fastest(lambda: accurate.simulate(axis, u, DT), bare_rollout(model, u, 2), repeat=3)
    results.append({"bar": "accurate, 20 s with friction, peak and gap [s]", "value": ours, "limit": 2.0, "want": "<="})
    results.append({"bar": "accurate, the same, against a bare rollout at equal step", "value": ours / theirs, "limit": 10.0,
                    "want": "<=", "seconds": [ours, theirs]})  # fmt: skip


def batch_throughput(results: list[dict]) -> None:
    axis = load_axis(shipped_model("robot_axis1"))
    axes = [axis + effect_class("coulomb_friction")(torque_Nm=0.01 * (k + 1)) for k in range(64)]
    drive = [Drive(chirp(1.0, DT, 1.0, 0.5, 30.0), DT)]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    one, many, alone, both = fastest(
        lambda: rollout(axes, drive, engine=Engine.ACCURATE, threads=1),
        lambda: rollout(axes, drive, engine=Engine.ACCURATE, threads=2),
        lambda: spin_on(1),
        lambda: spin_on(2),
        repeat=4,
    )
    machine = alone / both
    bar = f"batch of 64 on 2 threads ({cores} cores), throughput over one thread; an empty loop gains {machine:.2f}"
    results.append({"bar": bar,
                    "value": one / many, "limit": 1.7, "want": ">=", "seconds": [one, many], "empty_loop": machine})  # fmt: skip
    if machine < 1.8:  # no second core to be had: the bar cannot be judged, only that nothing is lost against the empty loop
        results[-1]["holds"] = one / many >= 0.9 * machine
        results[-1]["bar"] += ": not measurable here"


def kernel_against_mujoco(results: list[dict]) -> None:
    """The cheapest MuJoCo run that reaches 3e-4: plain MuJoCo by its own law, and the accurate runner at its longest steps."""
    path = shipped_model("robot_axis1")
    u = chirp(10.0, DT, 1.0, 0.5, 30.0)
    axis: Axis = load_axis(path) + effect_class("coulomb_friction")(torque_Nm=0.1) + effect_class("backlash")(gap_rad=5e-4)
    plain = Axis(axis.chain, axis.effects, BacklashLaw.UNGATED)
    exact, exact_plain = (reference.simulate(a, u, DT).velocity for a in (axis, plain))
    system = assemble(axis)
    candidates: list[tuple[str, float, Callable[[], object]]] = []
    for step in (5e-4, 2.5e-4):
        error = crosscheck.relative(accurate.simulate(system, u, DT, step=step).velocity, exact)
        candidates.append((f"accurate at {step:g} s", error, lambda step=step: accurate.simulate(system, u, DT, step=step)))
    with tempfile.TemporaryDirectory() as work:
        for step in (5e-5, 2.5e-5):
            nominal = Path(work) / "nominal.xml"
            nominal.write_text(path.read_text().replace('timestep="0.0005"', f'timestep="{step!r}"'))
            model = load_model(write_corrected(nominal, plain, Path(work) / "plain.xml").path)
            error = crosscheck.relative(run_literal(model, u, DT).velocity, exact_plain)
            candidates.append((f"plain MuJoCo at {step:g} s", error, lambda model=model: run_literal(model, u, DT)))
    for name, error, _ in candidates:
        print(f"  {name}: error {error:.2g}", file=sys.stderr)
    good = [(name, error, run) for name, error, run in candidates if error <= 3e-4]
    kernel, *times = fastest(lambda: ode.simulate(system, u, DT), *(run for _, _, run in good), repeat=5)
    at = int(np.argmin(times))
    error = crosscheck.relative(ode.simulate(system, u, DT).velocity, exact)
    results.append({"bar": f"kernel (error {error:.1g}) against the cheapest MuJoCo of error <= 3e-4 ({good[at][0]})",
                    "value": times[at] / kernel, "limit": 50.0, "want": ">=", "seconds": [kernel, times[at]]})  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    results: list[dict] = []
    for part in (literal_overhead, accurate_speed, batch_throughput, kernel_against_mujoco):
        part(results)
        for r in (r for r in results if "said" not in r):
            r.setdefault("holds", bool(r["value"] <= r["limit"] if r["want"] == "<=" else r["value"] >= r["limit"]))
            seconds = ", ".join(f"{x:.4g} s" for x in r.get("seconds", []))
            r["said"] = (
                f"{'holds ' if r['holds'] else 'MISSED'} {r['value']:8.3g} ({r['want']} {r['limit']:g})  {r['bar']}  {seconds}"
            )
            print(r["said"])
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=2) + "\n")
    sys.exit(0 if all(r["holds"] for r in results) else 1)


if __name__ == "__main__":
    main()
