"""EMPS, a carriage on a ball screw: friction, its asymmetry and one turn of the screw, from inertia and viscous friction alone.

Published: A. Janot, M. Gautier, M. Brunot, Data Set and Reference Models of EMPS, 2019 (nonlinearbenchmark.org).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.data.experiment import prepare
from diagnose.evidence.force_orders import line_energy
from diagnose.evidence.held_out import compare
from diagnose.fit.fitted import Fitted
from diagnose.fit.fitter import Fitter
from diagnose.pipeline import Options, diagnose
from diagnose.problem.choose_view import choose_view
from diagnose.problem.hypothesis import make
from diagnose.problem.view import ForceView
from diagnose.result import Diagnosis
from lab.proof.page import BLUE, GREY, RED, Page, Say, axes, interval, number, table
from lab.proof.servo import Servo, close_position_loop
from mjsim.axis import Axis
from mjsim.effects import Effect, effect_class
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.recording import Recording, load
from simgap.found import physics_found

__all__ = ["LEAD", "SERVO", "emps_page", "ringing"]

LEAD = 0.0025  # travel for one turn of the motor [m]
SERVO = Servo(kp=160.18, kv=243.45, drive=35.1506, limit=10.0)
# kg, N s/m, N, N; the offset as a part of the commanded force, which is the negative of the published one
PUBLISHED = {"Jm": 95.1089, "fm": 203.5034, "torque_Nm": 20.3935, "offset": -3.1648}
PUBLISHED_LOOP = {
    "DATA_EMPS.mat": (0.01375, 0.2291, 8.604, 5.848),
    "DATA_EMPS_PULSES.mat": (0.00802, 0.4789, 19.815, 8.941),
}
FORCE_ERROR = {"DATA_EMPS.mat": 4.0834, "DATA_EMPS_PULSES.mat": 5.9824}
SIGNALS = ("position", "velocity", "acceleration", "force")


def emps_page(files: Mapping[str, Path], say: Say = lambda _: None, jobs: int = 2) -> Page:
    """Diagnose the two recordings and put the findings beside the published table."""
    model = shipped_model("emps")
    nominal = load_axis(model)
    first, second = (load(files[role], model=model) for role in ("estimation", "held-out"))
    say("diagnosing EMPS")
    result = diagnose(nominal, [first], [second], Options(jobs=jobs))
    fitter = Fitter(nominal, choose_view([first], None), (prepare(first),), (prepare(second),), jobs)
    try:
        say("fitting the steps from the nominal model to the found one")
        steps = _steps(fitter, result)
        found = steps[-1][1]
        both = {
            r.source: (fitter.own_values(found.hypothesis, found, e) or (found.axis, None))[0]
            for r, e in ((first, fitter.experiments[0]), (second, fitter.held_out[0]))
        }
        say("running the models in the closed loop")
        loop = _closed_loop(nominal, both, (first, second))
        ripple = {r.source: _ripple(both[r.source], r) for r in (first, second)}
        flexible = _flexible(fitter, found)
        rings = ringing(both[second.source], second, (both[first.source], first))
        line = _line_picture(both[first.source], first)
    finally:
        fitter.close()
    figures: dict[str, Any] = {
        "verdict": result.verdict.value,
        "findings": {f.effect: {n: e.as_dict() for n, e in f.parameters.items()} for f in result.findings},
        "linear": {n: e.as_dict() for n, e in result.linear_parameters.items()},
        "published": PUBLISHED,
        "steps": [{"step": name, **_errors(fitter, f)} for name, f in steps],
        "closed_loop": loop,
        "ripple": ripple,
        "flexible_mode": flexible,
        "edges": {n: rings[n] for n in ("peaks", "peak_N", "share", "time_share", "edges")},
        "recordings": list(result.recordings),
    }
    pictures = {"force": _force_picture(result, second), "ripple": line, "ringing": _ringing_picture(rings)}
    return Page("emps", _text(result, steps, figures), pictures, figures)


def _steps(fitter: Fitter, result: Diagnosis) -> list[tuple[str, Fitted]]:
    """The refitted nominal model, with Coulomb friction, with asymmetry too, and with all that was found: each fitted alone."""
    found = tuple(physics_found(result))
    level = next((e.values["torque_Nm"] for e in found if "friction" in e.id and "torque_Nm" in e.values), 0.1)
    coulomb = make("coulomb_friction", "motor", {"torque_Nm": level})
    friction = tuple(e for e in found if "cycles_per_rev" not in e.values)
    wanted: list[tuple[str, tuple[Effect, ...]]] = [("inertia, viscous", ()), ("+ Coulomb", (coulomb,))]
    if friction:
        wanted.append((f"+ asymmetry ({' and '.join(e.id.replace('_', ' ') for e in friction)})", friction))
    if len(found) > len(friction):
        rest = [e.id.replace("_", " ") for e in found if e not in friction]
        wanted.append((f"+ {' and '.join(rest)}", found))
    return [(name, fitter.fit(fitter.hypothesis(effects), iterations=40)) for name, effects in wanted]


def _errors(fitter: Fitter, f: Fitted) -> dict[str, Any]:
    """Parameters, and the error of the force relative to the measured one [%], over the samples that count and over all."""
    axes_of = [(f.axis, fitter.experiments[0])]
    solved = fitter.own_values(f.hypothesis, f, fitter.held_out[0])
    axes_of.append((solved[0] if solved else f.axis, fitter.held_out[0]))
    out: dict[str, Any] = {"linear": dict(f.linear), "effects": {e.key: e.values for e in f.effects}}
    for (axis, experiment), name in zip(axes_of, ("estimation", "held_out"), strict=True):
        s = fitter.view.signals(axis, experiment, None)
        assert s is not None
        keep, e = fitter.counted(experiment), s.measured - s.predicted
        out[name] = 100 * float(np.linalg.norm(e[keep]) / np.linalg.norm(s.measured[keep]))
        out[f"{name}_all_samples"] = 100 * float(np.linalg.norm(e) / np.linalg.norm(s.measured))
    return out


def _closed_loop(nominal: Axis, found: Mapping[str, Axis], recordings: Sequence[Recording]) -> dict[str, Any]:
    """Relative errors [%] of position, velocity, acceleration and force of models run under the published controller."""
    published = nominal.with_linear({n: PUBLISHED[n] for n in ("Jm", "fm")})
    published += make("coulomb_friction", "motor", {"torque_Nm": PUBLISHED["torque_Nm"]})
    published += make("torque_offset", "motor", {"torque_Nm": -PUBLISHED["offset"]})
    out: dict[str, Any] = {}
    for r in recordings:
        models = {"nominal": nominal, "published, in this loop": published, "found": found[r.source]}
        added = r.columns.get("pulses_N", np.zeros(len(r)))
        out[r.source] = {"published": dict(zip(SIGNALS, PUBLISHED_LOOP[r.source], strict=True))}
        for name, axis in models.items():
            assert r.angle is not None
            run = close_position_loop(axis, SERVO, r.columns["qg"], added, r.dt, float(r.angle[0]))
            measured, simulated = _filtered(r.angle, r.torque, r.dt), _filtered(run.position, run.force, r.dt)
            out[r.source][name] = {
                s: 100 * float(np.linalg.norm(measured[s] - simulated[s]) / np.linalg.norm(measured[s])) for s in SIGNALS
            }
    return out


def _filtered(position: np.ndarray, force: np.ndarray, dt: float, cutoff_hz: float = 100.0) -> dict[str, np.ndarray]:
    """Position, its derivatives by central differences, and force, behind one zero-phase low-pass."""
    from scipy.signal import butter, sosfiltfilt

    sos = butter(4, 2 * cutoff_hz * dt, output="sos")
    q = sosfiltfilt(sos, position)
    v = np.gradient(q, dt)
    return {"position": q, "velocity": v, "acceleration": np.gradient(v, dt), "force": sosfiltfilt(sos, force)}


def _without_ripple(axis: Axis) -> Axis:
    return dataclasses.replace(axis, effects=tuple(e for e in axis.effects if "cycles_per_rev" not in e.values))


def _residual(axis: Axis, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """(commanded less needed force at every sample, which of them count)."""
    experiment = prepare(recording)
    view = ForceView(decimate=1)
    s = view.signals(axis, experiment, None)
    assert s is not None
    return s.measured - s.predicted, view.counts(experiment)


def _ripple(axis: Axis, recording: Recording) -> dict[str, Any]:
    """Amplitude [N] and phase [rad] of one and two cycles a turn in what the rest of the model leaves, at every sample."""
    e, keep = _residual(_without_ripple(axis), recording)
    assert recording.angle is not None
    out = {}
    for cycles in (1, 2):
        n = 2 * np.pi * cycles / LEAD
        x = np.column_stack([np.sin(n * recording.angle), np.cos(n * recording.angle)])[keep]
        c = np.linalg.lstsq(x, e[keep], rcond=None)[0]
        share = 1 - float(np.sum((e[keep] - x @ c) ** 2) / np.sum(e[keep] ** 2))
        out[str(cycles)] = {"amplitude_N": float(np.hypot(*c)), "phase_rad": math.atan2(c[1], c[0]), "share": share}
    return out


def _flexible(fitter: Fitter, found: Fitted) -> dict[str, Any]:
    """What one more flexible mode would gain on top of all that was found, however it is started."""
    cls = effect_class("extra_flexible_mode")
    best: Fitted | None = None
    for values in cls.starts(fitter.scales_for(cls, "arm")):
        small = {n: v * 0.04 for n, v in values.items()}
        h = fitter.hypothesis((*found.effects, cls(place="arm", **small)), found.linear, found.own)
        f = fitter.fit(h, iterations=25)
        if f.ok and (best is None or f.chi2 < best.chi2):
            best = f
    assert best is not None
    mode = best.effects[-1].values
    gain = compare(fitter.validate(found), fitter.validate(best))
    inertia, stiffness = mode["inertia_kgm2"], mode["stiffness_Nm_rad"]
    return {
        "inertia_kg": inertia,
        "frequency_hz": math.sqrt(stiffness / inertia) / (2 * math.pi),
        "held_out_gain": gain.relative_gain,
        "p_value": gain.p_value,
    }


def ringing(axis: Axis, pulsed: Recording, control: tuple[Axis, Recording], window: float = 0.4) -> dict[str, Any]:
    """The residual averaged over the edges of the pulses, each taken with its sign, and its spectrum from 30 ms on.

    ``control``: another recording, without pulses, averaged at the same times: what stands out must not stand there. Peaks [Hz]:
    between 8 and 60 Hz, at least four times the control's power.
    """
    steps = np.diff(pulsed.columns["pulses_N"])
    edges = np.flatnonzero(steps) + 1
    count, skip = round(window / pulsed.dt), round(0.03 / pulsed.dt)
    frequency = np.fft.rfftfreq(8 * (count - skip), pulsed.dt)
    out: dict[str, Any] = {"time": pulsed.dt * np.arange(count), "frequency": frequency, "edges": len(edges)}
    for name, model, recording in (("pulses", axis, pulsed), ("control", *control)):
        e, _ = _residual(model, recording)
        pieces = [np.sign(steps[k - 1]) * e[k : k + count] for k in edges if k + count <= len(e)]
        mean = np.mean(pieces, axis=0)
        tail = (mean - mean[skip:].mean())[skip:] * np.hanning(count - skip)
        out[name] = mean
        out[f"{name}_power"] = np.abs(np.fft.rfft(tail, 8 * (count - skip))) ** 2
    power, level = out["pulses_power"], out["control_power"]
    band = (frequency > 8) & (frequency < 60)
    floor = float(np.mean(level[band]))
    inside = range(1, len(power) - 1)
    top = [i for i in inside if band[i] and power[i] >= max(power[i - 1], power[i + 1], 4 * level[i], 4 * floor)]
    e, keep = _residual(axis, pulsed)
    near = np.zeros(len(e), bool)
    for k in edges:
        near[k : k + round(0.06 / pulsed.dt)] = True
    out["peak_N"] = float(np.max(np.abs(out["pulses"])))
    out["share"] = float(np.sum(e[near & keep] ** 2) / np.sum(e[keep] ** 2))
    out["time_share"] = float(np.mean(near[keep]))
    out["peaks"] = sorted(float(frequency[i]) for i in sorted(top, key=lambda i: -power[i])[:3])
    return out


def _force_picture(result: Diagnosis, recording: Recording) -> Any:
    figure, (left, right) = axes(9.5, 3.0, 2)
    held = next(t for t in result.traces if t.role == "held-out")
    show = (held.time > 5.8) & (held.time < 9.4)
    left.plot(held.time[show], held.measured[show], color=GREY, lw=0.9, label="commanded")
    left.plot(held.time[show], held.corrected[show], color=BLUE, lw=0.9, label="corrected model")
    left.set(xlabel="time [s]", ylabel="force [N]", title=f"{recording.source}, held out")
    left.legend(frameon=False, fontsize=8)
    for name, y, colour in (("nominal, refitted", held.refitted, RED), ("corrected", held.corrected, BLUE)):
        right.plot(held.time[show], np.where(held.counted, held.measured - y, np.nan)[show], color=colour, lw=0.8, label=name)
    right.set(xlabel="time [s]", ylabel="commanded - needed [N]", title="What each model leaves (samples that count)")
    right.legend(frameon=False, fontsize=8)
    return figure


def _line_picture(axis: Axis, recording: Recording) -> Any:
    assert recording.angle is not None
    figure, (left, right) = axes(9.5, 2.8, 2)
    e, keep = _residual(_without_ripple(axis), recording)
    v = np.gradient(recording.angle, recording.dt)
    one = 2 * np.pi / LEAD
    orders = np.linspace(0.15 * one, 3.2 * one, 1200)
    power = line_energy(e, recording.angle, v, np.ones(len(v)), keep, orders, recording.dt)
    left.plot(orders / one, power / np.median(power), color=BLUE, lw=0.8)
    left.set(xlabel="cycles per turn of the motor", ylabel="energy over the median", title="What the residual repeats with")
    turn = np.mod(recording.angle[keep] / LEAD, 1.0)
    bins = np.minimum((turn * 36).astype(int), 35)
    mean = np.bincount(bins, e[keep], 36) / np.maximum(np.bincount(bins, minlength=36), 1)
    right.plot((np.arange(36) + 0.5) * 10, mean, "o-", ms=3, lw=0.8, color=BLUE)
    right.set(xlabel="angle of the motor [deg]", ylabel="mean residual [N]", title="Folded over one turn")
    return figure


def _ringing_picture(rings: Mapping[str, Any]) -> Any:
    figure, (left, right) = axes(9.5, 2.8, 2)
    show = (rings["frequency"] > 5) & (rings["frequency"] < 70)
    for name, colour, label in (("control", GREY, "no pulses, same times"), ("pulses", RED, "after the edges")):
        left.plot(1e3 * rings["time"], rings[name], color=colour, lw=0.9, label=label)
        right.semilogy(rings["frequency"][show], rings[f"{name}_power"][show], color=colour, lw=1, label=label)
    for x in rings["peaks"]:
        y = float(np.interp(x, rings["frequency"], rings["pulses_power"]))
        right.annotate(f"{x:.1f} Hz", (x, y), fontsize=8, ha="center", va="bottom")
    left.set(xlabel="time after the edge [ms]", ylabel="mean residual [N]", title=f"Averaged over {rings['edges']} edges")
    right.set(xlabel="frequency [Hz]", ylabel="power", title="From 30 ms after the edge on")
    left.legend(frameon=False, fontsize=8)
    return figure


def _parameter_rows(result: Diagnosis) -> list[list[str]]:
    values = {n: e for f in result.findings for n, e in f.parameters.items() if f.effect != "torque_ripple"}
    rows = []
    for name, label, unit in (("Jm", "inertia", "kg"), ("fm", "viscous friction", "N s/m")):
        e = result.linear_parameters[name]
        rows.append([label, unit, number(PUBLISHED[name], 6), interval(e.value, e.ci95, 5), _off(e.value, PUBLISHED[name])])
    if (friction := values.get("torque_Nm")) is not None:
        rows.append(["Coulomb friction", "N", number(PUBLISHED["torque_Nm"], 6), interval(friction.value, friction.ci95, 5),
                     _off(friction.value, PUBLISHED["torque_Nm"])])  # fmt: skip
    if (offset := values.get("asymmetry_Nm")) is not None:
        rows.append(["offset = asymmetry", "N", number(PUBLISHED["offset"], 6), interval(offset.value, offset.ci95, 5),
                     _off(offset.value, PUBLISHED["offset"])])  # fmt: skip
    return rows


def _off(value: float, published: float) -> str:
    return f"{100 * (value / published - 1):+.2f} %"


def _text(result: Diagnosis, steps: Sequence[tuple[str, Fitted]], figures: Mapping[str, Any]) -> str:
    loops, ripple, flexible = figures["closed_loop"], figures["ripple"], figures["flexible_mode"]
    step_rows = [
        [s["step"], *(number(s[k], 4) for k in ("estimation", "held_out", "estimation_all_samples", "held_out_all_samples"))]
        for s in figures["steps"]
    ]
    step_rows.append(["published, inertia, viscous, Coulomb, offset", "–", "–", *(number(x, 5) for x in FORCE_ERROR.values())])
    loop_rows = [
        [source, name, *(number(e[s], 4) for s in SIGNALS)] for source, models in loops.items() for name, e in models.items()
    ]
    ripple_rows = [
        [source, cycles, f"{x['amplitude_N']:.2f}", f"{x['phase_rad']:+.2f}", f"{100 * x['share']:.1f} %"]
        for source, by in ripple.items() for cycles, x in by.items()
    ]  # fmt: skip
    named = next((f for f in result.findings if f.effect == "torque_ripple"), None)
    if named is not None:
        n, a, ev = named.parameters["cycles_per_rev"], named.parameters["amplitude_Nm"], named.evidence
        said = (
            f"Named: torque ripple of {interval(a.value, a.ci95, 3)} N at {interval(n.value, n.ci95, 5)} rad/m, a period of "
            f"{1e3 * 2 * math.pi / n.value:.4f} mm; one turn of the motor is {1e3 * LEAD:.1f} mm ({2 * math.pi / LEAD:.1f} rad/m). "
            f"p = {ev['p_value']:.1g} on held-out data after correction for {ev['hypotheses']:.0f} hypotheses; it lowers the "
            f"held-out error from {ev['held_out_error_before']:.4g} to {ev['held_out_error_after']:.4g} N."
        )
    else:
        said = "Not named by the diagnosis; the lines of the picture are there all the same."
    edges = figures["edges"]
    peaks = " and ".join(f"{x:.1f}" for x in edges["peaks"])
    later = (
        f"Later it rings at {peaks} Hz, which the control does not."
        if peaks
        else "Later, nothing between 8 and 60 Hz stands out of the control: the weak ringing that others have seen on these files is not "
        "confirmed by this average."
    )
    asymmetric = any("asymmetry_Nm" in f.parameters for f in result.findings)
    sentences = "\n".join(f"- {f.sentence} Equivalents: {', '.join(f.equivalents) or 'none'}." for f in result.findings)
    hashes = "\n".join(f"- `{r['file']}` ({r['role']}): SHA-256 `{r['sha256'][:16]}...`" for r in result.recordings)
    asymmetry_note = (
        "The sign of the offset is that of the force that it takes from the commanded one."
        if asymmetric else "The offset was named as an effect of its own; see the findings."
    )  # fmt: skip
    return f"""# EMPS: friction in a servo drive, from inertia and viscous friction alone

