"""Concealed effects in machines other than the robot's axis: ``python lab/speed/other_machines.py [--seed 3] [--json FILE]``.

Five machines (a direct drive, a flexible joint on a bench, a belt axis on a slide, a harmonic drive seen from its motor, three
masses) with sampling rates of 500 Hz to 2 kHz, their nominal MJCF up to 12 % off in inertia and stiffness and 30 % in damping;
open loop and under a PD law; one effect each or none. The solver, the laws and the recorder stand in this file and share nothing
with those of the project.

Each case is diagnosed by the command from its CSV files and the nominal MJCF alone. What counts as right: a null is `no_mismatch`
or `parameters_only`; an effect alone is named, or declared an equivalent of what is named. Sizes go with the machine's own
torque, speed and twist; what leaves less than half of the noise after the nominal model was refitted is told, and not counted.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.signal import butter, filtfilt
from scipy.stats import beta

STEP = 2.5e-5  # [s] of the solver, at most
KINDS = ("multisine", "steps", "multisine")
COLUMNS = "time_s,torque_Nm,velocity_rad_s,angle_rad"


@dataclass(frozen=True)
class Machine:
    """Inertias and viscous friction of the bodies, stiffness and damping of the springs between them, and how it is driven."""

    name: str
    inertia: tuple[float, ...]
    viscous: tuple[float, ...]
    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    dt: float
    band: tuple[float, float]  # of a multisine [Hz]
    torque: float  # rms [N m | N]
    seconds: float
    slide: bool = False


MACHINES = (
    Machine("direct drive", (0.05,), (0.12,), (), (), 1e-3, (0.3, 20.0), 2.0, 12.0),
    Machine("flexible joint", (2.1e-3, 1.6e-3), (4e-3, 0.0), (1.6,), (1.2e-3,), 2e-3, (0.3, 25.0), 0.12, 16.0),
    Machine("belt axis", (8.0, 25.0), (60.0, 0.0), (1.2e5,), (80.0,), 1e-3, (0.3, 40.0), 120.0, 10.0, slide=True),
    Machine("harmonic drive", (1.1e-4, 0.9e-4), (1.2e-3, 0.0), (1.6,), (1e-3,), 5e-4, (0.5, 60.0), 0.08, 8.0),
    Machine("three masses", (2e-3, 1.5e-3, 4e-3), (0.01, 0.0, 0.0), (40.0, 18.0), (0.01, 0.02), 1e-3, (0.3, 40.0), 0.6, 10.0),
)


class Laws(NamedTuple):
    """What is concealed; inactive by default. Motor, first spring, last body, actuator, sensor."""

    coulomb: float = 0.0
    breakaway: float = 1.0  # times the level
    stribeck: float = 0.0
    stribeck_speed: float = 1.0
    asymmetry: float = 0.0
    drift: float = 0.0
    drift_time: float = 1.0
    place: float = 0.0  # part of the level that goes with sin(place_order q + 0.4)
    place_order: float = 0.0
    load: float = 0.0  # friction over |torque of the first spring|
    bristle: float = 0.0  # Dahl's stiffness
    quadratic: float = 0.0
    ripple: float = 0.0
    ripple_order: float = 0.0
    offset: float = 0.0
    gap: float = 0.0
    gap_at: float = 0.0
    cubic: float = 0.0
    slip_stiffness: float = 0.0
    slip_torque: float = 0.0
    error: float = 0.0  # of the transmission
    error_order: float = 0.0
    gravity: float = 0.0
    swing: float = 0.0  # part of the last inertia that goes with sin(swing_order q + 0.7)
    swing_order: float = 0.0
    limit: float = 1e300
    dead: float = 0.0
    droop: float = 0.0
    lag: float = 0.0
    delay: float = 0.0
    sensor_lag: float = 0.0
    sensor_delay: float = 0.0


@njit(cache=True)
def solve(laws, inertia, viscous, stiffness, damping, feed, goal, goal_speed, kp, kd, noise, grid, dt, sub):  # type: ignore[no-untyped-def]
    """Semi-implicit steps with a friction that holds: torque held over a sample, velocity, angle, true velocity, true angle."""
    n, rows, h = len(inertia), len(goal), dt / sub
    q, v, a, out = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((rows, 5))
    past = np.zeros((rows * sub + 1, 2))
    acting = bristle = slip = 0.0
    seen = np.zeros(2)
    late = round(laws.sensor_delay / h)
    s = 0
    for i in range(rows):
        angle, speed = past[max(0, s - late), 0], past[max(0, s - late), 1]
        if laws.sensor_lag > 0:
            angle, speed = seen[0], seen[1]
        angle += noise[i, 1]
        if grid > 0:
            angle = grid * np.round(angle / grid)
        speed += noise[i, 0]
        out[i, 0] = feed[i] + kp * (goal[i] - angle) + kd * (goal_speed[i] - speed)
        out[i, 1], out[i, 2], out[i, 3], out[i, 4] = speed, angle, v[0], q[0]
        for m in range(sub):
            t = i * dt + m * h
            row = int(np.floor((t - laws.delay) / dt + 1e-9))
            u = min(max(out[row, 0] if row >= 0 else 0.0, -laws.limit), laws.limit)
            u = np.sign(u) * max(0.0, abs(u) - laws.dead)
            u *= 1.0 - laws.droop * u * u
            acting = acting + (u - acting) * (1.0 - np.exp(-h / laws.lag)) if laws.lag > 0 else u
            for b in range(n):
                a[b] = -viscous[b] * v[b]
            a[0] += (
                acting - laws.offset - laws.ripple * np.sin(laws.ripple_order * q[0] + 1.0) - laws.quadratic * v[0] * abs(v[0])
            )
            first = 0.0
            for c in range(n - 1):
                e, de, reach = q[c] - q[c + 1], v[c] - v[c + 1], 1.0
                if c == 0 and laws.error > 0:
                    phase = laws.error_order * q[0] + 0.3
                    e += laws.error * np.sin(phase)
                    reach += laws.error * laws.error_order * np.cos(phase)
                    de += (reach - 1.0) * v[0]
                torque = stiffness[c] * e + damping[c] * de
                if c == int(laws.gap_at) and laws.gap > 0:
                    torque = 0.0 if abs(e) < laws.gap / 2 else torque - np.sign(e) * stiffness[c] * laws.gap / 2
                if c == 0:
                    torque += laws.cubic * e**3
                    if laws.slip_stiffness > 0:
                        most = laws.slip_torque / laws.slip_stiffness
                        slip = min(max(slip + de * h, -most), most)
                        torque += laws.slip_stiffness * slip
                    first = torque
                a[c] -= torque * reach
                a[c + 1] += torque
            a[n - 1] -= laws.gravity * np.sin(q[n - 1] + 0.5)
            level = laws.coulomb + laws.stribeck * np.exp(-((v[0] / laws.stribeck_speed) ** 2))
            level *= (1.0 + laws.drift * np.exp(-t / laws.drift_time)) * (
                1.0 + laws.place * np.sin(laws.place_order * q[0] + 0.4)
            )
            level += laws.load * abs(first)
            if laws.bristle > 0:
                bristle += h * v[0] * (1.0 - laws.bristle * bristle / laws.coulomb * np.sign(v[0]))
                v[0] += h * (a[0] - laws.bristle * bristle) / inertia[0]
            elif v[0] == 0.0:
                hold = level * laws.breakaway
                if a[0] > hold + laws.asymmetry or a[0] < -hold + laws.asymmetry:
                    v[0] = h * (a[0] - np.sign(a[0]) * level - laws.asymmetry) / inertia[0]
            else:
                after = v[0] + h * (a[0] - np.sign(v[0]) * level - laws.asymmetry) / inertia[0]
                v[0] = 0.0 if after * v[0] < 0 and level > 0 else after
            for b in range(1, n):
                J = inertia[b]
                if b == n - 1 and laws.swing > 0:
                    phase = laws.swing_order * q[b] + 0.7
                    a[b] -= 0.5 * J * laws.swing * laws.swing_order * np.cos(phase) * v[b] ** 2
                    J *= 1.0 + laws.swing * np.sin(phase)
                v[b] += h * a[b] / J
            for b in range(n):
                q[b] += h * v[b]
            s += 1
            past[s, 0], past[s, 1] = q[0], v[0]
            if laws.sensor_lag > 0:
                w = 1.0 - np.exp(-h / laws.sensor_lag)
                seen[0] += (q[0] - seen[0]) * w
                seen[1] += (v[0] - seen[1]) * w
    return out


@dataclass
class Sizes:
    """What an effect is sized by: friction level, rms torque, speed and spring's twist, an order over the angle, and a die."""

    level: float
    torque: float
    speed: float
    swing: float
    twists: tuple[float, ...]
    order: float
    machine: Machine
    rng: np.random.Generator

    def draw(self, low: float, high: float) -> float:
        """Between low and high, the logarithm uniform."""
        return float(np.exp(self.rng.uniform(math.log(low), math.log(high))))


