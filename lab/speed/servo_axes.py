"""Servo axes judged by force, under torques that no model knows of: ``python lab/speed/servo_axes.py [--seed 1] [--json FILE]``.

One inertia with viscous friction under a position loop of 5 Hz, a smooth move after another, angle (17 bits a turn) and torque
recorded at 250 Hz to 1 kHz. On the axis acts a torque that is nobody's physics (other axes, cables, the process): noise of a
correlation time of 0.05, 0.3 or 1 s and of 5, 15 or 40 % of the rms torque that the moves need. The servo answers it, late and in
proportion, so that its command is correlated with what the model does not know: a delay, a lag, a dead zone or a spring then fit
better than nothing. Two recordings of 10 s, one held out; the nominal MJCF is 25 % off in inertia and 40 % in friction.

Concealed is nothing, or Coulomb friction of 15, 30 or 60 % of the rms torque, or a weight (gravity) of once or twice that rms. A
weight of which the moves show one value only is an offset; both names count. Printed: false alarms on nothing, with the exact
binomial interval, and what was named where something is missing. The solver stands in this file.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numba import njit
from scipy.signal import lfilter
from scipy.stats import beta

SECONDS = 10.0
INERTIA, VISCOUS = 10.0, 20.0
KINDS = ("nothing", "nothing", "coulomb_friction", "gravity_load")
RIGHT = {"coulomb_friction": ({"coulomb_friction"},), "gravity_load": ({"gravity_load"}, {"torque_offset"})}
MJCF = f"""<mujoco model="servo">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body name="arm">
      <joint name="axis" type="hinge" axis="0 0 1" damping="{VISCOUS:g}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{INERTIA:g} {INERTIA:g} {INERTIA:g}"/>
    </body>
  </worldbody>
  <actuator><motor name="motor_torque" joint="axis"/></actuator>
  <sensor><jointvel name="motor_velocity" joint="axis"/><jointpos name="motor_angle" joint="axis"/></sensor>
</mujoco>
"""
BINDING = """[recording]
time = { column = "time_s", unit = "s" }
torque = { column = "torque_Nm", unit = "Nm" }
angle = { column = "angle_rad", unit = "rad" }

[experiment]
loop = "closed"
judge = "force"

