"""Numbers from data: filter, decimate, prediction-error models with their uncertainty, residual tests, nonparametric checks."""

from ident.bode import Bode, bode
from ident.data import Detrend, IOData
from ident.estimate import Estimate, Status, ararx, armax, arx, bj, oe, pem
from ident.filter import Decimation, Design, LowPass, Phase, decimate, low_pass, shared_filter
from ident.model import PolyModel
from ident.options import Focus, InitialCondition, Options, SearchOptions
from ident.structure import Structure

__all__ = [
    "Bode",
    "Decimation",
    "Design",
    "Detrend",
    "Estimate",
    "Focus",
    "IOData",
    "InitialCondition",
    "LowPass",
    "Options",
    "Phase",
    "PolyModel",
    "SearchOptions",
    "Status",
    "Structure",
    "ararx",
    "armax",
    "arx",
    "bj",
    "bode",
    "decimate",
    "low_pass",
    "oe",
    "pem",
    "shared_filter",
]
