"""A user's own MJCF as a picture: its geoms, lights and cameras; what it lacks of light, floor, sky and camera is added.

The drawn model is a copy for drawing only: it is never stepped, and its degrees of freedom are those of the file.
"""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np

from mjsim.errors import InputError, nearest
from mjsim.mjcf.compile import caught_warnings, read_spec

__all__ = ["FREE", "Scene"]

FREE = "free"  # name of the fitted camera, for --camera
_MARGIN = 1.12  # of the distance at which the moving geoms just fill the picture
_POSES = 60  # poses of a motion that the camera is fitted to
_PLANES = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)


class Scene:
    """The drawn model, ready to be posed: ``model``, ``data``, the geom groups shown, the camera.

    ``qpos`` (P, nq): poses of the motion that will be shown; floor and free camera are fitted to them. ``camera``: a name in
    the file, `FREE`, or None for the file's first camera, else the free one. ``joint``: id of the driven joint, whose axis
    chooses the view of the free camera. ``moves``: whether any visible geom moves. Raises InputError.
    """

    def __init__(self, path: Path, qpos: np.ndarray, camera: str | None = None, joint: int | None = None) -> None:
        self.path = path
        self._poses = qpos[np.unique(np.linspace(0, len(qpos) - 1, _POSES).astype(int))]
        bare = _compiled(path, read_spec(path))
        self.option = _option(bare)
        corners, self.moves = _swept(bare, self._poses, self.option)
        self.low, self.high = corners.min(axis=0), corners.max(axis=0)
        self.model = _compiled(path, self._furnished(bare))
        self.model.vis.quality.shadowsize = 1024
        self.model.vis.quality.offsamples = 4
        self.data = mujoco.MjData(self.model)
        self.camera = self._camera(camera, joint, corners)

    @property
    def size(self) -> float:
        """Diagonal of the box that the visible geoms sweep [m]."""
        return float(np.linalg.norm(self.high - self.low))

    def pose(self, qpos: np.ndarray, data: mujoco.MjData | None = None) -> mujoco.MjData:
        """The drawn model at a pose (nq), in its own data or in ``data``."""
        return _posed(self.model, self.data if data is None else data, qpos)

    def fit(self, aspect: float) -> None:
        """Set the distance of the free camera for a picture of this width over height."""
        if self.camera.type != mujoco.mjtCamera.mjCAMERA_FREE:
            return
        forward, right, up = _directions(self.camera)
        vertical = math.tan(0.5 * math.radians(float(self.model.vis.global_.fovy)))
        x = self._corners - np.asarray(self.camera.lookat)
        toward = -(x @ forward)
        needed = np.maximum(np.abs(x @ right) / (vertical * aspect), np.abs(x @ up) / vertical)
        self.camera.distance = _MARGIN * float(np.max(toward + needed))

    def _furnished(self, bare: mujoco.MjModel) -> mujoco.MjSpec:
        """The file's spec with a sky, a light and a floor where it has none."""
        spec = read_spec(self.path)
        size = self.size or 1.0
        if not any(t == mujoco.mjtTexture.mjTEXTURE_SKYBOX for t in bare.tex_type):
            spec.add_texture(
                name="simgap_sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
                rgb1=[0.93, 0.95, 0.98], rgb2=[0.70, 0.76, 0.84], width=64, height=384,
            )  # fmt: skip
        if bare.nlight == 0:
            centre = 0.5 * (self.low + self.high)
            spec.worldbody.add_light(
                name="simgap_light", pos=(centre + size * np.array([0.6, -1.0, 2.0])).tolist(), dir=[-0.3, 0.5, -1.0],
                type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, diffuse=[0.55] * 3, specular=[0.2] * 3, castshadow=True,
            )  # fmt: skip
        if not np.isin(bare.geom_type, _PLANES).any():
            self._add_floor(spec, size)
        return spec

    def _add_floor(self, spec: mujoco.MjSpec, size: float) -> None:
        """A plane under all that is seen: at height 0 where the model stands above it, else below its lowest point."""
        spec.add_texture(
            name="simgap_floor", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
            rgb1=[0.80, 0.82, 0.85], rgb2=[0.74, 0.77, 0.81], width=256, height=256,
        )  # fmt: skip
        material = spec.add_material(name="simgap_floor", texrepeat=[2.0 / size, 2.0 / size], texuniform=True)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "simgap_floor"
        material.specular = material.shininess = material.reflectance = 0.0
        low = float(self.low[2])
        height = -1e-3 * size if -1e-9 * size <= low < size else low - 0.05 * size
        spec.worldbody.add_geom(
            name="simgap_floor", type=mujoco.mjtGeom.mjGEOM_PLANE, pos=[0.0, 0.0, height], quat=[1, 0, 0, 0],
            size=[0.0, 0.0, 0.05], material="simgap_floor", rgba=[1, 1, 1, 1], group=0, contype=0, conaffinity=0,
        )  # fmt: skip

    def _camera(self, name: str | None, joint: int | None, corners: np.ndarray) -> mujoco.MjvCamera:
        model, camera = self.model, mujoco.MjvCamera()
        names = [model.camera(i).name for i in range(model.ncam)]
        if name is not None and name != FREE and name not in names:
            known = [*(n for n in names if n), FREE]
            raise InputError(f"--camera {name!r}", f"no such camera in {self.path.name}", f"one of: {', '.join(known)}",
                             nearest(name, known))  # fmt: skip
        self._corners = corners
        if (model.ncam and name != FREE) or name in names:
            camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            camera.fixedcamid = names.index(name) if name is not None else 0
            return camera
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat = 0.5 * (self.low + self.high)
        camera.azimuth, camera.elevation = self._view(joint)
        camera.distance = 2 * (self.size or 1.0)
        return camera

    def _view(self, joint: int | None) -> tuple[float, float]:
        """Azimuth and elevation [deg] that show the motion of the driven joint broadside, a little from the side and above."""
        if joint is None:
            return 125.0, -22.0
        self.pose(self._poses[0])
        axis = np.array(self.data.xaxis[joint])
        hinge = self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        upright = abs(axis[2]) > 0.8
        if hinge and upright:  # it turns in the plane of the floor: from above
            return 90.0, -48.0
        azimuth = math.degrees(math.atan2(axis[1], axis[0]))
        if not hinge:  # across the stroke; a vertical stroke is seen from the front
            azimuth = 90.0 if upright else azimuth + 90.0
        seen = azimuth % 180.0  # of the two sides, the one that looks along +y, as MuJoCo's own view does
        return seen + 22.0 if seen <= 90.0 else seen - 22.0, -14.0


