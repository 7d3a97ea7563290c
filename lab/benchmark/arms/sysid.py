"""`mujoco.sysid` on the nominal structure: MuJoCo's own fitter, every linear parameter free, by free runs of the MJCF itself.

Each parameter is a factor on the number in the file. The observed signal is the joint's velocity from the state, since the sensor
data of a rollout are those of the step before. Bounds are those of the diagnosis: a tenth to ten times for inertias and
stiffnesses, 20 times either way for dampings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lab.benchmark.arms.base import Answer, Arm, Task
from mjsim.errors import InputError
from mjsim.mjcf.compile import caught_warnings
from mjsim.recording import Recording

__all__ = ["ARM", "Parameter", "Problem", "fit", "linear_parameters"]

ITERATIONS = 25  # as many as a fit of the diagnosis has
JOINT = "motor"  # the measured one

Modifier = Callable[[Any, float], None]  # (MjSpec, factor)


@dataclass(frozen=True)
class Parameter:
    """A number of the file: its bounds as factors, and what a factor does to the spec."""

    name: str
    lower: float
    upper: float
    apply: Modifier


def linear_parameters(spec: Any) -> tuple[Parameter, ...]:
    """Jm (split between rotor and gear input), Jg, Ja, fm, kg, ka, dg, da of `models/robot_axis1.xml`."""
    inertia = {n: np.array(spec.body(n).inertia) for n in ("motor_rotor", "gear_input", "gearbox", "arm")}
    stiffness = {n: np.array(spec.joint(n).stiffness) for n in ("gearbox", "arm")}
    damping = {n: np.array(spec.joint(n).damping) for n in (JOINT, "arm")}
    tendon = np.array(spec.tendon("gearbox_damper").damping)

    def of_bodies(*names: str) -> Modifier:
        def apply(s: Any, factor: float) -> None:
            for n in names:
                s.body(n).inertia = inertia[n] * factor

        return apply

    def of_joint(name: str, field: str, value: np.ndarray) -> Modifier:
        return lambda s, factor: setattr(s.joint(name), field, value * factor)

    def of_tendon(s: Any, factor: float) -> None:
        s.tendon("gearbox_damper").damping = tendon * factor

    scale, either = (0.1, 10.0), (-20.0, 20.0)
    return (
        Parameter("Jm", *scale, of_bodies("motor_rotor", "gear_input")),
        Parameter("Jg", *scale, of_bodies("gearbox")),
        Parameter("Ja", *scale, of_bodies("arm")),
        Parameter("fm", *either, of_joint(JOINT, "damping", damping[JOINT])),
        Parameter("kg", *scale, of_joint("gearbox", "stiffness", stiffness["gearbox"])),
        Parameter("ka", *scale, of_joint("arm", "stiffness", stiffness["arm"])),
        Parameter("dg", *either, of_tendon),
        Parameter("da", *either, of_joint("arm", "damping", damping["arm"])),
    )


class Problem:
    """A model file with free parameters, as `mujoco.sysid` wants it; fits one recording and runs free on any."""

    def __init__(self, model: Path, parameters: Callable[[Any], tuple[Parameter, ...]] = linear_parameters, threads: int = 1):
        from importlib import import_module

        import mujoco

        sysid: Any = import_module("mujoco.sysid")  # optional, and without types
        self._sysid = sysid
        self._spec = mujoco.MjSpec.from_file(str(model))
        self._model = self._spec.compile()
        self._threads = threads
        self._signal = (f"{JOINT}_qvel", sysid.SignalType.MjStateQVel)
        self._dict = sysid.ParameterDict()
        for p in parameters(self._spec):
            self._dict.add(sysid.Parameter(p.name, 1.0, p.lower, p.upper, modifier=_modifier(p.apply)))

    def residual(self, recording: Recording) -> Any:
        """The residual function of a recording that starts at rest, for `sysid.optimize`."""
        if recording.velocity is None:
            raise InputError(recording.source, "no velocity", "a velocity channel")
        sysid, m = self._sysid, self._model
        if abs(recording.dt / m.opt.timestep - 1) > 1e-9:
            raise InputError(recording.source, f"sampled every {recording.dt:g} s", f"the model's step of {m.opt.timestep:g} s")
        control = sysid.TimeSeries.from_control_names(recording.time, recording.torque[:, None], m)
        measured = sysid.TimeSeries.from_names(recording.time, recording.velocity[:, None], m, [self._signal])
        start = sysid.create_initial_state(m, np.zeros(m.nq), np.zeros(m.nv), np.zeros(m.na))
        with _quiet():  # that sensors of the model are not measured is meant
            sequence = sysid.ModelSequences("axis", self._spec, "log", start, control, measured, allow_missing_sensors=True)
        return sysid.build_residual_fn(models_sequences=[sequence], n_threads=self._threads, enabled_observations=[self._signal])

    def fit(self, recording: Recording, *, iterations: int = ITERATIONS, **options: Any) -> dict[str, float]:
        """Fitted factors by name; ``options`` go to MuJoCo's least squares."""
        with _quiet(), caught_warnings():
            fitted, _ = self._sysid.optimize(
                self._dict, self.residual(recording), optimizer="mujoco", verbose=False, max_iters=iterations, **options
            )
        return {n: float(p.value[0]) for n, p in fitted.items()}

    def error(self, factors: Mapping[str, float], recording: Recording) -> np.ndarray:
        """Measured less simulated velocity [rad/s] from the second sample on, from rest."""
        x = np.array([factors[n] for n in self._dict.keys()])  # noqa: SIM118  (not a mapping)
        with caught_warnings():
            _, predicted, measured = self.residual(recording)(x, self._dict.copy())
        return np.asarray(measured[0][0].data - predicted[0][0].data)[:, 0]


def _modifier(apply: Modifier) -> Callable[[Any, Any], None]:
    return lambda spec, parameter: apply(spec, float(parameter.value[0]))


@contextmanager
def _quiet() -> Iterator[None]:
    """Neither the tables on standard output nor the warnings of absl."""
    import contextlib
    import io

    from absl import logging

    before = logging.get_verbosity()
    logging.set_verbosity(logging.ERROR)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        logging.set_verbosity(before)


def fit(task: Task) -> Answer:
    """Fit on the estimation recording, run free on the held-out one."""
    problem = Problem(task.model)
    factors = problem.fit(task.estimation)
    e = problem.error(factors, task.held_out)
    if not np.all(np.isfinite(e)):
        raise InputError(task.held_out.source, "the fitted model diverges", "a finite run")
    note = ", ".join(f"{n} x {f:.4g}" for n, f in factors.items())
    return Answer(float(np.sqrt(np.mean(e**2))), task.refitted_rms, note=note)


ARM = Arm("sysid", "mujoco.sysid on the nominal structure", fit, needs=("absl", "colorama", "plotly", "tabulate", "yaml"))
