"""The accurate MuJoCo runner: MuJoCo steps an axis natively, and its step is cut so that it lands on every event.

The axis is laid out as MuJoCo likes it best: each body on its own joint in its own units, each coupling a fixed tendon with
native stiffness and damping, the torque a native motor, RK4. Between events nothing but MuJoCo acts. At an event
`opt.timestep` is varied until the step ends on it; then the mode is switched in the model: the spring reference, stiffness and
damping of the tendon (contact, gap, and the backlash law that the axis names), the mass of a body that sticks. So static
friction with a peak and the 1999 gated backlash law hold, which plain MJCF cannot express.

Laws that MJCF lacks are called by address at each of the four stages, with MuJoCo's forward dynamics giving the acceleration
(``qfrc_applied`` and the mass matrix carry them), so they are of fourth order too; no global callback is set. The loop is
compiled and calls `mj_step` and `mj_forward` in MuJoCo's own library without the GIL: threads do not wait for one another.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjsim.accurate.model import NativeModel, native_model, native_xml
from mjsim.accurate.run import _run
from mjsim.axis import Axis
from mjsim.effects.base import NotApplicableError, need_torque_input
from mjsim.mjcf.compile import caught_warnings
from mjsim.ode import DivergedError, Trajectory, _sense, apply_input
from mjsim.system import LIMIT, System, assemble

__all__ = ["NativeModel", "native_model", "native_xml", "simulate"]


def simulate(
    axis: Axis | System,
    torque: np.ndarray,
    dt: float,
    *,
    step: float | None = None,
    initial: np.ndarray | None = None,
    before: float = 0.0,
    t0: float = 0.0,
) -> Trajectory:
    """Free-run an axis in MuJoCo on a commanded torque (N,) held over each sample of dt [s], landing on every event.

    ``step``: largest MuJoCo step [s], 0.25 ms when None; the sample time is cut into equal parts of at most that. ``initial``
    (2, n): angles and velocities at the start, at rest when None; ``before``: commanded torque ahead of the first sample.
    Raises DivergedError, NotApplicableError for a servo.
    """
    s = (axis if isinstance(axis, System) else assemble(axis)).resolved(dt)
    need_torque_input(s.chain)
    if s.soft:
        raise NotApplicableError("soft friction is MuJoCo's own: run the file")
    elements = s.elements[s.elements[:, 0] != LIMIT]  # MuJoCo's own too, and in the model
    n, count = s.n, len(torque)
    mine = native_model(s)
    m, d = mine.model, mine.data
    u = np.array(apply_input(s, np.asarray(torque, float)), float)
    x0 = s.initial(initial)
    delay = s.input_delay / dt
    shift = math.floor(delay + 1e-12)
    split = max(0.0, delay - shift)
    split = split if split >= 1e-9 else 0.0
    largest = 2.5e-4 if step is None else step
    speed = 100.0 if s.spatial > 0 else 0.0
    n_sub = max(math.ceil(dt / largest - 1e-9), 1 if step is not None else s.substeps(dt, speed))
    staged = s.input_lag > 0 or not s.affine
    out = np.empty((count, 2 * n + n - 1))
    address = np.array([m._address, d._address, mine.step, mine.forward], np.int64)
    with caught_warnings() as warnings:
        mujoco.mj_forward(m, d)
        status, at = _run(
            address, staged, s.f, s.gap_law, s.chain.gain, elements, s.parameters, s.has_friction, mine.tendon, u, dt, shift,
            split, float(before), s.input_lag, n_sub, x0, np.zeros(s.n_states), t0, out, d.qpos, d.qvel, d.qacc, d.qfrc_smooth,
            d.ctrl, d.qfrc_applied, m.dof_armature, m.dof_M0, m.tendon_stiffness, m.tendon_damping,
            m.tendon_lengthspring.reshape(-1, 2), mine.timestep,
        )  # fmt: skip
    if status or warnings:
        said = f" (MuJoCo: {warnings[0]})" if warnings else ""
        raise DivergedError(
            f"MuJoCo's run diverged at {t0 + at * dt:.4f} s, body {s.chain.bodies[0].joint!r}{said}; "
            "take a shorter step, or check signs of damping and stiffness"
        )
    time = t0 + dt * np.arange(count)
    velocity, measured = _sense(s, out[:, n], out[:, 0], dt)
    return Trajectory(
        time, np.array(torque, float), velocity.copy(), measured.copy(),
        out[:, :n].copy(), out[:, n : 2 * n].copy(), out[:, 2 * n :].copy(),
    )  # fmt: skip
