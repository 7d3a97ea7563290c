"""What the noise of a recorded torque makes of a free run: an error of the input, and no missing physics.

White noise of rms s_u on the recorded torque is not in the torque that acts. A free run that is driven by it errs by

    var e(t_n) = s_u^2 sum_{k <= n} h_k^2

with h the impulse response from torque to velocity; of the angle, where it alone was measured, with dt sum_{j <= k} h_j. Noise
that a controller puts into its command is white as well, and acts: a model that is driven by a smoothed torque then errs more,
and less where the noise is the sensor's.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from diagnose.data.experiment import Experiment, middle
from diagnose.data.noise import white_noise_level
from diagnose.evidence.orders import torque_to_velocity
from diagnose.evidence.predictable import by_rate_of_angle, error_of_angle
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.thresholds import TWICE
from mjsim.axis import Axis
from mjsim.signals import lfilter

__all__ = ["made_by_torque_noise", "of_torque_noise"]


def of_torque_noise(axis: Axis, experiment: Experiment, *, of_angle: bool = False) -> float:
    """Mean square of the error that the white part of the recorded torque makes of a free run.

    Of the velocity [(rad/s)^2 | (m/s)^2], or ``of_angle`` [rad^2 | m^2].
    """
    r = experiment.recording
    b, a = torque_to_velocity(axis, r.dt, about=middle(r), by_velocity=r.angle is None)
    h = lfilter(b, a, np.concatenate([[1.0], np.zeros(len(r) - 1)]))
    if of_angle:
        h = r.dt * np.cumsum(h)
    return white_noise_level(r.torque) ** 2 * float(np.mean(np.cumsum(h**2)[experiment.counts]))


def made_by_torque_noise(fitter: Fitter, fitted: Fitted) -> bool:
    """Whether the held-out error is no more than the noise of sensor and recorded torque make, and falls once that is smoothed.

    `TWICE**2` times the mean square that the torque's noise makes is allowed: it is that of few independent samples. Judged on
    the angle where that alone was measured. False under a servo, and by force.
    """
    if fitter.view.channel != "velocity" or not fitter.noise.absolute:
        return False
    alone = by_rate_of_angle(fitter)
    for experiment in fitter.held_out:
        own = fitter.own_values(fitted.hypothesis, fitted, experiment)
        if own is None:
            return False
        counts = fitter.counted(experiment)
        smooth = np.hanning(9)[1:-1]  # by which white noise falls to half, and motion of few samples hardly
        torque = np.convolve(np.pad(experiment.recording.torque, len(smooth) // 2, "edge"), smooth / smooth.sum(), "valid")
        quiet = dataclasses.replace(experiment, recording=dataclasses.replace(experiment.recording, torque=torque))
        errors = [error_of_angle(fitter, e, *own) if alone else fitter.error(own[0], e, own[1]) for e in (experiment, quiet)]
        if errors[0] is None or errors[1] is None:
            return False
        plain, smoothed = (float(np.mean(e[counts] ** 2)) for e in errors if e is not None)
        sensor = experiment.angle_noise if alone else fitter.sigma(experiment)
        allowed = sensor**2 + TWICE**2 * of_torque_noise(own[0], experiment, of_angle=alone)
        if smoothed >= plain or plain > allowed:
            return False
    return True
