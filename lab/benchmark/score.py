"""Score one case: what a diagnosis said beside what was concealed, by plain JSON values on both sides.

Nothing here knows the tool that made the diagnosis: whatever writes the contract's ``diagnosis.json`` can be scored.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import permutations
from typing import Any

from lab.benchmark.catalogue import EQUIVALENT, LOG_FAULTS
from lab.benchmark.laws import Laws
from lab.benchmark.sized import SPREAD

__all__ = ["NULLS", "CaseScore", "Outcome", "ParameterScore", "alternatives", "score_case"]

NULLS = ("nothing", "parameters_only")
WITHOUT = ("no_mismatch", "parameters_only")  # verdicts that say: nothing is
PHYSICS = ("missing_physics", "unexplained")  # verdicts that say: something is missing
EXACT = ("cycles_per_rev",)  # whole numbers, found almost exactly: they would flatter the median error


class Outcome(enum.Enum):
    """How a case ended; the value stands in the JSON."""

    RIGHT = "right"
    EQUIVALENT = "right up to equivalents"
    EXTRA = "right and one too many"
    PART = "part of it"
    WRONG_NAME = "wrong name"
    MISSED = "missed"
    UNEXPLAINED = "unexplained"
    FALSE_ALARM = "false alarm"
    SMALL = "change of parameters missed"
    ERROR = "error"

    @property
    def good(self) -> bool:
        """Verdict and names are right, up to equivalents."""
        return self in (Outcome.RIGHT, Outcome.EQUIVALENT)


@dataclass(frozen=True)
class ParameterScore:
    """One number of one effect that was named at its place.

    ``error``: relative to the truth; for a phase the difference in rad, which is the relative error of the phasor.
    ``inside``: the 95 % interval holds the truth, None without a finite interval. ``counted``: enters the
    median error.
    """

    effect: str
    name: str
    truth: float
    value: float
    ci95: tuple[float, float] | None
    error: float
    inside: bool | None
    counted: bool


@dataclass(frozen=True)
class CaseScore:
    """One case: truth, what was said, and how far it holds.

    ``truth`` and ``found``: ``effect@place``, found strongest first. ``exact``: the names found are those concealed; ``named``:
    up to equivalents; ``top1``: the strongest finding is one of those concealed, up to equivalents. ``places``: of the effects
    found by name, whether the place is right. ``size``: smallest over the effects, in units of the noise rms, see
    `size.Size`. ``gap``: share of the held-out error above the true noise that was closed. ``left``: held-out rms over the true
    noise rms of each model. ``seconds``: of the diagnosis.
    """

    name: str
    level: str
    expected: str
    verdict: str
    outcome: Outcome
    verdict_right: bool
    truth: tuple[str, ...]
    found: tuple[str, ...]
    declared: tuple[tuple[str, ...], ...]
    exact: bool
    named: bool
    top1: bool
    places: tuple[tuple[str, bool], ...]
    parameters: tuple[ParameterScore, ...]
    linear: tuple[ParameterScore, ...]
    contract_law: bool
    size: Mapping[str, float]
    noise_kind: str
    closed_loop: bool
    excitation: str
    gap: float
    left: Mapping[str, float]
    seconds: float
    error: str

    @property
    def null(self) -> bool:
        """No physics was concealed."""
        return self.level in NULLS

    @property
    def detected(self) -> bool:
        """The verdict says that something is missing."""
        return self.verdict in PHYSICS

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "outcome": self.outcome.value, "good": self.outcome.good}


def _effect(key: str) -> str:
    return key.partition("@")[0]


def alternatives(keys: Iterable[str], declared: Mapping[str, Sequence[Sequence[str]]] | None = None) -> set[frozenset[str]]:
    """Every set of ``effect@place`` that makes the same motion as ``keys``, by the catalogue and by what a case declares.

    The relation is used both ways: friction that differs by sign is Coulomb friction and an offset, and these two are it.
    """
    table = {f"{e}@{p}": [frozenset(f"{a}@{b}" for a, b in g) for g in groups] for (e, p), groups in EQUIVALENT.items()}
    for key, groups in (declared or {}).items():
        table.setdefault(key, []).extend(frozenset(g) for g in groups)
    reached = {frozenset(keys)}
    todo = list(reached)
    while todo:
        here = todo.pop()
        there = [(here - {key}) | group for key in here for group in table.get(key, ())]
        there += [(here - group) | {key} for key, groups in table.items() for group in groups if group <= here]
        for new in there:
            if new not in reached:
                reached.add(new)
                todo.append(new)
    return reached


def _called(finding: Mapping[str, Any]) -> set[str]:
    """Names by which a finding goes: its own and those it says the data cannot tell from it."""
    return {finding["effect"], *(_effect(e) for e in finding.get("equivalents", ()))}


def _covers(findings: Sequence[Mapping[str, Any]], wanted: frozenset[str]) -> bool:
    """Each finding goes by the name of one wanted effect, and none is left over."""
    if len(findings) != len(wanted):
        return False
    names = [_called(f) for f in findings]
    return any(all(_effect(k) in n for k, n in zip(order, names, strict=True)) for order in permutations(wanted))


def _number(value: Any) -> float:
    """A float; what is not there is not a number."""
    return math.nan if value is None else float(value)


def _parameter(effect: str, name: str, truth: float, estimate: Mapping[str, Any]) -> ParameterScore:
    value = _number(estimate.get("value"))
    low, high = (_number(x) for x in (estimate.get("ci95") or (None, None)))
    given = truth
    if name.startswith("phase"):
        if math.isfinite(value):
            given += 2 * math.pi * round((value - given) / (2 * math.pi))
        error = abs(value - given)
    else:
        error = abs(value - given) / abs(given) if given else abs(value - given)
    finite = math.isfinite(low) and math.isfinite(high)
    inside = low <= given <= high if finite else None
    counted = math.isfinite(error) and name not in EXACT
    return ParameterScore(effect, name, given, value, (low, high) if finite else None, error, inside, counted)


def _small(linear: Mapping[str, float]) -> bool:
    """Every linear parameter is as near to the nominal one as those of an axis with an effect are."""
    nominal = Laws()
    return all(abs(v / getattr(nominal, n) - 1) <= SPREAD * 1.0001 for n, v in linear.items())


def _verdict_right(truth: Mapping[str, Any], verdict: str) -> bool:
    """On nulls both "nothing" and "parameters only" are right as long as the parameters differ little."""
    if truth["level"] in NULLS:
        fine = WITHOUT if _small(truth.get("linear_parameters", {})) else ("parameters_only",)
        return verdict in fine
    return bool(verdict == truth["verdict"])


def _as_log_fault(truth: Mapping[str, Any], result: Mapping[str, Any]) -> bool:
    """Whether all that is missing is a fault of the log which the answer names as such, with no physics in its place."""
    faults = {p["problem"] for p in (result.get("log") or {}).get("problems", ())}
    wanted = [LOG_FAULTS.get(e) for e in truth["effects"]]
    return bool(wanted) and all(w in faults for w in wanted) and not result.get("findings") and result.get("verdict") in WITHOUT


def _outcome(truth: Mapping[str, Any], verdict: str, right: bool, exact: bool, named: bool, shared: int, extra: bool) -> Outcome:
    if truth["level"] in NULLS:
        if right:
            return Outcome.RIGHT
        by_verdict = {"missing_physics": Outcome.FALSE_ALARM, "unexplained": Outcome.UNEXPLAINED}
        return by_verdict.get(verdict, Outcome.SMALL)
    if verdict not in PHYSICS:
        return Outcome.MISSED
    if truth["level"] == "out_of_library":
        return Outcome.RIGHT if right else Outcome.WRONG_NAME
    if verdict == "unexplained":
        return Outcome.UNEXPLAINED
    if named:
        return Outcome.RIGHT if exact else Outcome.EQUIVALENT
    if extra:
        return Outcome.EXTRA
    return Outcome.PART if shared else Outcome.WRONG_NAME


def _fits(truth: Mapping[str, Any], result: Mapping[str, Any]) -> tuple[float, dict[str, float]]:
    """(gap closed, held-out rms over noise of each model), by the true noise."""
    noise = float(truth["velocity_noise_rms_rad_s"])
    held = {k: _number(result.get("fit", {}).get(k, {}).get("held_out_rms")) for k in ("nominal", "refitted", "corrected")}
    before, after = held["refitted"], held["corrected"]
    # a gap below 1 % of the noise cannot be measured on some thousand samples
    gap = (before - after) / (before - noise) if before > 1.01 * noise else math.nan
    return gap, {k: v / noise for k, v in held.items()}


def score_case(name: str, truth: Mapping[str, Any], result: Mapping[str, Any]) -> CaseScore:
    """Score a diagnosis (``diagnosis.json`` as a dict, or ``{"error": text}``) by the truth of its case."""
    wanted = tuple(f"{e}@{truth['where'][e]}" for e in truth["effects"])
    error = str(result.get("error", ""))
    verdict = "error" if error else str(result["verdict"])
    findings: list[Mapping[str, Any]] = [] if error else list(result["findings"])
    found = tuple(f"{f['effect']}@{f['place']}" for f in findings)
    ways = alternatives(wanted, {f"{e}@{truth['where'][e]}": g for e, g in truth.get("equivalents", {}).items()})
    exact = sorted(map(_effect, found)) == sorted(map(_effect, wanted))
    named = any(_covers(findings, way) for way in ways)
    any_way = {k for way in ways for k in way}
    any_name = {_effect(k) for k in any_way}
    places, parameters = [], []
    for key in wanted:
        effect = _effect(key)
        same = [f for f in findings if f["effect"] == effect]
        if not same:
            continue
        f = next((f for f in same if f"{effect}@{f['place']}" == key), same[0])
        right = f"{effect}@{f['place']}" in any_way or key in f.get("equivalents", ())
        places.append((key, right))
        if right:
            given = truth["parameters"].get(effect, {})
            parameters += [_parameter(effect, n, float(v), f["parameters"][n]) for n, v in given.items() if n in f["parameters"]]
    verdict_right = not error and _verdict_right(truth, verdict)
    shared = sum(bool(_called(f) & any_name) for f in findings)
    extra = any(len(part) < len(findings) and _covers(part, way) for way in ways for part in _parts(findings))
    if _as_log_fault(truth, result):
        verdict_right = True
        outcome = Outcome.RIGHT
    else:
        outcome = (
            Outcome.ERROR if error else _outcome(truth, verdict, verdict_right, exact, named, shared, extra and bool(wanted))
        )
    linear = result.get("linear_parameters", {})
    gap, left = (math.nan, {}) if error else _fits(truth, result)
    sizes = truth.get("size", {}).values()
    return CaseScore(
        name=name,
        level=truth["level"],
        expected=truth["verdict"],
        verdict=verdict,
        outcome=outcome,
        verdict_right=verdict_right,
        truth=wanted,
        found=found,
        declared=tuple(tuple(f.get("equivalents", ())) for f in findings),
        exact=exact,
        named=named,
        top1=bool(findings) and bool(_called(findings[0]) & any_name),
        places=tuple(places),
        parameters=tuple(parameters),
        linear=tuple(
            _parameter("", n, float(v), linear[n]) for n, v in truth.get("linear_parameters", {}).items() if n in linear
        ),
        contract_law=all(law == "contract" for law in truth.get("law", {}).values()),
        size={k: min(s[k] for s in sizes) for k in ("raw", "after_refit", "distinct")} if sizes else {},
        noise_kind=truth.get("noise_kind", "white"),
        closed_loop=bool(truth.get("closed_loop", False)),
        excitation=truth.get("excitation", ""),
        gap=gap,
        left=left,
        seconds=_number(result.get("seconds")),
        error=error,
    )


def _parts(findings: Sequence[Mapping[str, Any]]) -> list[list[Mapping[str, Any]]]:
    """All selections of findings with at least one left out."""
    n = len(findings)
    return [[f for i, f in enumerate(findings) if mask >> i & 1] for mask in range(1, 2**n - 1)]
