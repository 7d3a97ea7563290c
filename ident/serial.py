"""Save an identification as JSON and load it back; the schema is that of ``identification.json``."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from ident.bode import bode
from ident.estimate import Estimate
from ident.model import PolyModel
from ident.quality import quality
from ident.residuals import ResidualTests, residual_tests
from ident.structure import Structure
from mjsim.errors import InputError

__all__ = ["from_json", "load", "model_from_dict", "model_to_dict", "save", "to_dict", "write_atomic"]


def _clean(value: Any) -> Any:
    """Plain JSON values; numbers that are not finite become null."""
    if isinstance(value, dict):
        return {k: _clean(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_clean(v) for v in value]
    if isinstance(value, (np.bool_, bool)):
        return bool(value)
    if isinstance(value, (np.integer, int)):
        return int(value)
    if isinstance(value, (np.floating, float)):
        return float(value) if np.isfinite(value) else None
    return value


def model_to_dict(model: PolyModel) -> dict[str, Any]:
    """Structure, orders, dt, polynomials, noise variance, standard errors and covariance; numbers keep every bit."""
    out: dict[str, Any] = {"structure": model.structure.name, "orders": list(model.structure.listed), "dt": model.dt}
    out |= {name: getattr(model, name) for name in "ABCDF"}
    out |= {"noise_variance": model.noise_variance, "std": model.std, "covariance": model.covariance}
    return _clean(out)


def model_from_dict(values: dict[str, Any], where: str = "identification") -> PolyModel:
    """Inverse of ``model_to_dict``; InputError names a missing or unusable key."""
    try:
        structure = Structure.from_listed(values["structure"], values["orders"])
        covariance = values.get("covariance")
        a, b, c, d, f = (np.asarray(values.get(n, [1.0]) if n == "A" else values[n], float) for n in "ABCDF")
        p = None if covariance is None else np.asarray(covariance, float)
        return PolyModel(structure, float(values["dt"]), a, b, c, d, f, float(values["noise_variance"]), p)
    except KeyError as error:
        raise InputError(where, f"the key {error} is missing", "structure, orders, dt, B, C, D, F, noise_variance") from None
    except (TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(where, f"a value has the wrong type ({error})", "numbers and lists of numbers") from None


def tests_to_dict(t: ResidualTests) -> dict[str, Any]:
    """Residual tests as plain values."""
    return _clean(
        {
            "lags": t.lags,
            "level": t.level,
            "white": t.white,
            "whiteness_p": t.whiteness_p,
            "independent": t.independent,
            "independence_p": t.independence_p,
            "feedback": t.feedback,
            "feedback_p": t.feedback_p,
            "mean_p": t.mean_p,
            "auto_bound": t.auto_bound,
            "cross_bound": t.cross_bound,
            "autocorrelation": t.auto,
            "cross_correlation": t.cross,
        }
    )


def to_dict(estimate: Estimate, tests: ResidualTests | None = None) -> dict[str, Any]:
    """Everything that ``identification.json`` holds."""
    tests = tests or residual_tests(estimate)
    q = quality(estimate)
    response = bode(estimate.model)
    low, high = response.magnitude_db_interval()
    phase_low, phase_high = response.phase_deg_interval()
    out = model_to_dict(estimate.model) | {
        "fit_percent": q.fit_percent,
        "simulation_fit_percent": q.simulation_percent,
        "loss": q.loss,
        "fpe": q.fpe,
        "aic": q.aic,
        "bic": q.bic,
        "samples": len(estimate.data),
        "status": estimate.status.name.lower(),
        "advice": estimate.status.advice,
        "initial_condition": estimate.initial_condition.value,
        "residual_tests": tests_to_dict(tests),
        "bode": {
            "frequency_hz": response.frequency_hz,
            "magnitude_db": response.magnitude_db,
            "phase_deg": response.phase_deg,
            "magnitude_db_ci95": [low, high],
            "phase_deg_ci95": [phase_low, phase_high],
            "extrema": [
                {"kind": e.kind, "frequency_hz": e.frequency_hz, "magnitude_db": e.magnitude_db} for e in response.extrema()
            ],
        },
        "input": {"name": estimate.data.u_name, "unit": estimate.data.u_unit},
        "output": {"name": estimate.data.y_name, "unit": estimate.data.y_unit},
        "source": estimate.data.source,
        "seconds": estimate.seconds,
    }
    return _clean(out)


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write under a temporary name beside ``path``, then rename: nothing half-written stays under the final name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def save(estimate: Estimate | PolyModel, path: str | Path) -> None:
    """Write ``identification.json``: the whole schema for an estimate, the model's part for a bare model."""
    values = to_dict(estimate) if isinstance(estimate, Estimate) else model_to_dict(estimate)
    write_atomic(Path(path), json.dumps(values, indent=1) + "\n")


def from_json(text: str, where: str = "identification") -> PolyModel:
    """The model out of JSON text."""
    try:
        values = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(where, f"not JSON (line {error.lineno})", "an identification.json") from None
    if not isinstance(values, dict):
        raise InputError(where, "not an object", "an identification.json")
    return model_from_dict(values, where)


def load(path: str | Path) -> PolyModel:
    """The model out of an ``identification.json``."""
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "no such file", "an identification.json")
    return from_json(path.read_text(errors="replace"), str(path))
