"""Axis <-> MJCF: reading any single-axis chain, and writing a corrected copy of an authored model."""

from mjsim.mjcf.editor import MjcfEditor
from mjsim.mjcf.load import Model, carried_binding, load_axis, load_model
from mjsim.mjcf.write import Written, check_writable, write_corrected

__all__ = ["MjcfEditor", "Model", "Written", "carried_binding", "check_writable", "load_axis", "load_model", "write_corrected"]
