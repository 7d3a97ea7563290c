"""KUKA KR300 R2500, axis 1: friction of a large robot axis, and a late encoder that looks like backlash.

Published: J. Weigand, J. Ulmen, A. Janot, M. Ruskowski, 2021 (https://github.com/JonasWeigand/Robot_Identification).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.data.experiment import prepare
from diagnose.explain.second_encoder import TERMS, SecondEncoder, judge_second_encoder
from diagnose.pipeline import Options, diagnose
from diagnose.result import Diagnosis
from lab.proof.page import BLUE, GREY, RED, Page, Say, axes, interval, number, table
from mjsim.axis import Axis
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.ode import inverse
from mjsim.recording import Recording, load
from simgap.pipeline import corrected_axis

__all__ = ["CYCLES", "kuka_page", "ripple_by_speed"]

PUBLISHED = {"fm": 1939.52, "torque_Nm": 350.3, "asymmetry_Nm": 4.26, "delay_s": 3.1e-3, "gap_rad": 3e-5}
CYCLES = 8  # of the ripple, per turn of the motor
BANDS = (0.03, 0.08, 0.14, 0.2, 0.28, 0.36)  # speeds at the link [rad/s]; above, the ripple passes half the sampling rate


def kuka_page(files: Mapping[str, Path], say: Say = lambda _: None, jobs: int = 2) -> Page:
    """Diagnose the two recordings, judge the second encoder, and follow the ripple over speed."""
    model = shipped_model("kuka_kr300_axis1")
    nominal = load_axis(model)
    first, second = (load(files[role], model=model) for role in ("estimation", "held-out"))
    say("diagnosing KUKA KR300 axis 1")
    result = diagnose(nominal, [first], [second], Options(jobs=jobs))
    say("judging the second encoder, and the two recordings the other way round")
    parts = [[prepare(first)], [prepare(second)]]
    encoder, swapped = (judge_second_encoder(nominal.chain, a, b) for a, b in (parts, parts[::-1]))
    assert encoder is not None
    assert swapped is not None
    axis = corrected_axis(nominal, result)
    ripple = {r.source: ripple_by_speed(axis, r) for r in (first, second)}
    carried = _carries_over(axis, first, second)
    figures: dict[str, Any] = {
        "verdict": result.verdict.value,
        "findings": {f.effect: {n: e.as_dict() for n, e in f.parameters.items()} for f in result.findings},
        "linear": {n: e.as_dict() for n, e in result.linear_parameters.items()},
        "fit": {n: f.as_dict() for n, f in result.fit.items()},
        "published": PUBLISHED,
        "second_encoder": _encoder_figures(encoder),
        "second_encoder_swapped": _encoder_figures(swapped),
        "ripple": ripple,
        "ripple_carried_over": carried,
        "recordings": list(result.recordings),
    }
    pictures = {"encoders": _encoder_picture(first, encoder), "ripple": _ripple_picture(ripple)}
    return Page("kuka", _text(result, encoder, swapped, figures), pictures, figures)


def _encoder_figures(encoder: SecondEncoder) -> dict[str, Any]:
    return {
        "found": list(encoder.found.terms),
        "values": dict(encoder.found.values),
        "difference_rad": encoder.held_out_difference,
        "left_rad": encoder.found.held_out_rms,
        "raced": [{"terms": list(e.terms), "rms": e.rms, "held_out_rms": e.held_out_rms} for e in encoder.compared],
    }


def _leftover(axis: Axis, recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(motor torque less the model's along the smoothed motion, without what is slow; speed; turns of the motor) at every sample."""
    from scipy.signal import butter, sosfiltfilt

    assert recording.angle is not None
    sos = butter(4, 2 * 10.0 * recording.dt, output="sos")
    q = sosfiltfilt(sos, recording.angle)
    v = np.gradient(q, recording.dt)
    e = recording.torque - inverse(axis, q, v, np.gradient(v, recording.dt), recording.dt)
    return e - sosfiltfilt(sos, e), v, recording.angle * axis.chain.gain / (2 * np.pi)


def _regress(e: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, float]:
    """Coefficients of sin and cos of the ripple, and the share of the variance that they take."""
    x = np.column_stack([np.sin(2 * np.pi * CYCLES * turns), np.cos(2 * np.pi * CYCLES * turns)])
    c = np.linalg.lstsq(x, e, rcond=None)[0]
    return c, 1 - float(np.sum((e - x @ c) ** 2) / np.sum(e**2))


