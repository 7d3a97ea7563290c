"""A robot's inverse dynamics for the concealed plant: recursive Newton-Euler in link frames, one sample at a time for all
samples.

Written from the textbook (J. J. Craig, Introduction to Robotics (2005), ch. 6), with its own description of an arm: it
shares no code with
`mjsim`, which it is there to test. The arm is a serial chain of hinges; a link's frame has its origin on its joint's axis.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Arm", "Link", "six_axes", "three_axes"]

GRAVITY = 9.81


@dataclass(frozen=True)
class Link:
    """One link: where its joint stands in the frame of the link before (m), about which of its axes it turns, and its matter.

    centre [m], inertia (3,) about the centre along the frame's axes [kg m^2], rotor inertia seen at the joint [kg m^2],
    viscous friction [N m s/rad]; limits of the joint [rad]; speed: largest [rad/s].
    """

    name: str
    place: tuple[float, float, float]
    axis: tuple[int, int, int]
    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float]
    rotor: float
    viscous: float
    limit: float
    speed: float


@dataclass(frozen=True)
class Arm:
    """A serial arm of hinges on a fixed base."""

    links: tuple[Link, ...]

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Torque (N, n) of the joints for a motion (N, n), friction and rotors left out."""
        n, samples = len(self.links), len(q)
        turn = [_rotation(np.array(link.axis, float), q[:, i]) for i, link in enumerate(self.links)]
        w = dw = np.zeros((samples, 3))
        acc = np.tile([0.0, 0.0, GRAVITY], (samples, 1))
        forces, moments = [], []
        for i, link in enumerate(self.links):
            back = np.swapaxes(turn[i], 1, 2)
            place, z = np.array(link.place), np.array(link.axis, float)
            acc = acc + _cross(dw, place) + _cross(w, _cross(w, place))
            acc, w, dw = (_apply(back, x) for x in (acc, w, dw))
            dw = dw + _cross(w, z * v[:, i, None]) + z * a[:, i, None]
            w = w + z * v[:, i, None]
            c, inertia = np.array(link.centre), np.array(link.inertia)
            forces.append(link.mass * (acc + _cross(dw, c) + _cross(w, _cross(w, c))))
            moments.append(dw * inertia + _cross(w, w * inertia))
        out = np.empty((samples, n))
        f = m = np.zeros((samples, 3))
        for i in reversed(range(n)):
            link = self.links[i]
            if i + 1 < n:
                place = np.array(self.links[i + 1].place)
                f = _apply(turn[i + 1], f)
                m = _apply(turn[i + 1], m) + _cross(place, f)
            f = f + forces[i]
            m = m + moments[i] + _cross(np.array(link.centre), forces[i])
            out[:, i] = m @ np.array(link.axis, float)
        return out

    def with_link(self, index: int, **changes: object) -> Arm:
        """A copy with another link."""
        links = list(self.links)
        links[index] = dataclasses.replace(links[index], **changes)  # type: ignore[arg-type]
        return Arm(tuple(links))

    def with_payload(self, mass: float, at: Sequence[float]) -> Arm:
        """A copy with a point mass [kg] on the last link."""
        last = self.links[-1]
        both = (last.mass * np.array(last.centre) + mass * np.array(at)) / (last.mass + mass)
        inertia = np.diag(last.inertia).astype(float)
        for m, c in ((last.mass, np.array(last.centre)), (mass, np.array(at))):
            r = c - both
            inertia += m * (r @ r * np.eye(3) - np.outer(r, r))
        # products of inertia are left out: the true arm is then another body, as sound as the first
        return self.with_link(len(self.links) - 1, mass=last.mass + mass, centre=tuple(both), inertia=tuple(np.diag(inertia)))

    def mjcf(self, name: str) -> str:
        """The arm as MJCF, with geoms, a light and a camera for the eye."""
        reach = sum(float(np.linalg.norm(link.place)) for link in self.links[2:]) + float(np.linalg.norm(self._tip()))
        top = sum(link.place[2] for link in self.links[:2]) + reach
        eye = np.array([0.0, 0.0, 0.5 * top]) + 1.65 * top * np.array([0.40, -0.84, 0.36])
        lines = [
            f'<mujoco model="{name}">', '  <compiler angle="radian" autolimits="true"/>',
            '  <option timestep="0.001" integrator="implicitfast"/>',
            "  <visual>",
            '    <headlight ambient="0.35 0.35 0.35" diffuse="0.35 0.35 0.35" specular="0.1 0.1 0.1"/>',
            "  </visual>",
            "  <default>", '    <geom contype="0" conaffinity="0" mass="0" group="1"/>', "  </default>",
            "  <asset>",
            '    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.95 0.96 0.98" rgb2="0.74 0.80 0.87" width="64" '
            'height="384"/>',
            '    <texture name="floor" type="2d" builtin="checker" rgb1="0.82 0.84 0.86" rgb2="0.77 0.79 0.82" width="256" '
            'height="256"/>',
            '    <material name="floor" texture="floor" texrepeat="4 4" texuniform="true" specular="0" reflectance="0"/>',
            '    <material name="shell" rgba="0.93 0.94 0.95 1" specular="0.3" shininess="0.5"/>',
            '    <material name="joint" rgba="0.13 0.38 0.60 1" specular="0.4" shininess="0.6"/>',
            '    <material name="cap" rgba="0.20 0.22 0.25 1" specular="0.3" shininess="0.5"/>',
            "  </asset>", "  <worldbody>",
            '    <light type="directional" pos="1 -2 4" dir="-0.35 0.5 -1" diffuse="0.55 0.55 0.55" specular="0.2 0.2 0.2"/>',
            f'    <camera name="overview" pos="{_text(eye)}" xyaxes="0.90 0.43 0 -0.155 0.324 0.933"/>',
            '    <geom name="floor" type="plane" size="0 0 0.05" material="floor"/>',
            '    <geom name="base" type="cylinder" pos="0 0 0.012" size="0.13 0.012" material="cap"/>',
            '    <geom name="pedestal" type="cylinder" pos="0 0 0.045" size="0.08 0.035" material="joint"/>',
        ]  # fmt: skip
        for i, link in enumerate(self.links):
            pad, size = "  " * (i + 2), 0.058 * 0.9**i
            after = np.array(self.links[i + 1].place if i + 1 < len(self.links) else self._tip())
            axis = np.array(link.axis)
            housing, caps = 1.05 * size * axis, 1.25 * size * axis
            lines += [
                f'{pad}<body name="{link.name}" pos="{_text(link.place)}">',
                f'{pad}  <joint name="joint{i + 1}" axis="{_text(link.axis)}" range="-{link.limit} {link.limit}" '
                f'armature="{link.rotor}" '
                f'damping="{link.viscous}"/>',
                f'{pad}  <inertial mass="{link.mass}" pos="{_text(link.centre)}" diaginertia="{_text(link.inertia)}"/>',
                f'{pad}  <geom type="cylinder" fromto="{_text(-housing)} {_text(housing)}" size="{size:.4g}" material="joint"/>',
                f'{pad}  <geom type="cylinder" fromto="{_text(-caps)} {_text(caps)}" size="{0.78 * size:.4g}" material="cap"/>',
                f'{pad}  <geom type="capsule" fromto="0 0 0 {_text(after)}" size="{0.68 * size:.4g}" material="shell"/>',
            ]
        end, out = np.array(self._tip()), np.array(self._tip()) / np.linalg.norm(self._tip())
        pad, size = "  " * (len(self.links) + 1), 0.058 * 0.9 ** (len(self.links) - 1)
        lines.append(
            f'{pad}  <geom name="tool" type="cylinder" fromto="{_text(end)} {_text(end + 0.6 * size * out)}" size="{size:.4g}" '
            'material="cap"/>'
        )
        for i in reversed(range(len(self.links))):
            lines.append("  " * (i + 2) + "</body>")
        lines += ["  </worldbody>", "  <actuator>"]
        lines += [f'    <motor name="motor{i + 1}" joint="joint{i + 1}"/>' for i in range(len(self.links))]
        return "\n".join([*lines, "  </actuator>", "</mujoco>", ""])

    def _tip(self) -> tuple[float, float, float]:
        """Where the last link ends, beyond its centre of mass [m]."""
        x, y, z = 1.6 * np.array(self.links[-1].centre)
        return float(x), float(y), float(z)


