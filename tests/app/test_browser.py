"""The app in a real browser, as a user has it: ``simgap app`` in a process, from a new run to a comparison."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import slowdown

for needed in ("starlette", "uvicorn"):
    pytest.importorskip(needed, reason=f"{needed} is not installed: pip install simgap[app]")

MODEL = Path(__file__).resolve().parents[2] / "models" / "pendulum.xml"
SECONDS = 3.0  # from an upload to the first picture
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
        assert found, line or process.stderr.read()
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

        page.set_input_files("[data-put$='/model/'][multiple]", MODEL)
        page.wait_for_selector("option[value='model/pendulum.xml']:checked", state="attached")
        page.set_input_files("[data-put$='/recordings/'][multiple]", recording)
        page.wait_for_selector("[data-part=held_out][value='log.csv']")

        page.click("[data-start=check]")
        page.wait_for_selector("text=No problem found.")
        options(page, "diagnose")
        page.fill("#diagnose-effects", "coulomb_friction,torque_offset")
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
        assert page.input_value("#diagnose-effects") == "coulomb_friction,torque_offset"
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
        page.set_input_files("[data-put$='/recordings/'][multiple]", bad)
        page.wait_for_selector("[data-part=held_out][value='bad.csv']")
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
        page.set_input_files("[data-put$='/recordings/'][multiple]", files)
        page.wait_for_selector("[data-part=held_out][value='DATA_EMPS.mat']")
        page.wait_for_selector(".preview svg >> nth=1")
        with page.expect_navigation():
            page.check("[data-part=held_out][value='DATA_EMPS_PULSES.mat']")
        assert page.is_checked("[data-part=held_out][value='DATA_EMPS_PULSES.mat']")
        page.click("[data-start=check]")
        page.wait_for_selector("a:has-text('check.html')")
        options(page, "diagnose")
        page.fill("#diagnose-effects", "coulomb_friction,torque_offset")
        page.check("#diagnose-markdown")
        page.click("[data-start=diagnose]")
        page.wait_for_selector("a:has-text('summary.md')")
        assert "Coulomb friction" in page.inner_text("main")
        fits(page, 1400, "emps")
        with page.expect_download() as saved:
            page.click("a:has-text('corrected.xml')")
        assert "frictionloss" in Path(saved.value.path()).read_text(encoding="utf-8")

        start(page, "replay", model="out/diagnose/corrected.xml", recording="recordings/DATA_EMPS_PULSES.mat")
        assert "fit" in page.inner_text(".printed")
        assert page.locator("a:has-text('replay.csv')").count() == 1
        start(page, "gate")
        assert "ok" in page.inner_text(".printed")
        start(page, "identify", model="emps", orders="2,2,2,2,1", decimate=5)
        page.wait_for_selector("figure img >> nth=0")
        fits(page, 1400, "identify")
        with page.expect_popup() as opened:
            page.click("a:has-text('identification.html')")
        opened.value.wait_for_selector("#response")
        opened.value.close()
        start(page, "render", source="emps", recording="recordings/DATA_EMPS.mat", duration=0.5, size="320x240", format=".gif")
        assert page.evaluate("document.querySelector('figure img').naturalWidth") > 0
        fits(page, 390, "render")
    assert said == []


def options(page: Any, command: str) -> None:
    """Show the optional fields of a command."""
    page.click(f"details:has([data-command={command}]) > summary")


def start(page: Any, command: str, fails: bool = False, **values: Any) -> None:
    """Open a command from the page of the run, fill its form in, start it, and wait until it has ended."""
    page.goto(page.url.partition("/runs/")[0] + "/runs/" + page.url.partition("/runs/")[2].partition("/")[0])
    page.click(f".commands a:text-is('{command}')")
    page.wait_for_url(f"**/{command}")
    if page.locator("details:has([data-command]) > summary").count():
        options(page, command)
    for name, value in values.items():
        field = page.locator(f".field:has(> label:text-is('{name.replace('_', ' ')}')) [data-setting]")
        if field.evaluate("e => e.tagName") == "SELECT":
            field.select_option(value)
        elif value is True:
            field.check()
        else:
            field.fill(str(value))
    page.click("[data-start]")
    page.wait_for_selector("[role=alert]:visible" if fails else "#results")


@pytest.mark.slow
def test_every_other_command(browser: Any, address: str, log: bytes, tmp_path: Path) -> None:
    """Commands that need no diagnosis, with a refusal as one line, progress, and what was printed."""
    said: list[str] = []
    recording, bad = tmp_path / "log.csv", tmp_path / "baseline.json"
    recording.write_bytes(log)
    bad.write_text("{")
    with browser.new_context(viewport={"width": 1400, "height": 900}) as window:
        page = window.new_page()
        page.set_default_timeout(120_000)
        page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: said.append(str(e)))
        page.goto(address)
        page.click("text=New run")
        page.wait_for_url("**/runs/*")
        start(page, "effects", name="backlash")
        assert "gap_rad" in page.inner_text(".printed")
        start(page, "effects", fails=True, name="backlsh")
        assert "did you mean 'backlash'" in page.inner_text(".error")
        start(page, "doctor")
        assert "mujoco" in page.inner_text(".printed")
        start(page, "run", scenario="coulomb_2", duration=1, engine="ode")
        assert page.locator("a:has-text('coulomb_2.csv')").count() == 1
        start(page, "crosscheck", model="pendulum", duration=1)
        assert page.evaluate("document.querySelector('figure img').naturalWidth") > 0
        fits(page, 390, "crosscheck")
        page.set_viewport_size({"width": 1400, "height": 900})
        start(page, "render", source="pendulum", duration=0.4, size="320x240")
        assert page.evaluate("document.querySelector('video').readyState") >= 0
        assert said == []
        start(page, "gate", fails=True, model="pendulum")
        assert "upload one in step 2" in page.inner_text("#problem")


def arm_in_a_folder(folder: Path) -> Path:
    """The pendulum's model as a main file, an included one, and a mesh in a folder of its own."""
    import mujoco

    text = MODEL.read_text(encoding="utf-8")
    start, end = text.index("<worldbody>"), text.index("</worldbody>") + len("</worldbody>")
    body = text[start:end].replace("</worldbody>", '<geom type="mesh" mesh="block" contype="0" conaffinity="0"/></worldbody>')
    (folder / "parts").mkdir(parents=True)
    (folder / "assets").mkdir()
    mesh = '<asset><mesh name="block" file="assets/block one.obj"/></asset>'
    (folder / "scene.xml").write_text(f'{text[:start]}{mesh}<include file="parts/body.xml"/>{text[end:]}')
    (folder / "parts" / "body.xml").write_text(f"<mujoco>{body}</mujoco>")
    (folder / "assets" / "block one.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    (folder / "README.md").write_text("not read")
    mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    return folder


@pytest.mark.slow
def test_a_model_as_a_folder_and_recordings_as_an_archive(browser: Any, address: str, log: bytes, tmp_path: Path) -> None:
    said: list[str] = []
    arm = arm_in_a_folder(tmp_path / "arm")
    with zipfile.ZipFile(tmp_path / "logs.zip", "w") as archive:
        for name in ("a.csv", "b 1.csv"):
            archive.writestr(name, log)
    with browser.new_context(viewport={"width": 1400, "height": 900}) as window:
        page = window.new_page()
        page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: said.append(str(e)))
        page.goto(address)
        page.click("text=New run")
        page.wait_for_url("**/runs/*")
        page.set_input_files("[data-put$='/model/'][webkitdirectory]", arm)
        page.wait_for_selector("option[value='model/arm/scene.xml']:checked", state="attached")
        assert page.inner_text("#state") == "1 file of kinds that are not read here was left out."
        page.set_input_files("[data-put$='/recordings/'][multiple]", tmp_path / "logs.zip")
        page.wait_for_selector(".preview svg >> nth=1")
        with page.expect_navigation():
            page.check("[data-part=held_out][value='logs/b 1.csv']")
        fits(page, 390, "folders")
        page.click("[data-start=check]")
        page.wait_for_selector("text=No problem found.", timeout=60_000)
        with page.expect_navigation():
            page.click(".files li:has-text('arm/') button")
        assert page.input_value("[data-setting=model]") == ""
    assert said == []


