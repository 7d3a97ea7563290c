"""Axis -> a corrected copy of an authored MJCF."""

from __future__ import annotations

import contextlib
import dataclasses
import tempfile
import textwrap
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mjsim.axis import Axis
from mjsim.effects import Effect, NotApplicableError, registered
from mjsim.effects.native import ServoIntegral
from mjsim.errors import InputError
from mjsim.mjcf import custom
from mjsim.mjcf.compile import save_compiled
from mjsim.mjcf.editor import MjcfEditor
from mjsim.mjcf.linear import LinearWriter
from mjsim.mjcf.load import Model, load_model
from mjsim.mjcf.native_read import read_native
from mjsim.mjcf.native_write import FRICTION_STEP, NativeWriter
from mjsim.mjcf.servo_write import write_servo
from mjsim.mjcf.xmltext import XmlText

__all__ = ["UNFAITHFUL", "Written", "check_writable", "write_corrected"]

UNFAITHFUL = "MuJoCo does not step any form of it to within its tolerance with this file's options"


@dataclass(frozen=True)
class Written:
    """The file that was written, and one line for each thing that plain MuJoCo lacks in it (simgap has it)."""

    path: Path
    lacks: tuple[str, ...]


def write_corrected(
    nominal_path: str | Path, axis: Axis, out_path: str | Path, comment: str = "", *, carried_only: Container[str] = (),
    friction_step: float = FRICTION_STEP,
) -> Written:  # fmt: skip
    """Write a copy of an authored MJCF that holds this axis: its linear parameters and all of its effects.

    What MJCF expresses is written by its own elements; everything is carried in ``<custom>``, which `load_axis` reads back and
    which alone counts there, so that nothing acts twice. ``comment`` stands at the head of the correction; effects whose key is
    in ``carried_only`` are not written by MJCF's elements. ``friction_step``: largest timestep [s] beside dry friction. The rest
    of the file stays as its author left it. A file that was corrected before is first taken back to what it was.
    """
    nominal, out = Path(nominal_path), Path(out_path)
    source = load_model(nominal, actuator=axis.chain.actuator)
    _same_shape(nominal, source.axis, axis)
    with tempfile.TemporaryDirectory() as work:
        if source.carried is not None:
            source = _restored(source, Path(work) / "nominal.xml")
        editor = MjcfEditor(source.path, source.found)
        lacks = _write_axis(editor, source, axis, carried_only, friction_step)
        editor.relocate(out)
        beside = nominal.with_suffix(".toml")
        binding = source.carried.binding if source.carried else ""
        carried = custom.Carried(
            axis.effects, axis.backlash_law, tuple(editor.ignored),
            (
                ("actuator", axis.chain.actuator), ("velocity_sensor", axis.chain.velocity_sensor),
                ("angle_sensor", axis.chain.angle_sensor),
            ),
            tuple(editor.added), tuple(editor.undo),
            beside.read_text(encoding="utf-8") if beside.is_file() else binding,
            lacks, _zero_of(axis, lacks),
        )  # fmt: skip
        lines = _head(editor, axis, [line for _, line in lacks], comment)
        editor.xml.append(editor.xml.root, ["<custom>", *(f"  {x}" for x in lines), *(f"  {x}" for x in custom.element(carried)),
                                            "</custom>"])  # fmt: skip
        save_compiled(editor.xml.raw, out)
    return Written(out, tuple(line for _, line in lacks))


def _zero_of(axis: Axis, lacks: Sequence[tuple[str, str]]) -> tuple[tuple[str, float], ...]:
    """The zero of a servo with integral action, which a ``<pid>`` lacks; nothing where it is 0 or no ki is written."""
    without = {key for key, _ in lacks}
    written = any(isinstance(v, ServoIntegral) for e in axis.effects if e.key not in without for v in e.native(axis.chain).values)
    servo = axis.chain.servo
    return (("zero", servo.zero),) if written and servo is not None and servo.zero else ()


def check_writable(model_path: str | Path, axis: Axis | None = None) -> None:
    """Dry run of `write_corrected`: whether every number of a model can be written back into its file.

    Every linear parameter and every effect that the file has is changed by a hundredth, written to a temporary folder and read
    back; every registered effect that the chain has a place for is written once. ``axis``: the model's, loaded when None. Raises
    InputError, which says what cannot be written and why.
    """
    path = Path(model_path)
    axis = load_model(path).axis if axis is None else axis
    linear = {p.name: 1.01 * p.value for p in axis.chain.linear_parameters() if p.value}
    effects = tuple(e.with_values({n: 0.99 * e.values[n] for n in type(e).amplitudes}) for e in axis.effects)
    changed = dataclasses.replace(axis.with_linear(linear), effects=effects)
    with tempfile.TemporaryDirectory() as work:
        out = Path(work) / path.name
        write_corrected(path, changed, out)
        found = {p.name: p.value for p in load_model(out).axis.chain.linear_parameters()}
        for name, value in linear.items():
            if not np.isclose(found.get(name, np.nan), value, rtol=1e-6):
                raise InputError(path, f"{name} is not read where it is written", "one element for each number", "name them")
        source = load_model(path, actuator=axis.chain.actuator)
        if source.carried is not None:
            source = _restored(source, Path(work) / "nominal.xml")
        for effect in _one_of_each(axis):
            editor = MjcfEditor(source.path, source.found)
            writer = NativeWriter(editor, LinearWriter(editor, axis.chain), axis.backlash_law, read_native(source.found, path))
            for part in effect.native(axis.chain).values:
                writer.write(part)
            writer.close()


