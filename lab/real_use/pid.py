"""``python -m lab.real_use.pid``: servos with integral action in plain MuJoCo, diagnosed against models without it.

python -m lab.real_use.pid run --seed 7 --count 24 --out out/pid/7.jsonl      # resumable, one JSON line a case
python -m lab.real_use.pid table out/pid/7.jsonl --into docs/real_use.md

The machine has a ``<pid>``, the model a ``<position>`` of the same kp and kv. Half of the cases have ki between kp / 3 and 5 kp
[1/s]; the others lack nothing, have other gains, or lack dry friction, a force limit or a delay. A log begins at rest, the
integral wound up to the weight, or in motion. Plain MuJoCo judges corrected.xml from the start (angle, velocity, activation)
that suits the held-out log best.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import least_squares

from diagnose.options import Options
from lab.real_use import design
from lab.real_use.logs import wave_of
from lab.real_use.machines import JOINT, Numbers, nominal, text
from lab.real_use.run import between_marks, measured, read, run_missing, said
from lab.real_use.score import MISSES, Count
from mjsim.errors import InputError
from mjsim.mjcf.compile import caught_warnings
from simgap.pipeline import diagnose_files

__all__ = ["KINDS", "PidCase", "draw", "main", "make_files", "run_case", "table"]

KINDS = {
    "integral": "integral_action", "nothing": "", "gains": "", "friction": "coulomb_friction", "limit": "actuator_saturation",
    "delay": "time_delay",
}  # fmt: skip
BLOCK = ("integral",) * 6 + ("nothing", "gains") * 2 + ("friction", "limit", "integral", "integral") + (
    "nothing", "gains", "friction", "limit", "delay", "delay"
) + ("integral",) * 4  # fmt: skip
SECONDS = {50.0: 20.0, 100.0: 12.0, 200.0: 8.0}
BEFORE = 4.0  # [s] that the machine runs ahead of the log
TIMESTEP = 0.001
ENCODER = 2.0 * math.pi / 4096  # [rad]; of a slide the same number of steps over its swing
LEVEL = (0.001, 0.005)  # noise of the angle over its rms
FADE = 0.4  # [s] over which a log from rest takes up its motion


@dataclass(frozen=True)
class PidCase:
    """One case: machine, rate [Hz], command (sines, steps), sensor (encoder, noise), begin (rest, motion), kind, seed."""

    number: int
    machine: str
    rate: float
    command: str
    sensor: str
    begin: str
    dry: bool
    kind: str
    seed: int

    @property
    def plain(self) -> design.Case:
        """The case of the machine's file."""
        kind = "joint_friction" if self.kind == "friction" or not self.dry else "nothing"
        return design.Case(
            self.number, self.machine, "stiff", "implicitfast", self.rate, "servo", "nothing", kind, TIMESTEP, self.seed
        )


def draw(count: int, seed: int) -> list[PidCase]:
    """The first ``count`` cases of a seed; of each kind the levels of all factors come in turn."""
    rng = np.random.default_rng(seed)
    levels = list(
        itertools.product(
            ("pendulum", "geared", "slide"), (50.0, 100.0, 200.0), ("sines", "steps"), ("encoder", "noise"), ("rest", "motion"),
            (False, True),
        )
    )  # fmt: skip
    order = [levels[i] for i in rng.permutation(len(levels))]
    kinds = itertools.cycle(BLOCK)
    out = []
    for i in range(count):
        machine, rate, command, sensor, begin, dry = order[i % len(order)]
        out.append(PidCase(i, machine, rate, command, sensor, begin, dry, next(kinds), int(rng.integers(2**31))))
    return out


