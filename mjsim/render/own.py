"""Filming a user's own MJCF: one motion, or a simulation and a recording side by side or as a ghost."""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import mujoco
import numpy as np

from mjsim.errors import InputError
from mjsim.render.context import Offscreen
from mjsim.render.overlay import COLOURS, Trace, captions, strip
from mjsim.render.scene import Scene
from mjsim.render.take import Take
from mjsim.render.writer import need_suffix, save

__all__ = ["Style", "film_takes", "magnified", "moments"]


class Style(enum.Enum):
    """How two motions are shown."""

    GHOST = "ghost"
    SIDE = "side"


def magnified(model: mujoco.MjModel, take: Take, factor: float) -> Take:
    """The take with its motion about the first pose enlarged. Raises InputError for joints that have no scalar position."""
    if factor == 1:
        return take
    if np.any(model.jnt_type < int(mujoco.mjtJoint.mjJNT_SLIDE)):
        raise InputError("--magnify", "the model has a free or ball joint", "hinges and slides only", "leave it out")
    return Take(take.name, take.time, take.qpos[0] + factor * (take.qpos - take.qpos[0]), take.curves)


def moments(
    takes: Sequence[Take], *, fps: float, speed: float, start: float | None, duration: float | None, still: bool
) -> tuple[np.ndarray, float, float]:
    """Times of the frames [s], and first and last time that the traces show. Raises InputError.

    A still shows ``start``, else the moment at which two motions differ most, or one is farthest from its first pose.
    """
    end = min(float(t.time[-1]) for t in takes)
    first = 0.0 if start is None else start
    if not 0 <= first < end:
        raise InputError("--start", f"{first:g} s", f"between 0 and {end:g} s", "start within the motion")
    if not still:
        last = end if duration is None else min(end, first + duration)
        return np.arange(first, last + 1e-9, speed / fps), first, last
    if start is None:
        grid = np.linspace(0.0, end, 500)
        poses = [t.qpos[_at(t, grid)] for t in takes]
        away = poses[1] - poses[0] if len(takes) > 1 else poses[0] - poses[0][0]
        start = float(grid[int(np.argmax(np.linalg.norm(away, axis=1)))])
    return np.array([start]), 0.0, end


def _at(take: Take, time: np.ndarray | float) -> np.ndarray:
    dt = float(take.time[1] - take.time[0])
    frames: np.ndarray = np.minimum(np.round(np.asarray(time) / dt).astype(int), len(take.time) - 1)
    return frames


def film_takes(
    scene: Scene,
    takes: Sequence[Take],
    out: Path,
    style: Style = Style.GHOST,
    *,
    size: tuple[int, int] = (960, 720),
    fps: float = 25.0,
    speed: float = 1.0,
    start: float | None = None,
    duration: float | None = None,
    notes: Sequence[str] = (),
    progress: Callable[[Iterable[int], int], Iterable[int]] | None = None,
) -> Path:
    """Film one or two takes of a scene to ``out`` (.mp4, .gif, .png: one picture).

    Two takes: the second is a translucent ghost in the picture of the first, or stands beside it in a picture of its own.
    ``size``: of each picture with its traces [pixels]; ``fps`` of the film; ``speed``: film time over true time; ``start``,
    ``duration`` [s]: what is shown, see `moments`; ``notes``: lines at the foot of the picture. Raises InputError.
    """
    need_suffix(out)
    still = out.suffix.lower() == ".png"
    times, first, last = moments(takes, fps=fps, speed=speed, start=start, duration=duration, still=still)
    if speed != 1 and not still:
        notes = [*notes, f"time x {speed:g}"]
    frames = _frames(scene, takes, style, times, (first, last), size, notes, progress)
    out.parent.mkdir(parents=True, exist_ok=True)
    save(frames, out, fps)
    return out


def _frames(
    scene: Scene,
    takes: Sequence[Take],
    style: Style,
    times: np.ndarray,
    window: tuple[float, float],
    size: tuple[int, int],
    notes: Sequence[str],
    progress: Callable[[Iterable[int], int], Iterable[int]] | None,
) -> Iterator[np.ndarray]:
    width, height = size[0] - size[0] % 2, size[1] - size[1] % 2
    low = int(0.24 * height) // 2 * 2
    cuts = [slice(int(_at(t, window[0])), int(_at(t, window[1])) + 1) for t in takes]
    traces = _traces(takes, cuts)
    names = [t.name for t in takes]
    side = style is Style.SIDE and len(takes) > 1
    wide = width * (2 if side else 1)
    scene.fit(width / (height - low))
    other = mujoco.MjData(scene.model)
    with ExitStack() as stack:
        screen = stack.enter_context(Offscreen(scene.model, width, height - low, scene.camera, scene.option))
        for f in range(len(times)) if progress is None else progress(range(len(times)), len(times)):
            t = float(times[f])
            at = [int(_at(take, t)) for take in takes]
            clock = f"{t:.2f} s"
            if side:
                pictures = []
                for i, take in enumerate(takes):
                    picture = screen.render(scene.pose(take.qpos[at[i]]))
                    pictures.append(captions(picture, take.name, clock, notes, COLOURS[i]))
                picture = np.hstack(pictures)
            elif len(takes) > 1:
                ghost = scene.pose(takes[1].qpos[at[1]], other)
                picture = screen.render(scene.pose(takes[0].qpos[at[0]]), ghost, COLOURS[1])
                legend = f"solid: {names[0]}, translucent: {names[1]}"
                picture = captions(picture, scene.path.name, clock, [legend, *notes])
            else:
                picture = captions(screen.render(scene.pose(takes[0].qpos[at[0]])), names[0], clock, notes)
            now = [a - cut.start for a, cut in zip(at, cuts, strict=True)]
            foot = [strip(traces, names, wide, low, t, now)] if traces else []
            yield np.ascontiguousarray(np.vstack([picture, *foot]))


def _traces(takes: Sequence[Take], cuts: Sequence[slice]) -> list[Trace]:
    """The curves of the first take, each with the curve of the same name of the second."""
    time = takes[0].time[cuts[0]]
    out = []
    for curve in takes[0].curves:
        lines = []
        for take, cut in zip(takes, cuts, strict=True):
            same = next((c.values for c in take.curves if c.name == curve.name), None)
            lines.append(None if same is None else same[cut])
        out.append(Trace(curve.name, curve.unit, time, tuple(lines)))
    return out