def _gap(s: Sizes) -> dict[str, float]:
    at = int(s.rng.integers(len(s.twists)))
    return {"gap": s.twists[at] * s.draw(0.3, 2.0), "gap_at": float(at)}


def _delay(s: Sizes) -> dict[str, float]:
    return {("delay", "sensor_delay")[int(s.rng.integers(2))]: s.machine.dt * s.draw(0.7, 5.0)}


Effect = Callable[[Sizes], dict[str, float]]
EVERYWHERE: dict[str, Effect] = {
    "coulomb_friction": lambda s: {"coulomb": s.level},
    "static_friction": lambda s: {"coulomb": s.level, "breakaway": 1.5},
    "stribeck_friction": lambda s: {"coulomb": s.level, "stribeck": 0.6 * s.level, "stribeck_speed": 0.3 * s.speed},
    "asymmetric_friction": lambda s: {"coulomb": s.level, "asymmetry": 0.4 * s.level},
    "quadratic_friction": lambda s: {"quadratic": s.level / s.speed**2},
    "friction_drift": lambda s: {"coulomb": s.level, "drift": 0.8, "drift_time": 0.3 * s.machine.seconds},
    "position_dependent_friction": lambda s: {"coulomb": s.level, "place": 0.5, "place_order": s.order},
    "presliding_friction": lambda s: {"coulomb": s.level, "bristle": s.level / (0.03 * s.swing)},
    "torque_ripple": lambda s: {"ripple": s.level, "ripple_order": s.order},
    "torque_offset": lambda s: {"offset": 0.5 * s.level},
    "actuator_saturation": lambda s: {"limit": s.draw(0.9, 1.6) * s.torque},
    "actuator_deadzone": lambda s: {"dead": 0.6 * s.level},
    "torque_gain_droop": lambda s: {"droop": s.draw(0.02, 0.08) / s.torque**2},
    "actuator_lag": lambda s: {"lag": s.machine.dt * s.draw(1.0, 6.0)},
    "sensor_lag": lambda s: {"sensor_lag": s.machine.dt * s.draw(1.0, 6.0)},
    "time_delay": _delay,
}
SPRUNG: dict[str, Effect] = {
    "backlash": _gap,
    "hardening_stiffness": lambda s: {"cubic": s.draw(0.1, 0.5) * s.machine.stiffness[0] / (3 * s.twists[0] ** 2)},
    "hysteresis": lambda s: {
        "slip_stiffness": 0.4 * s.machine.stiffness[0],
        "slip_torque": 0.2 * s.twists[0] * s.machine.stiffness[0],
    },
    "transmission_error": lambda s: {"error": s.twists[0] * s.draw(0.1, 0.4), "error_order": s.order},
    "load_dependent_friction": lambda s: {"load": s.draw(0.08, 0.2)},
    "position_dependent_inertia": lambda s: {"swing": s.draw(0.1, 0.3), "swing_order": s.order},
    "extra_flexible_mode": lambda s: {},  # another chain, see `_chain`
    "viscous_friction": lambda s: {},
}


