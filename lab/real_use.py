"""Logs of plain MuJoCo models as users have them, diagnosed: false alarms, effects named right, corrected files judged.

    python -m lab.real_use --quick --out out/real_use
    python -m lab.real_use --cases 200 --seed 1

Every case is drawn beforehand from one seed: a machine, the solver settings of its dry friction, an integrator, a sampling
rate, a loop, and what the nominal file lacks (nothing, a parameter, one effect). The log is made by MuJoCo itself, with the
options of the nominal file. A file with a line for each case is written as it goes; a run that was broken off goes on from it.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from diagnose.options import Options
from diagnose.verdict.numerics import IDS
from mjsim.mjcf.compile import caught_warnings
from simgap.pipeline import diagnose_files

__all__ = ["Case", "draw", "main", "run_case", "summary"]

QUICK, SECONDS = 16, 4.0
NOISE = 0.01  # of the velocity noise, relative to its rms
STIFF = 'solreffriction="-1 -1000" solimpfriction=".9999 .9999 .001 .5 2"'
MACHINES = ("pendulum", "geared", "slide", "two_mass")
LACKS = ("nothing", "nothing", "inertia", "damping", "coulomb_friction", "time_delay", "torque_offset", "quadratic_friction")


@dataclass(frozen=True)
class Case:
    """One case: how the log is made and what the nominal file lacks of it (nothing, a parameter, an effect)."""

    number: int
    machine: str
    stiff: bool
    integrator: str
    rate: float
    loop: str
    lacks: str
    seed: int

    @property
    def right(self) -> tuple[str, ...]:
        """Effects that are to be named."""
        return () if self.lacks in ("nothing", "inertia", "damping") else (self.lacks,)


@dataclass(frozen=True)
class _Machine:
    """Its torque [N m | N], dry friction that the nominal file has, and size of a friction that it lacks, viscous friction."""

    torque: float
    friction: float
    lacking: float
    damping: float
    gear: float = 1.0
    slide: bool = False


_SIZES = {
    "pendulum": _Machine(1.2, 0.2, 0.25, 0.05),
    "geared": _Machine(0.12, 0.3, 0.4, 0.2, gear=20.0),
    "slide": _Machine(20.0, 2.0, 4.0, 5.0, slide=True),
    "two_mass": _Machine(1.0, 0.1, 0.15, 0.05),
}


def draw(count: int, seed: int) -> list[Case]:
    """The cases of a seed."""
    rng = np.random.default_rng(seed)
    out = []
    for n in range(count):
        pick = lambda options: options[int(rng.integers(len(options)))]  # noqa: E731
        out.append(
            Case(n, MACHINES[n % len(MACHINES)], bool(rng.integers(2)), pick(("Euler", "implicitfast", "RK4")),
                 pick((100.0, 250.0, 1000.0, 2000.0)), pick(("open", "pd")), pick(LACKS), int(rng.integers(2**31)))
        )  # fmt: skip
    return out


def model(case: Case, *, true: bool) -> str:
    """MJCF of a case: the nominal file, or the machine that the log is made of."""
    m = _SIZES[case.machine]
    lacks = case.lacks if true else ""
    scale = 1.2 if lacks == "inertia" else 1.0
    damping = m.damping * (1.5 if lacks == "damping" else 1.0)
    quadratic = f" {0.3 * m.damping!r}" if lacks == "quadratic_friction" else ""
    has = case.lacks != "coulomb_friction"  # the file that lacks friction has none
    friction = m.friction if has else m.lacking if lacks else 0.0
    solver = STIFF if case.stiff else ""
    joint = f'damping="{damping!r}{quadratic}" frictionloss="{friction!r}" {solver if friction else ""}'
    gear = f'gear="{m.gear!r}"'
    delay = ' delay="0.012" nsample="26"' if lacks == "time_delay" else ""
    bias = f' biastype="affine" biasprm="{0.1 * m.torque!r} 0 0"' if lacks == "torque_offset" else ""
    bodies = {
        "pendulum": f'<body name="arm"><joint name="j" axis="0 1 0" {joint}/>'
        f'<inertial pos="0 0 -.2" mass="{0.4 * scale!r}" diaginertia=".01 .01 .01"/></body>',
        "geared": f'<body name="arm"><joint name="j" axis="0 1 0" armature="{0.05 * scale!r}" {joint}/>'
        '<inertial pos="0 0 -.3" mass=".6" diaginertia=".02 .02 .02"/></body>',
        "slide": f'<body name="cart"><joint name="j" type="slide" axis="1 0 0" {joint}/>'
        f'<inertial pos="0 0 0" mass="{2.0 * scale!r}" diaginertia=".01 .01 .01"/></body>',
        "two_mass": f'<body name="motor"><joint name="j" axis="0 0 1" {joint}/>'
        f'<inertial pos="0 0 0" mass="1" diaginertia="{0.02 * scale!r} {0.02 * scale!r} {0.02 * scale!r}"/>'
        '<body name="load"><joint name="shaft" axis="0 0 1" stiffness="120" damping=".03"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia=".03 .03 .03"/></body></body>',
    }
    return f"""<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="{case.integrator}"/>
  <worldbody>{bodies[case.machine]}</worldbody>
  <actuator><general name="drive" joint="j" {gear}{delay}{bias}/></actuator>
