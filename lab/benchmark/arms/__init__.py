"""Rival arms: other ways to model the same recordings, each one file behind one small interface (`base.Arm`).

They see what the diagnosis sees, two recordings and the nominal model, and stand on the fitting side: the generator, the scorer
and the page know of them only what they wrote down.
"""

from __future__ import annotations

from lab.benchmark.arms import box_jenkins, refitted, sparse, stepwise_bic, sysid
from lab.benchmark.arms.base import Answer, Arm, Task

__all__ = ["ARMS", "Answer", "Arm", "Task", "parse_arms"]

ARMS: dict[str, Arm] = {a.id: a for a in (refitted.ARM, sysid.ARM, box_jenkins.ARM, sparse.ARM, stepwise_bic.ARM)}


def parse_arms(text: str | None) -> tuple[Arm, ...]:
    """``--arms``: identifiers with commas, ``all``, or ``none``. Raises InputError that names the choices."""
    from mjsim.errors import InputError

    names = [n.strip() for n in (text or "none").split(",")]
    if names == ["none"]:
        return ()
    if names == ["all"]:
        return tuple(ARMS.values())
    for name in names:
        if name not in ARMS:
            raise InputError("--arms", f"{name!r} is not known", f"all, none, or some of {', '.join(ARMS)}")
    return tuple(ARMS[n] for n in dict.fromkeys(names))
