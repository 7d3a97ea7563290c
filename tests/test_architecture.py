"""The shape of the code: imports go one way, every name in ``__all__`` exists, files stay short, no machine's paths in them."""

from __future__ import annotations

import ast
import functools
import importlib
import math
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from mjsim.effects import registered

ROOT = Path(__file__).resolve().parents[1]
LAYERS = ("mjsim", "ident", "diagnose", "simgap", "lab")  # each may import those before it and itself
# commands that load the lab when they are called, and not before
LOAD_LAB = tuple(f"simgap/commands/{name}.py" for name in ("benchmark", "demo", "proof", "study"))
# stages of a diagnosis: each may import those before it and itself, at run time and for types alike
STAGES = ("data", "problem", "fit", "evidence", "structure", "explain", "verdict", "pipeline")
GROUND = ("mismatch", "options", "progress", "result", "thresholds")  # every stage may import these, and they no stage
SOURCES = sorted(
    p for layer in LAYERS for p in (ROOT / layer).rglob("*.py") if "speed" not in p.relative_to(ROOT).parts
)  # those are scripts
LONGEST = 400
LONG_BY_NATURE = {
    "mjsim/kernel.py": "one compiled unit: numba inlines across functions of one file, and every runner calls it",
    "lab/speed/other_machines.py": "a script: the equations and published numbers of several machines, each used once",
}


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@functools.cache
def tree_of(path: Path) -> ast.Module:
    """The syntax tree of a file, which several tests ask for."""
    return ast.parse(path.read_text(encoding="utf-8"))


def teardown_module() -> None:
    """Let the syntax trees go: each full collection of garbage goes through them."""
    tree_of.cache_clear()


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """All statements below a node, those inside functions and branches too."""
    for name in ("body", "orelse", "finalbody", "handlers", "cases"):
        for inner in getattr(node, name, ()):
            yield inner
            yield from statements(inner)


@functools.cache  # five tests ask for it
def imported(path: Path) -> list[tuple[int, str]]:
    """(line, absolute module) of every import, also those inside functions."""
    out = []
    package = name_of(path).split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    for node in statements(tree_of(path)):
        if isinstance(node, ast.Import):
            out += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(x for x in (base, node.module) if x)
            out += [(node.lineno, f"{module}.{alias.name}") for alias in node.names]
    return out


def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_imports_go_one_way():
    wrong = []
    for path in SOURCES:
        own = LAYERS.index(relative(path).split("/")[0])
        for line, module in imported(path):
            top = module.split(".")[0]
            if top == "lab" and relative(path) in LOAD_LAB:
                continue
            if top in LAYERS and LAYERS.index(top) > own:
                wrong.append(f"{relative(path)}:{line} imports {module}")
    assert not wrong


def imported_files(path: Path, files: dict[str, Path]) -> set[Path]:
    """The files that a file imports: a module, or the package that hands the name on."""
    out = set()
    for _, module in imported(path):
        found = files.get(module) or files.get(module.rpartition(".")[0])
        if found is not None and found != path:
            out.add(found)
    return out


def circles(graph: dict[Path, set[Path]]) -> list[list[Path]]:
    """Strongly connected components of more than one file (Tarjan)."""
    index: dict[Path, int] = {}
    low: dict[Path, int] = {}
    stack: list[Path] = []
    out: list[list[Path]] = []

    def visit(node: Path) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph[node]:
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            at = stack.index(node)
            if len(stack) - at > 1:
                out.append(stack[at:])
            del stack[at:]

    for node in graph:
        if node not in index:
            visit(node)
    return out


def test_no_files_import_each_other_in_a_circle():
    """Imports inside functions and for types alone count too."""
    files = {name_of(p): p for p in SOURCES}
    found = circles({p: imported_files(p, files) for p in SOURCES})
    assert [sorted(map(relative, c)) for c in found] == []


def test_a_circle_is_found():
    a, b, c = Path("a"), Path("b"), Path("c")
    assert circles({a: {b}, b: {c}, c: {b}}) == [[b, c]]
    assert circles({a: {b, c}, b: {c}, c: set()}) == []


