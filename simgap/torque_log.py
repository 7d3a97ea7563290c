"""The log of an axis that a torque drives, before the search: its check, and how the torque goes between samples."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from diagnose.check import LogCheck, Machine, check_log
from diagnose.check.found_hold import shows_hold, told_as_taken, with_found_hold
from diagnose.check.left_out import told_as_left_out, without_late_velocity
from diagnose.fit.command_hold import hold_shows, is_assumed, shown_hold, with_hold
from diagnose.options import Options
from mjsim.axis import Axis
from mjsim.mjcf import load_model
from mjsim.recording import Recording
from simgap.servo_log import with_taken

__all__ = ["checked_torque"]

Checked = tuple[LogCheck, Sequence[Recording], Sequence[Recording]]


def checked_torque(
    model: Path, nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options, *, accept: bool
) -> Checked:
    """The check of a log, and the recordings as they are taken.

    With the hold of the torque that they all show where none is stated, by their own relation of torque and motion or else by
    refits of the model; without a velocity that is late where the angle can take its place, unless they are to be taken as they
    are (``accept``).
    """
    machine, every = Machine.of(load_model(model)), [*recordings, *held_out]
    log = check_log(machine, every)
    other = with_found_hold(log, machine, recordings, held_out)
    if other is not None:
        recordings, held_out = other
        log = told_as_taken(log, check_log(machine, [*recordings, *held_out]))
    elif not log.to_fix() and not shows_hold(log):
        log, recordings, held_out = _by_refits(log, nominal, recordings, held_out, options)
    fewer = None if accept else without_late_velocity(log, recordings, held_out)
    if fewer is None:
        return log, recordings, held_out
    return told_as_left_out(log, check_log(machine, [*fewer[0], *fewer[1]])), *fewer


def _by_refits(
    log: LogCheck, nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options
) -> Checked:
    """With the hold under which the refitted model leaves less, of recordings whose motion is compared."""
    motion = recordings[0].velocity is not None and "force" not in (options.judge, recordings[0].judge)
    if not motion or not is_assumed([*recordings, *held_out]) or not hold_shows(nominal, recordings, held_out):
        return log, recordings, held_out
    hold = shown_hold(nominal, recordings, held_out, options.seconds)
    if hold == "held":
        return log, recordings, held_out
    taken = with_taken(log, hold, recordings)
    assert taken is not None
    return taken, with_hold(recordings, hold), with_hold(held_out, hold)
