"""Scenarios: model + effects + excitation + controller + noise + seed, as validated TOML, and the log that they write.

model = "robot_axis1"               # a shipped model, or a path from the scenario's file
engine = "ode"                      # ode | accurate | literal
seed = 1
duration_s = 20.0
[excitation]
kind = "chirp"                      # chirp | multisine | step | trapezoids
...
[[effects]]
id = "coulomb_friction"
torque_Nm = 0.1
[noise]
velocity = 0.05                     # standard deviations of white noise, in the units of the log
"""

from __future__ import annotations

import enum
import hashlib
import json
import os
import platform
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from mjsim import excitation as ex
from mjsim.axis import Axis
from mjsim.effects import BacklashLaw, Effect, effect_class, registered
from mjsim.errors import InputError, nearest
from mjsim.models import model_beside
from mjsim.ode import Trajectory
from mjsim.quantity import Motion
from mjsim.scenario_parts import Chirp, Multisine, Noise, Positive, Step, Strict, Trapezoids
from mjsim.toml import toml_at

__all__ = [
    "Engine",
    "Format",
    "Log",
    "Scenario",
    "load_scenario",
    "make_effect",
    "provenance",
    "refused",
    "run",
    "shipped_scenarios",
    "versions",
    "write_columns",
    "write_log",
]

_FOLDER = Path(__file__).parent / "scenarios"
KINDS: dict[object, type[Strict]] = {"chirp": Chirp, "multisine": Multisine, "step": Step, "trapezoids": Trapezoids}


class Engine(enum.Enum):
    """What runs the scenario."""

    ODE = "ode"
    ACCURATE = "accurate"
    LITERAL = "literal"


class Format(enum.Enum):
    """The log's file format."""

    CSV = "csv"
    PARQUET = "parquet"


class Scenario(Strict):
    """A validated scenario; ``name`` and ``folder`` come from its file."""

    name: str
    folder: Path
    about: str = ""
    model: str = "robot_axis1"
    engine: Engine = Engine.ODE
    seed: Annotated[int, Field(ge=0)] = 0
    duration_s: Positive = 20.0
    sample_time_s: Positive = 5e-4
    backlash_law: Literal["gated", "ungated", "no_pull"] = "gated"
    format: Format = Format.CSV
    excitation: Annotated[Chirp | Multisine | Step | Trapezoids, Field(discriminator="kind")]
    effects: tuple[dict[str, Any], ...] = ()
    linear: dict[str, float] = Field(default_factory=dict)
    noise: Noise = Noise()

    @property
    def model_path(self) -> Path:
        """The model's file, as `mjsim.models.model_beside` finds it from the scenario's folder."""
        return model_beside(self.folder, self.model)

    def axis(self) -> Axis:
        """The axis that runs: the model's own chain and effects with the scenario's laid on. Raises InputError."""
        from mjsim.mjcf import load_axis

        where = f"scenario {self.name!r}"
        axis = load_axis(self.model_path)
        axis = Axis(axis.chain, axis.effects, BacklashLaw[self.backlash_law.upper()])
        if self.linear:
            try:
                axis = axis.with_linear(self.linear)
            except (KeyError, ValueError) as error:
                raise InputError(f"{where}: [linear]", str(error.args[0])) from None
        for given in self.effects:
            effect = make_effect(given, where)
            if effect.key in {e.key for e in axis.effects}:
                axis = axis.without(effect.key)
            axis = axis + effect
        from mjsim.system import assemble

        try:
            assemble(axis)
        except ValueError as error:
            raise InputError(where, f"an effect does not fit the axis ({error})", todo="choose another place or value") from None
        return axis


def make_effect(given: Mapping[str, Any], where: str) -> Effect:
    """An effect from its table ``{id, place, parameters}``. Raises InputError listing what there is to choose from."""
    name = str(given.get("id", ""))
    if name not in registered():
        raise InputError(f"{where}: [[effects]] id", repr(name), f"one of {', '.join(registered())}", nearest(name, registered()))
    cls = effect_class(name)
    known = {spec.name for spec in cls.specs()}
    unknown = set(given) - known - {"id", "place"}
    if unknown:
        raise InputError(
            f"{where}: effect {name!r}",
            f"unknown key {sorted(unknown)[0]!r}",
            f"{', '.join(sorted(known))}, place",
            nearest(min(unknown), known, "rename it"),
        )
    try:
        return cls(**{k: v for k, v in given.items() if k != "id"})
    except (TypeError, ValueError) as error:
        said = str(error).replace(f"{cls.__name__}.__init__() ", "")
        raise InputError(f"{where}: effect {name!r}", said, f"{', '.join(sorted(known))}, place", "correct it") from None


