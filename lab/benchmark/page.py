"""``benchmark.html``: the figures of ``benchmark.json`` on one self-contained page, for light, dark and paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from lab.benchmark import page_pictures as pictures
from lab.benchmark.catalogue import OUTSIDE
from lab.benchmark.score import NULLS

__all__ = ["LEVEL_NAMES", "Manner", "render_page"]

LEVEL_NAMES = {
    "plain": "Plain",
    "under_noise": "Hidden under noise",
    "behind_refit": "Hidden behind a refit",
    "behind_feedback": "Hidden behind feedback",
    "two_effects": "Two effects",
    "other_law": "By another law",
    "out_of_library": "Outside the library",
    "nothing": "Nothing missing",
    "parameters_only": "Parameters only",
    "faint": "Faint",
    "coloured": "Beside noise that is not white",
}


@dataclass(frozen=True)
class Manner:
    """How the project writes its pages: numbers, shares, names of effects, tables, the switch of colours, the document.

    Handed in, since this package knows nothing of the diagnosis. table(heads, rows, numeric, wide, chosen): HTML;
    document(title, body, style): the page.
    """

    number: Callable[..., str]
    percent: Callable[..., str]
    effect: Callable[[str], str]
    table: Callable[..., str]
    theme_button: str
    document: Callable[..., str]


STYLE = """
:root { --equal: light-dark(#5aa2e0, #3f78ad); --extra: light-dark(#b9d7f2, #274c70); --part: light-dark(#e3b15f, #a87b2e); }
.picture svg { max-width: 60rem; }
@media (max-width: 44rem) { .picture svg { min-width: 38rem; } }
.confusion { font-size: .8rem; } .confusion td, .confusion thead th { padding: .15rem 0; text-align: center; min-width: 1.5rem; }
.confusion thead th { height: 11.5rem; vertical-align: bottom; }
.confusion thead th span { writing-mode: vertical-rl; transform: rotate(180deg); white-space: nowrap; }
.confusion tbody th { white-space: nowrap; padding: .15rem .6rem .15rem 0; }
.confusion td.same { background: var(--info-bg); color: var(--info); font-weight: 650; }
.confusion td.off { background: var(--alarm-bg); color: var(--alarm); }
.confusion td.quiet { background: var(--panel); color: var(--muted); }
"""


def render_page(summary: Mapping[str, Any], manner: Manner) -> tuple[str, dict[str, str]]:
    """(the page, its pictures by name as files of their own) of a ``benchmark.json``."""
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    def level(name: str) -> str:
        return LEVEL_NAMES.get(name, manner.effect(name))

    drawn = {"levels": pictures.levels(summary["levels"], level)}
    power = summary["power"]
    if power["detected"]["n"]:
        drawn["power"] = pictures.power(power["detected"], power["named"])
        drawn["effects"] = pictures.small_power(power["by_effect"], manner.effect)
        curved = {effect: c for effect, c in power["by_effect"].items() if any(c["detected"]["at50_ci95"])}
        if curved:
            drawn["power_by_effect"] = pictures.power_grid(curved, manner.effect)
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, extensions=["jinja2.ext.do"]
    )
    environment.filters |= {
        "number": manner.number,
        "percent": manner.percent,
        "effect": manner.effect,
        "key": lambda key: _key(key, manner.effect),
        "level": level,
    }
    text = (files("lab.benchmark") / "page.html.j2").read_text(encoding="utf-8")
    body = environment.from_string(text).render(
        s=summary,
        table=manner.table,
        theme_button=Markup(manner.theme_button),
        own=lambda arms: [i for i, a in enumerate(arms) if a["id"] == "simgap"],
        drawn={k: Markup(v) for k, v in drawn.items()},
        holds=sum(b["status"] == "holds" for b in summary["bars"]),
        fails=sum(b["status"] == "fails" for b in summary["bars"]),
        open=sum(b["status"] == "too few cases" for b in summary["bars"]),
        nulls=NULLS,
        outside={e.effect for e in OUTSIDE},
        wrong=[c for c in summary["cases"] if not c["good"] and (c["level"] != "faint" or c["verdict"] == "missing_physics")],
    )
    page = manner.document(f"Benchmark: {summary['n']} concealed cases", body, style=STYLE)
    return page, {name: pictures.standalone(svg) for name, svg in drawn.items()}


def _key(key: str, effect: Callable[[str], str]) -> str:
    """``effect@place`` in words."""
    name, _, place = key.partition("@")
    return f"{effect(name)} ({place})" if place else effect(name)
