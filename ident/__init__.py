"""Numbers from data: filter, decimate, prediction-error models with their uncertainty, residual tests, nonparametric checks."""

from ident.bode import Bode, Extremum, bode
from ident.compare import Comparison, compare
from ident.data import Detrend, IOData
from ident.estimate import Estimate, Status, ararx, armax, arx, bj, oe, pem
from ident.filter import Decimation, Design, LowPass, Phase, decimate, low_pass, shared_filter
from ident.model import PolyModel
from ident.multisine import Multisine, odd_multisine
from ident.nonlinearity import AmplitudeTest, BestLinearApproximation, amplitude_test, detection_lines
from ident.options import Focus, InitialCondition, Options, SearchOptions
from ident.order import OrderSelection, select_order
from ident.polezero import PoleZero, pole_zero
from ident.predict import predicted, simulated
from ident.quality import Quality, fit_percent, nrmse, quality
from ident.residuals import ResidualTests, check_residuals, residual_tests
from ident.serial import load, save
from ident.spectral import SpectralEstimate, etfe, spectral
from ident.structure import Structure
from ident.verdict import Grade, Verdict, judge

__all__ = [
    "AmplitudeTest",
    "BestLinearApproximation",
    "Bode",
    "Comparison",
    "Decimation",
    "Design",
    "Detrend",
    "Estimate",
    "Extremum",
    "Focus",
    "Grade",
    "IOData",
    "InitialCondition",
    "LowPass",
    "Multisine",
    "Options",
    "OrderSelection",
    "Phase",
    "PoleZero",
    "PolyModel",
    "Quality",
    "ResidualTests",
    "SearchOptions",
    "SpectralEstimate",
    "Status",
    "Structure",
    "Verdict",
    "amplitude_test",
    "ararx",
    "armax",
    "arx",
    "bj",
    "bode",
    "check_residuals",
    "compare",
    "decimate",
    "detection_lines",
    "etfe",
    "fit_percent",
    "judge",
    "load",
    "low_pass",
    "nrmse",
    "odd_multisine",
    "oe",
    "pem",
    "pole_zero",
    "predicted",
    "quality",
    "residual_tests",
    "save",
    "select_order",
    "shared_filter",
    "simulated",
    "spectral",
]
