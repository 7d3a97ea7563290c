"""The tables of a diagnosis page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from diagnose.report.charts import NAMES
from diagnose.report.components import Cell, Column, badge, bar, table
from diagnose.report.figures import estimate, interval, number, percent, prose, unit
from diagnose.report.truth import truth_rows
from diagnose.report.words import effect_name, linear_name, structure_name
from diagnose.result import Diagnosis, Estimate, Finding, FitFigures, Refused, Rival
from diagnose.thresholds import HALVINGS
from mjsim.effects import effect_class

__all__ = [
    "error_table", "linear_table", "parameter_table", "place_table", "recording_table", "refusal_table", "rival_tables",
    "truth_table", "unexcited",
]  # fmt: skip

_FILES = ("nominal", "corrected")  # whose errors are those of the files, as MuJoCo steps them
_STATUS = {"budget": "stopped at its budget", "stalled": "stalled: rough cost", "failed": "could not be run"}
_TESTS = {
    "criterion": "criterion, not low enough",
    "gain": "gain on the estimation data",
    "quantisation": "error beyond half a step of the encoder",
    "law": "gain of the richer law",
    "held_out": "held-out data",
    "encoder": "gain beside an encoder that errs",
    "events": "gain where the motion has events",
    "few_periods": "share left by a disturbance of few periods",
    "speed": "gain beside a function of the speed",
    "servo": "share of the error that the servo answers",
}


def weak(e: Estimate) -> bool:
    """Whether the interval reaches as far as zero: the data hardly tell that there is any."""
    low, high = e.ci95
    return not (math.isfinite(low) and math.isfinite(high)) or low <= 0 <= high


def truth_table(d: Diagnosis, truth: Mapping[str, Any]) -> Markup:
    """What was concealed beside what was found."""
    columns = [
        Column("What"), Column("Truth", numeric=True), Column("Found", numeric=True), Column("95 % interval", numeric=True),
        Column("Off by", numeric=True), Column("Outcome"),
    ]  # fmt: skip
    rows = []
    for r in truth_rows(d, truth):
        told: Cell = Markup('<span class="muted">{}</span>').format(r.verdict)
        if r.right is not None:
            told = badge(f"{'✓' if r.right else '✗'} {r.verdict}", "good" if r.right else "alarm")
        what = Markup('<span class="part">{}</span>').format(r.what) if r.part else r.what
        rows.append((what, r.truth, r.found, r.interval, r.off, told))
    return table(columns, rows)


def parameter_table(f: Finding, about: Mapping[str, str]) -> Markup:
    """Parameters of a finding with their intervals."""
    columns = [
        Column("Parameter"), Column("Value", numeric=True), Column("95 % interval", numeric=True), Column("Unit"),
        Column("Meaning", wide=True),
    ]  # fmt: skip
    rows = []
    for name, e in f.parameters.items():
        told: Cell = about.get(name, "")
        if weak(e) and not name.startswith("phase"):
            told = Markup("{} {}").format(told, badge("not told from zero", "warn"))
        rows.append((Markup("<code>{}</code>").format(name), estimate(e), interval(e), unit(e.unit), told))
    return table(columns, rows, f"Parameters of {effect_name(f.effect)}")


def stretch_table(d: Diagnosis) -> Markup | None:
    """Friction fitted to each stretch of a long recording; None where there is none."""
    parts = [s for s in d.stretches if s.get("friction")]
    names = list(dict.fromkeys(name for s in parts for name in s["friction"]))
    if not names:
        return None
    units = {name: e["unit"] for s in parts for name, e in s["friction"].items()}
    columns = [Column("Stretch from"), Column("Role"), *(Column(f"{name} [{units[name]}]", numeric=True) for name in names)]
    rows = []
    for s in parts:
        found = [s["friction"].get(name) for name in names]
        told = [Estimate(e["value"], tuple(e["ci95"]), e["unit"], e.get("at_bound", False)) if e else None for e in found]
        values = [f"{estimate(e)} ({interval(e)})" if e else "–" for e in told]
        rows.append((f"{number(s['start_s'])} s", str(s["role"]), *values))
    return table(columns, rows, "Friction of each stretch by itself, with 95 % intervals; all other numbers are held")


def conditioning_sentence(d: Diagnosis) -> str | None:
    """How well the data determine the numbers of the fit; None for a diagnosis without one."""
    c = d.conditioning
    if c is None:
        return None
    if c.rank < c.numbers:
        names = ", ".join(c.undetermined)
        return f"The data tell {c.rank} of {c.numbers} fitted numbers apart; not {names}, which follow the nominal model."
    return f"The data tell all {c.numbers} fitted numbers apart: rank {c.rank}, condition {number(c.condition)}."


def linear_table(d: Diagnosis) -> Markup | None:
    """The nominal model's own numbers, as given and as identified; None when there are none."""
    numbers: list[tuple[str, str, float | None, Estimate | None, bool]] = [
        (name, linear_name(name, e.unit), d.nominal_parameters.get(name), e, True) for name, e in d.linear_parameters.items()
    ]
    numbers += [
        (name, f"{effect_name(n.effect)}, {n.place}", nominal, n.parameters.get(name), name in _positive(n.effect))
        for n in d.nominal_effects for name, nominal in n.nominal.items()
    ]  # fmt: skip
    if not numbers:
        return None
    columns = [
        Column("Parameter"), Column("Meaning"), Column("Nominal", numeric=True), Column("Identified", numeric=True),
        Column("95 % interval", numeric=True), Column("Unit"), Column("Change", numeric=True, wide=True),
    ]  # fmt: skip
    rows = []
    for name, words, nominal, e, positive in numbers:
        head = Markup("<code>{}</code>").format(name), words if words != name else "", number(nominal)
        if e is None:
            rows.append((*head, "–", "–", "", "not exercised"))
        else:
            rows.append((*head, estimate(e), interval(e), unit(e.unit), _change(nominal, e, positive=positive)))
    beside = " together with the findings" if d.findings else ""
    return table(columns, rows, f"The nominal model's numbers, as given and as identified{beside}")


