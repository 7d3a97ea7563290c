"""Known physics concealed in real recordings: taken out of the model, or put into the real signals."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diagnose.data.experiment import prepare
from diagnose.explain.second_encoder import judge_second_encoder
from diagnose.pipeline import Options, diagnose
from diagnose.problem.hypothesis import make
from lab.proof.page import Page, Say, number, plain, table
from mjsim.axis import Axis
from mjsim.mjcf import load_axis
from mjsim.models import shipped_model
from mjsim.recording import Recording, load

__all__ = ["CASES", "Case", "concealed_page", "delayed", "pushed"]

Change = Callable[[Recording], Recording]

PITCH = 0.007  # of the ripple that is put in [m]: no multiple of the screw's
AMPLITUDE = 1.5  # [N]
DELAY = 0.005  # [s]
TOLERANCE = 0.1  # of a parameter, for the answer to be right


@dataclass(frozen=True)
class Case:
    """What is concealed, how, in a model that lacks ``left_out`` of the known physics; ``effect``: the right answer, if any."""

    title: str
    real: str
    changed: str
    effect: str | None
    parameters: Mapping[str, float]
    left_out: tuple[str, ...]
    change: Change


def pushed(recording: Recording) -> Recording:
    """The command with a ripple on top: what the servo would have had to command, along the same motion, against that ripple."""
    assert recording.angle is not None
    ripple = AMPLITUDE * np.sin(2 * np.pi / PITCH * recording.angle + 0.4)
    return dataclasses.replace(recording, torque=recording.torque + ripple)


def delayed(recording: Recording, delay: float = DELAY) -> Recording:
    """The position read late."""
    from scipy.interpolate import CubicSpline

    assert recording.angle is not None
    late = CubicSpline(recording.time, recording.angle)(np.maximum(recording.time - delay, recording.time[0]))
    return dataclasses.replace(recording, angle=late)


# what the machine has by its published table and by its own page of the proof (ripple: order and amplitude; phases are free)
KNOWN: dict[str, dict[str, float]] = {
    "coulomb_friction": {"torque_Nm": 20.3935},
    "torque_offset": {"torque_Nm": 3.1648},
    "torque_ripple": {"amplitude_Nm": 0.77, "cycles_per_rev": 2 * np.pi / 0.0025, "phase_rad": 0.0},
}

CASES = (
    Case("nothing (control)", "everything", "nothing: the model holds all that is known", None, {}, (), lambda r: r),
    Case("one turn of the screw, taken out of the model", "everything", "the model has friction and offset, no ripple",
         "torque_ripple", {"cycles_per_rev": KNOWN["torque_ripple"]["cycles_per_rev"]}, ("torque_ripple",), lambda r: r),
    Case("the offset, taken out of the model", "everything", "the model has Coulomb friction and ripple, no offset",
         "torque_offset", {"torque_Nm": 3.1648}, ("torque_offset",), lambda r: r),
    Case(f"a ripple of {AMPLITUDE} N each {1e3 * PITCH:g} mm, put into the command", "motion; command but for the ripple",
         "command + ripple of the recorded position: the servo is taken to hold the same motion",
         "torque_ripple", {"amplitude_Nm": AMPLITUDE, "cycles_per_rev": 2 * np.pi / PITCH}, ("torque_ripple",), pushed),
    Case(f"a delay of {1e3 * DELAY:g} ms, put into the position", "command; motion but for its time",
         "position interpolated at t - 5 ms; the real servo did not see it",
         "time_delay", {"delay_s": DELAY}, ("torque_ripple",), delayed),
)  # fmt: skip


def concealed_page(emps: Mapping[str, Path], kuka: Mapping[str, Path], say: Say = lambda _: None, jobs: int = 2) -> Page:
    """Run every case, the right answer beside the one that was given."""
    model = shipped_model("emps")
    recordings = [load(emps[role], model=model) for role in ("estimation", "held-out")]
    nominal = load_axis(model).with_linear({"Jm": 95.1089, "fm": 203.5034})
    rows, found = [], []
    for case in CASES:
        say(f"EMPS: {case.title}")
        known = _known(nominal, case.left_out)
        first, second = (case.change(r) for r in recordings)
        result = diagnose(known, [first], [second], Options(jobs=jobs))
        right = _right(case, result.findings)
        names = "; ".join(_said(f) for f in result.findings) or "–"
        rows.append([case.title, case.real, case.changed, result.verdict.value, names, right])
        found.append({"case": case.title, "verdict": result.verdict.value, "right": right, "findings": [f.effect for f in result.findings],
                      "parameters": {f.effect: {n: e.as_dict() for n, e in f.parameters.items()} for f in result.findings}})  # fmt: skip
    say("KUKA: the second encoder")
    encoder_rows, encoder_found = _encoder_cases(kuka)
    figures: dict[str, Any] = {"emps": found, "second_encoder": encoder_found}
    return Page("concealed_real", _text(rows, encoder_rows), {}, plain(figures))


def _known(nominal: Axis, left_out: tuple[str, ...]) -> Axis:
    for name, values in KNOWN.items():
        if name not in left_out:
            nominal = nominal + make(name, "motor", values)
    return nominal


def _said(finding: Any) -> str:
    values = ", ".join(
        f"{e.value:.4g} [{e.ci95[0]:.4g}, {e.ci95[1]:.4g}] {e.unit}"
        for n, e in finding.parameters.items() if n != "phase_rad"
    )  # fmt: skip
    also = f" (or {', '.join(finding.equivalents)})" if finding.equivalents else ""
    return f"{finding.effect.replace('_', ' ')} at the {finding.place}: {values}{also}"


def _right(case: Case, findings: Any) -> str:
    """Yes, no, or what of it is right: one effect, its parameters within the tolerance."""
    if case.effect is None:
        return "yes" if not findings else "no"
    named = next((f for f in findings if case.effect == f.effect or case.effect in f.equivalents), None)
    if named is None:
        return "no"
    if case.effect != named.effect:
        return "as an equivalent"
    wrong = {n: named.parameters[n].value / v - 1 for n, v in case.parameters.items()}
    more = [f.effect.replace("_", " ") for f in findings if f is not named and f.effect not in case.left_out]
    also = [f.effect.replace("_", " ") for f in findings if f is not named and f.effect in case.left_out]
    said = ", ".join(f"{n} {100 * x:+.1f} %" for n, x in wrong.items())
    if more or max(map(abs, wrong.values())) > TOLERANCE:
        return f"in part ({said})" + (f": {' and '.join(more)} is not there" if more else "")
    return f"yes ({said})" + (f"; {' and '.join(also)}, left out as well, is found too" if also else "")


def _encoder_cases(kuka: Mapping[str, Path]) -> tuple[list[list[str]], list[dict[str, Any]]]:
    """Delay and backlash put on top of what the real second encoder shows."""
    model = shipped_model("kuka_kr300_axis1")
    chain = load_axis(model).chain
    recordings = [load(kuka[role], model=model) for role in ("estimation", "held-out")]

    def late(r: Recording, by: float) -> Recording:
        from scipy.interpolate import CubicSpline

        assert r.second_angle is not None
        moved = CubicSpline(r.time, r.second_angle)(np.maximum(r.time - by, r.time[0]))
        return dataclasses.replace(r, second_angle=moved)

    def gap(r: Recording, width: float) -> Recording:
        assert r.second_angle is not None
        return dataclasses.replace(r, second_angle=r.second_angle - 0.5 * width * np.sign(r.torque))

    cases: tuple[tuple[str, Change], ...] = (
        ("nothing", lambda r: r),
        ("2 ms later", lambda r: late(r, 2e-3)),
        ("a gap of 400 microrad", lambda r: gap(r, 4e-4)),
        ("both", lambda r: gap(late(r, 2e-3), 4e-4)),
    )
    rows, figures = [], []
    for name, change in cases:
        result = judge_second_encoder(chain, [prepare(change(recordings[0]))], [prepare(change(recordings[1]))])
        assert result is not None
        v = result.found.values
        delay = f"{1e3 * v['time_delay']:.2f} ms" if "time_delay" in v else "none"
        width = f"{1e6 * v['backlash']:.0f} microrad" if "backlash" in v else "none"
        other = ", ".join(t for t in result.found.terms if t not in ("time_delay", "backlash")) or "none"
        rows.append([name, delay, width, other, f"{1e6 * result.found.held_out_rms:.0f}"])
        figures.append({"put in": name, "found": dict(v), "left_rad": result.found.held_out_rms})
    return rows, figures


def _text(rows: list[list[str]], encoder_rows: list[list[str]]) -> str:
    return f"""# Concealed in real recordings

