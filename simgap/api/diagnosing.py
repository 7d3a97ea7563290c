"""`diagnose` and `Diagnosis`: where recordings and a model differ, and which physics the model lacks."""

from __future__ import annotations

import gc
import json
import math
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import mujoco

from diagnose.check.types import LogCheck
from diagnose.pipeline import Options
from diagnose.result import Diagnosis as AxisResult
from diagnose.result import Estimate, Finding, FitFigures, Verdict
from diagnose.robot.options import RobotOptions
from diagnose.robot.result import JointResult, RobotDiagnosis, RobotFinding
from mjsim.effects import registered
from mjsim.effects.registry import named_instead
from mjsim.errors import InputError, nearest
from mjsim.recording import Recording
from mjsim.robot.recording import RobotRecording
from simgap.api.checking import listed
from simgap.api.model import Model
from simgap.api.recording import loaded
from simgap.api.scratch import Scratch
from simgap.long_logs import Loaded, load_all
from simgap.robot import is_robot
from simgap.sole import sole_in_python

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

__all__ = ["Diagnosis", "diagnose", "need_effects"]

FILES = ("diagnosis.json", "corrected.xml", "mapped.xml", "report.html")


@final
class Diagnosis:
    """The outcome of `diagnose`, of an axis or of a robot.

    ``result``: all that the search found, as `diagnose.result.Diagnosis` or `diagnose.robot.result.RobotDiagnosis`.

    >>> import numpy as np
    >>> import simgap
    >>> t = np.arange(0, 3, 0.004)
    >>> torque = 3 * np.sin(2 * np.pi * (0.3 + 0.5 * t) * t)
    >>> friction = simgap.effects["coulomb_friction"](place="motor", torque_Nm=0.3)
    >>> run = simgap.simulate("pendulum", torque, dt=0.004, effects=[friction])
    >>> rng = np.random.default_rng(0)
    >>> log = {"time_s": t, "torque_Nm": torque, "velocity_rad_s": run.velocity + 0.01 * rng.standard_normal(t.size)}
    >>> found = simgap.diagnose(log, "pendulum", effects=["coulomb_friction", "torque_offset"])
    >>> found.verdict.value
    'missing_physics'
    >>> found.findings[0].effect, found.findings[0].place
    ('coulomb_friction', 'motor')
    >>> round(found.findings[0].parameters["torque_Nm"].value, 1)
    0.3
    >>> list(found.by_joint())
    ['pendulum']
    >>> bool(found.corrected_model().dof_frictionloss[0] > 0.25)
    True
    """

    def __init__(self, result: AxisResult | RobotDiagnosis, model: Model, folder: Path, scratch: Scratch | None = None) -> None:
        self._result, self._model, self._folder, self._scratch = result, model, folder, scratch

    @property
    def result(self) -> AxisResult | RobotDiagnosis:
        """All that the search found."""
        return self._result

    @property
    def model(self) -> Model:
        """The model that was diagnosed."""
        return self._model

    @property
    def verdict(self) -> Verdict:
        """``no_mismatch``, ``parameters_only``, ``missing_physics`` or ``unexplained``; of a robot the worst of its joints."""
        return self._result.verdict

    @property
    def summary(self) -> str:
        """The answer in a sentence or two."""
        return self._result.summary

    @property
    def findings(self) -> tuple[Finding | RobotFinding, ...]:
        """Effects that are missing, strongest first: effect, place, parameters with 95 % intervals, evidence, equivalents."""
        return tuple(self._result.findings)

    def by_joint(self) -> dict[str, tuple[Finding | RobotFinding, ...]]:
        """Findings of each joint that was diagnosed, by its name; of an axis, all at its driven joint."""
        if isinstance(self._result, RobotDiagnosis):
            return {name: tuple(r.findings) for name, r in self._result.joints.items()}
        return {self._model.axis.chain.bodies[0].joint: self.findings}

    @property
    def joints(self) -> Mapping[str, JointResult]:
        """Verdict, findings, errors and parameters of each joint of a robot; empty for an axis."""
        return dict(self._result.joints) if isinstance(self._result, RobotDiagnosis) else {}

    @property
    def parameters(self) -> Mapping[str, Estimate]:
        """The model's own parameters as fitted, with 95 % intervals; of a robot as ``JOINT.name`` and ``LINK.name``."""
        if isinstance(self._result, AxisResult):
            return dict(self._result.linear_parameters)
        own = {f"{j}.{k}": v for j, r in self._result.joints.items() for k, v in r.linear_parameters.items()}
        return own | dict(self._result.links)

    @property
    def fit(self) -> Mapping[str, FitFigures]:
        """Errors of the model as given (``nominal``), with its numbers refitted, and corrected; estimation and held-out."""
        return dict(self._result.fit)

    @property
    def log(self) -> LogCheck | None:
        """What the check of the recordings found; None for robots and servos."""
        return self._result.log if isinstance(self._result, AxisResult) else None

    @property
    def next_experiment(self) -> str | None:
        """What to record next, where that would decide between effects that the data do not tell apart."""
        return self._result.next_experiment if isinstance(self._result, AxisResult) else None

    def as_dict(self) -> dict[str, Any]:
        """The content of ``diagnosis.json``."""
        loaded_json: dict[str, Any] = json.loads((self._folder / "diagnosis.json").read_text(encoding="utf-8"))
        return loaded_json

    def to_frame(self) -> pandas.DataFrame:
        """A row for each parameter of each finding: joint, effect, place, parameter, value, low and high of 95 %, unit, p_value.

        Needs pandas.
        """
        from simgap.api.frames import frame

        columns = ("joint", "effect", "place", "parameter", "value", "low", "high", "unit", "p_value")
        rows = [
            {
                "joint": joint, "effect": f.effect, "place": getattr(f, "place", "motor"), "parameter": name, "value": e.value,
                "low": e.ci95[0], "high": e.ci95[1], "unit": e.unit, "p_value": f.evidence.get("p_value", math.nan),
            }
            for joint, found in self.by_joint().items() for f in found for name, e in f.parameters.items()
        ]  # fmt: skip
        return frame(columns, rows)

    def plot(self) -> Figure:
        """Measured and predicted signals with the errors of the model as given and corrected, as a matplotlib figure.

        The first recording of an axis; of a robot, each joint. Nothing is shown: ``figure.savefig(path)``.
        """
        from simgap.api.pictures import of_axis, of_robot

        return of_robot(self._result) if isinstance(self._result, RobotDiagnosis) else of_axis(self._result)

    def report(self, path: str | Path, *, film_of: Sequence[str | Path] = ()) -> Path:
        """Write the report, one HTML file; returns its path.

        ``film_of``: the files of the recordings, for a film of the model with a recording as a ghost.
        """
        path = Path(path)
        if isinstance(self._result, RobotDiagnosis):
            from diagnose.robot.page import write_page

            film = None
            if film_of:
                from simgap.filming import film_of_robot

                film = film_of_robot(self._result, self._model.path, [Path(f) for f in film_of])
            write_page(self._result, path, film)
        else:
            from diagnose.report import write_report

            film = None
            if film_of:
                from simgap.filming import film_of as filmed

                film = filmed(self._result, self._model.path, [Path(f) for f in film_of])
            write_report(self._result, path, corrected_diff=self._difference(), film=film)
        return path

    def summary_file(self, path: str | Path) -> Path:
        """Write the answer as Markdown, for a pull request; returns its path."""
        if isinstance(self._result, RobotDiagnosis):
            from diagnose.robot.summary import write_summary as write_robot_summary

            write_robot_summary(self._result, Path(path))
        else:
            from diagnose.report.summary import write_summary

            write_summary(self._result, Path(path))
        return Path(path)

    def save(self, folder: str | Path) -> Path:
        """Write ``diagnosis.json``, ``corrected.xml`` and ``report.html`` into a folder; returns it."""
        out = Path(folder)
        out.mkdir(parents=True, exist_ok=True)
        for name in FILES:
            if (self._folder / name).is_file() and out.resolve() != self._folder.resolve():
                shutil.copyfile(self._folder / name, out / name)
        if not (out / "report.html").is_file():
            self.report(out / "report.html")
        return out

    @property
    def corrected_file(self) -> Path:
        """``corrected.xml``: the model with everything that was found; without ``out`` it lasts as long as this object."""
        return self._folder / "corrected.xml"

    def corrected_model(self) -> mujoco.MjModel:
        """The corrected model, compiled. What MJCF has no element for is carried beside it and run by `simgap.simulate`."""
        return Model(self.corrected_file).mjmodel

    def corrected_spec(self) -> mujoco.MjSpec:
        """The corrected model as a specification that can be edited."""
        return Model(self.corrected_file).spec

    def _difference(self) -> str:
        from simgap.pipeline import model_diff

        return model_diff(self._model.path, self.corrected_file)

    def __repr__(self) -> str:
        return f"<Diagnosis {self.verdict.value}: {self.summary}>"


