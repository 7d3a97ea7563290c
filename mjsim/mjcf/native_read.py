"""MJCF elements -> native values: what a file says of friction, gaps, weights, limits, delays and passive motors."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from mjsim.effects import native as N  # noqa: N812
from mjsim.errors import InputError
from mjsim.mjcf.chain import Found
from mjsim.mjcf.drive_laws import Form, range_of
from mjsim.mjcf.layout import outside
from mjsim.quantity import Motion
from mjsim.servo import Servo, Target

__all__ = ["Motor", "drive_motor", "passive_motors", "read_native", "weight_under"]

_TOL = 1e-9


def read_native(found: Found, path: Path, data: mujoco.MjData | None = None) -> tuple[N.Value, ...]:
    """The values that a file holds beside its linear chain, in the units of the chain; raises InputError for what is none.

    data: of the model, to work with.
    """
    return (
        *_on_bodies(found),
        *_on_couplings(found),
        *_on_drive(found, path),
        *_on_sensors(found, path),
        *_on_passive_motors(found, path),
        *_gravity(found, path, data),
    )


def _on_bodies(found: Found) -> Iterator[N.Value]:
    for i, parts in enumerate(found.on_body):
        level = sum(abs(p.scale) * p.element.friction for p in parts)
        if level:
            yield N.DryFriction(i, level)
        drag = sum(p.element.damping[1] * abs(p.scale) ** 3 for p in parts)
        if drag:
            yield N.SquareDrag(i, drag)
        pull = sum(p.scale**2 * p.element.stiffness[0] for p in parts)
        if pull:
            yield N.GroundSpring(i, pull, sum(p.scale * p.element.stiffness[0] * p.element.rest for p in parts) / pull)


def _on_couplings(found: Found) -> Iterator[N.Value]:
    for j, gaps in enumerate(found.gaps):
        width = sum(w for _, _, w in gaps)
        if width:
            yield N.Slack(j, width)
        cubic = sum(p.element.stiffness[2] * p.scale**4 for p in found.on_coupling[j])
        if cubic:
            yield N.CubicSpring(j, cubic)


def _on_drive(found: Found, path: Path) -> Iterator[N.Value]:
    model, drive = found.layout.model, found.layout.drive
    a = drive.id
    if a < 0:
        return
    limit = _limit(found, path)
    if limit is not None:
        yield N.DriveLimit(limit)
    if model.actuator_delay[a] > 0:
        yield N.DriveDelay(float(model.actuator_delay[a]))
    dyntype = mujoco.mjtDyn(int(model.actuator_dyntype[a]))
    if dyntype in (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT):
        yield N.DriveLag(float(model.actuator_dynprm[a, 0]))
    elif dyntype != mujoco.mjtDyn.mjDYN_NONE and drive.law.form is Form.GENERAL and not _integrates(drive.servo):
        raise outside(path, f"actuator {drive.name!r} has dynamics other than a first-order filter", 'use dyntype="filter"')
    if math.isfinite(drive.law.slew):
        yield N.CommandSlew(drive.law.slew)
    if drive.law.integral:
        yield N.ServoIntegral(drive.law.integral, drive.law.constant)
    if math.isfinite(drive.law.stall):
        yield N.SpeedLine(drive.law.stall, drive.law.no_load)
    motor = drive_motor(found)
    if motor is not None and not motor.whole:
        raise outside(
            path, f"actuator {drive.name!r} has cogging or a bristle that is not of its own joint in whole periods per turn",
            "leave cogging and lugre out",
        )  # fmt: skip
    yield from () if motor is None else motor.values


def _integrates(servo: Servo | None) -> bool:
    return servo is not None and servo.target is Target.INTEGRATED


def _limit(found: Found, path: Path) -> float | None:
    """Smallest symmetric limit of the input [unit of the input]."""
    model, drive = found.layout.model, found.layout.drive
    a = drive.id
    if drive.servo is not None:  # its limits are part of its law
        return None
    ranges = []
    if math.isfinite(range_of(model, a)[0]):
        ranges.append(("ctrlrange", range_of(model, a), 1.0))
    if model.actuator_forcelimited[a]:
        ranges.append(("forcerange", model.actuator_forcerange[a], abs(drive.gain)))
    for name, (low, high), _ in ranges:
        if abs(low + high) > 1e-9 * abs(high - low):
            raise outside(path, f"{name} of actuator {drive.name!r} is {low:g} .. {high:g}", "a range symmetric about zero")
    return min((float(r[1]) / scale for _, r, scale in ranges), default=None)


def _on_sensors(found: Found, path: Path) -> Iterator[N.Value]:
    """The delay of the bound sensors, one for both."""
    model, bound = found.layout.model, (found.chain.velocity_sensor, found.chain.angle_sensor)
    delays = {float(model.sensor_delay[s]) for s in range(model.nsensor) if model.sensor(s).name in bound}
    if len(delays) > 1:
        raise outside(path, f"sensors {' and '.join(map(repr, bound))} have different delays", "give them one delay")
    yield from (N.SensorDelay(delay) for delay in delays if delay > 0)


@dataclass(frozen=True)
class Motor:
    """A <dcmotor> with cogging or a bristle: its name, the values that it stands for and its travel over that of their place.

    ``whole``: whether values stand for all of it.
    """

    name: str
    values: tuple[N.Value, ...]
    scale: float
    whole: bool


def passive_motors(found: Found) -> list[Motor]:
    """Actuators without input. A <dcmotor> with cogging or a bristle and no electric part has values; others have none."""
    model = found.layout.model
    return [_motor(found, a) for a in range(model.nactuator) if model.actuator_ctrlnum[a] == 0]


def drive_motor(found: Found) -> Motor | None:
    """The cogging and bristle of the drive, None where it is no <dcmotor>."""
    drive = found.layout.drive
    return _parts(found, drive.id) if drive.law.form is Form.DCMOTOR else None


def _on_passive_motors(found: Found, path: Path) -> Iterator[N.Value]:
    for motor in passive_motors(found):
        if not motor.values:
            raise outside(path, f"actuator {motor.name!r} acts by itself", "remove it")
        yield from motor.values


def _motor(found: Found, a: int) -> Motor:
    model = found.layout.model
    gain, bias, dynamics = model.actuator_gainprm[a], model.actuator_biasprm[a], model.actuator_dynprm[a]
    electric = np.any(gain[1:]) or np.any(bias[6:]) or np.any(dynamics[:5]) or np.any(dynamics[7:])
    if int(model.actuator_biastype[a]) != mujoco.mjtBias.mjBIAS_DCMOTOR or electric:
        return Motor(str(model.actuator(a).name), (), 1.0, False)
    return _parts(found, a)


def _parts(found: Found, a: int) -> Motor:
    """Cogging and bristle of a <dcmotor>."""
    model, share = found.layout.model, _share(found, a)
    where = np.flatnonzero(share)
    name = str(model.actuator(a).name)
    if not len(where):
        return Motor(name, (), 1.0, False)
    bias, dynamics = model.actuator_biasprm[a], model.actuator_dynprm[a]
    parts = [*_cogging(share, bias), *_bristle(found, share, bias, dynamics)]
    whole = None not in parts
    return Motor(name, tuple(p for p in parts if p is not None) if whole else (), float(share[where[-1]]), whole)


def _cogging(share: np.ndarray, bias: np.ndarray) -> Iterator[N.Value | None]:
    """Cogging, None when it is not on the driven body's own angle in whole periods."""
    amplitude, cycles, phase = map(float, bias[:3])
    if amplitude:
        s = float(share[0])
        turns = abs(s) * cycles
        own = not np.any(share[1:]) and abs(turns - round(turns)) < _TOL * max(1.0, turns)
        yield N.Cogging(abs(s) * amplitude, round(turns), math.copysign(1.0, s) * phase) if own else None


