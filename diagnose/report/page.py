"""A diagnosis -> ``report.html``: the pictures, the tables and the template put together, written in one move."""

from __future__ import annotations

import inspect
import math
import os
import sys
import tempfile
from collections.abc import Mapping
from functools import partial
from importlib.resources import files
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from diagnose.report import pictures
from diagnose.report.curves import psd
from diagnose.report.figures import estimate, interval, number, p_value, percent, prose, unit
from diagnose.report.render_worker import Draw, Picture, draw_here
from diagnose.report.truth import truth_rows
from diagnose.report.words import VERDICTS, effect_name, formula, linear_name, placed, structure_name, where
from diagnose.result import Diagnosis, Estimate, Finding, Mismatch, Rival, Traces
from mjsim.effects import effect_class

if TYPE_CHECKING:
    from markupsafe import Markup

__all__ = ["render_report", "write_report"]

_SHOWN_RIVALS = 8
_MOST_TRACES = 4
_WEAK = 0.05
_LONG_DIFF = 80
_CARRIED = '<text name="simgap"'


def write_report(
    diagnosis: Diagnosis,
    path: Path,
    *,
    corrected_diff: str = "",
    truth: Mapping[str, Any] | None = None,
    draw: Draw = draw_here,
) -> None:
    """Write the page.

    ``corrected_diff``: unified diff of ``corrected.xml`` to the nominal model. ``truth``: what was concealed, by the keys of the
    practice set (``effects``, ``where``, ``parameters``, ``linear_parameters``). ``draw``: who draws, one picture after the other
    or `Drawers`. Nothing half-written is left under ``path``.
    """
    text = render_report(diagnosis, corrected_diff=corrected_diff, truth=truth, draw=draw)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, scratch = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as out:
            out.write(text)
        os.chmod(scratch, 0o644)
        os.replace(scratch, path)
    except BaseException:
        Path(scratch).unlink(missing_ok=True)
        raise


def render_report(
    diagnosis: Diagnosis, *, corrected_diff: str = "", truth: Mapping[str, Any] | None = None, draw: Draw = draw_here
) -> str:
    """The page as text."""
    from jinja2 import Environment, StrictUndefined

    here = files("diagnose.report")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"number": number, "unit": unit, "percent": percent, "prose": prose}
    template = environment.from_string((here / "page.html.j2").read_text(encoding="utf-8"))
    d = diagnosis
    shown, hidden = _rivals(d)
    drawn = _drawn(d, draw)
    return template.render(
        d=d,
        css=(here / "page.css").read_text(encoding="utf-8"),
        verdict=VERDICTS[d.verdict],
        placed=placed(d),
        tiles=_tiles(d),
        where=where(d),
        drawn=_shown(d, drawn),
        findings=[_finding(f, d.unit) for f in d.findings],
        map=_map(d, drawn.get("map")),
        linear=_linear(d),
        fits=_fits(d),
        horizons=list(dict.fromkeys(s for f in d.fit.values() for s, _ in f.ahead)),
        rivals=shown,
        more_rivals=hidden,
        better=_better(d),
        failed=[(structure_name(tuple(k.split("+"))), why) for k, why in d.failed.items()],
        false_alarm=_false_alarm(d),
        equivalents=[
            (effect_name(f.effect), f.place, [structure_name((e,)) for e in f.equivalents]) for f in d.findings if f.equivalents
        ],
        diff=_diff(corrected_diff),
        changes=tuple(sum(k == kind for k, _ in _diff(corrected_diff)) for kind in ("add", "del")),
        diff_open=len(_diff(corrected_diff)) <= _LONG_DIFF,
        truth=truth_rows(d, truth) if truth is not None else None,
        circumstances=_circumstances(truth),
        commands=_commands(d),
        recordings=_recordings(d),
        halves=len({t.source for t in d.traces}) < len(d.traces),
    )


def _false_alarm(d: Diagnosis) -> str:
    """How often physics is named where none is missing, in one sentence; empty where it was not measured."""
    a = d.false_alarm
    if not a:
        return ""
    return (
        f"In {a['alarms']:.0f} of {a['recordings']:.0f} simulated recordings with nothing missing, physics was named "
        f"all the same: {percent(a['share'])} (95 % interval {percent(a['low'])} to {percent(a['high'])})."
    )


