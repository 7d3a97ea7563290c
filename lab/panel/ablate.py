"""Ablation: the same cases with one heuristic switched off, compared with all of them on."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path

from ident.serial import write_atomic
from lab.benchmark.resume import plain
from lab.panel.case import Case
from lab.panel.compare import Comparison, compare, markdown
from lab.panel.rules import Rule, patches_of
from lab.panel.run import Setting, run_cases

__all__ = ["ablate", "ablation_table"]

BASE = "all_on"  # folder of the run with everything on


def ablate(
    rules: Sequence[Rule], cases: Sequence[Case], out: Path, setting: Setting, jobs: int, say: Callable[[str], None]
) -> dict[str, Comparison]:
    """Run the cases with everything on, then with each rule off; by rule, the comparison of the latter with the former.

    The first run counts in which cases each rule acts: one that never acts cannot change a case, which then keeps its answer.
    Each run is resumed as any other. ``out/RULE/comparison.md`` says the changed answers, ``out/ablation.json`` all figures.
    Raises InputError where a rule no longer fits the code.
    """
    watching = dataclasses.replace(setting, watched=patches_of(rules))
    base = run_cases(cases, out / BASE, watching, jobs, say).records
    found: dict[str, Comparison] = {}
    for rule in rules:
        changing = [c for c in cases if c.id in base and base[c.id].acted.get(rule.name)]
        say(f"without {rule.name} ({rule.what}), which acts in {len(changing)} of {len(base)} cases")
        less = dataclasses.replace(setting, patches=rule.patches, rule=rule.name)
        records = {**base, **(run_cases(changing, out / rule.name, less, jobs, say).records if changing else {})}
        found[rule.name] = compare(base, records)
        write_atomic(out / rule.name / "comparison.md", markdown(found[rule.name], "all on", f"without {rule.name}"))
        said = {name: c.as_dict() for name, c in found.items()}
        write_atomic(out / "ablation.json", json.dumps(plain({"commit": setting.tree.commit, "rules": said}), indent=1) + "\n")
    return found


def _percent(before: float, after: float) -> str:
    return f"{100 * (after / before - 1):+.0f} %" if before > 0 else "-"


def ablation_table(found: dict[str, Comparison]) -> str:
    """One row a rule: what its absence gains, loses and costs."""
    head = (
        "without",
        "gained",
        "lost",
        "p",
        "false alarms",
        "simulations, median",
        "95th percentile",
        "CPU time",
        "answers changed",
    )
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    for name, c in found.items():
        cells = (
            name, c.gained, c.lost, f"{c.p_value:.2g}", f"{c.false_alarms.after - c.false_alarms.before:+.0f}",
            _percent(c.simulations_median.before, c.simulations_median.after),
            _percent(c.simulations_95.before, c.simulations_95.after),
            _percent(c.cpu_seconds.before, c.cpu_seconds.after), len(c.changes),
        )  # fmt: skip
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"