def _chain(machine: Machine, effect: str, sizes: Sizes) -> tuple[np.ndarray, ...]:
    """Inertia, viscous friction, stiffness, damping of the plant."""
    J, f, k, d = (np.array(x) for x in (machine.inertia, machine.viscous, machine.stiffness, machine.damping))
    if effect == "viscous_friction":
        f[-1] = sizes.draw(0.1, 0.5) * f[0]
    if effect == "extra_flexible_mode":
        w = 2 * math.pi * machine.band[1] * sizes.rng.uniform(0.3, 0.7)
        split = sizes.draw(0.15, 0.4) * J[-1]
        J, f = np.append(J, split), np.append(f, 0.0)
        J[-2] -= split
        k, d = np.append(k, split * w * w), np.append(d, 0.06 * split * w)
    return J, f, k, d


@dataclass(frozen=True)
class Case:
    """A case as it was drawn, and what was said of it."""

    number: int
    machine: Machine
    effect: str | None
    closed: bool
    truth: dict[str, float] = field(default_factory=dict)


def _excitation(kind: str, machine: Machine, rng: np.random.Generator) -> np.ndarray:
    """Torque of unit rms."""
    rows = round(machine.seconds / machine.dt)
    if kind == "steps":
        u = np.zeros(rows)
        row, dwell = 0, 0.12 * rng.uniform(0.5, 2.0)
        while row < rows:
            hold = max(1, round(dwell / machine.dt * 2 ** rng.uniform(-1, 1)))
            u[row : row + hold] = rng.uniform(-1, 1)
            row += hold
    else:
        low, high = machine.band
        spectrum = np.zeros(rows // 2 + 1, complex)
        lines = np.arange(max(1, int(low * machine.seconds)), int(high * machine.seconds) + 1)
        spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
        u = np.fft.irfft(spectrum, rows)
    u -= u.mean()
    return np.asarray(u / u.std())


def _mjcf(machine: Machine, rng: np.random.Generator) -> str:
    """The nominal model: nested joints, so that an angle is the twist of its spring."""
    J, f, k, d = (np.array(x) for x in (machine.inertia, machine.viscous, machine.stiffness, machine.damping))
    J, k = (x * np.exp(0.12 * rng.uniform(-1, 1, len(x))) for x in (J, k))
    f, d = (x * np.exp(0.3 * rng.uniform(-1, 1, len(x))) for x in (f, d))
    names = {1: ("motor",), 2: ("motor", "arm"), 3: ("motor", "gearbox", "arm")}[len(J)]
    kind, along = ("slide", "1 0 0") if machine.slide else ("hinge", "0 0 1")
    text = (
        f'<mujoco model="machine"><compiler angle="radian"/><option timestep="{machine.dt:g}" integrator="RK4" gravity="0 0 0"/>'
    )
    text += "<worldbody>\n"
    for i, name in enumerate(names):
        spring = f' stiffness="{k[i - 1]:.6g}"' if i else ""
        mass = (
            f'mass="{J[i]:.6g}" diaginertia="1 1 1"'
            if machine.slide
            else f'mass="1" diaginertia="{J[i]:.6g} {J[i]:.6g} {J[i]:.6g}"'
        )
        damping = d[i - 1] if i else f[0]
        text += f'<body name="{name}_body"><joint name="{name}" type="{kind}" axis="{along}" damping="{damping:.6g}"'
        text += f'{spring}/><inertial pos="0 0 0" {mass}/>\n'
    text += "</body>" * len(names) + '</worldbody><actuator><motor name="motor_torque" joint="motor"/></actuator><sensor>'
    return text + '<jointvel name="motor_velocity" joint="motor"/><jointpos name="motor_angle" joint="motor"/></sensor></mujoco>'


def write(folder: Path, number: int, seed: int) -> Case:
    """Draw a case and write its recordings and its nominal model."""
    rng = np.random.default_rng([seed, number])
    machine = MACHINES[number % len(MACHINES)]
    n, dt, rows = len(machine.inertia), machine.dt, round(machine.seconds / machine.dt)
    known = EVERYWHERE | (SPRUNG if n > 1 else {}) | ({} if machine.slide else {"gravity_load": lambda s: {"gravity": s.level}})
    closed = bool(rng.random() < 0.35)
    none = rng.random() < 0.2
    kinds = rng.permutation(KINDS)[:2]
    drives = [_excitation(str(kind), machine, rng) for kind in kinds]
    sub = max(20, math.ceil(dt / STEP))
    plain = tuple(np.array(x) for x in (machine.inertia, machine.viscous, machine.stiffness, machine.damping))
    quiet = np.zeros((rows, 2))

    def run(
        laws: Laws, chain: tuple[np.ndarray, ...], drive: np.ndarray, noise: np.ndarray, grid: float, speed: float
    ) -> np.ndarray:
        feed, goal, kp, kd = machine.torque * drive, np.zeros(rows), 0.0, 0.0
        if speed > 0:  # a position loop of 4 Hz follows a smooth path of that speed
            w, total = 2 * math.pi * 4, sum(machine.inertia)
            kp, kd = total * w * w, 1.4 * total * w
            path = np.cumsum(drive) * dt
            goal = filtfilt(*butter(2, min(0.9, 16 * dt)), path - np.linspace(path[0], path[-1], rows))
            goal *= speed / np.std(np.gradient(goal, dt))
            goal, feed = goal - goal[0], np.zeros(rows)
        feed = np.array([float(f"{x:.7g}") for x in feed])
        return np.asarray(solve(laws, *chain, feed, goal, np.gradient(goal, dt), kp, kd, noise, grid, dt, sub))

    free = run(Laws(), plain, drives[0], quiet, 0.0, 0.0)
    speed = float(np.std(free[:, 3])) if closed else 0.0
    base = run(Laws(), plain, drives[0], quiet, 0.0, speed)
    travel, torque = float(np.ptp(base[:, 4])), float(np.std(base[:, 0]))
    sigma = float(np.std(base[:, 3])) * 10 ** rng.uniform(-2.5, -1.7)
    grid = 1e-6 if machine.slide else (2 * math.pi / 65536 if rng.random() < 0.5 else 0.0)
    J = machine.inertia
    twists = tuple(torque * sum(J[c + 1 :]) / sum(J) / k for c, k in enumerate(machine.stiffness))
    periods = 2 * math.pi / travel
    order = periods * math.exp(rng.uniform(math.log(4), math.log(12)))
    order = order if machine.slide else float(max(1, math.ceil(order)))
    level = torque * math.exp(rng.uniform(math.log(0.05), math.log(0.3)))
    sizes = Sizes(level, torque, float(np.std(base[:, 3])), float(np.std(base[:, 4])), twists, order, machine, rng)
    names = list(known)
    while True:
        effect = None if none else names[int(rng.integers(len(names)))]
        truth = known[effect](sizes) if effect else {}
        chain = _chain(machine, effect or "", sizes)
        motions = [
            run(Laws(**truth), chain, drive, np.array([sigma, 1e-6 * travel]) * rng.standard_normal((rows, 2)), grid, speed)
            for drive in drives
        ]
        if all(np.all(np.isfinite(m)) for m in motions):
            break  # else it cannot be driven so: a gain that falls beyond its turning point
    for motion, part in zip(motions, ("estimation", "held_out"), strict=True):
        data = np.column_stack([np.arange(rows) * dt, motion[:, :3]])
        np.savetxt(folder / f"{number:03d}_{part}.csv", data, delimiter=",", header=COLUMNS, comments="", fmt="%.9g")
    (folder / f"{number:03d}.xml").write_text(_mjcf(machine, rng), encoding="utf-8")
    if closed:
        (folder / f"{number:03d}.toml").write_text('[experiment]\nloop = "closed"\n', encoding="utf-8")
    return Case(number, machine, effect, closed, truth)


def diagnose(folder: Path, case: Case) -> dict:
    """What the command says of a case."""
    stem, out = f"{case.number:03d}", folder / f"{case.number:03d}"
    call = [sys.executable, "-m", "simgap", "diagnose", str(folder / f"{stem}_estimation.csv"), "--jobs", "1", "--quiet"]
    call += ["--held-out", str(folder / f"{stem}_held_out.csv"), "--model", str(folder / f"{stem}.xml"), "--out", str(out)]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    if done.returncode:
        return {
            "verdict": "refused",
            "named": [],
            "also": [],
            "left": math.nan,
            "said": done.stderr.strip()[-300:],
            "seconds": math.nan,
        }
    result = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    fit, found = result["fit"], result["findings"]
    return {
        "verdict": result["verdict"],
        "named": [f"{f['effect']}@{f['place']}" for f in found],
        "also": sorted({f["effect"] for f in found} | {e.split("@")[0] for f in found for e in f["equivalents"]}),
        "left": math.sqrt(max(0.0, (fit["refitted"]["held_out_rms"] / fit["noise_floor"]["rms"]) ** 2 - 1.0)),
        "seconds": result["seconds"],
    }


def judged(case: Case, said: dict) -> str:
    """``right``, ``wrong`` (a name that is not so), ``missed`` (no name), ``faint`` (below half of the noise), ``refused``."""
    if said["verdict"] == "refused":
        return "refused"
    named = [n.split("@")[0] for n in said["named"]] if said["verdict"] == "missing_physics" else []
    if case.effect is None:
        return "wrong" if named else ("right" if said["verdict"] != "unexplained" else "missed")
    if len(named) == 1 and case.effect in said["also"]:
        return "right"
    if said["left"] < 0.5 and not named:
        return "faint"
    return "wrong" if named else "missed"


def _interval(hits: int, of: int) -> str:
    low = beta.ppf(0.025, hits, of - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, of - hits) if hits < of else 1.0
    return f"{hits} of {of} (95 %: {100 * low:.0f} to {100 * high:.0f} %)"


def main(arguments: Sequence[str] | None = None) -> int:
    """Write, diagnose, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=70)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--at-once", type=int, default=2, help="diagnoses side by side")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args(arguments)
    rows = []
    with tempfile.TemporaryDirectory() as work, ThreadPoolExecutor(args.at_once) as pool:
        folder = Path(work)
        cases = [write(folder, i, args.seed) for i in range(args.cases)]
        for case, said in zip(cases, pool.map(lambda c: diagnose(folder, c), cases), strict=True):
            how = judged(case, said)
            loop = "closed" if case.closed else "open"
            print(f"{case.number:3d}  {case.machine.name:15s} {loop:6s} {case.effect or 'nothing':28s} {how:7s} {said['verdict']}"
                  f" {' + '.join(said['named'])}  ({said['seconds']:.0f} s)", flush=True)  # fmt: skip
            rows.append({"machine": case.machine.name, "closed": case.closed, "effect": case.effect, "truth": case.truth,
                         "judged": how, **said})  # fmt: skip
    nulls = [r for r in rows if r["effect"] is None]
    others = [r for r in rows if r["effect"] is not None and r["judged"] != "faint"]
    print(f"nulls with a false name: {_interval(sum(r['judged'] == 'wrong' for r in nulls), len(nulls))}")
    print(f"effects right, up to declared equivalents: {_interval(sum(r['judged'] == 'right' for r in others), len(others))}")
    print(f"effects under a wrong name: {_interval(sum(r['judged'] == 'wrong' for r in others), len(others))}")
    if args.json:
        args.json.write_text(json.dumps({"seed": args.seed, "cases": rows}, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
