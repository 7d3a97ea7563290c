"""The whole study: cells, ledger, figures, pages."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lab.study import figures as fig
from lab.study.cell import DT, GRID_HZ, Cell, Experiment, Result, band, log
from lab.study.claims import Group, physical_features
from lab.study.damping import DampingStudy, study_damping
from lab.study.ledger import Entry, claims_json, ledger
from lab.study.page import page_html, page_markdown
from lab.study.pipeline import BETTER, FAITHFUL, LADDER
from lab.study.plants import PLANTS, nominal, response
from lab.study.robot import Robot, RobotResult, recorded_robot, robot_models, surrogate_robot
from lab.study.store import Store, compute, stamp
from lab.study.study import Study
from lab.study.variants import BASE, BASE_BETTER, cells, robustness_map
from mjsim.errors import InputError

__all__ = ["run_study"]

_SEEDS = (1, 2, 3, 4, 5)
COLUMN_TITLES = (
    "as published: chirp to 30 Hz, 5 ms,\nlow-pass 40 Hz, [5 5 5 5 1]",
    "better: chirp to 45 Hz, 2.5 ms,\nno low-pass, [7 5 5 6 0]",
)


def run_study(
    out: Path,
    *,
    jobs: int = 1,
    recording: Path | None = None,
    quick: bool = False,
    say: Callable[[str, int, int], None] = lambda text, done, total: None,
) -> Study:
    """Compute what is missing, judge, write figures, claims.json and the ledger's pages into ``out``; ``say`` follows."""
    began = time.perf_counter()
    if out.exists() and not out.is_dir():
        raise InputError(out, "it is a file", "a folder", "choose another --out")
    given = recorded_robot(recording) if recording else None
    variants = robustness_map(quick)
    seeds = _SEEDS[:2] if quick else _SEEDS
    steps = {(text, s): Cell("linear", Experiment(high_hz=high, seed=s), p) for text, p, high in LADDER for s in seeds}
    wanted = list(dict.fromkeys([*cells(variants), *steps.values()]))
    store = Store(out / "cells", stamp())
    store.open()
    known = sum(store.path(c.inputs()).is_file() for c in wanted)
    say("figure 4", 0, 0)
    robot, robot_results = _robot(store, given)  # first, for a recording may be unusable

    def tick(done: int) -> None:
        say("simulate, filter, fit", done, len(wanted))

    results = compute(wanted, store, jobs, tick)
    say("interpretations of the negative damping", 0, 0)
    damping = _damping(store, quick)
    say("figures and pages", 0, 0)
    groups = {v: {p: results[v.cell(p)] for p in PLANTS} for v in variants}
    entries = ledger(groups)
    ladder = _ladder({k: results[c] for k, c in steps.items()}, len(seeds))
    claims = claims_json(entries, {"L2": {"damping": damping.to_dict()}, "L1": _peak_gain(ladder)})
    pictures = _pictures(groups[BASE], groups[BASE_BETTER], entries, ladder, damping, robot, robot_results)
    study = Study(
        entries, groups[BASE], groups[BASE_BETTER], ladder, damping, robot, robot_results, pictures, claims, len(wanted),
        len(wanted) - known, quick, time.perf_counter() - began,
    )  # fmt: skip
    _write(study, out)
    return study


def _damping(store: Store, quick: bool) -> DampingStudy:
    source = (Path(__file__).parent / "damping.py").read_text(encoding="utf-8")
    kept = store.remember({"damping": quick, "code": source}, lambda: dataclasses.asdict(study_damping(quick)))
    return DampingStudy.from_plain(json.loads(json.dumps(kept)))


