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
        "app": {"--folder", "--port"}, "gate": {"--baseline", "--tolerance", "--json"},
        "fleet": {"--scheduler", "--workers", "--robot", "--json"}, "effects": {"--json"}, "doctor": {"--json"},
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
    assert "it has no download address" in run("data", "toy")[2]


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


@pytest.mark.parametrize(
    ("words", "nearest"),
    [
        (("diagnoze",), "'diagnose'"),
        (("run", "coulomb2", "--out", "x"), "'coulomb_2'"),
        (("render", "robot_axis", "--out", "x.png"), "'robot_axis1'"),
        (("crosscheck", "robot_axis"), "'robot_axis1'"),
        (("replay", "emp", "log.csv", "--out", "x.csv"), "'emps'"),
        (("identify", "log.csv", "--model", "kuka_axis1", "--out", "x"), "'kuka_kr300_axis1'"),
        (("diagnose", "log.csv", "--model", "robotaxis1", "--out", "x"), "'robot_axis1'"),
        (("diagnose", "log.csv", "--model", "emps", "--out", "x", "--effects", "coulomb"), "'coulomb_friction'"),
        (("effects", "backlach"), "'backlash'"),
        (("data", "emp"), "'emps'"),
        (("run", "step", "--model", "emp", "--out", "x"), "'emps'"),
    ],
)
def test_an_unknown_name_is_told_with_the_nearest(run, words, nearest):
    code, out, err = run(*words)
    assert (code, out) == (2, "")
    assert f"did you mean {nearest}?" in err


LOG = "time_s,torque_Nm,velocity_rad_s\n" + "".join(f"{0.001 * k},{k % 7},{k % 11}\n" for k in range(400))
ROBOT_LOG = "time_s,joint1.angle_rad,joint1.torque_Nm\n" + "".join(f"{0.001 * k},{0.1 * (k % 7)},{k % 11}\n" for k in range(400))


