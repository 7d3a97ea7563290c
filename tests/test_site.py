"""The documentation site: its commands and code run as printed, page by page; what is generated is complete; it is built."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from lab.first_use import PAGES, ROOT, run_page, steps

DOCS = ROOT / "docs"
NOTEBOOKS = sorted(p.stem for p in (DOCS / "notebooks").glob("*.ipynb"))
ENVIRONMENT = os.environ | {
    "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
    "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)]),
    "MPLBACKEND": "agg",
}


def test_pages_have_something_to_run():
    assert len(PAGES) == 9
    assert [p for p in PAGES if not steps(p)] == []
    readme = [s.text.split()[1] for s in steps("README.md")]
    assert readme == ["run", "diagnose", "replay", "gate", "render"]


@pytest.mark.parametrize("page", PAGES)
def test_commands_of_pages_are_commands(page):
    from simgap.cli import COMMANDS

    for step in steps(page):
        if step.kind == "python":
            compile(step.text, page, "exec")
        else:
            assert step.text.split()[0] == "simgap", step
            assert step.text.split()[1] in COMMANDS


@pytest.mark.parametrize("page", PAGES)
def test_options_in_the_text_of_a_page_are_options(page):
    """Also in lines that are not run, such as those that name the reader's own files."""
    from simgap.cli import COMMANDS

    text = (ROOT / page).read_text(encoding="utf-8")
    found = re.findall(r"^(?:    |\$ )simgap (\w+)(.*)$|`simgap (\w+)([^`\n]*)`", text, re.MULTILINE)
    for name, rest in ((a or c, b or d) for a, b, c, d in found):
        assert name in COMMANDS, f"{page}: simgap {name}"
        module = importlib.import_module(f"simgap.commands.{name}")
        offered = {o for p in module.command.params for o in (*p.opts, *p.secondary_opts)} | {"--help"}
        assert set(re.findall(r"(?<![\w-])--[\w-]+", rest)) <= offered, f"{page}: simgap {name}{rest}"


def test_the_workflow_of_the_guide_is_yaml_whose_command_has_these_options():
    yaml = pytest.importorskip("yaml")
    text = (DOCS / "guides" / "ci-gate.md").read_text(encoding="utf-8")
    told = yaml.safe_load(re.search(r"```yaml\n(.*?)```", text, re.DOTALL)[1])
    (line,) = [s["run"] for s in told["jobs"]["gate"]["steps"] if "simgap gate" in s.get("run", "")]
    from simgap.commands.gate import command

    asked = set(re.findall(r"--\w+", line))
    assert asked == {"--baseline", "--markdown"}
    assert asked <= {o for p in command.params for o in p.opts}


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_a_page_runs_as_printed(page, tmp_path):
    for ran in run_page(page, tmp_path, ENVIRONMENT):
        if "no off-screen OpenGL" in ran.said:
            pytest.skip(ran.said)
        assert ran.code == 0, f"{ran.step.text}: {ran.said}"


