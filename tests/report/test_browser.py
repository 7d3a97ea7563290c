"""The diagnosis page in a real browser: it opens from disk, every control works, nothing is asked of the network."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import WIDTHS, WINDOWS, Watched, looks_right, opened
from synthetic import DIFF, DT, TRUTH, synthetic

from diagnose.report import write_report

SECONDS = 1.5  # to open a page of 20 s at 2 kHz
SAMPLES = 6_000


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_report(synthetic(SAMPLES), path, corrected_diff=DIFF, truth=TRUTH)
    return path


@pytest.fixture(scope="module", params=[pytest.param(min(WIDTHS), marks=pytest.mark.slow), max(WIDTHS)])
def wide(request: pytest.FixtureRequest, browser: Any, file: Path) -> Any:
    """The page in the narrowest and the widest window, all plots drawn; tests leave it as they found it."""
    with opened(browser, file, request.param) as watched:
        watched.see_all()
        watched.until("document.querySelectorAll('.plot.on').length >= 5")
        yield watched
        watched.clean()


def view(w: Watched) -> list[float]:
    return list(w.page.evaluate("document.querySelector('#recordings-time .gd')._fullLayout.xaxis.range"))


def press(w: Watched, action: str) -> None:
    w.page.click(f"[data-explorer] [data-do='{action}']")


def drag(w: Watched, part: str, start: float, end: float) -> None:
    """Drag over a plot from one to another share of its width."""
    w.page.locator(f"#recordings-{part}").scroll_into_view_if_needed()
    box = w.page.evaluate(
        f"""() => {{ const gd = document.querySelector('#recordings-{part} .gd'); const b = gd.getBoundingClientRect();
        const l = gd._fullLayout; return [b.left + l.xaxis._offset, b.top + l._size.t + 20, l.xaxis._length]; }}"""
    )
    mouse = w.page.mouse
    mouse.move(box[0] + start * box[2], box[1] + 30)
    mouse.down()
    mouse.move(box[0] + (start + end) / 2 * box[2], box[1] + 32)
    mouse.move(box[0] + end * box[2], box[1] + 34)
    mouse.up()


@WINDOWS
def test_opens_from_disk_and_fits_the_window(browser: Any, file: Path, widths: tuple[int, ...]) -> None:
    looks_right(browser, file, plots=5, widths=widths)


@pytest.mark.slow
def test_twenty_seconds_open_quickly(browser: Any, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(synthetic(40_000), path, corrected_diff=DIFF)
    with opened(browser, path, prepare=processor_time) as w:
        w.page.wait_for_selector(".plot.on .gd svg")
        metrics = {m["name"]: m["value"] for m in w.prepared.send("Performance.getMetrics")["metrics"]}
        w.clean()
    assert metrics["TaskDuration"] < SECONDS


def processor_time(page: Any) -> Any:
    """A session of the browser's tools that counts the processor's time of a page: others share the machine."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    return session


@pytest.mark.slow
def test_zoom_by_dragging_buttons_and_keys(wide: Watched) -> None:
    whole = view(wide)
    drag(wide, "time", 0.2, 0.6)
    wide.until("document.querySelector('#recordings-time .gd')._fullLayout.xaxis.range[0] > 0.1")
    low, high = view(wide)
    assert low == pytest.approx(whole[0] + 0.2 * (whole[1] - whole[0]), abs=0.02 * whole[1])
    assert high == pytest.approx(whole[0] + 0.6 * (whole[1] - whole[0]), abs=0.02 * whole[1])
    press(wide, "in")
    assert np.diff(view(wide))[0] == pytest.approx(0.5 * (high - low))
    press(wide, "out")
    before = view(wide)
    press(wide, "right")
    assert view(wide)[0] > before[0]
    press(wide, "reset")
    assert view(wide) == pytest.approx(whole)
    wide.page.focus("#recordings-time")
    wide.page.keyboard.press("+")
    assert np.diff(view(wide))[0] == pytest.approx(0.5 * (whole[1] - whole[0]))
    wide.page.keyboard.press("ArrowLeft")
    wide.page.keyboard.press("0")
    assert view(wide) == pytest.approx(whole)


def test_panning(wide: Watched) -> None:
    press(wide, "in")
    before = view(wide)
    press(wide, "pan")
    drag(wide, "time", 0.6, 0.4)
    wide.until(f"document.querySelector('#recordings-time .gd')._fullLayout.xaxis.range[0] > {before[0]} + 1e-3")
    press(wide, "reset")
    press(wide, "zoom")


