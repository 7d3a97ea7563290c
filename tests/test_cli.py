"""The command line as a whole: every command of the contract, its help, and the recordings that `simgap data` finds."""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import click
import numpy as np
import pytest

import simgap
from simgap import cli
from simgap.commands import data
from simgap.commands.data import DATA_SETS, DataSet, PublicFile

COMMANDS = list(cli.COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_real_and_has_a_help_with_an_example(run_cli, name):
    loaded = importlib.import_module(f"simgap.commands.{name}").command
    assert isinstance(loaded, click.Command)
    code, out, err = run_cli(name, "--help")
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
        "app": {"--folder", "--port"}, "gate": {"--baseline", "--tolerance", "--json"},
        "fleet": {"--scheduler", "--workers", "--robot", "--json"}, "effects": {"--json"}, "doctor": {"--json"},
        "study": {"--out"}, "benchmark": {"--out", "--grade", "--seed"}, "data": {"--json"},
    }  # fmt: skip
    for name in COMMANDS:
        loaded = importlib.import_module(f"simgap.commands.{name}").command
        offered = {o for p in loaded.params for o in p.opts}
        assert needed.get(name, set()) <= offered, name


def test_every_command_that_prints_results_prints_them_as_json():
    """`schema` prints JSON and nothing else; `app` is a server."""
    loaded = {n: importlib.import_module(f"simgap.commands.{n}").command for n in COMMANDS}
    assert {n for n, c in loaded.items() if "--json" not in {o for p in c.params for o in p.opts}} == {"schema", "app"}


@pytest.mark.parametrize(
    "words",
    [
        ("run", "--list"), ("run", "step", "--duration", "1", "--out", "logs"), ("effects",), ("effects", "backlash"),
        ("data", "--list"), ("check", "log.csv", "--model", "pendulum"), ("replay", "pendulum", "log.csv", "--out", "p.csv"),
        ("identify", "log.csv", "--orders", "1,0,0,1,1", "--decimate", "1", "--out", "fit"),
    ],
)  # fmt: skip
def test_json_on_standard_output_is_json_alone(run_cli, words):
    """Also without NaN, which is no JSON."""

    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    t = 0.004 * np.arange(500)
    torque = 3 * np.sin(2 * np.pi * (0.3 + 0.5 * t) * t)
    motion = simgap.simulate("pendulum", torque, dt=0.004)
    motion.save("log.csv")
    code, out, _ = run_cli(*words, "--json")
    assert code in (0, 1)
    assert json.loads(out, parse_constant=refuse)


def test_help_lists_every_command_and_loads_nothing_heavy():
    code = (
        "import sys; from click.testing import CliRunner; from simgap.cli import COMMANDS, cli; run = CliRunner().invoke;"
        "r = run(cli, ['--help']); others = [run(cli, [name, '--help']).exit_code for name in COMMANDS]; assert not any(others);"
        "print(r.output); heavy = [m for m in ('numba', 'mujoco', 'scipy', 'matplotlib', 'numpy') if m in sys.modules];"
        "sys.exit(len(heavy))"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    for name in COMMANDS:
        assert f"  {name} " in ended.stdout


def test_the_version(run_cli):
    assert run_cli("--version")[:2] == (0, f"simgap, version {simgap.__version__}\n")


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


def test_a_local_copy_is_found_by_its_content(run_cli, toy, tmp_path):
    toy()
    folder = tmp_path / "deep" / "down"
    folder.mkdir(parents=True)
    (folder / "renamed.mat").write_bytes(CONTENT)
    (folder / "zzz.mat").write_bytes(b"something else")
    code, out, err = run_cli("data", "toy", "--from", "deep", "--json")
    assert (code, err) == (0, "")
    said = json.loads(out)
    assert [f["role"] for f in said["files"]] == ["estimation", "held-out"]
    assert Path(said["files"][0]["file"]).name == "renamed.mat"
    code, out, _ = run_cli("data", "toy", "--from", "deep")
    assert code == 0
    assert "Next: simgap diagnose" in out


def test_the_environment_names_a_local_copy(run_cli, toy, tmp_path, monkeypatch):
    toy()
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "a.mat").write_bytes(CONTENT)
    monkeypatch.setenv("SIMGAP_DATA", str(tmp_path / "copy"))
    assert run_cli("data", "toy")[0] == 0
    monkeypatch.setenv("SIMGAP_DATA", str(tmp_path / "nowhere"))
    code, _, err = run_cli("data", "toy")
    assert code == 2
    assert "SIMGAP_DATA" in err


def test_another_file_of_the_same_name_is_refused(run_cli, toy, tmp_path):
    toy()
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "a.mat").write_bytes(b"changed")
    code, _, err = run_cli("data", "toy", "--from", "copy")
    assert code == 2
    assert "SHA-256" in err
    assert len(err.splitlines()) == 1


def test_a_file_is_fetched_once_and_kept(run_cli, toy, tmp_path, monkeypatch):
    (tmp_path / "server.mat").write_bytes(CONTENT)
    toy((tmp_path / "server.mat").as_uri())
    assert run_cli("data", "toy", "--json")[0] == 0
    assert (tmp_path / "cache" / "simgap" / "data" / "a.mat").read_bytes() == CONTENT

    def refuse(*_, **__):
        raise AssertionError("fetched again")

    monkeypatch.setattr(urllib.request, "urlopen", refuse)
    assert run_cli("data", "toy", "--json")[0] == 0


def test_what_is_fetched_must_be_what_is_pinned(run_cli, toy, tmp_path):
    (tmp_path / "server.mat").write_bytes(b"changed at the source")
    toy((tmp_path / "server.mat").as_uri())
    code, out, err = run_cli("data", "toy")
    assert (code, out) == (2, "")
    assert "the source has changed" in err
    assert not list(tmp_path.rglob("*.part"))
    assert not (tmp_path / "cache").exists()


