"""The published MJCF of SO-101 with its six position servos, and which of its recordings are fitted; `lab.proof.so101`.

The chain is the published one (MuJoCo Menagerie, robotstudio_so101, Apache-2.0): numbers only, no meshes. The recordings that
are fitted
hold one of each kind of excitation; all others are held out.
"""

from __future__ import annotations

import numpy as np

from diagnose.robot.result import RobotDiagnosis

__all__ = ["FITTED", "so101_mjcf", "summary_rows"]

FITTED = ("friction_gravity", "step_response", "chirp_sweep", "prbs_excitation", "oscillation_low_freq", "large_amplitude")

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


def so101_mjcf(friction: float = 0.052) -> str:
    """The MJCF text, with position servos of the published gains; friction [N m] of every joint, 0 for a file without."""
    lines = ['<mujoco model="so101">', '  <compiler angle="radian" balanceinertia="true"/>', "  <worldbody>"]
    loss = f' frictionloss="{friction:g}"' if friction else ""
    for i, (body, joint, pos, quat, mass, centre, inertia) in enumerate(BODIES):
        pad = "  " * (i + 2)
        lines += [
            f'{pad}<body name="{body}" pos="{pos}" quat="{quat}">',
            f'{pad}  <joint name="{joint}" axis="0 0 1" armature=".028" damping=".60"{loss}/>',
            f'{pad}  <inertial pos="{centre}" mass="{mass}" fullinertia="{inertia}"/>',
            f'{pad}  <geom type="capsule" fromto="0 0 0 {_end(i)}" size="{0.016 - 0.001 * i:.3f}" mass="0" contype="0" '
            'conaffinity="0"/>',
        ]
    lines += ["  " * (i + 2) + "</body>" for i in reversed(range(len(BODIES)))]
    servos = [
        f'    <position name="{joint}" joint="{joint}" kp="998.22" kv="2.731" forcerange="-2.94 2.94"/>'
        for _, joint, *_ in BODIES
    ]
    return "\n".join([*lines, "  </worldbody>", "  <actuator>", *servos, "  </actuator>", "</mujoco>", ""])


def _end(body: int) -> str:
    """Where the geom of a link ends: at the next joint, the last one at its tip."""
    return BODIES[body + 1][2] if body + 1 < len(BODIES) else "-.003 -.07 .02"


def summary_rows(d: RobotDiagnosis) -> list[tuple[str, float, float, int]]:
    """By joint: name, median over the held-out recordings in which it moves of the rms error [mrad] of the file, and of
    corrected.xml,
    all joints together in MuJoCo; and the number of these recordings."""
    assert d.closed_loop is not None
    out = []
    for name, rows in d.closed_loop["joints"].items():
        kept = [r for r in rows if r["role"] == "held-out" and r["moves"]]
        out.append((name, *(1e3 * float(np.median([r[k] for r in kept])) for k in ("nominal_rms", "corrected_rms")), len(kept)))
    return out