Generated by `simgap proof emps --out DIR`; do not edit. A real machine: DC motor, ball screw, carriage, under position control.
Recordings and reference values: Janot, Gautier, Brunot, "Data Set and Reference Models of EMPS", 2019 (nonlinearbenchmark.org), fetched by
`simgap data emps`:

{hashes}

The nominal model (`models/emps.xml`) has a mass of 95 kg and viscous friction of 200 N s/m and nothing else. The position loop is
tight, so the diagnosis judges by force ([why](../decisions/motion-and-force.md)).

**Verdict: `{result.verdict.value}`.** {result.summary}

{sentences}

![force](emps/force.png)

## Beside the published table

{table(["", "unit", "published", "found, 95 %", "difference"], _parameter_rows(result))}

{asymmetry_note} The intervals hold for the named structure: they do not cover what another treatment of the reversals would change.

Error of the force relative to the commanded one [%]; "count" leaves out rests, reversals and the filter's ends, "all" takes every
decimated sample, as the published figures do.

{table(["model", "DATA_EMPS, count", "PULSES, count", "DATA_EMPS, all", "PULSES, all"], step_rows)}

## The model in the loop

The published controller, u = kv (kp (reference - position) - velocity) + pulse with kp = {SERVO.kp} 1/s, kv = {SERVO.kv} V s/m, {SERVO.drive} N/V,
closed around each model, sampled at 1 kHz, run from rest along the recorded reference for 25 s. Relative errors [%]; both sides
low-passed at 100 Hz, derivatives by central differences.