def diagnose(
    recordings: Any | Sequence[Any],
    model: Model | str | Path | mujoco.MjSpec,
    *,
    held_out: Any | Sequence[Any] = (),
    out: str | Path | None = None,
    judge: str | None = None,
    effects: Sequence[str] = (),
    joints: Sequence[str] = (),
    jobs: int = 1,
    seed: int = 0,
    budget: float = math.inf,
    effort: float = 1.0,
    accept_log: bool = False,
    progress: bool | None = None,
) -> Diagnosis:
    """Locate, name, model and prove the mismatch between recordings and a model of an axis or of a robot.

    ``recordings``, ``held_out``: one or several in a list; each a file, columns by name, a DataFrame or a `Recording`; without
    ``held_out``, blocks of the recordings are held out. ``out``: a folder for diagnosis.json, corrected.xml and report.html;
    without it nothing is kept but what the result has. ``judge``: compare ``"motion"`` or ``"force"``, by default as the
    recording's binding says. ``effects``: identifiers to consider, all when empty. ``joints``: of a robot, those to diagnose, all
    that move when empty; of one axis, the one of a log that holds several. ``jobs``: threads. ``budget`` [s]: after which
    the search ends; validation, runs in plain MuJoCo and the report come on top. ``effort``: limit of the simulations of one
    axis, 0 for none. ``accept_log``: search even where the check of the log says that it has to be fixed. ``progress``: on
    standard error; None: only that something is compiled.

    Raises `InputError` for recordings or a model that cannot be used, and where another run writes into ``out``.

    >>> import numpy as np
    >>> import simgap
    >>> t = np.arange(0, 3, 0.004)
    >>> torque = 3 * np.sin(2 * np.pi * (0.3 + 0.5 * t) * t)
    >>> run = simgap.simulate("pendulum", torque, dt=0.004)
    >>> noise = 0.01 * np.random.default_rng(1).standard_normal(t.size)
    >>> log = {"time_s": t, "torque_Nm": torque, "velocity_rad_s": run.velocity + noise}
    >>> simgap.diagnose(log, "pendulum", effects=["torque_offset"]).verdict.value
    'no_mismatch'
    """
    began = time.monotonic()
    subject, given, held = Model(model), listed(recordings), listed(held_out)
    if judge not in (None, "motion", "force"):
        raise InputError("judge", repr(judge), "motion or force", nearest(str(judge), ("motion", "force"), "correct it"))
    if not given:
        raise InputError("recordings", "none", "at least one", "give a file, columns by name or a Recording")
    robot = is_robot([Path(r) if isinstance(r, str) else r for r in given], subject.path)
    need_effects(effects, robot=robot)
    if robot and judge is not None:
        chosen = "nothing for a robot: by force where the log has torques, else each servo by its motion"
        raise InputError("--judge", judge, chosen, "leave it out")
    if not robot and len(joints) > 1:
        raise InputError("--joint", f"{len(joints)} joints", "one, since the model drives one", "give the robot's model")
    joint = joints[0] if joints and not robot else None
    scratch = Scratch() if out is None else None
    folder = scratch.path if scratch is not None else Path(str(out))
    drawn = scratch is None
    options = Options(
        judge=judge, effects=tuple(effects), jobs=jobs, seed=seed, seconds=budget or math.inf, effort=effort or math.inf
    )
    result: AxisResult | RobotDiagnosis
    with sole_in_python(folder):
        if robot:
            group, kept = ([loaded(r, subject, robot=True) for r in x] for x in (given, held))
            asked = RobotOptions(tuple(joints), tuple(effects), seed=seed, until=began + options.seconds)
            result = _robot(group, subject, folder, kept, asked, progress=progress, page=drawn, accept_log=accept_log)
        else:
            read = _loaded(given, held, subject, joint)
            result = _axis(read, subject, folder, options.since(began), progress, accept_log, drawn)
    gc.collect()  # of many diagnoses in one process: else cyclic garbage waits until a quarter of all objects is new
    return Diagnosis(result, subject, folder, scratch)


