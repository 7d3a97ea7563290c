"""How long simgap takes to start and how fast its kernel runs: `python lab/speed/start_and_kernel.py`.

Start: wall time of the second of two processes, the first one fills the caches (compiled Python, numba's machine code on disk).
Kernel: 20 s at 2 kHz, processor time, best of several runs in one process after one that warms up, at the step that the accuracy
rule of `mjsim.system` chooses and at 25 us (20 steps a sample), with the relative rms of velocity by which the two differ.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from mjsim.axis import Axis
from mjsim.effects import Effect, effect_class
from mjsim.excitation import chirp
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate

DT = 5e-4
FIRST = (
    "from mjsim.mjcf import load_axis; from mjsim.models import shipped_model; from mjsim.ode import simulate;"
    "from mjsim.effects import effect_class; import numpy as np;"
    "a = load_axis(shipped_model('robot_axis1')) + effect_class('coulomb_friction')(torque_Nm=0.1);"
    "simulate(a, np.sin(np.arange(2000) * 0.01), 5e-4)"
)
LIMITS = {"help_s": 1.5, "first_simulation_s": 3.0, "kernel_ms": 50.0}


def started(*words: str) -> float:
    """Seconds of a process, the second time."""
    taken = 0.0
    for _ in range(2):
        began = time.perf_counter()
        subprocess.run([sys.executable, *words], check=True, capture_output=True)
        taken = time.perf_counter() - began
    return taken


def axes() -> dict[str, Axis]:
    axis = load_axis(shipped_model("robot_axis1"))

    def effect(name: str, **values: float | str) -> Effect:
        return effect_class(name)(**values)  # type: ignore[arg-type]

    friction, gap = effect("coulomb_friction", torque_Nm=0.1), effect("backlash", gap_rad=5e-4)
    ripple = effect("torque_ripple", amplitude_Nm=0.05, cycles_per_rev=4.0, phase_rad=1.0)
    stribeck = effect("stribeck_friction", torque_Nm=0.08, extra_static_torque_Nm=0.09, stribeck_velocity_rad_s=3.0)
    soon = effect("stribeck_friction", torque_Nm=0.08, extra_static_torque_Nm=0.09, stribeck_velocity_rad_s=0.03)
    hard = effect("hardening_stiffness", coefficient_Nm_rad3=9e10)
    return {
        "linear": axis,
        "Coulomb": axis + friction,
        "backlash": axis + gap,
        "Coulomb + backlash": axis + friction + gap,
        "Stribeck, soon faded": axis + soon,
        "Stribeck + hardening": axis + stribeck + hard,
        "Stribeck + backlash + ripple": axis + stribeck + gap + ripple,
    }


def best(axis: Axis, torque: np.ndarray, runs: int, substeps: int | None) -> float:
    """Milliseconds of the fastest run."""
    simulate(axis, torque, DT, substeps=substeps)
    taken = []
    for _ in range(runs):
        began = time.process_time()
        simulate(axis, torque, DT, substeps=substeps)
        taken.append(1e3 * (time.process_time() - began))
    return min(taken)


def difference(axis: Axis, torque: np.ndarray) -> float:
    """Relative rms of velocity between the chosen step and 25 us."""
    fine = simulate(axis, torque, DT, substeps=20).velocity
    return float(np.sqrt(np.mean((simulate(axis, torque, DT).velocity - fine) ** 2) / np.mean(fine**2)))


def measured(axis: Axis, torque: np.ndarray, runs: int) -> dict[str, float]:
    """Times [ms] at both steps and the difference."""
    return {
        "chosen": best(axis, torque, runs, None), "25us": best(axis, torque, runs, 20), "difference": difference(axis, torque)
    }  # fmt: skip


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--runs", type=int, default=7)
    options.add_argument("--json", action="store_true")
    given = options.parse_args()
    torque = chirp(20.0, DT, 1.0, 0.5, 30.0)
    result = {
        "machine": {"python": platform.python_version(), "cores": os.cpu_count(), "load": os.getloadavg()[0]},
        "help_s": started("-m", "simgap", "--help"),
        "first_simulation_s": started("-c", FIRST),
        "kernel_ms": {name: measured(axis, torque, given.runs) for name, axis in axes().items()},
    }
    if given.json:
        print(json.dumps(result, indent=2))
        return
    print(f"simgap --help          {result['help_s']:6.2f} s   (limit {LIMITS['help_s']} s)")
    print(f"first simulation       {result['first_simulation_s']:6.2f} s   (limit {LIMITS['first_simulation_s']} s)")
    print(f"20 s at 2 kHz on one core, limit {LIMITS['kernel_ms']:.0f} ms:   chosen step      25 us   difference")
    for name, taken in result["kernel_ms"].items():
        print(f"  {name:32s} {taken['chosen']:12.1f} ms {taken['25us']:9.1f} ms   {taken['difference']:.1e}")
    print(f"load {result['machine']['load']:.1f} on {result['machine']['cores']} cores, Python {result['machine']['python']}")


if __name__ == "__main__":
    main()