</mujoco>
"""


def record(case: Case, path: Path, which: int) -> float:
    """Write the log of a run in MuJoCo, the input held over each sample, with white noise; the noise rms of its velocity."""
    m = mujoco.MjModel.from_xml_string(model(case, true=True))
    data = mujoco.MjData(m)
    size, rng = _SIZES[case.machine], np.random.default_rng([case.seed, which])
    dt = 1.0 / case.rate
    steps, t = round(dt / m.opt.timestep), dt * np.arange(round(SECONDS / dt))
    tones = rng.uniform(0.2, 4.0, 6)
    wave = np.sin(2 * np.pi * (tones[:, None] * t + rng.uniform(0, 1, 6)[:, None])).sum(axis=0) / 2.0
    wave *= np.minimum(1.0, t / 0.2)
    q, v, u = (np.empty(len(t)) for _ in range(3))
    with caught_warnings():
        for k in range(len(t)):
            q[k], v[k] = data.qpos[0], data.qvel[0]
            u[k] = size.torque * wave[k]
            if case.loop == "pd":
                u[k] = 4.0 * size.torque * (0.4 * wave[k] - q[k]) - 0.4 * size.torque * v[k]
            data.ctrl[0] = u[k]
            mujoco.mj_step(m, data, steps)
    v_noise = NOISE * float(np.std(v))
    q_noise = v_noise / 50.0
    table = np.column_stack([t, u, v + v_noise * rng.standard_normal(len(t)), q + q_noise * rng.standard_normal(len(t))])
    np.savetxt(path, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="", fmt="%.9g")
    return v_noise


def run_case(case: Case, work: Path, jobs: int) -> dict[str, Any]:
    """Make, diagnose and score one case."""
    nominal, logs = work / "nominal.xml", [work / "estimation.csv", work / "held_out.csv"]
    nominal.write_text(model(case, true=False), encoding="utf-8")
    noise = [record(case, log, which) for which, log in enumerate(logs)][1]
    began = time.monotonic()
    out: dict[str, Any] = dataclasses.asdict(case)
    try:
        diagnose_files(logs[:1], nominal, work / "out", logs[1:], Options(jobs=jobs), progress=False)
    except ValueError as error:
        return {**out, "error": str(error)}
    said = json.loads((work / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    physics = sorted(f["effect"] for f in said["findings"] if f["class"] == "physics")
    plain, engine = said["fit"]["corrected"], said["fit"].get("surrogate", {}).get("corrected", said["fit"]["corrected"])
    return {
        **out, "verdict": said["verdict"], "found": physics,
        "numerics": [f["effect"] for f in said["findings"] if f["effect"] in IDS],
        "equivalents": sorted({e.split("@")[0] for f in said["findings"] for e in f["equivalents"]}),
        "nominal": said["fit"]["nominal"]["held_out_rms"], "plain": plain["held_out_rms"], "engine": engine["held_out_rms"],
        "noise": noise, "ratio": _ratio(plain["held_out_rms"], engine["held_out_rms"]), "notes": said["notes"],
        "seconds": time.monotonic() - began,
    }  # fmt: skip


def _ratio(a: float | None, b: float | None) -> float:
    return a / b if a is not None and b else math.inf


def _outcome(r: dict[str, Any]) -> str:
    """right, false alarm, missed or wrong."""
    wanted = [] if r["lacks"] in ("nothing", "inertia", "damping") else [r["lacks"]]
    if r.get("error"):
        return "error"
    if r["found"] == wanted:
        clean = {"nothing": ("no_mismatch",), "inertia": ("parameters_only",), "damping": ("parameters_only",)}
        return "right" if r["verdict"] in clean.get(r["lacks"], ("missing_physics",)) else f"verdict {r['verdict']}"
    return "false alarm" if not wanted else "missed" if not r["found"] else "wrong name"


def summary(results: Sequence[dict[str, Any]]) -> list[str]:
    """A line for each case and the counts."""
    lines = []
    for r in results:
        where = (
            f"{r['machine']:9s} {'stiff' if r['stiff'] else 'soft ':5s} {r['integrator']:12s} {r['rate']:6g} Hz {r['loop']:4s}"
        )
        told = r.get("error") or (
            f"{r['verdict']:15s} {'+'.join((*r['found'], *r['numerics'])) or '-':40s} ratio {r['ratio']:6.3f} "
            f"plain/noise {_ratio(r['plain'], r['noise']):7.2f} {r['seconds']:4.0f} s"
        )
        lines.append(f"{r['number']:3d} {where} {r['lacks']:18s} {_outcome(r):24s} {told}")
    clean = [r for r in results if r["lacks"] in ("nothing", "inertia", "damping")]
    rest = [r for r in results if r not in clean]
    within = sum(r.get("ratio", math.inf) <= 1.1 for r in results)
    lines += [
        f"false alarms: {sum(_outcome(r) == 'false alarm' for r in clean)} of {len(clean)}",
        f"named right: {sum(r.get('found') == [r['lacks']] for r in rest)} of {len(rest)}",
        f"verdict and names right: {sum(_outcome(r) == 'right' for r in results)} of {len(results)}",
        f"corrected.xml in plain MuJoCo within 1.1 x of the engine's held-out error: {within} of {len(results)}",
    ]
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases of a seed, resumably, and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m lab.real_use", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} cases")
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=2043)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/real_use"))
    options = parser.parse_args(arguments)
    cases = draw(QUICK if options.quick else options.cases, options.seed)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / f"seed_{options.seed}.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    done = {r["number"]: r for r in map(json.loads, lines)}
    for case in cases:
        if case.number in done and dataclasses.asdict(case).items() <= done[case.number].items():
            continue
        with tempfile.TemporaryDirectory() as work:
            done[case.number] = run_case(case, Path(work), options.jobs)
        with path.open("a", encoding="utf-8") as handle:
            handle.write(json.dumps(done[case.number]) + "\n")
        print(summary([done[case.number]])[0], flush=True)
    print("\n".join(["", *summary([done[c.number] for c in cases])]))


if __name__ == "__main__":
    main()
