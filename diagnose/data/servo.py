"""Servo logs: the model's drive and the recording's input made to agree, and what such a log cannot tell held as given.

A log of command and angle knows no torque. Its equation, divided by any of its numbers, is the same equation:

    J q'' + f q' + friction + weight = kp (c - zero - q) - kv q'

so that only ratios show unless one torque is known: a gain (`Recording.known`), the weight that the model carries, a torque that
is known sample by sample, or the inertia. Damping at the joint and kv act alike, and only their sum shows.
A motor with a back-EMF, driven by a voltage u, is

    J q'' + f q' + friction + weight = gain u - kv q'

of which gain / J and (kv + f) / J show. A velocity servo, whose gain is kv, tells kv / J and f / J apart.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from diagnose.data.experiment import measured_velocity
from diagnose.thresholds import MATERIAL
from mjsim.axis import Axis, Chain
from mjsim.control import as_driven
from mjsim.errors import InputError
from mjsim.recording import Recording
from mjsim.servo import Target
from mjsim.system import assemble

__all__ = ["as_servo", "command_of"]

WEIGHT = "gravity_load@arm.torque_Nm"
NO_ANGLE = (
    "No angle is recorded: the velocity is judged, and the angle counts from 0 at the first sample. Effects that depend on where "
    "the axis stands (weight, springs, ripple, stops) show only as far as the velocity tells the angle."
)
DRIVE_OFF = "The drive is off: the input is zero, and the motion is that from the first sample on."
IDLE = "Actuator {name!r} has the further input {inputs}, of which a log holds nothing: it is taken as zero."
SCALE_BY_WEIGHT = (
    "The drive is off, so that the motion tells ratios of torques only. The weight is taken as the model has it "
    "({weight:.4g} N m): an error of it scales all inertias, frictions and stiffnesses alike. A payload that is weighed, or a "
    "recording with a known torque, tells."
)
SCALE_BY_INERTIA = (
    "The drive is off and the model has no weight, so that the motion tells ratios to the inertia only (friction/J, "
    "stiffness/J): {name} is held at {value:.4g} as in the model. A known weight, or a recording with a known torque, tells."
)


def as_servo(
    nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording]
) -> tuple[Axis, list[Recording], list[Recording], tuple[str, ...]]:
    """Model and recordings with one input, a torque or a command; and what is held as given, in words.

    Raises InputError where a servo's log has no command, or a torque-driven model's none of the torque.
    """
    recordings, held_out = ([as_driven(nominal.chain, r) for r in group] for group in (recordings, held_out))
    every = [*recordings, *held_out]
    said = tuple(dict.fromkeys(note for r in every for note in r.notes))
    if not all(r.driven for r in every):
        return _undriven(nominal, recordings, held_out, said)
    if nominal.chain.servo is None:
        for r in every:
            if np.isnan(r.torque).any():
                raise InputError(
                    r.source, "it holds the command of a servo and no torque", "a torque, as the model's <motor> has it",
                    "use a servo in the model (<position kp=... kv=...>), or record the torque",
                )  # fmt: skip
        unused = {key for r in every for key in r.known if key in ("kp", "kv")}
        if unused:
            said = (*said, f"[experiment] {', '.join(sorted(unused))}: not used, since the model has no servo.")
        fitted, kept = ([dataclasses.replace(r, command=None) for r in group] for group in (recordings, held_out))
        return nominal, fitted, kept, (*said, *_supply(every))
    for r in every:
        command_of(nominal.chain, r)
        if r.angle is None and nominal.chain.servo.target is not Target.VELOCITY:
            raise InputError(r.source, "a command and no angle", "the angle of the joint", "record or bind it")
    chain, notes = _known(nominal.chain, recordings, held_out)
    chain, more = _held(nominal, chain, recordings)
    if chain.idle:
        more.append(IDLE.format(name=chain.actuator, inputs=" and ".join(chain.idle)))
    if every[0].angle is None:
        more.append(NO_ANGLE)
    fitted, kept = (
        [r if r.angle is None else dataclasses.replace(r, velocity=None) for r in group] for group in (recordings, held_out)
    )
    return dataclasses.replace(nominal, chain=chain), fitted, kept, (*said, *_supply(every), *notes, *more)


def command_of(chain: Chain, recording: Recording) -> np.ndarray:
    """The command (N,) of the servo of a chain. Raises InputError for a recording without one."""
    if recording.command is None:
        raise InputError(
            recording.source, f"no command, and {chain.actuator!r} of the model is a servo", "a column command_rad",
            "bind it ([recording] command = ...), or drive the model by <motor>",
        )  # fmt: skip
    return recording.command


def _undriven(
    nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], said: Sequence[str]
) -> tuple[Axis, list[Recording], list[Recording], tuple[str, ...]]:
    """As `as_servo`, where no input acts: the inertia, or the weight where the model has one, sets the scale of all torques."""
    for r in (*recordings, *held_out):
        if r.driven:
            raise InputError(
                r.source,
                "its drive was on, and that of other recordings was off",
                "recordings of one kind",
                "diagnose them apart",
            )
    weight, chain, held = _weight(nominal), nominal.chain, tuple[str, ...]()
    if all(r.known_torque is not None for r in recordings):
        note = "The torque that is known sample by sample sets the scale of all torques."
    elif weight > 0:
        held, note = (WEIGHT,), SCALE_BY_WEIGHT.format(weight=weight)
    else:
        first = chain.linear_parameters()[0]
        held, note = (first.name,), SCALE_BY_INERTIA.format(name=first.name, value=first.value)
    chain = dataclasses.replace(chain, driven=False, held=tuple(dict.fromkeys((*chain.held, *held))))
    effects = tuple(e for e in nominal.effects if e.place != "actuator")
    return dataclasses.replace(nominal, chain=chain, effects=effects), list(recordings), list(held_out), (*said, DRIVE_OFF, note)


def _weight(nominal: Axis) -> float:
    """The torque of the weight in the model [N m], 0 where it has none."""
    found = next((e for e in nominal.effects if e.key == WEIGHT.rpartition(".")[0]), None)
    return 0.0 if found is None else found.values["torque_Nm"]


def _supply(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A note where the supply voltage is stated."""
    stated = any("supply_V" in r.known for r in recordings)
    return ("[experiment] supply_V: not used, since no effect depends on the supply voltage.",) if stated else ()