def _text(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{float(v):.6g}" for v in values)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of (N, 3) or (3,), as `numpy.cross` without what it does for other shapes."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def _apply(R: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.asarray(np.matmul(R, x[:, :, None])[:, :, 0])


def _rotation(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) about an axis of the frame."""
    c, s, one = np.cos(angle), np.sin(angle), np.ones_like(angle)
    zero = np.zeros_like(angle)
    k = int(np.argmax(np.abs(axis)))
    s = s * axis[k]
    rows = {
        0: [one, zero, zero, zero, c, -s, zero, s, c],
        1: [c, zero, s, zero, one, zero, -s, zero, c],
        2: [c, -s, zero, s, c, zero, zero, zero, one],
    }[k]
    return np.stack(rows, axis=-1).reshape(-1, 3, 3)


def three_axes() -> Arm:
    """An arm of three joints: a turntable and two links in a vertical plane; 0.7 m, 7 kg."""
    return Arm(
        (
            Link("column", (0, 0, 0.10), (0, 0, 1), 2.6, (0, 0, 0.10), (0.012, 0.012, 0.006), 0.06, 0.5, 2.6, 2.0),
            Link("upper_arm", (0, 0, 0.20), (0, 1, 0), 2.8, (0.01, 0, 0.17), (0.030, 0.030, 0.004), 0.08, 0.8, 1.8, 1.8),
            Link("forearm", (0, 0, 0.36), (0, 1, 0), 1.6, (0.14, 0.01, 0.02), (0.003, 0.014, 0.014), 0.03, 0.3, 2.2, 2.4),
        )
    )


def six_axes() -> Arm:
    """An arm of six joints with a wrist; 0.9 m, 15 kg."""
    return Arm(
        (
            Link("column", (0, 0, 0.12), (0, 0, 1), 4.2, (0, 0.01, 0.12), (0.030, 0.030, 0.014), 0.16, 1.2, 2.8, 1.8),
            Link("upper_arm", (0, 0, 0.24), (0, 1, 0), 4.6, (0.01, 0.04, 0.20), (0.075, 0.075, 0.010), 0.20, 1.6, 1.9, 1.6),
            Link("forearm", (0, 0, 0.42), (0, 1, 0), 2.8, (0.10, -0.02, 0.03), (0.008, 0.022, 0.022), 0.09, 0.7, 2.3, 2.0),
            Link("wrist_roll", (0.34, 0, 0.04), (1, 0, 0), 1.4, (-0.06, 0, 0), (0.003, 0.006, 0.006), 0.025, 0.20, 2.8, 2.8),
            Link("wrist_pitch", (0.09, 0, 0), (0, 1, 0), 1.1, (0.03, 0, 0), (0.002, 0.003, 0.003), 0.020, 0.16, 2.0, 2.8),
            Link("flange", (0.08, 0, 0), (1, 0, 0), 0.6, (0.04, 0.005, 0), (0.0010, 0.0012, 0.0012), 0.010, 0.08, 2.8, 3.2),
        )
    )
