"""A picture of an uploaded recording, drawn in one process beside the server that has loaded what drawing needs."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

from simgap.terminal import one_line

if TYPE_CHECKING:
    from multiprocessing.pool import Pool

    from diagnose.report.plots import Chart
    from mjsim.recording import Recording
    from mjsim.robot.recording import RobotRecording

__all__ = ["Previews", "signals_chart"]

PATIENCE = 30.0  # seconds after which a picture is given up
MOST_JOINTS = 8  # of a robot that are drawn
MOST_KEPT = 64  # pictures in memory: some 50 kB each
_CHANNELS = (("torque", "corrected"), ("velocity", "refitted"), ("angle", "nominal"))


class Previews:
    """Pictures by file, drawn once for each state of a file; ``start`` loads the process ahead of the first one."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pool: Pool | None = None
        self._kept: dict[tuple[str, int, int, str], tuple[str, str]] = {}

    def start(self) -> None:
        """Start the process; a second call does nothing."""
        with self._lock:
            if self._pool is None:
                self._pool = multiprocessing.get_context("spawn").Pool(1, _ready)

    def picture(self, folder: Path, file: str, model: str) -> tuple[str, str]:
        """SVG of a recording of a run's folder, or why there is none, in one line. ``model``: whose TOML may name the columns."""
        there = (folder / file).stat()
        key = (str(folder / file), there.st_size, there.st_mtime_ns, model)
        if key not in self._kept:
            self.start()
            assert self._pool is not None
            try:
                found = self._pool.apply_async(_picture, (str(folder), file, model)).get(PATIENCE)
            except multiprocessing.TimeoutError:
                self.close()
                return "", f"no picture: reading it takes longer than {PATIENCE:.0f} s"
            while len(self._kept) >= MOST_KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = found
        return self._kept[key]

    def close(self) -> None:
        """End the process."""
        with self._lock:
            pool, self._pool = self._pool, None
        if pool is not None:
            pool.terminate()
            pool.join()


def _ready() -> None:
    """Load the readers and draw once, so that the first picture takes no longer than the others.

    MuJoCo, which only the joints of a model need, is loaded when a model is chosen.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal it goes to all processes; the server ends this one
    import numpy as np

    from diagnose.report.static import draw
    from mjsim.recording import Recording

    t = np.arange(3.0)
    draw(signals_chart(Recording(t, t, t, t, 1.0, source="")))


def _picture(folder: str, file: str, model: str) -> tuple[str, str]:
    from diagnose.report.static import draw
    from mjsim.errors import InputError
    from mjsim.recording import load as load_axis

    os.chdir(folder)  # so that a refusal names the file as the page does
    try:
        return draw(signals_chart(_of_model(file, model) if model else load_axis(file))), ""
    except InputError as error:
        return "", one_line(str(error))


def _of_model(file: str, model: str) -> Recording | RobotRecording:
    from simgap.api.recording import load

    return load(file, model=model)


def signals_chart(recording: Recording | RobotRecording) -> Chart:
    """Channels of an axis, or position and command of the joints of a robot, over time."""
    from diagnose.report.figures import unit
    from diagnose.report.plots import Axis, Chart, Line, Panel
    from mjsim.recording import Recording

    panels = []
    time = Axis("time", "s")
    if isinstance(recording, Recording):
        for channel, colour in _CHANNELS:
            values = getattr(recording, channel)
            if values is not None:
                line = Line("", recording.time, values, colour, 1.1)
                panels.append(Panel(time, Axis(channel, unit(recording.units.get(channel, ""))), (line,)))
    else:
        for k, name in enumerate(recording.joints[:MOST_JOINTS]):
            lines = [Line("position", recording.time, recording.angle[:, k], "measured", 1.8)]
            if recording.command is not None and recording.has("command", name):
                lines.append(Line("command", recording.time, recording.command[:, k], "corrected", 1.0))
            panels.append(Panel(time, Axis(name), tuple(lines)))
    alt = f"Signals of {recording.source} over time"
    key = f"p{zlib.crc32(recording.source.encode()):08x}"
    return Chart(key, alt, tuple((p,) for p in panels), 60 + 110 * len(panels))