def _compiled(path: Path, spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        with caught_warnings():
            return spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        said = " ".join(str(error).split())
        raise InputError(path, f"it cannot be drawn ({said})", "an MJCF model", "correct the element it names") from None


def _posed(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> mujoco.MjData:
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    mujoco.mj_flex(model, data)
    mujoco.mj_tendon(model, data)
    return data


def _option(model: mujoco.MjModel) -> mujoco.MjvOption:
    """Groups 0 to 2, as MuJoCo's viewer shows them; all groups where these hold no geom that can move."""
    option = mujoco.MjvOption()
    shown = np.asarray(option.geomgroup)[model.geom_group].astype(bool) & (model.body_weldid[model.geom_bodyid] != 0)
    if not shown.any():
        option.geomgroup[:] = 1
    return option


def _swept(model: mujoco.MjModel, poses: np.ndarray, option: mujoco.MjvOption) -> tuple[np.ndarray, bool]:
    """Corners (K, 3) of the bounding boxes of all visible geoms in all poses, planes left out, and whether any of them moves."""
    data = mujoco.MjData(model)
    seen = np.asarray(option.geomgroup)[model.geom_group].astype(bool) & ~np.isin(model.geom_type, _PLANES)
    material = model.geom_matid
    alpha = np.where(material >= 0, model.mat_rgba[material, 3] if model.nmat else 1.0, model.geom_rgba[:, 3])
    seen &= alpha > 0
    if not seen.any():
        return np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]]), False
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
    local = model.geom_aabb[seen, None, :3] + signs[None] * model.geom_aabb[seen, None, 3:]
    out = []
    for qpos in poses:
        _posed(model, data, qpos)
        turn = data.geom_xmat[seen].reshape(-1, 3, 3)
        out.append(np.einsum("gij,gcj->gci", turn, local) + data.geom_xpos[seen, None, :])
    stack = np.array(out)
    reach = float(np.max(np.ptp(stack, axis=(0, 1, 2)))) or 1.0
    return stack.reshape(-1, 3), bool(np.max(np.ptp(stack, axis=0)) > 1e-9 * reach)


def _directions(camera: mujoco.MjvCamera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forward, right and up (3,) of a free camera."""
    a, e = math.radians(camera.azimuth), math.radians(camera.elevation)
    forward = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([math.sin(a), -math.cos(a), 0.0])
    return forward, right, np.cross(right, forward)