def _bristle(found: Found, share: np.ndarray, bias: np.ndarray, dynamics: np.ndarray) -> Iterator[N.Value | None]:
    """A bristle on a body or across a coupling, None when it is neither."""
    where = [int(i) for i in np.flatnonzero(share)]
    level, rest, speed = map(float, bias[3:6])
    stiffness, damping = map(float, dynamics[5:7])
    s = abs(float(share[where[-1]]))
    if not stiffness:
        return
    if len(where) == 1:
        yield N.BodyBristle(where[0], level * s, stiffness * s * s, damping * s * s, (rest - level) * s, speed / s)
    elif len(where) == 2 and where[1] == where[0] + 1 and rest == level and not damping:
        across = np.isclose(share[where[0]], -share[where[1]] * found.chain.couplings[where[0]].ratio, rtol=1e-7)
        yield N.CouplingBristle(where[0], level * s, stiffness * s * s) if across else None
    else:
        yield None


def _share(found: Found, a: int) -> np.ndarray:
    """Transmission of an actuator (n,) over the coordinates of the bodies, zeros when it is not constant."""
    model = found.layout.model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    moment = np.zeros((model.nactuator, model.nv))
    mujoco.mju_sparse2dense(moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    share = moment[a] @ found.base()
    share[np.abs(share) < 1e-10 * np.max(np.abs(share), initial=0.0)] = 0.0
    return np.asarray(share)


def _gravity(found: Found, path: Path, data: mujoco.MjData | None = None) -> Iterator[N.Value]:
    """Constant torque at the motor and the weight on the last body, of the actuator's bias and gravity less its compensation."""
    model, drive, n = found.layout.model, found.layout.drive, len(found.chain.bodies)
    bias = 0.0
    if drive.id >= 0 and drive.servo is None:
        bias = drive.law.constant * found.chain.gain / drive.gain
    data = mujoco.MjData(model) if data is None else data
    mujoco.mj_resetData(model, data)
    to_q = found.base()
    samples = 16
    force = np.zeros((samples, n))
    angle = 2 * math.pi * np.arange(samples) / samples
    rigid = np.array([found.chain.total_ratio(i) for i in range(n)]) / found.chain.total_ratio(n - 1)
    for k in range(samples):
        data.qpos[:] = model.qpos0 + to_q @ rigid * angle[k]
        mujoco.mj_forward(model, data)
        force[k] = to_q.T @ (data.qfrc_gravcomp - data.qfrc_bias)
    mean = force.mean(axis=0)
    small = 1e-9 * max(1.0, float(np.sum(model.body_mass)) * float(np.linalg.norm(model.opt.gravity)))
    sine, cosine = 2 * np.sin(angle) @ force / samples, 2 * np.cos(angle) @ force / samples
    rest = force - mean - np.outer(np.sin(angle), sine) - np.outer(np.cos(angle), cosine)
    if np.max(np.abs(rest)) > small * 1e3 or np.any(np.hypot(sine, cosine)[:-1] > small) or np.any(np.abs(mean[1:]) > small):
        raise outside(path, "gravity loads more than the last body of the chain", "balance it, or switch gravity off")
    offset = bias + (float(mean[0]) if abs(mean[0]) > small else 0.0)
    if offset:
        yield N.DriveTorque(offset)
    # force = -T sin(angle + phase) = -T cos(phase) sin(angle) - T sin(phase) cos(angle)
    weight = float(np.hypot(sine[-1], cosine[-1]))
    if weight > small:
        if found.chain.motion is not Motion.HINGE:
            raise outside(path, "gravity varies along a slide", "keep the slide straight")
        across, along = (0.0 - float(x) if abs(x) > 1e-9 * weight else 0.0 for x in (cosine[-1], sine[-1]))  # else rounding
        yield N.Weight(n - 1, weight, math.atan2(across, along))


def weight_under(found: Found, path: Path, gravity: tuple[float, float, float]) -> N.Weight | None:
    """The weight on the last body under another gravity (3,) [m/s^2]; None where there is none, or others are loaded too."""
    model = copy.copy(found.layout.model)
    model.opt.gravity[:] = gravity
    try:
        values = list(_gravity(dataclasses.replace(found, layout=dataclasses.replace(found.layout, model=model)), path))
    except InputError:
        return None
    weights = [v for v in values if isinstance(v, N.Weight)]
    return weights[0] if weights else None
