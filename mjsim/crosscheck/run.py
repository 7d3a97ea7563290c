"""All cases of a model, in a batch together and each alone."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from mjsim.batch import Drive, Engine, rollout
from mjsim.crosscheck.cases import DT, Case, effect_cases, study_cases
from mjsim.crosscheck.engines import compare, own_error
from mjsim.crosscheck.laws import energy_rows, scaling_row
from mjsim.crosscheck.report import Report, Row
from mjsim.errors import InputError
from mjsim.excitation import chirp
from mjsim.mjcf import load_axis
from mjsim.mjcf.compile import caught_warnings
from mjsim.models import shipped_model
from mjsim.ode import DivergedError, Trajectory

__all__ = ["check_all"]

MARGIN = 2.0  # on the error of the author's own options: an effect changes the motion, and with it what these make of it


def check_all(model: str | Path | None = None, *, duration: float = 10.0, amplitude: float = 1.0) -> Iterator[Row | Report]:
    """Run every case; yields each row as it is done and last the report.

    ``model``: a file, or the shipped robot axis when None. ``duration`` [s] and ``amplitude`` [N m | N] are those of the chirp,
    0.5 to 30 Hz. Plain MuJoCo may err by its limit beside what the file's own timestep and integrator make of the bare chain. The
    study's cases and the laws run on the robot axis only.
    """
    path = shipped_model("robot_axis1") if model is None else Path(model)
    axis = load_axis(path)
    if axis.chain.servo is not None:
        raise InputError(
            path, f"actuator {axis.chain.actuator!r} is a servo", "an axis that is driven by a torque",
            "replace it by <motor>; simgap replay --engine literal compares a servo on a recording",
        )  # fmt: skip
    u = chirp(duration, DT, amplitude, 0.5, 30.0)
    robot = axis == load_axis(shipped_model("robot_axis1"))
    cases = study_cases(axis) if robot else [Case("the model as it is", axis, 1e-4, literal=None)]
    more, skipped = effect_cases(axis, u)
    if not robot:  # an author's coarse timestep is no error of what is written
        allowed = MARGIN * own_error(path, axis, u, DT)
        more = [c if c.literal is None else dataclasses.replace(c, literal=c.literal + allowed) for c in more]
    cases += more
    rows = []
    # in the batch, together; then each alone
    together: dict[int, Trajectory | DivergedError] = {}
    for factor in sorted({c.drive for c in cases}):
        at = [i for i, c in enumerate(cases) if c.drive == factor]
        runs = rollout([cases[i].axis for i in at], [Drive(factor * u, DT)], engine=Engine.ACCURATE)
        together |= {i: run for i, (run,) in zip(at, runs, strict=True)}

    def one(at: int) -> Row:
        batched = together[at]
        if not isinstance(batched, Trajectory):
            raise batched
        return compare(cases[at], path, cases[at].drive * u, DT, batched)

    with caught_warnings(), ThreadPoolExecutor(os.cpu_count()) as pool:
        for row in pool.map(one, range(len(cases))):
            rows.append(row)
            yield row
    if robot:
        for row in (scaling_row(axis, path, u, DT), *energy_rows(axis, path)):
            rows.append(row)
            yield row
    yield Report(tuple(rows), tuple(skipped))
