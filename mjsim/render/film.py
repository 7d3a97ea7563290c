"""Filming an axis: one or two shots side by side, frame by frame, to mp4, gif or png; nothing half-made under the final name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mjsim.axis import Axis, Chain
from mjsim.errors import InputError
from mjsim.ode import Trajectory
from mjsim.quantity import Motion
from mjsim.recording import Recording
from mjsim.render.context import Offscreen
from mjsim.render.overlay import COLOURS, Trace, captions, strip
from mjsim.render.stage import Magnification, Stage, deflections, magnify
from mjsim.render.writer import need_suffix, save
from mjsim.system import assemble

__all__ = ["Shot", "film", "shot_of_recording", "shot_of_run"]


@dataclass(frozen=True)
class Shot:
    """A motion to show: angles q (N, n) of the drawn chain, and the signals of the overlay, None where they were not measured.

    ``whole``: all bodies are known; otherwise only body 0 was measured and what follows it is drawn faint, as if rigid.
    """

    name: str
    chain: Chain
    half_gaps: np.ndarray
    time: np.ndarray
    q: np.ndarray
    torque: np.ndarray
    velocity: np.ndarray | None
    gear_torque: np.ndarray | None
    whole: bool = True


def shot_of_run(name: str, axis: Axis, run: Trajectory) -> Shot:
    """A simulated motion; a further flexible mode that an effect brings is drawn as part of the body it hangs on."""
    s = assemble(axis)
    n = len(axis.chain.bodies)
    gear = run.coupling_torque[:, 0] if n > 1 else None
    return Shot(name, axis.chain, s.f[5, : n - 1].copy(), run.time, run.q[:, :n], run.torque, run.velocity, gear)


def shot_of_recording(name: str, axis: Axis, record: Recording) -> Shot:
    """A recorded motion: body 0 is measured (its velocity integrated where no angle was); the rest follows it as if rigid."""
    chain = axis.chain
    if record.angle is not None:
        angle = record.angle
    elif record.velocity is not None:
        v = record.velocity
        angle = np.concatenate([[0.0], np.cumsum(0.5 * record.dt * (v[1:] + v[:-1]))])
    else:
        raise InputError(record.source, "neither velocity nor angle", "one of them", "bind a column")
    q = np.stack([chain.total_ratio(i) * angle for i in range(len(chain.bodies))], axis=1)
    gaps = np.zeros(len(chain.couplings))
    return Shot(name, chain, gaps, record.time - record.time[0], q, record.torque, record.velocity, None, len(chain.bodies) == 1)


def film(
    shots: list[Shot],
    out: str | Path,
    *,
    size: tuple[int, int] = (960, 720),
    fps: float = 25.0,
    speed: float = 1.0,
    start: float | None = None,
    duration: float | None = None,
    progress: Callable[[Iterable[int], int], Iterable[int]] | None = None,
) -> Path:
    """Film one shot, or two side by side, to ``out`` (.mp4, .gif, .png: one picture).

    ``size``: of each scene with its overlay [pixels]; ``fps`` of the film; ``speed``: film time over true time (0.2 is slow
    motion); ``start``, ``duration`` [s] of the motion shown, all of it when None; a png
    shows the moment ``start``, or that of the largest wind-up. ``progress`` wraps the loop over frames. Raises InputError.
    """
    path = Path(out)
    need_suffix(path)
    if not 1 <= len(shots) <= 2:
        raise ValueError("one shot, or two side by side")
    end = min(float(s.time[-1]) for s in shots)
    first = 0.0 if start is None else start
    if not 0 <= first < end:
        raise InputError("--start", f"{first:g} s", f"between 0 and {end:g} s", "start within the motion")
    last = end if duration is None else min(end, first + duration)
    still = path.suffix.lower() == ".png"
    times = np.arange(first, last + 1e-9, speed / fps)
    if still:
        times = np.array([start if start is not None else _most_bent(shots[0])])
        first, last = 0.0, end
    kept = [_window(s, first, last) for s in shots]
    frames = _frames(kept, times, size, speed, fps, first, progress)
    path.parent.mkdir(parents=True, exist_ok=True)
    save(frames, path, fps)
    return path


def _most_bent(shot: Shot) -> float:
    d = deflections(shot.chain, shot.q)
    at = np.max(np.abs(d), axis=1) if d.shape[1] else np.abs(shot.q[:, 0])
    return float(shot.time[int(np.argmax(at))])


def _window(shot: Shot, first: float, last: float) -> tuple[Shot, slice]:
    dt = float(shot.time[1] - shot.time[0])
    return shot, slice(round(first / dt), round(last / dt) + 1)


def _frames(
    kept: list[tuple[Shot, slice]],
    times: np.ndarray,
    size: tuple[int, int],
    speed: float,
    fps: float,
    first: float,
    progress: Callable[[Iterable[int], int], Iterable[int]] | None,
) -> Iterator[np.ndarray]:
    width, height = size[0] - size[0] % 2, size[1] - size[1] % 2
    low = int(0.24 * height) // 2 * 2
    lead = kept[0][0]
    dts = [float(s.time[1] - s.time[0]) for s, _ in kept]
    by = magnify(lead.chain, lead.q[kept[0][1]], 2 * lead.half_gaps, max(1, round(speed / fps / dts[0])))
    hinge = lead.chain.motion is Motion.HINGE
    units = ("Nm", "rad/s") if hinge else ("N", "m/s")
    window = lead.time[kept[0][1]]
    traces = [
        Trace("motor torque" if hinge else "force", units[0], window, tuple(s.torque[c] for s, c in kept)),
        Trace("motor velocity" if hinge else "velocity", units[1], window,
              tuple(None if s.velocity is None else s.velocity[c] for s, c in kept)),
    ]  # fmt: skip
    if len(lead.chain.bodies) > 1:
        traces.append(Trace("torque in the gear" if hinge else "force in the coupling", units[0], window,
                            tuple(None if s.gear_torque is None else s.gear_torque[c] for s, c in kept)))  # fmt: skip
    with ExitStack() as stack:
        drawn = []
        for shot, cut in kept:
            stage = Stage(shot.chain, shot.half_gaps, by, faint=not shot.whole)
            stage.frame(width / (height - low))
            screen = stack.enter_context(Offscreen(stage.model, width, height - low))
            drawn.append((shot, cut, stage, screen))
        for f in range(len(times)) if progress is None else progress(range(len(times)), len(times)):
            t = float(times[f])
            at = [min(round(t / dt), len(s.time) - 1) for (s, _), dt in zip(kept, dts, strict=True)]
            scenes = []
            for i, (shot, cut, stage, screen) in enumerate(drawn):
                scene = screen.render(stage.pose(shot.q[at[i]], float(shot.q[cut.start, 0])))
                colour = COLOURS[i] if len(drawn) > 1 else None
                scenes.append(captions(scene, shot.name, f"{t:.3f} s", _said(shot, by, speed), colour))
            now = [a - cut.start for a, (_, cut) in zip(at, kept, strict=True)]
            foot = strip(traces, [s.name for s, _ in kept], width * len(kept), low, t, now)
            yield np.ascontiguousarray(np.vstack([np.hstack(scenes), foot]))


def _said(shot: Shot, by: Magnification, speed: float) -> list[str]:
    """The lines under a scene: what is magnified, and what the marks mean."""
    lines = [f"shown: {by.said}" + (f", time x {speed:g}" if speed != 1 else "")]
    if not shot.whole:
        lines.append("faint: not measured, drawn as if it followed the motor rigidly")
    elif len(shot.chain.bodies) > 1:
        gap = " green while it floats in the gap," if np.any(shot.half_gaps > 0) else ""
        needle = "; needle: the gear without wind-up" if shot.chain.motion is Motion.HINGE else ""
        lines.append(f"lug:{gap} red while it drives the blue jaws{needle}")
    return lines
