"""The ten-minute test: what the README and the pages of the documentation print, run as printed by somebody who just installed.

    python -m lab.first_use                    # the wheel in a new environment: README and tutorial
    python -m lab.first_use --all              # and every guide
    python -m lab.first_use --clone            # a clean clone: `make demo`

A step is a line that begins with ``$`` in a ``console`` block, or a ``python`` block, which runs after those before it on its
page. Nothing of the source tree is on the path, and no compiled code is kept from before. Exit 1 where a step fails, or where
a page takes more than ten minutes of processor time, which a machine that does nothing else needs at most.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

__all__ = ["PAGES", "ROOT", "Step", "run_page", "steps"]

ROOT = Path(__file__).resolve().parent.parent
PAGES = ("README.md", "docs/tutorial.md", *(f"docs/guides/{p.name}" for p in sorted((ROOT / "docs/guides").glob("*.md"))))
BLOCK = re.compile(r"^```(?P<kind>console|python)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
MOST = 600.0  # [s] of processor time that a page may take


@dataclass(frozen=True)
class Step:
    """One thing that a page asks the reader to run; ``kind``: "console", one line without its prompt, or "python"."""

    kind: str
    text: str


@dataclass(frozen=True)
class Ran:
    """A step that was run: exit code, seconds by the clock and of the processors, end of what it said."""

    step: Step
    code: int
    seconds: float
    processor: float
    said: str


def steps(page: str) -> list[Step]:
    """The steps of a page of the repository, in order. Raises ValueError for a line of a console block without a prompt."""
    found = []
    for block in BLOCK.finditer((ROOT / page).read_text(encoding="utf-8")):
        if block["kind"] == "python":
            found.append(Step("python", block["text"]))
            continue
        for line in block["text"].splitlines():
            if not line.startswith("$ "):
                raise ValueError(f"{page}: {line!r} has no prompt")
            found.append(Step("console", line.removeprefix("$ ")))
    return found


def run_page(page: str, folder: Path, environment: Mapping[str, str], skip: tuple[str, ...] = ()) -> Iterator[Ran]:
    """Run the steps of a page in a folder, up to the first that fails; lines that begin with one of ``skip`` are left out."""
    code = ""
    for step in steps(page):
        if step.text.startswith(skip):
            continue
        if step.kind == "python":
            code += step.text
            (folder / "page.py").write_text(code, encoding="utf-8")
        line = "python page.py" if step.kind == "python" else step.text
        began, used = time.monotonic(), processor()
        ended = subprocess.run(
            ["bash", "-c", line], cwd=folder, env=dict(environment), stdin=subprocess.DEVNULL, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        said = (ended.stdout + ended.stderr)[-2000:]
        yield Ran(step, ended.returncode, time.monotonic() - began, processor() - used, said)
        if ended.returncode:
            return


def processor() -> float:
    """Seconds of processor time that ended processes of this one have used."""
    own = os.times()
    return own.children_user + own.children_system


def install(folder: Path) -> dict[str, str]:
    """A new environment that holds the wheel with the readers, and what a shell in it has. Raises CalledProcessError."""
    words = [sys.executable, "-m", "pip", "wheel", str(ROOT), "--no-deps", "-q", "-w", str(folder)]
    subprocess.run(words, check=True)
    (wheel,) = folder.glob("simgap-*.whl")
    venv.create(folder / "env", with_pip=True)
    environment = shell(folder, folder / "env/bin")  # without PYTHONPATH, by which pip finds what another environment has
    subprocess.run([folder / "env/bin/python", "-m", "pip", "install", "-q", f"{wheel}[formats]"], env=environment, check=True)
    return environment


def shell(folder: Path, *first: Path) -> dict[str, str]:
    """Environment of a new user: nothing of Python's or numba's settings, an empty cache, ``first`` on the path."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA", "SIMGAP", "VIRTUAL_ENV"))}
    path = os.pathsep.join([*map(str, first), kept.get("PATH", os.defpath)])
    return kept | {"PATH": path, "XDG_CACHE_HOME": str(folder / "cache"), "MPLBACKEND": "agg"}


def try_wheel(pages: tuple[str, ...], scratch: Path) -> bool:
    """Install the wheel and run the pages; prints each step with its seconds."""
    began = time.monotonic()
    environment = install(scratch)
    print(f"{time.monotonic() - began:6.1f} s  wheel built and installed with simgap[formats]", flush=True)
    good = True
    for i, page in enumerate(pages):
        folder = scratch / f"page{i}"
        folder.mkdir()
        total = clock = 0.0
        print(page)
        for ran in run_page(page, folder, environment, skip=("make", "pip")):
            total, clock = total + ran.processor, clock + ran.seconds
            print(f"{ran.seconds:6.1f} s, processor {ran.processor:5.1f} s  {ran.step.text.splitlines()[0]}", flush=True)
            if ran.code:
                good = False
                print(f"exit {ran.code}: {ran.said}")
        good &= total <= MOST
        print(f"{clock:6.1f} s, processor {total:5.1f} s  in all, {'within' if total <= MOST else 'NOT within'} {MOST:.0f} s")
    return good


def try_clone(scratch: Path) -> bool:
    """Clone the last commit and run ``make demo`` there."""
    subprocess.run(["git", "clone", "-q", str(ROOT), str(scratch / "clone")], check=True)
    began, used = time.monotonic(), processor()
    ended = subprocess.run(["make", "-s", "demo"], cwd=scratch / "clone", env=shell(scratch), check=False)
    clock, total = time.monotonic() - began, processor() - used
    report = scratch / "clone/out/demo/report.html"
    there = "a" if report.is_file() else "NO"
    print(f"{clock:6.1f} s, processor {total:5.1f} s  make demo, exit {ended.returncode}, {there} report")
    return ended.returncode == 0 and report.is_file() and total <= MOST


def main() -> None:
    """Run what was asked for; exit 1 where a step fails."""
    parser = argparse.ArgumentParser(prog="python -m lab.first_use", description=__doc__.partition("\n")[0])
    parser.add_argument("--all", action="store_true", help="every guide as well")
    parser.add_argument("--clone", action="store_true", help="`make demo` in a clean clone of the last commit")
    asked = parser.parse_args()
    scratch = Path(tempfile.mkdtemp(prefix="simgap-first-use-"))
    try:
        good = try_clone(scratch) if asked.clone else try_wheel(PAGES if asked.all else PAGES[:2], scratch)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    sys.exit(not good)


if __name__ == "__main__":
    main()
