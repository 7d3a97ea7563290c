"""What plain MuJoCo judges: a model as given and as found, beside the recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from diagnose.result import Diagnosis
from diagnose.verdict.reference import Run
from diagnose.verdict.reference_fit import Refit, refit_in_simulator
from diagnose.verdict.reference_runs import run_files, starts_of
from diagnose.verdict.reference_stage import Nominal
from mjsim.axis import Axis
from mjsim.mjcf.faithful import Writer
from mjsim.plant import MujocoPlant, Start

__all__ = ["Bench"]


@dataclass(frozen=True, eq=False)
class Bench:
    """What is judged: the model as given and as found, the diagnosis, the nominal file's runs, where the file goes, threads."""

    model: Path
    given: Axis
    axis: Axis
    result: Diagnosis
    nominal: Nominal
    out: Path
    threads: int

    @cached_property
    def starts(self) -> list[Start]:
        """Where runs of the axis start."""
        return starts_of(self.axis, self.nominal.cases)

    def run(self, path: Path) -> Sequence[Run | None]:
        """A file on every recording."""
        return run_files([MujocoPlant.load(path)], self.nominal.cases, self.threads)[0]

    def refit(self, axis: Axis, write: Writer, runs: Sequence[Run | None], goal: float) -> Refit | None:
        """The numbers of an axis refitted in MuJoCo, from where runs of it start."""
        cases = self.nominal.cases
        starts = [case.start() if run is None else run.start for case, run in zip(cases, runs, strict=True)]
        return refit_in_simulator(axis, write, self.out.name, cases, starts, self.threads, goal)
