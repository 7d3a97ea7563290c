"""What stiff bristles cost and how exactly they are run: ``python lab/speed/bristles.py``.

For a chirp and a multisine of 10 s at 2 kHz, Coulomb and Stribeck friction with bristles: how many times fewer products of a step
it takes to cut a step only where a bristle holds or turns, and the rms error of that (in brackets: of cutting all) against eight
times as many steps, over 0.05 rad/s, the velocity noise of a usual recording.
"""

from __future__ import annotations

import numpy as np

from mjsim.effects import effect_class
from mjsim.excitation import Grid, chirp, multisine
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate, work_done
from mjsim.system import MOST_STEPS, assemble

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
                steps = system.substeps(DT, 0.0)
                fine = simulate(system, torque, DT, substeps=min(8 * steps, MOST_STEPS)).velocity
                told = []
                for substeps in (steps, None):
                    before = work_done()
                    error = simulate(system, torque, DT, substeps=substeps).velocity - fine
                    told.append((work_done() - before, float(np.sqrt(np.mean(error**2))) / NOISE))
                (all_of_it, exact), (spared, here) = told
                gain = f"{all_of_it / spared:4.1f} times fewer, error {here:.3f} ({exact:.3f})"
                print(f"{name:9}  {law:31}  {stiffness:6.0f} N m/rad  {gain}")


if __name__ == "__main__":
    main()