def _one_of_each(axis: Axis) -> Iterator[Effect]:
    """Every registered effect at every place that the chain has."""
    for cls in registered().values():
        anything = {s.name: min(max(1.0, s.lower), s.upper) for s in cls.specs()}
        for place in cls.places:
            effect = cls(place=place, **anything)
            with contextlib.suppress(NotApplicableError):
                effect.ports(axis.chain)
                yield effect


def _write_axis(
    editor: MjcfEditor, source: Model, axis: Axis, carried_only: Container[str] = (), friction_step: float = FRICTION_STEP
) -> tuple[tuple[str, str], ...]:
    """Write the linear parameters and the effects of an axis; returns (effect, line) for what plain MuJoCo lacks of them."""
    linear = LinearWriter(editor, axis.chain)
    linear.write()
    write_servo(editor, axis.chain.servo)
    writer = NativeWriter(editor, linear, axis.backlash_law, read_native(source.found, source.path), friction_step)
    own, kept = {e.key: e for e in source.axis.effects}, {e.key for e in axis.effects}
    for e in own.values():
        if e.key not in kept:  # another law has taken its place
            for value in e.with_values(dict.fromkeys(type(e).amplitudes, 0.0)).native(source.axis.chain).values:
                writer.write(value)
    lacks = []
    for e in axis.effects:
        native = e.native(axis.chain)
        if own.get(e.key) == e:  # what the author wrote by MJCF's own elements and still holds stands there already
            for value in native.values:
                writer.keep(value)
            continue
        if e.key in carried_only:
            lacks.append((e.key, f"{e.subject}: {UNFAITHFUL}"))
            continue
        said = [native.lacks, *(f"{e.subject}: {line}" for line in map(writer.write, native.values) if line)]
        lacks += [(e.key, line) for line in said if line]
    writer.close()
    return tuple(lacks)


def _same_shape(path: Path, nominal: Axis, axis: Axis) -> None:
    a, b = nominal.chain, axis.chain
    names = [[x.joint for x in c.bodies] + [x.joint for x in c.couplings] for c in (a, b)]
    ratios = ([c.ratio for c in a.couplings], [c.ratio for c in b.couplings])
    if names[0] != names[1] or not np.allclose(*ratios, rtol=1e-9) or not np.isclose(a.gain, b.gain, rtol=1e-9):
        raise InputError(
            path, "the axis is not this model's", "bodies, ratios and gain as in the file", "load the axis from this file"
        )


def _restored(source: Model, at: Path) -> Model:
    """The file before its correction, written to ``at``."""
    assert source.carried is not None
    editor = MjcfEditor(source.path, source.found)
    editor.undo_all(list(source.carried.undo), list(source.carried.added))
    drop(editor.xml)
    editor.relocate(at)
    at.write_bytes(editor.xml.raw)
    bound = dict(source.carried.bound)
    again = load_model(at, bound=bound)
    return Model(at, again.found, again.axis, source.carried)


def drop(xml: XmlText) -> None:
    """Remove the <custom> section of an earlier correction."""
    node = xml.find(lambda n: n.tag == "text" and n.attributes.get("name") == custom.NAME)
    if node is not None:
        alone = node.parent is not None and len(node.parent.children) == 1
        xml.remove(node.parent if alone and node.parent is not None else node)


def _head(editor: MjcfEditor, axis: Axis, lacks: list[str], comment: str) -> list[str]:
    """The comment that says what was changed and what plain MuJoCo lacks."""
    parts = [comment] if comment else []
    changed = [
        f"{new.name} {old.value:.6g} -> {new.value:.6g} {new.quantity.unit(axis.chain.motion)}"
        for old, new in zip(editor.chain.linear_parameters(), axis.chain.linear_parameters(), strict=False)
        if old.name == new.name and not np.isclose(old.value, new.value, rtol=1e-12, atol=0.0)
    ]
    parts.append("Corrected by simgap" + (": " + ", ".join(changed) if changed else "") + ".")
    parts += [e.describe(axis.chain.motion) for e in axis.effects]
    parts += [f"Plain MuJoCo lacks: {line}." for line in lacks]
    parts.append("simgap reads the effects from the text below, and from there only.")
    lines = [line for p in parts for line in textwrap.wrap(p.replace("--", "- -"), 120, subsequent_indent="  ")]
    return ["<!--", *(f"  {line}" for line in lines), "-->"]