def _robot(store: Store, given: Robot | None) -> tuple[Robot, tuple[RobotResult, ...]]:
    """The robot of figure 4 and its models, as published and better."""
    robots = (given, given) if given is not None else (surrogate_robot(30.0), surrogate_robot(45.0))
    out = []
    code = (Path(__file__).parent / "robot.py").read_text(encoding="utf-8")
    for robot, pipeline in zip(robots, (FAITHFUL, BETTER), strict=True):

        def work(robot: Robot = robot, pipeline: Any = pipeline) -> dict[str, Any]:
            return robot_models(robot, (pipeline,))[0].to_dict()

        out.append(RobotResult.from_dict(store.remember({"robot": robot.key, "pipeline": pipeline.name, "code": code}, work)))
    return robots[0], tuple(out)


def _error(result: Result, top_hz: float) -> float:
    """rms(G_hat - G) / rms(G) over 1 Hz to top, flat in frequency, against the linear model with its torque held at 2000 Hz."""
    if result.void:
        return float("nan")
    found = 10 ** (np.asarray(result.magnitude_db) / 20) * np.exp(1j * np.radians(result.phase_deg))
    inside = band(GRID_HZ, 1.0, top_hz)
    exact = response(nominal(), GRID_HZ) * np.sinc(GRID_HZ * DT) * np.exp(-1j * np.pi * GRID_HZ * DT)  # the hold
    weight = GRID_HZ[inside]  # a log grid, so df goes with f
    off = np.sum(weight * np.abs(found - exact)[inside] ** 2) / np.sum(weight * np.abs(exact[inside]) ** 2)
    return float(np.sqrt(off))


def _ladder(results: Mapping[tuple[str, int], Result], seeds: int) -> tuple[Mapping[str, Any], ...]:
    from lab.study.damping import second_mode_hz

    rows = []
    for text, _, high in LADDER:
        group = [results[text, s] for s in _SEEDS[:seeds]]
        peaks = [None if (f := r.features.get("second_peak")) is None else f.hz for r in group]
        rows.append(
            {
                "step": text,
                "high_hz": high,
                "peak_hz": peaks,
                "mode_hz": [r.second_mode_hz for r in group],
                "error_30": float(np.median([_error(r, 30.0) for r in group])),
                "error_36": float(np.median([_error(r, 36.0) for r in group])),
                "simulation_percent": float(np.median([r.simulation_percent for r in group])),
                "exact_mode_hz": second_mode_hz(),
            }
        )
    return tuple(rows)


def _peak_gain(ladder: tuple[Mapping[str, Any], ...]) -> dict[str, Any]:
    """How far the second peak is off before and after."""
    exact = physical_features()["second_peak"].hz

    def off(row: Mapping[str, Any]) -> float | None:
        there = [abs(p - exact) for p in row["peak_hz"] if p is not None]
        return float(np.median(there)) if there else None

    return {
        "exact_second_peak_hz": exact,
        "exact_second_mode_hz": ladder[0]["exact_mode_hz"],
        "second_peak_off_hz_by_step": {r["step"]: off(r) for r in ladder},
        "error_1_36_hz_by_step": {r["step"]: r["error_36"] for r in ladder},
    }