def test_without_a_network_it_says_where_to_look(run_cli, toy, monkeypatch):
    def fail(*_, **__):
        raise urllib.error.URLError("no route to host")

    toy("https://example.org/a.mat")
    monkeypatch.setattr(urllib.request, "urlopen", fail)
    code, _, err = run_cli("data", "toy")
    assert code == 2
    assert len(err.splitlines()) == 1
    assert "example.org/toy" in err
    assert "--from DIR" in err
    toy()
    assert "it has no download address" in run_cli("data", "toy")[2]


def test_an_unknown_data_set_names_the_choices(run_cli):
    code, _, err = run_cli("data", "moonwalk")
    assert code == 2
    assert "emps, kuka_kr300" in err
    assert run_cli("data")[0] == 2
    assert run_cli("data", "--list")[0] == 0


@pytest.mark.parametrize("name", ["emps", "kuka_kr300"])
def test_the_pinned_hashes_are_those_of_a_local_copy(local_copy, name):
    for file in DATA_SETS[name].files:
        path = local_copy(name, file.name)
        assert data.locate(file, path.parent) == path


def test_a_shipped_model_goes_by_name_and_by_its_path_in_the_repository(run_cli, tmp_path):
    from mjsim.models import model_path, shipped_model

    assert model_path("emps") == shipped_model("emps")
    assert model_path("models/emps.xml") == shipped_model("emps")
    assert model_path("models/none.xml") == Path("models/none.xml")
    (tmp_path / "emps").write_text("a file here comes first")
    assert model_path("emps") == Path("emps")


def test_the_library_of_effects(run_cli):
    from mjsim.effects import registered

    code, out, _ = run_cli("effects", "--json")
    assert code == 0
    told = {e["id"]: e for e in json.loads(out)}
    assert set(told) == set(registered())
    for name, cls in registered().items():
        assert told[name]["source"] == cls.citation
        assert told[name]["law"]
        assert {n: p["unit"] for n, p in told[name]["parameters"].items()} == {s.name: s.unit() for s in cls.specs()}
    code, out, _ = run_cli("effects", "backlash")
    assert code == 0
    assert "gap_rad [rad; on a slide m]" in out
    assert "backlash_with_impact" in out
    listed = run_cli("effects")[1]
    assert all(cls.name() in listed for cls in registered().values())


def test_the_doctor_says_what_is_there_and_what_is_broken(run_cli, monkeypatch):
    from mjsim.errors import InputError
    from mjsim.models import shipped_models
    from mjsim.render import context

    monkeypatch.setattr(context, "backend", lambda: "egl (a renderer)")
    code, out, _ = run_cli("doctor", "--json")
    told = json.loads(out)
    assert code == 0
    assert told["rendering"]["backend"] == "egl (a renderer)"
    assert told["models"]["names"] == list(shipped_models())
    assert told["linear_algebra"]["blas"][0]["kernel"]
    assert isinstance(told["compiled"]["simulation"], bool)

    def none() -> str:
        raise InputError("rendering", "no off-screen OpenGL")

    monkeypatch.setattr(context, "backend", none)
    code, out, err = run_cli("doctor")
    assert code == 1
    assert "no off-screen OpenGL" in err
    assert len(err.splitlines()) == 1
    assert "Python" in out


def test_completion_of_a_command_imports_none():
    code = "from simgap.cli import main; main()"
    environment = os.environ | {"_SIMGAP_COMPLETE": "bash_complete", "COMP_WORDS": "simgap d", "COMP_CWORD": "1"}
    ended = subprocess.run([sys.executable, "-c", f"import sys; sys.argv = ['simgap']; {code}"], capture_output=True, text=True,
                           check=False, env=environment)  # fmt: skip
    assert [line.partition(",")[2] for line in ended.stdout.split()] == [n for n in COMMANDS if n.startswith("d")]


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("check a.csv --model pen", ["pendulum"]),
        ("check a.csv --model own", [""]),  # the shell's own completion of files
        (
            "check a.csv --model ''",
            ["own.xml", "arm3", "arm6", "emps", "kuka_kr300", "kuka_kr300_axis1", "pendulum", "robot_axis1"],
        ),
        ("run tutor", ["tutorial"]),
        ("render robot", ["robot_axis1"]),
        ("effects backl", ["backlash"]),
        ("diagnose a.csv --effects torque_offset,backl", ["torque_offset,backlash"]),
        ("data em", ["emps"]),
        ("fleet logs", [""]),
        ("check a.csv --model nothing_such --ou", ["--out"]),
    ],
)
def test_names_and_files_are_completed(words, offered, tmp_path, monkeypatch):
    import shlex

    from click.shell_completion import ShellComplete

    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.xml").write_text("<mujoco/>")
    *before, typed = shlex.split(words)
    found = ShellComplete(cli.cli, {}, "simgap", "_SIMGAP_COMPLETE").get_completions(before, typed)
    assert [item.value if item.type == "plain" else "" for item in found] == offered


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_completion_of_each_shell_is_printed_as_documented(shell):
    root = Path(__file__).parent.parent
    assert f"{shell}_source" in (root / "README.md").read_text(encoding="utf-8")
    assert f"_SIMGAP_COMPLETE={shell}_source simgap" in (root / "docs" / "tutorial.md").read_text(encoding="utf-8")
    code = "import sys; sys.argv = ['simgap']; from simgap.cli import main; main()"
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env=os.environ | {"_SIMGAP_COMPLETE": f"{shell}_source"},
    )  # fmt: skip
    assert f"_SIMGAP_COMPLETE={shell}_complete" in ended.stdout
