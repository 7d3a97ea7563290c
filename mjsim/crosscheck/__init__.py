"""MuJoCo against the analytic equations, effect by effect: every registered effect is covered because the registry is walked.

Each case is an axis, run on one chirp by the ODE kernel, by plain MuJoCo (literal: only what MJCF expresses, judged by its own
law), by the accurate runner alone and in a batch. The truth is the exact reference where the case is piecewise affine, else the
kernel at 16 steps per sample. Beside it stand the truth's own error (16 against 8 steps) and its sensitivity: the relative
change of the velocity over one of the input. Where the motion becomes chaotic, no two solvers agree: a case is compared over the
leading part in which the sensitivity is no more than two, which is printed. A form that misses its limit in plain MuJoCo at the
timestep that is written is tried at a fifth and a twenty-fifth of it; where it holds, that timestep is printed with both errors.
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
