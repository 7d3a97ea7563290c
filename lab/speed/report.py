"""Size of the report of a diagnosis, and how long Chromium takes to open it.

    python lab/speed/report.py --seconds 20 --rate 2000 --repeats 5

An axis with dry friction that its model lacks: one recording for the fit and one held out, each of so many seconds, with all
signals that a report holds. A page is open when its first plot is drawn and the browser is idle. Processor: of the page's main
thread; clock: from the request to that moment. The bars are 1.5 s and 6 MB for 20 s at 2 kHz. Needs Chromium
and playwright (extra ``dev``).
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.report import write_report
from diagnose.report.film import Film
from diagnose.result import Diagnosis, Estimate, Finding, FitFigures, Mismatch, Traces, Verdict
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate

BARS = {"seconds": 1.5, "megabytes": 6.0}
NOISE = 0.05
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def recorded(role: str, seconds: float, dt: float, seed: int) -> Traces:
    """A recording with the runs of three models and three states."""
    axis = load_axis(shipped_model("robot_axis1"))
    t = dt * np.arange(round(seconds / dt))
    torque = 1.2 * np.sin(2 * np.pi * (0.5 + 14 * t / seconds) * t)
    friction = effect_class("coulomb_friction")(torque_Nm=0.1)
    nominal, refitted, corrected = (simulate(a, torque, dt) for a in (axis, axis.with_linear({"fm": 0.045}), axis + friction))
    measured = corrected.velocity + NOISE * np.random.default_rng(seed).standard_normal(len(t))
    states = {"velocity": (measured, "rad/s"), "angle": (np.array(corrected.angle), "rad"), "torque": (torque, "Nm")}
    models = (np.array(x.velocity) for x in (nominal, refitted, corrected))
    return Traces(f"{role}.csv", role, t, measured, *models, np.ones(len(t), bool), NOISE, states=states)


def diagnosis(seconds: float, dt: float) -> Diagnosis:
    """What a report is made of, without a search."""
    traces = recorded("estimation", seconds, dt, 0), recorded("held-out", seconds, dt, 1)
    evidence = {"held_out_error_before": 0.4, "held_out_error_after": NOISE, "p_value": 1e-20, "hypotheses": 60.0}
    finding = Finding("coulomb_friction", "motor", "motor", "Dry friction of 0.1 N m.",
                      {"torque_Nm": Estimate(0.1, (0.099, 0.101), "N m")}, evidence)  # fmt: skip
    f = np.linspace(0, 0.5 / dt, 1025)
    flat = np.full_like(f, 2 * dt * NOISE**2)
    mismatch = Mismatch((), (), (), (), (f, 4 * flat, flat, 40 * flat), 0.9, 0.1, traces[0].source, "estimation", 1.0)
    fit = {k: FitFigures(v, v / 10, v, v / 10) for k, v in (("nominal", 0.6), ("refitted", 0.4), ("corrected", NOISE))}
    recordings = tuple({"file": t.source, "sha256": "", "role": t.role} for t in traces)
    return Diagnosis(
        verdict=Verdict.MISSING_PHYSICS, summary="The simulation leaves out dry friction.", findings=(finding,),
        mismatch=mismatch, mismatches=(mismatch,), linear_parameters={}, nominal_parameters={}, fit=fit, noise_floor=NOISE,
        gap_closed=1.0, rivals=(), failed={}, next_experiment=None, channel="velocity", unit="rad/s", view="motion", seed=0,
        seconds=1.0, versions={}, recordings=recordings, traces=traces, notes=(),
    )  # fmt: skip


def opening(browser: Any, file: Path) -> dict[str, float]:
    """Seconds until a page is open: on the clock, and of the processor."""
    with browser.new_context(viewport={"width": 1400, "height": 900}) as window:
        page = window.new_page()
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable", {"timeDomain": "threadTicks"})
        began = time.perf_counter()
        page.goto(file.as_uri())
        page.wait_for_selector(".plot.on .gd svg")
        page.evaluate("new Promise((done) => requestIdleCallback(done))")
        clock = time.perf_counter() - began
        metrics = {m["name"]: m["value"] for m in session.send("Performance.getMetrics")["metrics"]}
    return {"clock": clock, "processor": metrics["TaskDuration"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="Length of each recording.")
    parser.add_argument("--rate", type=float, default=2000.0, help="Samples a second.")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--film", type=Path, help="A film (mp4) to put into the report.")
    parser.add_argument("--out", type=Path, help="Keep the page here.")
    given = parser.parse_args()
    from playwright.sync_api import sync_playwright

    path = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    with tempfile.TemporaryDirectory() as folder:
        file = given.out or Path(folder) / "report.html"
        film = Film("held_out.csv", 0.0, 4.0, given.film.read_bytes(), "The model.") if given.film else None
        write_report(diagnosis(given.seconds, 1 / given.rate), file, film=film)
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
            taken = [opening(browser, file) for _ in range(given.repeats)]
            version = browser.version
            browser.close()
        size = file.stat().st_size / 1e6
    middle = {k: round(statistics.median(t[k] for t in taken), 2) for k in ("clock", "processor")}
    print(json.dumps({"megabytes": round(size, 2), "open_s": middle, "chromium": version, "bars": BARS}))


if __name__ == "__main__":
    main()