# files outside mjsim/effects that hold an effect's identifier as text, and why
NAMES_AN_EFFECT = {
    "diagnose/check/faults/joint_stop.py": "a fault of the log that has the name of the physics behind it",
    "lab/real_use/design.py": "makes logs of models that lack known effects",
    "lab/real_use/pid.py": "makes logs of models that lack integral action and what it may be taken for",
    "diagnose/robot/laws.py": "the laws of a force regression, under the identifiers of the contract",
    "diagnose/robot/servos/library.py": "the laws of a servo joint, under the identifiers of the contract",
    "mjsim/robot/carried.py": "the slots of the effects that a robot's file carries",
    "lab/robot/cases.py": "conceals known effects in robots",
    "lab/robot/servo_cases.py": "conceals known effects in servo robots",
    "lab/robot/integral.py": "lists the effects that it conceals beside integral action",
    "diagnose/explain/second_encoder.py": "terms of its own model of a second encoder, which bear the names of the contract",
    "lab/fuzz/corpus.py": "makes a corrected file that carries an effect",
    "lab/kill.py": "makes recordings of a known effect",
    "lab/proof/concealed.py": "conceals known effects in real recordings",
    "lab/proof/emps.py": "published values of named effects",
    "lab/proof/kuka.py": "published values of named effects",
    "lab/proof/kuka_robot.py": "published values of named effects",
    "lab/proof/summary.py": "published values of named effects",
}


def test_nothing_asks_for_an_effect_by_its_name():
    """What a consumer needs to know of an effect is declared in the effect's own file."""
    ids = "|".join(registered())
    named, cases = re.compile(rf"({ids})(@\w+)?"), ("lab/benchmark/", "lab/panel/", "lab/real_use/firmware/")
    found = {
        relative(path)
        for path in SOURCES
        if not relative(path).startswith(("mjsim/effects/", *cases))  # laws, and truths of cases
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and named.fullmatch(node.value)
    }
    assert found == set(NAMES_AN_EFFECT)


def test_effects_know_no_mjcf():
    wrong = [
        f"{relative(path)}:{line} imports {module}"
        for path in SOURCES
        if relative(path).startswith("mjsim/effects/") or relative(path) == "mjsim/chain.py"
        for line, module in imported(path)
        if module.startswith(("mjsim.mjcf", "mjsim.axis", "mujoco"))
    ]
    assert not wrong


