"""Cases: draw an axis, what is concealed in it and how it is driven, at one of the levels of difficulty.

A case is drawn again until its effect has the size that its level asks for, so that "hidden" and "visible" are facts
about the recording and not about a parameter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from lab.benchmark.catalogue import CATALOGUE, EQUIVALENT, OTHER_LAWS, OUTSIDE, Entry, compose, draw
from lab.benchmark.experiment import Experiment, draw_experiment, log_uniform
from lab.benchmark.laws import Laws
from lab.benchmark.measurement import Measurement
from lab.benchmark.plant import Motion, free_run, record
from lab.benchmark.refit import COARSE, LINEAR, rms
from lab.benchmark.size import Size, hidden_by_linear, raw, sizes, without
from mjsim.errors import InputError

__all__ = ["LEVELS", "SIZE", "Case", "effects_of", "make_case"]

# Smallest size of what neither a linear refit nor a simpler effect hides, and largest of what the linear refit leaves,
# both over the noise rms. Under noise both bounds are for the latter, and a tenth of the noise must be distinct. Faint effects
# are about as small as can be seen at all: they show where detection begins and count for the curves of power alone.
SIZE: dict[str, tuple[float, float]] = {
    "plain": (1.0, 80.0),
    "other_law": (1.0, 80.0),
    "under_noise": (0.15, 0.95),
    "behind_refit": (0.3, 4.0),
    "behind_feedback": (0.3, 30.0),
    "two_effects": (0.6, 80.0),
    "out_of_library": (0.5, 80.0),
    "faint": (0.012, 0.25),
    "coloured": (1.0, 80.0),
}
SPREAD = 0.06  # relative half-width of the linear parameters about Table 2
TRIES = 240
TURN = 30  # tries for one choice of effects


@dataclass(frozen=True)
class Case:
    """Two recordings of one axis, the second by another experiment, and the truth about them."""

    level: str
    estimation: Motion
    held_out: Motion
    truth: Mapping[str, object]


@dataclass(frozen=True)
class _Found:
    laws: Laws
    entries: tuple[Entry, ...]
    parameters: tuple[dict[str, float], ...]
    measurement: Measurement
    experiment: Experiment
    size: tuple[Size, ...]


def _axis(rng: np.random.Generator, spread: float = SPREAD) -> Laws:
    nominal = Laws()
    return nominal._replace(**{n: getattr(nominal, n) * (1 + spread * float(rng.uniform(-1, 1))) for n in LINEAR})


def _experiment(rng: np.random.Generator, entries: tuple[Entry, ...], closed: bool = False) -> Experiment:
    if closed:
        kind = str(rng.choice(["trapezoid", "speed_multisine"]))
    else:
        kind = str(rng.choice(["chirp"] * 7 + ["multisine"] * 7 + ["steps"] * 2 + ["trapezoid"] * 4))
        prefers = [k for e in entries for k in e.prefers]
        if prefers and rng.random() < 0.8:
            kind = str(rng.choice(prefers))
    return draw_experiment(kind, rng, log_uniform(rng, 0.5, 4.0))


def _held_out(rng: np.random.Generator, first: Experiment) -> Experiment:
    """Another experiment of about the same strength: the other kind of torque, or another profile."""
    other = {"chirp": "multisine", "multisine": "chirp", "steps": "multisine"}
    if not first.closed:
        amplitude = float(np.sqrt(2 * np.mean(first.torque**2)))
        return draw_experiment(other[first.excitation], rng, amplitude * float(rng.uniform(0.7, 1.1)))
    unit = 20.0 if first.excitation == "trapezoid" else 6.0
    amplitude = (first.settings.get("speed_rad_s") or first.settings["rms_rad_s"]) / unit
    return draw_experiment(first.excitation, rng, amplitude * float(rng.uniform(0.7, 1.1)))


def _usual(rng: np.random.Generator) -> Measurement:
    return Measurement(velocity_noise=log_uniform(rng, 0.03, 0.15))


def _any_noise(rng: np.random.Generator) -> Measurement:
    """White, coloured, repetitive over the turn, or quantised by an encoder: what a recorder does to a sound model."""
    base = _usual(rng)
    kind = rng.choice(["white", "ar1", "ar2", "repetitive", "quantised"])
    if kind == "ar1":
        return replace(base, poles=(complex(rng.uniform(0.5, 0.98)),))
    if kind == "ar2":
        pole = rng.uniform(0.7, 0.97) * np.exp(2j * np.pi * log_uniform(rng, 10.0, 300.0) / 2000.0)
        return replace(base, poles=(complex(pole), complex(np.conj(pole))))
    if kind == "repetitive":
        cycles = float(rng.choice([1.0, 2.0, 4.0, 8.0]))
        phase = float(rng.uniform(-np.pi, np.pi))
        amplitude = log_uniform(rng, 1e-4, 3e-3) / cycles
        return replace(base, repeat_amplitude=amplitude, repeat_cycles=cycles, repeat_phase=phase)
    if kind == "quantised":
        step = base.velocity_noise * log_uniform(rng, 0.1, 1.0)  # noise larger than a step: it acts as further white noise
        return replace(base, velocity_step=step, encoder_step=2 * np.pi / float(rng.choice([2**12, 2**14, 2**17])))
    return base


def _not_white(rng: np.random.Generator) -> Measurement:
    while (measurement := _any_noise(rng)).kind == "white":
        continue
    return measurement


def _dress(laws: Laws, chosen: tuple[Entry, ...], rng: np.random.Generator, peak: float) -> tuple[Laws, list[dict]]:
    parameters = []
    for entry in chosen:
        p = draw(entry, rng, peak)
        laws = compose(laws, entry, p)
        parameters.append(p)
    return laws, parameters


def _search(
    level: str,
    rng: np.random.Generator,
    pool: tuple[Entry, ...],
    first: str | None = None,
    count: int = 1,
    *,
    closed: bool = False,
    hide: Callable[[Laws, tuple[Entry, ...], np.ndarray, float], Laws] | None = None,
    under_noise: bool = False,
    quiet: float = 0.0,
    measured: Callable[[np.random.Generator], Measurement] = _usual,
) -> _Found:
    """Draw until every effect has the size that the level asks for; ``first`` is given up after 2 ``TURN`` tries.

    ``under_noise``: the noise is raised until the effect has the size drawn, to 1 rad/s or ``quiet`` times the rms speed.
    """
    low, high = SIZE[level]
    chosen = _choose(rng, pool, count, first)
    for attempt in range(TRIES):
        if attempt % TURN == TURN - 1:
            chosen = _choose(rng, pool, count, first if attempt < 2 * TURN else None)
        measurement = measured(rng)
        try:
            laws = _axis(rng)
            experiment = _experiment(rng, chosen, closed)
            bare = record(laws, experiment, measurement, rng, substeps=COARSE)
            peak = float(np.max(np.abs(bare.torque)))
            laws, parameters = _dress(laws, chosen, rng, peak)
            if laws.droop * peak * peak > 0.3 or laws.cubic_g < 0 or laws.cubic_a < 0:
                continue
            if any(e.effect == "held_rows" for e in chosen):
                measurement = replace(measurement, dropped=parameters[0]["probability"], hold=round(parameters[0]["rows"]))
            torque = record(laws, experiment, measurement, rng, substeps=COARSE).torque
            noise = measurement.velocity_noise
            if measurement.dropped > 0.0:
                s = _dropped_size(laws, torque, measurement, rng)
                size = [Size(s, s, s)]
            else:
                if not under_noise and min(raw(laws, [e], torque) for e in chosen) < low * noise:
                    continue
                if hide is not None:
                    laws = hide(laws, chosen, torque, high * noise)
                size = _sizes(laws, chosen, torque, noise, *((0.0, np.inf) if under_noise else (low, high)))
            if under_noise and size:
                loud = size[0].after_refit * noise / log_uniform(rng, low, high)
                if not 0.02 <= loud <= max(1.0, quiet * rms(bare.velocity_true)):
                    continue
                size = [Size(*(x * noise / loud for x in (size[0].raw, size[0].after_refit, size[0].distinct)))]
                measurement = replace(measurement, velocity_noise=loud)
            distinct = min(0.1, low) if under_noise else low
            if size and all(distinct <= s.distinct and s.after_refit <= high for s in size):
                return _Found(laws, chosen, tuple(parameters), measurement, experiment, tuple(size))
        except InputError:
            continue
    raise InputError(f"level {level}", f"no case of the size {low}-{high} in {TRIES} draws", todo="try another seed")


def _sizes(laws: Laws, chosen: tuple[Entry, ...], torque: np.ndarray, noise: float, low: float, high: float) -> list[Size]:
    """Size of each effect; empty as soon as one is outside the bounds."""
    out = []
    for entry in chosen:
        size = sizes(laws, entry, torque, noise, low, high, chosen)
        if size is None or size.distinct < low:
            return []
        out.append(size)
    return out


def _choose(rng: np.random.Generator, pool: tuple[Entry, ...], count: int, first: str | None) -> tuple[Entry, ...]:
    """Draw effects of different groups: each effect alike likely, then its place or law; ``first`` is one of them."""
    names = list(dict.fromkeys(e.effect for e in pool))
    while True:
        picked = [str(x) for x in rng.choice(names, count, replace=False)]
        if first is not None and first not in picked:
            picked[0] = first
        rows = [[e for e in pool if e.effect == name] for name in picked]
        entries = tuple(row[int(rng.integers(len(row)))] for row in rows)
        if len({e.group for e in entries}) == count:
            return entries


def _dropped_size(laws: Laws, torque: np.ndarray, measurement: Measurement, rng: np.random.Generator) -> float:
    y = free_run(laws, torque, substeps=COARSE).velocity
    _, _, drop = measurement.noise(torque.size, rng)
    last = np.maximum.accumulate(np.where(drop == 0, np.arange(drop.size), 0))
    return rms(y - y[last]) / measurement.velocity_noise


def _hide(laws: Laws, entries: tuple[Entry, ...], torque: np.ndarray, limit: float) -> Laws:
    """Re-tune the true linear parameters until the best linear model of the output *is* the nominal one.

    An effect of which that model leaves more than twice ``limit`` [rad/s] is given up at once.
    """
    nominal = Laws()
    best, best_miss = laws, np.inf
    for _ in range(5):
        start = laws._replace(**{n: getattr(nominal, n) for n in LINEAR})
        fitted = hidden_by_linear(laws, entries, torque, start)
        if fitted.left > 2 * limit:
            raise InputError("hide", "the refit leaves too much", "an effect that linear parameters nearly hide")
        bare = laws
        for entry in entries:
            bare = without(bare, entry)
        plain = bare._replace(**{n: getattr(nominal, n) for n in LINEAR})
        y = free_run(laws, torque, substeps=COARSE).velocity
        miss = rms(y - free_run(plain, torque, substeps=COARSE).velocity) / max(fitted.left, 1e-9)
        if miss < best_miss:
            best, best_miss = laws, miss
        if miss < 1.05:
            break
        change = {n: getattr(laws, n) * getattr(nominal, n) / getattr(fitted.laws, n) for n in LINEAR}
        for n in LINEAR:
            if not 0.5 < change[n] / getattr(nominal, n) < 2.0:
                raise InputError("hide", f"{n} would have to be {change[n]:.3g}", "half to twice the nominal value")
        laws = laws._replace(**change)
    if best_miss > 1.3:
        raise InputError("hide", f"the nominal model stays {best_miss:.2f} times worse than the refit", "at most 1.3")
    return best


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


def _plain(rng: np.random.Generator, first: str | None) -> _Found:
    return _search("plain", rng, CATALOGUE, first)


def _other_law(rng: np.random.Generator, first: str | None) -> _Found:
    return _search("other_law", rng, OTHER_LAWS, first)


def _under_noise(rng: np.random.Generator, first: str | None) -> _Found:
    return _search("under_noise", rng, _SMOOTH, first, under_noise=True)


def _faint(rng: np.random.Generator, first: str | None) -> _Found:
    return _search("faint", rng, _SMOOTH, first, under_noise=True, quiet=0.3)


def _coloured(rng: np.random.Generator, first: str | None) -> _Found:
    """As plain, beside noise that is not white, a third of it under feedback."""
    return _search("coloured", rng, CATALOGUE, first, closed=bool(rng.random() < 0.33), measured=_not_white)


def _behind_refit(rng: np.random.Generator, first: str | None) -> _Found:
    pool = _POOLS["behind_refit"]
    return _search("behind_refit", rng, pool, first, hide=_hide)


def _behind_feedback(rng: np.random.Generator, first: str | None) -> _Found:
    return _search("behind_feedback", rng, CATALOGUE, first, closed=True)


def _two_effects(rng: np.random.Generator, first: str | None) -> _Found:
    return _search("two_effects", rng, CATALOGUE, first, count=2)


def _out_of_library(rng: np.random.Generator, first: str | None) -> _Found:
    return _search("out_of_library", rng, OUTSIDE, first)


def _nothing(rng: np.random.Generator, _first: str | None) -> _Found:
    closed = bool(rng.random() < 0.15)
    return _Found(Laws(), (), (), _any_noise(rng), _experiment(rng, (), closed), ())


def _parameters_only(rng: np.random.Generator, _first: str | None) -> _Found:
    spread = float(rng.choice([0.06, 0.15, 0.3]))
    return _Found(_axis(rng, spread), (), (), _any_noise(rng), _experiment(rng, (), bool(rng.random() < 0.15)), ())


LEVELS: dict[str, Callable[[np.random.Generator, str | None], _Found]] = {
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


def _second(found: _Found, rng: np.random.Generator) -> tuple[Experiment, Motion] | None:
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
