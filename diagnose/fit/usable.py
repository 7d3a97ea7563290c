"""Recordings in the channels that are compared, and a fitter of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.data.channels import with_common_channels
from diagnose.data.derived import without_derived_velocity
from diagnose.data.experiment import corrected
from diagnose.data.servo import as_servo
from diagnose.data.split import Split
from diagnose.fit.fitter import Fitter
from diagnose.fit.ledger import Ledger
from diagnose.options import Options
from diagnose.problem.choose_view import choose_view, with_samples
from diagnose.problem.view import View
from mjsim.axis import Axis
from mjsim.errors import InputError
from mjsim.recording import Recording

__all__ = ["Usable"]


@dataclass(frozen=True)
class Usable:
    """A nominal axis and recordings of the channels that are compared, in which view.

    said: sentences on what was left out; derived: whether a velocity was, which was made of the angle.
    """

    nominal: Axis
    recordings: Sequence[Recording]
    held_out: Sequence[Recording]
    view: View
    said: tuple[str, ...]
    derived: bool

    @classmethod
    def of(cls, nominal: Axis, recordings: Sequence[Recording], held_out: Sequence[Recording], options: Options) -> Usable:
        """Those of a diagnosis. Raises InputError for recordings that cannot be used."""
        recordings, held_out, alike = with_common_channels(recordings, held_out)
        nominal, recordings, held_out, said = as_servo(nominal, recordings, held_out)
        given = recordings[0].velocity is not None and nominal.chain.servo is None
        recordings, held_out = ([without_derived_velocity(r) for r in group] for group in (recordings, held_out))
        derived = given and recordings[0].velocity is None
        view = choose_view(recordings, options.judge or recordings[0].judge or ("motion" if derived else None), nominal)
        return cls(nominal, recordings, held_out, view, (*alike, *said), derived)

    def fitter(
        self, experiments: Split, options: Options, corrections: Mapping[str, np.ndarray], ledger: Ledger | None = None
    ) -> Fitter:
        """A fitter of estimation and held-out experiments."""
        fitted, held = (corrected(group, corrections) for group in experiments)
        judged = with_samples(self.view, (*fitted, *held), self.nominal, options.judge)
        varies = _varies(self.nominal, self.recordings[0])
        return Fitter(self.nominal, judged, fitted, held, options.jobs, varies, ledger=ledger)


def _varies(nominal: Axis, recording: Recording) -> tuple[str, ...]:
    """The linear parameters that the binding says each recording has of its own."""
    known = [p.name for p in nominal.chain.linear_parameters()]
    for name in recording.varies:
        if name not in known:
            raise InputError("[experiment] varies", f"unknown linear parameter {name!r}", ", ".join(known), "correct the name")
    return recording.varies