def test_a_zoom_shows_every_sample(wide: Watched) -> None:
    caption = "[data-caption='time']"
    for _ in range(5):
        press(wide, "in")
    assert "Every sample is drawn" in wide.page.inner_text(caption)
    press(wide, "reset")
    assert "The least and the greatest of every" in wide.page.inner_text(caption)


def test_the_cursor_is_linked(wide: Watched) -> None:
    wide.page.fill("[data-choose='moment']", "3000")
    text = f"{3000 * DT:.4f} s"
    assert wide.page.inner_text("[data-say='moment']") == text
    assert wide.page.get_attribute("[data-choose='moment']", "aria-valuetext") == text
    assert wide.page.is_visible("#recordings-time .cursor")
    assert wide.page.is_visible("#recordings-state .pointer")
    values = wide.page.inner_text("[data-say='values']")
    assert "measured velocity" in values
    assert "error" in values
    wide.page.locator("#recordings-time").hover(position={"x": 300, "y": 60})
    assert wide.page.inner_text("[data-say='moment']") != text
    wide.page.focus("[data-choose='moment']")
    before = wide.page.input_value("[data-choose='moment']")
    wide.page.keyboard.press("ArrowRight")
    assert int(wide.page.input_value("[data-choose='moment']")) == int(before) + 1


def test_play_moves_the_cursor_and_stops(wide: Watched) -> None:
    wide.page.fill("[data-choose='moment']", "0")
    press(wide, "play")
    wide.until("Number(document.querySelector('[data-choose=moment]').value) > 50")
    press(wide, "play")
    assert wide.page.inner_text("[data-do='play']") == "Play"


@pytest.mark.slow
def test_a_stretch_of_time_is_marked_everywhere(wide: Watched) -> None:
    press(wide, "select")
    drag(wide, "time", 0.1, 0.3)
    told = wide.page.inner_text("[data-say='selection']")
    assert told.startswith("Selected, time from")
    assert "of the squared error" in told
    assert names(wide, "frequency")[-1] == "error while selected"
    assert "selected" in names(wide, "state")
    press(wide, "clear")
    assert names(wide, "frequency")[-1] != "error while selected"
    press(wide, "zoom")


def test_a_band_of_frequency_is_marked_everywhere(wide: Watched) -> None:
    press(wide, "select")
    drag(wide, "frequency", 0.3, 0.5)
    assert "frequency from" in wide.page.inner_text("[data-say='selection']")
    assert names(wide, "time")[-1] == "error in the selected band"
    assert "selected" in names(wide, "state")
    press(wide, "clear")
    press(wide, "zoom")


def test_a_range_of_a_state_by_numbers(wide: Watched) -> None:
    page = wide.page
    page.select_option("[data-choose='kind']", "state")
    assert page.inner_text("[data-say='unit']") == "rad/s"
    page.fill("[data-choose='low']", "5")
    page.fill("[data-choose='high']", "2")
    page.click("form.selection button[type='submit']")
    assert "two numbers" in page.inner_text("[data-say='selection']")
    page.fill("[data-choose='high']", "500")
    page.click("form.selection button[type='submit']")
    told = page.inner_text("[data-say='selection']")
    assert "velocity from 5.000 to 500.0 rad/s" in told
    assert names(wide, "time")[-1] == "selected"
    assert names(wide, "frequency")[-1] == "error while selected"
    press(wide, "clear")


def test_the_share_of_a_selection_is_right(browser: Any, tmp_path: Path) -> None:
    d = synthetic(SAMPLES)
    path = tmp_path / "report.html"
    write_report(d, path)
    held = d.traces[1]
    error = np.where(held.counted, held.measured - held.refitted, 0.0)
    inside = (held.time >= 0.5) & (held.time <= 1.5)
    share = np.sum(error[inside] ** 2) / np.sum(error**2)
    with opened(browser, path) as w:
        w.page.fill("[data-choose='low']", "0.5")
        w.page.fill("[data-choose='high']", "1.5")
        w.page.click("form.selection button[type='submit']")
        told = w.page.inner_text("[data-say='selection']")
    assert f"{100 * share:.2g} % of the squared error" in told


def names(w: Watched, part: str) -> list[str]:
    return list(w.page.evaluate(f"document.querySelector('#recordings-{part} .gd').data.map((t) => t.name)"))


