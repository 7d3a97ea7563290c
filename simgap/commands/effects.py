"""``simgap effects``: the library of effects: law, parameters with units, places, source, all from the registry."""

from __future__ import annotations

import inspect
import json
import math
from typing import TYPE_CHECKING, Any

import click

from simgap.arguments import complete_effects

if TYPE_CHECKING:
    from mjsim.effects import Effect, ParameterSpec

__all__ = ["command", "described", "library"]


def library() -> dict[str, list[type[Effect]]]:
    """Classes of each effect that a diagnosis can name, by its identifier: the law itself first, then its other forms."""
    from mjsim.effects import registered

    out: dict[str, list[type[Effect]]] = {}
    for cls in registered().values():
        out.setdefault(cls.name(), []).append(cls)
    return {name: sorted(forms, key=lambda c: c.id != name) for name, forms in out.items()}


def described(cls: type[Effect]) -> dict[str, Any]:
    """What the registry holds of one effect, as plain values."""
    title, law = _law(cls)
    return {
        "id": cls.id,
        "name": cls.name(),
        "title": title,
        "law": law,
        "sentence": cls.sentence,
        "places": list(cls.places),
        "family": cls.family,
        "refines": list(cls.refines),
        "parameters": {s.name: _parameter(s) for s in cls.specs()},
        "tolerance": cls.tolerance,
        "source": cls.citation,
    }


def _parameter(spec: ParameterSpec) -> dict[str, Any]:
    from mjsim.quantity import Motion

    bounds = [None if math.isinf(x) else x for x in (spec.lower, spec.upper)]
    return {
        "about": spec.about, "unit": spec.unit(), "unit_slide": spec.unit(Motion.SLIDE), "lower": bounds[0], "upper": bounds[1],
        "per_recording": spec.nuisance,
    }  # fmt: skip


def _law(cls: type[Effect]) -> tuple[str, str]:
    """Title and law: the first paragraph and the rest of the text of the file that holds the effect."""
    text = inspect.getdoc(inspect.getmodule(cls)) or ""
    title, _, law = text.partition("\n\n")
    return " ".join(title.split()), law.strip().replace("``", "")


def _show(forms: list[type[Effect]]) -> None:
    for i, cls in enumerate(forms):
        about = described(cls)
        click.echo(("" if i == 0 else "\nanother law of the same effect: ") + cls.id)
        click.echo(f"  {about['title']}\n")
        for line in about["law"].splitlines():
            click.echo(f"    {line}" if line else "")
        click.echo(f"\n  places      {', '.join(cls.places)}")
        for name, p in about["parameters"].items():
            units = p["unit"] if p["unit"] == p["unit_slide"] else f"{p['unit']}; on a slide {p['unit_slide']}"
            click.echo(f"  parameter   {name} [{units}]: {p['about']}{_bounds(p)}")
        if cls.refines:
            click.echo(f"  extends     {', '.join(cls.refines)}")
        click.echo(f"  accuracy    ODE and MuJoCo agree within {cls.tolerance:g} (relative rms of the motor velocity)")
        click.echo(f"  source      {cls.citation}")


def _bounds(parameter: dict[str, Any]) -> str:
    low, high = parameter["lower"], parameter["upper"]
    if low is None and high is None:
        return ""
    if high is None:
        return f", at least {low:g}"
    return f", at most {high:g}" if low is None else f", from {low:g} to {high:g}"


@click.command("effects", epilog="Example: simgap effects backlash")
@click.argument("name", required=False, shell_complete=complete_effects)
@click.option("--json", "as_json", is_flag=True, help="Print the library, or the effect, as JSON.")
def command(name: str | None, as_json: bool) -> None:
    """List the effects that a diagnosis can name, or describe the effect NAME.

    The description holds the law, the places, the parameters with units and bounds, and the source in the literature.
    """
    from mjsim.effects.registry import named_instead
    from mjsim.errors import InputError

    known = library()
    ids = {cls.id: owner for owner, forms in known.items() for cls in forms}
    if name is not None and name not in ids:
        raise InputError(f"effect {name!r}", "not known", f"one of {', '.join(known)}", named_instead(name, ids))
    chosen = known if name is None else {ids[name]: known[ids[name]]}
    if as_json:
        listed = [described(cls) for forms in chosen.values() for cls in forms if name in (None, cls.name(), cls.id)]
        click.echo(json.dumps(listed, indent=1, ensure_ascii=False))
    elif name is not None:
        _show([cls for cls in chosen[ids[name]] if name in (cls.name(), cls.id)])
    else:
        width = max(map(len, known))
        for owner, forms in known.items():
            click.echo(f"{owner:{width}s}  {_law(forms[0])[0]}")
            click.echo(f"{'':{width}s}  at {', '.join(forms[0].places)}: {', '.join(s.name for s in forms[0].specs())}")