def shipped_scenarios() -> dict[str, str]:
    """Names of the shipped scenarios and what they are about."""
    out = {}
    for path in sorted(_FOLDER.glob("*.toml")):
        out[path.stem] = str(toml_at(path).get("about", ""))
    return out


def load_scenario(source: str | Path, **overrides: Any) -> Scenario:
    """A scenario from a TOML file or a shipped one by name; ``overrides`` that are not None replace keys. Raises InputError."""
    path = Path(source)
    if path.suffix != ".toml" or not path.is_file():
        path = _FOLDER / f"{Path(source).name.removesuffix('.toml')}.toml"
        if not path.is_file() or os.sep in str(source):
            raise InputError(
                f"scenario {str(source)!r}", "no such file and no shipped scenario", f"a .toml file or one of: "
                f"{', '.join(shipped_scenarios())}", nearest(Path(source).name, shipped_scenarios()),
            )  # fmt: skip
    table = toml_at(path)
    table.update({k: v for k, v in overrides.items() if v is not None})
    try:
        return Scenario(**{**table, "name": path.stem, "folder": path.resolve().parent})
    except ValidationError as error:
        kind = table["excitation"].get("kind") if isinstance(table.get("excitation"), dict) else None
        tables: dict[str, type[Strict]] = {"noise": Noise, **({"excitation": KINDS[kind]} if kind in KINDS else {})}
        raise refused(path, error.errors(), Scenario, tables) from None


def refused(path: Path, errors: Sequence[Any], scenario: type[Strict], tables: Mapping[str, type[Strict]]) -> InputError:
    """The error for the first key that a scenario may not have, else for the first value that is wrong.

    ``scenario``: the class of the file; ``tables``: those of its tables by name.
    """
    first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
    loc = [str(part) for part in first["loc"]]
    if first["type"] == "extra_forbidden":
        known = _keys(loc, scenario, tables)
        where = f"{path}: [{loc[0]}]" if len(loc) > 1 else str(path)
        return InputError(
            where, f"key {loc[-1]!r} is not known", ", ".join(known), nearest(loc[-1], known, "rename or remove it")
        )
    said, advice = first["msg"][0].lower() + first["msg"][1:], "correct it"
    choices = re.findall(r"'(\w+)'", str(first.get("ctx", {}).get("expected_tags", first.get("ctx", {}).get("expected", ""))))
    given = first.get("ctx", {}).get("tag", first["input"])
    if choices:
        said, expected, advice = f"{given!r}", f"one of {', '.join(choices)}", nearest(str(given), choices, advice)
        loc += [first["ctx"]["discriminator"].strip("'")] if "discriminator" in first["ctx"] else []
        return InputError(f"{path}: {'.'.join(loc)}", said, expected, advice)
    return InputError(f"{path}: {'.'.join(loc) or 'the scenario'}", said, "", advice)


def _keys(loc: Sequence[str], scenario: type[Strict], tables: Mapping[str, type[Strict]]) -> tuple[str, ...]:
    """Keys that the table at ``loc`` of a scenario may have."""
    if len(loc) > 1 and loc[0] in tables:
        return tuple(tables[loc[0]].model_fields)
    return tuple(sorted(set(scenario.model_fields) - {"name", "folder"}))


@dataclass(frozen=True)
class Log:
    """What a scenario gives: the axis, its true motion, and the logged columns (noise included) by name."""

    scenario: Scenario
    axis: Axis
    motion: Trajectory
    columns: Mapping[str, np.ndarray]


def run(scenario: Scenario) -> Log:
    """Run a scenario. Raises InputError for what cannot be run and DivergedError, naming time and body, when it runs away."""
    axis = scenario.axis()
    dt, duration = scenario.sample_time_s, scenario.duration_s
    phases, noise = (np.random.default_rng(s) for s in np.random.SeedSequence(scenario.seed).spawn(2))
    count = ex.samples(duration, dt)
    if count < 2:
        raise InputError(
            f"scenario {scenario.name!r}: duration_s", repr(duration), f"at least two samples of {dt} s", "lengthen it"
        )
    white = {key: noise.standard_normal(count) for key in ("velocity", "angle", "torque")}
    if isinstance(scenario.excitation, Trapezoids):
        e = scenario.excitation
        wanted = ex.trapezoids(duration, dt, e.speed, e.acceleration, e.hold_s, e.rest_s)
        torque = ex.close_loop(axis, wanted, dt, e.cascade, scenario.noise.velocity * white["velocity"])
    else:
        try:
            torque = scenario.excitation.torque(duration, dt, phases)
        except ValueError as error:
            raise InputError(
                f"scenario {scenario.name!r}: [excitation]", str(error), todo="change the band or the period"
            ) from None
    motion = _engine(scenario, axis)(torque, dt)
    hinge = axis.chain.motion is Motion.HINGE
    names = ("torque_Nm", "velocity_rad_s", "angle_rad") if hinge else ("force_N", "velocity_m_s", "position_m")
    values = (motion.torque, motion.velocity, motion.angle)
    keys = ("torque", "velocity", "angle")
    columns = {"time_s": motion.time}
    for name, value, key in zip(names, values, keys, strict=True):
        columns[name] = value + getattr(scenario.noise, key) * white[key]
    return Log(scenario, axis, motion, columns)


