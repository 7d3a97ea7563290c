"""Typical sizes at each place of an axis, from a nominal run on the recordings: the starts of every fit are multiples of them."""

from __future__ import annotations

import numpy as np

from diagnose.check.stops import stops_of
from diagnose.data.experiment import Experiment, measured_angle, measured_velocity, smooth_velocity
from diagnose.data.runs import free_run
from diagnose.thresholds import LINE, TURNS
from mjsim.axis import Axis, Chain
from mjsim.effects import Scales
from mjsim.ode import DivergedError, Trajectory
from mjsim.quantity import Motion
from mjsim.recording import Recording
from mjsim.servo import Target
from mjsim.signals import plain_step, whole_step
from mjsim.system import assemble

__all__ = ["PLACES", "reversals", "scales_by_place", "value_steps"]


PLACES = ("motor", "gearbox", "arm", "actuator", "sensor")


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def reversals(v: np.ndarray, slow: float = 0.2) -> int:
    """How often a velocity (N,) changes its sign, from faster than ``slow`` times its rms to as fast the other way."""
    signs = np.sign(v[np.abs(v) > slow * _rms(v)])
    return int(np.sum(signs[1:] != signs[:-1]))


def _drive(axis: Axis, r: Recording, run: Trajectory | None) -> np.ndarray:
    """Torque (N,) of the drive on body 0: the recorded one, or that of the nominal servo in its own run, without its limits.

    Where the drive is off: what accelerates the inertia of the chain.
    """
    chain = axis.chain
    if not r.driven:
        inertia = sum(b.inertia * chain.total_ratio(i) ** 2 for i, b in enumerate(chain.bodies))
        return np.asarray(inertia * np.gradient(smooth_velocity(r) if run is None else run.v[:, 0], r.dt))
    if chain.servo is None:
        return chain.gain * r.torque
    if run is None:
        return np.asarray(chain.bodies[0].inertia * np.gradient(smooth_velocity(r), r.dt))
    s = assemble(axis)
    return np.asarray(
        s.gain * (chain.servo.scale * r.input - chain.servo.zero) - s.servo[0] * run.q[:, 0] - s.servo[1] * run.v[:, 0]
    )


def _following(chain: Chain, r: Recording, q: np.ndarray) -> float:
    """Rms error of a position servo, of its actuator [rad | m], along the angle q (N,) of body 0; 0 where there is none."""
    if r.command is None or chain.servo is None or chain.servo.target is not Target.POSITION:
        return 0.0
    return _rms(chain.servo.scale * r.command - chain.servo.zero - chain.gain * q)


def value_steps(values: np.ndarray, noise: float) -> tuple[float, ...]:
    """Steps in which values (N,) may come: the one whose line is strongest and what it may be an overtone of; () for no line.

    Where the rounding came last, all values lie on a grid, whose step is then the only one. Else:
    The characteristic function |mean exp(2 pi i f v)| of rounded values has a line at f = 1/step, lower by exp(-2 pi^2 (s f)^2)
    where noise of rms s came after the rounding. Steps from the noise up to an eighth of the range are looked at; coarser
    ones show as values that stand still. Source: B. Widrow, I. Kollar, Quantization Noise (2008), ch. 4.
    """
    low, span = float(np.min(values)), float(np.ptp(values))
    plain = plain_step(values)
    if plain > 0:
        return (plain,)
    finest = max(noise, span / 4000)
    grid = whole_step(np.diff(np.unique(values)))
    if grid >= finest:
        return (grid,)
    if span < 16 * finest:
        return ()
    width = finest / 8
    counts = np.bincount(((values - low) / width).astype(int))
    length = 1 << int(np.ceil(np.log2(4 * len(counts))))
    power = np.abs(np.fft.rfft(counts, length)) ** 2 / len(values)  # 1 in the mean for values of no step
    frequency = np.arange(len(power)) / (length * width)
    looked = (frequency >= 8 / span) & (frequency <= 1 / finest)
    power = np.where(looked, power, 0.0)
    # the values' own distribution is smooth: its power falls with the frequency, and a line stands out of its neighbours
    around = 64
    level = np.convolve(power, np.ones(2 * around + 1), "same") - np.convolve(power, np.ones(17), "same")
    line = power / np.maximum(level / (2 * around - 16), 1.0)
    # values rounded after the noise have overtones as strong as the fundamental: the lowest of the strong lines
    strong = np.flatnonzero(line >= max(LINE, 0.3 * float(np.max(line))))
    if len(strong) == 0:
        return ()
    near = slice(strong[0], strong[0] + 8)
    step = 1.0 / float(frequency[near][np.argmax(line[near])])
    # and it may be an overtone still
    return tuple(k * step for k in (1, 2, 3, 4) if k * step <= span / 8)


