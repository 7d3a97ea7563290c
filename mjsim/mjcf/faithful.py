"""The form of a corrected file that MuJoCo steps as the equations say, of the few that there are.

A form is accepted once the file, stepped by MuJoCo with its own options, differs from the equations by no more than is
allowed. They are tried in this order: the author's own solver settings; stiff dry friction at the author's timestep, and at ever
shorter ones down to that of `write_corrected`; its settings with the Euler integrator, which alone does the bristles of
`<dcmotor lugre>` justice; a timestep that is a fifth; and last, one effect less by MJCF's elements, which is then carried for
simgap only. What a form costs stands in a comment of the file.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mjsim.axis import Axis
from mjsim.effects import BacklashLaw, Effect
from mjsim.effects.native import JointRange, Slack
from mjsim.effects.ports import Friction, Gap
from mjsim.mjcf.adjust import adjust, author_settings
from mjsim.mjcf.compile import compile_file
from mjsim.mjcf.custom import Edit
from mjsim.mjcf.load import effect_of, load_model
from mjsim.mjcf.native_write import FRICTION_STEP
from mjsim.mjcf.write import write_corrected

__all__ = ["AUTHOR", "Faithful", "as_plain", "has_dry_friction", "nearest_native", "write_as_author", "write_faithful"]

AUTHOR = "the author's settings"
FINER = 5  # times the timestep
SHORTER = (1, 4)  # parts of the author's timestep at which stiff friction is tried, where `write_corrected` would take less
EXACT = 1e-9

Writer = Callable[[Axis, Path], tuple[str, ...]]


@dataclass(frozen=True, eq=False)
class Faithful:
    """The form that was written: its name, how far MuJoCo is from the equations with it, what plain MuJoCo lacks, its writer."""

    form: str
    differs: float
    lacks: tuple[str, ...]
    write: Writer


def write_faithful(model: Path, axis: Axis, out: Path, differs: Callable[[Path], tuple[float, bool]]) -> Faithful:
    """Write the first form that is near enough, else the one nearest.

    ``differs`` tells how far MuJoCo's steps of a file are from the equations, and whether that is near enough. Raises InputError
    when no form can be written.
    """
    best: Faithful | None = None
    out.parent.mkdir(parents=True, exist_ok=True)
    kept, trial = (out.with_name(f".{out.stem}.{name}.part.xml") for name in ("best", "trial"))  # beside it: assets are found
    try:
        for name, write in _forms(model, axis):
            lacks = write(axis, trial)
            d, near = differs(trial)
            if best is None or near or d < best.differs:
                best = Faithful(name, d, lacks, write)
                os.replace(trial, kept)
            if near:
                break
        assert best is not None
        os.replace(kept, out)
    finally:
        for path in (kept, trial):
            path.unlink(missing_ok=True)
    return best


def _forms(model: Path, axis: Axis) -> Iterator[tuple[str, Writer]]:
    own = load_model(model).axis.effects
    changed = [e for e in axis.effects if e.key not in {o.key for o in own}]

    def plain(axis: Axis, at: Path) -> tuple[str, ...]:
        return write_corrected(model, axis, at).lacks

    def finer(axis: Axis, at: Path, euler: bool, parts: int) -> tuple[str, ...]:
        lacks = plain(axis, at)
        step = float(compile_file(at).opt.timestep) / parts
        edits: list[Edit] = [("option", "", "integrator", "Euler")] if euler else []
        edits += [("option", "", "timestep", repr(float(f"{step:.12g}")))] if parts > 1 else []
        said = ["the Euler integrator"] * euler + [f"a timestep of {step:.3g} s, {parts} times the steps"] * (parts > 1)
        adjust(at, edits, f"MuJoCo steps what was found with {' and '.join(said)}.")
        return lacks

    def without(axis: Axis, at: Path, key: str) -> tuple[str, ...]:
        return write_corrected(model, axis, at, carried_only=(key,)).lacks

    def coarser(axis: Axis, at: Path, step: float) -> tuple[str, ...]:
        return write_corrected(model, axis, at, friction_step=step).lacks

    if has_dry_friction(axis) or any(isinstance(port, Gap) for e in own for port in e.ports(axis.chain)):
        yield AUTHOR, partial(write_as_author, model)
    if has_dry_friction(axis):
        step = float(compile_file(model).opt.timestep)
        for parts in SHORTER:
            if step / parts > FRICTION_STEP * (1 + EXACT):
                yield "stiff friction at a long timestep", partial(coarser, step=step / parts)
    yield "stiff settings", plain
    if changed:
        yield "Euler integrator", partial(finer, euler=True, parts=1)
        yield "finer timestep", partial(finer, euler=False, parts=FINER)
        yield "finer timestep, Euler integrator", partial(finer, euler=True, parts=FINER)
    for e in changed:
        yield f"{e.key} carried only", partial(without, key=e.key)


def _found_ranges(axis: Axis) -> set[str]:
    """The driven joint, where an effect of the axis is its range."""
    values = (v for e in axis.effects for v in e.native(axis.chain).values)
    return {axis.chain.bodies[0].joint or ""} if any(isinstance(v, JointRange) for v in values) else set()


def has_dry_friction(axis: Axis) -> bool:
    """Whether an effect of the axis is dry friction, which MuJoCo has with solver settings of its own."""
    return any(isinstance(port, Friction) for e in axis.effects for port in e.ports(axis.chain))


def as_plain(axis: Axis, lacks: Container[str]) -> Axis:
    """The axis as far as MJCF's own elements express it, where plain MuJoCo lacks something of the effects with these keys.

    Of an effect with native values there is what these are, of a gap whose damper is outside it one with the damper inside.
    """
    effects: list[Effect] = []
    law = axis.backlash_law
    for e in axis.effects:
        native = e.native(axis.chain)
        if e.key not in lacks:
            effects.append(e)
        elif native.lacks:
            effects += [effect_of(value, axis.chain, Path(e.key)) for value in native.values]
        elif any(isinstance(value, Slack) for value in native.values):
            law = BacklashLaw.UNGATED
            effects.append(e)
    return Axis(axis.chain, tuple(effects), law)


def nearest_native(axis: Axis, lacks: Container[str], speed: float) -> Axis:
    """The axis that MJCF's own elements have in place of effects with these keys: their native values, else what comes nearest.

    Nearest about a speed [rad/s | m/s] of the bodies (`Effect.nearest`). Effects that nothing comes near are left out.
    """
    out = as_plain(axis, lacks)
    for e in axis.effects:
        found = e.nearest(out.chain, speed) if e.key in lacks and not e.native(axis.chain).values else None
        if found is not None:
            there = {own.key for own in out.effects}
            out = Axis(found[0], (*out.effects, *(n for n in found[1] if n.key not in there)), out.backlash_law)
    return out


def write_as_author(model: Path, axis: Axis, out: Path) -> tuple[str, ...]:
    """`write_corrected` with the solver settings of the author's dry friction and limits; what plain MuJoCo lacks."""
    lacks = write_corrected(model, axis, out).lacks
    carried = load_model(out, bound={}).carried
    if carried is not None:
        adjust(out, author_settings(carried, _found_ranges(axis)))
    return lacks
