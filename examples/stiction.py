"""Stiction that MuJoCo's frictionloss cannot hold: `python examples/stiction.py`.

The machine (the sealed plant of the benchmark, with a solver of its own) breaks loose at twice the level at which it slides; the
model has no dry friction. MuJoCo's frictionloss, one level for rest and motion, is the best that plain MJCF could do: first the
diagnosis is allowed nothing else, then everything.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from diagnose.pipeline import Options
from diagnose.result import Diagnosis
from lab.benchmark.experiment import RATE, Experiment
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import record
from mjsim.models import shipped_model
from simgap.pipeline import diagnose_files

OUT = Path("out/examples/stiction")
LEVEL, PEAK = 0.12, 2.0  # [N m], breakaway over sliding
NOISE = Measurement().velocity_noise  # rms [rad/s]


def log(path: Path, seed: int, hz: float) -> None:
    """A slow sine of torque that lets the motor stick at every reversal, as a CSV."""
    t = np.arange(5 * RATE) / RATE
    torque = 0.35 * np.sin(2 * np.pi * hz * t) + 0.1 * np.sin(2 * np.pi * 3.1 * hz * t + seed)
    motion = record(
        Laws(coulomb_m=LEVEL, peak_m=PEAK),
        Experiment("sines", torque, np.zeros_like(torque)),
        Measurement(),
        np.random.default_rng(seed),
    )
    table = np.column_stack([motion.time, motion.torque, motion.velocity, motion.angle])
    np.savetxt(path, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="", fmt="%.9g")


def main(out: Path = OUT) -> tuple[Diagnosis, Diagnosis]:
    """(the diagnosis with Coulomb friction only, the diagnosis)."""
    out.mkdir(parents=True, exist_ok=True)
    first, second = out / "estimation.csv", out / "held_out.csv"
    log(first, 1, 0.9)
    log(second, 2, 0.7)
    files = [first], shipped_model("robot_axis1")
    level = diagnose_files(*files, out / "frictionloss", [second], Options(effects=("coulomb_friction",)), progress=False)
    left = level.fit["corrected"].held_out_rms
    print(f"Machine: slides at {LEVEL} N m, breaks loose at {PEAK:g} times that. Noise {NOISE:g} rad/s.", flush=True)
    print(f"What frictionloss can do: held-out error {left:.3g} rad/s, {level.verdict.value}.", flush=True)
    result = diagnose_files(*files, out / "report", [second], Options(), progress=False)
    print(f"{result.verdict.value}. {result.summary}")
    for f in result.findings:
        print(f"  {f.sentence} Cannot be told from: {', '.join(f.equivalents) or 'nothing else'}.")
    lines = (out / "report" / "corrected.xml").read_text(encoding="utf-8").splitlines()
    lacks = [line.strip() for line in lines if "Plain MuJoCo lacks" in line]
    print("corrected.xml says:", " ".join(lacks) or "nothing is lacking")
    print(f"Report: {out / 'report' / 'report.html'}")
    return level, result


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else OUT)
