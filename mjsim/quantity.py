"""Physical quantities: what a parameter measures and in which unit, for a hinge and for a slide joint."""

from __future__ import annotations

import enum

__all__ = ["Motion", "Quantity"]


class Motion(enum.Enum):
    """The kind of joint that the axis moves on."""

    HINGE = "hinge"
    SLIDE = "slide"


class Quantity(enum.Enum):
    """A quantity and its SI unit on a hinge axis and on a slide axis."""

    TORQUE = ("N m", "N")
    ANGLE = ("rad", "m")
    VELOCITY = ("rad/s", "m/s")
    ACCELERATION = ("rad/s^2", "m/s^2")
    INERTIA = ("kg m^2", "kg")
    TORQUE_PER_COMMAND = ("N m/ctrl", "N/ctrl")
    STIFFNESS = ("N m/rad", "N/m")
    DAMPING = ("N m s/rad", "N s/m")
    INTEGRAL_GAIN = ("N m/(rad s)", "N/(m s)")
    QUADRATIC_DAMPING = ("N m s^2/rad^2", "N s^2/m^2")
    CUBIC_STIFFNESS = ("N m/rad^3", "N/m^3")
    PER_TORQUE_SQUARED = ("1/(N m)^2", "1/N^2")
    PER_VELOCITY = ("s/rad", "s/m")
    CYCLES = ("1/rev", "rad/m")
    PHASE = ("rad", "rad")
    TIME = ("s", "s")
    RATIO = ("1", "1")

    def unit(self, motion: Motion = Motion.HINGE) -> str:
        """SI unit of the quantity on an axis of this motion."""
        return self.value[0] if motion is Motion.HINGE else self.value[1]
