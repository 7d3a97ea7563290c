"""A recording of one joint by plain MuJoCo, with friction that its file lacks."""

from __future__ import annotations

import mujoco
import numpy as np

from mjsim.recording import Recording

DT, SIGMA = 5e-3, 0.005


def rotor_log(xml: str, seed: int, drag: float = 0.0) -> Recording:
    """Under a chirp of torque, with noise; ``drag``: coefficient of friction by the square of the velocity."""
    m = mujoco.MjModel.from_xml_string(xml)
    d, rng = mujoco.MjData(m), np.random.default_rng(seed)
    t = DT * np.arange(1200)
    u = 2.0 * np.sin(2 * np.pi * (0.4 + 0.2 * t) * t + seed) * np.minimum(t, 1.0)
    q, v = np.empty(len(t)), np.empty(len(t))
    for k in range(len(t)):
        q[k], v[k] = d.qpos[0], d.qvel[0]
        d.ctrl[0] = u[k] - drag * v[k] * abs(v[k])
        mujoco.mj_step(m, d)
    noise = rng.standard_normal((2, len(t)))
    return Recording(t, u, v + SIGMA * noise[0], q + 1e-4 * noise[1], DT, source=f"log_{seed}.csv")
