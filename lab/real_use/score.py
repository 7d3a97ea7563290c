"""The score: false alarms, effects named right, corrected files; with Wilson intervals, by level of each factor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from lab.real_use.design import FACTORS, KINDS

__all__ = ["Count", "Outcome", "line", "outcome", "tables"]

Record = dict[str, Any]
MISSES = 1.1  # times the reported held-out error, for a corrected file to be as reported
Z = 1.96


@dataclass(frozen=True)
class Count:
    """How many of how many."""

    hits: int
    of: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the share (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
        if not self.of:
            return 0.0, 1.0
        p, n = self.hits / self.of, self.of
        middle, half = p + Z * Z / (2 * n), Z * math.sqrt(p * (1 - p) / n + (Z / (2 * n)) ** 2)
        return max(0.0, (middle - half) / (1 + Z * Z / n)), min(1.0, (middle + half) / (1 + Z * Z / n))

    def __str__(self) -> str:
        low, high = self.interval
        share = f"{100 * self.hits / self.of:.1f}" if self.of else "-"
        return f"{self.hits} of {self.of} | {share} % | {100 * low:.1f} to {100 * high:.1f} %"


class Outcome:
    """Names of what became of a case."""

    RIGHT, ALARM, VERDICT, MISSED, WRONG, MORE, ERROR = (
        "right", "false alarm", "verdict", "missed", "wrong name", "a name too many", "error"
    )  # fmt: skip


def _wanted(r: Record) -> list[str]:
    name = KINDS[r["kind"]][1]
    return [name] if name else []


def _found(r: Record) -> list[str]:
    """Names that were found; a stop that the motion reaches at one end alone is one of the joint's."""
    return [name.removeprefix("lower_").removeprefix("upper_") for name in r["found"]]


def outcome(r: Record) -> str:
    """What became of a case."""
    if r["exit"]:
        return Outcome.ERROR
    wanted, found = _wanted(r), _found(r)
    if wanted:
        if found == wanted:
            return Outcome.RIGHT if r["verdict"] == "missing_physics" else Outcome.VERDICT
        return Outcome.MISSED if not found else Outcome.MORE if set(wanted) <= set(found) else Outcome.WRONG
    if found:
        return Outcome.ALARM
    clean = {"nothing": ("no_mismatch",), "number": ("parameters_only",)}[r["group"]]
    return Outcome.RIGHT if r["verdict"] in clean else Outcome.VERDICT


def named(r: Record) -> bool:
    """Whether exactly the effects that are there are named."""
    return not r["exit"] and _found(r) == _wanted(r)


def _as_reported(r: Record) -> bool:
    return not r["exit"] and _ratio(r["own_error"], r["reported"]) <= MISSES


def _as_engine(r: Record) -> bool:
    return not r["exit"] and _ratio(r["own_error"], r["engine"]) <= MISSES


def _at_truth(r: Record) -> bool:
    return not r["exit"] and _ratio(r["own_error"], r["true_error"]) <= MISSES


def _ratio(a: float | None, b: float | None) -> float:
    return a / b if a is not None and b else math.inf


def _count(records: Iterable[Record], holds: Callable[[Record], bool]) -> Count:
    every = list(records)
    return Count(sum(map(holds, every)), len(every))


def line(r: Record) -> str:
    """A line for a case."""
    where = (
        f"{r['machine']:8s} {r['loop']:5s} {r['solver']:7s} {r['integrator']:12s} {r['rate']:4g} Hz {1e3 * r['timestep']:3g} ms"
    )
    if r["exit"]:
        told = r["error"].strip().splitlines()[-1]
    else:
        found = "+".join((*(f"{a}@{b}" for a, b in zip(r["found"], r["places"], strict=False)), *r["numerics"])) or "-"
        told = f"{r['verdict']:15s} {found}"
        told += f"; own/reported {_ratio(r['own_error'], r['reported']):.3f}, /engine {_ratio(r['own_error'], r['engine']):.3f}, "
        told += f"/truth {_ratio(r['own_error'], r['true_error']):.2f}"
    given = f"given {_ratio(r['given_error'], r['true_error']):7.2f}"
    return f"{r['number']:3d} {where} {r['kind']:15s} {given} {outcome(r):15s} {told}; {r['cpu_seconds']:.0f} s cpu"


