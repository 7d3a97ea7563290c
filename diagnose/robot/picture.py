"""A picture of the robot whose links bear the colour of what their joint lacks; a plan of its joints where nothing can be
rendered."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from html import escape
from pathlib import Path

import mujoco
import numpy as np

from diagnose.report.words import VERDICTS, effect_name
from diagnose.result import Verdict
from diagnose.robot.result import JointResult, RobotDiagnosis
from mjsim.errors import InputError
from mjsim.robot.model import Robot

__all__ = ["picture"]

WIDE, HIGH = 760, 520
LOOKED = 60  # poses
COLOURS = {
    Verdict.NO_MISMATCH: (0.30, 0.62, 0.42), Verdict.PARAMETERS_ONLY: (0.24, 0.50, 0.78), Verdict.MISSING_PHYSICS: (0.86, 0.42,
    0.16),
    Verdict.UNEXPLAINED: (0.62, 0.28, 0.62), None: (0.72, 0.74, 0.76),
}  # fmt: skip


def picture(d: RobotDiagnosis, robot: Robot, path: Path, poses: np.ndarray) -> str:
    """HTML of the picture with its legend.

    path: the MJCF; poses (P, m): positions of the independent joints, of which the one is drawn in which the bodies reach
    farthest apart. Rendered where a context for it can be had, else drawn as a plan.
    """
    qpos = poses @ robot.tie.T + robot.rest
    try:
        shown = _rendered(d, robot, path, qpos)
    except (InputError, OSError, RuntimeError, ImportError, mujoco.FatalError):
        shown = _plan(d, robot, _widest(robot, qpos))
    legend = "".join(_line(name, d.joints.get(name)) for name in robot.joints)
    return f'<figure class="robot">{shown}<figcaption><ul class="joints">{legend}</ul></figcaption></figure>'


def _widest(robot: Robot, qpos: np.ndarray) -> np.ndarray:
    """The pose (nq,) of poses (P, nq) in which the bodies reach farthest apart, of `LOOKED` that are looked at."""
    data, best = mujoco.MjData(robot.model), (-1.0, qpos[0])
    for q in qpos[np.unique(np.linspace(0, len(qpos) - 1, LOOKED).astype(int))]:
        data.qpos[:] = q
        mujoco.mj_kinematics(robot.model, data)
        size = float(np.linalg.norm(np.ptp(data.xpos[1:], axis=0)))
        best = max(best, (size, q), key=lambda x: x[0])
    return np.asarray(best[1])


def _line(name: str, r: JointResult | None) -> str:
    """One joint in the legend: its colour, name, and what is missing."""
    colour = _hex(COLOURS[r.verdict if r is not None else None])
    if r is None:
        said = "not diagnosed"
    else:
        said = ", ".join(dict.fromkeys(effect_name(f.effect) for f in r.findings)) or VERDICTS[r.verdict].badge
    swatch = f'<svg width="12" height="12" aria-hidden="true"><rect width="12" height="12" rx="2" fill="{colour}"/></svg>'
    link = f'<a href="#{escape(name)}">{escape(name)}</a>' if r is not None else escape(name)
    return f"<li>{swatch} {link}: {escape(said)}</li>"


def _hex(colour: tuple[float, float, float]) -> str:
    return "#" + "".join(f"{round(255 * c):02x}" for c in colour)


def _colour_of_links(d: RobotDiagnosis, robot: Robot) -> dict[int, tuple[float, float, float]]:
    """Colour of each moving body, by its id: that of its own joint, else that of the link before."""
    model = robot.model
    by_joint: Mapping[str, JointResult] = d.joints
    out: dict[int, tuple[float, float, float]] = {}
    for b in range(1, model.nbody):
        joints = [robot.dofs[j] for j in range(model.njnt) if int(model.jnt_bodyid[j]) == b]
        parent = int(model.body_parentid[b])
        if joints:
            found = by_joint.get(joints[-1])
            out[b] = COLOURS[found.verdict if found is not None else None]
        elif parent in out:
            out[b] = out[parent]
    return out


def _rendered(d: RobotDiagnosis, robot: Robot, path: Path, qpos: np.ndarray) -> str:
    import imageio.v3 as iio

    from mjsim.render.context import Offscreen
    from mjsim.render.scene import FREE, Scene

    pose = _widest(robot, qpos)
    scene = Scene(path, np.array([pose, pose + 1e-3]), FREE)  # fitted to this pose; two show that a geom moves
    scene.fit(WIDE / HIGH)
    if not scene.moves:
        raise InputError(path, "no geom that moves", "geoms of the links", "draw the plan of the joints")
    colours = _colour_of_links(d, robot)
    for g in range(scene.model.ngeom):
        body = int(scene.model.geom_bodyid[g])
        if body in colours or int(scene.model.geom_type[g]) != int(mujoco.mjtGeom.mjGEOM_PLANE):
            scene.model.geom_matid[g] = -1
            scene.model.geom_rgba[g] = [*colours.get(body, COLOURS[None]), 1.0]
    with Offscreen(scene.model, WIDE, HIGH, scene.camera, scene.option) as view:
        pixels = view.render(scene.pose(pose))
    file = io.BytesIO()
    iio.imwrite(file, pixels, extension=".png")
    data = base64.b64encode(file.getvalue()).decode()
    alt = "The robot, its links coloured by the verdict of their joint"
    return f'<img width="{WIDE}" height="{HIGH}" alt="{alt}" src="data:image/png;base64,{data}">'


def _plan(d: RobotDiagnosis, robot: Robot, qpos: np.ndarray) -> str:
    """Joints and what connects them, seen along the direction in which they spread least."""
    data = mujoco.MjData(robot.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(robot.model, data)
    model = robot.model
    points = np.array([data.xanchor[j] for j in range(model.njnt)])
    centred = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=True)
    flat = centred @ axes[:2].T
    size = max(float(np.max(np.ptp(flat, axis=0))), 1e-9)
    xy = 60 + (flat - flat.min(axis=0)) / size * (min(WIDE, HIGH) - 160)
    parts = []
    for j in range(model.njnt):
        body = int(model.body_parentid[model.jnt_bodyid[j]])
        while body > 0 and int(model.body_jntnum[body]) == 0:
            body = int(model.body_parentid[body])
        if body > 0:
            k = int(model.body_jntadr[body])
            ends = f'x1="{xy[k, 0]:.1f}" y1="{xy[k, 1]:.1f}" x2="{xy[j, 0]:.1f}" y2="{xy[j, 1]:.1f}"'
            parts.append(f'<line {ends} stroke="currentColor" stroke-width="4" opacity="0.4"/>')
    for j, name in enumerate(robot.dofs):
        found = d.joints.get(name)
        colour = _hex(COLOURS[found.verdict if found is not None else None])
        x, y = xy[j]
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="11" fill="{colour}"/>')
        parts.append(f'<text x="{x + 16:.1f}" y="{y - 8:.1f}" font-size="15" fill="currentColor">{escape(name)}</text>')
    high = float(xy[:, 1].max()) + 50
    label = "Plan of the joints, coloured by their verdict"
    return f'<svg viewBox="0 0 {WIDE} {high:.0f}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