def _tiles(d: Diagnosis) -> list[tuple[str, str, str]]:
    """(figure, what it is, detail) for the head of the page."""
    u = unit(d.unit)
    before, after = d.fit.get("refitted"), d.fit.get("corrected")
    out: list[tuple[str, str, str]] = []
    if d.findings and before and after:
        detail = f"{number(before.held_out_rms, 3)} → {number(after.held_out_rms, 3)} {u} rms on held-out data"
        what = "of the error above the noise removed" if d.noise_floor > 0 else "of the error removed"
        out.append((percent(d.gap_closed), what, detail))
    best = after or before
    if best and d.noise_floor > 0 and math.isfinite(best.held_out_rms):
        detail = f"{number(best.held_out_rms, 3)} against {number(d.noise_floor, 3)} {u} rms on held-out data"
        out.append((f"{number(best.held_out_rms / d.noise_floor, 3)} ×", "the noise: remaining error", detail))
    worst = max((f.evidence["p_value"] for f in d.findings if "p_value" in f.evidence), default=None)
    if worst is not None:
        tested = max((f.evidence.get("hypotheses", 0) for f in d.findings), default=0)
        detail = "chance of such a gain on held-out data with nothing missing, corrected for " + (
            f"{tested:.0f} hypotheses" if tested else "all hypotheses"
        )
        out.append((p_value(worst), "p-value" + ("" if len(d.findings) == 1 else ", weakest finding"), detail))
    else:
        others = sum(bool(r.effects) for r in d.rivals)
        what = "richer structure fitted" if others == 1 else "richer structures fitted"
        detail = "none paid on held-out data" if others else "none promised a gain worth a fit"
        detail += f", of {d.hypotheses} hypotheses" if d.hypotheses else ""
        out.append((f"{others}", what, detail))
    return out


def _chosen(d: Diagnosis) -> tuple[list[Traces], list[Traces]]:
    """The traces that are drawn and those that are left out, estimation recordings first."""
    roles = sorted(d.traces, key=lambda t: t.role != "estimation")
    chosen = [t for t in roles if t.role == "estimation"][: _MOST_TRACES - 1]
    chosen += [t for t in roles if t.role != "estimation"][: _MOST_TRACES - len(chosen)]
    return chosen, [t for t in roles if t not in chosen]


def _drawn(d: Diagnosis, draw: Draw) -> dict[str, Markup]:
    """All pictures as SVG text, by the name that their ids begin with; what there is nothing to draw for is left out."""
    from markupsafe import Markup

    found, noise, where_known = bool(d.findings), d.noise_floor > 0, placed(d)
    torque = "N m" if not d.mismatch.place else next((p.unit for p in d.mismatch.place if p.unit in ("N m", "N")), "N m")
    chosen, _ = _chosen(d)
    wanted: dict[str, Picture] = {
        f"t{i}": partial(pictures.time, t, d.channel, d.unit, found, noise, f"t{i}") for i, t in enumerate(chosen)
    }
    for i, m in enumerate(d.mismatches if where_known else d.mismatches[:1]):
        trace = next((t for t in d.traces if t.source == m.source), None) if i else next(iter(chosen), None)
        left = _density_left(m, trace) if found else None
        shaded = where_known or i > 0
        wanted[f"s{i}"] = partial(pictures.spectrum, m, left, d.channel, d.unit, f"s{i}", bands=shaded)
        if where_known:
            wanted[f"m{i}"] = partial(pictures.states, m.state, torque, f"m{i}")
    if d.map is not None:
        wanted["map"] = partial(pictures.torque_map, d.map, "map")
    return {k: Markup(svg) for k, svg in zip(wanted, draw(list(wanted.values())), strict=True) if svg}


def _density_left(m: Mismatch, t: Traces | None) -> np.ndarray | None:
    """Spectral density of what the corrected model leaves, at the frequencies of the mismatch's spectrum."""
    bins = len(m.spectrum[0])
    density = psd(t.measured - t.corrected, float(np.median(np.diff(t.time))), bins) if t is not None else None
    return density[1] if density is not None and len(density[1]) == bins else None