def _loaded(given: Sequence[Any], held: Sequence[Any], model: Model, joint: str | None) -> Loaded:
    """The recordings of an axis; of files that are too long, stretches."""
    if all(isinstance(r, str | Path) for r in (*given, *held)):
        prefer = model.axis.chain.bodies[0].joint
        return load_all(
            [Path(r) for r in given], [Path(r) for r in held], model.path, joint, prefer, driven=model.axis.chain.driven
        )
    fitted, kept = ([r for r in (loaded(x, model, joint=joint) for x in g) if isinstance(r, Recording)] for g in (given, held))
    return Loaded(tuple(fitted), tuple(kept))


def _axis(
    read: Loaded, model: Model, out: Path, options: Options, progress: bool | None, accept_log: bool, page: bool
) -> AxisResult:
    from simgap.pipeline import diagnose_recordings

    return diagnose_recordings(
        read.fitted, model.path, out, read.held_out, options, progress=progress, page=page, accept_log=accept_log,
        stretches=read.stretches,
    )  # fmt: skip


def _robot(
    recordings: Sequence[Recording | RobotRecording], model: Model, out: Path, held: Sequence[Recording | RobotRecording],
    options: RobotOptions, *, progress: bool | None, page: bool, accept_log: bool,
) -> RobotDiagnosis:  # fmt: skip
    import sys

    from simgap.robot import diagnose_robot_recordings

    group, kept = ([r for r in x if isinstance(r, RobotRecording)] for x in (recordings, held))
    say: Callable[[str], None] = (lambda line: print(line, file=sys.stderr)) if progress else (lambda line: None)
    return diagnose_robot_recordings(group, model.path, out, kept, options, say, page=page, accept_log=accept_log)


def need_effects(names: Sequence[str], *, robot: bool) -> None:
    """Refuse identifiers that are not known, or that no robot's log tells. Raises InputError."""
    from diagnose.robot.laws import identifiers as by_force
    from diagnose.robot.servos.library import identifiers as by_command

    choices = tuple(dict.fromkeys((*by_force(), *by_command()))) if robot else tuple(registered())
    for name in names:
        if name in choices:
            continue
        if robot and name in registered():
            raise InputError("--effects", f"effect {name!r} cannot be told of a robot", ", ".join(choices), "correct the name")
        advice = named_instead(name, choices, "simgap effects lists them")
        raise InputError("--effects", f"unknown effect {name!r}", ", ".join(choices), advice)
