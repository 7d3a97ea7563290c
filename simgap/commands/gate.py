"""``simgap gate``: exit 1 when a model predicts recordings worse than a baseline diagnosis says."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simgap.arguments import ModelFile

if TYPE_CHECKING:
    import numpy as np

    from diagnose.data.experiment import Experiment
    from diagnose.problem.view import View
    from mjsim.axis import Axis
    from mjsim.recording import Recording

__all__ = ["Check", "command", "judged", "read_baseline"]

ROLES = ("estimation", "held-out")


@dataclass(frozen=True)
class Check:
    """One comparison: rms error of the model on some recordings, that of the baseline [unit of the channel], their ratio.

    ``role``: what the baseline used these recordings for. ``grew``: ratio above 1 + tolerance, or no finite run.
    """

    recordings: tuple[str, ...]
    role: str
    rms: float
    baseline_rms: float
    ratio: float
    grew: bool


@dataclass(frozen=True)
class _Errors:
    """Errors of one recording: sums of squares and numbers of samples of each role it has in the baseline."""

    source: str
    roles: tuple[str, ...]
    squares: Mapping[str, float]
    counts: Mapping[str, int]


def judged(model: Path, recordings: Sequence[Path], baseline: Path, against: str, tolerance: float) -> tuple[list[Check], str]:
    """Checks of a model on recordings against a baseline's figures, and the unit of the errors.

    A recording is known by its SHA-256. All recordings of one role in the baseline are compared together with the figure of that
    role, since the baseline holds one figure for them; where some are missing, each is compared alone. Raises InputError, also
    for a recording that the baseline does not have: another motion has another error.
    """
    from diagnose.data.experiment import without_derived_velocity
    from diagnose.pipeline import choose_view
    from mjsim.errors import InputError
    from mjsim.mjcf import carried_binding, load_model
    from mjsim.recording import load

    known = read_baseline(baseline, against)
    source = load_model(model)
    loaded = [without_derived_velocity(load(p, model=model, binding=carried_binding(source, p))) for p in recordings]
    view = choose_view(loaded, known["view"], source.axis)
    for r in loaded:
        if r.sha256 not in known["roles"]:
            raise InputError(
                r.source, f"not one of the recordings of {baseline}, by its SHA-256", "a recording that the baseline used",
                "run simgap diagnose with it for a new baseline",
            )  # fmt: skip
    errors = [_errors(source.axis, view, r, known["roles"][r.sha256]) for r in loaded]
    checks, alone = [], list(errors)
    for roles in dict.fromkeys(e.roles for e in errors):
        group = [e for e in errors if e.roles == roles]
        if len(group) == sum(1 for r in known["roles"].values() if r == roles):
            checks.append(_check(group, roles, known["rms"], tolerance))
            alone = [e for e in alone if e.roles != roles]
    checks += [_check([e], e.roles, known["rms"], tolerance) for e in alone]
    return checks, known["unit"]


def read_baseline(path: Path, against: str) -> dict[str, Any]:
    """Figures of a diagnosis.json: rms of each role, roles of each recording by hash, view, unit. Raises InputError."""
    from mjsim.errors import InputError

    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "no such file", "the diagnosis.json of simgap diagnose", "check --baseline") from None
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"not valid JSON ({error})", "the diagnosis.json of simgap diagnose", "check it") from None
    try:
        fit, on = told["fit"][against], told["judged_on"]
        rms = {"estimation": _figure(fit["rms"]), "held-out": _figure(fit["held_out_rms"])}
        roles: dict[str, tuple[str, ...]] = {}
        for r in told["recordings"]:
            digest, role = str(r["sha256"]), str(r["role"])
            if role not in ROLES:
                raise ValueError(f"role {role!r}")
            roles[digest] = tuple(dict.fromkeys((*roles.get(digest, ()), role)))
        view, unit = ("force" if str(on["view"]).startswith("force") else "motion"), str(on["unit"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            path, f"not a diagnosis with figures of the {against} model ({type(error).__name__}: {error})",
            "the diagnosis.json of simgap diagnose", "run simgap diagnose again",
        ) from None  # fmt: skip
    return {"rms": rms, "roles": roles, "view": view, "unit": unit}


def _figure(value: Any) -> float:
    """A figure of the JSON; null stands for one that is not finite."""
    return math.inf if value is None else float(value)


def _errors(axis: Axis, view: View, recording: Recording, roles: tuple[str, ...]) -> _Errors:
    """Squared errors of the model on one recording, for each role that it has in the baseline.

    From rest or from the recorded speed, whichever has the smaller error. On what was not fitted, the phases of effects over
    the angle are estimated anew, as the diagnosis does: the zero of an encoder may differ between recordings.
    """
    import numpy as np

    from diagnose.data.experiment import hold_out_blocks, prepare

    squares, counts = {}, {}
    blocks = dict(zip(ROLES, hold_out_blocks(recording), strict=True))
    for role in roles:
        experiment = prepare(recording, counts=blocks[role] if len(roles) > 1 else None)
        axes = [axis] if role == "estimation" else [axis, _in_phase(axis, view, experiment)]
        starts = _starts(axis, recording) if view.channel == "velocity" else [None]
        keep = view.counts(experiment)
        errors = [_error(each, view, experiment, initial) for each in axes for initial in starts]
        squares[role] = min((float(np.sum(e[keep] ** 2)) for e in errors if e is not None), default=math.inf)
        counts[role] = max(1, int(np.sum(keep)))
    return _Errors(recording.source, roles, squares, counts)


def _error(axis: Axis, view: View, experiment: Experiment, initial: np.ndarray | None) -> np.ndarray | None:
    """Measured minus predicted (M,) in the view's unit; None when the run is not finite."""
    import numpy as np

    s = view.signals(axis, experiment, initial)
    return None if s is None or not np.isfinite(s.predicted).all() else s.measured - s.predicted