Generated by `simgap proof concealed --out DIR`; do not edit. Recordings of EMPS and of KUKA KR300 axis 1 (`simgap data emps`,
`simgap data kuka_kr300`). Known physics is taken out of the model, or put into the real signals; the diagnosis is told nothing.

What is real: friction, noise, quantisation, the controller, everything about these machines that nobody has modelled. What is not:
where something is put in, the servo did not react to it. A ripple in the command is exact for a servo that holds its motion (EMPS's
position follows to microns); a late position is what a late encoder would have logged, but the real loop was closed on the prompt one.

## EMPS, judged by force

DATA_EMPS for the fit, PULSES held out. Known: inertia {number(95.1089, 6)} kg, viscous friction, Coulomb friction and offset as published, one
ripple a turn; the linear parameters are free.

{table(["concealed", "real", "changed", "verdict", "found, 95 %", "right?"], rows)}

Where the ripple of one turn is left out of the model as well, it is there to be found beside what was put in, and counts as right; the library
lays one ripple at a place, so that the smaller of two may be missed or take another name. Which of its names is wrong is said in the last column.

## KUKA, the second encoder

On top of its own delay (about 3.1 ms) and no gap that pays:

{table(["put in", "delay found", "gap found", "other terms", "left, held out [microrad]"], encoder_rows)}
"""
