"""What is checked of an MJCF file around its compilation: sizes, kinds and places of files before, finite numbers after."""

from __future__ import annotations

import math
import os
import stat
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from mjsim.errors import InputError
from mjsim.mjcf.tags import Tag, tags

__all__ = ["MOST_ASSETS", "MOST_BYTES", "MOST_COPIES", "MOST_FILES", "MOST_KEYS", "ROOTS", "need_finite", "need_sizes", "roots"]

MOST_COPIES = 10_000
"""Largest number of copies by nested ``<replicate>``: MuJoCo compiles so many bodies within seconds."""
MOST_ELEMENTS = 10_000
"""Largest number of bodies, and as many of geoms, joints and sites, copies among them: seconds of compilation."""
MOST_CELLS = 2**24
"""Largest number of cells of a height field, and of pixels of a built-in texture: 128 MB as MuJoCo holds them."""
MOST_POINTS = 10_000
"""Largest number of points of a grid of ``<flexcomp>``: seconds of compilation."""
MOST_USER = 10_000
"""Largest number of user values of each element of a kind."""
MOST_ITERATIONS = 100_000
"""Largest number of iterations of a solver in one step."""
LEAST_TIMESTEP = 1e-8
"""Least timestep [s]: a run of one second takes minutes."""
MOST_KEYS = 10_000
"""Largest number of keyframes; the compiler's time grows with its square."""

MOST_FILES = 200
"""Largest number of ``<include>`` elements, those of included files among them."""
MOST_BYTES = 2**26
"""Largest size of a model with all files that it includes [bytes]."""
MOST_ASSETS = 2**30
"""Largest size of all meshes, textures and height fields together [bytes]; MuJoCo reads each as a whole."""

ROOTS = "SIMGAP_MODEL_ROOT"
"""Environment variable with further folders from which models may read, separated as in PATH."""

FOLDERS = ("assetdir", "meshdir", "texturedir")
_KINDS = ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")
SIZES = (
    ("hfield", ("nrow", "ncol"), MOST_CELLS), ("texture", ("width", "height"), MOST_CELLS),
    ("flexcomp", ("count",), MOST_POINTS), *(("size", (f"nuser_{kind}",), MOST_USER) for kind in _KINDS),
    *(("option", (f"{kind}iterations",), MOST_ITERATIONS) for kind in ("", "ls_", "noslip_", "ccd_", "sdf_")),
)  # fmt: skip
"""Element, attributes whose numbers are multiplied, and the largest product."""
_SIZED = {name for name, _, _ in SIZES}
COUNTED = ("body", "geom", "joint", "site")
NESTED = ("include", "model")  # elements whose file is MJCF as well

_read: set[str] = set()
"""Real paths of files that models of this process have read: a model derived from one of them may stand elsewhere."""

_NUMBERS = (
    "body_pos", "body_quat", "body_mass", "body_inertia", "jnt_pos", "jnt_axis", "jnt_stiffness", "jnt_range", "qpos0",
    "qpos_spring", "dof_damping", "dof_armature", "dof_frictionloss", "geom_pos", "geom_size", "actuator_gear",
    "actuator_gainprm",
    "actuator_biasprm", "actuator_dynprm", "tendon_stiffness", "tendon_damping", "tendon_frictionloss", "eq_data",
)  # fmt: skip
"""Arrays in which infinity is refused as well; the others may have infinite ranges."""
_OPTIONS = (
    "timestep", "impratio", "tolerance", "ls_tolerance", "noslip_tolerance", "ccd_tolerance", "gravity", "wind", "magnetic",
    "density", "viscosity", "o_margin", "o_solref", "o_solimp", "o_friction",
)  # fmt: skip


def roots(model: Path) -> list[str]:
    """Real paths of the folders from which a model may read: its own, that of the file that it links to, and `ROOTS`."""
    given = [entry for entry in os.environ.get(ROOTS, "").split(os.pathsep) if entry]
    own = (os.path.dirname(os.path.abspath(model)), os.path.dirname(os.path.realpath(model)))
    return list(dict.fromkeys(os.path.realpath(folder) for folder in (*own, *given)))


