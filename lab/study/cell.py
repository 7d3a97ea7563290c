"""One cell of the study: a case, an experiment and a pipeline make a log, a model and its features."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from lab.study.pipeline import FAITHFUL, Pipeline
from lab.study.plants import FEATURE_NAMES, PLANTS, Plant, build
from mjsim.errors import InputError

__all__ = ["DT", "GRID_HZ", "Cell", "Experiment", "Feature", "Result", "analyse", "band", "features_of", "log", "run_cell"]

DT = 5e-4
"""Sampling interval of the logs [s]."""
LOW_HZ = 0.5
_DENSE_HZ = np.geomspace(0.4, 99.0, 6000)
GRID_HZ = _DENSE_HZ[(_DENSE_HZ >= 0.5) & (_DENSE_HZ <= 60.0)][::8]
"""Frequencies [Hz] at which a cell keeps its response."""
ENGINES = ("accurate", "ode", "literal")


@dataclass(frozen=True)
class Experiment:
    """Chirp of ``amplitude`` [Nm] from 0.5 to ``high_hz`` over ``duration`` [s]; white ``noise`` [rad/s] on the velocity.

    ``engine``: accurate (MuJoCo that lands on events), literal (plain MuJoCo on the file), ode (analytic).
    """

    amplitude: float = 2.0
    duration: float = 20.0
    high_hz: float = 30.0
    noise: float = 0.01
    seed: int = 1
    engine: str = "ode"


@dataclass(frozen=True)
class Cell:
    """What is computed once and kept under the hash of these inputs."""

    plant: str
    experiment: Experiment
    pipeline: Pipeline = FAITHFUL

    def inputs(self) -> dict[str, Any]:
        """Everything that the result follows from, as plain values."""
        return {
            "plant": dataclasses.asdict(PLANTS[self.plant]),
            "experiment": dataclasses.asdict(self.experiment),
            "pipeline": {k: v for k, v in dataclasses.asdict(self.pipeline).items() if k != "name"},
        }


@dataclass(frozen=True)
class Feature:
    """A peak or notch of the magnitude: frequency [Hz], magnitude [dB re rad/s/Nm]."""

    hz: float
    db: float


@dataclass(frozen=True)
class Result:
    """What a cell found; ``void`` says why there is nothing, else it is empty.

    features: by name, None where the model has none. low_db: mean magnitude over 1 to 3 Hz [dB]. second_mode_hz: natural
    frequency [Hz] of the pole pair nearest the second peak's place, or None. zero_real: real part [rad/s] of the zero pair at the
    first notch (positive: non-minimum phase), or None. magnitude_db, phase_deg: on GRID_HZ. simulation_percent: NRMSE fit.
    """

    void: str = ""
    features: Mapping[str, Feature | None] = dataclasses.field(default_factory=dict)
    low_db: float = float("nan")
    second_mode_hz: float | None = None
    zero_real: float | None = None
    magnitude_db: tuple[float, ...] = ()
    phase_deg: tuple[float, ...] = ()
    simulation_percent: float = float("nan")
    search: str = ""
    seconds: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        out = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        out["features"] = {k: None if v is None else [v.hz, v.db] for k, v in self.features.items()}
        return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in out.items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Result:
        """Inverse of `to_dict`."""
        known = dict(values)
        known["features"] = {k: None if v is None else Feature(*v) for k, v in values["features"].items()}
        for key in ("magnitude_db", "phase_deg"):
            known[key] = tuple(values[key])
        for key in ("low_db", "simulation_percent"):
            known[key] = float("nan") if values[key] is None else values[key]
        return cls(**known)


def log(plant: Plant, e: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """Commanded torque [Nm] and measured velocity [rad/s] at 2000 Hz, noise included, each (N,)."""
    from mjsim.excitation import chirp

    torque = chirp(e.duration, DT, e.amplitude * plant.torque_share, LOW_HZ, e.high_hz)
    clean = _run(plant, e.engine, torque)
    white = np.random.default_rng(e.seed).standard_normal(torque.size)
    return torque, clean + e.noise * white


def _run(plant: Plant, engine: str, torque: np.ndarray) -> np.ndarray:
    if engine == "ode":
        from mjsim import ode

        return np.asarray(ode.simulate(build(plant), torque, DT).velocity)
    if engine == "accurate":
        from mjsim import accurate

        return np.asarray(accurate.simulate(build(plant), torque, DT).velocity)
    if engine == "literal":
        from mjsim.mujoco_run import run_signals

        if plant.effects or plant.linear:
            raise ValueError(f"the literal model is the linear one, not {plant.id!r}")
        return np.asarray(run_signals(_literal(), torque, DT).velocity)
    raise ValueError(f"engine {engine!r}; choose from {', '.join(ENGINES)}")


@cache
def _literal() -> Any:
    from mjsim.mjcf import load_model
    from mjsim.models import shipped_model

    return load_model(shipped_model("robot_axis1"))


def run_cell(cell: Cell) -> Result:
    """Simulate, filter, fit, read off."""
    began = time.perf_counter()
    torque, velocity = log(PLANTS[cell.plant], cell.experiment)
    if float(np.sqrt(np.mean(velocity**2))) < 0.02 * float(np.max(np.abs(torque))) + 2 * cell.experiment.noise:
        return Result(void="the motor hardly breaks away at this torque")
    found = analyse(torque, velocity, DT, cell.pipeline, cell.plant)
    return dataclasses.replace(found, seconds=time.perf_counter() - began)


def analyse(torque: np.ndarray, velocity: np.ndarray, dt: float, pipeline: Pipeline, source: str) -> Result:
    """Filter, fit and read off; data that cannot carry the model make a void result."""
    from ident import bode, quality

    try:
        estimate = pipeline.fit(pipeline.prepare(torque, velocity, dt, source))
    except InputError as error:
        return Result(void=str(error))
    model = estimate.model
    dense = _DENSE_HZ[: int(np.searchsorted(_DENSE_HZ, 0.495 / model.dt))]
    response = bode(dataclasses.replace(model, covariance=None), dense)
    keep = np.searchsorted(dense, GRID_HZ)
    magnitude, phase = response.magnitude_db, response.phase_deg
    low = band(dense, 1.0, 3.0)
    zero = _root_near(model.zeros, model.dt, 8.0, 22.0)
    mode = _root_near(model.poles, model.dt, 29.0, 60.0)
    return Result(
        features=features_of(response.extrema()),
        low_db=float(np.mean(magnitude[low])),
        second_mode_hz=None if mode is None else abs(mode) / (2 * np.pi),
        zero_real=None if zero is None else float(zero.real),
        magnitude_db=tuple(np.round(magnitude[keep], 4).tolist()),
        phase_deg=tuple(np.round(phase[keep], 3).tolist()),
        simulation_percent=quality(estimate).simulation_percent,
        search=estimate.status.value,
    )


def band(frequency_hz: np.ndarray, low: float, high: float) -> np.ndarray:
    """Which of the frequencies lie within [low, high] Hz."""
    return np.asarray((frequency_hz >= low) & (frequency_hz <= high))


def _root_near(roots: np.ndarray, dt: float, low: float, high: float) -> complex | None:
    """The least damped root whose natural frequency lies within [low, high] Hz, as s = log(z) / dt."""
    s = np.log(roots[np.abs(roots) > 1e-9].astype(complex)) / dt
    inside = s[(np.abs(s) >= 2 * np.pi * low) & (np.abs(s) <= 2 * np.pi * high) & (s.imag > 0)]
    return complex(inside[np.argmin(np.abs(inside.real))]) if inside.size else None


def features_of(extrema: Any) -> dict[str, Feature | None]:
    """Name the extrema: the deepest notch in 8 to 22 Hz, the highest peak up to 29 Hz, then a notch and a peak up to 60 Hz."""
    out: dict[str, Feature | None] = dict.fromkeys(FEATURE_NAMES)

    def best(kind: str, low: float, high: float) -> Feature | None:
        there = [e for e in extrema if e.kind == kind and low < e.frequency_hz < high]
        if not there:
            return None
        pick = max(there, key=lambda e: e.magnitude_db if kind == "peak" else -e.magnitude_db)
        return Feature(pick.frequency_hz, pick.magnitude_db)

    out["first_notch"] = best("notch", 8.0, 22.0)
    out["first_peak"] = best("peak", out["first_notch"].hz if out["first_notch"] else 18.0, 29.0)
    out["second_notch"] = best("notch", out["first_peak"].hz if out["first_peak"] else 24.0, 45.0)
    out["second_peak"] = best("peak", out["second_notch"].hz if out["second_notch"] else 30.0, 60.0)
    return out
