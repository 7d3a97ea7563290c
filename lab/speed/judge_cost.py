"""What the judge (the files in plain MuJoCo) adds to a diagnosis: ``python lab/speed/judge_cost.py``; exit 1 on a miss.

    python lab/speed/judge_cost.py --repeat 3

Each case is diagnosed twice by `simgap.pipeline.diagnose_files`, each time in a process of its own: with the judge, and with
neither the nominal file compared before the search nor the corrected one judged after it. Told are processor and wall seconds of
the two, their ratio, and the processor seconds that the judge itself takes, over all the others. The two differ where the judge
changes what is searched: a recording that bears the simulator's numerics is searched with these taken out.

Cases, chosen before anything was measured: the panel's four examples (2 kHz, an axis of three inertias), one machine of each kind
of `lab.real_use`, and a servo's log of command and angle, 60 s at 50 Hz, which is to be diagnosed within 20 s of wall time.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from lab.panel.case import materialise
from lab.panel.catalogue import select
from lab.real_use.design import BLOCK, draw
from lab.real_use.run import write_files

EXAMPLES = ("example_hidden_flexibility", "example_load_friction", "example_servo_backlash", "example_stiction")
SEED = 43
SHARE = 0.2  # of the rest of a diagnosis that the judge may take
WALL = 20.0  # [s] of the servo's log
SERVO_SECONDS, SERVO_RATE, SERVO_FRICTION, SERVO_NOISE = 60.0, 50.0, 0.08, 5e-4
SERVO = """<mujoco><compiler angle="radian"/><option timestep="0.002"/><worldbody><body name="arm" pos="0 0 1">
  <joint name="hinge" axis="0 1 0" damping="0.02" {friction}/>
  <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02" mass=".3"/><geom type="sphere" pos="0 0 -.5" size=".06" mass=".7"/>
  </body></worldbody><actuator><position name="servo" joint="hinge" kp="20" kv="1.5"/></actuator></mujoco>
