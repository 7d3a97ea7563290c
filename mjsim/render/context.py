"""An off-screen OpenGL context for MuJoCo without a display: EGL, else OSMesa, whatever was imported before."""

from __future__ import annotations

import ctypes.util
import importlib
import os
import sys
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np

from mjsim.errors import InputError

__all__ = ["CHOICE", "Offscreen", "backend"]

CHOICE = "SIMGAP_GL"  # environment variable: egl or osmesa; the command line moves MUJOCO_GL there
GHOST_ALPHA = 0.45
NEARER = 1.2e-2  # part of the way to the camera by which a ghost is moved: more than a texel of a shadow map is deep
_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}


def _open(width: int, height: int) -> Any:
    """The first context that opens, made current. Raises InputError naming the packages to install when none does."""
    wanted = (os.environ.get(CHOICE) or os.environ.get("MUJOCO_GL", "")).lower()
    names = [wanted] if wanted in _LIBRARIES else list(_LIBRARIES)
    said = []
    for name in names:
        if ctypes.util.find_library(_LIBRARIES[name]) is None:
            said.append(f"{name}: no lib{_LIBRARIES[name]}")
            continue
        chosen = os.environ.get("PYOPENGL_PLATFORM")
        if chosen not in (None, name):
            # PyOpenGL binds to one platform; before it has drawn anything it may still be given another
            for module in [
                m for m in sys.modules if m.split(".")[0] == "OpenGL" or m.startswith(("mujoco.egl", "mujoco.osmesa"))
            ]:
                del sys.modules[module]
            del os.environ["PYOPENGL_PLATFORM"]
        try:
            context = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
            context.make_current()
            return context
        except Exception as error:  # what fails here comes from a C library under one of several bindings
            said.append(f"{name}: {' '.join(str(error).split()) or type(error).__name__}")
    raise InputError(
        "rendering", f"no off-screen OpenGL ({'; '.join(said)})", "EGL or OSMesa",
        "on Debian or Ubuntu: apt-get install libegl1 libgl1 libosmesa6",
    )  # fmt: skip


def backend() -> str:
    """Name of the library that draws, ``egl`` or ``osmesa``, with the renderer that it says it is. Raises InputError."""
    context = _open(64, 64)
    try:
        from OpenGL import GL

        renderer = GL.glGetString(GL.GL_RENDERER)
        name = type(context).__module__.rsplit(".", 1)[-1]
        return f"{name} ({renderer.decode(errors='replace')})" if renderer else name
    finally:
        context.free()


class Offscreen:
    """Renders a model; use it in a ``with`` block.

    ``camera``: where from, the model's first camera when None. ``option``: which groups are drawn.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        width: int,
        height: int,
        camera: mujoco.MjvCamera | None = None,
        option: mujoco.MjvOption | None = None,
    ) -> None:
        self.model, self.width, self.height = model, width, height
        self._gl = _open(width, height)
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, maxgeom=max(2000, 4 * model.ngeom + 500))
        self._option = option or mujoco.MjvOption()
        self._camera = camera or mujoco.MjvCamera()
        if camera is None:
            self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            self._camera.fixedcamid = 0
        self._rect = mujoco.MjrRect(0, 0, width, height)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._context.free()
        self._gl.free()

    def render(
        self, data: mujoco.MjData, ghost: mujoco.MjData | None = None, tint: tuple[int, int, int] = (0, 0, 0)
    ) -> np.ndarray:
        """(height, width, 3) bytes; ``ghost``: the moving geoms at another pose, translucent, in the colour ``tint``."""
        self._gl.make_current()
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        mujoco.mjv_updateScene(self.model, data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL, self._scene)
        if ghost is not None:
            self._add_ghost(ghost, tint)
        mujoco.mjr_render(self._rect, self._scene, self._context)
        pixels = np.empty((self.height, self.width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._rect, self._context)
        return pixels[::-1]

    def _add_ghost(self, data: mujoco.MjData, tint: tuple[int, int, int]) -> None:
        """Add the moving geoms at another pose, a little nearer to the camera, so that equal poses do not flicker."""
        first = self._scene.ngeom
        perturb = mujoco.MjvPerturb()
        mujoco.mjv_addGeoms(self.model, data, self._option, perturb, mujoco.mjtCatBit.mjCAT_DYNAMIC, self._scene)
        eye = 0.5 * (np.asarray(self._scene.camera[0].pos) + np.asarray(self._scene.camera[1].pos))
        colour = [*(c / 255 for c in tint), GHOST_ALPHA]
        for geom in self._scene.geoms[first : self._scene.ngeom]:
            geom.rgba[:] = colour
            geom.matid = -1
            geom.emission, geom.reflectance = 0.25, 0.0
            geom.transparent = 1
            geom.pos[:] = geom.pos + NEARER * (eye - geom.pos)
