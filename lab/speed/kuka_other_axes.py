"""Axes 2 to 6 of the KUKA KR300, from inertia and viscous friction alone: ``python lab/speed/kuka_other_axes.py --from FOLDER``.

The recordings of `simgap proof kuka` hold all six axes. Nothing of the diagnosis was made for these five, which carry weights
and each other's torques; the nominal models are the a-priori inertia and viscous friction in the files themselves, as one inertia
at the link, with the rotor's. FOLDER: where ``rec_FF_A.mat``, which is fitted, and ``rec_FF_B.mat`` are. Printed is what the
simulation is said to have left out, with the held-out error over the rms variation of the force (NRMSE) before and after.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from diagnose.pipeline import Options, diagnose
from diagnose.result import Diagnosis
from mjsim.mjcf import load_axis
from mjsim.recording import load

FILES = ("rec_FF_A.mat", "rec_FF_B.mat")
MJCF = """<mujoco model="axis{axis}">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body name="arm">
      <joint name="axis{axis}" type="hinge" axis="0 0 1" damping="{viscous:.6g}" armature="{rotor:.6g}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{arm:.6g} {arm:.6g} {arm:.6g}"/>
    </body>
  </worldbody>
  <actuator><motor name="motor_torque" joint="axis{axis}" gear="{gear:.9g}"/></actuator>
  <sensor><jointvel name="motor_velocity" joint="axis{axis}"/><jointpos name="motor_angle" joint="axis{axis}"/></sensor>
</mujoco>
"""
BINDING = """[recording]
time = {{ column = "rec.time_cont", unit = "s" }}
torque = {{ column = "rec.act_torque_abs_nm", unit = "Nm", row = {row} }}
velocity = {{ column = "rec.act_vel_mot_deg_per_s", unit = "deg/s", row = {row} }}
angle = {{ column = "rec.act_pos_mot_deg", unit = "deg", row = {row} }}

[experiment]
loop = "closed"
judge = "force"

[model]
actuator = "motor_torque"
velocity_sensor = "motor_velocity"
angle_sensor = "motor_angle"
"""


def told(folder: Path, recordings: Path, axis: int, jobs: int) -> Diagnosis:
    """The diagnosis of an axis, counted from 1."""
    row = axis - 1
    first = loadmat(recordings / FILES[0], squeeze_me=True)
    priors = {name: float(np.asarray(first["para"][name].item())[row]) for name in ("u", "J_mr", "f_vis")}
    gear = abs(priors["u"])
    model = folder / f"axis{axis}.xml"
    model.write_text(
        MJCF.format(
            axis=axis, viscous=priors["f_vis"], rotor=priors["J_mr"] * gear**2, arm=first["m_all"][row].mean(), gear=gear
        ),
        encoding="utf-8",
    )
    model.with_suffix(".toml").write_text(BINDING.format(row=row), encoding="utf-8")
    fitted, held = (load(recordings / name, model=model) for name in FILES)
    return diagnose(load_axis(model), [fitted], [held], Options(jobs=jobs))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--from", dest="recordings", type=Path, required=True, help="folder of the two recordings")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        for axis in range(2, 7):
            d = told(Path(work), arguments.recordings, axis, arguments.jobs)
            found = []
            for f in d.findings:
                numbers = ", ".join(f"{n} {v.value:.4g} [{v.ci95[0]:.4g}, {v.ci95[1]:.4g}]" for n, v in f.parameters.items())
                found.append(f"{f.effect}@{f.place} ({numbers})" + (f", or {', '.join(f.equivalents)}" if f.equivalents else ""))
            before, after = d.fit["refitted"], d.fit["corrected"]
            print(
                f"axis {axis}  {d.verdict.value}  held-out NRMSE {before.held_out_nrmse:.2f} -> {after.held_out_nrmse:.2f}  "
                f"{' + '.join(found)}  ({d.seconds:.0f} s)", flush=True,
            )  # fmt: skip


if __name__ == "__main__":
    main()
