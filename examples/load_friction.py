"""Load-dependent friction that one rig cannot show: `python examples/load_friction.py`.

Friction in a gear grows with the torque that it transmits. On a stiff rig that holds a constant load and moves slowly that torque
does not change, and the friction is Coulomb's for all that the recording says: the diagnosis must say that it cannot tell, and
what to measure. The machine is the sealed plant of the benchmark, with stiff and well damped joints, read with noise.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from diagnose.pipeline import Options, diagnose
from diagnose.report import write_report
from diagnose.result import Diagnosis
from lab.benchmark.experiment import RATE, Experiment
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import record
from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.recording import Recording

OUT = Path("out/examples/load_friction")
SHARE, LOAD = 0.12, 60.0  # friction over transmitted torque at the motor; load on the arm [N m]
STIFF = {"kg": 1.5e6, "ka": 4.46e5, "dg": 2000.0, "da": 1000.0}  # joints that do not wind up under the load for long
NOISE = 0.2  # of the velocity [rad/s]


def rig(seed: int, hz: float, swing: float) -> Recording:
    """Five seconds about the torque that holds the load: ``swing`` [N m] at ``hz`` and a slower part."""
    rng = np.random.default_rng(seed)
    t = np.arange(5 * RATE) / RATE
    torque = LOAD / 118.0 + swing * np.sin(2 * np.pi * hz * t) + 0.5 * swing * np.sin(2 * np.pi * 0.37 * hz * t + seed)
    laws = Laws(load_m=SHARE, gravity=LOAD, gravity_phase=np.pi / 2, **STIFF)
    motion = record(laws, Experiment("rig", torque, np.zeros_like(torque)), Measurement(velocity_noise=NOISE), rng)
    return Recording(motion.time, motion.torque, motion.velocity, motion.angle, 1 / RATE, source=f"rig_{hz:g}_Hz_{seed}")


def loaded() -> Axis:
    """The nominal axis with the load that hangs on it, which is known."""
    nominal = load_axis(shipped_model("robot_axis1")).with_linear(STIFF)
    return nominal + effect_class("gravity_load")(torque_Nm=LOAD, phase_rad=np.pi / 2)


def tell(name: str, result: Diagnosis) -> None:
    """What was found, what it cannot be told from, what to measure."""
    print(f"{name}: {result.verdict.value}. {result.summary}")
    for f in result.findings:
        print(f"  {f.sentence} Cannot be told from: {', '.join(f.equivalents) or 'nothing else'}.")
    print(f"  Next: {result.next_experiment or 'nothing to tell apart'}", flush=True)


def main(out: Path = OUT) -> Diagnosis:
    """The diagnosis of the slow rig."""
    out.mkdir(parents=True, exist_ok=True)
    print(f"Machine: friction of {SHARE} of the transmitted torque; a load of {LOAD} N m is known.")
    alone = diagnose(loaded(), [rig(1, 0.15, 0.12)], [rig(2, 0.12, 0.12)], Options())
    tell("Slow rig", alone)
    write_report(alone, out / "report.html")
    print(f"Report: {out / 'report.html'}")
    return alone


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else OUT)