@pytest.mark.slow
def test_a_folder_of_a_real_robot(browser: Any, address: str, local_copy: Any) -> None:
    """SO-101: a folder in the form of SAGE is one recording, with a picture of its joints."""
    folder = local_copy("so101", "raw/friction_gravity/joint_list.txt").parent
    with browser.new_context(viewport={"width": 1400, "height": 900}) as window:
        page = window.new_page()
        page.set_default_timeout(60_000)
        page.goto(address)
        page.click("text=New run")
        page.wait_for_url("**/runs/*")
        page.set_input_files("[data-put$='/recordings/'][webkitdirectory]", folder)
        page.wait_for_selector("[data-part=held_out][value='friction_gravity']")
        page.wait_for_selector(".preview svg")
        fits(page, 1400, "sage")


@pytest.mark.slow
def test_from_an_upload_to_its_picture(browser: Any, address: str, log: bytes, tmp_path: Path) -> None:
    recording, bad = tmp_path / "log.csv", tmp_path / "bad.csv"
    recording.write_bytes(log)
    bad.write_text("a,b\n1,2\n")
    with browser.new_context(viewport={"width": 1400, "height": 900}) as window:
        page = window.new_page()
        page.goto(address)
        page.click("text=New run")
        page.wait_for_url("**/runs/*")
        before, began = slowdown(), time.monotonic()
        page.set_input_files("[data-put$='/recordings/'][multiple]", recording)
        page.wait_for_selector(".preview svg")
        took = time.monotonic() - began
        assert took < SECONDS * max(before, slowdown()), took
        assert page.locator(".preview svg").get_attribute("aria-label") == "Signals of log.csv over time"
        page.set_input_files("[data-put$='/recordings/'][multiple]", bad)
        page.wait_for_selector(".preview:has-text('bad.csv')")
        fits(page, 390, "upload")
