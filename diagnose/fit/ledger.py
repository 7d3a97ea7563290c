"""The ledger of fits: append-only, keyed by problem, structure and start; on disk, so that an interrupted diagnosis resumes.

The first line of the file is a hash of what every fit depends on (recordings, model, options, code); each other line is a fit
under the hash of its request, with a checksum. The search is deterministic: run again, it requests the same fits in the same
order, and known ones are read from the file. Residual and Jacobian are large and are computed again for the few fits that
others build on. A line is
written whole and flushed; a line that was cut off is dropped when the file is read.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.fit.least_squares import Fit, Status
from mjsim.axis import Axis
from mjsim.errors import writing
from mjsim.recording import Recording

__all__ = ["Entry", "Ledger", "checksum", "fingerprint"]

FORMAT = 2


@dataclass(frozen=True, eq=False)
class Entry:
    """A fit without its arrays: solution x (p,), cost, status, iterations, gain; n: samples; work: what it took."""

    x: np.ndarray
    cost: float
    status: Status
    iterations: int
    predicted_gain: float
    n: int
    work: int


def checksum(said: Mapping[str, Any]) -> str:
    """The first 16 digits of the SHA-256 of a line without its checksum."""
    rest = {k: v for k, v in said.items() if k != "check"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()[:16]


class Ledger:
    """Fits by the hash of their request, on disk.

    ``follows``: a hash of what every fit depends on; a file with another one is not used.
    """

    def __init__(self, path: Path, follows: str) -> None:
        self.path, self.follows = path, follows
        self._known: dict[str, Entry] = {}
        self._lock = threading.Lock()
        self._made: list[Path] = []
        self._ready = False
        self._open = True
        self._read()
        self.recalled = len(self._known)

    def _read(self) -> None:
        """Take what counts, and leave a file of whole lines only."""
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True)
        except (OSError, UnicodeDecodeError):
            return
        if not lines or _parsed(lines[0]) != {"format": FORMAT, "follows": self.follows}:
            return
        whole = [lines[0]]
        for line in lines[1:]:
            said = _parsed(line)
            try:
                if said["check"] != checksum(said):
                    continue
                self._known[said["key"]] = Entry(
                    np.array([float.fromhex(v) for v in said["x"]]), float.fromhex(said["cost"]), Status[said["status"]],
                    int(said["iterations"]), float.fromhex(said["gain"]), int(said["n"]), int(said["work"]),
                )  # fmt: skip
                whole.append(line)
            except (KeyError, TypeError, ValueError):
                continue
        if len(whole) < len(lines):
            self._replace("".join(whole))
        self._ready = True

    def recall(self, key: str) -> Entry | None:
        """What is known under a key."""
        return self._known.get(key)

    def keep(self, key: str, fit: Fit, n: int, work: int) -> None:
        """Write a fit down."""
        known = Entry(fit.x, fit.cost, fit.status, fit.iterations, fit.predicted_gain, n, work)
        said = {
            "key": key, "x": [float(v).hex() for v in fit.x], "cost": float(fit.cost).hex(), "status": fit.status.name,
            "iterations": fit.iterations, "gain": float(fit.predicted_gain).hex(), "n": n, "work": work,
        }  # fmt: skip
        with self._lock, writing(self.path):
            if not self._open or key in self._known:
                return
            self._known[key] = known
            if not self._ready:
                self._begin()
            with self.path.open("a", encoding="utf-8") as handle:
                handle.write(json.dumps(said | {"check": checksum(said)}) + "\n")

    def _begin(self) -> None:
        """The folder and the first line."""
        missing = [p for p in self.path.parents if not p.exists()]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._made = missing
        self._replace(json.dumps({"format": FORMAT, "follows": self.follows}) + "\n")
        self._ready = True

    def _replace(self, text: str) -> None:
        """Write the whole file, beside its name first."""
        part = self.path.with_name(f".{self.path.name}.part")
        try:
            part.write_text(text, encoding="utf-8")
            os.replace(part, self.path)
        finally:
            part.unlink(missing_ok=True)

    @property
    def size(self) -> int:
        """Number of fits that are known."""
        return len(self._known)

    def close(self) -> None:
        """Write no more."""
        with self._lock:
            self._open = False

    def discard(self) -> None:
        """Remove the file, and the folders that were made for it as far as they are empty."""
        self.close()
        self.path.unlink(missing_ok=True)
        for folder in self._made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def _parsed(line: str) -> dict[str, Any]:
    try:
        said = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return said if isinstance(said, dict) else {}


def fingerprint(nominal: Axis, recordings: Iterable[Recording], *options: object) -> str:
    """Hash of what every fit depends on: the axis, the samples as read, the options, the code and the libraries."""
    from importlib.metadata import version

    import diagnose
    import mjsim

    digest = hashlib.sha256(repr((nominal, options)).encode())
    for r in recordings:
        digest.update(repr((r.sha256, r.dt, r.judge, r.loop, r.varies)).encode())
        arrays = (r.time, r.torque, r.velocity, r.angle, r.second_angle, r.second_velocity, r.command, r.known_torque)
        for a in arrays:
            digest.update(b"-" if a is None else np.ascontiguousarray(a).tobytes())
    for package in (mjsim, diagnose):
        root = Path(str(package.__file__)).parent
        for path in sorted(p for p in root.rglob("*.py") if "report" not in p.parts and "render" not in p.parts):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    for name in ("numpy", "scipy", "numba", "mujoco"):
        digest.update(version(name).encode())
    return digest.hexdigest()
