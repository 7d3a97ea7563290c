"""Cases: draw an axis, what is concealed in it and how it is driven, at one of the levels of difficulty.

A case is drawn again until its effect has the size that its level asks for, so that "hidden" and "visible" are facts
about the recording and not about a parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

import numpy as np

from lab.benchmark.catalogue import CATALOGUE, EQUIVALENT, OTHER_LAWS, OUTSIDE, Entry
from lab.benchmark.experiment import Experiment, draw_experiment
from lab.benchmark.laws import Laws
from lab.benchmark.plant import Motion, free_run, record
from lab.benchmark.refit import LINEAR, rms
from lab.benchmark.sized import Found, any_axis, any_experiment, any_noise, draw_of_size, hide_from_refit, not_white
from mjsim.errors import InputError

__all__ = ["LEVELS", "Case", "effects_of", "make_case"]


@dataclass(frozen=True)
class Case:
    """Two recordings of one axis, the second by another experiment, and the truth about them."""

    level: str
    estimation: Motion
    held_out: Motion
    truth: Mapping[str, object]


def _held_out(rng: np.random.Generator, first: Experiment) -> Experiment:
    """Another experiment of about the same strength: the other kind of torque, or another profile."""
    other = {"chirp": "multisine", "multisine": "chirp", "steps": "multisine"}
    if not first.closed:
        amplitude = float(np.sqrt(2 * np.mean(first.torque**2)))
        return draw_experiment(other[first.excitation], rng, amplitude * float(rng.uniform(0.7, 1.1)))
    unit = 20.0 if first.excitation == "trapezoid" else 6.0
    amplitude = (first.settings.get("speed_rad_s") or first.settings["rms_rad_s"]) / unit
    return draw_experiment(first.excitation, rng, amplitude * float(rng.uniform(0.7, 1.1)))


_SMOOTH = tuple(e for e in CATALOGUE if e.effect != "sensor_quantisation")  # a step below the noise is noise
_POOLS: dict[str, tuple[Entry, ...]] = {
    "plain": CATALOGUE,
    "under_noise": _SMOOTH,
    "behind_refit": _SMOOTH,
    "behind_feedback": CATALOGUE,
    "two_effects": CATALOGUE,
    "other_law": OTHER_LAWS,
    "out_of_library": OUTSIDE,
    "faint": _SMOOTH,
    "coloured": CATALOGUE,
}


def effects_of(level: str) -> tuple[str, ...]:
    """The effects that a level can conceal."""
    return tuple(dict.fromkeys(e.effect for e in _POOLS.get(level, ())))


def _plain(rng: np.random.Generator, first: str | None) -> Found:
    return draw_of_size("plain", rng, CATALOGUE, first)


def _other_law(rng: np.random.Generator, first: str | None) -> Found:
    return draw_of_size("other_law", rng, OTHER_LAWS, first)


def _under_noise(rng: np.random.Generator, first: str | None) -> Found:
    return draw_of_size("under_noise", rng, _SMOOTH, first, under_noise=True)


def _faint(rng: np.random.Generator, first: str | None) -> Found:
    return draw_of_size("faint", rng, _SMOOTH, first, under_noise=True, quiet=0.3)


def _coloured(rng: np.random.Generator, first: str | None) -> Found:
    """As plain, beside noise that is not white, a third of it under feedback."""
    return draw_of_size("coloured", rng, CATALOGUE, first, closed=bool(rng.random() < 0.33), measured=not_white)


def _behind_refit(rng: np.random.Generator, first: str | None) -> Found:
    pool = _POOLS["behind_refit"]
    return draw_of_size("behind_refit", rng, pool, first, hide=hide_from_refit)


def _behind_feedback(rng: np.random.Generator, first: str | None) -> Found:
    return draw_of_size("behind_feedback", rng, CATALOGUE, first, closed=True)


def _two_effects(rng: np.random.Generator, first: str | None) -> Found:
    return draw_of_size("two_effects", rng, CATALOGUE, first, count=2)


def _out_of_library(rng: np.random.Generator, first: str | None) -> Found:
    return draw_of_size("out_of_library", rng, OUTSIDE, first)


def _nothing(rng: np.random.Generator, _first: str | None) -> Found:
    closed = bool(rng.random() < 0.15)
    return Found(Laws(), (), (), any_noise(rng), any_experiment(rng, (), closed), ())


def _parameters_only(rng: np.random.Generator, _first: str | None) -> Found:
    spread = float(rng.choice([0.06, 0.15, 0.3]))
    return Found(any_axis(rng, spread), (), (), any_noise(rng), any_experiment(rng, (), bool(rng.random() < 0.15)), ())


LEVELS: dict[str, Callable[[np.random.Generator, str | None], Found]] = {
    "plain": _plain,
    "under_noise": _under_noise,
    "behind_refit": _behind_refit,
    "behind_feedback": _behind_feedback,
    "two_effects": _two_effects,
    "other_law": _other_law,
    "out_of_library": _out_of_library,
    "nothing": _nothing,
    "parameters_only": _parameters_only,
    "faint": _faint,
    "coloured": _coloured,
}

VERDICT = {"nothing": "no_mismatch", "parameters_only": "parameters_only", "out_of_library": "unexplained"}


def _sensitivity(laws: Laws, torque: np.ndarray) -> float:
    """Rms change [rad/s] of a free run when the torque changes by a millionth: what no model can be asked to meet."""
    return rms(free_run(laws, torque).velocity - free_run(laws, torque * (1 + 1e-6)).velocity)


STILL = 3.0  # noise rms: an axis below that speed is held still by friction; its case is drawn again, or the held-out drive is

SIMPLER = {"coulomb_m": "coulomb_friction", "offset_m": "torque_offset", "act_delay": "time_delay"}


def _second(found: Found, rng: np.random.Generator) -> tuple[Experiment, Motion] | None:
    """The held-out experiment of a case and its recording; None where none of 20 is stable and moves."""
    for _ in range(20):
        experiment = _held_out(rng, found.experiment)
        try:
            motion = record(found.laws, experiment, found.measurement, rng)
        except InputError:
            continue
        if rms(motion.velocity_true) > STILL * found.measurement.floor:
            return experiment, motion
    return None


def make_case(level: str, rng: np.random.Generator, first: str | None = None) -> Case:
    """Draw a case of a level, with the effect ``first`` where it can have the size asked for; else another is drawn.

    The same generator state gives the same case.

    The truth has the keys of the practice set (``effects``, ``where``, ``parameters``, ``velocity_noise_rms_rad_s``,
    ``closed_loop``, ``excitation``, ``linear_parameters``) and ``level``, ``verdict`` (the one expected), ``law`` (by
    which each effect was made), ``size`` (see `size.Size`; ``distinct`` is over the ``simpler`` effects),
    ``equivalents`` (what makes the same motion), ``measurement``, ``noise_kind``, ``repeat_over_noise``,
    ``sensitivity_over_noise``, ``held_out_excitation`` and both experiments' settings.
    """
    if level not in LEVELS:
        raise InputError("level", f"{level!r} is not known", f"one of {', '.join(LEVELS)}")
    if first is not None and first not in effects_of(level):
        raise InputError(f"level {level}", f"{first!r} cannot be hidden", f"one of {', '.join(effects_of(level))}")
    for _ in range(20):
        found = LEVELS[level](rng, first)
        estimation = record(found.laws, found.experiment, found.measurement, rng)
        second = _second(found, rng) if rms(estimation.velocity_true) > STILL * found.measurement.floor else None
        if second is not None:
            break
    else:
        raise InputError(f"level {level}", "no case is stable and moves in both recordings", todo="try another seed")
    experiment, held_out = second
    names = [e.effect for e in found.entries]
    m = found.measurement
    repeat = m.repeat_amplitude * m.repeat_cycles * rms(estimation.velocity_true) / np.sqrt(2) / m.velocity_noise
    truth: dict[str, object] = {
        "level": level,
        "verdict": VERDICT.get(level, "missing_physics"),
        "effects": names,
        "where": {e.effect: e.place for e in found.entries},
        "parameters": dict(zip(names, found.parameters, strict=True)),
        "law": {e.effect: e.law for e in found.entries},
        "size": {n: asdict(s) for n, s in zip(names, found.size, strict=True)},
        "simpler": {e.effect: [SIMPLER[f] for f in e.rivals] for e in found.entries},
        "equivalents": {
            e.effect: [[f"{name}@{place}" for name, place in group] for group in EQUIVALENT.get((e.effect, e.place), ())]
            for e in found.entries
        },
        "velocity_noise_rms_rad_s": m.floor,
        "noise_kind": m.kind,
        "repeat_over_noise": float(repeat),
        "sensitivity_over_noise": {
            "estimation": _sensitivity(found.laws, estimation.torque) / m.floor,
            "held_out": _sensitivity(found.laws, held_out.torque) / m.floor,
        },
        "measurement": {**asdict(m), "poles": [[p.real, p.imag] for p in m.poles]},
        "closed_loop": found.experiment.closed,
        "excitation": found.experiment.excitation,
        "held_out_excitation": experiment.excitation,
        "settings": {"estimation": found.experiment.settings, "held_out": experiment.settings},
        "linear_parameters": {n: getattr(found.laws, n) for n in LINEAR},
    }
    return Case(level, estimation, held_out, truth)
