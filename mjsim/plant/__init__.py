"""Plants: one interface to what a model does on an input, whoever integrates it."""

from mjsim.plant.base import Hold, Linear, Parameter, Plant, Side, Signal, Site, Start, check_units
from mjsim.plant.chain import ChainPlant
from mjsim.plant.mujoco import MujocoPlant, run_together

__all__ = [
    "ChainPlant",
    "Hold",
    "Linear",
    "MujocoPlant",
    "Parameter",
    "Plant",
    "Side",
    "Signal",
    "Site",
    "Start",
    "check_units",
    "run_together",
]
