"""Stiction that MuJoCo's frictionloss cannot hold: `python examples/stiction.py`.

The machine (the sealed plant of the benchmark, with a solver of its own) breaks loose at twice the level at which it slides. The
model has the sliding level as frictionloss, so nothing is wrong with it while it moves; MuJoCo has no element for the rest.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from diagnose.flow import Options
from diagnose.result import Diagnosis
from mjsim.models import shipped_model
from simgap.benchmark.experiment import RATE, Experiment
from simgap.benchmark.laws import Laws
from simgap.benchmark.measurement import Measurement
from simgap.benchmark.plant import record
from simgap.pipeline import diagnose_files

OUT = Path("out/examples/stiction")
LEVEL, PEAK = 0.12, 2.0  # [N m], breakaway over sliding


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


def main(out: Path = OUT) -> Diagnosis:
    """Diagnose against a model whose friction has the right level and no peak."""
    out.mkdir(parents=True, exist_ok=True)
    model, first, second = out / "axis.xml", out / "estimation.csv", out / "held_out.csv"
    text = shipped_model("robot_axis1").read_text(encoding="utf-8")
    model.write_text(
        text.replace('damping="0.0355" frictionloss="0"', f'damping="0.0355" frictionloss="{LEVEL}"'), encoding="utf-8"
    )
    log(first, 1, 0.9)
    log(second, 2, 0.7)
    result = diagnose_files([first], model, out / "report", [second], Options(), progress=False)
    print(f"Machine: slides at {LEVEL} N m, breaks loose at {PEAK:g} times that. Model: frictionloss {LEVEL}.")
    print(f"{result.verdict.value}. {result.summary}")
    for f in result.findings:
        print(f"  {f.sentence} Cannot be told from: {', '.join(f.equivalents) or 'nothing else'}.")
    lacks = [
        line.strip() for line in (out / "report" / "corrected.xml").read_text(encoding="utf-8").splitlines() if "lacks" in line
    ]
    print("corrected.xml says:", " ".join(lacks) or "nothing is lacking")
    print(f"Report: {out / 'report' / 'report.html'}")
    return result


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else OUT)
