"""Where the shipped models are: ``models/`` of a checkout, ``simgap/models/`` of an installed wheel."""

from __future__ import annotations

from pathlib import Path

from mjsim.errors import InputError, nearest

__all__ = ["model_beside", "model_path", "models_directory", "shipped_model", "shipped_models"]


def models_directory() -> Path:
    """The directory that holds the shipped models and their bindings."""
    root = Path(__file__).resolve().parent.parent
    # beside the packages in a checkout; in a wheel this package is simgap/_src/mjsim (docs/decisions/one-package.md)
    for candidate in (root / "models", root.parent / "models"):
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
        known = shipped_models()
        raise InputError(f"model {name!r}", "no such shipped model", f"one of: {', '.join(known)}", nearest(name, known))
    return path


def model_beside(folder: Path, name: str) -> Path:
    """Path of the model that a file in a folder names: a path from there that ends in .xml and is a file, else a shipped model.

    A name with a folder is never a shipped one. Raises InputError naming the choices.
    """
    path = (folder / name).resolve()
    if name.endswith(".xml") and (path.is_file() or "/" in name):
        return path
    return shipped_model(name)


def model_path(source: str | Path) -> Path:
    """Path of a model given as a file or as a shipped name.

    A name without a folder and without an ending that is no file here (``emps``) is looked up among the shipped models, as is a
    shipped file by its path in the repository (``models/emps.xml``). A path that ends in .xml is returned as it is: who reads it
    says when it is missing. Raises InputError naming the choices.
    """
    path = Path(source)
    if path.exists():
        return path
    shipped = models_directory() / path.name
    if path.parent == Path("models") and shipped.is_file():
        return shipped
    if path.suffix or path.name != str(source):
        return path
    known = shipped_models()
    if path.name in known:
        return shipped_model(path.name)
    raise InputError(
        f"model {str(source)!r}", "no such file and no shipped model", f"an MJCF file (.xml) or one of: {', '.join(known)}",
        nearest(path.name, known),
    )  # fmt: skip
