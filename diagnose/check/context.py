"""What several checks of one recording share, computed once: signals on a uniform grid, noise, the scale and the fits under
it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from diagnose.check.following import Following, follows
from diagnose.check.machine import Machine
from diagnose.check.relation import Fit, Relation, Signals
from diagnose.check.scale import Scale, find_scale
from diagnose.check.spectrum import noise_level
from diagnose.check.unknown_gear import GearRatio, find_gear
from mjsim.recording import Recording
from mjsim.timebase import rate_of

__all__ = ["Context", "stamps", "torque_of"]


def stamps(recording: Recording) -> tuple[np.ndarray, float]:
    """Steps between the stamps (N - 1,) and the sample time [s]: the mean of those that lack no sample."""
    return np.diff(recording.time), rate_of(recording.time)


def torque_of(recording: Recording) -> np.ndarray | None:
    """The logged torque (N,); None where the log has none (a servo's log of command and position)."""
    torque = getattr(recording, "torque", None)
    return None if torque is None or not np.all(np.isfinite(torque)) else torque


@dataclass(frozen=True, eq=False)
class Context:
    """Shared quantities of one recording and its machine; everything is computed when it is first asked for."""

    recording: Recording
    machine: Machine
    together: int = 0  # measured samples of all recordings that are checked at once

    @property
    def hold(self) -> str:
        """How the input goes between samples as the binding says, "held" where it does not."""
        return getattr(self.recording, "hold", None) or "held"

    @property
    def hold_is_stated(self) -> bool:
        """Whether the binding says how the input is held."""
        return self.recording.hold_stated or self.hold != "held"

    @cached_property
    def signals(self) -> Signals | None:
        """The channels on a uniform grid (interpolated by the stamps where these jitter); None without a torque that varies."""
        r = self.recording
        torque = torque_of(r)
        if torque is None or len(r) < 2 or np.ptp(torque) == 0:
            return None
        steps, dt = stamps(r)
        if np.max(np.abs(steps - dt)) < 1e-3 * dt:
            return Signals(r.dt, torque, r.velocity, r.angle)
        count = round(float(r.time[-1] - r.time[0]) / dt) + 1
        grid = r.time[0] + dt * np.arange(count)
        laid = [None if x is None else np.interp(grid, r.time, x) for x in (torque, r.velocity, r.angle)]
        assert laid[0] is not None
        return Signals(dt, laid[0], laid[1], laid[2])

    @cached_property
    def noise(self) -> dict[str, float]:
        """Noise rms of each response, by its fastest part and its rounding."""
        return {n: noise_level(x) for n in ("velocity", "angle") if (x := getattr(self.recording, n)) is not None}

    @cached_property
    def scale(self) -> Scale | None:
        """Sign, units and sides; None where the relation cannot be fitted."""
        return None if self.signals is None else find_scale(self.signals, self.machine, self.hold)

    @cached_property
    def gear(self) -> GearRatio | None:
        """The ratio of a gear that the model does not state, where the labels are contradicted and no known factor mends them."""
        scale = self.scale
        if self.signals is None or scale is None or not scale.contradicted or scale.chosen.kind != "none" or self.is_command:
            return None
        return find_gear(self.signals, self.machine, scale.labelled.fits[0], self.hold) if scale.labelled.fits else None

    @cached_property
    def mended(self) -> Signals | None:
        """The signals under the chosen hypothesis of `scale`."""
        return None if self.signals is None or self.scale is None else self.scale.chosen.apply(self.signals)

    @cached_property
    def response(self) -> str:
        """The response from which delays are estimated: the velocity where there is one."""
        return "velocity" if self.recording.velocity is not None else "angle"

    @cached_property
    def relation(self) -> Relation | None:
        """The relation of the mended signals and that response."""
        return None if self.mended is None else Relation(self.mended, self.machine, self.response)

    @cached_property
    def fit(self) -> Fit | None:
        """Its fit under the stated hold: the first of the evidence where that is of the same response."""
        scale = self.scale
        if scale is not None and scale.evidence.fits and len(scale.evidence.fits) == len(scale.responses):
            return scale.evidence.fits[0]
        return None if self.relation is None else self.relation.fit(self.hold)

    @cached_property
    def delay_spread(self) -> float:
        """Difference [s] between the delays of the first and the second half: what a delay has that is no delay; 0 where
        unknown."""
        s = self.mended
        if s is None or self.fit is None:
            return 0.0
        n, delays = len(s.torque), []
        for cut in (slice(0, n // 2), slice(n // 2, n)):
            part = [None if x is None else x[cut] for x in (s.velocity, s.angle)]
            fit = Relation(Signals(s.dt, s.torque[cut], part[0], part[1]), self.machine, self.response).fit(self.hold)
            if fit is None:
                return 0.0
            delays.append(fit.delay.value)
        return abs(delays[1] - delays[0])

    @cached_property
    def following(self) -> Following | None:
        """How the input follows the angle, where it does and is no torque."""
        return follows(self.signals, self.scale, self.machine, self.hold)

    @property
    def is_command(self) -> bool:
        """Whether the input follows the value of the angle, as a position command does, and is no torque."""
        return self.following is not None
