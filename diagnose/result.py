"""What a diagnosis is: verdict, findings, where the mismatch is, fits before and after, rivals, and what to measure next."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.check.types import LogCheck
from diagnose.json_file import write_json
from diagnose.mismatch import Mismatch, Place, Share, StateShare
from mjsim.effects import Effect
from mjsim.torque_map import TorqueMap

__all__ = [
    "Diagnosis",
    "Estimate",
    "Finding",
    "FitFigures",
    "MapResult",
    "MapVariable",
    "Mismatch",
    "NominalEffect",
    "Place",
    "Refused",
    "Rival",
    "Share",
    "StateShare",
    "Traces",
    "Verdict",
]


class Verdict(enum.Enum):
    """The four answers; the value stands in the JSON."""

    NO_MISMATCH = "no_mismatch"
    PARAMETERS_ONLY = "parameters_only"
    MISSING_PHYSICS = "missing_physics"
    UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval and unit; at_bound: it stands at a bound of its range, where the interval is one-sided."""

    value: float
    ci95: tuple[float, float]
    unit: str
    at_bound: bool = False

    def as_dict(self) -> dict[str, Any]:
        """As in the contract, and ``at_bound`` where it is."""
        told = {"value": self.value, "ci95": list(self.ci95), "unit": self.unit}
        return told | ({"at_bound": True} if self.at_bound else {})


