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
from diagnose.result import Diagnosis

__all__ = ["film_of"]

SECONDS = 4.0  # of the recording
FPS = 12.5
SIZE = "600x450"
PATIENCE = 120.0  # [s] after which the film is given up: some 3 s of a free core are needed


def film_of(result: Diagnosis, model: Path, files: Sequence[Path]) -> Film | str | None:
    """A film around the largest error of the first held-out recording; in one sentence why there is none.

    None where no recording has been compared. A process of its own draws it: a fault of a graphics library ends only that.
    """
    explorer = explorer_of(result)
    if explorer is None:
        return None
    signals, start, seconds = stretch_of(explorer, SECONDS)
    file = next((f for f in files if f.name == signals.source), None)
    if file is None:
        return f"{signals.source} is no file"
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "film.mp4"
        call = [
            sys.executable, "-m", "simgap", "render", str(model), "--recording", str(file), "--out", str(out), "--size", SIZE,
            "--fps", f"{FPS:g}", "--start", f"{start - signals.time[0]:.6g}", "--duration", f"{seconds:.6g}",
        ]  # fmt: skip
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        try:
            done = subprocess.run(call, capture_output=True, text=True, timeout=PATIENCE, env=environment, check=False)
        except subprocess.TimeoutExpired:
            return f"rendering took longer than {PATIENCE:.0f} s"
        except OSError as error:
            return f"no process could be started ({error.strerror})"
        if done.returncode or not out.is_file():
            lines = done.stderr.strip().splitlines() or ["rendering failed"]
            return lines[-1].removeprefix("simgap: ").rstrip(".")
        about = f"{model.name} as given, in MuJoCo (solid), and {signals.source} (translucent)."
        return Film(signals.source, start, seconds, out.read_bytes(), about)