def _engine(scenario: Scenario, axis: Axis) -> Callable[[np.ndarray, float], Trajectory]:
    if scenario.engine is Engine.ACCURATE:
        from mjsim import accurate

        return lambda u, dt: accurate.simulate(axis, u, dt)
    if scenario.engine is Engine.LITERAL:
        return lambda u, dt: _literal(scenario, axis, u, dt)
    from mjsim import ode

    return lambda u, dt: ode.simulate(axis, u, dt)


def _literal(scenario: Scenario, axis: Axis, u: np.ndarray, dt: float) -> Trajectory:
    """Plain MuJoCo on the model's own file, with the effects written into a copy by MJCF's own elements."""
    from mjsim.mjcf import load_model, write_corrected
    from mjsim.mujoco_run import run_signals

    plain = load_model(scenario.model_path)
    if axis.effects == plain.axis.effects and axis.chain == plain.axis.chain:
        return run_signals(plain, u, dt)
    with tempfile.TemporaryDirectory() as work:
        written = write_corrected(scenario.model_path, axis, Path(work) / scenario.model_path.name)
        if written.lacks:
            raise InputError(
                f"scenario {scenario.name!r}", f"plain MuJoCo lacks it ({written.lacks[0]})", "engine ode or accurate",
                'set engine = "accurate"',
            )  # fmt: skip
        return run_signals(load_model(written.path), u, dt)


def write_log(log: Log, out: str | Path) -> Path:
    """Write the log and beside it its provenance (JSON) and, for a slide axis, its units (TOML); never half a file."""
    folder, scenario = Path(out), log.scenario
    path = write_columns(folder, scenario.name, scenario.format, log.columns, provenance(log))
    if "force_N" in log.columns:
        binding = '[recording]\ntime = "time_s"\ntorque = "force_N"\nvelocity = "velocity_m_s"\nangle = "position_m"\n'
        _whole(folder / f"{scenario.name}.toml", lambda at: at.write_text(binding, encoding="utf-8"))
    return path


def write_columns(
    folder: Path, name: str, kind: Format, columns: Mapping[str, np.ndarray], origin: Mapping[str, Any]
) -> Path:  # fmt: skip
    """Write columns (N,) and beside them their origin as NAME.provenance.json; returns the path of the log."""
    folder.mkdir(parents=True, exist_ok=True)
    path, text = folder / f"{name}.{kind.value}", json.dumps(origin, indent=2)
    _whole(path, lambda at: _parquet(at, columns, text) if kind is Format.PARQUET else _csv(at, columns))
    _whole(folder / f"{name}.provenance.json", lambda at: at.write_text(text + "\n", encoding="utf-8"))
    return path


def provenance(log: Log) -> dict[str, Any]:
    """Scenario, seed, versions and the hash of the model's file."""
    model = log.scenario.model_path
    return {
        "scenario": log.scenario.model_dump(mode="json", exclude={"folder"}),
        "effects": [e.describe() for e in log.axis.effects],
        "model": {"file": model.name, "sha256": hashlib.sha256(model.read_bytes()).hexdigest()},
        "seed": log.scenario.seed,
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Versions of what a log was made with."""
    import mujoco
    import numba
    import scipy

    return {
        "simgap": _version(), "python": platform.python_version(), "numpy": np.__version__, "scipy": scipy.__version__,
        "numba": numba.__version__, "mujoco": mujoco.__version__,
    }  # fmt: skip


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("simgap")
    except PackageNotFoundError:
        return "unknown"


def _csv(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    table = np.column_stack(list(columns.values()))
    formats = ["%.9g"] + ["%.17g"] * (table.shape[1] - 1)
    np.savetxt(path, table, fmt=formats, delimiter=",", header=",".join(columns), comments="")


def _parquet(path: Path, columns: Mapping[str, np.ndarray], told: str) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputError(
            path.name, "Parquet needs pyarrow", "pip install 'simgap[formats]'", "install it, or write CSV"
        ) from None
    table = pa.table(dict(columns)).replace_schema_metadata({"simgap_provenance": told})
    pq.write_table(table, path)


def _whole(path: Path, write: Callable[[Path], Any]) -> None:
    """Write under a temporary name, then rename: a broken run leaves nothing under the final name."""
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    os.close(handle)
    try:
        write(Path(name))
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
