"""Bad input through the command line: exit 2, one line on standard error that says what, where and what to do, nothing left."""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from mjsim.errors import InputError
from mjsim.models import shipped_model
from simgap import cli

N = 600
DT = 5e-4
TIME = DT * np.arange(N)
MODEL = str(shipped_model("robot_axis1"))
NAMES = ("time_s", "torque_Nm", "velocity_rad_s", "angle_rad")


def table(**changed: np.ndarray) -> str:
    """A recording as CSV text, some of its columns replaced."""
    rng = np.random.default_rng(0)
    columns = {
        "time_s": TIME,
        "torque_Nm": np.sin(40 * TIME),
        "velocity_rad_s": 10 * np.sin(40 * TIME) + 0.01 * rng.standard_normal(N),
        "angle_rad": -0.25 * np.cos(40 * TIME),
        **changed,
    }
    rows = (",".join(f"{x:.9g}" for x in row) for row in zip(*columns.values(), strict=True))
    return "\n".join([",".join(columns), *rows]) + "\n"


GOOD = table()


def replaced(row: int, cell: int, text: str) -> str:
    """The good table with one cell (counted from 1, the header is row 1) replaced."""
    lines = GOOD.splitlines()
    cells = lines[row - 1].split(",")
    cells[cell - 1] = text
    lines[row - 1] = ",".join(cells)
    return "\n".join(lines) + "\n"


def dropped(row: int) -> str:
    lines = GOOD.splitlines()
    return "\n".join(lines[: row - 1] + lines[row:]) + "\n"


def without(name: str) -> str:
    keep = [i for i, n in enumerate(NAMES) if n != name]
    return "\n".join(",".join(line.split(",")[i] for i in keep) for line in GOOD.splitlines()) + "\n"


def backwards() -> str:
    lines = GOOD.splitlines()
    lines[300], lines[301] = lines[301], lines[300]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