def stage_of(module: str) -> str:
    """The stage of ``diagnose.STAGE...``, empty of any other module."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[0] == "diagnose" and parts[1] in (*STAGES, *GROUND) else ""


def test_stages_of_a_diagnosis_are_imported_one_way():
    wrong = []
    for path in SOURCES:
        own = stage_of(name_of(path))
        for line, module in imported(path) if own else ():
            other = stage_of(module)
            if other in STAGES and (own in GROUND or STAGES.index(other) > STAGES.index(own)):
                wrong.append(f"{relative(path)}:{line} imports {module}")
    assert not wrong


# numbers of a format, of geometry or of the table itself, which decide nothing
NO_THRESHOLDS = {
    "diagnose/fit/ledger.py": {"FORMAT"},  # version of a file
    "diagnose/structure/score.py": {"QUARTERS"},  # of a turn
    "diagnose/problem/hypothesis.py": {"STIFFEST"},  # from numbers of the table
}


# pages, robots, checks of the log and the comparison with the simulator have numbers of their own
NOT_IN_THE_TABLE = (
    "diagnose/report/",
    "diagnose/robot/",
    "diagnose/check/",
    "diagnose/verdict/reference",
    "diagnose/verdict/numerics",
    "diagnose/thresholds.py",
)


def numeric_constants(path: Path) -> set[str]:
    """Names at the top of a module that are given a value with a number in it."""
    names = set()
    for node in tree_of(path).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            numbers = [
                n for n in ast.walk(node.value)
                if isinstance(n, ast.Constant) and isinstance(n.value, int | float) and not isinstance(n.value, bool)
            ]  # fmt: skip
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if numbers:
                names |= {n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)}
    return names


def test_numbers_of_a_diagnosis_stand_in_one_table():
    wrong = {}
    for path in SOURCES:
        name = relative(path)
        if name.startswith("diagnose/") and not name.startswith(NOT_IN_THE_TABLE):
            found = numeric_constants(path) - NO_THRESHOLDS.get(name, set())
            if found:
                wrong[name] = found
    assert not wrong


def test_each_number_says_what_it_is_and_which_test_exercises_it():
    thresholds = importlib.import_module("diagnose.thresholds")
    named = numeric_constants(ROOT / "diagnose/thresholds.py")
    derived = {name for name, t in thresholds.TABLE.items() if t.kind == thresholds.DERIVED}  # without a number of their own
    assert thresholds.TABLE.keys() - derived == named - derived
    for name, t in thresholds.TABLE.items():
        assert getattr(thresholds, name) == t.value
        assert t.kind in (thresholds.LEVEL, thresholds.COST, thresholds.NUMERIC, thresholds.DERIVED)
        assert t.unit, name
        assert t.why, name
        assert (ROOT / t.test).is_file(), t.test


# how many numbers of each kind the table may hold: a new one takes the place of another, or this page says why there are more
MOST_NUMBERS = {"level of a decision": 12, "cost": 5, "numerical tolerance": 23}


def test_the_table_of_numbers_does_not_grow():
    thresholds = importlib.import_module("diagnose.thresholds")
    found = Counter(t.kind for t in thresholds.TABLE.values())
    assert all(found[kind] <= most for kind, most in MOST_NUMBERS.items()), found


def test_what_is_derived_follows_from_other_numbers():
    t = importlib.import_module("diagnose.thresholds")
    derived = {name for name, x in t.TABLE.items() if x.kind == t.DERIVED}
    assert " ".join(sorted(derived)) == "FAIR FAR FEWEST LARGE LEADING LEAST_SAMPLES ONE_FIT SAME SENSOR_SHARE SHORTEST"
    assert math.isclose(math.sqrt(2 / t.LEAST_SAMPLES), t.MATERIAL), "a mean square is known to a material gain"
    assert math.isclose(1 / math.sqrt(2 * t.FEWEST), t.SMALL), "an rms is known to a small share"
    assert math.isclose(1 / math.sqrt(2 * t.SHORTEST), t.TWICE * t.SMALL), "a weight is known to a tenth"
    assert math.isclose(math.sqrt(t.FAIR), 1 / t.TWICE)
    assert math.isclose(t.SAME * t.CLEAR, t.MATERIAL)
    assert math.isclose((t.LARGE - 1) * t.TWICE, 1), "an error of half the variance of the noise"
    assert math.isclose(t.FAR - 1, t.TWICE), "an error of twice the variance of the noise"
    assert math.isclose(t.SENSOR_SHARE, t.SMALL * t.MATERIAL)
    assert math.isclose(t.ONE_FIT * t.LEADING, 1)


# private metaphors that standard terms have replaced (residual, confounder, divergence, prediction, zero, negligible, ...)
METAPHORS = re.compile(
    r"\b(what is left|stand-ins?|entrants?|raced?|let go|astray|foret(ell|old)|shaken|unfolded|creased|nought|to speak of|trifle"
    r"|bears? out)\b",
    re.I,
)


def test_texts_use_the_terms_of_the_field():
    wrong = [
        f"{relative(path)}:{k}: {line.strip()}"
        for path in SOURCES
        if relative(path).startswith(("mjsim/", "ident/", "diagnose/", "simgap/"))
        for k, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if METAPHORS.search(line)
    ]
    assert wrong == []


def test_the_flow_is_read_on_a_page():
    assert len((ROOT / "diagnose/pipeline.py").read_text(encoding="utf-8").splitlines()) <= 120


def test_the_sealed_plant_shares_no_physics_with_what_it_tests():
    """A benchmark whose plant used the library's laws or solver would only show that the library agrees with itself."""
    parts = ("effects", "ode", "kernel", "system", "reference", "affine", "batch", "accurate")
    barred = ("diagnose", *(f"mjsim.{part}" for part in parts))
    wrong = [
        f"{relative(path)}:{line} imports {module}"
        for path in SOURCES
        if relative(path).startswith("lab/benchmark/") and not relative(path).startswith("lab/benchmark/arms/")
        for line, module in imported(path)
        if any(module == b or module.startswith(f"{b}.") for b in (*barred, "lab.benchmark.arms"))
    ]
    assert not wrong


