"""simgap: where a robot simulation and its recording differ, and which physics was left out.

`load` a recording, `check` it, `diagnose` it against a `Model`; `identify` a Box-Jenkins model of it; `simulate` a model;
`effects` are those that a diagnosis can name. Names are loaded when they are asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mjsim.errors import InputError
    from mjsim.recording import Recording
    from mjsim.robot.recording import RobotRecording
    from simgap.api.checking import check
    from simgap.api.diagnosing import Diagnosis, diagnose
    from simgap.api.identifying import Identification, identify
    from simgap.api.library import effects
    from simgap.api.model import Model
    from simgap.api.recording import load
    from simgap.api.simulating import simulate

__all__ = [
    "Diagnosis",
    "Identification",
    "InputError",
    "Model",
    "Recording",
    "RobotRecording",
    "__version__",
    "check",
    "diagnose",
    "effects",
    "identify",
    "load",
    "simulate",
]

__version__ = "0.1.0"

_WHERE = {
    "Diagnosis": "simgap.api.diagnosing",
    "Identification": "simgap.api.identifying",
    "InputError": "mjsim.errors",
    "Model": "simgap.api.model",
    "Recording": "mjsim.recording",
    "RobotRecording": "mjsim.robot.recording",
    "check": "simgap.api.checking",
    "diagnose": "simgap.api.diagnosing",
    "effects": "simgap.api.library",
    "identify": "simgap.api.identifying",
    "load": "simgap.api.recording",
    "simulate": "simgap.api.simulating",
}


def __getattr__(name: str) -> object:
    if name not in _WHERE:
        from mjsim.errors import nearest

        raise AttributeError(
            f"module 'simgap' has no attribute {name!r}; {nearest(name, __all__, 'dir(simgap) lists the names')}"
        )
    value = getattr(importlib.import_module(_WHERE[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