@pytest.fixture
def simgap(monkeypatch, capsys, tmp_path):
    """``simgap("diagnose", ...)``: the command as a user calls it, in this process and in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["simgap", *words])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        return Outcome(int(ended.value.code or 0), said.out, said.err)

    return call


def check(outcome: Outcome, *said: str, left: Path | None = Path("report")) -> None:
    assert outcome.code == 2, outcome
    assert outcome.out == ""
    (line,) = outcome.err.strip().splitlines()
    assert "Traceback" not in line
    for words in said:
        assert words in line, line
    if left is not None:
        assert not left.exists(), f"left behind: {sorted(left.rglob('*'))}"


TABLES = {
    "missing torque": (without("torque_Nm"), ["log.csv", "no column 'torque_Nm'", "time_s", "log.toml"]),
    "missing time": (without("time_s"), ["log.csv", "no column 'time_s'"]),
    "no output": ("\n".join(",".join(x.split(",")[:2]) for x in GOOD.splitlines()), ["log.csv", "velocity"]),
    "not a number": (replaced(17, 2, "oops"), ["log.csv", "row 17", "'torque_Nm'", "'oops'", "a number"]),
    "empty cell": (replaced(18, 3, ""), ["log.csv", "row 18", "velocity_rad_s"]),
    "nan": (replaced(42, 3, "nan"), ["log.csv", "velocity", "row 42", "finite"]),
    "infinite": (replaced(43, 2, "inf"), ["log.csv", "torque", "row 43", "finite"]),
    "short row": (GOOD.rstrip("\n").rsplit(",", 1)[0] + "\n", ["log.csv", f"row {N + 1}", "3 cells", "4"]),
    "a sample is missing": (dropped(100), ["log.csv", "sample time", "row 100", "uniform"]),
    "time goes back": (backwards(), ["log.csv", "time does not increase", "row"]),
    "empty": ("", ["log.csv", "empty"]),
    "header only": (",".join(NAMES) + "\n", ["log.csv", "header and no data"]),
    "a picture": ("\x89PNG\r\n\x1a\n\x00\x01\x02", ["log.csv"]),
    "two separators": (GOOD.replace(",", ";", 1), ["log.csv", "4 columns under 3 names"]),
    "opposite signs of motion": (table(velocity_rad_s=-10 * np.sin(40 * TIME)), ["log.csv", "-1 times", "velocity"]),
    "angle in degrees": (table(angle_rad=-14.3239 * np.cos(40 * TIME)), ["log.csv", "57.", "velocity", "rad"]),
    "wrapped angle": (
        table(velocity_rad_s=50 + np.sin(40 * TIME), angle_rad=np.mod(50 * TIME, 2 * np.pi)),
        ["log.csv", "jumps", "6.2", "unwrap"],
    ),
    "no header": ("\n".join(GOOD.splitlines()[1:]), ["log.csv", "row 1", "header"]),
    "too short": ("\n".join(GOOD.splitlines()[:120]) + "\n", ["log.csv", "119 samples", "at least"]),
    "constant torque": (table(torque_Nm=np.ones(N)), ["log.csv", "torque is constant"]),
    "not moving": (
        table(velocity_rad_s=1e-3 * np.random.default_rng(1).standard_normal(N), angle_rad=np.zeros(N)),
        ["log.csv", "noise", "excite"],
    ),
    "standing": (table(velocity_rad_s=np.zeros(N), angle_rad=np.zeros(N)), ["log.csv", "motion", "excite"]),
}


@pytest.mark.parametrize("case", TABLES)
def test_a_bad_table(simgap, case):
    text, said = TABLES[case]
    Path("log.csv").write_text(text, encoding="latin-1")
    check(simgap("diagnose", "log.csv", "--model", MODEL, "--out", "report"), *said)


@pytest.mark.parametrize("case", ["missing torque", "not a number", "nan", "a sample is missing", "empty"])
@pytest.mark.parametrize("command", ["identify", "replay"])
def test_a_bad_table_in_the_other_commands(simgap, command, case):
    text, said = TABLES[case]
    Path("log.csv").write_text(text, encoding="latin-1")
    words = ("log.csv",) if command == "identify" else (MODEL, "log.csv")
    check(simgap(command, *words, "--out", "report"), *said)


def test_a_held_out_recording_that_is_fitted(simgap):
    Path("log.csv").write_text(GOOD)
    Path("copy.csv").write_text(GOOD)
    check(simgap("diagnose", "log.csv", "--held-out", "copy.csv", "--model", MODEL, "--out", "report"), "copy.csv", "log.csv")


def test_a_bad_held_out_recording(simgap):
    Path("log.csv").write_text(GOOD)
    Path("other.csv").write_text(TABLES["nan"][0])
    check(simgap("diagnose", "log.csv", "--held-out", "other.csv", "--model", MODEL, "--out", "report"), "other.csv", "row 42")


def test_a_recording_that_is_not_there(simgap):
    check(simgap("diagnose", "nowhere.csv", "--model", MODEL, "--out", "report"), "nowhere.csv", "no such file")


@pytest.mark.parametrize("kind", [".mat", ".npz", ".parquet", ".mcap", ".xlsx"])
def test_a_file_that_is_not_what_its_name_says(simgap, kind):
    Path(f"log{kind}").write_text(GOOD)
    check(simgap("diagnose", f"log{kind}", "--model", MODEL, "--out", "report"), f"log{kind}")


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        ('torque = { column = "torque_Nm", unit = "furlong" }', ["log.toml", "torque", "'furlong'", "Nm"]),
        ('torque = { column = "torque_Nm", unit = "rpm" }', ["log.toml", "torque", "measures velocity"]),
        ('torque = { column = "torque_Nm", unit = "V" }', ["log.toml", "torque", "gain"]),
        ('torque = { column = "torque_Nm", gain = "big" }', ["log.toml", "gain", "'big'"]),
        ('torque = { column = "torque_Nm", unit = 7 }', ["log.toml", "unit", "7"]),
        ('torque = "torque_Nm"\nspeed = "velocity_rad_s"', ["log.toml", "'speed'", "velocity"]),
        ('torque = "torque_Nm"\nvelocity = "omega"', ["log.csv", "'omega'"]),
        ('torque = "torque_Nm"\nvelocity = "velocity_rad_s"\ndt = "fast"', ["log.toml", "dt", "'fast'"]),
        ("torque = ", ["log.toml", "TOML"]),
    ],
)
def test_a_bad_binding(simgap, toml, said):
    Path("log.csv").write_text(GOOD)
    text = f"[recording]\n{toml}\n"
    Path("log.toml").write_text(text if "time" in toml or "dt" in toml else text + 'time = "time_s"\n')
    check(simgap("diagnose", "log.csv", "--model", MODEL, "--out", "report"), *said)


ONE_BODY = """<mujoco><compiler autolimits="false"/><option gravity="0 0 0"/><worldbody><body>
<joint name="motor" type="hinge" damping="0.03"/><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
{actuator}</mujoco>"""
BOUND = '[model]\nactuator = "motor_torque"\n'


@pytest.mark.parametrize(
    ("xml", "toml", "said"),
    [
        ("", "", ["axis.xml"]),
        ("<mujoco><worldbody><body>", "", ["axis.xml"]),
        ("<robot/>", "", ["axis.xml"]),
        ('<mujoco><worldbody><body><joint type="banana"/></body></worldbody></mujoco>', "", ["axis.xml", "banana"]),
        ("<mujoco/>", "", ["axis.xml"]),
        (ONE_BODY.format(actuator=""), BOUND, ["axis.xml", "actuator"]),
        (ONE_BODY.format(actuator='<actuator><motor name="other" joint="motor"/></actuator>'), BOUND,
         ["motor_torque", "other"]),
        (ONE_BODY.format(actuator='<actuator><motor name="motor_torque" joint="motor"/></actuator>'),
         '[model]\nactuators = "motor_torque"\n', ["axis.toml", "'actuators'"]),
    ],
)  # fmt: skip
def test_a_bad_model(simgap, xml, toml, said):
    Path("log.csv").write_text(GOOD)
    Path("axis.xml").write_text(xml)
    if toml:
        Path("axis.toml").write_text(toml)
    check(simgap("diagnose", "log.csv", "--model", "axis.xml", "--out", "report"), *said)


def test_a_model_that_is_not_there(simgap):
    Path("log.csv").write_text(GOOD)
    check(simgap("diagnose", "log.csv", "--model", "nowhere.xml", "--out", "report"), "nowhere.xml")


def test_an_effect_that_is_not_known(simgap):
    Path("log.csv").write_text(GOOD)
    outcome = simgap("diagnose", "log.csv", "--model", MODEL, "--out", "report", "--effects", "backlash,warp_drive")
    check(outcome, "--effects", "'warp_drive'", "coulomb_friction")


def test_an_effect_that_this_chain_cannot_have(simgap):
    """Nothing is left to try: that is said rather than reported as no finding."""
    Path("log.csv").write_text(GOOD)
    columns = zip(("time", "torque", "velocity", "angle"), NAMES, strict=True)
    Path("log.toml").write_text("[recording]\n" + "".join(f'{role} = "{name}"\n' for role, name in columns))
    outcome = simgap("diagnose", "log.csv", "--model", str(shipped_model("emps")), "--out", "report", "--effects", "hysteresis")
    check(outcome, "--effects", "hysteresis")


def test_an_unknown_scenario(simgap):
    check(simgap("run", "moonwalk", "--out", "report"), "moonwalk")


@pytest.mark.parametrize(
    "words", [("diagnose",), ("diagnose", "log.csv"), ("identify", "log.csv"), ("warp",), ("demo", "--seed", "x")]
)
def test_bad_usage_names_the_help(simgap, words):
    outcome = simgap(*words)
    assert outcome.code == 2
    assert "Traceback" not in outcome.err
    assert re.search(r"Usage:|--help", outcome.err)


@pytest.mark.parametrize(
    "words",
    [
        ("diagnose", "log.csv", "--model", "robot_axis1", "--out", "out", "--budget"),
        ("diagnose", "log.csv", "--model", "robot_axis1", "--out", "out", "--effort"),
        ("gate", "robot_axis1", "log.csv", "--baseline", "diagnosis.json", "--tolerance"),
        ("fleet", "*.csv", "--model", "robot_axis1", "--out", "out", "--effort"),
        ("render", "step", "--out", "film.mp4", "--speed"),
        ("crosscheck", "--duration"),
    ],
)
def test_a_number_that_is_not_finite(simgap, words):
    """NaN lies in every range, since it compares with no bound."""
    for given in ("nan", "inf"):
        outcome = simgap(*words, given)
        assert outcome.code == 2
        assert re.search(rf"'{words[-1]}': (inf|nan) is (no finite number|not in the range)", outcome.err)


def test_a_duration_of_more_samples_than_an_array_can_hold(simgap):
    for words in (("crosscheck", "--duration", "1e300"), ("run", "step", "--out", "out", "--duration", "1e300")):
        outcome = simgap(*words)
        assert outcome.code == 2
        assert len(outcome.err.splitlines()) == 1
        assert "1e+300 s in samples of 0.0005 s" in outcome.err


def test_a_place_that_cannot_be_written(simgap):
    Path("log.csv").write_text(GOOD)
    Path("report").write_text("a file stands where the folder should")
    outcome = simgap("diagnose", "log.csv", "--model", MODEL, "--out", "report", "--effects", "coulomb_friction")
    check(outcome, "report", left=None)
    assert Path("report").read_text() == "a file stands where the folder should"


def test_the_process_itself(tmp_path):
    """The same through ``python -m simgap``: exit code and streams of the process."""
    (tmp_path / "log.csv").write_text(TABLES["nan"][0])
    words = [sys.executable, "-m", "simgap", "diagnose", "log.csv", "--model", MODEL, "--out", "report"]
    ended = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    check(Outcome(ended.returncode, ended.stdout, ended.stderr), "log.csv", "row 42", left=tmp_path / "report")


def test_a_process_that_meets_bad_input_says_so_to_the_one_that_waits_for_it() -> None:
    """Else it ends there, and what is told is that a pool was broken."""
    error = InputError(Path("log.csv"), "no rows", "some", "record again")
    assert str(pickle.loads(pickle.dumps(error))) == str(error) == "log.csv: no rows; expected some; record again"