"""


@dataclass(frozen=True)
class Files:
    """A case on disk."""

    name: str
    model: Path
    estimation: Path
    held_out: Path


def servo_log(path: Path, seed: int) -> None:
    """Command and angle of a position servo whose joint has dry friction, by MuJoCo."""
    m = mujoco.MjModel.from_xml_string(SERVO.format(friction=f'frictionloss="{SERVO_FRICTION}"'))
    data, rng = mujoco.MjData(m), np.random.default_rng([SEED, seed])
    t = np.arange(round(SERVO_SECONDS * SERVO_RATE)) / SERVO_RATE
    tones, phases = np.linspace(0.1, 2.5, 12), rng.uniform(0, 2 * np.pi, 12)
    command = 0.16 * np.sin(2 * np.pi * np.outer(t, tones) + phases).sum(axis=1) * np.minimum(1.0, t)
    angle = np.empty(len(t))
    for k, u in enumerate(command):
        angle[k], data.ctrl[0] = data.qpos[0], u
        mujoco.mj_step(m, data, round(1.0 / SERVO_RATE / m.opt.timestep))
    table = np.column_stack([t, command, angle + SERVO_NOISE * rng.standard_normal(len(t))])
    np.savetxt(path, table, delimiter=",", header="time_s,command_rad,angle_rad", comments="", fmt="%.9g")


def made(folder: Path) -> list[Files]:
    """The cases, written to a folder."""
    out = []
    for case in select(EXAMPLES):
        files = materialise(case, folder / "panel")
        logs = [files.folder / names[0] for names in (files.content.estimation, files.content.held_out)]
        out.append(Files(case.id, files.folder / files.content.model, logs[0], logs[1]))
    first = {drawn.machine: drawn for drawn in reversed(draw(BLOCK, SEED))}
    for machine, drawn in sorted(first.items()):
        at = folder / machine
        write_files(drawn, at)
        name = f"{machine}, {drawn.loop}, {drawn.rate:g} Hz, {drawn.kind}"
        out.append(Files(name, at / "nominal.xml", at / "estimation.csv", at / "held_out.csv"))
    at = folder / "servo"
    at.mkdir(exist_ok=True)
    files = Files("servo, 60 s at 50 Hz", at / "servo.xml", at / "estimation.csv", at / "held_out.csv")
    files.model.write_text(SERVO.format(friction=""), encoding="utf-8")
    for which, log in enumerate((files.estimation, files.held_out)):
        servo_log(log, which)
    return [*out, files]


def one(arguments: Sequence[str]) -> None:
    """In a process of its own: diagnose, and print what the judge took of the processor."""
    import simgap.pipeline as pipeline
    from diagnose.options import Options

    model, estimation, held_out, out, judged = arguments
    taken = [0.0]

    def timed(function: Any) -> Any:
        def wrapped(*a: Any) -> Any:
            began = time.process_time()
            try:
                return function(*a)
            finally:
                taken[0] += time.process_time() - began

        return wrapped

    if judged == "without":
        pipeline.before_search = lambda *_: None
    pipeline.before_search, pipeline.write_judged = timed(pipeline.before_search), timed(pipeline.write_judged)
    found = pipeline.diagnose_files(
        [Path(estimation)], Path(model), Path(out), [Path(held_out)], Options(), progress=False, accept_log=True
    )
    print(json.dumps({"judge": taken[0], "verdict": found.verdict.value, "found": [f.effect for f in found.findings]}))


def measured(files: Files, out: Path, judged: str) -> dict[str, Any]:
    """Processor and wall seconds of a diagnosis, and what it says."""
    asked = [str(x) for x in (files.model, files.estimation, files.held_out, out)]
    began = time.monotonic()
    process = subprocess.Popen([sys.executable, __file__, "--one", *asked, judged], stdout=subprocess.PIPE)
    assert process.stdout is not None
    said = process.stdout.read()
    process.stdout.close()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{files.name}: the diagnosis ended with {process.returncode}")
    return {"cpu": used.ru_utime + used.ru_stime, "wall": time.monotonic() - began, **json.loads(said)}


def compared(files: Files, folder: Path, repeat: int) -> dict[str, Any]:
    """Medians of a case with and without the judge, in turns."""
    turns = [{j: measured(files, folder / "out", j) for j in ("with", "without")} for _ in range(repeat)]

    def median(judged: str, key: str) -> float:
        return statistics.median(t[judged][key] for t in turns)

    on, off, judge = median("with", "cpu"), median("without", "cpu"), median("with", "judge")
    return {
        "case": files.name, "cpu_with": on, "cpu_without": off, "cpu_ratio": on / off, "wall_with": median("with", "wall"),
        "wall_without": median("without", "wall"), "judge_cpu": judge, "share": judge / (on - judge),
        "verdict": turns[0]["with"]["verdict"], "found": turns[0]["with"]["found"],
        "verdict_without": turns[0]["without"]["verdict"], "found_without": turns[0]["without"]["found"],
    }  # fmt: skip


def line(r: dict[str, Any]) -> str:
    """A line of the table."""
    found = "+".join(r["found"]) or "-"
    return (
        f"{r['case']:34s} cpu {r['cpu_without']:6.1f} -> {r['cpu_with']:6.1f} s ({r['cpu_ratio']:5.2f})  wall "
        f"{r['wall_without']:6.1f} -> {r['wall_with']:6.1f} s  judge {r['judge_cpu']:5.2f} s, {100 * r['share']:4.1f} %  "
        f"{r['verdict']} {found}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the cases, print a line for each, compare with the bars."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--case", action="append", help="only cases whose name begins so; may be repeated")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    results = []
    with tempfile.TemporaryDirectory() as work:
        cases = made(Path(work))
        measured(cases[-1], Path(work) / "out", "with")  # fills the cache of compiled code
        for files in (f for f in cases if f.name.startswith(tuple(options.case or ("",)))):
            results.append(compared(files, Path(work), options.repeat))
            print(line(results[-1]), flush=True)
    judge = sum(r["judge_cpu"] for r in results)
    share = judge / (sum(r["cpu_with"] for r in results) - judge)
    servo = next((r["wall_with"] for r in results if r["case"] == cases[-1].name), 0.0)
    print(f"judge, over all of it: {100 * share:.1f} % of the rest (bar {100 * SHARE:.0f} %)")
    print(f"largest of a case: {100 * max(r['share'] for r in results):.1f} %; servo: {servo:.1f} s (bar {WALL:.0f} s)")
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return int(share > SHARE or servo > WALL)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        one(sys.argv[2:])
    else:
        sys.exit(main())
