"""The wheel holds one import package: its imports name only itself, and it works beside other people's packages of our names."""

from __future__ import annotations

import ast
import importlib.util
import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
pytest.importorskip("hatchling")


@pytest.fixture(scope="module")
def build():
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("from mjsim.ode import simulate", "from simgap._src.mjsim.ode import simulate"),
        ("    from diagnose import result", "    from simgap._src.diagnose import result"),
        ("import mjsim", "from simgap._src import mjsim"),
        ("import ident.bode as b", "import simgap._src.ident.bode as b"),
        ("import ident.bode", "import simgap._src.ident.bode; from simgap._src import ident"),
        ("import os, lab", "import os; from simgap._src import lab"),
        ('where = files("diagnose.report")', "where = files('simgap._src.diagnose.report')"),
        ("from .mjsim import x", "from .mjsim import x"),
        ("import labels", "import labels"),
        ('verb = "diagnose"', 'verb = "diagnose"'),
        ('é = "é"; from mjsim.x import y', 'é = "é"; from simgap._src.mjsim.x import y'),
    ],
)
def test_imports_name_the_installed_place(build, before, after):
    head = "if True:\n" if before.startswith(" ") else ""
    assert build.rewritten(f"{head}{before}\n") == f"{head}{after}\n"


@pytest.mark.slow
def test_nothing_in_the_wheel_imports_a_package_of_the_source_tree(build, tmp_path):
    build.lay_out(ROOT, tmp_path / "simgap")
    found = []
    for path in (tmp_path / "simgap").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module]
            found += [f"{path.name}: {n}" for n in names if n.partition(".")[0] in build.PACKAGES]
    assert not found
    assert (tmp_path / "simgap" / "models" / "robot_axis1.xml").is_file()
    assert (tmp_path / "simgap" / "py.typed").is_file()


@pytest.mark.slow
def test_the_wheel_has_one_top_level_name(tmp_path):
    """So that nothing that is installed can hide another distribution's package, or be hidden."""
    words = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(words, cwd=ROOT, check=True, capture_output=True, env=os.environ | {"SOURCE_DATE_EPOCH": "315532800"})
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {n.partition("/")[0] for n in names if ".dist-info/" not in n} == {"simgap"}
    assert not [n for n in names if "__pycache__" in n or n.startswith("simgap/_src/lab/panel")]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Python of a new environment that holds the wheel, in which other packages have the names of our source tree."""
    at = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "wheel", str(ROOT), "--no-deps", "--no-build-isolation", "-q", "-w", str(at)]
    subprocess.run(pip, check=True)
    (wheel,) = at.glob("*.whl")
    tops = {name.partition("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {t for t in tops if not t.endswith(".dist-info")} == {"simgap"}
    venv.create(at / "env", with_pip=True)
    python = at / "env" / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "-q", f"{wheel}[formats]"], check=True)
    work = at / "work"
    work.mkdir()
    for name in ("mjsim", "ident", "diagnose", "lab"):
        (work / f"{name}.py").write_text(f'raise RuntimeError("this is another {name}")\n', encoding="utf-8")
    return python, work


def run(installed, *words):
    python, work = installed
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA_CACHE"))}
    ended = subprocess.run([python, *words], cwd=work, env=clean, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, f"{words}: {ended.stderr}"
    return ended.stdout


API = """
import numpy as np, simgap
t = np.arange(0, 2, .004)
u = 3 * np.sin(2 * np.pi * (.3 + .5 * t) * t)
run = simgap.simulate("pendulum", u, dt=.004)
log = {"time_s": t, "torque_Nm": u, "velocity_rad_s": run.velocity + .01 * np.random.default_rng(0).standard_normal(t.size)}
found = simgap.diagnose(log, "pendulum", effects=["torque_offset"])
print(found.verdict.value, type(run).__module__)
"""


@pytest.mark.slow
def test_it_works_beside_other_packages_of_these_names(installed):
    assert run(installed, "-m", "simgap", "effects", "backlash").startswith("backlash")
    assert run(installed, "-c", API).split() == ["no_mismatch", "simgap._src.mjsim.recording"]
    run(installed, "-m", "simgap", "run", "coulomb_2", "--duration", "3", "--out", "logs", "--format", "parquet")
    only = ("--effects", "coulomb_friction,torque_offset", "--quiet")
    run(installed, "-m", "simgap", "diagnose", "logs/coulomb_2.parquet", "--model", "robot_axis1", "--out", "report", *only)
    run(installed, "-m", "simgap", "replay", "report/corrected.xml", "logs/coulomb_2.parquet", "--out", "prediction.mcap")
    assert {p.name for p in (installed[1] / "report").iterdir()} >= {"diagnosis.json", "corrected.xml", "report.html"}
    assert "usage" in run(installed, "-m", "simgap", "demo", "--help").lower()