def _shown(d: Diagnosis, drawn: Mapping[str, Markup]) -> dict[str, Any]:
    """The pictures in their places, with what stands under them."""
    chosen, left_out = _chosen(d)
    return {
        "time": [(t.source, t.role, drawn[f"t{i}"]) for i, t in enumerate(chosen)],
        "left_out": [t.source for t in left_out],
        "spectrum": drawn.get("s0"),
        "states": drawn.get("m0"),
        "others": [_elsewhere(d, i, drawn) for i in range(1, len(d.mismatches))] if placed(d) else [],
        "sigma": d.noise_floor > 0,
    }


def _elsewhere(d: Diagnosis, index: int, drawn: Mapping[str, Markup]) -> dict[str, Any]:
    """Where the mismatch is on a further recording: sentences and pictures."""
    m = d.mismatches[index]
    return {
        "source": m.source,
        "role": m.role.replace("_", " "),
        "share": percent(d.shares()[index]),
        "where": where(d, m),
        "pictures": [drawn[k] for k in (f"s{index}", f"m{index}") if k in drawn],
    }


def _law(effect: str) -> tuple[str, str, str]:
    """(title, formula, citation) of an effect; empty for what stands on no registry (a map)."""
    try:
        cls = effect_class(effect)
    except KeyError:
        return "", "", ""
    title, _, law = (inspect.getdoc(sys.modules[cls.__module__]) or "").partition("\n\n")
    return " ".join(title.split()), law.strip(), cls.citation


def _finding(f: Finding, channel_unit: str) -> dict[str, Any]:
    from markupsafe import Markup

    title, law, citation = _law(f.law)
    about = {s.name: s.about for s in effect_class(f.law).specs()} if title else {}
    known = ("held_out_error_before", "held_out_error_after", "p_value", "hypotheses", "delta_chi2", "p_value_estimation")
    return {
        "finding": f,
        "name": effect_name(f.effect),
        "title": title,
        "formula": Markup(formula(law)),
        "citation": citation,
        "parameters": [
            (name, about.get(name, ""), *_estimated(e), _weak(e) and not name.startswith("phase"))
            for name, e in f.parameters.items()
        ],
        "weak": f.evidence.get("p_value", 0.0) > _WEAK,
        "evidence": _evidence(f, unit(channel_unit)),
        "more": [(k.replace("_", " "), number(v)) for k, v in f.evidence.items() if k not in known],
    }


def _map(d: Diagnosis, svg: Markup | None) -> dict[str, Any] | None:
    """The torque map: where, its picture, what it gains and what is fitted beside it."""
    m = d.map
    if m is None:
        return None
    u = unit(d.unit)
    kept = ", ".join(f"{effect_name(e.id)} ({e.place})" for e in m.effects)
    dropped = [f for f in d.findings if (f.effect, f.place) not in {(e.name(), e.place) for e in m.effects}]
    beside = f"Fitted beside it: {kept}." if kept else "Fitted beside it: the nominal model's own numbers only."
    if dropped:
        beside += " It does without " + ", ".join(f"{effect_name(f.effect)} ({f.place})" for f in dropped)
        beside += ", which may have stood in for what is mapped."
    return {
        "where": f"{'in' if m.effect.coupling else 'at'} the {m.effect.place}",
        "element": m.element,
        "sentence": m.sentence,
        "svg": svg,
        "gain": f"With it the held-out error is {number(m.held_out_error_after)} {u} rms instead of "
        f"{number(m.held_out_error_before)} {u} (p {_equals(m.p_value)}, over the maps that were tried). mapped.xml carries it.",
        "beside": beside,
    }


def _equals(p: float) -> str:
    text = p_value(p)
    return text if text.startswith("<") else f"= {text}"


def _weak(e: Estimate) -> bool:
    """Whether the interval reaches as far as the value: the data hardly say that there is any."""
    low, high = e.ci95
    return not (math.isfinite(low) and math.isfinite(high)) or low <= 0 <= high


def _estimated(e: Estimate) -> tuple[str, str, str]:
    return estimate(e), interval(e), unit(e.unit)


