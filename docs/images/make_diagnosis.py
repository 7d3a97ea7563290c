"""The picture of the README: `python docs/images/make_diagnosis.py` conceals Coulomb friction, diagnoses it and draws it."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from diagnose.pipeline import Options, diagnose
from mjsim.axis import Axis
from mjsim.effects import effect_class
from mjsim.excitation import chirp
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate
from mjsim.recording import Recording

DT = 5e-4


def record(axis: Axis, amplitude: float, top: float, seed: int) -> Recording:
    """Ten seconds of a chirp, with noise on velocity and angle."""
    torque = chirp(10.0, DT, amplitude, 0.5, top)
    run = simulate(axis, torque, DT)
    noise = np.random.default_rng(seed).standard_normal((2, len(torque)))
    return Recording(
        run.time, torque, run.velocity + 0.05 * noise[0], run.angle + 1e-4 * noise[1], DT, source=f"chirp_{seed}.csv"
    )


def main() -> None:
    """Conceal, diagnose, draw."""
    nominal = load_axis(shipped_model("robot_axis1"))
    concealed = effect_class("coulomb_friction")(torque_Nm=0.1)
    axis = nominal.with_linear({"Jm": 4.7e-4, "fm": 0.0345, "kg": 1.46e5}) + concealed
    result = diagnose(nominal, [record(axis, 1.0, 30.0, 1)], [record(axis, 0.8, 24.0, 2)], Options(jobs=2))
    held = next(t for t in result.traces if t.role == "held-out")
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(11, 3.1), width_ratios=(1.5, 1, 1.1), layout="constrained")
    show = (held.time > 1.0) & (held.time < 2.2)
    for name, y, colour in (("nominal, refitted", held.refitted, "#c44e52"), ("corrected", held.corrected, "#2a6f97")):
        left.plot(held.time[show], (held.measured - y)[show], color=colour, lw=1, label=name)
    left.set(xlabel="time [s]", ylabel="measured - simulated [rad/s]", title="Held-out recording: what each model misses")
    left.legend(frameon=False, loc="upper right")
    state = next(s for s in result.mismatch.state if s.state == "velocity")
    middle.errorbar(state.x, state.y, state.error, fmt="o", ms=3, color="#555555")
    middle.set(
        xlabel="motor velocity [rad/s]",
        ylabel="missing torque [N m]",
        title=f"Where: {100 * state.share:.0f} % of it by velocity",
    )
    names = ["nominal", "refitted", "corrected"]
    values = [result.fit[n].held_out_rms for n in names]
    right.barh(names[::-1], values[::-1], color=["#2a6f97", "#c44e52", "#bbbbbb"])
    right.axvline(result.noise_floor, color="k", lw=0.8, ls=":")
    right.text(result.noise_floor, 2.5, " noise", va="bottom", fontsize=8)
    found = result.findings[0]
    value = found.parameters["torque_Nm"]
    low, high = value.ci95
    title = f"{found.effect.replace('_', ' ')} at the {found.place}: {value.value:.4f} N m\n95 % [{low:.4f}, {high:.4f}]"
    right.set(xscale="log", xlabel="held-out error, rms [rad/s]", title=title)
    right.title.set_fontsize(9)
    out = Path(__file__).with_name("diagnosis.png")
    figure.savefig(out, dpi=120)
    print(f"{out.name}: {result.verdict.value}, {title}".replace("\n", ", "))


if __name__ == "__main__":
    main()
