"""The page: self-contained, complete for every verdict, right in its numbers, small and quick."""

from __future__ import annotations

import dataclasses
import html.parser
import re
import time
from pathlib import Path

import numpy as np
import pytest

from diagnose.report import write_report
from diagnose.report.curves import envelope, worst_stretch
from diagnose.report.figures import estimate, interval, number, p_value, percent, prose, unit
from diagnose.report.words import formula
from diagnose.result import Diagnosis, Estimate, Finding, FitFigures, Mismatch, Place, Rival, Share, StateShare, Traces, Verdict
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate

DT = 5e-4
NOISE = 0.05
TRUTH = {
    "effects": ["coulomb_friction"],
    "where": {},
    "parameters": {"coulomb_friction": {"torque_Nm": 0.1}},
    "linear_parameters": {"Jm": 4.56e-4},
    "closed_loop": False,
    "velocity_noise_rms_rad_s": NOISE,
}
DIFF = """--- robot_axis1.xml
+++ corrected.xml
@@ -52,3 +52,3 @@
     <body name="motor_rotor" pos="-0.42 0 0.36">
-      <joint name="motor" damping="0.0355" frictionloss="0"/>
+      <joint name="motor" damping="0.0351" frictionloss="0.1001"/>
       <inertial pos="0 0 0" mass="1" diaginertia="2.28e-4 2.28e-4 2.28e-4"/>
"""