def true_numbers(case: PidCase, given: Numbers) -> Numbers:
    """Numbers of the machine, sized by its weight and the torque of its swing."""
    rng = np.random.default_rng([case.seed, 1])
    torque = max(given.weight * given.swing, given.kp * given.swing * 0.2)
    match case.kind:
        case "integral":
            return dataclasses.replace(given, ki=given.kp * math.exp(rng.uniform(math.log(1 / 3), math.log(5.0))))
        case "gains":
            kp, kv = (1.3 ** float(rng.choice([-1.0, 1.0])) for _ in range(2))
            return dataclasses.replace(given, kp=given.kp * kp, kv=given.kv * kv)
        case "friction":
            return dataclasses.replace(given, friction=0.3 * rng.uniform(0.7, 1.4) * torque)
        case "limit":
            return dataclasses.replace(given, limit=rng.uniform(0.5, 0.8) * _peak(case, given))
        case "delay":
            return dataclasses.replace(given, delay=max(1, round(0.012 * rng.uniform(0.7, 1.4) / TIMESTEP)) * TIMESTEP)
        case _:
            return given


def _peak(case: PidCase, given: Numbers) -> float:
    """Largest torque of the drive at the joint in the first log of the nominal machine."""
    u, start = _command(case, given, 0)
    return float(np.max(np.abs(_run(mujoco.MjModel.from_xml_string(text(case.plain, given)), case.rate, u, start)[1])))


def make_files(case: PidCase, folder: Path) -> tuple[Numbers, Numbers]:
    """Write nominal.xml, true.xml, estimation.csv and held_out.csv; the numbers of both files."""
    given = nominal(case.plain)
    truth = true_numbers(case, given)
    folder.mkdir(parents=True, exist_ok=True)
    for name, numbers in (("nominal", given), ("true", truth)):
        (folder / f"{name}.xml").write_text(text(case.plain, numbers), encoding="utf-8")
    for which, name in enumerate(("estimation", "held_out")):
        log = _log(case, folder / "true.xml", given, which)
        head = "time_s,command_rad,angle_rad"
        np.savetxt(folder / f"{name}.csv", log, delimiter=",", header=head, comments="", fmt="%.9g")
    return given, truth


def _log(case: PidCase, path: Path, given: Numbers, which: int) -> np.ndarray:
    """Time, command and angle (N, 3) of the machine on a command that is held over each sample."""
    rng, ahead = np.random.default_rng([case.seed, 3, which]), round(BEFORE * case.rate)
    u, start = _command(case, given, which)
    q = _run(mujoco.MjModel.from_xml_path(str(path)), case.rate, u, start)[0][ahead:]
    t, u = np.arange(len(q)) / case.rate, u[ahead:]
    if case.sensor == "encoder":
        step = ENCODER if case.machine != "slide" else ENCODER * given.swing / 0.4
        return np.column_stack([t, u, step * np.round(q / step)])
    return np.column_stack([t, u, q + rng.uniform(*LEVEL) * float(np.std(q)) * rng.standard_normal(len(q))])


def _command(case: PidCase, given: Numbers, which: int) -> tuple[np.ndarray, tuple[float, float, float]]:
    """Command (N,) from `BEFORE` ahead of the log on, and where the machine starts then."""
    rng = np.random.default_rng([case.seed, 2, which])
    ahead, count = round(BEFORE * case.rate), round(SECONDS[case.rate] * case.rate)
    t = (np.arange(ahead + count) - ahead) / case.rate
    offset = given.swing * rng.uniform(0.5, 1.0) * rng.choice([-1.0, 1.0])
    if case.command == "sines":
        wave = wave_of(rng, t - t[0], 2.0)
    else:
        wave = rng.uniform(-1.7, 1.7, math.ceil((t[-1] - t[0]) / 0.5) + 1)[((t - t[0]) / 0.5).astype(int)]
    if case.begin == "rest":
        wave = wave * np.clip(t / FADE, 0.0, 1.0)
    return given.gear * (offset + given.swing * wave), (offset if case.begin == "rest" else 0.0, 0.0, 0.0)


