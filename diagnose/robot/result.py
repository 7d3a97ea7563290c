"""The outcome of a diagnosis of a robot, as ``diagnosis.json`` has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.check.types import LogCheck
from diagnose.json_file import write_json
from diagnose.result import Conditioning, Estimate, FitFigures, Verdict

__all__ = ["BaseParameter", "JointResult", "RobotDiagnosis", "RobotFinding", "Trace"]


@dataclass(frozen=True)
class RobotFinding:
    """One effect at one joint; as `diagnose.result.Finding`, with the joint and, of a coupling, the joint that it comes from."""

    effect: str
    joint: str
    element: str
    sentence: str
    parameters: Mapping[str, Estimate]
    evidence: Mapping[str, float]
    equivalents: tuple[str, ...] = ()
    form: str = ""
    source: str = ""
    place: str = "motor"

    def as_dict(self) -> dict[str, Any]:
        """As in the contract."""
        return {
            "effect": self.effect, "joint": self.joint, "place": self.place, "element": self.element, "sentence": self.sentence,
            "parameters": {k: v.as_dict() for k, v in self.parameters.items()}, "evidence": dict(self.evidence),
            "equivalents": list(self.equivalents), "form": self.form, **({"from": self.source} if self.source else {}),
        }  # fmt: skip


@dataclass(frozen=True)
class BaseParameter:
    """A combination of the robot's own parameters that the motion determines: name, fitted value with interval, nominal value."""

    combination: str
    estimate: Estimate
    nominal: float


@dataclass(frozen=True, eq=False)
class Trace:
    """Torque or position of one joint in one recording (M,): time [s], measured, and by the models.

    counted (M,): samples on which models are judged, None where all are; elsewhere a signal may be NaN. states: what the joint
    did, by name: values (M,) and unit.
    """

    source: str
    role: str
    time: np.ndarray
    measured: np.ndarray
    nominal: np.ndarray
    refitted: np.ndarray
    corrected: np.ndarray
    counted: np.ndarray | None = None
    states: Mapping[str, tuple[np.ndarray, str]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class JointResult:
    """One joint: verdict and why, findings, errors of the models by force, its own parameters, refusals, traces.

    remains: part of the held-out squared error that a black-box model predicts, and its p-value. conditioning: of the numbers
    of a joint that is fitted by itself.
    """

    joint: str
    unit: str
    verdict: Verdict
    summary: str
    findings: tuple[RobotFinding, ...]
    fit: Mapping[str, FitFigures]
    linear_parameters: Mapping[str, Estimate]
    nominal_parameters: Mapping[str, float]
    remains: tuple[float, float]
    refusals: tuple[str, ...]
    traces: tuple[Trace, ...] = ()
    conditioning: Conditioning | None = None

    def as_dict(self) -> dict[str, Any]:
        """As in the contract."""
        return {
            "verdict": self.verdict.value, "summary": self.summary, "findings": [f.as_dict() for f in self.findings],
            "fit": {k: v.as_dict() for k, v in self.fit.items()},
            "linear_parameters": {k: v.as_dict() for k, v in self.linear_parameters.items()},
            "nominal_parameters": dict(self.nominal_parameters),
            "remains": {"share": self.remains[0], "p_value": self.remains[1]}, "refusals": list(self.refusals),
            "conditioning": self.conditioning.as_dict() if self.conditioning is not None else None,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class RobotDiagnosis:
    """The outcome for a robot; see the contract. changed: in words, what of its own parameters differs from the file.

    closed_loop: errors of all joints together in MuJoCo, by joint and recording; picture: HTML of the robot, for the page;
    log: what the check of the log found; conditioning: of the robot's own numbers where all joints are fitted together.
    """

    verdict: Verdict
    summary: str
    joints: Mapping[str, JointResult]
    fit: Mapping[str, FitFigures]
    links: Mapping[str, Estimate]
    nominal_links: Mapping[str, float]
    base: tuple[BaseParameter, ...]
    changed: tuple[str, ...]
    notes: tuple[str, ...]
    hypotheses: int
    cutoff_hz: float
    recordings: tuple[Mapping[str, str], ...]
    seed: int
    seconds: float
    versions: Mapping[str, str]
    judged_on: Mapping[str, Any] = field(default_factory=lambda: {"channel": "torque", "unit": "N m", "view": "force"})
    closed_loop: Mapping[str, Any] | None = None
    picture: str = ""
    log: LogCheck | None = None
    conditioning: Conditioning | None = None

    @property
    def findings(self) -> tuple[RobotFinding, ...]:
        """Findings of all joints, strongest first."""
        return tuple(sorted((f for j in self.joints.values() for f in j.findings), key=lambda f: -f.evidence["delta_chi2"]))

    def as_dict(self) -> dict[str, Any]:
        """The contract's JSON for a robot, with a few fields more."""
        own = {f"{j}.{k}": v.as_dict() for j, r in self.joints.items() for k, v in r.linear_parameters.items()}
        return {
            "verdict": self.verdict.value,
            "summary": self.summary,
            "findings": [f.as_dict() for f in self.findings],
            "mismatch": {"time": [], "frequency": [], "state": []},
            "joints": {k: v.as_dict() for k, v in self.joints.items()},
            "linear_parameters": {**own, **{k: v.as_dict() for k, v in self.links.items()}},
            "nominal_parameters": dict(self.nominal_links),
            "base_parameters": [{"combination": b.combination, "nominal": b.nominal, **b.estimate.as_dict()} for b in self.base],
            "conditioning": self.conditioning.as_dict() if self.conditioning is not None else None,
            "changed": list(self.changed),
            "fit": {**{k: v.as_dict() for k, v in self.fit.items()}, "noise_floor": {"rms": None}},
            "judged_on": {**self.judged_on, "cutoff_hz": self.cutoff_hz},
            **({"closed_loop": dict(self.closed_loop)} if self.closed_loop is not None else {}),
            "log": self.log.as_dict() if self.log is not None else None,
            "notes": list(self.notes),
            "next_experiment": None,
            "hypotheses": self.hypotheses,
            "seed": self.seed,
            "versions": dict(self.versions),
            "recordings": [dict(r) for r in self.recordings],
            "seconds": self.seconds,
        }

    def write_json(self, path: Path) -> None:
        """Write ``diagnosis.json`` in one move."""
        write_json(path, self.as_dict())
