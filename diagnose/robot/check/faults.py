"""What can be wrong with the channels of one joint: each function returns problems with a number, a unit and an advice."""

from __future__ import annotations

import math

from diagnose.check.thresholds import ACTUATOR_DELAY, FOLLOWED, MODE_RATE, PARAMETER_FACTOR, RANGE_FIX, RATIO_TOLERANCE, SKEW_FIX
from diagnose.check.types import Problem, Severity
from diagnose.robot.check.relations import Relation

__all__ = ["WRONG", "geared", "late_or_early", "out_of_range", "scaled", "slow", "still", "swapped"]

WRONG = ("gear", "sign", "swapped", "unit")  # faults of a log with which every number of a diagnosis would be wrong
ANGLES = {180 / math.pi: "degrees", 1 / (2 * math.pi): "turns"}
GEARED = 1.25  # factor about a gear within which it explains a ratio: friction and masses of the file bend the ratio as well
RATES = {180 / math.pi: "degrees per second", 30 / math.pi: "rpm", 1 / (2 * math.pi): "turns per second"}
LENGTHS = {1e3: "millimetres", 1e2: "centimetres"}
TORQUES = {1e3: "N mm", 1e2: "N cm", 1e-3: "kN m"}


def swapped(channel: str, joint: str, other: str, crossed: float, own: float, what: str = "position") -> Problem:
    """Two joints whose columns of a channel are exchanged."""
    return Problem(
        f"{joint}.{channel}", "swapped", crossed, "1",
        f"The {channel} of {joint} goes with the {what} of {other}, and the other way round (correlation {crossed:.2f}; with "
        f"their own {own:.2f}).", f"swap the columns of the {channel} of {joint} and {other}", Severity.FIX,
    )  # fmt: skip


def scaled(
    channel: str, joint: str, r: Relation, units: dict[float, str], against: str, least: float = PARAMETER_FACTOR
) -> list[Problem]:
    """A sign or a unit: the slope of a channel over what it should equal, where the relation explains it.

    No sign where another delay with the other sign explains it as well. ``least``: the factor from which on a ratio is a fault
    that no known unit explains.
    """
    size, out = abs(r.slope), []
    if r.explained < FOLLOWED or size == 0.0:
        return []
    if r.slope < 0 and r.opposite < FOLLOWED:
        out.append(
            Problem(
                f"{joint}.{channel}", "sign", r.slope, "1",
                f"The {channel} of {joint} has the opposite sign of {against} (slope {r.slope:.3g}).",
                f"reverse the sign of {joint}.{channel}, or the joint's axis in the model", Severity.FIX,
            )
        )  # fmt: skip
    if 1 / PARAMETER_FACTOR < size < PARAMETER_FACTOR:
        return out
    near = min(units, key=lambda f: min(abs(math.log(size / f)), abs(math.log(size * f))))
    for factor, has, model in ((near, units[near], "SI"), (1 / near, "SI", units[near])):
        if abs(math.log(size / factor)) < math.log(1 + 2 * RATIO_TOLERANCE):
            text = f"{has} where {against} is in {model}"
            out.append(
                Problem(
                    f"{joint}.{channel}", "unit", size, "1",
                    f"The {channel} of {joint} is {size:.4g} times {against}: {text}.",
                    f"give the unit of {joint}.{channel} in the binding, or convert the column", Severity.FIX,
                )
            )  # fmt: skip
            return out
    if 1 / least < size < least:
        return out
    out.append(
        Problem(
            f"{joint}.{channel}", "channel_ratio", size, "1",
            f"The {channel} of {joint} is {size:.4g} times {against}, which no known unit explains.",
            f"correct the unit or the gear of {joint}.{channel}", Severity.FIX,
        )
    )  # fmt: skip
    return out


