"""What was understood of the model and of the recordings, in one sentence a topic."""

from __future__ import annotations

from collections.abc import Sequence

from diagnose.check.context import Context
from diagnose.check.faults.hold import tell_hold
from diagnose.check.machine import Machine
from diagnose.check.unused import unused_channels

__all__ = ["understood"]

NONE = "none: the drive is off, and the motion is that from the first sample on."


def understood(contexts: Sequence[Context], machine: Machine) -> dict[str, str]:
    """Topic -> sentence."""
    chain, slide = machine.chain, not machine.hinge
    inertia, stiffness, damping = ("kg", "N/m", "N s/m") if slide else ("kg m^2", "N m/rad", "N m s/rad")
    bodies = ", ".join(
        f"{b.place} (joint {b.joint!r}, inertia {b.inertia:.4g} {inertia}"
        + (f", damping {b.viscous:.4g} {damping})" if b.viscous else ")")
        for b in chain.bodies
    )  # fmt: skip
    out = {"chain": f"{len(chain.bodies)} {'inertia' if len(chain.bodies) == 1 else 'inertias'}: {bodies}."}
    if chain.couplings:
        out["couplings"] = "; ".join(
            f"{c.place}: ratio {c.ratio:.6g}, stiffness {c.stiffness:.4g} {stiffness}, damping {c.damping:.4g} {damping}"
            for c in chain.couplings
        ) + "."  # fmt: skip
    out["gear"] = ", ".join(f"{g:.6g}" for g in machine.gears) if machine.gears else "none: every side has one ratio"
    driven = chain.driven and all(c.recording.driven for c in contexts)
    name = f"actuator {chain.actuator!r}" if chain.actuator else "the actuator"
    out["input"] = f"{name}, {chain.gain:.6g} {'N' if slide else 'N m'} at the joint per unit of input."
    if not driven:
        out["input"] = NONE if chain.driven else f"{NONE} The model has no actuator."
    effects = "; ".join(e.describe(chain.motion) for e in machine.axis.effects)
    out["effects in the file"] = effects or "none."
    if machine.modes:
        out["modes"] = ", ".join(f"{m:.4g} Hz" for m in machine.modes)
    for context in contexts:
        out[context.recording.source] = _log(context)
    unused = unused_channels((c.recording for c in contexts), servo=chain.servo is not None)
    if unused:
        out["channels not fitted"] = " ".join(unused)
    return out


def _log(context: Context) -> str:
    r = context.recording
    rate = 1 / r.dt
    channels = [
        n
        for n in ("command", "torque", "velocity", "angle", "second_angle", "second_velocity", "current", "supply")
        if getattr(r, n, None) is not None and (r.driven or n != "torque")
    ]
    units = ", ".join(f"{c} [{r.units[c]}]" if r.units.get(c) else c for c in channels)
    loop = {
        None: "Not stated whether a controller feeds the motion back",
        "open": "Open loop",
        "closed": "A controller feeds back",
    }
    hold = f"input {context.hold}" + (" as stated" if context.hold_is_stated else " (assumed)")
    told = tell_hold(context)
    if context.hold_is_stated:
        how = ""
    elif told is None or told.hold is None:
        how = ', not told by the data: say [recording] hold = "held", "linear" or "mean"'
    else:
        how = f", and the data show it {told.hold}"
    noise = ", ".join(f"{v:.3g} in the {n}" for n, v in context.noise.items())
    fed = f"{loop.get(r.loop, r.loop)}; {hold}{how}. " if r.driven else ""
    notes = "".join(f" {note}" for note in r.notes)
    return f"{len(r)} samples, {rate:.6g} a second, {r.duration:.4g} s; {units}. {fed}Noise rms {noise or 'not told'}.{notes}"
