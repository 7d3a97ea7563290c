"""Typical sizes at each place of an axis, from a nominal run on the recordings: the starts of every fit are multiples of them."""

from __future__ import annotations

import numpy as np

from diagnose.experiment import Experiment, measured_velocity
from mjsim.axis import Axis
from mjsim.effects import Scales
from mjsim.ode import DivergedError, simulate

__all__ = ["PLACES", "scales_by_place"]

PLACES = ("motor", "gearbox", "arm", "actuator", "sensor")


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def scales_by_place(axis: Axis, experiment: Experiment, orders: tuple[float, ...] = ()) -> dict[str, Scales]:
    """Scales at every place. Where the nominal free run diverges, rigid-body estimates stand in for it."""
    r = experiment.recording
    chain = axis.chain
    v = measured_velocity(r)
    q = r.angle if r.angle is not None else np.cumsum(v) * r.dt
    n = len(chain.bodies)
    try:
        y = simulate(axis, r.torque, r.dt, before=experiment.before)
        torque, deflect = y.coupling_torque, [c.ratio * y.q[:, j] - y.q[:, j + 1] for j, c in enumerate(chain.couplings)]
    except DivergedError:
        accel = np.gradient(v, r.dt)
        torque = np.empty((len(v), n - 1))
        deflect = []
        for j, c in enumerate(chain.couplings):
            behind = sum(b.inertia * chain.total_ratio(i) for i, b in enumerate(chain.bodies) if i > j)
            torque[:, j] = behind * accel
            deflect.append(torque[:, j] / c.stiffness)
    out = {}
    for place in PLACES:
        found = chain.body(place)
        at: int = found if found is not None else 0
        joint = chain.coupling(place)
        load = torque[:, joint] if joint is not None else chain.gain * r.torque
        if joint is None and n > 1 and place == "arm":
            load = torque[:, -1]
        ratio = chain.total_ratio(at)
        out[place] = Scales(
            torque=_rms(load), max_torque=float(np.max(np.abs(load))), velocity=ratio * _rms(v),
            max_velocity=ratio * float(np.max(np.abs(v))), deflection=_rms(deflect[joint]) if joint is not None else 1.0,
            inertia=chain.bodies[at].inertia, stiffness=chain.couplings[joint].stiffness if joint is not None else 1.0,
            travel=ratio * float(np.ptp(q)), input=_rms(r.torque), max_input=float(np.max(np.abs(r.torque))), output=_rms(v),
            dt=r.dt, duration=r.duration, orders=tuple(o / ratio for o in orders) if at else orders,
        )  # fmt: skip
    return out
