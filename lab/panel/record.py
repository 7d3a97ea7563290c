"""What a commit says of a case, and whether it is right; files of answers."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ident.serial import write_atomic
from lab.benchmark.resume import plain
from lab.benchmark.score import NULLS, PHYSICS, Outcome, score_case
from lab.panel.case import Content
from mjsim.errors import InputError

__all__ = ["Finding", "Record", "from_json", "outcome_of", "read_answers", "record_of", "to_json", "write_answers"]

FORMAT = 1  # of the files of answers
FIGURES = ("nominal", "refitted", "corrected")
DIGITS = 6  # of a number in a file of answers


@dataclass(frozen=True)
class Finding:
    """One effect that was named.

    ``parameters``: name -> value and the ends of its 95 % interval, SI; None where there is no finite end.
    """

    effect: str
    place: str
    parameters: Mapping[str, tuple[float | None, float | None, float | None]]
    equivalents: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """``effect@place``."""
        return f"{self.effect}@{self.place}"


@dataclass(frozen=True)
class Record:
    """One answer.

    ``hash``: of the case that it is about; ``commit``: of the code; ``outcome``: a value of `lab.benchmark.score.Outcome`, None
    where no truth is known; ``null``: nothing was concealed; ``held_out``: rms held-out errors (nominal, refitted, corrected) in
    the unit that was judged; ``noise``: rms of the noise that the diagnosis found, same unit; ``simulations``: None where the
    commit does not count them; ``seconds``: elapsed, ``cpu_seconds``: of the processor; ``error``: why there is no answer;
    ``inside``: of the parameters that could be compared with the truth, how many intervals hold it, and how many there are;
    ``errors``: relative errors of these parameters, of a phase in rad; ``acted``: how often each watched rule gave an answer that
    is not the neutral one.
    """

    case: str
    hash: str
    commit: str
    verdict: str
    outcome: str | None
    null: bool
    findings: tuple[Finding, ...] = ()
    linear: Mapping[str, tuple[float | None, float | None, float | None]] = field(default_factory=dict)
    held_out: tuple[float | None, ...] = ()
    noise: float | None = None
    simulations: int | None = None
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    inside: tuple[int, int] = (0, 0)
    errors: tuple[float, ...] = ()
    error: str = ""
    acted: Mapping[str, int] = field(default_factory=dict)

    @property
    def good(self) -> bool | None:
        """Right up to equivalents; None where no truth is known."""
        return None if self.outcome is None else Outcome(self.outcome).good

    @property
    def named(self) -> tuple[str, ...]:
        """``effect@place`` of each finding, sorted."""
        return tuple(sorted(f.key for f in self.findings))


def outcome_of(content: Content, result: Mapping[str, Any]) -> str | None:
    """How an answer holds against what is known of the case: by the benchmark's rules, or by the names that are expected."""
    if content.truth is not None:
        return score_case("", content.truth, result).outcome.value
    if content.expected is None:
        return None
    return _by_names(content.expected, result).value


def _by_names(expected: Mapping[str, Any], result: Mapping[str, Any]) -> Outcome:
    """Against sets of names, each of which is right."""
    if "error" in result:
        return Outcome.ERROR
    found = {f["effect"] for f in result["findings"]}
    ways = [set(way) for way in expected["effects"]]
    if result["verdict"] in expected["verdicts"] and found in ways:
        return Outcome.RIGHT
    if result["verdict"] not in PHYSICS:
        return Outcome.MISSED
    if result["verdict"] == "unexplained":
        return Outcome.UNEXPLAINED
    if any(way < found for way in ways):
        return Outcome.EXTRA
    return Outcome.PART if any(way & found for way in ways) else Outcome.WRONG_NAME


def _triple(estimate: Mapping[str, Any]) -> tuple[float | None, float | None, float | None]:
    low, high = estimate.get("ci95") or (None, None)
    return estimate.get("value"), low, high


def record_of(case: str, hash: str, commit: str, content: Content, reply: Mapping[str, Any], result: Mapping[str, Any]) -> Record:
    """The record of a reply of the driver and of the ``diagnosis.json`` that it left; of a failure ``reply`` has ``error``."""
    null = content.truth is not None and content.truth["level"] in NULLS
    error = str(reply.get("error", ""))
    common: dict[str, Any] = {
        "case": case, "hash": hash, "commit": commit, "null": null, "simulations": reply.get("simulations"),
        "acted": dict(reply.get("acted", {})),
        "seconds": round(float(reply.get("seconds", 0.0)), 3), "cpu_seconds": round(float(reply.get("cpu_seconds", 0.0)), 3),
    }  # fmt: skip
    if error:
        return Record(verdict="error", outcome=outcome_of(content, {"error": error}), error=error, **common)
    fit = result["fit"]
    scored = () if content.truth is None else score_case(case, content.truth, result).parameters
    known = [p.inside for p in scored if p.inside is not None]
    return Record(
        verdict=result["verdict"],
        outcome=outcome_of(content, result),
        findings=tuple(
            Finding(f["effect"], f["place"], {n: _triple(p) for n, p in f["parameters"].items()}, tuple(f.get("equivalents", ())))
            for f in result["findings"]
        ),
        linear={n: _triple(p) for n, p in result["linear_parameters"].items()},
        held_out=tuple(fit[name]["held_out_rms"] for name in FIGURES),
        noise=fit["noise_floor"]["rms"],
        inside=(sum(known), len(known)),
        errors=tuple(p.error for p in scored if p.counted),
        **common,
    )


def _round(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _round(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_round(v) for v in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def to_json(record: Record) -> str:
    """One line."""
    return json.dumps(_round(plain(asdict(record))), separators=(",", ":"))


def from_json(said: Mapping[str, Any]) -> Record:
    """The record of a line."""
    findings = tuple(
        Finding(f["effect"], f["place"], {n: tuple(p) for n, p in f["parameters"].items()}, tuple(f["equivalents"]))
        for f in said["findings"]
    )
    lists = {k: tuple(said[k]) for k in ("held_out", "inside", "errors")}
    linear = {n: tuple(p) for n, p in said["linear"].items()}
    return Record(**{**said, **lists, "findings": findings, "linear": linear})


def write_answers(path: Path, records: Sequence[Record], about: Mapping[str, Any]) -> None:
    """Write a file of answers: JSON, one line a case, in the order of their names."""
    lines = ",\n".join(to_json(r) for r in sorted(records, key=lambda r: r.case))
    head = json.dumps({"format": FORMAT, **about, "count": len(records)})
    write_atomic(path, f'{head[:-1]}, "answers": [\n{lines}\n]}}\n')


def read_answers(path: Path) -> dict[str, Record]:
    """Records by case, of a file of answers or of the folder of a run. Raises InputError for what is neither."""
    try:
        if path.is_dir():
            said = [json.loads(p.read_text(encoding="utf-8"))["record"] for p in sorted((path / "records").glob("*.json"))]
        else:
            said = json.loads(path.read_text(encoding="utf-8"))["answers"]
        records = {r.case: r for r in map(from_json, said)}
    except (OSError, ValueError, KeyError, TypeError) as error:
        found = f"no answers can be read ({type(error).__name__})"
        raise InputError(path, found, "the folder of a run, or a file of answers") from None
    if not records:
        raise InputError(path, "no answer in it", "the folder of a run, or a file of answers")
    return records