def geared(joint: str, r: Relation, gear: float) -> list[Problem]:
    """A torque that is given at the joint, where the model's actuator gives it before its gear."""
    ratio = abs(r.slope)
    if (
        r.explained < FOLLOWED or not ratio or abs(math.log(abs(gear))) < 2 * math.log(PARAMETER_FACTOR)
    ):  # wrong masses do as much
        return []
    if abs(math.log(ratio / abs(gear))) > math.log(GEARED):
        return []
    return [
        Problem(
            f"{joint}.torque", "gear", ratio, "1",
            f"The torque of {joint} is {ratio:.4g} times what the actuator needs by the model, whose gear is {gear:g}: it is "
            "that of the joint, and the model wants it before the gear.",
            f"give {joint}.torque a gain of {1 / gear:.4g} in the binding, or divide the column by {gear:g}", Severity.FIX,
        )
    ]  # fmt: skip


def late_or_early(channel: str, joint: str, delay: float, expected: tuple[float, float], dt: float, cause: str) -> list[Problem]:
    """A channel that is earlier or later than the model and one sample explain; ``expected``: least, most [s].

    A response that is ahead of its cause is a fault of the log. One that is behind it by less than the model says may be a servo
    with a feedforward.
    """
    allowed = max(dt, ACTUATOR_DELAY)
    low, high = expected[0] - allowed, expected[1] + allowed
    if low <= delay <= high:
        return []
    early = delay < low
    off = delay - (expected[0] if early else expected[1])
    ahead = early and (expected[1] == 0.0 or delay < -allowed)
    fix = ahead or (not early and abs(off) > SKEW_FIX and expected[1] == 0.0)
    law = "a feedforward" if early else "a lag"
    why = "the clocks of the two channels differ" if fix else f"{law}, another gain and a skew of the clocks look alike"
    return [
        Problem(
            f"{joint}.{channel}", "skew", delay, "s",
            f"The {channel} of {joint} follows {cause} by {1e3 * delay:.4g} ms, where the model and one sample explain "
            f"{1e3 * low:.3g} to {1e3 * high:.3g} ms: {why}.",
            f"log {joint}.{channel} by the clock of {cause}, or shift it by {-1e3 * off:.4g} ms",
            Severity.FIX if fix else Severity.LIMITS,
        )
    ]  # fmt: skip


def out_of_range(joint: str, low: float, high: float, least: float, most: float, slide: bool) -> list[Problem]:
    """A position outside the joint's limits, with the unit that would put it inside."""
    reach = high - low
    if not math.isfinite(reach) or (least >= low - RANGE_FIX * reach and most <= high + RANGE_FIX * reach):
        return []
    unit = "m" if slide else "rad"
    units = {f: name for f, name in (LENGTHS if slide else ANGLES).items() if f > 1 and most - least > reach}
    fits = [name for f, name in units.items() if low <= least / f and most / f <= high]
    return [
        Problem(
            f"{joint}.angle", "unit" if fits else "joint_range", most if most > high else least, unit,
            f"The position of {joint} goes from {least:.4g} to {most:.4g} {unit}; the model has "
            f"{low:.4g} to {high:.4g}"
            + (f". In {fits[0]} it would be inside." if fits else "."),
            "give the unit in the binding, or convert the column" if fits
            else "correct the zero and the unit of the column, or the range in the model",
            Severity.FIX,
        )
    ]  # fmt: skip


def slow(joint: str, frequency: float, rate: float) -> list[Problem]:
    """A servo whose frequency is out of reach of the sampling rate."""
    if frequency < rate / MODE_RATE:
        return []
    return [
        Problem(
            f"{joint}.angle", "sample_rate", frequency, "Hz",
            f"The servo of {joint} has {frequency:.3g} Hz by the model, out of reach of {rate:.4g} samples/s.",
            f"log at {MODE_RATE * frequency:.3g} samples/s or more, and check that the time is in seconds", Severity.LIMITS,
        )
    ]  # fmt: skip


def still(joint: str, channel: str) -> Problem:
    """A channel that does not vary."""
    return Problem(
        f"{joint}.{channel}", "constant", 0.0, "1", f"The {channel} of {joint} does not vary: nothing can be told of this joint.",
        f"move {joint}, or leave it out", Severity.LIMITS,
    )  # fmt: skip