def traces(samples: int, role: str, rng: np.random.Generator) -> Traces:
    axis = load_axis(shipped_model("robot_axis1"))
    t = DT * np.arange(samples)
    u = 1.2 * np.sin(2 * np.pi * (0.5 * t + 0.4 * t**2))
    coulomb = effect_class("coulomb_friction")(torque_Nm=0.1)
    corrected = np.array(simulate(axis + coulomb, u, DT).velocity)
    # what a linear fit would do: more viscous friction in place of the missing dry one
    refitted = np.array(simulate(axis.with_linear({"fm": 0.045}), u, DT).velocity)
    counted = np.ones(samples, bool)
    counted[samples // 2 : samples // 2 + samples // 20] = False
    noisy = corrected + NOISE * rng.standard_normal(samples)
    return Traces(
        f"axis_{role}.csv", role, t, noisy, np.array(simulate(axis, u, DT).velocity), refitted, corrected, counted, NOISE
    )


def synthetic(samples: int = 20_000) -> Diagnosis:
    from scipy.signal import welch

    rng = np.random.default_rng(3)
    one, two = traces(samples, "estimation", rng), traces(samples, "held_out", rng)
    e = one.measured - one.refitted
    f, pe = welch(e, 1 / DT, nperseg=2048, detrend=False)
    _, py = welch(one.measured, 1 / DT, nperseg=2048)
    v = np.linspace(-30, 30, 24)
    before, after = (float(np.sqrt(np.mean((two.measured - y) ** 2))) for y in (two.refitted, two.corrected))
    state = (
        StateShare("velocity", "rad/s", 0.931, v, -0.1 * np.tanh(v), np.full(24, 0.004)),
        StateShare("torque command", "N m", 0.62, v / 25, -0.08 * np.tanh(v / 8), np.full(24, 0.006)),
        StateShare(
            "phase of order 4 of the angle",
            "rad",
            0.011,
            np.linspace(0, 6.2, 24),
            0.01 * rng.standard_normal(24),
            np.full(24, 0.01),
        ),
        StateShare("time", "s", 0.0, np.empty(0), np.empty(0), np.empty(0)),
    )
    finding = Finding(
        "coulomb_friction",
        "motor",
        "motor",
        "Dry (Coulomb) friction of 0.1001 N m at the motor: a constant torque against the motion that also holds it at rest.",
        {"torque_Nm": Estimate(0.10013, (0.09982, 0.10044), "N m")},
        {
            "held_out_error_before": before,
            "held_out_error_after": after,
            "p_value": 3.1e-14,
            "delta_chi2": 81234.0,
            "hypotheses": 63.0,
        },
        ("presliding_friction@motor",),
    )
    rivals = [
        Rival(("coulomb_friction@motor",), 9, 0.0501, after, -41234.5, "converged"),
        Rival((), 8, 0.31, before, 8123.2, "converged"),
        *(
            Rival((f"{k}@motor",), 10, 0.0501 + 0.01 * i, after + 0.01 * i, -41000.0 + 900 * i, "converged")
            for i, k in enumerate(
                (
                    "stribeck_friction",
                    "presliding_friction",
                    "asymmetric_friction",
                    "static_friction",
                    "friction_drift",
                    "quadratic_friction",
                    "torque_ripple",
                    "torque_offset",
                    "load_dependent_friction",
                )
            )
        ),
        Rival(("torque_ripple@motor", "backlash@gearbox"), 12, float("nan"), float("nan"), float("inf"), "diverged"),
    ]
    nominal = {p.name: p.value for p in load_axis(shipped_model("robot_axis1")).chain.linear_parameters()}
    units = {p.name: p.quantity.unit() for p in load_axis(shipped_model("robot_axis1")).chain.linear_parameters()}
    linear = {
        k: Estimate(1.01 * x, (1.005 * x, 1.015 * x) if x > 0 else (1.015 * x, 1.005 * x), units[k]) for k, x in nominal.items()
    }
    return Diagnosis(
        verdict=Verdict.MISSING_PHYSICS,
        summary="The simulation leaves out dry friction of 0.1001 N m at the motor; with it the error falls to the noise.",
        findings=(finding,),
        mismatch=Mismatch(
            (Share(0.0, 0.5, 0.21), Share(0.5, 1.0, 0.14), Share(4.0, 4.5, 0.11)),
            (Share(0.98, 3.9, 0.71), Share(8.8, 11.7, 0.12)),
            state,
            (
                Place("motor", "motor", 0.098, "N m", 0.931, "velocity"),
                Place("sensor", "motor_velocity", 0.31, "as the channel", 0.22, "time"),
            ),
            (f, pe, np.full_like(f, NOISE**2 * 2 * DT), py),
            0.972,
            0.08,
        ),
        linear_parameters=linear,
        nominal_parameters=nominal,
        fit={
            "nominal": FitFigures(0.62, 0.05, 0.66, 0.05),
            "refitted": FitFigures(0.31, 0.02, before, 0.02),
            "corrected": FitFigures(0.0501, 0.004, after, 0.004),
        },
        noise_floor=NOISE,
        gap_closed=0.9987,
        rivals=tuple(rivals),
        failed={"hysteresis@arm": "no start could be run"},
        notes=("The damping of the gearbox is negative, in the nominal model and as identified: unphysical.",),
        next_experiment="A multisine of 0.3 N m between 0.5 and 20 Hz, for 20 s, would tell presliding from Coulomb friction.",
        channel="velocity",
        unit="rad/s",
        view="motion",
        traces=(one, two),
        recordings=({"file": "axis_estimation.csv", "sha256": "ab" * 32}, {"file": "axis_held_out.csv", "sha256": "cd" * 32}),
        seed=7,
        seconds=21.3,
        versions={"simgap": "0.1.0", "mujoco": "4.0.0"},
        false_alarm={"share": 0.01, "low": 0.001, "high": 0.04, "alarms": 1.0, "recordings": 100.0},
    )


@pytest.fixture(scope="module")
def diagnosis() -> Diagnosis:
    return synthetic()


@pytest.fixture(scope="module")
def page(diagnosis: Diagnosis, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "out" / "report.html"
    write_report(diagnosis, path, corrected_diff=DIFF, truth=TRUTH)
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]
    return path.read_text(encoding="utf-8")


class Outline(html.parser.HTMLParser):
    """Tags that are not closed in order, ids, and text."""

    VOID = frozenset(("meta", "br", "img", "link", "hr", "input"))

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self.ids += [v for k, v in attrs if k == "id" and v]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self.ids += [v for k, v in attrs if k == "id" and v]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def outline(page: str) -> Outline:
    o = Outline()
    o.feed(page)
    assert o.open == []
    return o


def words(page: str) -> str:
    return re.sub(r"\s+", " ", " ".join(outline(page).text))


def test_well_formed_self_contained_accessible(page: str) -> None:
    o = outline(page)
    assert len(o.ids) == len(set(o.ids))
    for tag, attributes in o.tags:
        assert tag not in ("script", "link", "iframe")
        for name in ("src", "href", "xlink:href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:"))
        if tag == "svg":
            assert attributes["aria-label"]
        if tag == "th":
            assert attributes["scope"] in ("col", "row")
    assert not re.search(r"url\((?!#)|@import", page)
    assert re.findall(r'href="#([^"]+)"', page)
    assert set(re.findall(r'href="#([^"]+)"', page)) <= set(o.ids)
    assert set(re.findall(r"url\(#([^)]+)\)", page)) <= set(o.ids)


def test_pictures_follow_the_theme(page: str) -> None:
    drawn = "".join(re.findall(r"<svg.*?</svg>", page, flags=re.S))
    assert not re.findall(r"#[0-9a-f]{6}\b", drawn)
    used = set(re.findall(r"var\(--([a-z]+)\)", drawn))
    styles = re.search(r"<style>(.*?)</style>", page, flags=re.S)
    assert styles is not None
    assert "prefers-color-scheme: dark" in styles[1]
    for name in used:
        assert len(re.findall(rf"--{name}:", styles[1])) >= 2


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


def test_small_and_quick(diagnosis: Diagnosis, tmp_path: Path, page: str) -> None:
    start = time.perf_counter()
    write_report(diagnosis, tmp_path / "report.html", corrected_diff=DIFF, truth=TRUTH)
    assert time.perf_counter() - start < 4.0  # two on a free core
    assert (tmp_path / "report.html").stat().st_size < 1_000_000
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == page


@pytest.mark.parametrize("verdict", list(Verdict))
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
    assert "<script" not in page
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
    s = worst_stretch(t)
    e2 = np.where(t.counted, (t.measured - t.refitted) ** 2, 0)
    assert 50 < s.stop - s.start <= len(t.time) // 5
    assert np.mean(e2[s]) > 2 * np.mean(e2)