def need_sizes(path: Path) -> None:
    """Raise InputError for a file that expands beyond the limits, with all that it includes, or that reads outside its folder.

    Every file that it refers to is a regular file in one of the `roots`, after links are followed. A file that is not there is
    left to MuJoCo, which names it.
    """
    model = _Model(path)
    model.walk(path, [], 1.0)
    size = 0
    for name in model.assets:
        for file in model.existing(name, [*model.folders, *model.below]):
            size += os.stat(file).st_size
            if size > MOST_ASSETS:
                most = f"{MOST_ASSETS / 2**20:.4g} MB"
                raise InputError(path, f"its meshes and textures have more than {most}", "smaller ones", "reduce the meshes")
            model.accepted.add(file)
    _read.update(model.accepted)


class _Model:
    """What has been found of a model and the files that it reads."""

    def __init__(self, path: Path) -> None:
        self.path, self.roots = path, roots(path)
        self.files = self.bytes = self.keys = 0
        self.folders = [os.path.dirname(os.path.abspath(path))]  # of the model and of the files that it includes
        self.below: list[str] = []  # of meshes and textures
        self.assets: dict[str, None] = {}
        self.accepted: set[str] = set()
        self.elements = dict.fromkeys(COUNTED, 0.0)

    def walk(self, file: Path, within: Sequence[str], copies: float) -> None:
        """Count what is in a file and in those that it includes; ``within``: files around it, copies: how often it stands."""
        try:
            raw = file.read_bytes()
        except OSError as error:
            raise InputError(file, f"cannot be read ({error.strerror})", "an MJCF model", "check the path") from None
        self.files += 1
        self.bytes += len(raw)
        if self.files > MOST_FILES + 1 or self.bytes > MOST_BYTES:
            most = f"{MOST_FILES} files or {MOST_BYTES / 2**20:.3g} MB"
            raise InputError(self.path, f"it includes more than {most}", "a smaller model", "merge the files")
        nested = [copies]
        for tag in tags(raw, file):
            self._count(tag, nested)
            self._need_size(tag)
            for key, value in tag.attributes if b"file" in tag.text or tag.name == "compiler" else ():
                name = os.fsdecode(value)
                if tag.name == "compiler" and key in FOLDERS:
                    self.below += [os.path.join(folder, name.replace("\\", "/")) for folder in self.folders]
                elif key.startswith("file") and tag.name in NESTED:
                    self._enter(name, [*within, os.path.realpath(file)], nested[-1])
                elif key.startswith("file"):
                    self.assets[name] = None

    def _count(self, tag: Tag, nested: list[float]) -> None:
        self.keys += tag.name == "key" and tag.opens
        if self.keys > MOST_KEYS:
            raise InputError(self.path, f"{self.keys} keyframes", f"at most {MOST_KEYS}", "remove those that are not needed")
        if tag.name in COUNTED and tag.opens:
            self.elements[tag.name] += nested[-1]
            if self.elements[tag.name] > MOST_ELEMENTS:
                raise InputError(
                    self.path, f"it has more than {MOST_ELEMENTS} <{tag.name}>", "fewer", "remove what does not move"
                )
        if tag.name != "replicate":
            return
        if tag.opens:
            copies = nested[-1] * _number(dict(tag.attributes).get("count", b"1"))
            if copies > MOST_COPIES:
                raise InputError(self.path, f"<replicate> makes {copies:.3g} copies", f"at most {MOST_COPIES}", "lower its count")
            nested.append(copies)
        if tag.closes and len(nested) > 1:
            nested.pop()

    def _need_size(self, tag: Tag) -> None:
        for name, keys, most in SIZES if tag.name in _SIZED and tag.opens else ():
            product = math.prod(abs(x) for key, value in tag.attributes if key in keys for x in _numbers(value))
            if tag.name == name and not product <= most:
                what = f"<{name}> has {' times '.join(keys)} of {product:.3g}"
                raise InputError(self.path, what, f"at most {most}", "lower it")

    def _enter(self, name: str, within: Sequence[str], copies: float) -> None:
        for file in self.existing(name, self.folders):
            self.accepted.add(file)
            if file not in within:  # MuJoCo names a file that includes itself
                self.folders = list(dict.fromkeys([*self.folders, os.path.dirname(file)]))
                self.walk(Path(file), within, copies)

    def existing(self, name: str, folders: Sequence[str]) -> list[str]:
        """Real paths of the regular files that MuJoCo may mean by a name. Raises InputError for one outside the roots.

        MuJoCo takes ``\\\\`` for ``/``, shortens ``a/../b`` before links are followed, and leaves folders out by ``strippath``.
        """
        found: dict[str, None] = {}
        for place in _places(name, folders):
            kind = _mode(place)
            if kind is None or stat.S_ISDIR(kind):
                continue
            real = os.path.realpath(place)
            if real not in _read and not any(os.path.commonpath([real, root]) == root for root in self.roots):
                raise InputError(
                    self.path, f"it refers to {name!r} outside its folder", f"a file in {self.roots[0]}",
                    f"copy it there, or allow its folder: --model-root {os.path.dirname(real)}",
                )  # fmt: skip
            if not stat.S_ISREG(kind):
                raise InputError(self.path, f"{place!r} is not a regular file", "a file", "name a file")
            found[real] = None
        return list(found)


