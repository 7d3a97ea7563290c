"""Recordings of a servo robot as each joint's own problem: series of what it carries, command, position, and which samples
count."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from diagnose.robot.motion import BLOCKS, EVERY
from diagnose.robot.servos.bodies import GRAVITY, body_numbers, changes, gravcomp_of
from diagnose.robot.servos.positions import moves, resolution, smoothed
from mjsim.errors import InputError
from mjsim.hold import between, delayed
from mjsim.quantity import Motion as Kind
from mjsim.robot.along import Along, along
from mjsim.robot.drives import JointDrive, joint_drives, need_command
from mjsim.robot.inertia import moved, point_mass
from mjsim.robot.joint_kernel import SLOT, run_joint
from mjsim.robot.model import Robot
from mjsim.robot.recording import RobotRecording
from mjsim.robot.shares import SERIES, compensation, shares
from mjsim.robot.softness import friction_softness
from mjsim.robot.touching import Touching, touching
from mjsim.trapezoid import profiled

__all__ = ["OWN", "JointProblem", "Motion", "joint_problem", "moving", "prepare"]

COLUMN = {"inertia": 0, "bias": 1, "by_position": 2, "torque": 4}  # of a series, see `run_joint`
DIVERGED = 1e3  # times the travel: the largest error of a run, whose square stays a number
OWN = 10  # columns of a series that are of the joint itself; three of each joint follow
STEP = 5e-3  # [s]: longest step of the kernel, a twentieth of the period of a servo of 10 Hz
FEWEST_STEPS = 4  # per sample, of the kernel
EDGE = 0.1  # [s]: what the low-pass reaches, before a contact or the end of a series that is moved in time; not counted
RESTS = 0.01  # of the rms speed: the speed over which the sign of a motion turns
WINDING = 0.1  # of the rms torque of the links: a change of an integral at the start, by which its response is seen
WEIGHTLESS = 0.01  # of the torque of the links: the weight about an axis that is vertical to .01 rad
WINDOW, UNSETTLED = 12.0, 1.0  # [s]: windows of a part of the samples, and what of each, and behind a contact, is not counted


@dataclass(frozen=True, eq=False)
class Motion:
    """One recording: what each joint carries, smooth positions and velocities (N, m), and its role.

    shares (N, m, C, 5): what each joint carries more by one unit of each of the C numbers of `body_numbers`; drive (N, m):
    torque of each joint's drive by the file, of links, armature and damping; late: seconds by which positions of joints are taken
    to be logged late; touching: contact.
    """

    recording: RobotRecording
    held: bool
    z: np.ndarray
    dz: np.ndarray
    series: Along
    shares: np.ndarray
    drive: np.ndarray
    late: Mapping[str, float]
    touching: Touching


def moving(robot: Robot, recordings: Sequence[RobotRecording]) -> tuple[str, ...]:
    """Joints that a servo drives, that have a command and a position in every recording and move in one at least."""
    drives = joint_drives(robot)
    out = []
    for j, name in enumerate(robot.joints):
        if drives[j] is None or not all(r.has("command", name) and name in r.joints for r in recordings):
            continue
        if any(moves(r.angle[:, r.joints.index(name)]) for r in recordings):
            out.append(name)
    if not out:
        raise need_command(robot, recordings[0].source)
    return tuple(out)


def prepare(robot: Robot, recording: RobotRecording, held: bool, late: Mapping[str, float] = MappingProxyType({})) -> Motion:
    """The recording with what each joint carries along it; ``late``: seconds by which positions of joints are logged late."""
    if len(recording) < 100:
        raise InputError(recording.source, f"{len(recording)} samples", "at least 100", "record longer")
    z, dz, ddz = smoothed(robot, recording, late)
    links, known = robot.nominal - robot.fixed, recording.payload
    if known is not None:
        at, pos, quat = robot.link_of(known.body)
        links[at] += moved(point_mass(known.mass, np.array(known.pos)), pos, quat)
    series = along(robot, z, dz, ddz, links if known is not None else None)
    numbers = body_numbers(robot)
    extra = shares(robot, z, dz, ddz, changes(robot, numbers))
    if gravcomp_of(robot) is not None:
        extra[:, :, [n.kind for n in numbers].index(GRAVITY)] = compensation(robot, z)
    drive = series.torque.copy()
    for j, d in enumerate(joint_drives(robot)):
        if d is not None:
            drive[:, j] += d.slots[SLOT["armature"]] * ddz[:, j] + d.slots[SLOT["damping"]] * dz[:, j]
    contact = touching(robot, z, dz, ddz, recording.dt)
    return Motion(recording, held, z, dz, series, extra, drive, dict(late), contact)


@dataclass(frozen=True, eq=False)
class JointProblem:
    """One joint in all recordings, one after the other (N samples).

    starts (R + 1,): where each begins; first, slope (N,): the target of the servo between samples; series (N, 10 + 3 m):
    see `run_joint`; angle (N,): measured position; fitted, held (N,): samples that count; noise: rms of the angle; nominal (K,):
    the file's
    slots; weight (N,): torque of gravity about the joint; masses (C,): the numbers of `body_numbers` less those of the file,
    which series and weight have in them, and their covariance (C, C); felt (F,): those that the joint feels; shares (N, F, 5): of
    these, see `mjsim.robot.shares`;
    sources: file and role of each recording; rows (N,): index of each sample in the problem of all recordings; slide:
    whether it is no hinge; joints (m): of the robot; softness: that its dry friction has or would have in the user's simulator,
    see `friction_softness`; shift (N,): what that simulator's run of the whole robot is beyond the joint's own run, which is
    compared with the rest of the measured position; hold_stated: whether somebody states how the commands go between samples.
    """

    joint: int
    name: str
    drive: JointDrive
    dt: float
    each: int
    starts: np.ndarray
    first: np.ndarray
    slope: np.ndarray
    series: np.ndarray
    angle: np.ndarray
    fitted: np.ndarray
    held: np.ndarray
    noise: float
    sources: tuple[tuple[str, str], ...]
    rows: np.ndarray
    weight: np.ndarray
    felt: np.ndarray
    shares: np.ndarray
    masses: np.ndarray
    masses_variance: np.ndarray
    slide: bool = False
    joints: tuple[str, ...] = ()
    softness: tuple[float, ...] = (0.0, 0.0)
    shift: np.ndarray | None = None
    hold_stated: bool = False

    @property
    def is_soft(self) -> bool:
        """Whether its dry friction lets it creep, as the user's simulator does."""
        return bool(self.nominal[SLOT["soft"]] > 0.0)

    def carried_to(self, other: JointProblem) -> JointProblem:
        """Another problem of the joint with the masses and the kind of dry friction of this one."""
        return other.with_masses(self.masses, self.masses_variance).with_soft_friction(self.is_soft)

    def with_soft_friction(self, soft: bool) -> JointProblem:
        """The problem with dry friction as in the user's simulator, or with one that holds at rest."""
        slots = self.nominal.copy()
        slots[SLOT["soft"]], slots[SLOT["soft_rate"]] = self.softness if soft else (0.0, 0.0)
        return dataclasses.replace(self, drive=dataclasses.replace(self.drive, slots=slots))

    @property
    def bears_weight(self) -> bool:
        """Whether gravity acts about the joint in the file (`WEIGHTLESS`)."""
        own, links = (float(np.mean(x**2)) for x in (self.weight, self.series[:, 4]))
        return own > WEIGHTLESS**2 * links

    @property
    def nominal(self) -> np.ndarray:
        """Slots (K,) as the file has them."""
        return self.drive.slots

    def with_masses(self, masses: np.ndarray, variance: np.ndarray | None = None) -> JointProblem:
        """The problem under other masses (C,), less those of the file, and their covariance (C, C)."""
        more = np.einsum("nck,c->nk", self.shares, (masses - self.masses)[self.felt])
        series = self.series.copy()
        for k, name in enumerate(SERIES[:-1]):
            series[:, COLUMN[name]] += more[:, k]
        zero = np.zeros((len(masses), len(masses)))
        return dataclasses.replace(
            self, series=series, weight=self.weight + more[:, -1], masses=np.asarray(masses, float),
            masses_variance=zero if variance is None else variance,
        )  # fmt: skip

    @functools.cached_property
    def as_given(self) -> JointProblem:
        """The problem under the masses of the file."""
        return self.with_masses(np.zeros_like(self.masses)) if np.any(self.masses) else self

    def run(self, p: np.ndarray, each: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity (N,) of the joint running free under these slots.

        Where the integral of a servo stands at the start of a recording is what suits its counted samples best, to first order.
        """
        shift = np.zeros(len(self.sources))
        q, v = self._run(p, shift, each)
        if p[SLOT["integral"]] > 0.0:
            size = WINDING * float(np.sqrt(np.mean(self.series[:, 4] ** 2))) + self.noise * float(p[SLOT["kp"]])
            most = DIVERGED * float(np.ptp(self.angle))
            response = (self._run(p, shift + size, each)[0] - q) / size
            for k in range(len(self.sources)):
                part = self.part(k)
                counts = (self.fitted | self.held)[part]
                g, e = response[part][counts], (self.angle - q)[part][counts]
                if not max(size * np.max(np.abs(g), initial=0.0), np.max(np.abs(e), initial=0.0)) < most:
                    continue  # it diverges
                squares = float(g @ g)
                shift[k] = float(np.clip(g @ e / squares, -size / WINDING**2, size / WINDING**2)) if squares > 0.0 else 0.0
            q, v = self._run(p, shift, each)
        return q, v

    def _run(self, p: np.ndarray, shift: np.ndarray, each: int) -> tuple[np.ndarray, np.ndarray]:
        """The same from the integral of a servo that is ``shift`` (R,) [N m | N] beyond what carries the links at the start."""
        q, v = np.empty(len(self.angle)), np.empty(len(self.angle))
        steps, (first, slope) = each or self.each, self._target(p)
        run_joint(p, self.drive.velocity, self.starts, first, slope, self.series, self.dt, steps, shift, q, v)
        late = float(p[SLOT["late"]]) / self.dt
        if late > 0.0:  # as it is logged
            for k in range(len(self.sources)):
                part = self.part(k)
                q[part], v[part] = delayed(q[part], late), delayed(v[part], late)
        return q, v

    def _target(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and slope (N,) of the target, on its profile where its acceleration is limited."""
        if not p[SLOT["acceleration"]] > 0.0:
            return self.first, self.slope
        most = float(p[SLOT["slew"]]) if p[SLOT["slew"]] > 0.0 else math.inf
        parts = [self.part(k) for k in range(len(self.sources))]
        each = [profiled(self.first[x], self.slope[x], self.dt, most, float(p[SLOT["acceleration"]])) for x in parts]
        return np.concatenate([first for first, _ in each]), np.concatenate([slope for _, slope in each])

    def error(self, p: np.ndarray) -> np.ndarray:
        """Measured less simulated position (N,); a run that diverges has at most `DIVERGED` times the travel."""
        e, most = self.angle - self.run(p)[0], DIVERGED * float(np.ptp(self.angle))
        e = e if self.shift is None else e - self.shift
        return np.where(np.abs(e) < most, e, most)

    def part(self, run: int) -> slice:
        """Samples of one recording."""
        return slice(int(self.starts[run]), int(self.starts[run + 1]))

    def with_fitted(self) -> JointProblem:
        """The problem without recordings of which no sample is fitted."""
        return self._kept

    @functools.cached_property
    def _kept(self) -> JointProblem:
        runs = [k for k in range(len(self.sources)) if self.fitted[self.part(k)].any()]
        if len(runs) == len(self.sources):
            return self
        at = np.concatenate([np.arange(self.starts[k], self.starts[k + 1]) for k in runs])
        sizes = [int(self.starts[k + 1] - self.starts[k]) for k in runs]
        return dataclasses.replace(
            self, starts=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64), first=self.first[at], slope=self.slope[at],
            series=self.series[at], angle=self.angle[at], fitted=self.fitted[at], held=self.held[at],
            sources=tuple(self.sources[k] for k in runs), rows=self.rows[at], weight=self.weight[at], shares=self.shares[at],
            shift=None if self.shift is None else self.shift[at],
        )  # fmt: skip

    def windows(self, most: int) -> JointProblem:
        """About ``most`` samples in windows of `WINDOW`, spread over the fitted samples; each begins at rest where it is
        measured.

        The first `UNSETTLED` of a window is not counted. The problem itself where it is no longer.
        """
        key = self._windows
        if most not in key:
            key[most] = self._cut(most)
        return key[most]

    @functools.cached_property
    def _windows(self) -> dict[int, JointProblem]:
        return {}

    def _cut(self, most: int) -> JointProblem:
        whole = self.with_fitted()
        size, skip = round(WINDOW / self.dt), round(UNSETTLED / self.dt)
        if len(whole.angle) <= most or size < 4 * skip:
            return whole
        begins = [
            (k, b) for k in range(len(whole.sources)) for b in range(int(whole.starts[k]), int(whole.starts[k + 1]) - size + 1,
            size)
            if whole.fitted[b : b + size].any()
        ]  # fmt: skip
        few = max(1, most // size)
        if len(begins) <= few:
            return whole
        chosen = [begins[i] for i in np.unique(np.linspace(0, len(begins) - 1, few).round().astype(int))]
        at = np.concatenate([np.arange(b, b + size) for _, b in chosen])
        starts = np.arange(len(chosen) + 1, dtype=np.int64) * size
        series, fitted = whole.series[at].copy(), whole.fitted[at].copy()
        series[starts[:-1], 5] = whole.angle[at][starts[:-1]]
        for b in starts[:-1]:
            fitted[b : b + skip] = False
        return dataclasses.replace(
            whole, starts=starts, first=whole.first[at], slope=whole.slope[at], series=series, angle=whole.angle[at],
            fitted=fitted,
            held=whole.held[at], sources=tuple(whole.sources[k] for k, _ in chosen), rows=whole.rows[at],
            weight=whole.weight[at], shares=whole.shares[at],
            shift=None if whole.shift is None else whole.shift[at],
        )  # fmt: skip

    def blocks(self, seconds: float) -> np.ndarray:
        """Block (N,) of each sample, counted from zero: stretches of a length that end with each recording."""
        size = max(1, round(seconds / self.dt))
        own = [np.arange(n) // size for n in np.diff(self.starts)]
        first = np.cumsum([0, *(int(b[-1]) + 1 for b in own)])
        return np.concatenate([b + k for b, k in zip(own, first, strict=False)])


def _others(m: Motion) -> list[np.ndarray]:
    """Torque of the drive, sign of the motion and velocity (N,) of each joint."""
    out = []
    for j in range(m.z.shape[1]):
        v = m.dz[:, j]
        out += [m.drive[:, j], v / np.hypot(v, RESTS * float(np.sqrt(np.mean(v**2))) + 1e-12), v]
    return out


def joint_problem(robot: Robot, motions: Sequence[Motion], name: str, split: bool) -> JointProblem:
    """The problem of one joint; ``split``: every third of ten blocks of each recording is held out."""
    j = robot.joints.index(name)
    drive = joint_drives(robot)[j]
    assert drive is not None
    softness = tuple(friction_softness(robot)[j].tolist())
    dt = motions[0].recording.dt
    firsts: list[np.ndarray] = []
    slopes: list[np.ndarray] = []
    series: list[np.ndarray] = []
    angles: list[np.ndarray] = []
    fitted: list[np.ndarray] = []
    held: list[np.ndarray] = []
    sources: list[tuple[str, str]] = []
    for m in motions:
        r = m.recording
        k = r.joints.index(name)
        assert r.command is not None
        n, q = len(r), r.angle[:, k]
        u = drive.target(r.command[:, k], r.dt, float(q[0]))
        first, slope = between(u, r.dt, "linear" if drive.servo.target.value == "integrated velocity" else r.hold)
        load = m.series.torque[:, j]
        one = np.column_stack([
            m.series.inertia[:, j], m.series.bias[:, j], m.series.by_position[:, j], m.series.by_velocity[:, j], load, m.z[:, j],
            m.dz[:, j], *m.shares[:, j, -1, :3].T, *_others(m),
        ])  # fmt: skip
        one[0, 5] = q[0]  # the run starts where the joint is measured
        counts = np.full(n, moves(q)) & ~m.touching.widened(math.ceil(EDGE / dt), math.ceil(UNSETTLED / dt))[:, j]
        if m.late:
            counts[n - math.ceil((max(m.late.values()) + EDGE) / r.dt) :] = False
        apart = (np.arange(n) * BLOCKS // n) % EVERY == EVERY - 1 if split else np.full(n, m.held)
        for group, values in (
            (firsts, first), (slopes, slope), (series, one), (angles, q), (fitted, counts & ~apart), (held, counts & apart),
        ):  # fmt: skip
            group.append(values)
        sources.append((r.source, "held-out" if m.held else "estimation"))
    sizes, count = [len(a) for a in angles], motions[0].shares.shape[2]
    q = np.concatenate(angles)
    felt = np.flatnonzero(np.any([np.any(m.shares[:, j] != 0.0, axis=(0, 2)) for m in motions], axis=0))
    own = np.concatenate([m.shares[:, j, felt].astype(np.float32) for m in motions])
    return JointProblem(
        j, name, drive, dt, max(FEWEST_STEPS, math.ceil(dt / STEP)), np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        np.concatenate(firsts), np.concatenate(slopes), np.concatenate(series), q, np.concatenate(fitted), np.concatenate(held),
        float(np.median([resolution(a) for a in angles])), tuple(sources), np.arange(len(q)),
        np.concatenate([m.series.weight[:, j] for m in motions]), felt, own,
        np.zeros(count), np.zeros((count, count)), robot.motions[j] is Kind.SLIDE, robot.joints,
        softness, hold_stated=all(m.recording.hold_stated for m in motions),
    )  # fmt: skip