@dataclass(frozen=True)
class Conditioning:
    """How well the data determine the numbers of a fit, by its Jacobian with columns of length one.

    numbers, rank: how many there are, and how many of them the data tell apart; condition: largest singular value over the
    smallest; undetermined: those beyond the rank, each a combination of the others to the data.
    """

    numbers: int
    rank: int
    condition: float
    undetermined: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """By name."""
        return {
            "numbers": self.numbers, "rank": self.rank, "condition": self.condition, "undetermined": list(self.undetermined)
        }  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One effect that was found: what, where, how large, on what evidence, and which others the data cannot tell from it.

    evidence: held_out_error_before / _after (rms without and with this effect, view's unit), p_value (held-out, one-
    sided, corrected
    for the number of hypotheses), delta_chi2 (estimation, whitened), hypotheses (number tested). form: the law that was fitted,
    where it is another than the effect's own. equivalents: lowest held-out error first; equivalent_errors: their held-out rms
    error, where they have one. kind: physics, or numerics where a setting of the simulator makes the difference.
    """

    effect: str
    place: str
    element: str
    sentence: str
    parameters: Mapping[str, Estimate]
    evidence: Mapping[str, float]
    equivalents: tuple[str, ...] = ()
    form: str = ""
    kind: str = "physics"
    equivalent_errors: Mapping[str, float] = field(default_factory=dict)

    @property
    def rivals(self) -> tuple[str, ...]:
        """The equivalents as text, each with its held-out error where it has one."""
        errors = self.equivalent_errors
        return tuple(f"{e} (held-out error {errors[e]:.4g})" if e in errors else e for e in self.equivalents)

    @property
    def law(self) -> str:
        """Identifier of the law that was fitted."""
        return self.form or self.effect


@dataclass(frozen=True)
class NominalEffect:
    """An effect that the nominal model has itself, by the identifier of its law: its parameters as given and as fitted.

    ``parameters``: those that the recordings exercise; the others stay as given.
    """

    effect: str
    place: str
    element: str
    nominal: Mapping[str, float]
    parameters: Mapping[str, Estimate]

    @property
    def key(self) -> str:
        """``id@place``."""
        return f"{self.effect}@{self.place}"

    @property
    def values(self) -> dict[str, float]:
        """Fitted values, as ``id@place.name``."""
        return {f"{self.key}.{name}": e.value for name, e in self.parameters.items()}


@dataclass(frozen=True)
class FitFigures:
    """Errors of one model: rms in the view's unit and nrmse (error over spread of the measurement), estimation and held-out.

    ahead: (seconds, rms held-out error of the prediction so far ahead), see `diagnose.explain.ahead`.
    """

    rms: float
    nrmse: float
    held_out_rms: float
    held_out_nrmse: float
    ahead: tuple[tuple[float, float], ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """By name."""
        return {
            "rms": self.rms,
            "nrmse": self.nrmse,
            "held_out_rms": self.held_out_rms,
            "held_out_nrmse": self.held_out_nrmse,
            "ahead": [{"seconds": s, "held_out_rms": e} for s, e in self.ahead],
        }


@dataclass(frozen=True, eq=False)
class MapVariable:
    """A variable of a torque map: its name, unit and the values (n,) at which the map is given."""

    name: str
    unit: str
    grid: np.ndarray


@dataclass(frozen=True, eq=False)
class MapResult:
    """The residual as a torque over one or two variables: a map and not a cause.

    effect: the map as it runs; values, low, high (n,) or (n, m): the map on the grid of its variables and its 95 % bands, in
    unit; seen: whether the estimation recordings come by there (the rest is extrapolated); held_out_error_before / _after: rms
    without and with it, in the view's unit; p_value: of that gain, one-sided, over the maps that were tried; linear, effects: the
    model's own numbers and the named effects that it needs, as fitted beside the map.
    """

    effect: TorqueMap
    element: str
    sentence: str
    variables: tuple[MapVariable, ...]
    unit: str
    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    seen: np.ndarray
    held_out_error_before: float
    held_out_error_after: float
    p_value: float
    linear: Mapping[str, float]
    effects: tuple[Effect, ...]

    def as_dict(self) -> dict[str, Any]:
        """For the JSON; ``law`` is what ``corrected.xml`` carries."""
        return {
            "place": self.effect.place,
            "element": self.element,
            "acts": "in the coupling" if self.effect.coupling else "on the body",
            "sentence": self.sentence,
            "variables": [{"name": v.name, "unit": v.unit, "grid": v.grid.tolist()} for v in self.variables],
            "unit": self.unit,
            "values": self.values.tolist(),
            "ci95": [self.low.tolist(), self.high.tolist()],
            "seen": self.seen.tolist(),
            "held_out_error_before": self.held_out_error_before,
            "held_out_error_after": self.held_out_error_after,
            "p_value": self.p_value,
            "beside": {
                "linear_parameters": dict(self.linear),
                "effects": [{"effect": e.id, "place": e.place, "parameters": e.values} for e in self.effects],
            },
            "law": self.effect.as_dict(),
        }


@dataclass(frozen=True)
class Rival:
    """A structure that was fitted: its effects, parameters, estimation and held-out error, how its fit ended."""

    effects: tuple[str, ...]
    n_parameters: int
    rms: float
    held_out_rms: float
    criterion: float
    status: str


@dataclass(frozen=True)
class Refused:
    """A leading rival that is not the answer: the test that refused it, and by how much.

    effects: its structure; against: the structure that it was compared with; test: which test; numbers: what the test measured,
    and what it asks for ("needed" where that is a least value).
    """

    effects: tuple[str, ...]
    against: tuple[str, ...]
    test: str
    numbers: Mapping[str, float]

    def as_dict(self) -> dict[str, Any]:
        """By name."""
        return {
            "effects": list(self.effects), "against": list(self.against), "test": self.test, "numbers": dict(self.numbers),
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Traces:
    """Signals of one recording for the plots (M samples): measured and the predictions, in the view's unit.

    mapped: with the torque map, when there is one. states: name -> (values (M,), unit) of the recorded channels.
    """

    source: str
    role: str
    time: np.ndarray
    measured: np.ndarray
    nominal: np.ndarray | None
    refitted: np.ndarray
    corrected: np.ndarray
    counted: np.ndarray
    sigma: float
    mapped: np.ndarray | None = None
    states: Mapping[str, tuple[np.ndarray, str]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The outcome; see the fields of the contract's ``diagnosis.json``.

    channel, unit: what the models are judged on; mismatch: on the first recording, mismatches: on every one; log: what the check
    of the recordings found. fit: errors, those of nominal and corrected as MuJoCo steps the files where ``surrogate`` is given:
    the same by the fitting engine. friction: its sizes fitted to one recording, by the recording's hash; conditioning: of the
    chosen structure.
    """

    verdict: Verdict
    summary: str
    findings: tuple[Finding, ...]
    mismatch: Mismatch
    linear_parameters: Mapping[str, Estimate]
    nominal_parameters: Mapping[str, float]
    fit: Mapping[str, FitFigures]
    noise_floor: float
    gap_closed: float
    rivals: tuple[Rival, ...]
    failed: Mapping[str, str]
    notes: tuple[str, ...]
    next_experiment: str | None
    channel: str
    unit: str
    view: str
    traces: tuple[Traces, ...]
    recordings: tuple[Mapping[str, str], ...]
    seed: int
    seconds: float
    versions: Mapping[str, str] = field(default_factory=dict)
    false_alarm: Mapping[str, float] = field(default_factory=dict)
    map: MapResult | None = None
    hypotheses: int = 0
    simulations: int = 0
    mismatches: tuple[Mismatch, ...] = ()
    nominal_effects: tuple[NominalEffect, ...] = ()
    log: LogCheck | None = None
    surrogate: Mapping[str, FitFigures] = field(default_factory=dict)
    refusals: tuple[Refused, ...] = ()
    stretches: tuple[Mapping[str, Any], ...] = ()
    friction: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)
    conditioning: Conditioning | None = None

    def shares(self) -> tuple[float, ...]:
        """Each recording's share of the residual energy above noise of all of them."""
        total = sum(m.energy for m in self.mismatches)
        return tuple(m.energy / total if total > 0 else 0.0 for m in self.mismatches)

    def as_dict(self) -> dict[str, Any]:
        """The contract's JSON, with a few fields more."""
        return {
            "verdict": self.verdict.value,
            "summary": self.summary,
            "findings": [
                {
                    "effect": f.effect, "class": f.kind, "law": f.law, "place": f.place, "element": f.element,
                    "sentence": f.sentence, "parameters": {k: v.as_dict() for k, v in f.parameters.items()},
                    "evidence": dict(f.evidence), "equivalents": list(f.equivalents),
                    "equivalent_errors": dict(f.equivalent_errors),
                }
                for f in self.findings
            ],
            "mismatch": {
                **self.mismatch.as_dict(),
                "recordings": [
                    {"file": m.source, "role": m.role, "share": share, **m.as_dict()}
                    for m, share in zip(self.mismatches, self.shares(), strict=True)
                ],
            },
            "linear_parameters": {k: v.as_dict() for k, v in self.linear_parameters.items()},
            "log": self.log.as_dict() if self.log is not None else None,
            "nominal_parameters": dict(self.nominal_parameters),
            "nominal_effects": [
                {
                    "effect": n.effect, "place": n.place, "element": n.element, "nominal": dict(n.nominal),
                    "parameters": {k: v.as_dict() for k, v in n.parameters.items()},
                }
                for n in self.nominal_effects
            ],
            "fit": {
                **{k: v.as_dict() for k, v in self.fit.items()},
                **({"surrogate": {k: v.as_dict() for k, v in self.surrogate.items()}} if self.surrogate else {}),
                "noise_floor": {"rms": self.noise_floor},
            },
            "gap_closed": self.gap_closed,
            "map": self.map.as_dict() if self.map is not None else None,
            "judged_on": {"channel": self.channel, "unit": self.unit, "view": self.view},
            "rivals": [
                {"effects": list(r.effects), "parameters": r.n_parameters, "rms": r.rms, "held_out_rms": r.held_out_rms,
                 "criterion": r.criterion, "status": r.status} for r in self.rivals
            ],
            "refusals": [r.as_dict() for r in self.refusals],
            "stretches": [dict(s) for s in self.stretches],
            "conditioning": self.conditioning.as_dict() if self.conditioning is not None else None,
            "failed": dict(self.failed),
            "notes": list(self.notes),
            "next_experiment": self.next_experiment,
            "hypotheses": self.hypotheses,
            "simulations": self.simulations,
            "false_alarm": dict(self.false_alarm),
            "seed": self.seed,
            "versions": dict(self.versions),
            "recordings": [dict(r) for r in self.recordings],
            "seconds": self.seconds,
        }  # fmt: skip

    def write_json(self, path: Path) -> None:
        """Write ``diagnosis.json`` in one move."""
        write_json(path, self.as_dict())
