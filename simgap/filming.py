"""A short film for a report: the model as given, stepped on a recorded input, with the recording as a ghost."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from diagnose.report.charts import explorer_of
from diagnose.report.film import Film, stretch_of
from diagnose.report.plots import Explorer
from diagnose.result import Diagnosis
from diagnose.robot.page import explorer_of as of_joint
from diagnose.robot.result import RobotDiagnosis

__all__ = ["film_of", "film_of_robot"]

SECONDS = 4.0  # of the recording
FPS = 12.5
SIZE = "600x450"
PATIENCE = 120.0  # [s] after which the film is given up: some 3 s of a free core are needed


def film_of(result: Diagnosis, model: Path, files: Sequence[Path]) -> Film | str | None:
    """A film around the largest error of the first held-out recording; in one sentence why there is none.

    None where no recording has been compared. A process of its own draws it: a fault of a graphics library ends only that.
    """
    explorer = explorer_of(result)
    return None if explorer is None else _around_the_error(explorer, model, files, replay=False)


def film_of_robot(result: RobotDiagnosis, model: Path, files: Sequence[Path]) -> Film | str | None:
    """As `film_of`, of a robot: around the largest error of the joint that the model as given predicts worst.

    The simulation is that of ``simgap replay``: all joints together, those that a torque drives held by a tracking loop.
    """
    joints = sorted(result.joints.values(), key=lambda r: -r.fit["nominal"].held_out_nrmse if "nominal" in r.fit else 0.0)
    explorers = (of_joint(r, i) for i, r in enumerate(joints))
    explorer = next((e for e in explorers if e is not None), None)
    return None if explorer is None else _around_the_error(explorer, model, files, replay=True)


def _around_the_error(explorer: Explorer, model: Path, files: Sequence[Path], *, replay: bool) -> Film | str:
    signals, start, seconds = stretch_of(explorer, SECONDS)
    file = next((f for f in files if f.name == signals.source), None)
    if file is None:
        return f"{signals.source} is no file"
    with tempfile.TemporaryDirectory() as folder:
        out, simulation = Path(folder) / "film.mp4", Path(folder) / "simulation.npz"
        render = [
            "render", str(model), "--recording", str(file), "--out", str(out), "--size", SIZE, "--fps", f"{FPS:g}",
            "--start", f"{start - signals.time[0]:.6g}", "--duration", f"{seconds:.6g}",
        ]  # fmt: skip
        calls = [["replay", str(model), str(file), "--out", str(simulation)]] if replay else []
        calls.append([*render, "--simulation", str(simulation)] if replay else render)
        why = next((said for call in calls if (said := _ran(call))), "")
        if why or not out.is_file():
            return why or "rendering failed"
        how = "in MuJoCo, all joints together" if replay else "in MuJoCo"
        about = f"{model.name} as given, {how} (solid), and {signals.source} (translucent)."
        return Film(signals.source, start, seconds, out.read_bytes(), about)


def _ran(words: Sequence[str]) -> str:
    """Run a command of simgap; empty, or why it failed."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    call = [sys.executable, "-m", "simgap", *words]
    try:
        done = subprocess.run(call, capture_output=True, text=True, timeout=PATIENCE, env=environment, check=False)
    except subprocess.TimeoutExpired:
        return f"{words[0]} took longer than {PATIENCE:.0f} s"
    except OSError as error:
        return f"no process could be started ({error.strerror})"
    if done.returncode == 0:
        return ""
    lines = done.stderr.strip().splitlines() or [f"{words[0]} failed"]
    return lines[-1].removeprefix("simgap: ").rstrip(".")
