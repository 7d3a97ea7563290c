"""What an axis looks like: rotor, gear with lug and jaws (the gap between them), gearbox, arm; a slide as carriages on a rail.

The stage is a model for drawing only: it holds no physics, its joints are put where the motion says. Rigid motion and
wind-up are magnified apart, because a wind-up of 1e-3 rad beside a stroke of one turn would not be seen; `Magnification` says
by how much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from mjsim.axis import Chain
from mjsim.quantity import Motion

__all__ = ["Magnification", "Stage", "magnify"]

_LUG, _JAW = 0.035, 0.045  # half widths of lug and jaws [rad on the stage]


@dataclass(frozen=True)
class Magnification:
    """Factors from true to shown motion: rigid motion of the link side, wind-up and gap, turn of the rotor."""

    rigid: float
    windup: float
    rotor: float

    @property
    def said(self) -> str:
        """In words."""
        parts = [f"motion x {_round(self.rigid)}", f"wind-up and gap x {_round(self.windup)}" if self.windup else ""]
        parts.append(f"rotor x {_round(self.rotor)}" if self.rotor != 1 else "")
        return ", ".join(p for p in parts if p)


def _round(x: float) -> str:
    return f"{x:.3g}" if x < 100 else f"{float(f'{x:.2g}'):.0f}"


def deflections(chain: Chain, q: np.ndarray) -> np.ndarray:
    """(N, n-1) deflection of each coupling, its gap included."""
    out = [c.ratio * q[:, j] - q[:, j + 1] for j, c in enumerate(chain.couplings)]
    return np.stack(out, axis=1) if out else np.zeros((len(q), 0))


def magnify(chain: Chain, q: np.ndarray, gaps: np.ndarray, frame: int) -> Magnification:
    """Factors that make a motion q (N, n) fill the stage; ``frame``: samples between pictures."""
    ratio = chain.couplings[0].ratio if chain.couplings else 1.0
    rigid = ratio * (q[:, 0] - q[0, 0])
    reach = float(np.max(np.abs(rigid), initial=0.0))
    full = 0.8 if chain.motion is Motion.HINGE else 0.45
    motion = _nice(full / reach) if 0 < reach < full or (chain.motion is Motion.SLIDE and reach > full) else 1.0
    d = np.abs(deflections(chain, q))
    bent = max(float(np.max(d, initial=0.0)), float(np.max(gaps, initial=0.0)))
    windup = _nice((0.7 if chain.motion is Motion.HINGE else 0.12) / bent) if bent > 0 else 0.0
    step = np.abs(q[frame:, 0] - q[:-frame, 0]) if len(q) > frame else np.zeros(1)
    fastest = float(np.max(step, initial=0.0))
    return Magnification(motion, windup, min(1.0, _nice(0.7 / fastest)) if fastest > 0 else 1.0)


def _nice(x: float) -> float:
    """The next of 1, 2, 5 times a power of ten at or below."""
    power = 10.0 ** math.floor(math.log10(x))
    return power * max(m for m in (1.0, 2.0, 5.0) if m * power <= x * (1 + 1e-9))


class Stage:
    """The drawn axis; `pose` puts it where a motion is."""

    def __init__(self, chain: Chain, half_gaps: np.ndarray, by: Magnification, *, faint: bool = False) -> None:
        self.chain, self.half_gaps, self.by = chain, half_gaps, by
        self._names: list[str] = []
        xml = _hinge(chain, self._names, faint) if chain.motion is Motion.HINGE else _slide(chain, self._names, faint)
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        self._wide = chain.motion is Motion.HINGE and by.rigid == 1.0  # it may swing all the way round
        self._colour = {n: self.model.geom(n).id for n in self._geoms("lug")}

    def frame(self, aspect: float) -> None:
        """Choose the field of view so that the machine fits a picture of this width over height."""
        reach = (0.95 if self._wide else 0.62) if self.chain.motion is Motion.HINGE else 0.74
        self.model.cam_fovy[0] = math.degrees(2 * math.atan(max(reach / aspect, 0.55 if self._wide else 0.0)))

    def _geoms(self, prefix: str) -> list[str]:
        names = (self.model.geom(g).name for g in range(self.model.ngeom))
        return [n for n in names if n.startswith(prefix)]

    def pose(self, q: np.ndarray, start: float) -> mujoco.MjData:
        """Put the stage at the angles q (n); ``start``: angle of body 0 that is shown as zero."""
        chain, by = self.chain, self.by
        n = len(chain.bodies)
        where: dict[str, float] = {}
        ratio = chain.couplings[0].ratio if chain.couplings else 1.0
        at = by.rigid * ratio * (q[0] - start)
        where["rotor"] = by.rotor * q[0]
        where["driver0"] = where["needle"] = at
        for j, c in enumerate(chain.couplings):
            d = by.windup * (c.ratio * q[j] - q[j + 1])
            half = by.windup * self.half_gaps[j]
            driven = at - d
            if j > 0:
                where[f"driver{j}"] = at
            where[f"jaw{j}a"] = driven + max(half, d)
            where[f"jaw{j}b"] = driven + min(-half, d)
            touching = self.half_gaps[j] == 0 or abs(d) >= half
            if f"lug{j}" in self._colour:
                self.model.geom_rgba[self._colour[f"lug{j}"]] = (0.85, 0.15, 0.10, 1) if touching else (0.35, 0.75, 0.35, 1)
            where[f"body{j + 1}"] = at = driven
        if n == 1:
            where["body0"] = at
        for name in self._names:
            self.data.qpos[self.model.joint(name).qposadr[0]] = where.get(name, 0.0)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        return self.data


def _head(camera: str, faint: bool) -> list[str]:
    strong = "0.35" if faint else "1"
    return [
        '<mujoco model="stage">',
        '  <compiler angle="radian" boundmass="1e-6" boundinertia="1e-6"/>',
        '  <visual><headlight ambient="0.42 0.42 0.42" diffuse="0.30 0.30 0.30" specular="0.1 0.1 0.1"/>'
        '<quality shadowsize="1024" offsamples="4"/><map znear="0.02" zfar="30"/></visual>',
        "  <asset>",
        '    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.93 0.95 0.98" rgb2="0.70 0.76 0.84" '
        'width="64" height="384"/>',
        '    <texture name="floor" type="2d" builtin="checker" rgb1="0.80 0.82 0.85" rgb2="0.76 0.78 0.81" '
        'width="256" height="256"/>',
        '    <material name="floor" texture="floor" texrepeat="16 16" specular="0" shininess="0" reflectance="0"/>',
        '    <material name="steel" rgba="0.66 0.69 0.74 1" specular="0.7" shininess="0.7"/>',
        f'    <material name="orange" rgba="0.95 0.45 0.10 {strong}" specular="0.4" shininess="0.5"/>',
        f'    <material name="amber" rgba="0.98 0.66 0.20 {strong}" specular="0.4" shininess="0.5"/>',
        '    <material name="dark" rgba="0.20 0.22 0.26 1" specular="0.3" shininess="0.3"/>',
        '    <material name="mark" rgba="0.10 0.12 0.16 1"/>',
        f'    <material name="jaw" rgba="0.20 0.40 0.75 {strong}"/>',
        f'    <material name="needle" rgba="0.05 0.60 0.45 {strong}"/>',
        "  </asset>",
        '  <default><geom contype="0" conaffinity="0"/></default>',
        "  <worldbody>",
        '    <light pos="0.8 -1.5 3" dir="-0.25 0.45 -1" diffuse="0.42 0.42 0.42" castshadow="true"/>',
        f"    {camera}",
        '    <geom type="plane" size="6 6 0.1" material="floor"/>',
    ]


def _hinge(chain: Chain, names: list[str], faint: bool) -> str:
    out = _head('<camera name="view" pos="0.10 -1.42 1.50" xyaxes="1 0 0 0 0.70 0.714" fovy="42"/>', faint)
    out.append('    <geom type="cylinder" pos="0 0 0.04" size="0.46 0.04" material="dark"/>')
    out.append('    <geom type="cylinder" pos="-0.72 0 0.10" size="0.13 0.10" material="dark"/>')

    def piece(name: str, geoms: list[str], x: float = 0.0) -> None:
        names.append(name)
        out.append(f'    <body pos="{x} 0 0"><joint name="{name}" axis="0 0 1"/>' + "".join(geoms) + "</body>")

    piece(
        "rotor",
        [
            '<geom type="cylinder" pos="0 0 0.225" size="0.15 0.025" material="steel"/>',
            '<geom type="box" pos="0.075 0 0.252" size="0.07 0.014 0.004" material="mark"/>',
            '<geom type="cylinder" pos="0 0 0.26" size="0.03 0.012" material="dark"/>',
        ],
        x=-0.72,
    )
    z, radius, n = 0.11, 0.42, len(chain.bodies)
    for j in range(len(chain.couplings)):
        lug_r, inner = radius - 0.05, radius - 0.12
        top = z + 0.10
        lug = _sector(f"lug{j}", lug_r, z + 0.085, _LUG, 0.045, 0.06, 'rgba="0.35 0.75 0.35 1"')
        if j == 0:
            disc = f'<geom type="cylinder" pos="0 0 {z}" size="{radius} 0.03" material="steel"/>'
            piece("driver0", [disc, lug, *_teeth(radius, z)])
        else:
            piece(f"driver{j}", [lug])
        for letter, side in (("a", 1.0), ("b", -1.0)):
            shift = side * (_LUG + _JAW)
            jaw = _sector(f"jaw{j}{letter}", lug_r, top, _JAW, 0.05, 0.035, 'material="jaw"', shift)
            spoke = _sector(f"spoke{j}{letter}", 0.5 * (inner + lug_r) - 0.02, top - 0.01, 0.6 * _JAW, 0.07, 0.014,
                            'material="jaw"', shift)  # fmt: skip
            piece(f"jaw{j}{letter}", [jaw, spoke])
        last = j + 1 == n - 1
        colour = "orange" if last else "amber"
        size = inner + 0.005
        body = [f'<geom type="cylinder" pos="0 0 {top}" size="{size} 0.04" material="{colour}"/>']
        if not last:
            body.append(f'<geom type="box" pos="{0.7 * size} 0 {top + 0.042}" size="{0.25 * size} 0.012 0.003" material="mark"/>')
        else:
            body += _link(top)
        piece(f"body{j + 1}", body)
        z, radius = top, inner
    if n == 1:
        piece("body0", ['<geom type="cylinder" pos="0 0 0.13" size="0.25 0.05" material="orange"/>', *_link(0.13)])
    else:
        piece("needle", [f'<geom type="box" pos="0.62 0 {z + 0.115}" size="0.44 0.007 0.004" material="needle"/>'])
    return "\n".join([*out, "  </worldbody>", "</mujoco>"])


def _teeth(radius: float, z: float) -> list[str]:
    """Teeth of the driven wheel, so that it is seen to turn."""
    out = []
    for k in range(48):
        a = 2 * math.pi * k / 48
        out.append(
            f'<geom type="box" pos="{radius * math.cos(a):.4f} {radius * math.sin(a):.4f} {z}" size="0.016 0.012 0.024" '
            f'euler="0 0 {a:.4f}" material="steel"/>'
        )
    return out


def _link(z: float) -> list[str]:
    return [
        f'<geom type="cylinder" pos="0 0 {z + 0.05}" size="0.13 0.05" material="orange"/>',
        f'<geom type="box" pos="0.5 0 {z + 0.06}" size="0.45 0.055 0.032" material="orange"/>',
        f'<geom type="cylinder" pos="0.95 0 {z + 0.06}" size="0.075 0.045" material="dark"/>',
    ]


def _sector(name: str, radius: float, z: float, half: float, depth: float, height: float, look: str, at: float = 0.0) -> str:
    """A block on a rim, towards the camera: at -90 degrees plus ``at``."""
    a = at - 0.5 * math.pi
    return (
        f'<geom name="{name}" type="box" pos="{radius * math.cos(a):.4f} {radius * math.sin(a):.4f} {z:.4f}" '
        f'size="{depth} {radius * half:.4f} {height}" euler="0 0 {a:.4f}" {look}/>'
    )


def _slide(chain: Chain, names: list[str], faint: bool) -> str:
    out = _head('<camera name="view" pos="-0.16 -1.75 1.05" xyaxes="1 0 0 0 0.47 0.883" fovy="42"/>', faint)
    n = len(chain.bodies)
    out.append('    <geom type="box" pos="0 0 0.05" size="1.15 0.16 0.05" material="dark"/>')
    out += [f'    <geom type="box" pos="0 {y} 0.115" size="1.12 0.02 0.015" material="steel"/>' for y in (-0.11, 0.11)]
    out.append('    <geom type="cylinder" pos="-1.32 0 0.16" euler="0 1.5708 0" size="0.12 0.16" material="dark"/>')
    rotor = [
        '<geom type="cylinder" size="0.022 1.12" pos="0 0 1.14" material="steel"/>',
        '<geom type="cylinder" size="0.10 0.015" pos="0 0 0.03" material="steel"/>',
        '<geom type="box" size="0.045 0.012 0.004" pos="0.05 0 0.046" material="mark"/>',
        *(f'<geom type="box" size="0.004 0.023 0.02" pos="0.020 0 {0.1 + 0.1 * k:.2f}" material="mark"/>' for k in range(21)),
    ]
    names.append("rotor")
    out.append('    <body pos="-1.16 0 0.16" euler="0 1.5708 0"><joint name="rotor" axis="0 0 1"/>' + "".join(rotor) + "</body>")

    def piece(name: str, geoms: list[str], x: float) -> None:
        names.append(name)
        out.append(
            f'    <body pos="{x:.3f} 0 0.19"><joint name="{name}" type="slide" axis="1 0 0"/>' + "".join(geoms) + "</body>"
        )

    pitch = 0.62
    first = -0.5 * pitch * (n - 1)
    for i in range(n):
        colour = "orange" if i == n - 1 else "amber"
        name = "body0" if n == 1 else ("driver0" if i == 0 else f"body{i}")
        block = [
            f'<geom type="box" size="0.17 0.15 0.05" material="{colour}"/>',
            '<geom type="box" pos="0 -0.152 0" size="0.008 0.002 0.045" material="mark"/>',
        ]
        piece(name, block, first + pitch * i)
        if i < n - 1:
            x = first + pitch * i
            lug = f'<geom name="lug{i}" type="box" pos="0.26 0 0.06" size="0.02 0.05 0.05" rgba="0.35 0.75 0.35 1"/>'
            rod = '<geom type="box" pos="0.21 0 0.01" size="0.07 0.02 0.012" material="steel"/>'
            piece(f"driver{i}" if i else "lugs0", [lug, rod], x)
            piece(f"jaw{i}a", ['<geom type="box" pos="0.30 0 0.06" size="0.02 0.08 0.05" material="jaw"/>'], x)
            piece(f"jaw{i}b", ['<geom type="box" pos="0.22 0 0.06" size="0.02 0.08 0.05" material="jaw"/>'], x)
    return "\n".join([*out, "  </worldbody>", "</mujoco>"])
