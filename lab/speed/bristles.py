"""What stiff bristles and soft friction cost and how exactly they are run: ``python lab/speed/bristles.py``.

For a chirp and a multisine of 10 s at 2 kHz, Coulomb and Stribeck friction with bristles: how many times fewer products of a step
it takes to cut a step only where a bristle holds or turns, and the rms error of that (in brackets: of cutting all) against eight
times as many steps, over 0.05 rad/s, the velocity noise of a usual recording. Last a body with MuJoCo's default soft friction
(impedance .9, rate 105 1/s) at 50 and 200 Hz, 60 s of both inputs at a tenth of their frequencies.
"""

from __future__ import annotations

import numpy as np

from mjsim.axis import Axis
from mjsim.chain import Body, Chain, Softness
from mjsim.effects import effect_class
from mjsim.excitation import Grid, chirp, multisine
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate, work_done
from mjsim.system import MOST_STEPS, System, assemble

DT, SECONDS, NOISE = 5e-4, 10.0, 0.05
COULOMB = {"torque_Nm": 0.1}
STRIBECK = {**COULOMB, "extra_static_torque_Nm": 0.1, "stribeck_velocity_rad_s": 0.6, "damping_Nms_rad": 0.05}


def main() -> None:
    """Print a line for each input, law and stiffness."""
    axis = load_axis(shipped_model("robot_axis1"))
    inputs = {
        "chirp": chirp(SECONDS, DT, 2.5, 0.5, 45.0),
        "multisine": multisine(np.random.default_rng(0), SECONDS, DT, 0.7, 0.1, 60.0, period=SECONDS, grid=Grid.FULL),
    }
    for name, torque in inputs.items():
        for law, values in (("presliding_friction", COULOMB), ("stribeck_friction_with_bristles", STRIBECK)):
            for stiffness in (300.0, 3e3, 1.2e4):
                system = assemble(axis + effect_class(law)(**values, stiffness_Nm_rad=stiffness))
                print(f"{name:9}  {law:31}  {stiffness:6.0f} N m/rad  {gain(system, torque, DT)}")
    body = Body("motor", 0.3, 0.02, "arm", Softness(0.9, 105.0))
    soft = assemble(Axis(Chain((body,), ())) + effect_class("coulomb_friction")(torque_Nm=0.1))
    for rate in (50.0, 200.0):
        slow = {
            "chirp": chirp(60.0, 1.0 / rate, 1.0, 0.05, 4.5),
            "multisine": multisine(np.random.default_rng(0), 60.0, 1.0 / rate, 0.7, 0.02, 3.0, period=60.0, grid=Grid.FULL),
        }
        for name, torque in slow.items():
            print(f"{name:9}  soft friction, {rate:3.0f} Hz  {gain(soft, torque, 1.0 / rate)}")


def gain(system: System, torque: np.ndarray, dt: float) -> str:
    """How many times fewer products of a step a run takes than one that is cut everywhere, and the errors of both."""
    n, parts = system.steps(dt, 0.0)
    fine = simulate(system, torque, dt, substeps=min(8 * n * parts, MOST_STEPS)).velocity
    told = []
    for substeps in (n * parts, None):
        before = work_done()
        error = simulate(system, torque, dt, substeps=substeps).velocity - fine
        told.append((work_done() - before, float(np.sqrt(np.mean(error**2))) / NOISE))
    (all_of_it, exact), (spared, here) = told
    return f"{all_of_it / spared:4.1f} times fewer, error {here:.3f} ({exact:.3f})"


if __name__ == "__main__":
    main()
