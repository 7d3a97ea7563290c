"""Scales that contradict the model or each other and that no known factor explains."""

from __future__ import annotations

import math

from diagnose.check.context import Context
from diagnose.check.machine import Machine
from diagnose.check.registry import check
from diagnose.check.thresholds import DISTINCT, INERTIA_RANGE, RATIO_TOLERANCE, Z95
from diagnose.check.types import Problem, Severity
from mjsim.recording import Recording
from mjsim.signals import limits

__all__ = ["unknown_scale"]


@check("unknown_scale", "channel_ratio", "torque_scale", question="Do scales disagree by an unknown factor?")
def unknown_scale(recording: Recording, machine: Machine, context: Context) -> list[Problem]:
    """Angle against velocity by an unknown factor (fix); all torques of the model by a common one (limits), or
    by more than a fit mends (fix)."""
    scale = context.scale
    if scale is None or not scale.contradicted or scale.chosen.kind != "none" or context.is_command:
        return []
    labelled = scale.labelled
    if labelled.pair is not None and not labelled.channels_agree():
        if recording.velocity is not None and limits(recording.velocity):
            return []  # a clipped velocity is too slow for its angle: that is named by its own check
        r = labelled.pair.ratio
        return [
            Problem(
                "angle", "channel_ratio", r.value, "1",
                f"The angle moves {r.value:.4g} times as fast as the velocity says, which is no known unit or gear of the model.",
                "state units and gains of both in the binding (an encoder on the link: second_angle)", Severity.FIX,
                (r.value - Z95 * r.error, r.value + Z95 * r.error),
            )
        ]  # fmt: skip
    beyond = labelled.out_of_reach()
    if beyond is not None:
        ends = (beyond.value - Z95 * beyond.error, beyond.value + Z95 * beyond.error)
        return [
            Problem(
                "torque", "torque_scale", beyond.value, "1",
                f"By torque and motion the inertia is {beyond.value:.3g} times the model's, and friction or gravity are off the"
                f" same way. A fit takes {1 / INERTIA_RANGE:g} to {INERTIA_RANGE:g} times the model's inertia.",
                "state unit and gain of torque and motion in the binding (of a current: torque constant times gear), or correct"
                " the model (rotor inertia as armature, damping)", Severity.FIX, ends,
            )
        ]  # fmt: skip
    common = labelled.common()
    if common is None or abs(math.log(common)) < math.log(DISTINCT) - math.log(1 + RATIO_TOLERANCE):
        return []
    return [
        Problem(
            "torque", "torque_scale", common, "1",
            f"Inertia and friction or gravity of the recording are {common:.4g} times the model's together. A gain of the torque"
            " (a current taken as torque) and parameters that are off by one factor cannot be told from each other.",
            "state the gain of the torque column (torque constant times gear) in the binding, or weigh the load", Severity.LIMITS,
        )
    ]  # fmt: skip
