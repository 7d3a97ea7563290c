"""SO-101, six position servos: stiffness and friction of each joint from command and position, where gravity gives the scale.

    python -m lab.robot.so101 FOLDER [NAME...]     # recordings as Parquet

The chain is the published one (MuJoCo Menagerie, robotstudio_so101, Apache-2.0): numbers only, no meshes.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco

from diagnose.robot.servo import servo_by_gravity
from mjsim.robot.model import robot_from
from mjsim.robot.recording import load_robot_recording

__all__ = ["main", "so101_mjcf"]

CUTOFF = 4.0  # [Hz]: the loop's own bandwidth at most
RECORDINGS = (
    "friction_gravity",
    "sinusoidal_sweep",
    "trapezoidal_profile",
    "oscillation_low_freq",
    "center_workspace",
    "circular_motion",
)

# body, joint, pos, quat (wxyz), mass, centre, inertia (xx yy zz xy xz yz)
BODIES = (
    ("shoulder", "shoulder_pan", ".0388353 0 .0624", "0 0 -1 0", ".100006", "-.0307604 -1.7e-5 -.0252713",
     "8.3759e-5 8.10403e-5 2.39783e-5 7.6e-8 -1.16342e-6 1.54663e-7"),
    ("upper_arm", "shoulder_lift", "-.0303992 -.0182778 -.0542", "1 -1 -1 -1", ".103", "-.089847 -.008382 .018409",
     "4.08002e-5 1.47318e-4 1.42487e-4 -1.97819e-5 -4.03e-8 8.97e-9"),
    ("lower_arm", "elbow_flex", "-.11257 -.028 0", "1 0 0 1", ".104", "-.09807 .0032438 .018283",
     "2.87438e-5 1.59844e-4 1.4529e-4 7.41152e-6 1.26409e-6 -4.9e-8"),
    ("wrist", "wrist_flex", "-.1349 .0052 0", "1 0 0 -1", ".079", "-.000103312 -.0386143 .0281156",
     "3.68263e-5 2.5391e-5 2.1e-5 1.79e-8 -5.28e-8 3.6412e-6"),
    ("gripper", "wrist_roll", "0 -.0611 .0181", ".0172091 -.0172091 .706897 .706897", ".099", ".000214 .000245 -.025187",
     "2.75087e-5 4.33657e-5 3.45059e-5 -3.35e-7 -5.7352e-6 -5.18e-8"),
    ("moving_jaw", "gripper", ".0202 .0188 -.0234", "1 1 0 0", ".012", "-.001575 -.0300244 .0192755",
     "6.61e-6 1.89e-6 5.29e-6 -3.2e-7 -6e-9 -1.1e-7"),
)  # fmt: skip


def so101_mjcf() -> str:
    """The MJCF text, with position servos of the published gains."""
    lines = ['<mujoco model="so101">', '  <compiler angle="radian" balanceinertia="true"/>', "  <worldbody>"]
    for i, (body, joint, pos, quat, mass, centre, inertia) in enumerate(BODIES):
        pad = "  " * (i + 2)
        lines += [
            f'{pad}<body name="{body}" pos="{pos}" quat="{quat}">',
            f'{pad}  <joint name="{joint}" axis="0 0 1" armature=".028" damping=".60" frictionloss=".052"/>',
            f'{pad}  <inertial pos="{centre}" mass="{mass}" fullinertia="{inertia}"/>',
        ]
    lines += ["  " * (i + 2) + "</body>" for i in reversed(range(len(BODIES)))]
    servos = [f'    <position name="{joint}" joint="{joint}" kp="998.22" kv="2.731"/>' for _, joint, *_ in BODIES]
    return "\n".join([*lines, "  </worldbody>", "  <actuator>", *servos, "  </actuator>", "</mujoco>", ""])


def main(folder: Path, names: tuple[str, ...] = RECORDINGS) -> None:
    """Print the estimates from these recordings together."""
    robot = robot_from(mujoco.MjModel.from_xml_string(so101_mjcf()), "so101")
    recordings = [load_robot_recording(folder / f"{name}.parquet", robot) for name in names]
    for s in servo_by_gravity(robot, recordings, CUTOFF):
        scaled = f"F/kp {1e3 * s.friction_angle.value:.1f} mrad [{', '.join(f'{1e3 * c:.1f}' for c in s.friction_angle.ci95)}]"
        told = "scale not determined by gravity"
        if s.kp is not None and s.friction is not None:
            told = ", ".join(
                f"{k} {e.value:.3g} [{e.ci95[0]:.3g}, {e.ci95[1]:.3g}] {e.unit}"
                for k, e in (("kp", s.kp), ("friction", s.friction))
            )
        print(f"{s.joint:14s} {scaled}, kv/kp {s.time.value:.3f} s; {told}; {100 * s.share:.0f} % explained")


if __name__ == "__main__":
    main(Path(sys.argv[1]), tuple(sys.argv[2:]) or RECORDINGS)