def ripple_by_speed(axis: Axis, recording: Recording) -> list[dict[str, float]]:
    """Amplitude [N m at the motor], phase [rad] and share of the fast residual of the ripple in bands of speed, each way."""
    e, v, turns = _leftover(axis, recording)
    out = []
    for sign in (1.0, -1.0):
        for low, high in itertools.pairwise(BANDS):
            band = (sign * v > low) & (sign * v <= high)
            if band.sum() < 60:
                continue
            c, share = _regress(e[band], turns[band])
            out.append(
                {"speed": sign * float(np.mean(np.abs(v[band]))), "amplitude_Nm": float(np.hypot(*c)),
                 "phase_rad": math.atan2(c[1], c[0]), "share": share, "n": float(band.sum())}
            )  # fmt: skip
    return out


def _carries_over(axis: Axis, first: Recording, second: Recording) -> dict[str, float]:
    """Share of the fast residual that one ripple of fixed amplitude and phase takes: on the recording that it was fitted to, on the
    other one with the phase fitted anew, and with amplitude and phase as they were."""
    (e1, v1, turns1), (e2, v2, turns2) = _leftover(axis, first), _leftover(axis, second)
    m1, m2 = (np.abs(v) > BANDS[0] for v in (v1, v2))
    c, own = _regress(e1[m1], turns1[m1])
    other, free = _regress(e2[m2], turns2[m2])
    x = np.column_stack([np.sin(2 * np.pi * CYCLES * turns2), np.cos(2 * np.pi * CYCLES * turns2)])[m2]

    def share(k: np.ndarray) -> float:
        return 1 - float(np.sum((e2[m2] - x @ k) ** 2) / np.sum(e2[m2] ** 2))

    size = float(np.hypot(*c))
    return {
        "amplitude_Nm": size,
        "fitted": own,
        "held_out_free": free,
        "held_out_phase_free": share(other / max(float(np.hypot(*other)), 1e-300) * size),
        "held_out_as_fitted": share(c),
    }


def _encoder_picture(recording: Recording, encoder: SecondEncoder) -> Any:
    from scipy.interpolate import CubicSpline

    assert recording.angle is not None
    assert recording.second_angle is not None
    figure, (left, right) = axes(9.5, 3.2, 2)
    d = recording.angle - recording.second_angle
    v = np.gradient(recording.angle, recording.dt)
    delay = encoder.found.values.get("time_delay", 0.0)
    shifted = CubicSpline(recording.time, recording.angle)(recording.time - delay) - recording.second_angle
    inside = slice(10, -10)
    torque = recording.torque
    left.plot(torque[inside], 1e6 * (d - d.mean())[inside], ".", ms=1.5, color=RED)
    left.set(xlabel="motor torque [N m]", ylabel="motor - second encoder [microrad]", title="Looks like wind-up with a gap")
    label = f"second encoder taken {1e3 * delay:.2f} ms earlier"
    right.plot(v[inside], 1e6 * (d - d.mean())[inside], ".", ms=1.5, color=RED, label="as recorded")
    right.plot(v[inside], 1e6 * (shifted - shifted[inside].mean())[inside], ".", ms=1.5, color=BLUE, label=label)
    right.set(xlabel="link velocity [rad/s]", title="Is a line over the velocity: a delay")
    right.legend(frameon=False, fontsize=8, markerscale=5)
    return figure


def _ripple_picture(ripple: Mapping[str, list[dict[str, float]]]) -> Any:
    figure, (left, right) = axes(9.5, 2.8, 2)
    for (source, rows), colour in zip(ripple.items(), (BLUE, GREY), strict=True):
        left.plot([r["speed"] for r in rows], [r["amplitude_Nm"] for r in rows], "o", color=colour, label=source)
        right.plot([r["speed"] for r in rows], [r["phase_rad"] for r in rows], "o", color=colour)
    left.set(
        xlabel="mean link velocity of the band [rad/s]",
        ylabel="amplitude [N m, motor]",
        title=f"Ripple at {CYCLES} cycles a turn",
    )
    left.set_ylim(bottom=0)
    left.legend(frameon=False, fontsize=8)
    right.set(xlabel="mean link velocity of the band [rad/s]", ylabel="phase [rad]", title="Its phase", ylim=(-3.3, 3.3))
    return figure


