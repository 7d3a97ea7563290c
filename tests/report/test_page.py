"""The page: self-contained, complete for every verdict, right in its numbers, small and quick."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import re
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from outline import outline, words
from synthetic import DIFF, TRUTH, synthetic

from diagnose.report import write_report
from diagnose.report.charts import explorer_of
from diagnose.report.curves import envelope, worst_stretch
from diagnose.report.document import theme
from diagnose.report.figures import estimate, interval, number, p_value, percent, prose, unit
from diagnose.report.page import _commands, render_report
from diagnose.report.plots import page_data
from diagnose.report.static import VARIABLES
from diagnose.report.tables import linear_table
from diagnose.report.words import formula
from diagnose.result import Diagnosis, Estimate, FitFigures, Mismatch, NominalEffect, Rival, Traces, Verdict


@pytest.fixture(scope="module")
def diagnosis() -> Diagnosis:
    return synthetic()


@pytest.fixture(scope="module")
def page(diagnosis: Diagnosis, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "out" / "report.html"
    write_report(diagnosis, path, corrected_diff=DIFF, truth=TRUTH)
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]
    return path.read_text(encoding="utf-8")


def test_well_formed_self_contained_accessible(page: str) -> None:
    o = outline(page)
    assert len(o.ids) == len(set(o.ids))
    for tag, attributes in o.tags:
        assert tag not in ("link", "iframe", "object", "embed")
        assert "style" not in attributes
        assert not [name for name in attributes if name.startswith("on")]
        for name in ("src", "href", "xlink:href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:"))
        if tag == "svg":
            assert attributes.get("aria-label") or attributes.get("aria-hidden") == "true"
        if tag == "th":
            assert attributes["scope"] in ("col", "row")
        if tag in ("input", "select"):
            assert "data-choose" in attributes
    drawn = "".join(re.findall(r"<svg.*?</svg>", page, flags=re.S))
    assert not re.search(r"url\((?!#)|@import", drawn)
    assert set(re.findall(r'href="#([^"]+)"', drawn)) <= set(o.ids)
    assert set(re.findall(r"url\(#([^)]+)\)", drawn)) <= set(o.ids)
    assert {a["href"][1:] for t, a in o.tags if t == "a" and a.get("href")} <= set(o.ids)


def test_policy_allows_the_inline_elements_and_nothing_else(page: str) -> None:
    policy = next(a["content"] or "" for t, a in outline(page).tags if a.get("http-equiv") == "Content-Security-Policy")
    rules = {name: sources for name, *sources in (rule.split() for rule in policy.split(";"))}
    assert rules["default-src"] == rules["base-uri"] == rules["form-action"] == ["'none'"]
    for tag in ("script", "style"):
        texts = re.findall(rf"<{tag}(?![^>]*application/json)[^>]*>(.*?)</{tag}>", page, flags=re.S)
        hashes = [f"'sha256-{base64.b64encode(hashlib.sha256(x.encode()).digest()).decode()}'" for x in texts]
        assert rules[f"{tag}-src"] == hashes
    assert rules["img-src"] == rules["media-src"] == ["data:", "blob:"]


def test_plots_follow_the_theme(page: str) -> None:
    drawn = "".join(re.findall(r"<svg.*?</svg>", page, flags=re.S))
    assert not re.findall(r"#[0-9a-f]{6}\b", drawn)
    used = set(re.findall(r"\b([fs]-[a-z]+)\b", " ".join(re.findall(r'class="([^"]*)"', drawn))))
    assert used >= {"s-measured", "s-refitted", "s-corrected", "f-ink"}
    for name in VARIABLES:
        assert f"--{name}: light-dark(" in theme()
    for name in used:
        assert f".{name} {{" in theme()


def contrast(one: str, other: str) -> float:
    """Ratio of luminances of two colours #rrggbb (WCAG 2.2)."""

    def luminance(text: str) -> float:
        channels = [int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_contrast_is_that_of_wcag_aa(scheme: int) -> None:
    pairs = dict(re.findall(r"--([a-z-]+): (light-dark\([^)]*\))", theme()))
    colour = {name: re.findall(r"#[0-9a-f]{6}", text)[scheme] for name, text in pairs.items()}
    for name in ("ink", "muted", "corrected"):  # text and links
        for ground in ("paper", "panel"):
            assert contrast(colour[name], colour[ground]) >= 4.5, (name, ground)
    for name in ("good", "info", "warn", "alarm"):
        assert contrast(colour[name], colour[f"{name}-bg"]) >= 4.5, name
    for name in ("nominal", "refitted", "corrected", "mapped", "accent", "ink"):  # lines
        assert contrast(colour[name], colour["paper"]) >= 3.0, name


def test_says_what_where_how_sure(page: str, diagnosis: Diagnosis) -> None:
    text = words(page)
    for part in (
        re.sub(r"\s", " ", prose(diagnosis.summary)),
        "Missing physics",
        "= F sign(v), |τ f | ≤ F at v = 0",
        "C. A. Coulomb 1785",
        "0.09982 … 0.10044",
        "Presliding friction",
        "99.87",
        "Hysteresis (arm) : no start could be run".replace(" :", ":"),
        re.sub(r"\s", " ", prose(diagnosis.next_experiment or "")),
        "ab" * 32,
        "Seed 7",
        "simgap replay corrected.xml axis_held_out.csv",
        "✓ inside",
        "negative",
    ):
        assert part in text, part
    assert 'frictionloss="0.1001"' in text
    assert "None" not in text
    assert "nan" not in text.lower().split()


def test_recordings_are_counted_in_whole_numbers(page: str) -> None:
    assert "In 1 of 100 simulated recordings" in page


def test_small_quick_and_the_same_again(diagnosis: Diagnosis, tmp_path: Path, page: str) -> None:
    start = time.process_time()
    write_report(diagnosis, tmp_path / "report.html", corrected_diff=DIFF, truth=TRUTH)
    assert time.process_time() - start < 2.0
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == page


def test_twenty_seconds_at_two_kilohertz_stay_below_six_megabytes() -> None:
    page = render_report(synthetic(40_000), corrected_diff=DIFF)
    assert len(page.encode()) < 6_000_000


def test_long_recordings_are_thinned_to_the_samples_of_the_largest_errors(diagnosis: Diagnosis) -> None:
    explorer = explorer_of(diagnosis)
    assert explorer is not None
    whole, part = (page_data((), [explorer], budget) for budget in (1e9, 3e5))
    for full, thin, t in zip(*(x["explorers"]["recordings"]["recordings"] for x in (whole, part)), diagnosis.traces, strict=True):
        measured, refitted = (decoded(thin, *path) for path in (("measured",), ("models", "refitted")))
        assert thin["samples"] == len(decoded(full, "measured")) == len(t.time)
        assert len(measured) < 0.4 * len(t.time)
        error = t.measured - t.refitted
        assert np.max(measured - refitted) == pytest.approx(np.max(error), rel=1e-5)
        assert np.min(measured - refitted) == pytest.approx(np.min(error), rel=1e-5)
    assert len(json.dumps(part)) < 1.2 * 3e5


def decoded(recording: dict[str, Any], *path: str) -> np.ndarray:
    """A signal of the page's data."""
    for name in path:
        recording = recording[name]
    return np.frombuffer(base64.b64decode(recording["f"]), "<f4")


@pytest.mark.parametrize(
    "verdict",
    [pytest.param(v, marks=pytest.mark.slow if v in (Verdict.MISSING_PHYSICS, Verdict.PARAMETERS_ONLY) else ()) for v in Verdict],
)
def test_every_verdict_without_the_optional_parts(diagnosis: Diagnosis, verdict: Verdict, tmp_path: Path) -> None:
    one = diagnosis.traces[0]
    short = Traces(
        one.source,
        one.role,
        one.time[:400],
        one.measured[:400],
        None,
        one.refitted[:400],
        one.refitted[:400],
        one.counted[:400],
        float("nan"),
    )
    empty = Mismatch((), (), (), (), (np.empty(0),) * 4, 0.0, 0.0)
    bare = dataclasses.replace(
        diagnosis,
        verdict=verdict,
        findings=(),
        mismatch=empty,
        linear_parameters={},
        rivals=(),
        failed={},
        notes=(),
        next_experiment=None,
        traces=(short,),
        recordings=(),
        false_alarm={},
        versions={},
        noise_floor=float("nan"),
        gap_closed=float("nan"),
        fit={"refitted": FitFigures(0.1, 0.1, float("nan"), float("nan"))},
    )
    write_report(bare, tmp_path / "report.html")
    text = words((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "nan" not in text.split()
    assert "None" not in text


def test_unknown_map_and_hostile_names(diagnosis: Diagnosis, tmp_path: Path) -> None:
    finding = dataclasses.replace(diagnosis.findings[0], effect="torque_map", sentence="A map <b>not</b> a cause.", parameters={})
    marked = dataclasses.replace(
        diagnosis,
        findings=(finding,),
        traces=(dataclasses.replace(diagnosis.traces[0], source='<script>"x"&.csv'),),
        recordings=({"file": "<script>alert(1)</script>.csv", "sha256": "0"},),
    )
    write_report(marked, tmp_path / "report.html", truth={"effects": ["backlash"], "parameters": {"backlash": {"gap_rad": 1e-4}}})
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    tags = outline(page).tags
    assert len([t for t, _ in tags if t == "script"]) == len(re.findall(r"<script>|<script type=", page))
    assert "<script>alert" not in page
    assert '<script>"x"' not in page
    text = words(page)
    assert "A map <b>not</b> a cause." in text
    assert "missed" in text
    assert "invented" in text


def test_failure_leaves_nothing(diagnosis: Diagnosis, tmp_path: Path) -> None:
    diagnosis = dataclasses.replace(diagnosis, traces=())
    target = tmp_path / "report.html"
    target.mkdir()
    with pytest.raises(OSError, match="report"):
        write_report(diagnosis, target)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def plain(text: str) -> str:
    return text.replace("\N{NARROW NO-BREAK SPACE}", " ").replace("\N{MINUS SIGN}", "-")


@pytest.mark.parametrize(
    ("x", "text"),
    [
        (0.0, "0"),
        (1.0, "1.000"),
        (0.1, "0.1000"),
        (158413.99, "1.584 × 10⁵"),
        (4.5204e-4, "4.520 × 10⁻⁴"),
        (12345.6, "12 350"),
        (-62.0, "-62.00"),
        (0.99996, "1.000"),
        (float("nan"), "–"),
        (float("inf"), "∞"),
        (None, "–"),
        (99999.7, "1.000 × 10⁵"),
    ],
)
def test_numbers(x: float | None, text: str) -> None:
    assert plain(number(x)) == text


@pytest.mark.parametrize(
    ("e", "value", "bounds"),
    [
        (Estimate(0.10013, (0.09982, 0.10044), "N m"), "0.10013", "0.09982 … 0.10044"),
        (Estimate(4.5204e-4, (4.5e-4, 4.54e-4), "kg m^2"), "4.520 × 10⁻⁴", "4.500 × 10⁻⁴ … 4.540 × 10⁻⁴"),
        (Estimate(158413.9, (158000.0, 158800.0), "N m/rad"), "1.5841 × 10⁵", "1.5800 × 10⁵ … 1.5880 × 10⁵"),
        (Estimate(0.0, (-0.002, 0.002), "N m"), "0.00000", "-0.00200 … 0.00200"),
        (Estimate(3.0, (float("-inf"), float("inf")), "s"), "3.000", "not determined"),
        (Estimate(float("nan"), (float("nan"), float("nan")), "s"), "–", "not determined"),
    ],
)
def test_estimates_show_the_digits_of_their_interval(e: Estimate, value: str, bounds: str) -> None:
    assert plain(estimate(e)) == value
    assert plain(interval(e)) == bounds


def test_percent_and_units() -> None:
    assert plain(percent(0.99999)) == "99.99 %"
    assert plain(percent(0.9987)) == "99.87 %"
    assert plain(percent(0.72)) == "72 %"
    assert plain(percent(1.0)) == "100 %"
    assert plain(percent(0.00001)) == "< 0.01 %"
    assert percent(float("nan")) == "–"
    assert unit("N m s^2/rad^2") == "N·m·s²/rad²"
    assert unit("1/(N m)^2") == "1/(N·m)²"
    assert unit("1") == ""
    assert p_value(1e-30).startswith("< 10")


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("friction of 0.1001 N m, coefficient -849.6 N s^2/m^2", "friction of 0.1001 N·m, coefficient -849.6 N·s²/m²"),
        ("5 N m s/rad and 2 kg m^2; 1/(N m)^2", "5 N·m·s/rad and 2 kg·m²; 1/(N·m)²"),
        ("a stiffness of 8.998e+10 N m/rad^3, file2e+5x", "a stiffness of 8.998 × 10¹⁰ N·m/rad³, file2e+5x"),
        ("A non-zero N moving well - 95 % of it", "A non-zero N moving well - 95 % of it"),
    ],
)
def test_prose_prints_units(text: str, printed: str) -> None:
    assert plain(prose(text)).replace("\N{NO-BREAK SPACE}", " ") == printed


def test_formula() -> None:
    assert formula("tau_f = s z,  z' = v - s |v| z / F") == "τ<sub>f</sub> = s z,  z′ = v − s |v| z / F"
    assert formula("a < b^2 & c") == "a &lt; b<sup>2</sup> &amp; c"
    assert formula("on the body's own side") == "on the body’s own side"


def test_the_carried_text_is_told_in_one_line(diagnosis: Diagnosis, tmp_path: Path) -> None:
    diagnosis = dataclasses.replace(diagnosis, traces=())
    carried = DIFF + '+    <text name="simgap" data=\'{"version": 1,\n' + 40 * '+    "x": 1,\n' + "+    }'/>\n+  </custom>\n"
    write_report(diagnosis, tmp_path / "report.html", corrected_diff=carried)
    text = words((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "42 lines that simgap reads back" in text
    assert '"version"' not in text
    assert "</custom>" in text


def test_doubt_is_shown(diagnosis: Diagnosis, tmp_path: Path) -> None:
    rival = Rival(("backlash@gearbox",), 9, 0.06, 0.03, -40000.0, "budget")
    weak = dataclasses.replace(
        diagnosis.findings[0], evidence={"p_value": 0.12}, parameters={"torque_Nm": Estimate(1.0, (-1.0, 3.0), "N m")}
    )
    doubtful = dataclasses.replace(diagnosis, traces=(), findings=(weak,), rivals=(*diagnosis.rivals, rival))
    write_report(doubtful, tmp_path / "report.html")
    text = words((tmp_path / "report.html").read_text(encoding="utf-8"))
    for part in ("weak on held-out data", "not told from zero", "Backlash (gearbox) (0.03000 rad/s)", "stopped at its budget"):
        assert part in text, part
    assert "Less held-out error" not in words_of_sound(diagnosis, tmp_path)
    better = dataclasses.replace(rival, criterion=-50000.0)  # a better criterion: it stands among the refusals
    assert "Less held-out error" not in words_of_sound(
        dataclasses.replace(diagnosis, rivals=(*diagnosis.rivals, better)), tmp_path
    )


def test_a_phase_may_be_negative_and_a_torque_level_may_not(diagnosis: Diagnosis) -> None:
    estimates = {"torque_Nm": Estimate(-1.1, (-1.2, -1.0), "N m"), "phase_rad": Estimate(-1e-3, (-2e-3, -5e-4), "rad")}
    own = NominalEffect("gravity_load", "arm", "arm", {"torque_Nm": 1.0, "phase_rad": 0.0}, estimates)
    friction = {"torque_Nm": Estimate(-0.1, (-0.2, -0.05), "N m")}
    other = NominalEffect("coulomb_friction", "motor", "motor", {"torque_Nm": 0.1}, friction)
    sound = dataclasses.replace(diagnosis, linear_parameters={}, nominal_effects=(own, other))
    rows = str(linear_table(sound)).split("<tr")
    assert [("negative" in row) for row in rows if "phase_rad" in row] == [False]
    assert [("negative" in row) for row in rows if "Coulomb friction" in row] == [True]


def test_a_change_below_the_digits_has_no_sign(diagnosis: Diagnosis) -> None:
    near = {"Jm": Estimate(1.00000001, (1.000000005, 1.000000015), "kg m^2")}
    table = str(linear_table(dataclasses.replace(diagnosis, linear_parameters=near, nominal_parameters={"Jm": 1.0})))
    assert "&lt; 0.01" in table
    assert "+&lt;" not in table


def words_of_sound(diagnosis: Diagnosis, tmp_path: Path) -> str:
    write_report(dataclasses.replace(diagnosis, traces=()), tmp_path / "sound.html")
    return words((tmp_path / "sound.html").read_text(encoding="utf-8"))


def test_envelope_keeps_every_peak_and_gap() -> None:
    x = np.arange(10_000.0)
    y = np.zeros(10_000)
    y[4321], y[8765] = 7.0, -3.0
    y[2000:2500] = np.nan
    xe, ye = envelope(x, y, 500)
    assert len(xe) <= 1002
    assert np.all(np.diff(xe) >= 0)
    assert np.nanmax(ye) == 7.0
    assert np.nanmin(ye) == -3.0
    assert xe[np.nanargmax(ye)] == 4321
    assert np.any(np.isnan(ye))


def test_worst_stretch_holds_the_worst_error(diagnosis: Diagnosis) -> None:
    t = diagnosis.traces[0]
    s = worst_stretch(t.time, t.measured, t.refitted, t.counted)
    e2 = np.where(t.counted, (t.measured - t.refitted) ** 2, 0)
    assert 50 < s.stop - s.start <= len(t.time) // 5
    assert np.mean(e2[s]) > 2 * np.mean(e2)


@pytest.mark.parametrize(
    ("name", "quoted"),
    [("log.csv", "log.csv"), ("a b;rm -rf $HOME.csv", "'a b;rm -rf $HOME.csv'"), ("-rf.csv", "./-rf.csv"),
     ("it's.csv", "'it'\"'\"'s.csv'")],
)  # fmt: skip
def test_a_suggested_command_can_be_pasted_into_a_shell(name, quoted):
    d = SimpleNamespace(recordings=[{"file": f"logs/{name}"}], map=object())
    assert _commands(d) == [f"simgap replay {m}.xml {quoted} --out prediction.csv" for m in ("corrected", "mapped")]
    assert _commands(SimpleNamespace(recordings=[], map=None)) == []