def _run(m: mujoco.MjModel, rate: float, u: np.ndarray, start: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Angle of the joint and torque of its drive (N,) from a start (angle, velocity, activation) on a held command."""
    data, (q, torque) = mujoco.MjData(m), np.empty((2, len(u)))
    steps, at = round(1 / (rate * m.opt.timestep)), (m.joint(JOINT).qposadr[0], m.joint(JOINT).dofadr[0])
    data.qpos[at[0]], data.qvel[at[1]] = start[:2]
    if m.na:
        data.act[-1] = start[2]
    with caught_warnings():
        for k, x in enumerate(u):
            q[k] = data.qpos[at[0]]
            data.ctrl[0] = x
            mujoco.mj_step(m, data, steps)
            torque[k] = data.qfrc_actuator[at[1]]
    return q, torque


def follow(path: Path, rate: float, log: np.ndarray) -> float:
    """Rms error of a file on a log (N, 3) in plain MuJoCo, from the start that suits it best; infinite where it diverges."""
    m = mujoco.MjModel.from_xml_path(str(path))
    _, u, q = log.T
    scale = np.array([max(1e-3 * np.ptp(q), 1e-9), np.ptp(q), 0.1 * np.ptp(q)])[: 3 if m.na else 2]

    def errors(x: np.ndarray) -> np.ndarray:
        moved = np.pad(x * scale, (0, 3 - len(x)))
        e = q - _run(m, rate, u, (q[0] + moved[0], moved[1], moved[2]))[0]
        return np.where(np.isfinite(e), e, 1e6)

    fit = least_squares(errors, np.zeros(len(scale)), diff_step=1e-2, x_scale=1.0, max_nfev=12)
    error = float(np.sqrt(np.mean(fit.fun**2)))
    return error if error < 1e5 else math.inf


def run_case(case: PidCase, folder: Path, jobs: int) -> dict[str, Any]:
    """Make and diagnose one case in a folder; what is recorded of it. ``error``: a message of bad input (``exit`` 2)."""
    given, truth = make_files(case, folder)
    names = [f.name for f in dataclasses.fields(truth) if getattr(truth, f.name) != getattr(given, f.name)]
    held = np.loadtxt(folder / "held_out.csv", delimiter=",", skiprows=1)
    out: dict[str, Any] = {
        **dataclasses.asdict(case), "truth": {n: getattr(truth, n) for n in names}, "ratio": truth.ki / truth.kp,
        "ki": truth.ki / truth.gear**2, "given_error": follow(folder / "nominal.xml", case.rate, held),
        "true_error": follow(folder / "true.xml", case.rate, held), "exit": 0,
    }  # fmt: skip
    with measured(out):
        try:
            files = [folder / f"{name}.csv" for name in ("estimation", "held_out")]
            diagnose_files(
                files[:1], folder / "nominal.xml", folder / "out", files[1:], Options(jobs=jobs), progress=False, accept_log=True
            )
        except InputError as error:
            out |= {"exit": 2, "error": str(error)}
    if out["exit"] == 0:
        out |= said(json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8")))
        out["own_error"] = follow(folder / "out" / "corrected.xml", case.rate, held)
    return out


def _wanted(r: dict[str, Any]) -> list[str]:
    return [KINDS[r["kind"]]] if KINDS[r["kind"]] else []


def _named(r: dict[str, Any]) -> bool:
    return not r["exit"] and r["found"] == _wanted(r)


def _false(r: dict[str, Any]) -> bool:
    return not r["exit"] and bool(set(r["found"]) - set(_wanted(r)))


def _ratio(r: dict[str, Any], own: str, other: str) -> float:
    return r[own] / r[other] if not r["exit"] and r[own] is not None and r[other] else math.inf


def _ki(r: dict[str, Any]) -> float:
    """ki that was found over that of the machine; NaN where it was not named."""
    i = r["found"].index("integral_action") if not r["exit"] and "integral_action" in r["found"] else -1
    return r["values"][i]["gain_Nm_rad_s"] / r["ki"] if i >= 0 and r["ki"] else math.nan


def line(r: dict[str, Any]) -> str:
    """A line for a case."""
    dry = "dry" if r["dry"] else "   "
    where = f"{r['machine']:8s} {r['rate']:3g} Hz {r['command']:5s} {r['sensor']:7s} {r['begin']:6s} {dry}"
    if r["exit"]:
        return f"{r['number']:3d} {where} {r['kind']:8s} {r['error'].strip().splitlines()[-1]}"
    found = "+".join(r["found"]) or "-"
    return (
        f"{r['number']:3d} {where} {r['kind']:8s} ki/kp {r['ratio']:5.2f} given {_ratio(r, 'given_error', 'true_error'):6.1f} "
        f"{'ok ' if _named(r) else '-- '} {r['verdict']:15s} {found}; ki found/true {_ki(r):.3f}, own/reported "
        f"{_ratio(r, 'own_error', 'reported'):.3f}, own/truth {_ratio(r, 'own_error', 'true_error'):.3f}; "
        f"{r['cpu_seconds']:.0f} s"
    )


def table(records: Sequence[dict[str, Any]]) -> str:
    """The score as Markdown."""
    integral, others = ([r for r in records if (r["kind"] == "integral") == own] for own in (True, False))
    clean = [r for r in others if not KINDS[r["kind"]]]
    rows = [
        ("integral action named, and nothing else", Count(sum(map(_named, integral)), len(integral))),
        ("another effect named where it is there", Count(sum(map(_false, integral)), len(integral))),
        ("physics named where nothing is missing or gains are off", Count(sum(map(_false, clean)), len(clean))),
        ("integral action named where another effect is missing or none",
         Count(sum("integral_action" in r.get("found", ()) for r in others), len(others))),
        ("dry friction, a force limit or a delay named, and nothing else",
         Count(sum(_named(r) for r in others if r not in clean), len(others) - len(clean))),
        (f"own run of `corrected.xml` within {MISSES} x of the reported held-out error",
         Count(sum(_ratio(r, "own_error", "reported") <= MISSES for r in records), len(records))),
        (f"own run of `corrected.xml` within {MISSES} x of the true machine's error",
         Count(sum(_ratio(r, "own_error", "true_error") <= MISSES for r in records), len(records))),
    ]  # fmt: skip
    ki = sorted(abs(math.log(_ki(r))) for r in integral if math.isfinite(_ki(r)))
    out = ["| measure | count | share | 95 % (Wilson) |", "|---|---|---|---|", *(f"| {name} | {c} |" for name, c in rows)]
    if ki:
        most = 100.0 * (math.exp(ki[-1]) - 1.0)
        out += ["", f"ki that was found: median {100 * (math.exp(ki[len(ki) // 2]) - 1):.1f} % off, at most {most:.1f} %."]
    wrong = [r for r in records if not _named(r) or _ratio(r, "own_error", "reported") > MISSES]
    return "\n".join([*out, *(["", "Not right:", "", *(f"    {line(r)}" for r in wrong)] if wrong else [])]) + "\n"


BEGIN, END = "<!-- pid: begin -->", "<!-- pid: end -->"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m lab.real_use.pid", description=__doc__,
                                     formatter_class=argparse.RawTextHelpFormatter)  # fmt: skip
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="run the cases that the file of records lacks")
    run.add_argument("--seed", type=int, required=True)
    run.add_argument("--count", type=int, default=len(BLOCK))
    run.add_argument("--cases", type=int, nargs="*", help="only these numbers of them")
    run.add_argument("--jobs", type=int, default=1, help="threads")
    run.add_argument("--keep", type=Path, help="keep the files of each case in this folder")
    run.add_argument("--out", type=Path, required=True, help="file of records (JSON lines)")
    score = commands.add_parser("table", help="score records, as Markdown")
    score.add_argument("records", type=Path)
    score.add_argument("--into", type=Path, help="replace what stands between the two markers of this Markdown file")
    options = parser.parse_args(arguments)
    if options.command == "run":
        cases = [c for c in draw(options.count, options.seed) if options.cases is None or c.number in options.cases]
        for record in run_missing(cases, options.out, options.jobs, options.keep, run_case):
            print(line(record), flush=True)
        return 0
    records = sorted(read(options.records).values(), key=lambda r: r["number"])
    if options.into is None:
        print("\n".join([*map(line, records), "", table(records)]))
        return 0
    return between_marks(options.into, BEGIN, END, table(records))


if __name__ == "__main__":
    sys.exit(main())