def test_a_rival_arm_knows_nothing_of_the_sealed_plant():
    """Arms are on the fitting side: they may use the fitter, and see no more of the generator than the recordings."""
    own = ("lab.benchmark.arms",)
    wrong = [
        f"{relative(path)}:{line} imports {module}"
        for path in SOURCES
        if relative(path).startswith("lab/benchmark/arms/")
        for line, module in imported(path)
        if module.startswith("lab.benchmark.") and not any(module == b or module.startswith(f"{b}.") for b in own)
    ]
    assert not wrong


def test_all_names_exist():
    wrong = [f"{relative(p)}: {what}" for p in SOURCES if p.name != "__main__.py" for what in faults_of_names(p)]
    assert not wrong


def faults_of_names(path):
    """What is wrong with a file's ``__all__``; a file that has public names needs one, and a text beside it."""
    tree = tree_of(path)
    has_all = any(
        isinstance(n, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in n.targets) for n in tree.body
    )
    defines = any(isinstance(n, ast.ClassDef | ast.FunctionDef) and not n.name.startswith("_") for n in tree.body)
    if not has_all:
        return ["defines public names and has no __all__"] if defines else []
    module = importlib.import_module(name_of(path))
    names = module.__all__
    wrong = [f"{n} is not there" for n in names if not hasattr(module, n)]
    if len(set(names)) != len(names):
        wrong.append("a name stands twice in __all__")
    if not ast.get_docstring(tree):
        wrong.append("does not say what it is")
    return wrong


def test_files_stay_readable():
    """Tests and scripts as well; what is longer stands in a list, with its reason, and leaves it when it is no longer so."""
    files = [p for top in (*LAYERS, "tests", "examples") for p in (ROOT / top).rglob("*.py")]
    lines = {relative(p): len(p.read_text(encoding="utf-8").splitlines()) for p in files}
    assert {k for k, v in lines.items() if v > LONGEST} == LONG_BY_NATURE.keys()


def test_one_effect_is_one_file():
    effects = [p for p in SOURCES if relative(p).startswith("mjsim/effects/")]
    for path in effects:
        registered = sum(
            any(isinstance(d, ast.Name) and d.id == "register" for d in node.decorator_list)
            for node in tree_of(path).body if isinstance(node, ast.ClassDef)
        )  # fmt: skip
        assert registered <= 1, relative(path)
        if registered:
            assert len(path.read_text(encoding="utf-8").splitlines()) <= 150, relative(path)


def test_no_machine_paths():
    """What is written down must hold on every machine."""
    where = re.compile(r"(?<![\w.])/(?:" + "|".join(("home", "root", "work", "tmp", "Users", "mnt")) + r")/")
    kinds = {".py", ".md", ".toml", ".xml", ".yml", ".yaml", ".json", ".csv", ".html", ".j2", ".css"}
    wrong = []
    for top in (*LAYERS, "tests", "docs", "examples", "models", ".github", ".ci"):
        for path in (ROOT / top).rglob("*"):
            written = path.suffix in kinds or (top == ".ci" and "__pycache__" not in path.parts)
            if path.is_file() and written and path != Path(__file__).resolve():
                text = path.read_text(encoding="utf-8")
                wrong += [f"{relative(path)}: {m.group()}" for m in where.finditer(text)]
    for name in ("README.md", "CHANGELOG.md", "Makefile", "pyproject.toml"):
        if (ROOT / name).is_file():
            wrong += [f"{name}: {m.group()}" for m in where.finditer((ROOT / name).read_text(encoding="utf-8"))]
    assert not wrong
