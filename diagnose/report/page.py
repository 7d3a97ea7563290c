"""A diagnosis -> ``report.html``: answer, plots, tables and the diff of the model, put together and written in one move."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path, PurePath
from shlex import quote
from typing import TYPE_CHECKING, Any

from diagnose.report import tables
from diagnose.report.answer import false_alarm, sentences, tiles
from diagnose.report.charts import explorer_of, map_chart, spectrum_chart, states_chart
from diagnose.report.document import document, write_page
from diagnose.report.figures import number, p_value, percent, prose, unit
from diagnose.report.film import Film, film_figure
from diagnose.report.plots import Chart, page_data
from diagnose.report.words import VERDICTS, effect_name, formula, placed, structure_name, where
from diagnose.result import Diagnosis, Finding
from mjsim.effects import effect_class

if TYPE_CHECKING:
    from markupsafe import Markup

__all__ = ["render_report", "write_report"]

_WEAK = 0.05
_LONG_DIFF = 80
_CARRIED = '<text name="simgap"'


def write_report(
    diagnosis: Diagnosis, path: Path, *, corrected_diff: str = "", truth: Mapping[str, Any] | None = None,
    film: Film | str | None = None,
) -> None:  # fmt: skip
    """Write the page.

    ``corrected_diff``: unified diff of ``corrected.xml`` to the nominal model. ``truth``: what was concealed, by the keys of the
    practice set (``effects``, ``where``, ``parameters``, ``linear_parameters``). ``film``: of the model, or why there is none.
    Nothing half-written is left under ``path``.
    """
    write_page(render_report(diagnosis, corrected_diff=corrected_diff, truth=truth, film=film), path)


def render_report(
    diagnosis: Diagnosis, *, corrected_diff: str = "", truth: Mapping[str, Any] | None = None, film: Film | str | None = None
) -> str:  # fmt: skip
    """The page as text; the same diagnosis gives the same bytes."""
    from jinja2 import Environment, StrictUndefined

    from diagnose.report import components

    d = diagnosis
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"number": number, "unit": unit, "percent": percent, "prose": prose}
    template = environment.from_string((files("diagnose.report") / "page.html.j2").read_text(encoding="utf-8"))
    charts, explorer = _charts(d), explorer_of(d)
    drawn = {key: components.chart_figure(chart, _CAPTIONS.get(key[0], "")) for key, chart in charts.items()}
    first, rest = sentences(d.summary)
    leading, others, count = tables.rival_tables(d)
    diff = _diff(corrected_diff)
    recordings = _recordings(d)
    body = template.render(
        d=d, verdict=VERDICTS[d.verdict], placed=placed(d), first=first, rest=rest, tiles=tiles(d), where=where(d), drawn=drawn,
        theme=components.theme_button(),
        explorer=components.explorer_section(
            explorer, "Recording and models", film_figure(film, explorer) if film is not None else None
        ) if explorer else None,
        halves=len({t.source for t in d.traces}) < len(d.traces), elsewhere=_elsewhere(d, drawn),
        places=tables.place_table(d) if placed(d) else None, findings=[_finding(f, d.unit) for f in d.findings],
        map=_map(d, drawn.get("map")), linear=tables.linear_table(d), errors=tables.error_table(d) if d.fit else None,
        horizons=any(f.ahead for f in d.fit.values()), rivals=leading, more_rivals=others, more=count,
        stretches=tables.stretch_table(d), conditioning=tables.conditioning_sentence(d),
        refusals=tables.refusal_table(d.refusals), unexcited=tables.unexcited(d), better=_better(d),
        failed=[(structure_name(tuple(k.split("+"))), why) for k, why in d.failed.items()], false_alarm=false_alarm(d),
        equivalents=[
            (effect_name(f.effect), f.place, [_with_error(f, e, d.unit) for e in f.equivalents])
            for f in d.findings
            if f.equivalents
        ],
        diff=diff, changes=tuple(sum(k == kind for k, _ in diff) for kind in ("add", "del")), diff_open=len(diff) <= _LONG_DIFF,
        truth=tables.truth_table(d, truth) if truth is not None else None, circumstances=_circumstances(truth),
        commands=_commands(d), recordings=recordings, provenance=tables.recording_table(recordings),
    )  # fmt: skip
    name = recordings[0]["name"] if recordings else "a recording"
    data = page_data(list(charts.values()), [explorer] if explorer else [])
    interactive = bool(charts) or explorer is not None
    return document(f"{VERDICTS[d.verdict].badge}: diagnosis of {name}", body, data if interactive else None)


_CAPTIONS = {
    "s": "Spectral densities. Shaded: the bands that hold most of the refitted nominal model's error above the noise, with their "
    "shares.",
    "n": "The torque that would have to act at the motor, beside the refitted nominal model, averaged over each state; band: "
    "two standard errors.",
    "m": "The torque that the map adds to the model; band: 95 %. It is drawn where the recordings come by; beyond the range of "
    "the data it keeps the value at the edge.",
}


def _charts(d: Diagnosis) -> dict[str, Chart]:
    """All charts by key: s0, s1, ... spectra and n0, n1, ... states of each recording, and the map; those that have data."""
    where_known = placed(d)
    torque = next((p.unit for p in d.mismatch.place if p.unit in ("N m", "N")), "N m")
    out: dict[str, Chart | None] = {}
    for i, m in enumerate(d.mismatches if where_known else d.mismatches[:1]):
        trace = next((t for t in d.traces if t.source == m.source), None)
        out[f"s{i}"] = spectrum_chart(d, m, trace, f"s{i}", bands=where_known or i > 0)
        if where_known:
            out[f"n{i}"] = states_chart(m.state, torque, f"n{i}")
    if d.map is not None:
        out["map"] = map_chart(d.map, "map")
    return {key: chart for key, chart in out.items() if chart is not None}


def _elsewhere(d: Diagnosis, drawn: Mapping[str, Markup]) -> list[dict[str, Any]]:
    """Where the mismatch is on further recordings: sentences and plots."""
    return [
        {
            "source": m.source,
            "role": m.role,
            "share": percent(d.shares()[i]),
            "where": where(d, m),
            "plots": [drawn[k] for k in (f"s{i}", f"n{i}") if k in drawn],
        }
        for i, m in enumerate(d.mismatches)
        if i and placed(d)
    ]


def _law(effect: str) -> tuple[str, str, str]:
    """(title, formula, citation) of an effect; empty for what stands on no registry (a map)."""
    try:
        cls = effect_class(effect)
    except KeyError:
        return "", "", ""
    title, _, law = (inspect.getdoc(sys.modules[cls.__module__]) or "").partition("\n\n")
    return " ".join(title.split()), law.strip(), cls.citation


def _with_error(f: Finding, equivalent: str, unit: str) -> str:
    """An equivalent of a finding by name, with its held-out error where it has one."""
    error = f.equivalent_errors.get(equivalent)
    name = structure_name((equivalent,))
    return name if error is None else f"{name} (held-out error {error:.4g} {unit})"


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
        "parameters": tables.parameter_table(f, about) if f.parameters else None,
        "weak": f.evidence.get("p_value", 0.0) > _WEAK,
        "evidence": _evidence(f, unit(channel_unit)),
        "more": [(k.replace("_", " "), number(v)) for k, v in f.evidence.items() if k not in known],
    }


def _map(d: Diagnosis, plot: Markup | None) -> dict[str, Any] | None:
    """The torque map: where, its plot, what it gains and what is fitted beside it."""
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
        "plot": plot,
        "gain": f"With it the held-out error is {number(m.held_out_error_after)} {u} rms instead of "
        f"{number(m.held_out_error_before)} {u} (p {_equals(m.p_value)}, over the maps that were tried). mapped.xml carries it.",
        "beside": beside,
    }


def _equals(p: float) -> str:
    text = p_value(p)
    return text if text.startswith("<") else f"= {text}"


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


def _better(d: Diagnosis) -> list[tuple[str, str]]:
    """(structure, held-out error) of rivals of a worse criterion that err materially less on the held-out data.

    Rivals are runs of the engine, and compared with the engine's run of the chosen structure. Those of a better criterion stand
    among the refusals.
    """
    chosen = {f"{f.law}@{f.place}" for f in d.findings if f.kind == "physics"}
    mine = next((r for r in d.rivals if set(r.effects) == chosen), None)
    if mine is None or not d.findings:
        return []
    ahead = [r for r in d.rivals if r.held_out_rms < 0.99 * mine.held_out_rms and r.criterion > mine.criterion]
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
        role = r.get("role", "")
        if key in out:
            out[key]["role"] += f" and {role}"
        else:
            out[key] = {"name": PurePath(r.get("file", "")).name, "sha256": r.get("sha256", ""), "role": role}
    return list(out.values())


def _commands(d: Diagnosis) -> list[str]:
    """How to replay what was found, and how to repeat the diagnosis."""
    names = [PurePath(r.get("file", "")).name for r in d.recordings]
    if not names:
        return []
    log = quote(f"./{names[-1]}" if names[-1].startswith("-") else names[-1])
    models = ["corrected.xml", *(["mapped.xml"] if d.map is not None else [])]
    return [f"simgap replay {model} {log} --out prediction.csv" for model in models]