@pytest.mark.slow
def test_recording_error_and_state_are_chosen(wide: Watched) -> None:
    page = wide.page
    assert page.input_value("[data-choose='recording']") == "1"  # the held-out one
    page.select_option("[data-choose='recording']", "0")
    page.select_option("[data-choose='model']", "corrected")
    page.select_option("[data-choose='state']", "angle")
    assert "corrected model over the recorded angle" in page.inner_text("[data-caption='state']")
    for chosen, value in (("recording", "1"), ("model", "refitted"), ("state", "velocity")):
        page.select_option(f"[data-choose='{chosen}']", value)


def test_the_legend_hides_a_model(wide: Watched) -> None:
    button = wide.page.locator(".legend button", has_text="nominal, as given")
    button.click()
    assert button.get_attribute("aria-pressed") == "false"
    assert "nominal, as given" not in names(wide, "time")
    button.click()
    assert "nominal, as given" in names(wide, "time")


def test_signals_are_saved(wide: Watched, tmp_path: Path) -> None:
    with wide.page.expect_download() as download:
        press(wide, "csv")
    path = tmp_path / download.value.suggested_filename
    download.value.save_as(path)
    rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    assert rows[0] == ["time_s", "measured_velocity", "nominal", "refitted", "corrected", "torque", "angle"]
    assert len(rows) == SAMPLES + 1
    held = synthetic(SAMPLES).traces[1]
    assert float(rows[100][1]) == pytest.approx(held.measured[99], rel=1e-5)
    assert float(rows[100][4]) == pytest.approx(held.corrected[99], rel=1e-5)


def test_charts_zoom(wide: Watched) -> None:
    chart = wide.page.locator("[data-chart='s0']")
    ends = "document.querySelector('#chart-s0 .gd')._fullLayout.xaxis.range"
    before = wide.page.evaluate(ends)
    chart.locator("[data-do='in']").click()
    after = wide.page.evaluate(ends)
    assert after[1] - after[0] == pytest.approx(0.5 * (before[1] - before[0]))
    chart.locator("[data-do='reset']").click()
    assert wide.page.evaluate(ends) == pytest.approx(before)


def test_the_theme_is_switched(browser: Any, file: Path) -> None:
    with opened(browser, file, color_scheme="light") as w:
        colour = "getComputedStyle(document.body).backgroundColor"
        grid = "document.querySelector('#recordings-time .gd')._fullLayout.xaxis.gridcolor"
        w.page.wait_for_selector("#recordings-time .gd svg")
        light, light_grid = w.page.evaluate(colour), w.page.evaluate(grid)
        w.page.click("#theme")
        assert w.page.inner_text("#theme") == "Colours: light"
        w.page.click("#theme")
        assert w.page.inner_text("#theme") == "Colours: dark"
        assert w.page.evaluate(colour) != light
        assert w.page.evaluate(grid) != light_grid
        w.page.click("#theme")
        assert w.page.evaluate(colour) == light
        w.clean()


def test_the_keyboard_reaches_every_control(browser: Any, file: Path) -> None:
    with opened(browser, file) as w:
        w.page.wait_for_selector("#recordings-time .gd svg")
        wanted = w.page.evaluate(
            "() => [...document.querySelectorAll('button, select, input, summary, a[href], [tabindex=\"0\"]')]"
            ".filter((e) => e.offsetParent !== null || e.className === 'skip').length"
        )
        seen = 0
        outlined = True
        for _ in range(wanted + 40):
            w.page.keyboard.press("Tab")
            shown, body = w.page.evaluate(
                "() => { const e = document.activeElement;"
                " return [getComputedStyle(e).outlineStyle !== 'none', e === document.body]; }"
            )
            if body:
                break
            outlined = outlined and shown
            seen += 1
        assert outlined
        assert seen >= wanted
        w.clean()


@pytest.mark.slow
def test_print_and_pages_without_scripts_show_the_static_pictures(browser: Any, file: Path) -> None:
    with opened(browser, file, java_script_enabled=False) as w:
        assert w.page.is_visible(".static svg >> nth=0")
        assert not w.page.is_visible("[data-choose='moment']")
    with opened(browser, file) as w:
        w.see_all()
        w.page.emulate_media(media="print")
        assert w.page.is_visible(".static svg >> nth=0")
        assert not w.page.is_visible("#recordings-time .gd")
        assert not w.page.is_visible("#theme")
