"""Is the log fit for a diagnosis? What was understood of model and recordings, and what is wrong with the recordings."""

from diagnose.check.machine import Machine
from diagnose.check.run import check_log
from diagnose.check.types import Excitation, LogCheck, LogVerdict, Problem, Severity

__all__ = ["Excitation", "LogCheck", "LogVerdict", "Machine", "Problem", "Severity", "check_log"]