def _known(chain: Chain, recordings: Sequence[Recording], held_out: Sequence[Recording]) -> tuple[Chain, list[str]]:
    """The chain with the gains that the experiments state, which are then held. A held-out recording may leave them out."""
    assert chain.servo is not None
    notes, servo, held = [], chain.servo, list(chain.held)
    for name, unit in (("kp", "N m/rad"), ("kv", "N m s/rad")):
        values = {r.known.get(name) for r in recordings} | {r.known[name] for r in held_out if name in r.known}
        if values == {None}:
            continue
        if len(values) > 1:
            raise InputError("[experiment]", f"{name} differs between the recordings", "one value", "diagnose them apart")
        value = values.pop()
        assert value is not None
        if name == "kp" and servo.target is Target.VELOCITY:
            raise InputError("[experiment] kp", f"{chain.actuator!r} is a velocity servo", "kv", "rename the key, or remove it")
        servo = dataclasses.replace(servo, kp=value) if name == "kp" else dataclasses.replace(servo, kv=value)
        held.append(name)
        notes.append(f"{name} = {value:.6g} {unit} is known from the experiment, and held.")
    return dataclasses.replace(chain, servo=servo, held=tuple(held)), notes


def _held(nominal: Axis, chain: Chain, recordings: Sequence[Recording]) -> tuple[Chain, list[str]]:
    """The chain with what these recordings cannot tell held, and why."""
    servo = chain.servo
    assert servo is not None
    held, notes = list(chain.held), []
    main = "kv" if servo.target is Target.VELOCITY else "kp"
    weight = _weight(nominal)
    logged = f"command and {'velocity' if recordings[0].angle is None else 'angle'}"
    ratios = f"{'gain/J, ' if servo.back_emf else ''}{main}/J, friction/J"
    if main in held:
        pass
    elif all(r.known_torque is not None for r in recordings):
        notes.append("The torque that is known sample by sample sets the scale of all torques.")
    elif weight > 0:
        held.append(WEIGHT)
        notes.append(
            f"{logged[0].upper()}{logged[1:]} tell ratios of torques only. The weight is taken as the model has it "
            f"({weight:.4g}): an error of it scales all gains, frictions and inertias. A known payload, or "
            f"{main} stated in [experiment], tells."
        )
    else:
        first = chain.linear_parameters()[0]
        held.append(first.name)
        notes.append(
            f"Without a weight or another known torque, {logged} tell ratios to the inertia only ({ratios}): "
            f"{first.name} is held at {first.value:.4g} as in the model. A known payload, or {main} stated in [experiment], "
            "tells."
        )
    if servo.kv != 0 and "kv" not in held and (main != "kv" or servo.back_emf):
        held.append(next(p.name for p in chain.linear_parameters() if p.kind == "viscous"))
        what = "kv, the back-EMF," if servo.back_emf else "kv"
        notes.append(f"{what} and the viscous friction of the joint act alike: only their sum shows, and kv is fitted.")
    held = [*held, *(["limit"] if np.isfinite(servo.limit) and not _reached(nominal, recordings) else [])]
    return dataclasses.replace(chain, held=tuple(dict.fromkeys(held))), notes


def _reached(nominal: Axis, recordings: Sequence[Recording]) -> bool:
    """Whether the recorded error asks the nominal servo for its force limit."""
    s, servo = assemble(nominal), nominal.chain.servo
    assert servo is not None
    for r in recordings:
        angle = 0.0 if r.angle is None else r.angle  # a servo that follows a velocity asks nothing of it
        asked = s.gain * (servo.scale * r.input - servo.zero) - s.servo[0] * angle - s.servo[1] * measured_velocity(r)
        if np.max(np.abs(asked)) > (1.0 - MATERIAL) * s.servo[2]:
            return True
    return False