def _evidence(f: Finding, u: str) -> str:
    """The evidence for a finding as a sentence."""
    e, parts = f.evidence, []
    before, after = e.get("held_out_error_before"), e.get("held_out_error_after")
    if before is not None and after is not None:
        times = f", {number(before / after, 3)} times less" if after > 0 and before / after > 1.05 else ""
        parts.append(
            f"Without it the model misses the held-out data by {number(before)} {u} rms, with it by {number(after)} {u}{times}."
        )
    if "p_value" in e:
        tested = f" after correction for {e['hypotheses']:.0f} hypotheses" if "hypotheses" in e else ""
        parts.append(f"Probability of such a gain by chance: {p_value(e['p_value'])}{tested}.")
    if "delta_chi2" in e:
        chance = f" (p {_equals(e['p_value_estimation'])})" if "p_value_estimation" in e else ""
        parts.append(f"On the estimation data it takes {number(e['delta_chi2'], 3)} off the whitened chi-square{chance}.")
    return " ".join(parts)


def _linear(d: Diagnosis) -> list[dict[str, Any]]:
    rows = []
    numbers: list[tuple[str, str, float | None, Estimate | None]] = [
        (name, linear_name(name, e.unit), d.nominal_parameters.get(name), e) for name, e in d.linear_parameters.items()
    ]
    numbers += [
        (name, f"{effect_name(n.effect)}, {n.place}", nominal, n.parameters.get(name))
        for n in d.nominal_effects for name, nominal in n.nominal.items()
    ]  # fmt: skip
    for name, words, nominal, e in numbers:
        if e is None:
            unused = {"value": "–", "interval": "–", "unit": "", "change": "not exercised", "negative": False, "weak": False}
            rows.append({"name": name, "words": words, "nominal": number(nominal), **unused})
            continue
        change = (e.value - nominal) / abs(nominal) if nominal else math.nan
        value, bounds, u = _estimated(e)
        inside = nominal is not None and e.ci95[0] <= nominal <= e.ci95[1]
        sign = "+" if change > 0 else "\N{MINUS SIGN}"
        rows.append(
            {
                "name": name,
                "words": words,
                "nominal": number(nominal),
                "value": value,
                "interval": bounds,
                "unit": u,
                "change": "–" if not math.isfinite(change) else "as nominal" if inside else f"{sign}{percent(abs(change))}",
                "negative": e.ci95[1] < 0,
                "weak": _weak(e),
            }
        )
    return rows


_FILES = ("nominal", "corrected")  # whose errors are those of the files, as MuJoCo steps them
_FIT_WORDS = {
    "nominal": "nominal, as given",
    "refitted": "nominal, refitted",
    "corrected": "corrected",
    "mapped": "with the torque map",
}


def _fits(d: Diagnosis) -> list[dict[str, Any]]:
    """One row per model, with the error as a multiple of the noise floor and the length of its bar (log scale)."""
    rows = []
    errors = [f.held_out_rms for f in d.fit.values() if math.isfinite(f.held_out_rms) and f.held_out_rms > 0]
    floor = d.noise_floor if d.noise_floor > 0 else math.nan
    least = min([*errors, *([floor] if floor > 0 else [])], default=1.0)
    span = math.log(max(errors, default=1.0) / least) or 1.0
    engine = {f"{k} by the equations": d.surrogate[k] for k in _FILES if k in d.surrogate}
    for key, f in {**d.fit, **engine}.items():
        if key == "corrected" and not d.findings and not d.surrogate:
            continue  # nothing was added: it is the refitted one
        bar = 4 + 96 * math.log(f.held_out_rms / least) / span if f.held_out_rms > 0 and math.isfinite(f.held_out_rms) else 0
        rows.append(
            {
                "key": key,
                "name": _FIT_WORDS.get(key, key) + (", in plain MuJoCo" if d.surrogate and key in _FILES else ""),
                "fit": f,
                "ahead": dict(f.ahead),
                "times": number(f.held_out_rms / floor, 3) if floor > 0 else "–",
                "bar": round(bar, 1),
            }
        )
    return rows


