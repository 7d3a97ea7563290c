"""Axis <-> MJCF: reading any single-axis chain, and writing a corrected copy of an authored model."""

from mjsim.mjcf.load import Model, load_axis, load_model

__all__ = ["Model", "load_axis", "load_model"]