def _pictures(
    base: Group,
    better: Group,
    entries: tuple[Entry, ...],
    ladder: tuple[Mapping[str, Any], ...],
    damping: DampingStudy,
    robot: Robot,
    robot_results: tuple[RobotResult, ...],
) -> tuple[fig.Picture, ...]:
    exact = ("linear, exact", response(nominal(), GRID_HZ))
    torque, velocity = log(PLANTS["linear"], BASE.cell("linear").experiment)
    data = FAITHFUL.prepare(torque, velocity, DT, "figure 3")
    note = "2 Nm, 20 s, velocity noise 0.01 rad/s, simulated in MuJoCo"

    def both(*lines: tuple[str, str, Any]) -> tuple[tuple[str, float, list[fig.Curve]], ...]:
        return tuple(
            (title, high, [fig.Curve(label, group[plant], style) for plant, label, style in lines])
            for title, high, group in zip(COLUMN_TITLES, (30.0, 45.0), (base, better), strict=True)
        )

    highs = [_top(robot.torque, robot.dt)] * 2 if not robot.truth else [30.0, 45.0]
    titles = COLUMN_TITLES if robot.truth else ("as published: 5 ms, low-pass 40 Hz, [5 5 5 5 1]", "better: 2.5 ms, [7 5 5 6 0]")
    fourth = tuple(
        (t, h, [fig.Curve("Box-Jenkins model of the simulated model", r.model, "-", "0.6", 1.8),
                fig.Curve("of the " + robot.label, r.robot, "-", "black", 1.1)])
        for t, h, r in zip(titles, highs, robot_results, strict=True)
    )  # fmt: skip
    return (
        fig.time_figure(
            "figure3", "Figure 3. Input and output of the linear model (plain MuJoCo), decimated to 5 ms and low-passed",
            data.time, np.asarray(data.u), np.asarray(data.y),
        ),
        fig.bode_figure(
            "figure4", "Figure 4. Robot against simulated model", fourth,
            "The robot is a surrogate, simulated with concealed parameters: no IRB1400 was measured" if robot.truth else "",
        ),
        fig.bode_figure(
            "figure5", "Figure 5. Coulomb friction",
            both(("linear", "linear", "-"), ("coulomb_1", "case 1: 0.0355 Nm", fig.DASH),
                 ("coulomb_2", "case 2: 0.1 Nm", fig.DOT), ("coulomb_3", "case 3: 0.355 Nm", fig.DASH_DOT)), note, exact,
        ),
        fig.bode_figure(
            "figure6", "Figure 6. Static friction on case 2",
            both(("coulomb_2", "peak = 1", "-"), ("static_2", "peak = 2", fig.DOT), ("static_5", "peak = 5", fig.DASH)),
            note, exact,
        ),
        fig.bode_figure(
            "figure7", "Figure 7. Backlash b in the gearbox",
            both(("linear", "no backlash", "-"), ("gap_1", "b = 0.0001 rad", fig.DASH), ("gap_5", "b = 0.0005 rad", fig.DOT),
                 ("gap_10", "b = 0.001 rad", fig.DASH_DOT)), note, exact,
        ),
        fig.bode_figure(
            "figure8", "Figure 8. Less input torque at a backlash of 0.0001 rad",
            both(("gap_1", "100 % torque", "-"), ("torque_50", "50 % torque", fig.DASH), ("torque_20", "20 % torque", fig.DOT)),
            note, exact,
        ),
        fig.ladder_figure("figure9_second_peak", "The second peak, from the report's pipeline to the better one", ladder),
        fig.map_figure("figure10_robustness", "Claims over amplitude, duration, band, engine, order and noise", entries),
        fig.damping_figure("figure11_damping", "A shift between the logged channels, taken for damping", damping),
    )  # fmt: skip


def _top(torque: np.ndarray, dt: float) -> float:
    """Frequency [Hz] below which lie 99.9 % of a torque's power."""
    power: np.ndarray = np.cumsum(np.abs(np.fft.rfft(torque - torque.mean())) ** 2)
    return float(np.fft.rfftfreq(torque.size, dt)[int(np.searchsorted(power, 0.999 * power[-1]))])


def _write(study: Study, out: Path) -> None:
    from ident.serial import write_set

    contents: dict[Path, str | bytes] = {}
    for picture in study.pictures:
        contents |= fig.files(picture, out)
    if study.robot.truth:
        contents[out / "figure4_truth.json"] = json.dumps(study.robot.truth, indent=1) + "\n"
    images = {p.stem: c for p, c in contents.items() if p.suffix == ".png" and isinstance(c, bytes)}
    contents |= {
        out / "study.md": page_markdown(study),
        out / "study.html": page_html(study, images),
        out / "claims.json": json.dumps(study.claims, indent=1) + "\n",
    }
    try:
        write_set(contents)
    except OSError as error:
        raise InputError(out, f"cannot be written ({error.strerror})", "a writable folder") from None