[model]
actuator = "motor_torque"
velocity_sensor = "motor_velocity"
angle_sensor = "motor_angle"
"""


@dataclass
class Case:
    """What was drawn, and what was said of it."""

    number: int
    kind: str
    dt: float
    memory: float  # of the unknown torque [s]
    unknown: float  # its rms, over that of the torque that the moves need
    size: float  # of what is concealed, over the same
    verdict: str = ""
    named: tuple[str, ...] = ()
    seconds: float = 0.0


@njit(cache=True)
def servo(J, viscous, dry, weight, goal, speed, unknown, kp, kd, dt, sub):  # type: ignore[no-untyped-def]
    """Angle and torque (N,) under a position loop; a friction that holds, a weight, and a torque that acts on the axis."""
    n, h = len(goal), dt / sub
    q, v = goal[0], 0.0
    angle, torque = np.empty(n), np.empty(n)
    for k in range(n):
        u = kp * (goal[k] - q) + kd * (speed[k] - v)
        angle[k], torque[k] = q, u
        for _ in range(sub):
            free = u + unknown[k] - viscous * v - weight * np.sin(q + 0.4)
            if v == 0.0 and abs(free) <= dry:
                continue
            sign = np.sign(v) if v != 0.0 else np.sign(free)
            after = v + h * (free - sign * dry) / J
            if v * after < 0.0 and abs(free) <= dry:
                after = 0.0
            q += 0.5 * h * (v + after)
            v = after
    return angle, torque


def moves(rng: np.random.Generator, dt: float) -> np.ndarray:
    """Goal (N,): minimum-jerk moves of 0.4 to 2.5 s between angles within 0.8 rad, some with a rest after them."""
    goal = np.zeros(round(SECONDS / dt))
    k, at = round(rng.uniform(0.1, 0.6) / dt), 0.0
    while k < len(goal):
        rows, to = round(rng.uniform(0.4, 2.5) / dt), rng.uniform(-0.8, 0.8)
        s = np.linspace(0, 1, rows)
        part = at + (to - at) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        goal[k : k + rows] = part[: len(goal) - k]
        k, at = k + rows, to
        rest = round(rng.choice([0.0, 0.0, 0.3]) / dt)
        goal[k : k + rest] = at
        k += rest
    return goal


def write(folder: Path, number: int, seed: int) -> Case:
    """Draw a case and write its two recordings."""
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    dt, memory, unknown = (float(rng.choice(x)) for x in ((1e-3, 2e-3, 4e-3), (0.05, 0.3, 1.0), (0.05, 0.15, 0.4)))
    size = {"nothing": 0.0, "coulomb_friction": float(rng.choice([0.15, 0.3, 0.6])), "gravity_load": rng.uniform(1, 2)}[kind]
    J, viscous = INERTIA * rng.uniform(0.8, 1.25), VISCOUS * rng.uniform(0.7, 1.4)
    turn = 2 * math.pi * 5.0
    rms = None
    for name in ("estimation", "held_out"):
        goal = moves(rng, dt)
        speed = np.gradient(goal, dt)
        if rms is None:
            rms = float(np.sqrt(np.mean((J * np.gradient(speed, dt) + viscous * speed) ** 2)))
        forget = math.exp(-dt / memory)
        ahead = round(5 * memory / dt)
        noise = lfilter([math.sqrt(1 - forget**2)], [1.0, -forget], rng.standard_normal(ahead + len(goal)))[ahead:]
        dry, weight = (rms * size if kind == x else 0.0 for x in ("coulomb_friction", "gravity_load"))
        angle, torque = servo(
            J, viscous, dry, weight, goal, speed, unknown * rms * noise, J * turn**2, 1.6 * J * turn, dt, round(dt / 2.5e-4)
        )  # fmt: skip
        grid = 2 * math.pi / 2**17
        rows = np.column_stack([
            dt * np.arange(len(goal)), torque + 0.01 * rms * rng.standard_normal(len(goal)), grid * np.round(angle / grid)
        ])  # fmt: skip
        path = folder / f"{number:03d}_{name}.csv"
        np.savetxt(path, rows, delimiter=",", header="time_s,torque_Nm,angle_rad", comments="", fmt="%.9g")
    return Case(number, kind, dt, memory, unknown, size)


def told(folder: Path, case: Case) -> Case:
    """The case with what a diagnosis says of its files."""
    from diagnose.pipeline import Options, diagnose
    from mjsim.mjcf import load_axis
    from mjsim.recording import load

    model = folder / "servo.xml"
    fitted, held = (load(folder / f"{case.number:03d}_{name}.csv", model=model) for name in ("estimation", "held_out"))
    result = diagnose(load_axis(model), [fitted], [held], Options(jobs=1))
    case.verdict, case.seconds = result.verdict.value, result.seconds
    case.named = tuple(sorted(f.effect for f in result.findings))
    return case


def judged(case: Case) -> str:
    """Right, missed, or wrong: something named that is not there."""
    if case.kind == "nothing":
        return "wrong" if case.named else "right"
    if not case.named:
        return "missed"
    return "right" if set(case.named) in RIGHT[case.kind] else "wrong"


def _tell(cases: list[Case], say: Callable[[str], None] = print) -> None:
    for kind in dict.fromkeys(KINDS):
        own = [c for c in cases if c.kind == kind]
        count = Counter(judged(c) for c in own)
        wrong, n = count["wrong"], len(own)
        if kind == "nothing":
            upper = float(beta.ppf(0.975, wrong + 1, n - wrong)) if wrong < n else 1.0
            say(f"nothing missing: physics named in {wrong} of {n} (95 %: up to {100 * upper:.1f} %)")
            continue
        say(f"{kind}: right {count['right']}, missed {count['missed']}, wrong {wrong} of {n}")
        for level in sorted({c.unknown for c in own}):
            some = [c for c in own if c.unknown == level]
            say(f"    unknown torque {100 * level:.0f} %: right {sum(judged(c) == 'right' for c in some)} of {len(some)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=160)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--at-once", type=int, default=2, help="diagnoses side by side, one job each")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    cases = []
    with tempfile.TemporaryDirectory() as work, ProcessPoolExecutor(arguments.at_once, get_context("spawn")) as pool:
        folder = Path(work)
        (folder / "servo.xml").write_text(MJCF, encoding="utf-8")
        (folder / "servo.toml").write_text(BINDING, encoding="utf-8")
        drawn = [write(folder, i, arguments.seed) for i in range(arguments.cases)]
        for case in pool.map(partial(told, folder), drawn):
            cases.append(case)
            print(
                f"{case.number:4d}  {case.kind:17s} {1e3 * case.dt:.0f} ms  {case.memory:.2f} s  {100 * case.unknown:2.0f} %  "
                f"{case.size:.2f}  {judged(case):7s} {case.verdict} {' + '.join(case.named)}  ({case.seconds:.0f} s)", flush=True,
            )  # fmt: skip
    _tell(cases)
    if arguments.json is not None:
        said = {"seed": arguments.seed, "cases": [asdict(c) for c in cases]}
        arguments.json.write_text(json.dumps(said, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