@pytest.mark.parametrize(
    ("words", "nearest"),
    [
        (("diagnose", "log.csv", "--modell", "emps"), "'--model'"),
        (("replay", "emps", "log.csv", "--out", "x.csv", "--engine", "mujocco"), "'mujoco'"),
        (("diagnose", "log.csv", "--model", "emps", "--out", "x", "--judge", "forces"), "'force'"),
        (("proof", "emp", "--out", "x"), "'emps'"),
        (("effects", "colomb"), "'coulomb_friction'"),
        (("render", "emps", "--out", "x.pmg"), "'.png'"),
        (("replay", "emps", "log.csv", "--out", "x.csvv"), "'.csv'"),
        (("identify", "log.csv", "--out", "x", "--input", "torqu_Nm"), "'torque_Nm'"),
        (("check", "log.cvs", "--model", "robot_axis1"), "'log.csv'"),
        (("diagnose", "robot.csv", "--model", "arm3", "--out", "x", "--joint", "joint11"), "'joint1'"),
    ],
)
def test_an_unknown_option_value_file_or_column_is_told_with_the_nearest(run, words, nearest):
    Path("log.csv").write_text(LOG)
    Path("robot.csv").write_text(ROBOT_LOG)
    code, out, err = run(*words)
    assert (code, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert f"id you mean {nearest}?" in err


@pytest.mark.parametrize(
    ("text", "nearest"),
    [
        ('[recording]\ntorque = { column = "torque_Nm", unit = "Nmm" }\n', "'Nm'"),
        ('[recording]\ntorque = { column = "torque_Mn" }\n', "'torque_Nm'"),
        ('[recording]\ntorqe = { column = "torque_Nm" }\n', "'torque'"),
        ('[recording]\ntorque = { colum = "torque_Nm" }\n', "'column'"),
        ('[recording]\nhold = "hold"\n', "'held'"),
        ('[recordings]\nhold = "held"\n', "'recording'"),
        ('[experiment]\nlop = "open"\n', "'loop'"),
        ('[experiment]\nloop = "opened"\n', "'open'"),
        ('[experiment]\njudge = "motions"\n', "'motion'"),
        ('[joints.motor]\ntorqe = "torque_Nm"\n', "'torque'"),
    ],
)
def test_an_unknown_name_in_a_binding_is_told_with_the_nearest(run, text, nearest):
    Path("log.csv").write_text(LOG)
    Path("log.toml").write_text(text)
    code, out, err = run("check", "log.csv", "--model", "robot_axis1")
    assert (code, out) == (2, "")
    assert f"did you mean {nearest}?" in err


@pytest.mark.parametrize(
    ("text", "nearest"),
    [
        ('[joints.joint11]\ntorque = "joint1.torque_Nm"\nangle = "joint1.angle_rad"\n', "'joint1'"),
        ('[joints.joint1]\ntorqe = "joint1.torque_Nm"\n', "'torque'"),
        ('[joints.joint1]\ntorque = "joint1.torque_N"\nangle = "joint1.angle_rad"\n', "'joint1.torque_Nm'"),
        ('[joints.joint1]\ntorque = { colum = "joint1.torque_Nm" }\n', "'column'"),
        ('[joint.joint1]\ntorque = "joint1.torque_Nm"\n', "'joints'"),
        ('[recording]\nhold = "meen"\n', "'mean'"),
        ('[experiment]\npayload = { body = "forearmm", mass = 1 }\n', "'forearm'"),
        ('[experiment]\npayload = { bdy = "forearm", mass = 1 }\n', "'body'"),
    ],
)
def test_an_unknown_name_in_the_binding_of_a_robot_is_told_with_the_nearest(run, text, nearest):
    Path("log.csv").write_text(ROBOT_LOG)
    Path("log.toml").write_text(text)
    code, out, err = run("check", "log.csv", "--model", "arm3")
    assert (code, out) == (2, "")
    assert f"did you mean {nearest}?" in err


CHIRP = '[excitation]\nkind = "chirp"\namplitude = 1.0\nlow_hz = 0.5\nhigh_hz = 30\n'


@pytest.mark.parametrize(
    ("text", "nearest"),
    [
        (f'abuot = "x"\n{CHIRP}', "'about'"),
        (f'engine = "od"\n{CHIRP}', "'ode'"),
        (CHIRP.replace("chirp", "chrip"), "'chirp'"),
        (CHIRP.replace("amplitude", "amplitud"), "'amplitude'"),
        (f"{CHIRP}[noise]\nvelocty = 0.1\n", "'velocity'"),
        (f'{CHIRP}[[effects]]\nid = "coulomb"\n', "'coulomb_friction'"),
        (f'{CHIRP}[[effects]]\nid = "backlash"\ngap = 1e-3\n', "'gap_rad'"),
        (f'{CHIRP}[[effects]]\nid = "backlash"\nplace = "gearbx"\ngap_rad = 1e-3\n', "'gearbox'"),
    ],
)
def test_an_unknown_name_in_a_scenario_is_told_with_the_nearest(run, text, nearest):
    Path("s.toml").write_text(text)
    code, out, err = run("run", "s.toml", "--out", "x")
    assert (code, out) == (2, "")
    assert f"did you mean {nearest}?" in err


def test_an_unknown_name_in_python_is_told_with_the_nearest():
    with pytest.raises(AttributeError, match="did you mean 'diagnose'"):
        _ = simgap.diagnos
    with pytest.raises(KeyError, match="did you mean 'coulomb_friction'"):
        _ = simgap.effects["coulomb"]
    with pytest.raises(ValueError, match="did you mean 'gearbox'"):
        simgap.effects["backlash"](place="gearbx", gap_rad=1e-3)
    with pytest.raises(simgap.InputError, match="did you mean 'force'"):
        simgap.diagnose({"time_s": [0]}, "pendulum", judge="forces")


def test_a_name_that_resembles_none_is_told_with_the_choices(run):
    code, _, err = run("render", "zzzz", "--out", "x.png")
    assert code == 2
    assert "robot_axis1" in err
    assert "did you mean" not in err


def test_a_shipped_model_goes_by_name_and_by_its_path_in_the_repository(run, tmp_path):
    from mjsim.models import model_path, shipped_model

    assert model_path("emps") == shipped_model("emps")
    assert model_path("models/emps.xml") == shipped_model("emps")
    assert model_path("models/none.xml") == Path("models/none.xml")
    (tmp_path / "emps").write_text("a file here comes first")
    assert model_path("emps") == Path("emps")


def test_the_library_of_effects(run):
    from mjsim.effects import registered

    code, out, _ = run("effects", "--json")
    assert code == 0
    told = {e["id"]: e for e in json.loads(out)}
    assert set(told) == set(registered())
    for name, cls in registered().items():
        assert told[name]["source"] == cls.citation
        assert told[name]["law"]
        assert {n: p["unit"] for n, p in told[name]["parameters"].items()} == {s.name: s.unit() for s in cls.specs()}
    code, out, _ = run("effects", "backlash")
    assert code == 0
    assert "gap_rad [rad; on a slide m]" in out
    assert "backlash_with_impact" in out
    listed = run("effects")[1]
    assert all(cls.name() in listed for cls in registered().values())


def test_the_doctor_says_what_is_there_and_what_is_broken(run, monkeypatch):
    from mjsim.errors import InputError
    from mjsim.models import shipped_models
    from mjsim.render import context

    monkeypatch.setattr(context, "backend", lambda: "egl (a renderer)")
    code, out, _ = run("doctor", "--json")
    told = json.loads(out)
    assert code == 0
    assert told["rendering"]["backend"] == "egl (a renderer)"
    assert told["models"]["names"] == list(shipped_models())
    assert told["linear_algebra"]["blas"][0]["kernel"]
    assert isinstance(told["compiled"]["simulation"], bool)

    def none() -> str:
        raise InputError("rendering", "no off-screen OpenGL")

    monkeypatch.setattr(context, "backend", none)
    code, out, err = run("doctor")
    assert code == 1
    assert "no off-screen OpenGL" in err
    assert len(err.splitlines()) == 1
    assert "Python" in out


def test_completion_of_a_command_imports_none():
    import os

    code = "from simgap.cli import main; main()"
    environment = os.environ | {"_SIMGAP_COMPLETE": "bash_complete", "COMP_WORDS": "simgap d", "COMP_CWORD": "1"}
    ended = subprocess.run([sys.executable, "-c", f"import sys; sys.argv = ['simgap']; {code}"], capture_output=True, text=True,
                           check=False, env=environment)  # fmt: skip
    assert [line.partition(",")[2] for line in ended.stdout.split()] == [n for n in COMMANDS if n.startswith("d")]
