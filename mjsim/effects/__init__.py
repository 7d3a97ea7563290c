"""The effects: one file each, on one registry.

Every module of this package is imported here, so that adding an effect is adding its file and nothing else. Take a class
from its own module (``from mjsim.effects.backlash import Backlash``) or by its identifier (``effect_class("backlash")``).
"""

import importlib
import pkgutil

from mjsim.effects.base import Effect, NotApplicableError, ParameterSpec, PlaceError, Scales
from mjsim.effects.ports import BacklashLaw
from mjsim.effects.registry import effect_class, register, registered

__all__ = [
    "BacklashLaw",
    "Effect",
    "NotApplicableError",
    "ParameterSpec",
    "PlaceError",
    "Scales",
    "effect_class",
    "register",
    "registered",
]

for _module in sorted(m.name for m in pkgutil.iter_modules(__path__)):
    importlib.import_module(f"{__name__}.{_module}")
