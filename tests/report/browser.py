"""Headless Chromium for tests: the system's browser, driven by playwright; skipped with a reason where one of them is missing."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

PICTURES = os.environ.get("SIMGAP_PICTURES")  # a folder for screenshots
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@contextmanager
def started() -> Iterator[Any]:
    """A browser that is closed at the end."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install simgap[dev]")
    path = next((found for name in NAMES if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


def slowdown(seconds: float = 0.1) -> float:
    """Time on the clock over time of the processor now, at least 1: others share the machine."""
    wall, processor = time.perf_counter(), time.thread_time()
    while time.thread_time() - processor < seconds:
        pass
    return max(1.0, (time.perf_counter() - wall) / seconds)


@dataclass
class Watched:
    """A page with what it said on the console and what it asked of the network."""

    page: Any
    said: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    prepared: Any = None

    def clean(self) -> None:
        """Hold that nothing was reported and nothing requested."""
        assert self.said == []
        assert self.asked == []

    def until(self, condition: str, seconds: float = 10.0) -> None:
        """Wait for a condition in JavaScript; the page's policy does not let Playwright's own wait evaluate text in the page."""
        end = time.monotonic() + seconds
        while not self.page.evaluate(condition):
            assert time.monotonic() < end, condition
            time.sleep(0.02)

    def see_all(self) -> None:
        """Scroll through the page, so that every plot is drawn."""
        self.page.evaluate(
            """async () => {
                for (let y = 0; y < document.documentElement.scrollHeight; y += 400) {
                    window.scrollTo(0, y);
                    await new Promise((done) => requestAnimationFrame(() => setTimeout(done, 20)));
                }
                window.scrollTo(0, 0);
            }"""
        )


@contextmanager
def opened(
    browser: Any, file: Path, width: int = 1400, prepare: Callable[[Any], Any] | None = None, **context: Any
) -> Iterator[Watched]:
    """A file in a window of its own of a given width [px]; ``prepare``: called with the page before the file is opened."""
    with browser.new_context(viewport={"width": width, "height": 900}, **context) as window:
        page = window.new_page()
        watched = Watched(page)
        page.on("console", lambda m: watched.said.append(f"{m.type}: {m.text}") if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: watched.said.append(str(e)))
        page.on("request", lambda r: None if r.url.startswith(("file:", "data:", "blob:")) else watched.asked.append(r.url))
        watched.prepared = prepare(page) if prepare else None
        page.goto(file.as_uri())
        yield watched


WIDTHS = (390, 1400)  # of a phone and a desktop [px]
WINDOWS = pytest.mark.parametrize(
    "widths", [pytest.param(WIDTHS, id="phone and desktop"), pytest.param((768,), id="tablet", marks=pytest.mark.slow)]
)  # of tests that open a page by `looks_right`
CUT_OFF = """() => [...document.querySelectorAll('td, th, .tiles *, button, select, h1, h2, p, figcaption')].filter((e) =>
    e.offsetParent !== null && !e.closest('.scroll') && e.getBoundingClientRect().right > innerWidth + 1)
    .map((e) => e.textContent)"""
COVERED = """() => {
    const b = document.getElementById('theme').getBoundingClientRect(), out = [];
    for (const e of document.querySelectorAll('header h1, header p, header .badge, header nav a')) {
        const range = document.createRange();
        range.selectNodeContents(e);
        for (const r of range.getClientRects())
            if (r.left < b.right && r.right > b.left && r.top < b.bottom && r.bottom > b.top) out.push(e.textContent);
    }
    return out;
}"""  # texts that lie under the switch of colours


def looks_right(browser: Any, file: Path, plots: int = 0, widths: Sequence[int] = WIDTHS) -> None:
    """Hold that a page opens from disk at each width in both colours: nothing reported, requested, covered or out of sight.

    At each width it is opened in the one and changed to the other, as a device does by time of day.
    """
    for width in widths:
        schemes = ("light", "dark") if width < 768 else ("dark", "light")
        with opened(browser, file, width, color_scheme=schemes[0]) as w:
            w.see_all()
            w.until(f"document.querySelectorAll('.plot.on').length >= {plots}")
            for scheme in schemes:
                w.page.emulate_media(color_scheme=scheme)
                assert w.page.evaluate("document.documentElement.scrollWidth") <= width
                assert w.page.evaluate(CUT_OFF) == []
                assert w.page.evaluate(COVERED) == []
                if PICTURES:
                    w.page.screenshot(path=f"{PICTURES}/{file.stem}-{width}-{scheme}.png", full_page=True)
            w.page.click("#theme")
            w.clean()
