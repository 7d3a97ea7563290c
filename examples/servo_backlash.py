"""Backlash in a servo: `python examples/servo_backlash.py`.

The machine (the sealed plant of the benchmark) has a gap in its gear and a velocity controller that reacts to what its noisy
sensor sees, so that the torque depends on the gap and on the noise.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from diagnose.pipeline import Options
from diagnose.result import Diagnosis
from lab.benchmark.experiment import speed_multisine, trapezoid
from lab.benchmark.laws import GAP_IMPACT, Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import record
from mjsim.models import shipped_model
from simgap.pipeline import diagnose_files

OUT = Path("out/examples/servo_backlash")
GAP = 6e-4  # [rad], arm side


def log(path: Path, seed: int) -> None:
    """Ten seconds under the controller, trapezoids (seed 1) or a multisine, as a CSV."""
    rng = np.random.default_rng(seed)
    # contact by compliant impact: not the contract's law
    laws = Laws(gap_g=GAP, gap_law_g=GAP_IMPACT, impact_g=0.3)
    experiment = trapezoid(10.0, 15.0, 0.08, 0.1, True, rng) if seed == 1 else speed_multisine(10.0, 5.0, 15.0, 0.08, 0.1, rng)
    motion = record(laws, experiment, Measurement(), rng)
    table = np.column_stack([motion.time, motion.torque, motion.velocity, motion.angle])
    np.savetxt(path, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="", fmt="%.9g")


def main(out: Path = OUT) -> Diagnosis:
    """Diagnose the multisine, held out on the trapezoids."""
    out.mkdir(parents=True, exist_ok=True)
    first, second = out / "estimation.csv", out / "held_out.csv"
    log(first, 2)
    log(second, 1)
    result = diagnose_files([first], shipped_model("robot_axis1"), out / "report", [second], Options(), progress=False)
    print(f"Machine: a gap of {GAP:g} rad in the gearbox, under a PI velocity controller that sees the noise.")
    print(f"{result.verdict.value}. {result.summary}")
    for f in result.findings:
        print(f"  {f.sentence} Cannot be told from: {', '.join(f.equivalents) or 'nothing else'}.")
    print(f"Report: {out / 'report' / 'report.html'}")
    return result


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else OUT)
