"""MuJoCo against the analytic equations, effect by effect: every registered effect is covered because the registry is walked.

Each case is an axis, run on one chirp by the ODE kernel, by plain MuJoCo (literal: only what MJCF expresses, judged by its own
law), by the accurate runner alone and in a batch. The truth is the exact reference where the case is piecewise affine, else the
kernel at 16 steps per sample. Beside it stand the truth's own error (16 against 8 steps) and its sensitivity: what 1e-10 of the
start angle changes. Where that is large the motion is chaotic, no two solvers agree, and the case is shown but not judged.
A robot is compared joint by joint with recursive Newton-Euler rows (`mjsim.crosscheck.robot`).
"""

from mjsim.crosscheck.cases import Case, effect_cases, scales_at, study_cases
from mjsim.crosscheck.engines import compare, literal, relative
from mjsim.crosscheck.laws import energy_error
from mjsim.crosscheck.report import Cell, Report, Row, Status, plot, table
from mjsim.crosscheck.robot import check_robot_model
from mjsim.crosscheck.run import check_all

__all__ = [
    "Case",
    "Cell",
    "Report",
    "Row",
    "Status",
    "check_all",
    "check_robot_model",
    "compare",
    "effect_cases",
    "energy_error",
    "literal",
    "plot",
    "relative",
    "scales_at",
    "study_cases",
    "table",
]