def _rivals(d: Diagnosis) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Sorted by criterion; the first ones, the nominal and the chosen structure among them, and the rest."""
    chosen = {f"{f.law}@{f.place}" for f in d.findings if f.kind == "physics"}

    def key(r: Rival) -> float:
        return r.criterion if math.isfinite(r.criterion) else math.inf

    ordered = sorted(d.rivals, key=key)
    mine = next((r for r in ordered if set(r.effects) == chosen), None)
    reference = mine.criterion if mine is not None and math.isfinite(mine.criterion) else key(ordered[0]) if ordered else 0.0
    rows: list[dict[str, Any]] = [
        {
            "rival": r,
            "name": structure_name(r.effects),
            "above": number(r.criterion - reference, 3),
            "chosen": r is mine,
            "status": _STATUS.get(r.status, r.status.replace("_", " ")),
        }
        for r in ordered
    ]
    front = {i for i, row in enumerate(rows) if i < _SHOWN_RIVALS or row["chosen"] or not row["rival"].effects}
    return [row for i, row in enumerate(rows) if i in front], [row for i, row in enumerate(rows) if i not in front]


def _better(d: Diagnosis) -> list[tuple[str, str]]:
    """(structure, held-out error) of rivals that were not chosen although they err materially less on the held-out data."""
    best = d.fit.get("corrected")
    if best is None or not d.findings:
        return []
    chosen = {f"{f.law}@{f.place}" for f in d.findings if f.kind == "physics"}
    ahead = [r for r in d.rivals if set(r.effects) != chosen and r.held_out_rms < 0.99 * best.held_out_rms]
    return [(structure_name(r.effects), number(r.held_out_rms)) for r in sorted(ahead, key=lambda r: r.held_out_rms)[:3]]


def _diff(text: str) -> list[tuple[str, str]]:
    """(kind, line) of a unified diff; what the file carries for simgap alone is told in one line."""
    kinds = {"+": "add", "-": "del", "@": "at"}
    out: list[tuple[str, str]] = []
    carried = 0
    for line in text.rstrip("\n").splitlines():
        if carried or _CARRIED in line:
            carried += 1
            if line.rstrip().endswith("/>"):
                out.append(("same", f" … {carried} lines that simgap reads back …"))
                carried = 0
            continue
        out.append(("head" if line.startswith(("---", "+++")) else kinds.get(line[:1], "same"), line))
    return out


_QUANTITIES = {"_rad_s": "rad/s", "_Nm": "N·m", "_rad": "rad", "_s": "s", "_Hz": "Hz"}


def _plain(key: str) -> str:
    """``noise_rms_rad_s`` -> ``noise rms [rad/s]``."""
    for tail, u in _QUANTITIES.items():
        if key.endswith(tail):
            return f"{key.removesuffix(tail).replace('_', ' ')} [{u}]"
    return key.replace("_", " ")


def _circumstances(truth: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """What else is known of a concealed case: noise, excitation, loop."""
    if truth is None:
        return []
    plain = {k: v for k, v in truth.items() if isinstance(v, str | bool | int | float)}
    words = {True: "yes", False: "no"}
    return [
        (_plain(k), words[v] if isinstance(v, bool) else number(float(v)) if isinstance(v, int | float) else v)
        for k, v in plain.items()
    ]


def _recordings(d: Diagnosis) -> list[dict[str, str]]:
    """Each file once, with all its roles."""
    out: dict[str, dict[str, str]] = {}
    for r in d.recordings:
        key = r.get("sha256") or r.get("file", "")
        role = r.get("role", "").replace("_", " ")
        if key in out:
            out[key]["role"] += f" and {role}"
        else:
            out[key] = {"name": PurePath(r.get("file", "")).name, "sha256": r.get("sha256", ""), "role": role}
    return list(out.values())


_STATUS = {"budget": "stopped at its budget", "stalled": "stalled: rough cost", "failed": "could not be run"}


def _commands(d: Diagnosis) -> list[str]:
    """How to replay what was found, and how to repeat the diagnosis."""
    names = [PurePath(r.get("file", "")).name for r in d.recordings]
    if not names:
        return []
    models = ["corrected.xml", *(["mapped.xml"] if d.map is not None else [])]
    return [f"simgap replay {model} {names[-1]} --out prediction.csv" for model in models]
