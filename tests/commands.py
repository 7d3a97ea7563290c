"""Commands as processes of their own, a short recording for them, and what a refusal is; in process: the fixture `simgap`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from simgap import cli

__all__ = ["ROOT", "command", "recording", "refused"]

ROOT = Path(cli.__file__).resolve().parent.parent
N = 600
TIME = 5e-4 * np.arange(N)


def recording(path: Path, velocity: str = "velocity_rad_s") -> Path:
    rng = np.random.default_rng(0)
    table = np.column_stack([TIME, np.sin(40 * TIME), 10 * np.sin(40 * TIME) + 0.01 * rng.standard_normal(N), -np.cos(40 * TIME)])
    np.savetxt(path, table, delimiter=",", header=f"time_s,torque_Nm,{velocity},angle_rad", comments="", fmt="%.9g")
    return path


def command(*words: str, **more: object) -> subprocess.Popen[str]:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])} | dict(more.pop("env", {}))  # type: ignore[call-overload]
    return subprocess.Popen([sys.executable, "-m", "simgap", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                            env=environment, **more)  # type: ignore[call-overload, no-any-return]  # fmt: skip


def refused(outcome: tuple[int, str, str], *parts: str) -> None:
    """Exit 2 and one line that holds the parts."""
    code, _, err = outcome
    assert code == 2, err
    assert "Traceback" not in err
    assert len(err.splitlines()) == 1
    for part in parts:
        assert part in err
