"""Pages of the documentation that are generated while MkDocs builds it: commands from click, effects from the registry with a
picture each, the keys of the JSON files, and the notebooks as pages.
"""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np
from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parent))
import notebook_pages

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.pages import Page

    from mjsim.axis import Axis
    from mjsim.effects import Effect

LINK = re.compile(r"(?<!!)\[(?P<text>[^\]]+)\]\((?P<to>\.\.?/[^)\s]+)\)")
DT, SECONDS = 5e-4, 3.0
PERIODS = 4  # of the chirp, that a picture shows
DRIVE = {"robot_axis1": (1.0, 0.5, 30.0), "pendulum": (0.5, 0.3, 4.0)}  # amplitude and band of the chirp [N m | rad, Hz]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is generated to the files of the site."""
    root = Path(config.docs_dir)
    pages: dict[str, str | bytes] = {"reference/commands.md": commands(), "reference/json.md": json_keys()}
    pages |= dict(notebook_pages.pages(root / "notebooks", root.parent))
    pictures = dict(effect_pictures())
    pages["reference/effects.md"] = effects({name.partition("@")[0] for name in pictures})
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    for name, data in pictures.items():
        files.append(File.generated(config, f"reference/effects/{name.partition('@')[0]}.png", content=data))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The page with links to files of the repository that are no part of the site as plain text."""
    root = Path(config.docs_dir)
    here = (root / page.file.src_uri).parent

    def plain(link: re.Match[str]) -> str:
        outside = not Path(os.path.normpath(here / link["to"].partition("#")[0])).is_relative_to(root)
        return link["text"] if outside else link[0]

    return LINK.sub(plain, markdown)


def commands() -> str:
    """The reference of the command line: of each command its text, arguments and options."""
    from simgap.cli import COMMANDS, cli

    out = ["# Commands", "Generated from the commands themselves; `simgap COMMAND --help` prints the same.", ""]
    group = click.Context(cli, info_name="simgap")
    for name, about in COMMANDS.items():
        command = cli.get_command(group, name)
        assert command is not None
        context = click.Context(command, info_name=name, parent=group)
        help_text = "\n\n".join(p.replace("\n", " ") for p in (command.help or "").split("\n\n"))
        example = (command.epilog or "").removeprefix("Example: ")
        out += [f"## simgap {name}", about, "", f"    {command.get_usage(context).removeprefix('Usage: ')}", "", help_text, ""]
        if example:
            out += ["Example:", "", *(f"    {line.strip()}" for line in example.split("; ")), ""]
        options = [p for p in command.get_params(context) if isinstance(p, click.Option) and not p.hidden]
        out += ["| option | meaning |", "|---|---|", *(_option(p, context) for p in options), ""]
    return "\n".join(out)


def _option(option: click.Option, context: click.Context) -> str:
    names, text = option.get_help_record(context) or ("", "")
    return f"| `{_cell(names)}` | {_cell(text)} |"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def effects(pictured: set[str]) -> str:
    """The library of effects: law, places, parameters, source, and what each does to the motion of a known axis."""
    from simgap.commands.effects import described, library

    out = [
        "# Effects",
        "Generated from the registry of effects; `simgap effects NAME` prints the same. Each picture shows an axis without the "
        "effect and with it, at a size with which a fit begins: the robot axis on a chirp of torque, for effects of a servo a "
        "pendulum on a chirp of its command. Left: four periods around the largest change; right: the change over the velocity.",
        "",
    ]
    for name, forms in library().items():
        out += [f"## {name}", ""]
        for i, cls in enumerate(forms):
            about = described(cls)
            if i:
                out += [f"**Another law of the same effect: `{cls.id}`**", ""]
            out += [about["title"], "", "``` { .text .law }", about["law"], "```", ""]
            if cls.id in pictured:
                out += [f"![{about['title']}](effects/{cls.id}.png)", ""]
            out += [
                f"Places: {', '.join(f'`{p}`' for p in about['places'])}.",
                "",
                "| parameter | unit | meaning |",
                "|---|---|---|",
            ]
            for key, p in about["parameters"].items():
                units = p["unit"] if p["unit"] == p["unit_slide"] else f"{p['unit']}; {p['unit_slide']} on a slide"
                out.append(f"| `{key}` | {_cell(units)} | {_cell(p['about'])} |")
            out += ["", f"Source: {_cell(about['source'])}", ""]
    return "\n".join(out)


def effect_pictures() -> Iterator[tuple[str, bytes]]:
    """(effect@place, PNG) of each effect at the first place that an axis has for it."""
    from mjsim.crosscheck.cases import effect_cases
    from mjsim.excitation import chirp
    from mjsim.mjcf import load_axis
    from mjsim.models import shipped_model
    from simgap import Model

    done: set[str] = set()
    spec = Model("pendulum").spec
    spec.actuator("torque").set_to_position(kp=20.0, kv=1.0)
    axes = {"robot_axis1": load_axis(shipped_model("robot_axis1")), "pendulum": Model(spec).axis}
    for name, axis in axes.items():
        amplitude, low, high = DRIVE[name]
        u = chirp(SECONDS, DT, amplitude, low, high)
        for case in effect_cases(axis, u, DT)[0]:
            effect = case.axis.effects[-1]
            if effect.id not in done and (name == "robot_axis1") == (axis.chain.servo is None):
                done.add(effect.id)
                yield f"{effect.id}@{effect.place}", picture(axis, effect, u, (low, high))


def stretch(change: np.ndarray, band: tuple[float, float]) -> slice:
    """Samples of `PERIODS` periods of the chirp around the largest change, whose frequency grows over the band [Hz]."""
    at = int(np.argmax(np.abs(change)))
    frequency = band[0] + (band[1] - band[0]) * at / len(change)
    half = max(1, min(len(change), round(PERIODS / frequency / DT)) // 2)
    begin = min(max(0, at - half), len(change) - 2 * half)
    return slice(begin, begin + 2 * half)


def picture(axis: Axis, effect: Effect, u: np.ndarray, band: tuple[float, float]) -> bytes:
    """PNG of the motor's velocity without and with an effect where it changes most, and of the change over all of the motion."""
    from matplotlib.figure import Figure

    from mjsim.axis import Axis as AxisOf
    from mjsim.ode import DivergedError, simulate

    bare = AxisOf(axis.chain, (), axis.backlash_law)
    before = simulate(bare, u, DT)
    try:
        after = simulate(bare + effect, u, DT)
    except DivergedError:
        after = before
    figure = Figure(figsize=(8, 3), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2, 1))
    part = stretch(after.velocity - before.velocity, band)
    left.plot(before.time[part], before.velocity[part], color="#999999", linewidth=2, label="without")
    left.plot(after.time[part], after.velocity[part], color="#2a7ab9", linewidth=1, label=f"with {effect.id.replace('_', ' ')}")
    left.set(xlabel="time [s]", ylabel="velocity [rad/s]")
    figure.legend(loc="outside upper left", ncols=2, fontsize="small", frameon=False)
    right.axhline(0.0, color="#999999", linewidth=0.8)
    right.plot(after.velocity, after.velocity - before.velocity, color="#c44e52", linewidth=0.6)
    right.set(xlabel="velocity [rad/s]", ylabel="change [rad/s]")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=80)
    return buffer.getvalue()


def json_keys() -> str:
    """The keys of the JSON files, from the contract's classes: what a program may rely on."""
    from simgap.api.keys import FILES

    out = [
        "# JSON",
        "A program may rely on these keys; more may be added. `null` stands for a number that is not known. `simgap schema` "
        "prints the JSON Schema of `diagnosis.json`, `simgap schema check` and `simgap schema identification` print the others.",
        "",
    ]
    for name, (about, keys) in FILES.items():
        rows = [f"| `{k}` | {_cell(v)} |" for k, v in keys.items()]
        out += [f"## {name}", about, "", "| key | holds |", "|---|---|", *rows, ""]
    return "\n".join(out)
