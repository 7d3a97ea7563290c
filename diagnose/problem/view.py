"""How a model is judged against a recording: by its free-run motion, or by the force that the recorded motion needs.

Motion (output error): the model runs on the recorded torque and its velocity is compared. Efficient and unbiased when the
noise is in the sensor, also under feedback, since the torque that acted is recorded.
Force (inverse dynamics): the model is moved as recorded and the torque that this needs is compared. For recordings under a tight
position loop, whose motion says nothing and whose free run drifts on any disturbance of the torque.
Both are low-passed alike where they are filtered (docs/decisions/motion-and-force.md).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from diagnose.data.experiment import Experiment, measured_velocity
from diagnose.data.runs import free_run, with_known
from diagnose.thresholds import DITHER, HALVINGS, LEAST_SAMPLES, MOST_SUBSTEPS, SMALL, TWICE
from mjsim.axis import Axis
from mjsim.effects import NotApplicableError
from mjsim.effects.ports import StaticMap
from mjsim.hold import at_samples, delayed, lagged
from mjsim.ode import DivergedError, apply_input, count_work, inverse, sensed, simulate
from mjsim.recording import Recording
from mjsim.system import MOST_STEPS, STEP, System, assemble

__all__ = ["ForceView", "MotionView", "Signals", "View", "highest_observer_gain"]


@dataclass(frozen=True)
class Signals:
    """What is compared, on one time grid (M): time [s], measured and predicted in the view's unit.

    rounding (M): the part of the predicted by which a sensor rounds it to steps; None without. mean_angle: mean error of the
    angle over its standard error, of a free run that starts at the first measured angle; 0 where it is not asked for.
    """

    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    rounding: np.ndarray | None = None
    mean_angle: float = 0.0


def highest_observer_gain(axis: Axis) -> float:
    """The highest observer gain [1/s] by which the measured velocity may correct a model; 0 where it cannot be run.

    Ahead of a sensor's lag T the noise that leads it is rate T times as large: it breaks a body loose that would stick.
    """
    if axis.chain.servo is not None:
        return 0.0  # its own feedback draws it to the command
    try:
        lag = assemble(axis).output_lag
    except (NotApplicableError, ValueError):
        return 0.0
    return TWICE / lag if lag > 0 else math.inf


def _delivered(s: System, torque: np.ndarray, dt: float, before: float) -> np.ndarray:
    """What an actuator makes of a command (N,) held over each sample: its mean over the sample."""
    u = apply_input(s, np.asarray(torque, float))
    late = math.ceil(s.input_delay / dt - 1e-9)
    if s.input_delay > 0:
        split = late - s.input_delay / dt  # part of a sample over which the newer command acts
        earlier = np.concatenate([np.full(late, before), u])
        u = split * earlier[1 : len(u) + 1] + (1.0 - split) * earlier[: len(u)]
    return lagged(u, s.input_lag, dt, before)


def _ahead(s: System, v: np.ndarray, dt: float) -> np.ndarray:
    """The velocity (N,) of which the measured one was measured, in its mean over each sample."""
    for m in s.output_maps:
        v = v - m.c if m.map is StaticMap.ADD else v
    following = np.append(v[1:], v[-1])
    mean = 0.5 * (v + following) + s.output_lag / dt * (following - v)  # of y + T y', which a lag T shows as y
    k = np.arange(len(v))
    delayed: np.ndarray = np.interp(k + s.output_delay / dt, k, mean) if s.output_delay > 0 else mean
    return delayed


class View(Protocol):
    """A way to judge a model."""

    @property
    def channel(self) -> str:
        """What is compared: velocity or torque."""

    @property
    def decimate(self) -> int:
        """One compared sample for so many recorded ones."""

    def signals(self, axis: Axis, experiment: Experiment, initial: np.ndarray | None) -> Signals | None:
        """Measured and predicted, or None when the model cannot be run (diverged, or values outside its domain)."""

    def counts(self, experiment: Experiment) -> np.ndarray:
        """Which of the compared samples count (M) bool."""

    def noise(self, experiment: Experiment) -> float | None:
        """Noise rms of the compared signal where the recording tells it, else None."""

    def band(self, dt: float) -> float:
        """Highest frequency [Hz] that is compared, of recordings sampled every dt [s]."""


def _rounded(measured: np.ndarray, clean: np.ndarray, step: float, counts: np.ndarray) -> np.ndarray:
    """What a signal (N,) is in the mean once it has been rounded to steps, by the noise before the rounding that fits best.

    Noise of a part r of a step turns the staircase into a smoother one, and beyond r = 0.6 into the signal itself (dither).
    """
    if step <= 0:
        return clean
    from scipy.special import ndtr  # loading it takes a sixth of the time until the first fit, and few sensors round

    def mean(part: slice, r: float) -> np.ndarray:
        level = np.round(clean[part] / step)
        off = clean[part] / step - level
        return np.asarray(step * (level + ndtr((off - 0.5) / r) - ndtr((-0.5 - off) / r)))

    some = slice(None, None, max(1, len(clean) // LEAST_SAMPLES))
    errors = [float(np.sum((measured[some] - mean(some, r))[counts[some]] ** 2)) for r in DITHER]
    count_work(2 * len(clean))
    return mean(slice(None), DITHER[int(np.argmin(errors))])


def _free_motion(
    system: System, torque: np.ndarray, experiment: Experiment, *, asked: bool, **how: Any
) -> tuple[np.ndarray, float]:
    """Velocity (N,) of a free run, averaged as the measured one of an encoder alone; mean error of the angle, if ``asked``.

    The latter over its standard error, of a run from the first angle; 0 where no angle was measured, or without noise.
    """
    r, start = experiment.recording, experiment.angle
    how |= {"angle": r.angle, "origin": start, "before": experiment.before, "hold": r.hold}
    asked = asked and r.angle is not None and experiment.angle_noise > 0.0 and bool(experiment.counts.any())
    if r.velocity is not None and not asked:
        return sensed(system, torque, r.dt, **how), 0.0
    run = simulate(system, torque, r.dt, **how)
    velocity = run.velocity if r.velocity is not None else np.gradient(run.angle, r.dt)
    if not asked or r.angle is None:
        return velocity, 0.0
    off = (r.angle - run.angle - start)[experiment.counts]
    return velocity, float(np.mean(off)) * math.sqrt(len(off)) / experiment.angle_noise


@dataclass(frozen=True)
class MotionView:
    """Free run on the recorded input, judged on motor velocity, or on the angle where the input is the command of a servo.

    lead [1/s]: rate at which a torque draws the model to the recorded velocity, by its own motor inertia; 0 for a free run.
    Under an observer gain a model forgets its past within 1 / gain: events do not add up, and its error has fewer minima.
    tied: gravity and springs act at the recorded angle too, so that a run cannot swing otherwise than the recording does.
    most_substeps: of a run, a sample; a model that needs more is not run. step [rad]: by which the fastest motion turns in one.
    Source: C. P. Vyasarayani et al., Multibody Syst. Dyn. 26 (2011) 411.
    """

    channel: str = "velocity"
    decimate: int = 1
    observer_gain: float = 0.0
    tied: bool = False
    most_substeps: int = MOST_SUBSTEPS
    step: float = STEP

    @classmethod
    def of(cls, nominal: Axis, recordings: Sequence[Recording]) -> MotionView:
        """For recordings of an axis: slow ones need many steps a sample."""
        steps = math.ceil(TWICE * max(r.dt for r in recordings) * assemble(nominal).omega / STEP)
        servo = nominal.chain.servo is not None
        return cls(
            "angle" if servo and all(r.angle is not None for r in recordings) else "velocity",
            most_substeps=MOST_STEPS if servo else max(MOST_SUBSTEPS, min(steps, MOST_STEPS)),
        )

    def signals(self, axis: Axis, experiment: Experiment, initial: np.ndarray | None) -> Signals | None:
        """Velocity measured and simulated at every sample."""
        r = experiment.recording
        torque = r.input
        try:
            if self.channel == "angle":
                return self._angles(axis, experiment, initial)
            system = assemble(with_known(self._with_observer_damping(axis), experiment))
            if self.observer_gain > 0:  # gain J (v - v_model): the first part is input, the second viscous friction
                torque = self._observer_torque(system, experiment, axis)
                system = dataclasses.replace(system, input_maps=(), input_lag=0.0, input_delay=0.0)
            if self.tied:
                system = system.tied()
            rounding = [m.c for m in system.output_maps if m.map is StaticMap.ROUND]
            if rounding:
                rest = tuple(m for m in system.output_maps if m.map is not StaticMap.ROUND)
                system = dataclasses.replace(system, output_maps=rest)
            asked = not r.driven and not self.tied and self.observer_gain == 0.0
            predicted, mean_angle = _free_motion(
                system, torque, experiment, asked=asked, initial=initial, most_substeps=self.most_substeps, step=self.step
            )
        except (DivergedError, NotApplicableError, ValueError, np.linalg.LinAlgError):
            return None
        measured = measured_velocity(r) + (0.0 if experiment.correction is None else experiment.correction)
        smooth = predicted
        for step in rounding:
            predicted = _rounded(measured, predicted, step, experiment.counts)
        return Signals(r.time, measured, predicted, predicted - smooth if rounding else None, mean_angle)

    def _angles(self, axis: Axis, experiment: Experiment, initial: np.ndarray | None) -> Signals:
        """Angle measured, and simulated under the model's own servo on the recorded command."""
        run = free_run(axis, experiment, initial, most_substeps=self.most_substeps, step=self.step)
        measured = experiment.recording.angle
        assert measured is not None
        if experiment.correction is not None:
            measured = measured + experiment.correction
        return Signals(experiment.recording.time, measured, run.angle)

    def _observer_torque(self, system: System, experiment: Experiment, axis: Axis) -> np.ndarray:
        """The torque (N,) past the actuator that draws a model to a recording."""
        delivered, velocity = self._path(system, experiment)
        return delivered + self.observer_gain * axis.chain.bodies[0].inertia / system.gain * velocity

    def _path(self, system: System, experiment: Experiment) -> tuple[np.ndarray, np.ndarray]:
        """What an actuator makes of the recorded torque, and the velocity ahead of a sensor, kept: a fit asks for few others."""
        path = (
            system.input_maps,
            system.input_lag,
            system.input_delay,
            system.output_maps,
            system.output_lag,
            system.output_delay,
        )
        known = experiment.kept.get(path)
        if known is None:
            r = experiment.recording
            known = _delivered(system, r.input, r.dt, experiment.before), _ahead(system, measured_velocity(r), r.dt)
            if len(experiment.kept) >= HALVINGS[0][0]:  # structures that are fitted at a time
                experiment.kept.clear()
            experiment.kept[path] = known
        return known

    def _with_observer_damping(self, axis: Axis) -> Axis:
        """The axis with the loss of the lead as viscous friction."""
        if self.observer_gain <= 0:
            return axis
        first, *others = axis.chain.bodies
        first = dataclasses.replace(first, viscous=first.viscous + self.observer_gain * first.inertia)
        return dataclasses.replace(axis, chain=dataclasses.replace(axis.chain, bodies=(first, *others)))

    def counts(self, experiment: Experiment) -> np.ndarray:
        """The experiment's own mask."""
        return experiment.counts

    def noise(self, experiment: Experiment) -> float | None:
        """White noise of the measured channel."""
        return experiment.sigma

    def band(self, dt: float) -> float:
        """All that the samples hold: half their rate [Hz]."""
        return 0.5 / dt


