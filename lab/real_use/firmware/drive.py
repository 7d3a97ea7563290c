"""A drive's firmware: a position loop that runs once a millisecond, for one or several joints."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

__all__ = ["PERIOD", "Firmware", "Loop"]

PERIOD = 1e-3  # [s]

Numbers = float | tuple[float, ...]


@dataclass(frozen=True)
class Firmware:
    """Numbers of a position loop; each one number for all joints, or a tuple with one a joint; SI at the joint.

    force = kp e - kv v + ki int(e) + lead r', e = r - q less a dead band; r follows the command, ``latency`` [s] later, with at
    most ``speed`` and ``acceleration`` (trapezoidal profile). ``lag`` [s]: first-order lag of the force; ``limit``: largest
    force; ``stall``, ``free_speed``: force at rest and speed without force of the line that bounds the force (back-EMF).
    """

    kp: Numbers
    kv: Numbers
    ki: Numbers = 0.0
    lead: Numbers = 0.0
    deadband: Numbers = 0.0
    latency: float = 0.0
    lag: Numbers = 0.0
    speed: Numbers = math.inf
    acceleration: Numbers = math.inf
    limit: Numbers = math.inf
    stall: Numbers = math.inf
    free_speed: Numbers = math.inf


@lru_cache(64)  # a loop asks for each several times a period
def _each(numbers: Numbers, joints: int) -> np.ndarray:
    """The number of each joint, read-only."""
    return np.asarray(np.broadcast_to(np.asarray(numbers, dtype=float), (joints,)))


@dataclass
class Loop:
    """A running position loop."""

    firmware: Firmware
    joints: int
    _state: dict[str, np.ndarray] = field(default_factory=dict)
    _waiting: list[np.ndarray] = field(default_factory=list)

    def force(self, command: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Force of each joint over the next period."""
        f, s = self.firmware, self._state
        late = self._late(command)
        before = s.setdefault("target", late.copy())
        target = self._profile(before, late)
        rate = (target - before) / PERIOD
        s["rate"] = s.get("rate", np.zeros(self.joints)) + 0.1 * (rate - s.get("rate", np.zeros(self.joints)))
        s["target"] = target
        error = target - q
        error = np.sign(error) * np.maximum(np.abs(error) - self._of(f.deadband), 0.0)
        integral = s.setdefault("integral", np.zeros(self.joints))
        integral += self._of(f.ki) * error * PERIOD
        out = self._of(f.kp) * error - self._of(f.kv) * v + integral + self._of(f.lead) * s["rate"]
        lag = self._of(f.lag)
        share = np.where(lag > 0, -np.expm1(-PERIOD / np.maximum(lag, 1e-9)), 1.0)
        last = s.setdefault("force", out.copy())
        last += share * (out - last)
        out = np.clip(last, -self._of(f.limit), self._of(f.limit))
        stall, free = self._of(f.stall), self._of(f.free_speed)
        if np.all(np.isinf(stall)):
            return np.asarray(out)
        return np.asarray(np.clip(out, -stall * (1.0 + v / free), stall * (1.0 - v / free)))

    def _of(self, numbers: Numbers) -> np.ndarray:
        return _each(numbers, self.joints)

    def _late(self, command: np.ndarray) -> np.ndarray:
        self._waiting.append(command.copy())
        steps = round(self.firmware.latency / PERIOD)
        if len(self._waiting) > steps + 1:
            self._waiting.pop(0)
        return self._waiting[0]

    def _profile(self, target: np.ndarray, command: np.ndarray) -> np.ndarray:
        """The next target: towards the command with bounded speed and acceleration, at rest where it arrives."""
        top, acceleration = self._of(self.firmware.speed), self._of(self.firmware.acceleration)
        if np.all(np.isinf(acceleration)):
            return np.asarray(target + np.clip(command - target, -top * PERIOD, top * PERIOD))
        way = command - target
        bounded = np.where(np.isinf(acceleration), 1e9, acceleration)
        # the speed from which the next period still lets it stop at the command
        brake = bounded * PERIOD
        wanted = np.sign(way) * np.minimum(np.sqrt(brake**2 / 4 + 2.0 * bounded * np.abs(way)) - brake / 2, top)
        speed = self._state.get("speed", np.zeros(self.joints))
        speed = speed + np.clip(wanted - speed, -brake, brake)
        self._state["speed"] = speed
        return np.asarray(target + speed * PERIOD)
