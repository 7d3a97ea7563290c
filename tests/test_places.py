"""Places to write to that cannot be used, of every command that writes: taken, read-only, full, held by another run."""

from __future__ import annotations

import ctypes
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from lab.kill import EFFECT, MODEL, write_log
from simgap import cli
from simgap.arguments import OutputFile, OutputFolder
from simgap.sole import sole
from tests.commands import ROOT, command, recording, refused

SHORT = ("--model", "pendulum.xml", "--effects", EFFECT, "--quiet", "--out")

# the option that names the place comes last
FOLDERS = {
    "run": ("run", "step", "--duration", "0.1", "--out"),
    "demo": ("demo", "--out"),
    "check": ("check", "log.csv", "--model", "robot_axis1", "--out"),
    "identify": ("identify", "log.csv", "--out"),
    "crosscheck": ("crosscheck", "emps", "--out"),
    "benchmark": ("benchmark", "--out"),
    "study": ("study", "--quick", "--out"),
    "proof": ("proof", "summary", "--out"),
    "diagnose": ("diagnose", "log.csv", "--model", "robot_axis1", "--out"),
    "fleet": ("fleet", "log.csv", "--model", "robot_axis1", "--out"),
    "app": ("app", "--no-browser", "--folder"),
    "data": ("data", "emps", "--to"),
}
FILES = {
    "render": ("render", "emps", "--out"),
    "replay": ("replay", "robot_axis1", "log.csv", "--out"),
    "gate": ("gate", "robot_axis1", "log.csv", "--baseline", "diagnosis.json", "--markdown"),
    "study": ("study", "--quick", "--out", "elsewhere", "--docs"),
    "benchmark": ("benchmark", "--out", "elsewhere", "--calibration"),
}
READ = {"--from", "--model-root"}  # folders that are read
HELD = {**{k: v for k, v in FOLDERS.items() if k != "data"}, **{f"{k} file": v for k, v in FILES.items()}}
"""Of `data`, two runs write files of one hash: neither is lost."""

CAP_DAC_OVERRIDE, PR_CAPBSET_DROP = 1, 24  # linux/capability.h, linux/prctl.h: by which root writes into any folder

ALL_IN_ONE = """
import contextlib, io, json, sys
from simgap import cli
told = {}
for name, words in json.loads(sys.stdin.read()).items():
    sys.argv, said = ["simgap", *words], io.StringIO()
    with contextlib.redirect_stderr(said):
        try:
            cli.main()
        except SystemExit as ended:
            told[name] = (ended.code or 0, "", said.getvalue())
print(json.dumps(told))
"""


def outputs() -> Iterator[tuple[str, ...]]:
    """(command, option) of all places that a command writes to."""
    context = click.Context(cli.cli)
    for name in cli.cli.list_commands(context):
        found = cli.cli.get_command(context, name)
        assert found is not None
        for option in found.params:
            written = isinstance(option.type, (OutputFile, OutputFolder))
            if written or (isinstance(option.type, click.Path) and option.opts[0] not in READ):
                yield name, option.opts[0]


def test_every_place_is_in_the_tables():
    assert sorted(outputs()) == sorted((words[0], words[-1]) for words in (*FOLDERS.values(), *FILES.values()))


@pytest.mark.parametrize("name", list(FOLDERS))
def test_a_folder_that_is_a_file(simgap, name):
    recording(Path("log.csv"))
    Path("taken").write_text("kept")
    refused(simgap(*FOLDERS[name], "taken"), "taken", "is a file")
    refused(simgap(*FOLDERS[name], "taken/deeper"), "taken", "is a file")
    assert Path("taken").read_text() == "kept"


@pytest.mark.parametrize("name", list(FILES))
def test_a_file_that_is_a_folder(simgap, name):
    recording(Path("log.csv"))
    Path("taken.png").mkdir()
    refused(simgap(*FILES[name], "taken.png"), "taken.png", "it is a folder")
    Path("file").write_text("kept")
    refused(simgap(*FILES[name], "file/film.png"), "'file' is a file")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the capabilities of root are Linux's")
