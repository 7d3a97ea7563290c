"""A diagnosis with everything that a page can show, made without a search."""

from __future__ import annotations

import numpy as np

from diagnose.result import (
    Diagnosis,
    Estimate,
    Finding,
    FitFigures,
    Mismatch,
    Place,
    Refused,
    Rival,
    Share,
    StateShare,
    Traces,
    Verdict,
)
from mjsim.effects import effect_class
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import simulate

DT = 5e-4
NOISE = 0.05
TRUTH = {
    "effects": ["coulomb_friction"],
    "where": {},
    "parameters": {"coulomb_friction": {"torque_Nm": 0.1}},
    "linear_parameters": {"Jm": 4.56e-4},
    "closed_loop": False,
    "velocity_noise_rms_rad_s": NOISE,
}
DIFF = """--- robot_axis1.xml
+++ corrected.xml
@@ -52,3 +52,3 @@
     <body name="motor_rotor" pos="-0.42 0 0.36">
-      <joint name="motor" damping="0.0355" frictionloss="0"/>
+      <joint name="motor" damping="0.0351" frictionloss="0.1001"/>
       <inertial pos="0 0 0" mass="1" diaginertia="2.28e-4 2.28e-4 2.28e-4"/>
"""


def traces(samples: int, role: str, rng: np.random.Generator) -> Traces:
    axis = load_axis(shipped_model("robot_axis1"))
    t = DT * np.arange(samples)
    u = 1.2 * np.sin(2 * np.pi * (0.5 * t + 0.4 * t**2))
    coulomb = effect_class("coulomb_friction")(torque_Nm=0.1)
    corrected = np.array(simulate(axis + coulomb, u, DT).velocity)
    # what a linear fit would do: more viscous friction in place of the missing dry one
    refitted = np.array(simulate(axis.with_linear({"fm": 0.045}), u, DT).velocity)
    counted = np.ones(samples, bool)
    counted[samples // 2 : samples // 2 + samples // 20] = False
    noisy = corrected + NOISE * rng.standard_normal(samples)
    nominal = simulate(axis, u, DT)
    states = {"velocity": (noisy, "rad/s"), "angle": (np.array(nominal.angle), "rad"), "torque": (u, "Nm")}
    return Traces(
        f"axis_{role}.csv", role, t, noisy, np.array(nominal.velocity), refitted, corrected, counted, NOISE, states=states
    )


def synthetic(samples: int = 20_000) -> Diagnosis:
    from scipy.signal import welch

    rng = np.random.default_rng(3)
    one, two = traces(samples, "estimation", rng), traces(samples, "held-out", rng)
    e = one.measured - one.refitted
    f, pe = welch(e, 1 / DT, nperseg=2048, detrend=False)
    _, py = welch(one.measured, 1 / DT, nperseg=2048)
    v = np.linspace(-30, 30, 24)
    before, after = (float(np.sqrt(np.mean((two.measured - y) ** 2))) for y in (two.refitted, two.corrected))
    state = (
        StateShare("velocity", "rad/s", 0.931, v, -0.1 * np.tanh(v), np.full(24, 0.004)),
        StateShare("torque command", "N m", 0.62, v / 25, -0.08 * np.tanh(v / 8), np.full(24, 0.006)),
        StateShare(
            "phase of order 4 of the angle",
            "rad",
            0.011,
            np.linspace(0, 6.2, 24),
            0.01 * rng.standard_normal(24),
            np.full(24, 0.01),
        ),
        StateShare("time", "s", 0.0, np.empty(0), np.empty(0), np.empty(0)),
    )
    finding = Finding(
        "coulomb_friction",
        "motor",
        "motor",
        "Dry (Coulomb) friction of 0.1001 N m at the motor: a constant torque against the motion that also holds it at rest.",
        {"torque_Nm": Estimate(0.10013, (0.09982, 0.10044), "N m")},
        {
            "held_out_error_before": before,
            "held_out_error_after": after,
            "p_value": 3.1e-14,
            "delta_chi2": 81234.0,
            "hypotheses": 63.0,
        },
        ("presliding_friction@motor",),
    )
    rivals = [
        Rival(("coulomb_friction@motor",), 9, 0.0501, after, -41234.5, "converged"),
        Rival((), 8, 0.31, before, 8123.2, "converged"),
        *(
            Rival((f"{k}@motor",), 10, 0.0501 + 0.01 * i, after + 0.01 * i, -41000.0 + 900 * i, "converged")
            for i, k in enumerate(
                (
                    "stribeck_friction",
                    "presliding_friction",
                    "asymmetric_friction",
                    "static_friction",
                    "friction_drift",
                    "quadratic_friction",
                    "torque_ripple",
                    "torque_offset",
                    "load_dependent_friction",
                )
            )
        ),
        Rival(("torque_ripple@motor", "backlash@gearbox"), 12, float("nan"), float("nan"), float("inf"), "diverged"),
    ]
    nominal = {p.name: p.value for p in load_axis(shipped_model("robot_axis1")).chain.linear_parameters()}
    units = {p.name: p.quantity.unit() for p in load_axis(shipped_model("robot_axis1")).chain.linear_parameters()}
    linear = {
        k: Estimate(1.01 * x, (1.005 * x, 1.015 * x) if x > 0 else (1.015 * x, 1.005 * x), units[k]) for k, x in nominal.items()
    }
    mismatch = Mismatch(
        (Share(0.0, 0.5, 0.21), Share(0.5, 1.0, 0.14), Share(4.0, 4.5, 0.11)),
        (Share(0.98, 3.9, 0.71), Share(8.8, 11.7, 0.12)),
        state,
        (
            Place("motor", "motor", 0.098, "N m", 0.931, "velocity"),
            Place("sensor", "motor_velocity", 0.31, "as the channel", 0.22, "time"),
        ),
        (f, pe, np.full_like(f, NOISE**2 * 2 * DT), py),
        0.972,
        0.08,
        one.source,
        "estimation",
        1.0,
    )
    return Diagnosis(
        verdict=Verdict.MISSING_PHYSICS,
        summary="The simulation leaves out dry friction of 0.1001 N m at the motor; with it the error falls to the noise.",
        findings=(finding,),
        mismatch=mismatch,
        mismatches=(mismatch,),
        linear_parameters=linear,
        nominal_parameters=nominal,
        fit={
            "nominal": FitFigures(0.62, 0.05, 0.66, 0.05),
            "refitted": FitFigures(0.31, 0.02, before, 0.02),
            "corrected": FitFigures(0.0501, 0.004, after, 0.004),
        },
        noise_floor=NOISE,
        gap_closed=0.9987,
        rivals=tuple(rivals),
        failed={"hysteresis@arm": "no start could be run"},
        notes=("The damping of the gearbox is negative, in the nominal model and as identified: unphysical.",),
        next_experiment="A multisine of 0.3 N m between 0.5 and 20 Hz, for 20 s, would tell presliding from Coulomb friction.",
        channel="velocity",
        unit="rad/s",
        view="motion",
        traces=(one, two),
        recordings=({"file": "axis_estimation.csv", "sha256": "ab" * 32}, {"file": "axis_held_out.csv", "sha256": "cd" * 32}),
        seed=7,
        seconds=21.3,
        versions={"simgap": "0.1.0", "mujoco": "4.0.0"},
        refusals=(
            Refused(("presliding_friction@motor",), ("coulomb_friction@motor",), "law", {"gain": 3.1, "needed": 25.0}),
            Refused(
                ("torque_ripple@motor",),
                ("coulomb_friction@motor",),
                "held_out",
                {"relative_gain": 0.001, "needed": 0.01, "p_value": 0.4, "largest_p_value": 0.05},
            ),
        ),
        false_alarm={"share": 0.01, "low": 0.001, "high": 0.04, "alarms": 1.0, "recordings": 100.0},
    )
