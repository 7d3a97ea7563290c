"""The commands of the README run as printed, in an empty folder."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def printed() -> list[str]:
    """Commands that stand alone in an indented line of the README."""
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    return [line.strip() for line in lines if line.startswith("    simgap ")]


def test_the_readme_has_commands_that_follow_each_other():
    assert [line.split()[1] for line in printed()] == ["run", "diagnose", "replay", "gate", "render"]


@pytest.mark.slow
def test_the_commands_of_the_readme_run_as_printed(tmp_path):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    for line in printed():
        words = [sys.executable, "-m", *shlex.split(line)]
        ended = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        if "no off-screen OpenGL" in ended.stderr:
            pytest.skip(ended.stderr)
        assert ended.returncode == 0, f"{line}: {ended.stderr}"
    assert {"logs", "report", "prediction.csv", "axis.png"} <= {p.name for p in tmp_path.iterdir()}
