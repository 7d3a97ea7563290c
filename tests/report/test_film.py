"""The film of a page: which stretch, why there is none, and that it follows the slider."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import opened
from synthetic import DT, synthetic

from diagnose.report import write_report
from diagnose.report.charts import explorer_of
from diagnose.report.film import Film, stretch_of
from diagnose.result import Diagnosis
from mjsim.models import shipped_model
from mjsim.render.writer import save
from simgap.filming import film_of

SAMPLES = 6_000


@pytest.fixture(scope="module")
def diagnosis() -> Diagnosis:
    return synthetic(SAMPLES)


def test_the_stretch_holds_the_largest_error(diagnosis: Diagnosis) -> None:
    explorer = explorer_of(diagnosis)
    assert explorer is not None
    s, start, seconds = stretch_of(explorer, 1.0)
    held = diagnosis.traces[1]
    assert s.source == held.source
    assert seconds == pytest.approx(1.0)
    error = np.where(held.counted, np.abs(held.measured - held.refitted), 0.0)
    inside = (held.time >= start) & (held.time <= start + seconds)
    assert np.mean(error[inside] ** 2) > np.mean(error**2)
    whole = stretch_of(explorer, 100.0)
    assert whole[1:] == (held.time[0], pytest.approx(held.time[-1] - held.time[0]))


def test_why_there_is_no_film_is_said(diagnosis: Diagnosis, tmp_path: Path) -> None:
    assert film_of(dataclasses.replace(diagnosis, traces=()), shipped_model("robot_axis1"), []) is None
    assert film_of(diagnosis, shipped_model("robot_axis1"), []) == "axis_held-out.csv is no file"
    broken = tmp_path / "axis_held-out.csv"
    broken.write_text("no table", encoding="utf-8")
    why = film_of(diagnosis, shipped_model("robot_axis1"), [broken])
    assert isinstance(why, str)
    assert "axis_held-out.csv" in why
    write_report(diagnosis, tmp_path / "report.html", film="a & b")
    assert "No film: a &amp; b." in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.fixture
def page(diagnosis: Diagnosis, tmp_path: Path) -> Path:
    """A report with a film of forty frames."""
    frames = (np.full((48, 64, 3), 6 * k, np.uint8) for k in range(40))
    save(frames, tmp_path / "film.mp4", 12.5)
    film = Film("axis_held-out.csv", 0.5, 3.2, (tmp_path / "film.mp4").read_bytes(), "A model <b> and a recording.")
    write_report(diagnosis, tmp_path / "report.html", film=film)
    return tmp_path / "report.html"


@pytest.mark.slow
def test_it_follows_the_slider(browser: Any, page: Path) -> None:
    with opened(browser, page) as w:
        w.page.wait_for_selector("#recordings-time .gd svg")
        w.until("document.querySelector('video').readyState >= 2")
        w.page.fill("[data-choose='moment']", "4000")
        w.until(f"Math.abs(document.querySelector('video').currentTime - {4000 * DT - 0.5}) < 0.05")
        w.page.select_option("[data-choose='recording']", "0")
        assert not w.page.is_visible("video")
        w.clean()
