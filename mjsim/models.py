"""Where the shipped models are: ``models/`` of a checkout, ``simgap/models/`` of an installed wheel."""

from __future__ import annotations

from pathlib import Path

from mjsim.errors import InputError

__all__ = ["models_directory", "shipped_model", "shipped_models"]


def models_directory() -> Path:
    """The directory that holds the shipped models and their bindings."""
    root = Path(__file__).resolve().parent.parent
    # beside the packages in a checkout, inside the face package in a wheel
    for candidate in (root / "models", root / "simgap" / "models"):
        if (candidate / "robot_axis1.xml").is_file():
            return candidate
    raise InputError(root, "the shipped models are missing", "models/robot_axis1.xml", "install simgap anew")


def shipped_models() -> tuple[str, ...]:
    """Names of the shipped models."""
    return tuple(sorted(p.stem for p in models_directory().glob("*.xml")))


def shipped_model(name: str) -> Path:
    """Path of a shipped model by name (``robot_axis1``); its binding stands beside it. Raises InputError naming the choices."""
    path = models_directory() / f"{name.removesuffix('.xml')}.xml"
    if not path.is_file():
        raise InputError(f"model {name!r}", "no such shipped model", f"one of: {', '.join(shipped_models())}", "name one of them")
    return path
