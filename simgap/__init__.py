"""simgap: where a robot simulation and its recording differ, and which physics was left out."""

__all__ = ["__version__"]

__version__ = "0.1.0"