def _places(name: str, folders: Sequence[str]) -> Iterator[str]:
    names = dict.fromkeys(form for n in (name, name.replace("\\", "/")) for form in (n, os.path.basename(n)) if form)
    for folder in dict.fromkeys(folders):
        for form in names:
            place = os.path.join(folder, form)
            yield place
            if os.path.normpath(place) != place:
                yield os.path.normpath(place)


def _mode(place: str) -> int | None:
    try:
        return os.stat(place).st_mode
    except (OSError, ValueError):
        return None


def _number(text: bytes) -> float:
    """The first number of a text; 1 where there is none, which MuJoCo names."""
    return next(iter(_numbers(text)), 1.0)


def _numbers(text: bytes) -> list[float]:
    """The numbers of a text; none where it has anything else, which MuJoCo names."""
    try:
        return [float(x) for x in text.split()]
    except ValueError:
        return []


def need_finite(model: mujoco.MjModel, path: Path) -> None:
    """Raise InputError where a number of the compiled model is not finite, or its timestep too small.

    MuJoCo accepts NaN and steps it.
    """
    for name in _OPTIONS:
        if not np.all(np.isfinite(getattr(model.opt, name))):
            raise InputError(path, f"<option {name}> is not finite", "a number", "correct the attribute")
    if not model.opt.timestep >= LEAST_TIMESTEP:
        raise InputError(
            path, f"its timestep is {model.opt.timestep:g} s", f"at least {LEAST_TIMESTEP:g} s", "correct the attribute"
        )
    for name in _arrays():
        values = getattr(model, name)
        if not values.size or np.isfinite(values).all():
            continue
        bad = np.argwhere(~np.isfinite(values) if name in _NUMBERS else np.isnan(values))
        if len(bad):
            raise InputError(path, f"{name}[{', '.join(map(str, bad[0]))}] is not finite", "a number", "correct the attribute")


@cache
def _arrays() -> tuple[str, ...]:
    """Names of the arrays of a compiled model that hold real numbers, those that a file states first."""
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    arrays = ((name, getattr(model, name)) for name in dir(model) if not name.startswith("_"))
    return tuple(dict.fromkeys([*_NUMBERS, *(name for name, x in arrays if isinstance(x, np.ndarray) and x.dtype.kind == "f")]))