@dataclass(frozen=True)
class ForceView:
    """Inverse dynamics along the recorded motion, judged on torque.

    cutoff_hz: zero-phase fourth-order Butterworth low-pass on motion and torque alike (default a tenth of the sampling
    rate), then decimation by ``decimate``. slow, rest: samples below ``slow`` times the rms speed do not count (the direction of
    friction is unknown there), nor where the speed stays below ``rest`` times it for a fifth of a second (the axis stands).
    early: lead of the input over its rows [s] (`diagnose.fit.timing`).
    """

    cutoff_hz: float | None = None
    decimate: int = 10
    slow: float = 0.005
    rest: float = 0.05
    early: float = 0.0
    channel: str = "torque"
    # what is kept of an experiment, by its id, and the experiment, so that no other has that id
    _motions: dict[int, tuple[Experiment, tuple[np.ndarray, ...]]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _counted: dict[int, tuple[Experiment, np.ndarray]] = field(default_factory=dict, init=False, repr=False, compare=False)

    def _filtered(self, experiment: Experiment) -> tuple[np.ndarray, ...]:
        """Angle, velocity, acceleration (low-passed, by central differences) and the torque as commanded.

        The second difference of the angle and the torque are means under the same triangle about a sample.
        """
        if id(experiment) in self._motions:
            return self._motions[id(experiment)][1]
        r = experiment.recording
        if r.angle is not None:
            q = self._low_passed(r.angle, r.dt)
            v = np.gradient(q, r.dt)
            a = np.gradient(v, r.dt)  # at the ends, where no second difference is
            a[1:-1] = np.diff(q, 2) / r.dt**2
        else:
            v = self._low_passed(measured_velocity(r), r.dt)
            q = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) * r.dt])
            a = np.gradient(v, r.dt)
        motion = q, v, a, self._low_passed(delayed(at_samples(r.torque, r.hold), -self.early / r.dt), r.dt, 2)
        self._motions[id(experiment)] = experiment, motion
        return motion

    def _low_passed(self, x: np.ndarray, dt: float, times: int = 1) -> np.ndarray:
        """A signal (N, ...) behind the filter: a motion once; a torque twice, as the one is that a filtered motion needs."""
        from scipy.signal import butter, sosfiltfilt

        sos = butter(4, min(2 * self.band(dt) * dt, 0.9), output="sos")
        for _ in range(times):
            x = sosfiltfilt(sos, x, axis=0)
        return np.asarray(x)

    def low_passed(self, torques: np.ndarray, experiment: Experiment) -> np.ndarray:
        """Torques (N, k) along the recording as they are judged: low-passed and decimated, (M, k)."""
        return self._low_passed(torques, experiment.recording.dt, 2)[:: self.decimate]

    def signals(self, axis: Axis, experiment: Experiment, initial: np.ndarray | None) -> Signals | None:
        """Torque commanded (through the actuator effects) and torque needed, low-passed and decimated alike."""
        r = experiment.recording
        q, v, a, commanded = self._filtered(experiment)
        try:
            s = assemble(axis)
            if s.output_delay > 0:
                q, v, a = (delayed(x, -s.output_delay / r.dt) for x in (q, v, a))
            if s.output_lag > 0:  # what a lag of the sensor T shows is y with y + T y' = x
                T = s.output_lag
                q, v, a = q + T * v, v + T * a, a + T * np.gradient(a, r.dt)
            shifts = (m.c for m in s.output_maps if m.map is StaticMap.ADD)
            offset = sum(shifts) if r.angle is None else 0.0  # the rate of an angle does not have it
            needed = inverse(s, q, v - offset, a, r.dt)
        except (DivergedError, NotApplicableError, ValueError, np.linalg.LinAlgError):
            return None
        every = slice(None, None, self.decimate)
        needed = self._low_passed(needed, r.dt)
        shrinking = [m for m in s.input_maps if m.map in (StaticMap.CLIP, StaticMap.DROOP)]
        if not shrinking:
            return Signals(r.time[every], commanded[every], self._command(s, needed, r.dt)[every])
        # what these deliver does not tell the command: the command is taken through them
        u = apply_input(s, r.torque)
        late = at_samples(lagged(u, s.input_lag, r.dt, u[0]), r.hold)
        if s.input_delay != self.early:
            late = delayed(late, (s.input_delay - self.early) / r.dt)
        acting = self._low_passed(late, r.dt, 2)[every]
        # an actuator that delivers next to nothing asks next to nothing of the model: the error is one of the command
        keep = self.counts(experiment)
        asked, delivered = (float(np.std(x[keep])) for x in (commanded[every], acting))
        if not delivered > SMALL * asked:
            return None
        return Signals(r.time[every], asked / delivered * acting, asked / delivered * needed[every])

    def _command(self, s: System, needed: np.ndarray, dt: float) -> np.ndarray:
        """The command (N,), low-passed, by which an actuator delivers the torque (N,) that the motion needs.

        The recorded command is never changed: an error is part of it, and would go with it into whatever were made of it.
        """
        command = needed
        if s.input_lag > 0:
            command = command + s.input_lag * np.gradient(command, dt)
        if s.input_delay > 0:
            command = delayed(command, -s.input_delay / dt)
        for m in reversed(s.input_maps):
            if m.map is StaticMap.ADD:
                command = command - m.c
            elif m.map is StaticMap.DEAD:
                command = command + self._low_passed(m.c * np.sign(command), dt, 2)
        return command

    def counts(self, experiment: Experiment) -> np.ndarray:
        """The experiment's mask without the filter's ends and standstill."""
        if id(experiment) not in self._counted:
            self._counted[id(experiment)] = experiment, self._moving(experiment)
        return self._counted[id(experiment)][1]

    def _moving(self, experiment: Experiment) -> np.ndarray:
        r = experiment.recording
        _, v, _, _ = self._filtered(experiment)
        from scipy.ndimage import maximum_filter1d

        rms = math.sqrt(float(np.mean(v**2)))
        # a sample at which the speed passes through zero, and a rest, during which the torque is whatever friction lets stand
        rest = maximum_filter1d(np.abs(v), 2 * max(1, round(0.1 / r.dt)) + 1) < self.rest * rms
        moving = (np.abs(v) > self.slow * rms) & ~rest
        edge = math.ceil(2.0 / (self.band(r.dt) * r.dt))
        inside = np.zeros(len(r), bool)
        inside[edge : len(r) - edge] = True
        counted: np.ndarray = (experiment.counts & moving & inside)[:: self.decimate]
        return counted

    def noise(self, experiment: Experiment) -> float | None:
        """Not known beforehand: what acts on the torque is no sensor noise."""
        return None

    def band(self, dt: float) -> float:
        """Highest frequency [Hz] below the low-pass."""
        return self.cutoff_hz or 0.1 / dt
