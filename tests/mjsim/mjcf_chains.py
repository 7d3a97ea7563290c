"""Single-axis chains written as MJCF in the ways in which people write them, beside the chain that each of them is."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Spec", "chain_xml"]


@dataclass(frozen=True)
class Spec:
    """A chain: inertias (n), viscous (n), stiffness and damping (n-1), ratio of the first coupling, motion, style.

    style: "nested" (relative joints), "side" (absolute joints joined by fixed tendons); tied: the gear is an equality.
    """

    inertia: tuple[float, ...]
    viscous: float
    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    ratio: float
    motion: str
    style: str
    gain: float


def chain_xml(s: Spec) -> str:
    """MJCF of a chain; the gear is an equality when nested, a tendon's coefficients when side by side."""
    bodies = _nested(s) if s.style == "nested" else _side(s)
    return f"""<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 0" timestep="0.0005" integrator="RK4"/>
{bodies}
  <actuator><motor name="drive" joint="j0" gear="{s.gain!r}"/></actuator>
  <sensor><jointvel name="speed" joint="j0"/><jointpos name="place" joint="j0"/></sensor>
</mujoco>"""


def _inertial(value: float, motion: str) -> str:
    mass, tensor = (value, 1.0) if motion == "slide" else (1.0, value)
    return f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="{tensor!r} {tensor!r} {tensor!r}"/>'


def _side(s: Spec) -> str:
    out, tendons = ["  <worldbody>"], ["  <tendon>"]
    for i, inertia in enumerate(s.inertia):
        damping = f' damping="{s.viscous!r}"' if i == 0 else ""
        out.append(
            f'    <body name="b{i}"><joint name="j{i}" type="{s.motion}" axis="0 0 1"{damping}/>'
            f"{_inertial(inertia, s.motion)}</body>"
        )
    for j, (k, d) in enumerate(zip(s.stiffness, s.damping, strict=True)):
        ratio = s.ratio if j == 0 else 1.0
        # written on twice the deflection: a quarter of stiffness and damping
        tendons.append(
            f'    <fixed name="t{j}" stiffness="{k / 4!r}" damping="{d / 4!r}"><joint joint="j{j}" coef="{2 * ratio!r}"/>'
            f'<joint joint="j{j + 1}" coef="-2"/></fixed>'
        )
    return "\n".join([*out, "  </worldbody>", *tendons, "  </tendon>"])


def _nested(s: Spec) -> str:
    """Motor on its own; the others nest behind a gear input tied to it, which takes a third of the motor's inertia."""
    n = len(s.inertia)
    if n == 1:
        return (
            f'  <worldbody><body name="b0"><joint name="j0" type="{s.motion}" axis="0 1 0" damping="{s.viscous!r}"/>'
            f"{_inertial(s.inertia[0], s.motion)}</body></worldbody>"
        )
    behind = s.inertia[0] / 3 / s.ratio**2
    out = [
        "  <worldbody>",
        f'    <body name="b0"><joint name="j0" type="{s.motion}" axis="0 1 0" damping="{s.viscous!r}"/>'
        f"{_inertial(2 * s.inertia[0] / 3, s.motion)}</body>",
        f'    <body name="input"><joint name="input" type="{s.motion}" axis="0 1 0"/>{_inertial(behind, s.motion)}',
    ]
    out += [
        f'    <body name="b{i}"><joint name="j{i}" type="{s.motion}" axis="0 1 0" stiffness="{s.stiffness[i - 1]!r}"'
        f' damping="{s.damping[i - 1]!r}"/>{_inertial(s.inertia[i], s.motion)}'
        for i in range(1, n)
    ]
    out += ["    " + "</body>" * n, "  </worldbody>"]
    out.append(f'  <equality><joint joint1="j0" joint2="input" polycoef="0 {1 / s.ratio!r} 0 0 0"/></equality>')
    return "\n".join(out)
