"""The zero of a position servo takes up a constant torque: J q'' + ... = kp (c - zero - q) + A is the servo of zero - A / kp.

Dry friction of another level for each direction, F sign(v) + A, then moves the joint as F beside another zero does.
"""

from __future__ import annotations

from typing import Any

from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.verdict.decide import estimates
from mjsim.effects import Effect, effect_class
from mjsim.effects.registry import registered
from mjsim.servo import Target

__all__ = ["constant_torque", "with_an_offset"]

ZERO, KP = "zero", "kp"


def constant_torque(fitter: Fitter, best: Fitted) -> tuple[float, float] | None:
    """The zero found less that of the model [rad | m], and the torque that kp makes of it [N m | N].

    None where no zero of a position servo is fitted, or where the 95 % interval of the zero holds the model's value.
    """
    servo = fitter.nominal.chain.servo
    if servo is None or servo.target is Target.VELOCITY:
        return None
    found = estimates(best, fitter, owner="")
    zero = found.get(ZERO)
    if zero is None or zero.ci95[0] <= servo.zero <= zero.ci95[1]:
        return None
    kp = found[KP].value if KP in found else servo.kp
    moved = zero.value - servo.zero
    return moved, kp * moved


def with_an_offset(fitter: Fitter, best: Fitted, effect: Effect) -> tuple[str, ...]:
    """Effects that are this one and the constant torque that the zero of the servo takes up, with numbers that they may have."""
    moved = constant_torque(fitter, best)
    if moved is None:
        return ()
    out = []
    for name, cls in registered().items():
        offsets = [c for c in map(effect_class, cls.refines) if c.family == "offset"]
        if effect.id not in cls.refines or not offsets:
            continue
        size: dict[str, Any] = {offsets[0].amplitudes[0]: -moved[1]}
        whole = cls.whole((effect, offsets[0](**size)))
        if whole is not None and all(r.holds for r in whole.admissible(fitter.scales_for(cls, whole.place))):
            out.append(name)
    return tuple(out)