def test_a_parent_that_is_read_only(tmp_path):
    """All commands in one process that has no right to override the mode of a folder."""
    recording(tmp_path / "log.csv")
    (tmp_path / "locked").mkdir()
    (tmp_path / "locked").chmod(0o500)
    words = {k: [*v, "locked/deeper"] for k, v in FOLDERS.items()} | {f"{k} file": [*v, "locked/a.png"] for k, v in FILES.items()}
    libc = ctypes.CDLL(None)
    ended = subprocess.run(
        [sys.executable, "-c", ALL_IN_ONE], cwd=tmp_path, input=json.dumps(words), capture_output=True, text=True, check=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
        preexec_fn=lambda: libc.prctl(PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, 0, 0, 0),
    )  # fmt: skip
    told = json.loads(ended.stdout.splitlines()[-1])
    assert set(told) == set(words)
    for outcome in told.values():
        refused(outcome, "locked", "cannot be written")
    assert not list((tmp_path / "locked").iterdir())


@pytest.mark.parametrize("name", ["run", "demo"])
def test_a_place_that_the_system_refuses(simgap, name):
    """No folder can be made in /proc, whoever asks: the system's own refusal is one line too."""
    if not Path("/proc/self").is_dir():
        pytest.skip("no /proc")
    refused(simgap(*FOLDERS[name], "/proc/nowhere"), "/proc")


@pytest.mark.parametrize(
    ("words", "limit"),
    [
        (("run", "step", "--duration", "2", "--out", "out"), 8192),
        pytest.param(("render", "step", "--out", "out/film.png"), 8192, marks=pytest.mark.slow),
        pytest.param(("check", "a.npz", "--model", "pendulum.xml", "--out", "out"), 8192, marks=pytest.mark.slow),
        pytest.param(("replay", "pendulum.xml", "a.npz", "--out", "out/p.csv"), 8192, marks=pytest.mark.slow),
        pytest.param(("diagnose", "a.npz", *SHORT, "out"), 8192, marks=pytest.mark.slow),
        pytest.param(("fleet", "a.npz", "--workers", "1", *SHORT, "out"), 1024, marks=pytest.mark.slow),  # starts a cluster
        pytest.param(("demo", "--out", "out"), 8192, marks=pytest.mark.slow),  # a whole diagnosis, to a page and a model
    ],
)
def test_a_full_disk(tmp_path, words, limit):
    """A limit on the size of a file fails a write half-way, as a full disk does: one line, no half file under a final name."""
    (tmp_path / "pendulum.xml").write_text(MODEL)
    write_log(tmp_path / "a.npz", 0.15, 0, 500)

    def bound() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    cache = {"NUMBA_CACHE_DIR": ""} if not os.environ.get("NUMBA_CACHE_DIR") else {}
    ended = command(*words, cwd=tmp_path, preexec_fn=bound, env=cache)
    out, err = ended.communicate(timeout=300)
    lines = [line for line in err.splitlines() if line.startswith("simgap:")]
    assert "Traceback" not in err
    assert ended.returncode == 2, err
    assert len(lines) == 1, out + err
    assert "out" in lines[0]
    left = {p.name for p in (tmp_path / "out").rglob("*") if p.is_file()}
    assert left <= {"state.jsonl"}  # whose last line may be cut off: it is dropped when it is read
    assert not [name for name in left if name.endswith(".part")]


def test_two_runs_into_one_folder(simgap):
    """The second is refused while the first holds the folder, also under another name of it, and not afterwards."""
    with sole(Path("out")):
        refused(simgap("run", "step", "--duration", "0.1", "--out", "./out"), "out", "another run writes")
        assert not Path("out").exists()
        Path("out").mkdir()
        Path("link").symlink_to("out")
        refused(simgap("run", "step", "--duration", "0.1", "--out", "link"), "link", "another run writes")
        assert simgap("run", "step", "--duration", "0.1", "--out", "other")[0] == 0
    assert simgap("run", "step", "--duration", "0.1", "--out", "out")[0] == 0


@pytest.mark.parametrize("name", list(HELD))
def test_two_runs_of_any_command_into_one_place(simgap, name):
    recording(Path("log.csv"))
    with sole(Path("out.png")):
        refused(simgap(*HELD[name], "out.png"), "out.png", "another run writes")
    assert not Path("out.png").exists()
