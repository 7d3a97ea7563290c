"""A picture of an uploaded recording, drawn in one process beside the server that has loaded what drawing needs."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING

from simgap.terminal import one_line

if TYPE_CHECKING:
    from multiprocessing.pool import Pool

    import numpy as np

    from diagnose.report.plots import Chart, Panel
    from mjsim.recording import Recording
    from mjsim.robot.recording import RobotRecording

__all__ = ["Previews", "signals_chart"]

PATIENCE = 30.0  # seconds after which a picture is given up
PAUSE = 0.2  # seconds between two looks at whether the server ends
MOST_JOINTS = 8  # of a robot that are drawn
MOST_KEPT = 64  # pictures in memory: some 50 kB each
_COLOURS = {"torque": "corrected", "velocity": "refitted", "angle": "nominal"}
_OF_SLIDE = {"torque": ("force", "N"), "velocity": ("velocity", "m/s"), "angle": ("position", "m")}
_OF_HINGE = {"torque": ("torque", "N m"), "velocity": ("velocity", "rad/s"), "angle": ("angle", "rad")}


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
                with _interrupts_blocked():
                    self._pool = multiprocessing.get_context("spawn").Pool(1, _ready)

    def picture(self, folder: Path, file: str, model: str) -> tuple[str, str]:
        """SVG of a recording of a run's folder, or why there is none, in one line. ``model``: whose TOML may name the columns."""
        there = (folder / file).stat()
        key = (str(folder / file), there.st_size, there.st_mtime_ns, model)
        if key not in self._kept:
            found = self._drawn(str(folder), file, model)
            if found is None:
                return "", f"no picture: reading it takes longer than {PATIENCE:.0f} s"
            while len(self._kept) >= MOST_KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = found
        return self._kept[key]

    def _drawn(self, *task: str) -> tuple[str, str] | None:
        """What the process answers; None where it is given up, because it takes too long or the server ends."""
        self.start()
        pool = self._pool
        if pool is None:
            return None
        answer, end = pool.apply_async(_picture, task), time.monotonic() + PATIENCE
        while not answer.ready() and self._pool is pool and time.monotonic() < end:
            answer.wait(PAUSE)
        if answer.ready():
            return answer.get()
        if self._pool is pool:
            self.close()
        return None

    def close(self) -> None:
        """End the process."""
        with self._lock:
            pool, self._pool = self._pool, None
        if pool is not None:
            pool.terminate()
            pool.join()


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT in this thread and in the processes and threads that it starts; without effect on Windows.

    A new process has the signal mask of the thread that starts it, and handles no signal before `_ready` is called.
    """
    if sys.platform == "win32":
        yield
        return
    resource_tracker.ensure_running()  # unblocks the signal in this thread when it starts its own process
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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

    os.chdir(folder)  # so that a refusal names the file as the page does
    try:
        return draw(_of_model(file, model) if model else _of_file(Path(file))), ""
    except InputError as error:
        return "", one_line(str(error))


def _of_model(file: str, model: str) -> Chart:
    from mjsim.quantity import Quantity
    from mjsim.recording import Recording
    from simgap.api.model import Model
    from simgap.api.recording import load

    recording = load(file, model=model)
    if isinstance(recording, Recording):
        return signals_chart(recording)
    robot = Model(model).robot
    units = {joint: Quantity.ANGLE.unit(motion) for joint, motion in zip(robot.joints, robot.motions, strict=True)}
    return robot_chart(recording, units)


def _of_file(path: Path) -> Chart:
    """Without a model: the joints that the columns of a log name, or the channels of an axis."""
    from mjsim.binding import joint_channels, joints_in
    from mjsim.readers import read_table
    from mjsim.recording import load as load_axis

    table = read_table(path)
    joints = []
    for name in joints_in(table):
        columns = {role: channel.column for role, channel in joint_channels(table, name).items()}
        if "angle" in columns:
            unit = "m" if columns["angle"].endswith("_m") else "" if table.by_joint else "rad"
            joints.append((name, unit, table[columns["angle"]], table[columns["command"]] if "command" in columns else None))
    if len(joints) < 2 or "time_s" not in table:
        return signals_chart(load_axis(path))
    return _joints_chart(str(path), table["time_s"], joints)


def signals_chart(recording: Recording) -> Chart:
    """Channels of an axis over time."""
    from diagnose.report.figures import unit
    from diagnose.report.plots import Axis, Line, Panel

    panels, units = [], recording.units
    slide = units.get("angle") == "m" or units.get("velocity") == "m/s"
    for channel, (name, known) in (_OF_SLIDE if slide else _OF_HINGE).items():
        values = getattr(recording, channel)
        if values is not None:
            line = Line("", recording.time, values, _COLOURS[channel], 1.1)
            in_si = (
                known if units.get("angle") or units.get("velocity") else ""
            )  # a torque by a gain has the SI unit of its motion
            panels.append(Panel(Axis("time", "s"), Axis(name, unit(units.get(channel) or in_si)), (line,)))
    return _chart(recording.source, panels)


def robot_chart(recording: RobotRecording, units: Mapping[str, str]) -> Chart:
    """Position and command of the joints of a robot over time; ``units``: of the positions, by joint."""
    joints = []
    for k, name in enumerate(recording.joints):
        command = recording.command[:, k] if recording.command is not None and recording.has("command", name) else None
        joints.append((name, units.get(name, ""), recording.angle[:, k], command))
    return _joints_chart(recording.source, recording.time, joints)


def _joints_chart(source: str, time: np.ndarray, joints: Sequence[tuple[str, str, np.ndarray, np.ndarray | None]]) -> Chart:
    """A panel a joint: name, unit, position and command."""
    from diagnose.report.plots import Axis, Line, Panel

    panels = []
    for name, unit, angle, command in joints[:MOST_JOINTS]:
        lines = [Line("position", time, angle, "measured", 1.8)]
        if command is not None:
            lines.append(Line("command", time, command, "corrected", 1.0))
        panels.append(Panel(Axis("time", "s"), Axis(name, unit), tuple(lines)))
    return _chart(source, panels)


def _chart(source: str, panels: Sequence[Panel]) -> Chart:
    from diagnose.report.plots import Chart

    key = f"p{zlib.crc32(source.encode()):08x}"
    return Chart(key, f"Signals of {source} over time", tuple((p,) for p in panels), 60 + 110 * len(panels))