{table(["recording", "model", *SIGNALS], loop_rows)}

The row "published" is quoted; "published, in this loop" is that model in our loop, and is what "found" has to be compared with: the
published simulation's sampling and filters are not known in every detail. Position and velocity tell little: the loop hides what the model lacks.

## One turn of the screw

{said}

{table(["recording", "cycles a turn", "amplitude [N]", "phase [rad]", "share of the residual"], ripple_rows)}

By regression at exactly one and two cycles a turn on every sample. Amplitude and pitch carry over from one recording to the other;
the phase is each recording's own, since the encoder counts from where it was switched on. The second harmonic is there and not named: the library
lays one ripple at a place.

![ripple](emps/ripple.png)

## What is left, and not named

The 60 ms after the edges of the force pulses are {100 * edges["time_share"]:.0f} % of the time that counts and hold {100 * edges["share"]:.0f} % of what the found model leaves
of PULSES. Averaged over {edges["edges"]} edges the residual swings by {edges["peak_N"]:.0f} N and is gone after some 60 ms. {later} So what is left is located: fast,
after steps of the force. A flexibility of screw, coupling or frame does that, and so does a command that acts a fraction of a sample
sooner or later than it is logged; one mass tells neither. Asked directly, a further flexible mode on top of the found model comes out at
{number(flexible["inertia_kg"], 3)} kg and {number(flexible["frequency_hz"], 3)} Hz and {"lowers" if flexible["held_out_gain"] > 0 else "raises"} the held-out squared error by {100 * abs(flexible["held_out_gain"]):.1f} %. To be named
it would have to lower it by 2 % ([why](../decisions/evidence.md)).

![ringing](emps/ringing.png)
"""
