"""Whether a model is judged by motion or by force, and in which band of frequencies."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from diagnose.data.experiment import Experiment, measured_velocity
from diagnose.data.noise import white_noise_level
from diagnose.problem.view import ForceView, MotionView, View
from diagnose.thresholds import SENSOR_SHARE, SMALL, TAPS
from mjsim.axis import Axis
from mjsim.errors import InputError
from mjsim.recording import Recording
from mjsim.system import assemble, state_matrix

__all__ = ["choose_view", "clean_band", "growth_when_held", "with_samples"]


def choose_view(recordings: Sequence[Recording], judge: str | None, nominal: Axis | None = None) -> View:
    """Motion or force.

    As asked, as the binding says, else force when there is only a position (a servo under a position loop) and the mechanism
    behind the driven body can be moved as recorded: one that is unstable then swings up whatever the torque. Raises
    InputError where that is asked for.
    """
    if nominal is not None and nominal.chain.servo is not None:
        return MotionView.of(nominal, recordings)
    judge = judge or recordings[0].judge
    growth = growth_when_held(nominal) if nominal is not None else -math.inf
    swings_up = growth * max(r.duration for r in recordings) > -math.log(SMALL)
    if judge == "force" and swings_up:
        raise InputError(
            "judge", f"'force', and behind the driven body, once that is held, the nominal model swings up by {growth:.3g} 1/s",
            "'motion'", "judge by motion, or correct the damping of the nominal model",
        )  # fmt: skip
    if judge is None:
        judge = "force" if recordings[0].velocity is None and not swings_up else "motion"
    if judge == "motion":
        return MotionView() if nominal is None else MotionView.of(nominal, recordings)
    dt = recordings[0].dt
    decimate = max(1, round(0.01 / dt)) if dt < 0.005 else 1
    if nominal is None:
        return ForceView(decimate=decimate)
    return ForceView(cutoff_hz=min(clean_band(nominal, r) for r in recordings), decimate=decimate)


def with_samples(view: View, experiments: Sequence[Experiment], nominal: Axis, asked: str | None) -> View:
    """The view, or where a short recording has no samples that count by force, that of motion.

    ``asked``: how the user wants it judged, None where that is left to the bindings. Fewer samples than the whitening filter of
    a torque has taps (`TAPS`) tell nothing. Raises InputError where force is asked for: the low-pass of the band in which the
    torque of the encoder's noise is small has no inside in a recording shorter than its ends.
    """
    if not isinstance(view, ForceView):
        return view
    poor = [e for e in experiments if int(np.sum(view.counts(e))) < TAPS]
    if not poor:
        return view
    recordings = [e.recording for e in experiments]
    asked = asked or recordings[0].judge
    swings_up = growth_when_held(nominal) * max(r.duration for r in recordings) > -math.log(SMALL)
    if asked is None and not swings_up:
        return MotionView.of(nominal, recordings)
    r, band = poor[0].recording, view.band(poor[0].recording.dt)
    raise InputError(
        r.source, f"{r.duration:.3g} s, of which no {TAPS} samples in motion can be judged by force below {band:.3g} Hz",
        "motion for longer than the low-pass takes to settle",
        "judge by motion ([experiment] judge = 'motion'), or record longer",
    )  # fmt: skip


def growth_when_held(axis: Axis) -> float:
    """Rate [1/s] at which what is behind the driven body swings up while that body is moved as recorded; below 0: it settles."""
    s = assemble(Axis(axis.chain))
    if s.n == 1:
        return -math.inf
    behind = [i for i in range(2 * s.n) if i not in (0, s.n)]
    return float(np.max(np.linalg.eigvals(state_matrix(s.f)[np.ix_(behind, behind)]).real))


def clean_band(axis: Axis, recording: Recording, share: float = SENSOR_SHARE) -> float:
    """Highest frequency [Hz], up to a tenth of the sampling rate, below which the torque of the encoder's noise is negligible.

    Twice differentiated and multiplied by the inertia, the noise of the angle (from its sixth differences, at least its rounding)
    grows with the fourth power of the frequency; it may make ``share`` of the recorded torque's power.
    """
    from scipy.signal import welch

    highest = 0.1 / recording.dt
    if recording.angle is None:
        y, power = measured_velocity(recording), 2
    else:
        y, power = recording.angle, 4
    steps = np.abs(np.diff(y))
    rounding = float(np.min(steps[steps > 0], initial=math.inf))
    noise = max(white_noise_level(y), rounding / math.sqrt(12.0) if rounding > 1e-9 * np.ptp(y) else 0.0)
    inertia = sum(b.inertia * axis.chain.total_ratio(i) ** 2 for i, b in enumerate(axis.chain.bodies))
    segment = min(len(y), max(256, 2 ** int(np.log2(len(y) / 6))))
    f, torque = welch(axis.chain.gain * recording.torque, 1 / recording.dt, nperseg=segment)
    false = inertia**2 * (2 * np.pi * f) ** power * noise**2 * 2 * recording.dt
    dirty = np.flatnonzero((np.cumsum(false) > share * np.cumsum(torque)) & (f <= highest))
    # from the top down: at the lowest frequencies neither counts
    return highest if len(dirty) == 0 or f[dirty[0]] > 0.8 * highest else float(max(f[dirty[0]], 0.02 * highest))