@pytest.mark.slow
def test_a_new_environment_runs_readme_and_tutorial():
    """The ten-minute test: the wheel in a new environment, nothing compiled before."""
    pytest.importorskip("hatchling")
    ended = subprocess.run(
        [sys.executable, "-m", "lab.first_use"], cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_a_page_stops_at_the_first_step_that_fails(tmp_path, monkeypatch):
    (tmp_path / "page.md").write_text("```console\n$ echo a\n$ false\n$ echo c\n```\n```python\nx = 1\n```\n")
    monkeypatch.setattr("lab.first_use.ROOT", tmp_path)
    assert [r.code for r in run_page("page.md", tmp_path, ENVIRONMENT)] == [0, 1]
    assert [r.code for r in run_page("page.md", tmp_path, ENVIRONMENT, skip=("false",))] == [0, 0, 0]
    (tmp_path / "page.md").write_text("```console\necho a\n```\n")
    with pytest.raises(ValueError, match="no prompt"):
        steps("page.md")


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


def module_of(path):
    """A module by its file, as MkDocs loads a hook."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_notebook_becomes_a_page_with_what_its_cells_show():
    nbformat = pytest.importorskip("nbformat")
    shown = module_of(DOCS / "notebook_pages.py").shown
    v4 = nbformat.v4
    outputs = [
        v4.new_output("stream", name="stdout", text="a\n"),
        v4.new_output("stream", name="stderr", text="progress\n"),
        v4.new_output("execute_result", data={"text/plain": "3"}),
        v4.new_output("execute_result", data={"text/plain": "<Figure>", "image/png": "AAAA"}),
    ]
    notebook = v4.new_notebook(cells=[v4.new_markdown_cell("# Title"), v4.new_code_cell("f(1)", outputs=outputs)])
    text, pictures = shown(notebook, "own")
    assert text.startswith("# Title\n\n```python\nf(1)\n```\n\n```text\na\n```\n\n```text\n3\n```\n\n![")
    assert "progress" not in text
    assert pictures == {"own_0.png": b"\0\0\0"}


def test_the_reference_names_every_command_and_every_effect():
    pytest.importorskip("mkdocs")
    hooks = module_of(DOCS / "hooks.py")
    from mjsim.effects import registered
    from simgap.cli import COMMANDS

    text = hooks.commands()
    assert [c for c in COMMANDS if f"## simgap {c}\n" not in text] == []
    assert "`--held-out PATH`" in text
    library = hooks.effects({"backlash"})
    assert [e for e in registered() if e not in library] == []
    assert "(effects/backlash.png)" in library
    assert "findings[].effect" in hooks.json_keys()


def test_a_picture_of_an_effect_shows_the_largest_change():
    pytest.importorskip("mkdocs")
    hooks = module_of(DOCS / "hooks.py")
    for at in (0, 3000, 5999):
        change = np.zeros(6000)
        change[at] = -1.0
        part = hooks.stretch(change, (0.5, 30.0))
        assert 0 <= part.start < part.stop <= 6000
        assert part.start <= at <= part.stop  # at the end the frequency is 30 Hz: four periods are 267 samples
    assert part.stop - part.start == 266


def test_every_page_of_the_navigation_is_written_or_generated():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    nav = re.findall(r": ([\w/]+\.md)$", text[text.index("\nnav:") :], re.MULTILINE)
    generated = {"reference/commands.md", "reference/effects.md", "reference/json.md", *(f"notebooks/{n}.md" for n in NOTEBOOKS)}
    assert [p for p in nav if not (DOCS / p).is_file() and p not in generated] == []
    assert len(nav) > 20


@pytest.mark.slow
def test_the_site_is_built(tmp_path, request):
    pytest.importorskip("mkdocs")
    pytest.importorskip("material")
    pytest.importorskip("mkdocstrings")
    pytest.importorskip("nbclient")
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
    for name in NOTEBOOKS:
        page = (out / "notebooks" / f"{name}.html").read_text(encoding="utf-8")
        assert "coulomb" in page or "cubic drag" in page
        assert "left out" in page or "Missing:" in page  # what a cell printed
    assert (out / "notebooks" / "own_robot_0.png").is_file()
    headings = re.findall(r'<h2 id="([\w-]+)"', (out / "reference" / "effects.html").read_text(encoding="utf-8"))
    assert [h for h in headings if not (out / "reference" / "effects" / f"{h}.png").is_file()] == []
    assert broken_links(out) == []
    # where there is no browser, all of the above is held before the test is skipped
    assert found_from_disk(request.getfixturevalue("browser"), out, "backlash")[0].endswith("reference/effects.html")


def found_from_disk(browser, site, word):
    """Pages that the search of the site finds in Chromium, opened from disk; nothing is asked of the network."""
    asked = []
    with browser.new_page() as page:
        page.on("request", lambda r: asked.append(r.url))
        page.goto((site / "guides" / "ros.html").as_uri())
        page.fill("input.md-search__input", word)
        page.wait_for_selector(".md-search-result__item")
        found = [e.get_attribute("href") for e in page.query_selector_all(".md-search-result__link")]
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
    return found


def broken_links(site):
    """(page, link) of links to files that the site does not have."""
    return [
        (page.relative_to(site).as_posix(), link)
        for page in site.rglob("*.html")
        for link in re.findall(r'(?:href|src)="([^"#]+)', page.read_text(encoding="utf-8"))
        if not re.match(r"[a-z]+:|/", link) and not (page.parent / link).exists()
    ]
