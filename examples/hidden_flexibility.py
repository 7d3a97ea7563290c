"""A drive whose frequency response shows two masses where the simulation has one: `python examples/hidden_flexibility.py`.

The machine is two inertias on a spring, solved exactly (matrix exponential) and read with noise; the model is one inertia. A tool
that knows friction and delay only fits those in the spring's place. Asked without such limits, the diagnosis says flexibility.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
from scipy.linalg import expm
from scipy.optimize import least_squares

from diagnose.pipeline import Options
from diagnose.result import Diagnosis
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from mjsim.ode import simulate
from mjsim.recording import load
from simgap.pipeline import diagnose_files

OUT = Path("out/examples/hidden_flexibility")
MOTOR, LINK, SPRING, DAMPING, FRICTION = 0.012, 0.008, 90.0, 0.02, 0.03  # SI
DT, SECONDS, NOISE = 1e-3, 12.0, 0.02

MODEL = f"""<mujoco model="drive">
  <option timestep="0.001" integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body name="drive">
      <joint name="drive" axis="0 0 1" damping="{FRICTION}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 {MOTOR + LINK}"/>
      <geom type="cylinder" size="0.1 0.02" mass="0" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor name="motor_torque" joint="drive"/></actuator>
  <sensor><jointvel name="motor_velocity" joint="drive"/><jointpos name="motor_angle" joint="drive"/></sensor>
</mujoco>
"""


def machine(torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motor velocity and angle of two masses on a spring under a held torque, exact at the samples."""
    s, d = SPRING, DAMPING
    a = np.array([
        [0, 0, 1, 0], [0, 0, 0, 1],
        [-s / MOTOR, s / MOTOR, -(d + FRICTION) / MOTOR, d / MOTOR], [s / LINK, -s / LINK, d / LINK, -d / LINK],
    ])  # fmt: skip
    m = expm(np.block([[a, np.array([[0], [0], [1 / MOTOR], [0]])], [np.zeros((1, 5))]]) * DT)
    x = np.zeros((len(torque), 4))
    for k in range(len(torque) - 1):
        x[k + 1] = m[:4, :4] @ x[k] + m[:4, 4] * torque[k]
    return x[:, 2], x[:, 0]


def record(path: Path, seed: int, top_hz: float) -> None:
    """A random-phase multisine up to ``top_hz``, its response with noise, as a CSV."""
    rng = np.random.default_rng(seed)
    n = round(SECONDS / DT)
    lines = np.arange(2, int(top_hz * SECONDS))
    spectrum = np.zeros(n // 2 + 1, complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
    torque = np.fft.irfft(spectrum, n)
    torque *= 0.4 / np.std(torque)
    velocity, angle = machine(torque)
    velocity = velocity + NOISE * rng.standard_normal(n)
    angle = angle + 1e-5 * rng.standard_normal(n)
    table = np.column_stack([DT * np.arange(n), torque, velocity, angle])
    np.savetxt(path, table, delimiter=",", header="time_s,torque_Nm,velocity_rad_s,angle_rad", comments="", fmt="%.9g")


def plain_fit(model: Path, recording: Path) -> tuple[dict[str, float], float]:
    """What least squares makes of it when friction and delay are all it has: (numbers, rms error)."""
    axis, r = load_axis(model), load(recording, model=model)
    nominal = np.array([MOTOR + LINK, FRICTION, 0.05, 2e-3])

    def missed(x: np.ndarray) -> np.ndarray:
        inertia, viscous, coulomb, delay = nominal * np.maximum(x, 1e-3)
        friction, late = effect_class("coulomb_friction"), effect_class("time_delay")
        there = axis.with_linear({"Jm": inertia, "fm": viscous})
        there = there + friction(torque_Nm=coulomb) + late(delay_s=delay)
        return simulate(there, r.torque, r.dt).velocity - r.column("velocity")

    found = least_squares(missed, np.ones(4), diff_step=1e-3, max_nfev=25)
    names = ("inertia_kgm2", "viscous_Nms_rad", "coulomb_Nm", "delay_s")
    return dict(zip(names, map(float, nominal * np.maximum(found.x, 1e-3)), strict=True)), float(np.sqrt(np.mean(found.fun**2)))


def main(out: Path = OUT) -> tuple[Diagnosis, Diagnosis]:
    """(the diagnosis with friction and delay only, the diagnosis)."""
    out.mkdir(parents=True, exist_ok=True)
    model, first, second = out / "drive.xml", out / "estimation.csv", out / "held_out.csv"
    model.write_text(MODEL, encoding="utf-8")
    record(first, 1, 40.0)
    record(second, 2, 30.0)
    only = Options(effects=("coulomb_friction", "static_friction", "stribeck_friction", "time_delay", "actuator_lag"))
    naive = diagnose_files([first], model, out / "naive", [second], only, progress=False)
    result = diagnose_files([first], model, out / "report", [second], Options(), progress=False)
    rigid = result.fit["refitted"].held_out_rms
    anti = math.sqrt(SPRING / LINK) / (2 * math.pi)
    print(f"Machine: {LINK} kg m^2 on a spring of {SPRING} N m/rad, anti-resonance at {anti:.2f} Hz. Noise {NOISE} rad/s.")
    print(f"One mass, refitted: held-out error {rigid:.3g} rad/s.")
    numbers, error = plain_fit(model, first)
    said = ", ".join(f"{n} = {v:.3g}" for n, v in numbers.items())
    print(f"Least squares with friction and delay: {said}; error {error:.3g} rad/s. Numbers come out, and mean nothing.")
    named = ", ".join(f.effect for f in naive.findings) or "nothing"
    left = naive.fit["corrected"].held_out_rms
    print(f"The diagnosis, allowed friction, delay and lag only, names {named}; {left:.3g} rad/s; {naive.verdict.value}.")
    print(f"Diagnosis: {result.verdict.value}. {result.summary}")
    for f in result.findings:
        values = {n: e.value for n, e in f.parameters.items()}
        print(f"  {f.sentence}")
        if f.effect == "extra_flexible_mode":
            found = math.sqrt(values["stiffness_Nm_rad"] / values["inertia_kgm2"]) / (2 * math.pi)
            print(f"  Anti-resonance {found:.2f} Hz (true {anti:.2f}).")
    print(f"Report: {out / 'report' / 'report.html'}")
    return naive, result


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else OUT)
