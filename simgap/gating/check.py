"""What a gate compares, and the baseline that it compares with."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from diagnose.data.listed import holds_of
from mjsim.errors import InputError, nearest_file

__all__ = ["ROLES", "Baseline", "Check", "of_the_baseline", "ratio_of", "read_baseline"]

ROLES = ("estimation", "held-out")


@dataclass(frozen=True)
class Check:
    """One comparison: rms error of the model on some recordings, that of the baseline [``unit``], their ratio.

    ``role``: what the baseline used these recordings for. ``grew``: ratio above 1 + tolerance, or no finite run. ``joint``: of
    a robot.
    """

    recordings: tuple[str, ...]
    role: str
    rms: float
    baseline_rms: float
    ratio: float
    grew: bool
    unit: str
    joint: str | None = None


@dataclass(frozen=True)
class Baseline:
    """Figures of a diagnosis.json.

    rms: of each role, of an axis; joints: of a robot, of each joint the rms by (SHA-256, role), where the joint moves; roles: of
    each recording, by its SHA-256; by_mujoco: whether the figures are of the file as MuJoCo steps it; holds: how the input of
    each goes between samples, by its SHA-256.
    """

    path: Path
    rms: Mapping[str, float]
    joints: Mapping[str, Mapping[tuple[str, str], float]]
    roles: Mapping[str, tuple[str, ...]]
    view: str
    unit: str
    by_mujoco: bool
    holds: Mapping[str, str] = field(default_factory=dict)

    @property
    def robot(self) -> bool:
        """Whether it is the diagnosis of a robot."""
        return bool(self.joints)


def read_baseline(path: Path, against: str) -> Baseline:
    """Figures of the ``against`` ("nominal" | "corrected") model in a diagnosis.json. Raises InputError."""
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        advice = nearest_file(path, ".json", advice="check --baseline")
        raise InputError(path, "no such file", "the diagnosis.json of simgap diagnose", advice) from None
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"not valid JSON ({error})", "the diagnosis.json of simgap diagnose", "check it") from None
    try:
        return _baseline(path, told, against)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            path, f"not a diagnosis with figures of the {against} model ({type(error).__name__}: {error})",
            "the diagnosis.json of simgap diagnose", "run simgap diagnose again",
        ) from None  # fmt: skip


def _baseline(path: Path, told: Mapping[str, Any], against: str) -> Baseline:
    fit, on = told["fit"][against], told["judged_on"]
    rms = {"estimation": _figure(fit["rms"]), "held-out": _figure(fit["held_out_rms"])}
    roles: dict[str, tuple[str, ...]] = {}
    for r in told["recordings"]:
        digest, role = str(r["sha256"]), _role(r)
        if role not in ROLES:
            raise ValueError(f"role {role!r}")
        roles[digest] = tuple(dict.fromkeys((*roles.get(digest, ()), role)))
    listed = [(str(r["sha256"]), str(r["file"])) for r in told["recordings"]]
    joints = {str(name): _rows(rows, listed, against) for name, rows in told.get("closed_loop", {}).get("joints", {}).items()}
    view = "force" if str(on["view"]).startswith("force") else "motion"
    return Baseline(path, rms, joints, roles, view, str(on["unit"]), view == "motion" and "surrogate" in told["fit"],
                    holds_of(told["recordings"]))  # fmt: skip


def _role(told: Mapping[str, Any]) -> str:
    """Role of a recording; a robot's diagnosis of an earlier version has an underscore."""
    return str(told["role"]).replace("_", "-")


def _rows(rows: Sequence[Mapping[str, Any]], listed: Sequence[tuple[str, str]], against: str) -> dict[tuple[str, str], float]:
    """Figures of one joint by recording and role; rows stand in the order of the recordings, of which some may have none."""
    there = {str(row["file"]) for row in rows}
    digests = [digest for digest, file in listed if file in there]
    return {
        (digest, _role(row)): _figure(row[f"{against}_rms"])
        for digest, row in zip(digests, rows, strict=True) if row["moves"]
    }  # fmt: skip


def _figure(value: Any) -> float:
    """A figure of the JSON; null stands for one that is not finite."""
    return math.inf if value is None else float(value)


def of_the_baseline(source: str, sha256: str, known: Baseline) -> tuple[str, ...]:
    """Roles of a recording in the baseline. Raises InputError for one that is not there: another motion has another error."""
    if sha256 not in known.roles:
        raise InputError(
            source, f"not one of the recordings of {known.path}, by its SHA-256", "a recording that the baseline used",
            "run simgap diagnose with it for a new baseline",
        )  # fmt: skip
    return known.roles[sha256]


def ratio_of(rms: float, before: float) -> float:
    """Rms over that of the baseline; 0 where the baseline has no finite error and the model does."""
    if before > 0 and math.isfinite(before):
        return rms / before
    return 0.0 if math.isfinite(rms) else math.inf
