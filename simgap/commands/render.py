"""``simgap render``: the motion of a scenario or a model as a film or a picture, without a display."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    import numpy as np

    from mjsim.axis import Axis
    from mjsim.render import Shot

__all__ = ["command"]


def _size(text: str) -> tuple[int, int]:
    from mjsim.errors import InputError

    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        width = height = 0
    if not (160 <= width <= 3840 and 120 <= height <= 2160):
        raise InputError("--size", repr(text), "WIDTHxHEIGHT such as 960x720, between 160x120 and 3840x2160")
    return width, height


def _shots(source: str, recording: Path | None, simulation: Path | None) -> list[Shot]:
    """One shot, or two when a recording is given: the model on the recorded torque (or a simulated log) and the recording."""
    from mjsim import ode
    from mjsim.errors import InputError
    from mjsim.quantity import Motion
    from mjsim.recording import load
    from mjsim.render import shot_of_recording, shot_of_run
    from mjsim.scenario import load_scenario, run

    path = Path(source)
    if path.suffix == ".xml":
        from mjsim.mjcf import load_axis

        axis, motion = load_axis(path), None
        if recording is None:
            if simulation is not None:
                raise InputError("--simulation", "no recording to set it against", "--recording LOG", "add it")
            amplitude, torque = _demonstration(axis)
            said = f"simulation, chirp 0.5-15 Hz, {amplitude:.3g} {'Nm' if axis.chain.motion is Motion.HINGE else 'N'}"
            return [shot_of_run(said, axis, ode.simulate(axis, torque, 5e-4))]
    else:
        if recording is not None or simulation is not None:
            raise InputError(source, "--recording and --simulation go with a model", "MODEL.xml", "name the model")
        log = run(load_scenario(source))
        axis, motion = log.axis, log.motion
    if motion is not None:
        return [shot_of_run("simulation", axis, motion)]
    assert recording is not None
    record = load(recording, model=path)
    if simulation is not None:
        first = shot_of_recording("simulation", axis, load(simulation, model=path))
    else:
        start = None
        if record.velocity is not None or record.angle is not None:
            import numpy as np

            ratios = np.array([axis.chain.total_ratio(i) for i in range(len(axis.chain.bodies))])
            q0 = float(record.angle[0]) if record.angle is not None else 0.0
            v0 = float(record.velocity[0]) if record.velocity is not None else 0.0
            start = np.stack([ratios * q0, ratios * v0])
        first = shot_of_run("simulation", axis, ode.simulate(axis, record.torque, record.dt, initial=start))
    return [first, shot_of_recording("recording", axis, record)]


def _demonstration(axis: Axis) -> tuple[float, np.ndarray]:
    """A chirp that moves a model which nothing else moves: about 0.3 rad or 0.2 m at its end, friction overcome twice over."""
    from mjsim.effects import ports
    from mjsim.excitation import chirp
    from mjsim.quantity import Motion
    from mjsim.system import constant

    chain = axis.chain
    inertia = sum(b.inertia * chain.total_ratio(i) ** 2 for i, b in enumerate(chain.bodies))
    damping = sum(b.viscous * chain.total_ratio(i) ** 2 for i, b in enumerate(chain.bodies))
    reach = (0.3 if chain.motion is Motion.HINGE else 0.2) / abs(chain.total_ratio(len(chain.bodies) - 1))
    w = 3.14
    torque = reach * w * (inertia**2 * w**2 + damping**2) ** 0.5
    for effect in axis.effects:
        for port in effect.ports(chain):
            if isinstance(port, ports.Friction):
                level = constant(port.law, port.p, 1.0) or (0.0, 0.0)
                torque += 2.0 * level[1] * abs(chain.total_ratio(port.body))
    amplitude = float(f"{torque / abs(chain.gain):.2g}")
    return amplitude, chirp(8.0, 5e-4, amplitude, 0.5, 15.0)


def _bar(frames: Iterable[int], count: int) -> Iterator[int]:
    with click.progressbar(frames, length=count, label="rendering", file=sys.stderr) as bar:
        yield from bar


@click.command(epilog="Example: simgap render backlash_1e-3 --out gap.mp4 --start 4 --duration 2 --speed 0.2")
@click.argument("source", metavar="SCENARIO_OR_MODEL")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="FILE.mp4, FILE.gif or FILE.png (one picture).")
@click.option("--recording", type=click.Path(path_type=Path), help="With a model: a log; simulation and recording side by side.")
@click.option("--simulation", type=click.Path(path_type=Path), help="A simulated log instead of running the model.")
@click.option("--start", type=float, help="First moment shown [s]; of a png, the moment (largest wind-up when not given).")
@click.option("--duration", type=click.FloatRange(min=0, min_open=True), help="Length of the motion shown [s].")
@click.option("--speed", type=click.FloatRange(min=0, min_open=True), default=1.0, show_default=True, help="0.2 is slow motion.")
@click.option("--fps", type=click.FloatRange(1, 120), default=25.0, show_default=True, help="Pictures a second.")
@click.option("--size", default="960x720", show_default=True, help="Of each scene with its traces [pixels].")
def command(
    source: str,
    out: Path,
    recording: Path | None,
    simulation: Path | None,
    start: float | None,
    duration: float | None,
    speed: float,
    fps: float,
    size: str,
) -> None:
    """Render SCENARIO_OR_MODEL headless; motion is magnified, and the picture says by how much."""
    from mjsim.errors import InputError
    from mjsim.ode import DivergedError
    from mjsim.render import film
    from mjsim.render.film import SUFFIXES

    if out.suffix.lower() not in SUFFIXES:
        raise InputError(out, f"unknown kind of film {out.suffix!r}", ", ".join(SUFFIXES), "choose another name")
    pixels = _size(size)
    try:
        shots = _shots(source, recording, simulation)
    except DivergedError as error:
        raise InputError(source, str(error)) from None
    progress = _bar if sys.stderr.isatty() else None
    film(shots, out, size=pixels, fps=fps, speed=speed, start=start, duration=duration, progress=progress)
    click.echo(str(out))
