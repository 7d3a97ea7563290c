"""The page ``docs/decisions/ablation.md`` from ``data/ablation.json``: heuristics of the search that were removed.

python -m lab.panel.ablation_page > docs/decisions/ablation.md
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

__all__ = ["DATA", "page"]

DATA = Path(__file__).parent / "data" / "ablation.json"

PAGE = """\
# Heuristics of the search that were removed

**Decision.** A heuristic whose absence loses no right answer and adds no false alarm on a declared set of cases is
removed, with its code, its thresholds and its tests. The set, from the quick subset of the [panel](panel.md), the
practice set and cited cases, was chosen by its cost before anything was measured. The judge by MuJoCo was off on all
sides.

**Result.** {about}

Of the {count} cases that both sides have, {right[0]} are right with all heuristics ({before}) and {right[1]} without
them, for {taken[0]} and {taken[1]} simulations in all. So small a set shows no loss below one case in ten or so.

| removed | what it did |
| --- | --- |
{removed}

In their place stand one mechanism for nonsmooth structures (`path.relaxed`: falling observer gains with starts from
the covariance), one for added bodies (`fit.starts.multistart`), and one queue that orders the work.

| case | all heuristics | all of these off | after the removal |
| --- | --- | --- | --- |
{cases}

## One rule at a time

Switched off one by one at commit {one[commit]}, on {one[cases]} cases that were chosen by their cost beforehand,
{one[known]} of them with a truth:

| rule | what it does | right, on and off | simulations, median | 95th percentile | decision |
| --- | --- | --- | --- | --- | --- |
{rules}

{together[what]} At commit {together[commit]},
on {together[cases]} cases ({together[known]} with a truth): right {pair[right]},
median of the simulations {pair[median]}, 95th percentile {pair[percentile_95]}. Growing horizons keep their ratio of 1.6:
with a ratio of two a pendulum that goes over the top is left in a wrong minimum.

## The other rules, each in the cases in which it acts

A rule that never gives another answer than the neutral one in a case cannot change that case. At commit {acts[commit]}
the calls of every rule were counted in {acts[cases]} cases ({acts[which]}), and each rule was then switched off
in the cases in which it acts.
Counts of right answers are of those with a truth, simulations are sums over the cases that were run again.

| rule | what it does | acts in | right, on and off | simulations, on and off | decision |
| --- | --- | --- | --- | --- | --- |
{acting}

{acts[note]}

This page is made by `python -m lab.panel.ablation_page` from `lab/panel/data/ablation.json`; a test holds that.
"""


def _answer(run: Mapping[str, Any] | None) -> str:
    """An answer in one cell: verdict or effects, how it was scored, simulations."""
    if run is None:
        return "-"
    named = " + ".join(run["named"]) or str(run["verdict"])
    return f"{named}; {run['outcome'] or 'no truth'}; {run['simulations']}"


def _change(pair: Sequence[Any]) -> str:
    """Before and after."""
    return f"{pair[0]} -> {pair[1]}"


def _rule(rule: Mapping[str, Any]) -> str:
    """A row of the table of single rules."""
    cells = (rule["name"], rule["what"], *(_change(rule[k]) for k in ("right", "median", "percentile_95")), rule["fate"])
    return f"| {' | '.join(cells)} |"


def _acting(rule: Mapping[str, Any]) -> str:
    """A row of the table of rules that were switched off where they act."""
    cells = (rule["name"], rule["what"], str(rule["acts"]), *(_change(rule[k]) for k in ("right", "simulations")), rule["fate"])
    return f"| {' | '.join(cells)} |"


def page(data: Mapping[str, Any]) -> str:
    """The page in Markdown."""
    pairs = [(r["before"], r["after"]) for r in data["cases"] if r["before"] and r["after"]]
    cells = [[r["case"], *(_answer(r[k]) for k in ("before", "off", "after"))] for r in data["cases"]]
    one, together = data["one_by_one"], data["one_by_one"]["together"]
    return PAGE.format(
        one=one,
        rules="\n".join(map(_rule, one["rules"])),
        together=together,
        acts=data["by_acts"],
        acting="\n".join(map(_acting, data["by_acts"]["rules"])),
        pair={k: _change(together[k]) for k in ("right", "median", "percentile_95")},
        about=data["about"],
        before=data["before"],
        count=len(pairs),
        right=[sum(bool(pair[k]["good"]) for pair in pairs) for k in (0, 1)],
        taken=[sum(pair[k]["simulations"] or 0 for pair in pairs) for k in (0, 1)],
        removed="\n".join(f"| {r['name']} | {r['what']} |" for r in data["removed"]),
        cases="\n".join(f"| {' | '.join(row)} |" for row in cells),
    )


if __name__ == "__main__":
    print(page(json.loads(DATA.read_text(encoding="utf-8"))), end="")
