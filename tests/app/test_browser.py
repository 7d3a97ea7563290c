"""The app in a real browser, as a user has it: ``simgap app`` in a process, from a new run to a comparison."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

for needed in ("starlette", "uvicorn"):
    pytest.importorskip(needed, reason=f"{needed} is not installed: pip install simgap[app]")

MODEL = Path(__file__).resolve().parents[2] / "models" / "pendulum.xml"
PICTURES = os.environ.get("SIMGAP_PICTURES")  # a folder for screenshots


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """The app in a process of its own."""
    words = [sys.executable, "-m", "simgap", "app", "--no-browser", "--folder", str(tmp_path / "runs")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        line = process.stdout.readline()
        found = re.fullmatch(r"simgap app: (http://127\.0\.0\.1:\d+/\?token=[\w-]{43})\n", line)
        assert found, line
        yield found[1]
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
        assert process.stderr.read() == ""


def fits(page: Any, width: int, name: str) -> None:
    """Nothing is wider than the window."""
    page.set_viewport_size({"width": width, "height": 900})
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    if PICTURES:
        page.screenshot(path=f"{PICTURES}/{name}-{width}.png", full_page=True)


@pytest.mark.slow
def test_from_a_new_run_to_a_comparison(browser: Any, address: str, log: bytes, tmp_path: Path) -> None:
    said: list[str] = []
    recording = tmp_path / "log.csv"
    recording.write_bytes(log)
    with browser.new_context(viewport={"width": 1400, "height": 900}) as window:
        page = window.new_page()
        page.set_default_timeout(60_000)
        page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: said.append(str(e)))
        page.goto(address)
        assert "token" not in page.url
        page.fill("input[name=name]", "<b>pendulum</b>")
        page.click("text=New run")
        page.wait_for_url("**/runs/*")
        assert page.inner_text("h1") == "<b>pendulum</b>"

        page.set_input_files("[data-put$='/model/']", MODEL)
        page.wait_for_selector("option[value='model/pendulum.xml']:checked", state="attached")
        page.set_input_files("[data-put$='/recordings/']", recording)
        page.wait_for_selector("[data-held-out][value='log.csv']")

        page.click("[data-start=check]")
        page.wait_for_selector("text=No problem found.")
        page.click("summary")
        page.fill("[data-setting=effects]", "coulomb_friction,torque_offset")
        page.click("[data-start=diagnose]")
        page.wait_for_selector(".lines li")
        fits(page, 1400, "working")
        page.wait_for_selector("text=Missing physics")
        assert page.inner_text("th[scope=row]:has-text('Coulomb')") == "Coulomb friction"
        for width in (1400, 390):
            fits(page, width, "run")

        with page.expect_popup() as opened:
            page.click("text=report.html")
        report = opened.value
        report.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
        report.wait_for_selector(".plot.on", state="attached")
        assert report.evaluate("origin") == "null"
        report.close()

        first = page.url
        page.click("text=Copy to a new run")
        page.wait_for_url(lambda url: url != first)
        assert page.input_value("[data-setting=effects]") == "coulomb_friction,torque_offset"
        page.goto(first.rpartition("/runs/")[0] + "/")
        for box in page.query_selector_all("[name=run]"):
            box.check()
        fits(page, 390, "home")
        page.click("text=Compare the chosen runs")
        page.wait_for_url("**/compare?run=*")
        assert page.inner_text("table.cards").count("pendulum.xml") == 2
        for width in (1400, 390):
            fits(page, width, "compare")

        page.set_viewport_size({"width": 1400, "height": 900})
        page.goto(first)
        bad = tmp_path / "bad.csv"
        bad.write_text("a,b\n1,2\n")
        assert said == []
        page.set_input_files("[data-put$='/recordings/']", bad)
        page.wait_for_selector("[data-held-out][value='bad.csv']")
        page.click("[data-start=check]")
        page.wait_for_selector(".error:has-text('bad.csv')")
        fits(page, 390, "error")
        assert said == []


@pytest.mark.slow
def test_a_recording_of_a_real_machine(browser: Any, address: str, local_copy: Any) -> None:
    """EMPS: a shipped model by name, one recording held out, effects in two of its laws."""
    files = [local_copy("emps", name) for name in ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat")]
    said: list[str] = []
    with browser.new_context(viewport={"width": 1400, "height": 900}) as window:
        page = window.new_page()
        page.set_default_timeout(240_000)
        page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
        page.goto(address)
        page.click("text=New run")
        page.wait_for_url("**/runs/*")
        page.select_option("[data-setting=model]", "emps")
        page.wait_for_selector("option[value=emps]:checked", state="attached")
        page.set_input_files("[data-put$='/recordings/']", files)
        page.wait_for_selector("[data-held-out][value='DATA_EMPS.mat']")
        with page.expect_navigation():
            page.check("[data-held-out][value='DATA_EMPS_PULSES.mat']")
        assert page.is_checked("[data-held-out][value='DATA_EMPS_PULSES.mat']")
        page.click("[data-start=check]")
        page.wait_for_selector("a:has-text('check.html')")
        page.click("summary")
        page.fill("[data-setting=effects]", "coulomb_friction,torque_offset")
        page.check("[data-setting=markdown]")
        page.click("[data-start=diagnose]")
        page.wait_for_selector("a:has-text('summary.md')")
        assert "Coulomb friction" in page.inner_text("main")
        fits(page, 1400, "emps")
        with page.expect_download() as saved:
            page.click("a:has-text('corrected.xml')")
        assert "frictionloss" in Path(saved.value.path()).read_text(encoding="utf-8")
    assert said == []