def _positive(effect: str) -> set[str]:
    """Parameters of an effect that its law bounds to be positive."""
    return {spec.name for spec in effect_class(effect).specs() if spec.lower >= 0}


def _change(nominal: float | None, e: Estimate, *, positive: bool) -> Cell:
    """Relative change of a number; badges where one that is to be positive is not, or may be zero."""
    change = (e.value - nominal) / abs(nominal) if nominal else math.nan
    sign = "+" if change > 0 else "\N{MINUS SIGN}"
    told = "–" if not math.isfinite(change) else f"{sign}{percent(abs(change))}".replace(f"{sign}<", "<")
    if nominal is not None and e.ci95[0] <= nominal <= e.ci95[1]:
        told = "as nominal"
    if not positive:
        return told
    if e.ci95[1] < 0:
        return Markup("{} {}").format(told, badge("negative", "warn"))
    return Markup("{} {}").format(told, badge("not told from zero", "warn")) if weak(e) else told


def error_table(d: Diagnosis) -> Markup:
    """One row per model, with the error as a multiple of the noise and a bar on a logarithmic scale."""
    u = unit(d.unit)
    known = d.noise_floor > 0
    ahead = list(dict.fromkeys(s for f in d.fit.values() for s, _ in f.ahead))
    columns = [
        Column("Model"), Column(f"Error, estimation [{u}]", numeric=True), Column(f"Error, held out [{u}]", numeric=True),
        Column("of the spread, held out", numeric=True), *(Column(f"held out, {s:.3g} s ahead", numeric=True) for s in ahead),
        *([Column("× noise floor", numeric=True)] if known else []), Column("Held out, log scale"),
    ]  # fmt: skip
    engine = {f"{k} by the equations": d.surrogate[k] for k in _FILES if k in d.surrogate}
    # where nothing was added, the corrected model is the refitted one
    fits = {k: f for k, f in {**d.fit, **engine}.items() if k != "corrected" or d.findings or d.surrogate}
    share = _log_shares(d)
    rows: list[tuple[Cell, ...]] = []
    for key, f in fits.items():
        by_step = dict(f.ahead)
        name = NAMES.get(key, key) + (", in plain MuJoCo" if d.surrogate and key in _FILES else "")
        times = [number(f.held_out_rms / d.noise_floor, 3)] if known else []
        colour = key if key in NAMES else "measured"
        rows.append(
            (name, number(f.rms), number(f.held_out_rms), percent(f.held_out_nrmse, 3),
             *(number(by_step[s]) if s in by_step else "" for s in ahead), *times, bar(share(f), colour))
        )  # fmt: skip
    if known:
        rows.append(("noise floor", "", number(d.noise_floor), "", *("" for _ in ahead), "1", ""))
    chosen = [i for i, key in enumerate(fits) if key == "corrected"]
    return table(columns, rows, f"Errors in {d.channel}, rms. Held-out data took no part in the fits", chosen)


def _log_shares(d: Diagnosis) -> Any:
    """Length of the bar of a model: from 4 % for the least error (or the noise) to all for the greatest."""
    errors = [f.held_out_rms for f in d.fit.values() if math.isfinite(f.held_out_rms) and f.held_out_rms > 0]
    least = min([*errors, *([d.noise_floor] if d.noise_floor > 0 else [])], default=1.0)
    span = math.log(max(errors, default=1.0) / least) or 1.0

    def share(f: FitFigures) -> float:
        usable = f.held_out_rms > 0 and math.isfinite(f.held_out_rms)
        return 0.04 + 0.96 * math.log(f.held_out_rms / least) / span if usable else 0.0

    return share


