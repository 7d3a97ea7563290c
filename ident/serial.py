"""Save an identification as JSON and load it back; the schema is that of ``identification.json``."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ident.bode import Bode, bode
from ident.estimate import Estimate
from ident.model import PolyModel
from ident.polezero import Root, pole_zero
from ident.quality import quality
from ident.residuals import ResidualTests, residual_tests
from ident.structure import Structure
from mjsim.errors import InputError, writing

__all__ = ["from_json", "load", "model_from_dict", "model_to_dict", "save", "to_dict", "write_atomic", "write_set"]


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


def _cleaned(values: dict[str, Any]) -> dict[str, Any]:
    return {k: _clean(v) for k, v in values.items()}


def model_to_dict(model: PolyModel) -> dict[str, Any]:
    """Structure, orders, dt, polynomials, noise variance, standard errors and covariance; numbers keep every bit."""
    out: dict[str, Any] = {"structure": model.structure.name, "orders": list(model.structure.listed), "dt": model.dt}
    out |= {name: getattr(model, name) for name in "ABCDF"}
    out |= {"noise_variance": model.noise_variance, "std": model.std, "covariance": model.covariance}
    return _cleaned(out)


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
    return _cleaned(
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


def _root(r: Root) -> dict[str, Any]:
    return {
        "re": r.z.real,
        "im": r.z.imag,
        "covariance": r.covariance,
        "frequency_hz": r.frequency_hz,
        "frequency_std_hz": r.frequency_std_hz,
        "damping": r.damping,
        "damping_std": r.damping_std,
    }


def to_dict(estimate: Estimate, tests: ResidualTests | None = None, response: Bode | None = None) -> dict[str, Any]:
    """Everything that ``identification.json`` holds; ``response``: on which frequencies, default three decades up to Nyquist."""
    tests = tests or residual_tests(estimate)
    q = quality(estimate)
    response = response or bode(estimate.model)
    low, high = response.magnitude_db_interval()
    roots = pole_zero(estimate.model)
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
        "poles": [_root(r) for r in roots.poles],
        "zeros": [_root(r) for r in roots.zeros],
        "input": {"name": estimate.data.u_name, "unit": estimate.data.u_unit},
        "output": {"name": estimate.data.y_name, "unit": estimate.data.y_unit},
        "source": estimate.data.source,
        "seconds": estimate.seconds,
    }
    return _cleaned(out)


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write under a temporary name beside ``path``, then rename: nothing half-written stays under the final name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with writing(path):
            temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_set(contents: Mapping[Path, str | bytes]) -> None:
    """Write files that belong together: all of them, or none.

    Every file is written under a temporary name beside its place first, then all are renamed. What stood there before is moved
    aside and comes back when anything fails, Ctrl-C included; folders that were made are then taken away again. Raises OSError.
    """
    tag = f"{os.getpid()}"
    staged: list[tuple[Path, Path]] = []
    aside: list[tuple[Path, Path]] = []
    placed: list[Path] = []
    made: list[Path] = []
    try:
        for path, content in contents.items():
            missing = [p for p in (path.parent, *path.parent.parents) if not p.exists()]
            path.parent.mkdir(parents=True, exist_ok=True)
            made += reversed(missing)
            temporary = path.with_name(f".{path.name}.{tag}.part")
            staged.append((temporary, path))
            with writing(path):
                temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        for temporary, path in staged:
            if path.exists():
                old = path.with_name(f".{path.name}.{tag}.old")
                aside.append((old, path))
                path.replace(old)
            placed.append(path)
            temporary.replace(path)
    except BaseException:
        for path in placed:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
        for old, path in aside:
            with contextlib.suppress(OSError):
                old.replace(path)
        for temporary, _ in staged:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
        for folder in reversed(made):
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise
    for old, _ in aside:
        with contextlib.suppress(OSError):
            old.unlink()


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