def _text(result: Diagnosis, encoder: SecondEncoder, swapped: SecondEncoder, figures: Mapping[str, Any]) -> str:
    linear = result.linear_parameters
    friction = next((f for f in result.findings if "torque_Nm" in f.parameters), None)
    rows = [["viscous friction", "N m s/rad", number(PUBLISHED["fm"], 6), interval(linear["fm"].value, linear["fm"].ci95)]]
    if friction is not None:
        e = friction.parameters["torque_Nm"]
        rows.append(["Coulomb friction", "N m", number(PUBLISHED["torque_Nm"]), interval(e.value, e.ci95)])
    rows.append(["asymmetry", "N m", number(PUBLISHED["asymmetry_Nm"]), "not named" if friction is None or "asymmetry_Nm" not in
                 friction.parameters else interval(friction.parameters["asymmetry_Nm"].value, friction.parameters["asymmetry_Nm"].ci95)])  # fmt: skip
    rows.append(["delay of the second encoder", "ms", "3.1 (measured by others on these files)",
                 f"{1e3 * encoder.found.values.get('time_delay', math.nan):.2f}; from B to A {1e3 * swapped.found.values.get('time_delay', math.nan):.2f}"])  # fmt: skip
    rows.append(["backlash", "rad", f"{PUBLISHED['gap_rad']:g} (a priori)", "not named" if "backlash" not in encoder.found.terms else
                 number(encoder.found.values["backlash"])])  # fmt: skip
    raced = [
        [" + ".join(TERMS[t] for t in e.terms) or "nothing", f"{1e6 * e.rms:.0f}", f"{1e6 * e.held_out_rms:.0f}"]
        for e in encoder.compared if (len(e.terms) <= 2 and "time_delay" not in e.terms) or len(e.terms) == 1
    ]  # fmt: skip
    ripple_rows = [
        [source, f"{r['speed']:+.2f}", f"{r['amplitude_Nm']:.3f}", f"{r['phase_rad']:+.2f}", f"{100 * r['share']:.0f} %"]
        for source, found in figures["ripple"].items() for r in found
    ]  # fmt: skip
    over = figures["ripple_carried_over"]
    sentences = "\n".join(f"- {f.sentence} Equivalents: {', '.join(f.equivalents) or 'none'}." for f in result.findings)
    hashes = "\n".join(f"- `{r['file']}` ({r['role']}): SHA-256 `{r['sha256'][:16]}...`" for r in result.recordings)
    fit = result.fit
    evidence = "" if friction is None else (
        f"Held-out p = {friction.evidence['p_value']:.1g} after correction for {friction.evidence['hypotheses']:.0f} hypotheses. "
    )  # fmt: skip
    return f"""# KUKA KR300, axis 1: friction, and an encoder that is late

Generated by `simgap proof kuka --out DIR`; do not edit. A real machine: axis 1 (vertical, no gravity) of a KUKA KR300 R2500 under position
control, 10 s at 4 ms. Recordings and reference values: Weigand, Ulmen, Janot, Ruskowski, 2021
(github.com/JonasWeigand/Robot_Identification, MIT), located by `simgap data kuka_kr300`:

{hashes}

The nominal model (`models/kuka_kr300_axis1.xml`) is one inertia with viscous friction. The inertia is left to each recording, since it depends
on the pose of the other five axes. Judged by force.

**Verdict: `{result.verdict.value}`.** {result.summary}

{sentences}

## Beside the published values

{table(["", "unit", "published", "found, 95 %"], rows)}

Torque error on held-out data, nrmse: nominal {number(fit["nominal"].held_out_nrmse, 3)}, refitted {number(fit["refitted"].held_out_nrmse, 3)},
corrected {number(fit["corrected"].held_out_nrmse, 3)}. {evidence}Richer friction laws (Stribeck, presliding, asymmetric) were fitted and did not lower the
held-out error significantly. The published values are from other trajectories of the same robot.

## The second encoder: a delay, not backlash

{encoder.sentence()} Fitted on B and held out on A: {swapped.sentence()}

{table(["explained by", "left on A [microrad]", "left on B, held out [microrad]"], raced)}

Over the torque the difference draws a loop, as wind-up with a gap would; the best explanation without a delay is in the table. Over the
velocity it is a line. Backlash, compliance and hysteresis were fitted beside the delay as well, and did not pay: none is named.

![encoders](kuka/encoders.png)

## Ripple at {CYCLES} cycles a turn of the motor

{table(["recording", "mean velocity [rad/s]", "amplitude [N m, motor]", "phase [rad]", "share of the fast residual"], ripple_rows)}

One ripple of fixed amplitude and phase, fitted to A over all speeds, has {over["amplitude_Nm"]:.3f} N m and takes {100 * over["fitted"]:.0f} % of the fast
residual (above 10 Hz) of A. On B, amplitude and phase fitted anew: {100 * over["held_out_free"]:.0f} %; A's amplitude, the phase anew:
{100 * over["held_out_phase_free"]:.0f} %; both as they were on A: {100 * over["held_out_as_fitted"]:.0f} %. What carries over is the number of cycles. The amplitude grows about as the
speed does, and the phase shifts with it: not cogging, whose torque would be the same at every speed, but what a velocity controller makes of
an error of fixed angle in encoder or gear (a reading, not a proof). The law `torque_ripple` does not hold here, and it is not named.

![ripple](kuka/ripple.png)

## What this does not show

Stiffness: the first resonance (near 17 Hz by the a-priori stiffness) is above what the recordings excite. Standstill torque: rests are left out, since
the torque is then whatever friction and the controller's integral let stand.
"""