def tables(records: Sequence[Record]) -> str:
    """The score as Markdown tables: the bars, by level of each factor, and every case that is not right."""
    clean = [r for r in records if r["group"] in ("nothing", "number")]
    effects, outside = ([r for r in records if r["group"] == g] for g in ("effect", "outside"))
    delayed = [r for r in records if r["kind"] == "delay"]
    rows: list[tuple[str, Count]] = [
        ("false alarms (physics named where nothing or a number is off)", _count(clean, lambda r: bool(r.get("found")))),
        ("clean cases with the right verdict", _count(clean, lambda r: outcome(r) == Outcome.RIGHT)),
        ("effects named right, and nothing else", _count(effects, named)),
        ("effects named right, and `missing_physics`", _count(effects, lambda r: outcome(r) == Outcome.RIGHT)),
        ("effects among the names or their equivalents", _count(effects, _among)),
        (
            "further elements: a spring at the joint, a stop of it",
            _count(outside, lambda r: outcome(r) == Outcome.RIGHT),
        ),
        (f"own run of `corrected.xml` within {MISSES} x of the reported held-out error", _count(records, _as_reported)),
        (f"own run of `corrected.xml` within {MISSES} x of the fitting engine's error", _count(records, _as_engine)),
        (f"own run of `corrected.xml` within {MISSES} x of the true machine's error", _count(records, _at_truth)),
        ("diverging corrected files", _count(records, lambda r: not r["exit"] and not math.isfinite(r["own_error"]))),
        ("tracebacks or one-line errors", _count(records, lambda r: bool(r["exit"]))),
        ("logs that the check wants fixed first: a delay of the drive is a skew of clocks as well", _count(delayed, _refused)),
        ("the same of all other kinds", _count([r for r in records if r not in delayed], _refused)),
    ]
    lines = ["| measure | count | share | 95 % (Wilson) |", "|---|---|---|---|", *(f"| {name} | {c} |" for name, c in rows)]
    lines += ["", "| level | clean | false alarms | effects | named right |", "|---|---|---|---|---|"]
    for factor in ("machine", "loop", "solver", "integrator", "rate"):
        for level in dict.fromkeys(FACTORS[factor]):
            here = [[r for r in group if r[factor] == level] for group in (clean, effects)]
            unit = " Hz" if factor == "rate" else ""
            name = f"{level:g}" if isinstance(level, float) else level
            alarms, right = sum(bool(r.get("found")) for r in here[0]), sum(map(named, here[1]))
            lines.append(f"| {factor} {name}{unit} | {len(here[0])} | {alarms} | {len(here[1])} | {right} |")
    lines += ["", "| kind | cases | named right |", "|---|---|---|"]
    for kind in KINDS:
        of = [r for r in records if r["kind"] == kind]
        if of:
            lines.append(f"| {kind} | {len(of)} | {sum(map(named, of))} |")
    lines += ["", *_not_right(records)]
    cpu = sorted(r["cpu_seconds"] for r in records)
    if cpu:
        lines += ["", f"CPU seconds of a case: median {cpu[len(cpu) // 2]:.0f}, largest {cpu[-1]:.0f}."]
    return "\n".join(lines) + "\n"


def _not_right(records: Sequence[Record]) -> list[str]:
    """Every case that is not right, or whose corrected file is not as reported or not as the true machine."""
    rows = ["| case | machine, loop | solver, integrator | rate | lacks | outcome | told | own error / reported, / truth |",
            "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for r in records:
        if outcome(r) == Outcome.RIGHT and _as_reported(r) and _at_truth(r):
            continue
        told = r["error"].strip().splitlines()[-1] if r["exit"] else f"{r['verdict']}: {', '.join(r['found']) or 'nothing'}"
        ratios = "-" if r["exit"] else " / ".join(f"{_ratio(r['own_error'], r[k]):.3g}" for k in ("reported", "true_error"))
        rows.append(
            f"| {r['number']} | {r['machine']}, {r['loop']} | {r['solver']}, {r['integrator']} | {r['rate']:g} Hz | {r['kind']} "
            f"| {outcome(r)} | {told} | {ratios} |"
        )
    return rows


def _refused(r: Record) -> bool:
    return bool(r.get("refused"))


def _among(r: Record) -> bool:
    return not r["exit"] and set(_wanted(r)) <= {*r["found"], *r["equivalents"]}