def place_table(d: Diagnosis) -> Markup | None:
    """By place: the error that would have to act there; None when there is nothing to place."""
    if not d.mismatch.place:
        return None
    columns = [
        Column("Place"), Column("MJCF element"), Column("Size, rms", numeric=True), Column("Unit"),
        Column("Explained by one state", numeric=True), Column("Share"), Column("State"),
    ]  # fmt: skip
    rows = [
        (p.place, Markup("<code>{}</code>").format(p.element), number(p.rms),
         unit(d.unit if p.unit == "as the channel" else p.unit), percent(p.explained), bar(p.explained), p.by)
        for p in d.mismatch.place
    ]  # fmt: skip
    return table(
        columns, rows, "By place: the error that would have to act there, and the share of it that one variable explains. "
        "Signals alone may not tell places apart",
    )  # fmt: skip


def rival_tables(d: Diagnosis) -> tuple[Markup | None, Markup | None, int]:
    """The leading structures, the others, and how many others: by criterion; the nominal and the chosen one always lead."""
    if not d.rivals:
        return None, None, 0
    chosen = {f"{f.law}@{f.place}" for f in d.findings if f.kind == "physics"}
    ordered = sorted(d.rivals, key=lambda r: r.criterion if math.isfinite(r.criterion) else math.inf)
    mine = next((r for r in ordered if set(r.effects) == chosen), None)
    reference = (mine if mine is not None and math.isfinite(mine.criterion) else ordered[0]).criterion
    front = [i < HALVINGS[0][0] or r is mine or not r.effects for i, r in enumerate(ordered)]
    first = [r for r, leads in zip(ordered, front, strict=True) if leads]
    rest = [r for r, leads in zip(ordered, front, strict=True) if not leads]
    caption = "Rivals: every structure was fitted with all its numbers free; the criterion prices each number, less is better"
    return (
        _rivals(d, first, reference, mine, caption),
        _rivals(d, rest, reference, mine, "") if rest else None,
        len(rest),
    )


def _rivals(d: Diagnosis, rivals: Sequence[Rival], reference: float, mine: Rival | None, caption: str) -> Markup:
    u = unit(d.unit)
    columns = [
        Column("Structure"), Column("Free numbers", numeric=True), Column(f"Error, estimation [{u}]", numeric=True),
        Column(f"Error, held out [{u}]", numeric=True), Column("Criterion above chosen", numeric=True), Column("Fit"),
    ]  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for r in rivals:
        name: Cell = structure_name(r.effects)
        if r is mine:
            name = Markup("{} {}").format(name, badge("chosen", "info"))
        status = _STATUS.get(r.status, r.status.replace("_", " "))
        above = number(r.criterion - reference, 3)
        rows.append((name, str(r.n_parameters), number(r.rms), number(r.held_out_rms), above, status))
    return table(columns, rows, caption, [i for i, r in enumerate(rivals) if r is mine])


def refusal_table(refusals: Sequence[Refused]) -> Markup | None:
    """For each leading rival the test that refused it, what that test measured and what it asks for."""
    if not refusals:
        return None
    columns = [Column("Rival"), Column("Beside"), Column("Refused by"), Column("Measured", numeric=True, wide=True),
               Column("Needed", numeric=True, wide=True)]  # fmt: skip
    rows = []
    for r in refusals:
        limits = {"needed": "at least", "largest_p_value": "p at most"}
        measured = ", ".join(f"{k.replace('_', ' ')} {number(v, 3)}" for k, v in r.numbers.items() if k not in limits)
        needed = ", ".join(f"{word} {number(r.numbers[k], 3)}" for k, word in limits.items() if k in r.numbers)
        test = _TESTS.get(r.test, r.test.replace("_", " "))
        rows.append((structure_name(r.effects), structure_name(r.against), test, measured, needed))
    return table(columns, rows, "Refusals: why the leading rivals are not the answer")


def unexcited(d: Diagnosis) -> Markup | None:
    """What the excitation of the recordings does not show, with the reason; None when nothing was found."""
    lacking = [e for e in d.log.excitation if not e.identifiable] if d.log is not None else []
    if not lacking:
        return None
    rows = [(e.family, prose(e.sentence)) for e in lacking]
    caption = "Limits of the excitation: what these recordings do not move enough to be judged"
    return table([Column("Not shown"), Column("Why", wide=True)], rows, caption)


def recording_table(recordings: Sequence[Mapping[str, str]]) -> Markup | None:
    """Each file once, with its roles and its hash."""
    if not recordings:
        return None
    rows = [
        (Markup("{} {}").format(r["name"], Markup('<span class="muted">({})</span>').format(r["role"]) if r["role"] else ""),
         Markup("<code>{}</code>").format(r["sha256"]))
        for r in recordings
    ]  # fmt: skip
    return table([Column("Recording"), Column("SHA-256", wide=True)], rows)
