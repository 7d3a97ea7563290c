"""The same two-parameter fit by our fitter and by `mujoco.sysid`: ``python lab/speed/diagnose_vs_sysid.py [--json FILE]``.

    pip install -e '.[bench]'        (in a virtual environment of its own)

Coulomb and viscous friction of the motor, from 0.05 N m and the nominal viscosity on; every other number is that of the nominal
model, which is the true one. The recording is a 10 s chirp at 2 kHz of the sealed plant (its own laws and solver, noise 0.05
rad/s), the held-out one a multisine. Both fit the same velocity by free runs from rest, one thread each. Ours: the fitter of
`simgap diagnose`, its own start and stop. `mujoco.sysid`: `frictionloss` and `damping` of the joint in the shipped MJCF at its
own step of 0.5 ms, MuJoCo's least squares with its defaults.

The ratio is taken twice: to the end of both, and to the moment at which `mujoco.sysid` first stood within a millionth of its
final cost, so that its tighter stopping rule is not held against it. The bar is judged by the smaller one. Times are the least
of several repetitions, taken in turns, after one run ahead of the clock. Exit 1 when the bar is missed or our held-out error is
the larger one.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.data.experiment import prepare
from diagnose.fit.fitter import Fitter
from diagnose.problem.hypothesis import make
from diagnose.problem.view import MotionView
from lab.benchmark.arms.sysid import ARM, Parameter, Problem
from lab.benchmark.experiment import chirp, multisine
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import Motion, record
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.recording import Recording

SEED = 21
NOISE = 0.05  # [rad/s]
START = 0.05  # Coulomb torque [N m]
FASTER = 20.0
NEAR = 1e-6  # of the final cost


def recordings(coulomb: float, viscous: float) -> tuple[Recording, Recording]:
    """Estimation and held-out."""
    rng = np.random.default_rng(SEED)
    laws = Laws()._replace(coulomb_m=coulomb, fm=viscous)
    measurement = Measurement(velocity_noise=NOISE)

    def of(motion: Motion) -> Recording:
        return Recording(motion.time, motion.torque, motion.velocity, motion.angle, 1 / 2000)

    return (
        of(record(laws, chirp(10.0, 1.0, 0.5, 30.0), measurement, rng)),
        of(record(laws, multisine(10.0, 0.6, 0.1, 30.0, rng), measurement, rng)),
    )


def ours(estimation: Recording, held_out: Recording) -> dict[str, Any]:
    """Seconds, numbers, errors of our fitter."""
    axis = load_axis(shipped_model("robot_axis1"))
    began = time.perf_counter()
    fitter = Fitter(axis, MotionView(), (prepare(estimation),), (prepare(held_out),), jobs=1)
    h = fitter.hypothesis((make("coulomb_friction", "motor", {"torque_Nm": START}),))
    h = dataclasses.replace(h, entries=tuple(e for e in h.entries if e.owner or e.name == "fm"))
    fitted = fitter.fit(h)
    seconds = time.perf_counter() - began
    values = {e.name: float(e.si(x)) for e, x in zip(h.entries, fitted.fit.x, strict=True)}
    held = fitter.validate(fitted)
    assert held is not None
    fitter.close()
    return {
        "seconds": seconds, "coulomb": values["torque_Nm"], "viscous": values["fm"], "held_out": held.rms, "runs": fitter.runs,
        "status": fitted.fit.status.name.lower(),
    }  # fmt: skip


def two_parameters(spec: Any) -> tuple[Parameter, ...]:
    viscous = np.array(spec.joint("motor").damping)
    return (
        Parameter("coulomb", 0.0, 20.0, lambda s, f: setattr(s.joint("motor"), "frictionloss", START * f)),
        Parameter("viscous", -20.0, 20.0, lambda s, f: setattr(s.joint("motor"), "damping", viscous * f)),
    )


def theirs(estimation: Recording, held_out: Recording) -> dict[str, Any]:
    """Seconds, numbers, errors of `mujoco.sysid`, and the seconds to within ``NEAR`` of its final cost."""
    problem = Problem(shipped_model("robot_axis1"), two_parameters)
    trace: list[tuple[float, float]] = []
    began = time.perf_counter()
    factors = problem.fit(
        estimation, iter_callback=lambda log: trace.append((time.perf_counter() - began, float(log[-1].objective)))
    )
    seconds = time.perf_counter() - began
    final = min(cost for _, cost in trace)
    # an entry has the cost at which its iteration began: reached by the end of the one before
    reached = next(i for i, (_, cost) in enumerate(trace) if cost <= final * (1 + NEAR))
    error = problem.error(factors, held_out)
    return {
        "seconds": seconds, "near": trace[max(reached - 1, 0)][0],
        "coulomb": START * factors["coulomb"], "viscous": Laws().fm * factors["viscous"],
        "held_out": float(np.sqrt(np.mean(error**2))), "iterations": len(trace),
    }  # fmt: skip


def compare(coulomb: float, viscous: float, repeat: int) -> dict[str, Any]:
    """Both fits, in turns; the least times."""
    pair = recordings(coulomb, viscous)
    ours(*pair)
    mine, other = ours(*pair), theirs(*pair)
    for _ in range(repeat - 1):
        a, b = ours(*pair), theirs(*pair)
        mine["seconds"] = min(mine["seconds"], a["seconds"])
        for key in ("seconds", "near"):
            other[key] = min(other[key], b[key])
    return {
        "coulomb": coulomb, "viscous": viscous, "ours": mine, "sysid": other,
        "ratio": other["seconds"] / mine["seconds"], "ratio_near": other["near"] / mine["seconds"],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if lacks := ARM.lacks():
        parser.error(f"mujoco.sysid lacks {', '.join(lacks)}: pip install -e '.[bench]'")
    results = []
    for coulomb, viscous in ((0.1, 0.045), (0.03, 0.03)):
        r = compare(coulomb, viscous, arguments.repeat)
        print(f"truth       Coulomb {coulomb:.5f} N m, viscous {viscous:.5f} N m s/rad, noise {NOISE} rad/s")
        for name in ("ours", "sysid"):
            x = r[name]
            how = (
                f"{x['runs']} runs, {x['status']}"
                if name == "ours"
                else f"{x['iterations']} iterations, near after {x['near']:.2f} s"
            )
            print(
                f"  {name:6s}    Coulomb {x['coulomb']:.5f}, viscous {x['viscous']:.5f}, "
                f"held-out error {x['held_out']:.5f} rad/s, {x['seconds']:.3f} s ({how})"
            )
        slower = min(r["ratio"], r["ratio_near"])
        r["holds"] = bool(slower >= FASTER and r["ours"]["held_out"] <= r["sysid"]["held_out"] * (1 + 1e-9))
        better = r["ours"]["held_out"] / r["sysid"]["held_out"]
        r["said"] = (
            f"{'holds ' if r['holds'] else 'MISSED'} {slower:8.3g} (>= {FASTER:g})  faster than mujoco.sysid "
            f"({r['ratio']:.3g} to the end of both), held-out error {better:.4f} times its (<= 1)"
        )
        print(r["said"])
        results.append(r)
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=2) + "\n")
    assert all(math.isfinite(r["ratio"]) for r in results)
    sys.exit(0 if all(r["holds"] for r in results) else 1)


if __name__ == "__main__":
    main()
