"""The MJCF of a KUKA KR300 R2500 from its published Denavit-Hartenberg table, with primitive geoms.

Source of the numbers: J. Weigand, J. Ulmen, A. Janot, M. Ruskowski, 2021; repository JonasWeigand/Robot_Identification (MIT).
Standard convention: frame i = Rz(q) Tz(d) Tx(a) Rx(alpha) of frame i - 1; base turned by 180 deg about x. The table says no more of the zero
positions than an offset of axis 3; those of axes 2 and 3 (-90 and 180 deg: upper arm upright) are the ones of all multiples of 90 deg
that the recorded torques bear out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

__all__ = ["AXES", "LinkRow", "kuka_mjcf"]


@dataclass(frozen=True)
class LinkRow:
    """One row of the table: d, a [m], alpha, offset [rad], mass [kg], centre [m], inertia (xx yy zz xy yz xz) about it [kg m^2].

    rotor: inertia of the rotor on the motor side [kg m^2]; ratio: gear; viscous [N m s/rad], coulomb [N m]: motor side.
    """

    d: float
    a: float
    alpha: float
    offset: float
    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]
    rotor: float
    ratio: float
    viscous: float
    coulomb: float


def _row(d: float, a: float, alpha: float, mass: float, centre: tuple[float, ...], inertia: tuple[float, ...], rotor: float,
         ratio: float, viscous: float, coulomb: float, offset: float = 0.0) -> LinkRow:  # fmt: skip
    x, y, z = (c * 1e-3 for c in centre)
    xx, yy, zz, xy, yz, xz = (i * 1e-6 for i in inertia)
    return LinkRow(
        d, a, math.radians(alpha), math.radians(offset), mass, (x, y, z), (xx, yy, zz, xy, yz, xz), rotor, ratio, viscous, coulomb
    )


AXES = (
    _row(-0.675, 0.350, 90, 395.40, (-353, 174, -4), (16733765, 29799119, 32814954, -1703664, 129384, 4404062), 0.00923, 1798 / 7,
         0.00147635, 0.7319),
    _row(-0.189, 1.15, 0, 339.12, (-709, -1, 23), (7507819, 88886691, 88673761, 430046, 173157, -4396607), 0.0118, 1872 / 7,
         0.01068183, 1.8323, -90),
    _row(0.189, 0.041, -90, 105.21, (-18, -18, -76), (10783798, 10186135, 1943179, 118474, -606384, -101950), 0.0118, 757 / 3,
         0.08398663, 1.8626, 180),
    _row(-1.0, 0.0, 90, 35.80, (0, 236, 1), (425035, 217993, 428465, -4, -11353, -27), 0.00173, 221.0, 0.00191608, 0.4480),
    _row(0.0, 0.0, -90, 31.46, (0, -80, -9), (283826, 229562, 258266, -4, -19521, -120), 0.00173, 5032 / 21, 0.00162988, 0.4132),
    _row(-0.24, 0.0, 180, 17.78, (0, 0, -50), (0, 0, 0, 0, 0, 0), 0.00173, 206793 / 1340, 0.00220532, 0.3726),
)  # fmt: skip


def _rx(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _quat(R: np.ndarray) -> np.ndarray:
    out = np.zeros(4)
    mujoco.mju_mat2Quat(out, np.ascontiguousarray(R, float).ravel())
    return out


def _text(values: np.ndarray | list[float] | tuple[float, ...]) -> str:
    return " ".join(f"{v:.9g}" for v in np.where(np.abs(values) < 1e-12, 0.0, values))


def _inertial(row: LinkRow, extra: tuple[float, tuple[float, float, float]] | None) -> str:
    """The <inertial> of a link in the frame of its joint, in principal axes; a point mass may be added."""
    R, shift = _rx(row.alpha), np.array([row.a, 0.0, row.d])
    xx, yy, zz, xy, yz, xz = row.inertia
    central = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    mass, centre = row.mass, np.array(row.centre)
    if not central.any():  # none is given: a solid flange of 0.1 m radius and 0.1 m length
        central = mass * np.diag([0.0033333, 0.0033333, 0.005])
    if extra is not None:
        added, at = extra[0], np.array(extra[1])
        both = (mass * centre + added * at) / (mass + added)
        for m, c in ((mass, centre), (added, at)):
            r = c - both
            central = central + m * (r @ r * np.eye(3) - np.outer(r, r))
        mass, centre = mass + added, both
    values, axes = np.linalg.eigh(central)
    values, axes = values[::-1], axes[:, ::-1].copy()
    if np.linalg.det(axes) < 0:
        axes[:, 2] *= -1
    return (
        f'<inertial mass="{mass:.9g}" pos="{_text(R @ centre + shift)}" quat="{_text(_quat(R @ axes))}" '
        f'diaginertia="{_text(values)}"/>'
    )


_LOOK = (  # what is drawn in the frame of each joint: thick boxes and tubes from one axis to the next
    '<geom type="cylinder" fromto="0 0 -.12 0 0 -.62" size=".33" material="orange"/><geom type="box" pos=".2 0 -.6" size=".28 .2 .18" material="orange"/>',
    '<geom type="cylinder" fromto="0 0 -.3 0 0 .02" size=".22" material="dark"/><geom type="capsule" fromto=".1 0 -.19 1.05 0 -.19" size=".15" material="orange"/>',
    '<geom type="cylinder" fromto="0 0 -.05 0 0 .38" size=".18" material="dark"/><geom type="box" pos=".04 0 .19" size=".17 .2 .17" material="orange"/>',
    '<geom type="cylinder" fromto="0 0 -.15 0 0 -.85" size=".12" material="orange"/>',
    '<geom type="cylinder" fromto="0 0 -.14 0 0 .14" size=".11" material="dark"/>',
    '<geom type="cylinder" fromto="0 0 -.1 0 0 -.24" size=".09" material="orange"/>',
)


def kuka_mjcf(payload: float = 0.0, *, friction: bool = False) -> str:
    """The MJCF text; ``payload`` [kg] at the place that the authors' file gives it; ``friction``: with the published Coulomb friction."""
    lines = [
        "<!--",
        "  KUKA KR300 R2500, six axes, as far as it is known before measuring: the published table of J. Weigand, J. Ulmen, A. Janot and",
        "  M. Ruskowski (2021, github.com/JonasWeigand/Robot_Identification, MIT): geometry, masses, rotors, gears, viscous friction.",
        f"  {'With' if friction else 'No'} dry friction. The recorded torque is the motor's, the angles are the joints'. SI units, radians. Geoms only",
        "  for the eye.",
        "-->",
        '<mujoco model="kuka_kr300">',
        '  <compiler angle="radian" autolimits="true"/>',
        '  <option timestep="0.0005" integrator="implicitfast"/>',
        "  <default>",
        '    <geom contype="0" conaffinity="0" mass="0" group="1"/>',
        '    <joint axis="0 0 1" range="-6.2 6.2"/>',
        "  </default>",
        "  <asset>",
        '    <material name="orange" rgba="0.93 0.43 0.10 1"/>',
        '    <material name="dark" rgba="0.18 0.19 0.22 1"/>',
        "  </asset>",
        "  <worldbody>",
        '    <light pos="2 -3 5" dir="-0.3 0.5 -1" diffuse="0.8 0.8 0.8"/>',
        '    <camera name="overview" pos="1.2 -5.6 2.6" xyaxes="1 0 0 0 0.3 0.95"/>',
        '    <geom name="floor" type="plane" size="4 4 0.1" rgba="0.85 0.86 0.88 1"/>',
        '    <geom name="base" type="cylinder" pos="0 0 0.06" size="0.5 0.06" material="dark"/>',
    ]
    place, R = np.zeros(3), _rx(math.pi)
    depth = 4
    for i, row in enumerate(AXES):
        turn = np.array(
            [[math.cos(row.offset), -math.sin(row.offset), 0], [math.sin(row.offset), math.cos(row.offset), 0], [0, 0, 1]]
        )
        pad = " " * depth
        lines += [
            f'{pad}<body name="link{i + 1}" pos="{_text(place)}" quat="{_text(_quat(R @ turn))}">',
            f'{pad}  <joint name="axis{i + 1}" armature="{row.rotor * row.ratio**2:.9g}" damping="{row.viscous * row.ratio**2:.9g}"'
            + (f' frictionloss="{row.coulomb * row.ratio:.9g}"' if friction else "") + "/>",
            f"{pad}  {_inertial(row, (payload, (0.0, 0.0, -0.05)) if i == 5 and payload > 0 else None)}",
            f"{pad}  {_LOOK[i]}",
        ]  # fmt: skip
        place, R = np.array([row.a, 0.0, row.d]), _rx(row.alpha)
        depth += 2
    for _ in AXES:
        depth -= 2
        lines.append(f"{' ' * depth}</body>")
    lines += ["  </worldbody>", "  <actuator>", "    <!-- motor torque in, joint torque out -->"]
    lines += [f'    <motor name="motor{i + 1}" joint="axis{i + 1}" gear="{row.ratio:.9g}"/>' for i, row in enumerate(AXES)]
    lines += ["  </actuator>", "</mujoco>", ""]
    return "\n".join(lines)
