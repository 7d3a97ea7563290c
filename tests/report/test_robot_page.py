"""The page of a robot in a real browser: an explorer a joint, with gaps where nothing counts, and a film."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import WINDOWS, looks_right, opened

from diagnose.report.film import Film
from diagnose.result import Estimate, FitFigures, Verdict
from diagnose.robot.page import write_page
from diagnose.robot.result import JointResult, RobotDiagnosis, RobotFinding, Trace

N, DT = 900, 0.01


def trace(role: str, seed: int) -> Trace:
    """A swing of a joint with dry friction; the ends are not compared."""
    t = DT * np.arange(N)
    rng = np.random.default_rng(seed)
    velocity = 2 * np.cos(3 * t)
    counted = (t > 0.5) & (t < 8.5)
    smooth = np.where(counted, 4 * np.sin(3 * t), np.nan)
    measured = smooth + 2 * np.sign(velocity) + 0.02 * rng.standard_normal(N)
    states = {"position": (2 / 3 * np.sin(3 * t), "rad"), "velocity": (velocity, "rad/s")}
    return Trace(f"{role}.csv", role, t, measured, smooth, smooth + velocity, smooth + 2 * np.sign(velocity), counted, states)


def joint(name: str, *, missing: bool) -> JointResult:
    friction = RobotFinding(
        "coulomb_friction", name, name, "Dry friction <of> 2 N m.", {"torque_Nm": Estimate(2.0, (1.9, 2.1), "N m")},
        {"held_out_error_before": 1.2, "held_out_error_after": 0.02, "p_value": 1e-15, "delta_chi2": 100.0},
    )  # fmt: skip
    fit = {k: FitFigures(v, v / 4, v, v / 4) for k, v in (("nominal", 2.0), ("refitted", 1.2), ("corrected", 0.02))}
    verdict = Verdict.MISSING_PHYSICS if missing else Verdict.NO_MISMATCH
    return JointResult(
        name, "N m", verdict, "It is judged by its torque.", (friction,) if missing else (), fit,
        {"damping": Estimate(0.5, (0.49, 0.51), "N m s/rad")}, {"damping": 0.5}, (0.0, 0.5), ("presliding_friction: no gain",),
        (trace("estimation", 1), trace("held-out", 2)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    joints = {n: joint(n, missing=n == "elbow") for n in ("shoulder", "elbow")}
    recordings = tuple({"file": f"{r}.csv", "role": r, "sha256": "0" * 64} for r in ("estimation", "held-out"))
    d = RobotDiagnosis(
        Verdict.MISSING_PHYSICS, "Missing: friction at elbow.", joints, joints["elbow"].fit, {}, {}, (), ("armature",), (),
        12, 20.0, recordings, 0, 3.0, {"simgap": "0"},
    )  # fmt: skip
    path = tmp_path_factory.mktemp("robot") / "robot.html"
    write_page(d, path, Film("held_out.csv", 1.0, 0.1, b"", "The arm <as given>."))
    return path


@pytest.fixture(scope="module")
def still(file: Path) -> Path:
    """A copy without the film, which has no frames here."""
    head, _, rest = file.read_text(encoding="utf-8").partition('<figure class="film">')
    path = file.with_name("still.html")
    path.write_text(head + rest.partition("</figure>")[2], encoding="utf-8")
    return path


@pytest.mark.slow
@WINDOWS
def test_fits_each_window(browser: Any, still: Path, widths: tuple[int, ...]) -> None:
    looks_right(browser, still, plots=6, widths=widths)


@pytest.mark.slow
def test_every_joint_has_an_explorer_of_its_own(browser: Any, still: Path) -> None:
    with opened(browser, still) as w:
        w.see_all()
        w.until("document.querySelectorAll('.plot.on').length >= 6")
        for key in ("joint-0", "joint-1"):
            explorer = w.page.locator(f"[data-explorer={key}]")
            assert explorer.locator("[data-choose=recording] option").all_inner_texts() == [
                "estimation.csv (estimation)", "held-out.csv (held out)"
            ]  # fmt: skip
            explorer.locator("[data-choose=moment]").fill("300")
            assert explorer.locator("[data-say=moment]").inner_text() == "3.0000 s"
            assert "rad/s" in explorer.locator("[data-say=values]").inner_text()
            explorer.locator("[data-choose=state]").select_option("velocity")
            assert "over the recorded velocity" in explorer.locator("[data-caption=state]").inner_text()
            explorer.locator("[data-choose=low]").fill("2")
            explorer.locator("[data-choose=high]").fill("3")
            explorer.locator("form button[type=submit]").click()
            assert "of the squared error" in explorer.locator("[data-say=selection]").inner_text()
        assert w.page.locator("[data-explorer=joint-1] .legend button").all_inner_texts() == [
            "nominal, as given", "nominal, refitted", "corrected"
        ]  # fmt: skip
        assert w.page.locator("[data-explorer=joint-0] .legend button").all_inner_texts() == ["nominal, as given", "corrected"]
        w.clean()


def test_texts_are_escaped_and_the_film_stands_alone(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert "Dry friction &lt;of&gt; 2 N m." in text
    assert "The arm &lt;as given&gt;. From 1.00 to 1.10 s." in text
    assert "data-recording" not in text.partition("<video")[2].partition(">")[0]