def scales_by_place(
    axis: Axis, experiment: Experiment, orders: tuple[float, ...] = (), swung: tuple[float, ...] = (), *, turning: bool = True
) -> dict[str, Scales]:
    """Scales at every place; with ``turning``, whole orders of the motor's turn as well as those found.

    ``orders``, ``swung``: over the motor's angle, of torques and of a varying inertia.

    Where the nominal free run diverges, rigid-body estimates stand in for it.
    """
    r = experiment.recording
    chain = axis.chain
    v = smooth_velocity(r)
    q = measured_angle(r)
    n = len(chain.bodies)
    drive = np.zeros(len(v))
    try:
        y = free_run(axis, experiment)
        drive = _drive(axis, r, y)
        torque, deflect = y.coupling_torque, [c.ratio * y.q[:, j] - y.q[:, j + 1] for j, c in enumerate(chain.couplings)]
    except DivergedError:
        drive = _drive(axis, r, None)
        accel = np.gradient(v, r.dt)
        torque = np.empty((len(v), n - 1))
        deflect = []
        for j, c in enumerate(chain.couplings):
            behind = sum(b.inertia * chain.total_ratio(i) for i, b in enumerate(chain.bodies) if i > j)
            torque[:, j] = behind * accel
            deflect.append(torque[:, j] / c.stiffness)
    out = {}
    force = np.abs(drive / chain.gain)
    asked = (float(np.max(force)), *(float(x) for x in np.quantile(force, (0.9, 0.7)))) if np.any(force) else ()
    steps = value_steps(measured_velocity(r), experiment.sigma)
    turning = turning and chain.motion is Motion.HINGE and len(orders) > 0
    stops = stops_of(q, v, r.dt)
    fastest = float(np.max(np.abs(np.gradient(v, r.dt))))
    turns = tuple(n for n in TURNS if turning and n * float(np.ptp(q)) > np.pi)  # half a period
    for place in PLACES:
        found = chain.body(place)
        at: int = found if found is not None else 0
        joint = chain.coupling(place)
        load = torque[:, joint] if joint is not None else drive
        if joint is None and n > 1 and place == "arm":
            load = torque[:, -1]
        ratio = chain.total_ratio(at)
        out[place] = Scales(
            torque=_rms(load), max_torque=float(np.max(np.abs(load))), velocity=ratio * _rms(v),
            max_velocity=ratio * float(np.max(np.abs(v))), deflection=_rms(deflect[joint]) if joint is not None else 1.0,
            inertia=chain.bodies[at].inertia, stiffness=chain.couplings[joint].stiffness if joint is not None else 1.0,
            travel=ratio * float(np.ptp(q)), input=_rms(r.input), max_input=float(np.max(np.abs(r.input))), output=_rms(v),
            dt=r.dt, duration=r.duration, orders=tuple(o / ratio for o in orders) if at else orders,
            swung=tuple(o / ratio for o in swung), turns=turns, steps=steps,
            following=_following(chain, r, q), asked=asked,
            move=r.duration / (1 + reversals(v)), stops=stops if at == 0 else (),
            hold_stated=r.hold_stated, acceleration=ratio * fastest,
        )  # fmt: skip
    return out
