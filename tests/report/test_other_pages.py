"""The pages of a check and of an identification in a real browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import WINDOWS, looks_right, opened

import simgap

N = 4_000
DT = 5e-4


@pytest.fixture(scope="module")
def log() -> dict[str, np.ndarray]:
    t = DT * np.arange(N)
    torque = 1.2 * np.sin(2 * np.pi * (0.5 + 4 * t) * t)
    run = simgap.simulate("robot_axis1", torque, dt=DT)
    noise = np.random.default_rng(2).standard_normal(N)
    return {"time_s": t, "torque_Nm": torque, "velocity_rad_s": run.velocity + 0.05 * noise, "angle_rad": run.angle}


@pytest.fixture(scope="module")
def identification(log: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    fitted = simgap.identify(log, orders=(2, 2, 2, 2, 1), decimate=10)
    return fitted.report(tmp_path_factory.mktemp("pages") / "identification.html")


@pytest.fixture(scope="module")
def pages(identification: Path, log: dict[str, np.ndarray]) -> dict[str, Path]:
    simgap.check(log, "robot_axis1", out=identification.parent)
    return {"identification": identification, "check": identification.parent / "check.html"}


@pytest.mark.slow
@WINDOWS
@pytest.mark.parametrize(("name", "plots"), [("identification", 0), ("check", 3)])
def test_opens_from_disk_and_fits_the_window(
    browser: Any, pages: dict[str, Path], name: str, plots: int, widths: tuple[int, ...]
) -> None:
    looks_right(browser, pages[name], plots, widths)


@pytest.mark.parametrize(("scheme", "chosen", "dark"), [("light", "", False), ("dark", "", True), ("dark", "light", False)])
def test_figures_suit_the_colours_of_the_page(browser: Any, identification: Path, scheme: str, chosen: str, dark: bool) -> None:
    with opened(browser, identification, color_scheme=scheme) as w:
        w.page.evaluate("(chosen) => { if (chosen) document.documentElement.dataset.theme = chosen; }", chosen)
        filters = w.page.evaluate("[...document.querySelectorAll('.photo img')].map((e) => getComputedStyle(e).filter)")
        assert [("invert" in f) for f in filters] == [dark] * len(filters)
        assert len(filters) >= 3
