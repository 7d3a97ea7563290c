"""Which torque maps there may be: over one or two state variables, at every place of a chain."""

from __future__ import annotations

import itertools

import numpy as np

from diagnose.data.experiment import measured_velocity
from diagnose.data.runs import free_run
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.thresholds import INTERVALS
from mjsim.ode import DivergedError, apply_input
from mjsim.system import assemble
from mjsim.torque_map import MapAxis, TorqueMap

__all__ = ["shapes", "variables", "words"]


def words(shape: TorqueMap) -> str:
    """A map by its place and variables."""
    return f"{'in' if shape.coupling else 'at'} the {shape.place} over {' and '.join(a.variable for a in shape.axes)}"


# what a map may depend on


def variables(fitter: Fitter, fitted: Fitted) -> list[dict[tuple[str, bool, str], np.ndarray]] | None:
    """For each experiment (place, coupling, variable) -> values at every recorded sample; None when the model cannot be run."""
    chain = fitted.axis.chain
    places = [(p, i) for p in TorqueMap.places if (i := chain.body(p)) is not None and (i > 0 or p == "motor")]
    joints = [(p, j) for p in TorqueMap.places if (j := chain.coupling(p)) is not None]
    if len(chain.bodies) == 1:
        places = places[:1]
    out = []
    for r, experiment in enumerate(fitter.experiments):
        recording = experiment.recording
        axis = fitted.hypothesis.axis(fitted.fit.x, r)
        own: dict[tuple[str, bool, str], np.ndarray] = {}
        if fitter.view.channel == "torque":
            v, q = measured_velocity(recording), recording.angle
            own[("motor", False, "velocity")] = _smooth(v, recording.dt)
            own[("motor", False, "time")] = recording.time
            if q is not None:
                own[("motor", False, "angle")] = q
            out.append(own)
            continue
        try:
            y = free_run(axis, experiment, fitted.hypothesis.initial(fitted.fit.x, r))
        except (DivergedError, ValueError):
            return None
        command = apply_input(assemble(axis), recording.input)
        shift = recording.angle - y.q[:, 0] if recording.angle is not None else np.zeros(len(recording))
        for place, i in places:
            # the model errs, hence is here: the motor's speed as measured
            own[(place, False, "velocity")] = _smooth(measured_velocity(recording), recording.dt) if i == 0 else y.v[:, i]
            own[(place, False, "angle")] = y.q[:, i] + chain.total_ratio(i) * shift
            if i == 0:
                own[(place, False, "torque command")] = command
                own[(place, False, "time")] = recording.time - recording.time[0]
            if len(chain.bodies) > 1:
                own[(place, False, "load")] = (
                    chain.couplings[0].ratio * y.coupling_torque[:, 0] if i == 0 else y.coupling_torque[:, i - 1]
                )
        for place, j in joints:
            ratio = chain.couplings[j].ratio
            own[(place, True, "deflection")] = ratio * y.q[:, j] - y.q[:, j + 1]
            own[(place, True, "deflection rate")] = ratio * y.v[:, j] - y.v[:, j + 1]
            own[(place, True, "angle")] = y.q[:, j] + chain.total_ratio(j) * shift
        out.append(own)
    return out


def _smooth(v: np.ndarray, dt: float) -> np.ndarray:
    width = max(3, int(0.002 / dt))
    kernel = np.hanning(width + 2)[1:-1]
    return np.convolve(v, kernel / kernel.sum(), mode="same")


def shapes(known: list[dict[tuple[str, bool, str], np.ndarray]]) -> list[TorqueMap]:
    """Every map over one and over two variables of one place."""
    keys = list(known[0])
    out = []
    for place, coupling in dict.fromkeys((p, c) for p, c, _ in keys):
        names = [v for p, c, v in keys if (p, c) == (place, coupling)]
        for chosen in [(v,) for v in names] + list(itertools.combinations(names, 2)):
            intervals = INTERVALS[len(chosen) - 1]
            axes = [MapAxis.spanning(v, np.concatenate([k[(place, coupling, v)] for k in known]), intervals) for v in chosen]
            found = tuple(a for a in axes if a is not None)
            if len(found) == len(axes):
                out.append(TorqueMap(place=place, axes=found, coefficients=(0.0,) * TorqueMap.count(found), coupling=coupling))
    return out


# the regression