def _in_phase(axis: Axis, view: View, experiment: Experiment) -> Axis:
    """The axis with the per-recording parameters of its effects (phases) fitted to this recording by least squares."""
    import numpy as np
    from scipy.optimize import least_squares

    free = [(e.key, s.name) for e in axis.effects for s in e.specs() if s.nuisance]
    start = np.array([getattr(e, s.name) for e in axis.effects for s in e.specs() if s.nuisance])
    keep = view.counts(experiment)
    if not free or (as_given := _error(axis, view, experiment, None)) is None:
        return axis

    def moved(x: np.ndarray) -> Axis:
        out = axis
        for e in axis.effects:
            own = {name: float(v) for (key, name), v in zip(free, x, strict=True) if key == e.key}
            out = out.without(e.key) + e.with_values(own) if own else out
        return out

    def residual(x: np.ndarray) -> np.ndarray:
        error = _error(moved(x), view, experiment, None)
        return np.full(int(keep.sum()), 1e6 * np.std(as_given)) if error is None else error[keep]

    # the solver's steps are relative: the shift is counted from 1, so that a central step is 1e-3 rad whatever the phase is
    fit = least_squares(lambda z: residual(start + z - 1.0), np.ones(len(start)), jac="3-point", diff_step=1e-3, max_nfev=20)
    return moved(start + fit.x - 1.0)


def _starts(axis: Axis, recording: Recording) -> list[np.ndarray | None]:
    """Rest, and the chain moving as recorded at the first sample (a straight line through the first 5 ms), without deflection."""
    import numpy as np

    speed = recording.velocity if recording.velocity is not None else np.gradient(recording.column("angle"), recording.dt)
    few = max(2, min(len(speed), round(0.005 / recording.dt)))
    first = float(np.polynomial.Polynomial.fit(np.arange(few), speed[:few], 1)(0.0))
    ratios = np.array([axis.chain.total_ratio(i) for i in range(len(axis.chain.bodies))])
    angle = float(recording.angle[0]) if recording.angle is not None else 0.0
    return [None, np.array([angle * ratios, first * ratios])]


def _check(group: Sequence[_Errors], roles: tuple[str, ...], known: Mapping[str, float], tolerance: float) -> Check:
    """The errors of a group against the baseline's figures, each role weighted by its number of samples."""
    count = {role: sum(e.counts[role] for e in group) for role in group[0].counts}
    total = sum(count.values())
    rms = math.sqrt(sum(sum(e.squares[role] for e in group) for role in count) / total)
    reference = {role: known[role] if math.isfinite(known[role]) else known["estimation"] for role in count}
    before = math.sqrt(sum(count[role] * reference[role] ** 2 for role in count) / total)
    ratio = rms / before if before > 0 and math.isfinite(before) else (0.0 if math.isfinite(rms) else math.inf)
    return Check(tuple(e.source for e in group), " + ".join(roles), rms, before, ratio, not ratio <= 1 + tolerance)


def _show(checks: Sequence[Check], unit: str) -> None:
    from rich.console import Console
    from rich.table import Table

    from simgap.terminal import rich_text

    table = Table("recordings", "in the baseline", f"rms error [{unit}]", f"baseline [{unit}]", "ratio", "")
    for c in checks:
        names = "\n".join(rich_text(n) for n in c.recordings)
        result = "[red]grew[/red]" if c.grew else "[green]ok[/green]"
        figures = (f"{c.rms:.4g}" if math.isfinite(c.rms) else "diverges", f"{c.baseline_rms:.4g}", f"{c.ratio:.3f}")
        table.add_row(names, c.role, *figures, result)
    Console().print(table)


@click.command("gate", epilog="Example: simgap gate robot.xml log.csv --baseline report/diagnosis.json")
@click.argument("model", type=ModelFile())
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--baseline", required=True, type=click.Path(path_type=Path), help="diagnosis.json to compare with.")
@click.option(
    "--against", type=click.Choice(["nominal", "corrected"]), default="nominal", show_default=True,
    help="Figures of the baseline: those of the model that was diagnosed, or of its corrected.xml.",
)  # fmt: skip
@click.option(
    "--tolerance", type=click.FloatRange(min=0), default=0.02, show_default=True,
    help="Allowed growth of the rms error, as a fraction of the baseline's.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print the comparison as JSON.")
def command(
    model: Path, recordings: tuple[Path, ...], baseline: Path, against: str, tolerance: float, as_json: bool
) -> None:  # fmt: skip
    """Fail when MODEL predicts RECORDINGS worse than a baseline: a regression test for a model.

    Simulates the model on each recording and compares the rms error with that of the baseline. The error is that of the
    diagnosis: of the free-run motion, or of the force that the recorded motion needs. Exit 1 when an error exceeds that of the
    baseline by more than the tolerance.
    """
    from mjsim.errors import CheckError

    checks, unit = judged(model, recordings, baseline, against, tolerance)
    worse = [c for c in checks if c.grew]
    if as_json:
        rows = [{k: None if v in (math.inf, -math.inf) else v for k, v in asdict(c).items()} for c in checks]
        told = {"passed": not worse, "against": against, "tolerance": tolerance, "unit": unit, "checks": rows}
        click.echo(json.dumps(told, indent=1))
    else:
        _show(checks, unit)
    if worse:
        names = ", ".join(n for c in worse for n in c.recordings)
        most = max(c.ratio for c in worse)
        grown = f"{most:.3f} times the baseline's" if math.isfinite(most) else "not finite: the model diverges"
        raise CheckError(f"the error of {model.name} on {names} is {grown}; allowed: {1 + tolerance:g} times")
