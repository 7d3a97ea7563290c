"""The documentation site: its commands and code run as printed, page by page; what is generated is complete; it is built."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(p.relative_to(DOCS).as_posix() for p in [DOCS / "tutorial.md", *(DOCS / "guides").glob("*.md")])
NOTEBOOKS = sorted(p.stem for p in (DOCS / "notebooks").glob("*.ipynb"))
BLOCK = re.compile(r"^```(?P<kind>console|python)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "MPLBACKEND": "agg"}


def steps(page):
    """What a page asks the reader to run, in order: (kind, text)."""
    return [(m["kind"], m["text"]) for m in BLOCK.finditer((DOCS / page).read_text(encoding="utf-8"))]


def test_pages_have_something_to_run():
    assert len(PAGES) == 8
    assert [p for p in PAGES if not steps(p)] == []


@pytest.mark.parametrize("page", PAGES)
def test_commands_of_pages_are_commands(page):
    from simgap.cli import COMMANDS

    for kind, text in steps(page):
        for line in text.splitlines() if kind == "console" else ():
            assert line.startswith("$ simgap "), line
            assert line.split()[2] in COMMANDS
        if kind == "python":
            compile(text, page, "exec")


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_a_page_runs_as_printed(page, tmp_path):
    code = ""
    for kind, text in steps(page):
        if kind == "python":
            code += text
            script = tmp_path / "page.py"
            script.write_text(code, encoding="utf-8")
            words = [[sys.executable, str(script)]]
        else:
            words = [[sys.executable, "-m", *shlex.split(line.removeprefix("$ "))] for line in text.splitlines()]
        for line in words:
            ended = subprocess.run(line, cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, check=False)
            assert ended.returncode == 0, f"{line}: {ended.stderr[-2000:]}"


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs(name, tmp_path):
    """Cell after cell in one process; its assertions hold."""
    cells = json.loads((DOCS / "notebooks" / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    script = tmp_path / "notebook.py"
    script.write_text("\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code"), encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr[-2000:]


def test_there_are_three_notebooks_without_outputs():
    assert NOTEBOOKS == ["first_diagnosis", "own_effect", "own_robot"]
    for name in NOTEBOOKS:
        cells = json.loads((DOCS / "notebooks" / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
        assert all(not c.get("outputs") for c in cells)


def test_the_reference_names_every_command_and_every_effect():
    pytest.importorskip("mkdocs")
    sys.path.insert(0, str(DOCS))
    try:
        import hooks
    finally:
        sys.path.remove(str(DOCS))
    from mjsim.effects import registered
    from simgap.cli import COMMANDS

    text = hooks.commands()
    assert [c for c in COMMANDS if f"## simgap {c}\n" not in text] == []
    assert "`--held-out PATH`" in text
    library = hooks.effects({"backlash"})
    assert [e for e in registered() if e not in library] == []
    assert "(effects/backlash.png)" in library
    assert "findings[].effect" in hooks.json_keys()


def test_every_page_of_the_navigation_is_written_or_generated():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    nav = re.findall(r": ([\w/]+\.md)$", text[text.index("\nnav:") :], re.MULTILINE)
    generated = {"reference/commands.md", "reference/effects.md", "reference/json.md", *(f"notebooks/{n}.md" for n in NOTEBOOKS)}
    assert [p for p in nav if not (DOCS / p).is_file() and p not in generated] == []
    assert len(nav) > 20


@pytest.mark.slow
def test_the_site_is_built(tmp_path):
    pytest.importorskip("mkdocs")
    pytest.importorskip("material")
    pytest.importorskip("mkdocstrings")
    out = tmp_path / "site"
    ended = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(out)], cwd=ROOT, env=ENVIRONMENT,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, textwrap.shorten(ended.stderr, 3000)
    assert (out / "reference" / "effects" / "backlash.png").is_file()
    api = (out / "reference" / "api.html").read_text(encoding="utf-8")
    assert "corrected_model" in api
    assert "https://fonts" not in api
