"""`Model`: an MJCF file, a shipped model or an `mujoco.MjSpec`, as an axis or a robot."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import mujoco

from mjsim.axis import Axis
from mjsim.errors import InputError
from mjsim.mjcf import load_axis
from mjsim.mjcf.compile import compile_file, read_spec
from mjsim.models import model_path
from simgap.api.scratch import Scratch

if TYPE_CHECKING:
    from mjsim.robot.model import Robot

__all__ = ["Model", "ModelSource"]

ModelSource = "Model | str | Path | mujoco.MjSpec"
"""What stands for a model: itself, an MJCF file, the name of a shipped model, or an `mujoco.MjSpec`."""


@final
class Model:
    """A model to compare recordings with.

    ``source``: an MJCF file, the name of a shipped model (``"pendulum"``), or an `mujoco.MjSpec`, which is written to a temporary
    file. Raises `InputError` for a file that is not there or that MuJoCo does not load, and for an unknown name.

    >>> import simgap
    >>> model = simgap.Model("pendulum")
    >>> model.joints
    ('pendulum',)
    >>> model.parameters["fm"]  # viscous friction [N m s/rad]
    0.05
    >>> [effect.id for effect in model.effects]
    ['gravity_load']
    >>> model.mjmodel.nv
    1
    """

    def __init__(self, source: Model | str | Path | mujoco.MjSpec) -> None:
        self._scratch: Scratch | None = None
        self._path: Path
        if isinstance(source, Model):
            self._path, self._scratch = source._path, source._scratch
        elif isinstance(source, mujoco.MjSpec):
            self._scratch = Scratch()
            self._path = self._scratch.path / f"{Path(source.modelname or 'model').name}.xml"
            self._path.write_text(_text(source), encoding="utf-8")
        else:
            self._path = model_path(source)
        self._mjmodel = compile_file(self._path)

    @property
    def path(self) -> Path:
        """The MJCF file."""
        return self._path

    @property
    def mjmodel(self) -> mujoco.MjModel:
        """The compiled model."""
        return self._mjmodel

    @property
    def spec(self) -> mujoco.MjSpec:
        """The model as a specification that can be edited; a fresh one each time."""
        return read_spec(self._path)

    @cached_property
    def axis(self) -> Axis:
        """The model as one driven axis. Raises `InputError` where it is none."""
        return load_axis(self._path)

    @cached_property
    def robot(self) -> Robot:
        """The model as a fixed-base tree of joints. Raises `InputError` where it is none."""
        from mjsim.robot.model import load_robot

        return load_robot(self._path)

    @property
    def is_robot(self) -> bool:
        """Whether actuators drive several joints."""
        from simgap.robot import driven_joints

        return len(driven_joints(self._mjmodel)) > 1

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that a diagnosis names: all independent ones of a robot, those of the bodies of an axis."""
        return self.robot.joints if self.is_robot else tuple(b.joint for b in self.axis.chain.bodies)

    @property
    def parameters(self) -> Mapping[str, float]:
        """Linear parameters of an axis by name [SI]: inertias J, viscous frictions f, stiffnesses k, dampings d."""
        return {p.name: p.value for p in self.axis.chain.linear_parameters()}

    @property
    def effects(self) -> tuple[Any, ...]:
        """Effects that the model of an axis has itself, such as gravity, a gap, dry friction."""
        return self.axis.effects

    def __repr__(self) -> str:
        return f"Model({str(self._path)!r})"


def _text(spec: mujoco.MjSpec) -> str:
    try:
        spec.compile()
        return str(spec.to_xml())
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        said = " ".join(str(error).split())
        raise InputError("model", f"MuJoCo does not compile the specification ({said})", "an MjSpec", "correct it") from None
