"""The command line as a whole: every command of the contract, its help, and the recordings that `simgap data` finds."""

from __future__ import annotations

import hashlib
import importlib
import json
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import click
import pytest

import simgap
from simgap import cli
from simgap.commands import data
from simgap.commands.data import DATA_SETS, DataSet, PublicFile

COMMANDS = list(cli.COMMANDS)


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """``run("data", ...)`` -> (exit code, standard output, standard error), in an empty folder and with an empty cache."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("SIMGAP_DATA", raising=False)

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["simgap", *words])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        return int(ended.value.code or 0), said.out, said.err

    return call


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_real_and_has_a_help_with_an_example(run, name):
    loaded = importlib.import_module(f"simgap.commands.{name}").command
    assert isinstance(loaded, click.Command)
    code, out, err = run(name, "--help")
    assert code == 0
    assert err == ""
    assert f"Example: simgap {name}" in " ".join(out.split())
    for option in loaded.params:
        if isinstance(option, click.Option):
            assert option.help or option.name == "help", f"{name}: {option.opts} says nothing of itself"


def test_the_contract_of_options():
    """Options that scripts call; see the interface in docs/architecture.md."""
    needed = {
        "demo": {"--out"}, "run": {"--out", "--json"}, "render": {"--out"}, "crosscheck": {"--json"},
        "identify": {"--out", "--orders", "--decimate", "--cutoff", "--input", "--output", "--json"},
        "diagnose": {"--model", "--out", "--held-out", "--json"}, "replay": {"--out", "--json"},
        "study": {"--out"}, "benchmark": {"--out", "--grade", "--seed"}, "data": {"--json"},
    }  # fmt: skip
    for name in COMMANDS:
        loaded = importlib.import_module(f"simgap.commands.{name}").command
        offered = {o for p in loaded.params for o in p.opts}
        assert needed.get(name, set()) <= offered, name


def test_help_lists_every_command_and_loads_nothing_heavy():
    code = (
        "import sys; from click.testing import CliRunner; from simgap.cli import cli; r = CliRunner().invoke(cli, ['--help']);"
        "print(r.output); heavy = [m for m in ('numba', 'mujoco', 'scipy', 'matplotlib', 'numpy') if m in sys.modules];"
        "sys.exit(len(heavy))"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    for name in COMMANDS:
        assert f"  {name} " in ended.stdout


def test_the_version(run):
    assert run("--version")[:2] == (0, f"simgap, version {simgap.__version__}\n")


CONTENT = b"a recording of no consequence"


@pytest.fixture
def toy(monkeypatch):
    """A data set of one file's content under two names, fetched from an address that the test sets."""

    def make(url=None):
        digest = hashlib.sha256(CONTENT).hexdigest()
        files = tuple(
            PublicFile(n, len(CONTENT), digest, role, url) for n, role in (("a.mat", "estimation"), ("b.mat", "held-out"))
        )
        monkeypatch.setitem(DATA_SETS, "toy", DataSet("toy", "A toy", "example.org/toy", "none", "robot_axis1", files))

    return make


def test_a_local_copy_is_found_by_its_content(run, toy, tmp_path):
    toy()
    folder = tmp_path / "deep" / "down"
    folder.mkdir(parents=True)
    (folder / "renamed.mat").write_bytes(CONTENT)
    (folder / "zzz.mat").write_bytes(b"something else")
    code, out, err = run("data", "toy", "--from", "deep", "--json")
    assert (code, err) == (0, "")
    said = json.loads(out)
    assert [f["role"] for f in said["files"]] == ["estimation", "held-out"]
    assert Path(said["files"][0]["file"]).name == "renamed.mat"
    code, out, _ = run("data", "toy", "--from", "deep")
    assert code == 0
    assert "Next: simgap diagnose" in out


def test_the_environment_names_a_local_copy(run, toy, tmp_path, monkeypatch):
    toy()
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "a.mat").write_bytes(CONTENT)
    monkeypatch.setenv("SIMGAP_DATA", str(tmp_path / "copy"))
    assert run("data", "toy")[0] == 0
    monkeypatch.setenv("SIMGAP_DATA", str(tmp_path / "nowhere"))
    code, _, err = run("data", "toy")
    assert code == 2
    assert "SIMGAP_DATA" in err


def test_another_file_of_the_same_name_is_refused(run, toy, tmp_path):
    toy()
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "a.mat").write_bytes(b"changed")
    code, _, err = run("data", "toy", "--from", "copy")
    assert code == 2
    assert "SHA-256" in err
    assert len(err.splitlines()) == 1


def test_a_file_is_fetched_once_and_kept(run, toy, tmp_path, monkeypatch):
    (tmp_path / "server.mat").write_bytes(CONTENT)
    toy((tmp_path / "server.mat").as_uri())
    assert run("data", "toy", "--json")[0] == 0
    assert (tmp_path / "cache" / "simgap" / "data" / "a.mat").read_bytes() == CONTENT

    def refuse(*_, **__):
        raise AssertionError("fetched again")

    monkeypatch.setattr(urllib.request, "urlopen", refuse)
    assert run("data", "toy", "--json")[0] == 0


def test_what_is_fetched_must_be_what_is_pinned(run, toy, tmp_path):
    (tmp_path / "server.mat").write_bytes(b"changed at the source")
    toy((tmp_path / "server.mat").as_uri())
    code, out, err = run("data", "toy")
    assert (code, out) == (2, "")
    assert "the source has changed" in err
    assert not list(tmp_path.rglob("*.part"))
    assert not (tmp_path / "cache").exists()


def test_without_a_network_it_says_where_to_look(run, toy, monkeypatch):
    def fail(*_, **__):
        raise urllib.error.URLError("no route to host")

    toy("https://example.org/a.mat")
    monkeypatch.setattr(urllib.request, "urlopen", fail)
    code, _, err = run("data", "toy")
    assert code == 2
    assert len(err.splitlines()) == 1
    assert "example.org/toy" in err
    assert "--from DIR" in err
    toy()
    assert "has no address of its own" in run("data", "toy")[2]


def test_an_unknown_data_set_names_the_choices(run):
    code, _, err = run("data", "moonwalk")
    assert code == 2
    assert "emps, kuka_kr300" in err
    assert run("data")[0] == 2
    assert run("data", "--list")[0] == 0


@pytest.mark.parametrize("name", ["emps", "kuka_kr300"])
def test_the_pinned_hashes_are_those_of_a_local_copy(local_copy, name):
    for file in DATA_SETS[name].files:
        path = local_copy(name, file.name)
        assert data.locate(file, path.parent) == path
