"""Cases: an experiment on a machine, and one fault laid on its log, all drawn from one generator."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lab.log_faults.machines import MACHINES, Plant, perturbed
from mjsim.excitation import Cascade, Grid, chirp, close_loop, multisine, trapezoids
from mjsim.ode import simulate
from mjsim.recording import Recording

__all__ = ["KINDS", "Case", "draw"]

FINE = 4000  # samples a second of the simulation
SECONDS = 10.0
RATES = (250, 500, 1000)


@dataclass(frozen=True, eq=False)
class Case:
    """A faulty log and its clean control; kind: the problem that has to be named, channel: where, detail: what was done."""

    number: int
    plant: Plant
    experiment: str
    kind: str
    channels: tuple[str, ...]
    detail: str
    faulty: Recording
    clean: Recording


@dataclass(frozen=True, eq=False)
class _Motion:
    """Input and motion on the fine grid, with the noise that the sensors add at the samples of the log."""

    rate: int
    torque: np.ndarray
    velocity: np.ndarray
    angle: np.ndarray
    noise: tuple[np.ndarray, np.ndarray]

    def log(self, shift: float = 0.0) -> Recording:
        """The log, its motion ``shift`` [s] late against its torque, cut where both are known."""
        every = FINE // self.rate
        t = np.arange(0, len(self.velocity), every)[: len(self.torque)] / FINE
        fine = np.arange(len(self.velocity)) / FINE
        inside = (t - shift >= 0) & (t - shift <= fine[-1])
        v, q = (np.interp(t - shift, fine, x) + n for x, n in zip((self.velocity, self.angle), self.noise, strict=True))
        dt = 1 / self.rate
        keep = np.flatnonzero(inside)
        return Recording(
            dt * np.arange(len(keep)), self.torque[keep], v[keep], q[keep], dt, source="log.csv",
            units={"torque": "Nm", "velocity": "rad/s", "angle": "rad"},
        )  # fmt: skip


def _between(u: np.ndarray, every: int, hold: str) -> np.ndarray:
    """The input on the fine grid: held over each sample, or linear between samples."""
    if hold == "held":
        return np.repeat(u, every)
    k = np.arange(len(u) * every) / every
    between: np.ndarray = np.interp(k + 0.5 / every, np.arange(len(u)), u)  # mean over the fine interval
    return between


def _input(plant: Plant, rate: int, experiment: str, rng: np.random.Generator, axis: object) -> np.ndarray:
    dt = 1 / rate
    high = min(plant.high, 0.2 * rate)
    if experiment == "chirp":
        return chirp(SECONDS, dt, 1.4 * plant.torque, plant.low, high)
    if experiment == "multisine":
        return multisine(rng, SECONDS, dt, plant.torque, plant.low, high, period=5.0, grid=Grid.FULL)
    inertia = plant.nominal.chain.bodies[0].inertia / abs(plant.nominal.chain.gain)
    reference = trapezoids(SECONDS, dt, 2.0, 12.0, 0.25, 0.1) + 0.5 * multisine(
        rng, SECONDS, dt, 1.0, 0.5, 6.0, period=5.0, grid=Grid.FULL
    )
    noise = 0.01 * rng.standard_normal(len(reference))
    cascade = Cascade(6.0, 25 * inertia, 150 * inertia, 20 * plant.torque)
    return close_loop(axis, reference, dt, cascade, noise)  # type: ignore[arg-type]


def _run(plant: Plant, rng: np.random.Generator, rate: int, experiment: str, hold: str = "held") -> Callable[[str], _Motion]:
    axis = perturbed(plant, rng)
    u = _input(plant, rate, experiment, rng, axis)
    levels = rng.uniform(0.003, 0.015), rng.uniform(0.0003, 0.0015)
    draws = rng.standard_normal((2, len(u)))

    def make(hold: str) -> _Motion:
        every = FINE // rate
        fine = _between(u, every, "linear" if hold == "linear" else "held")
        if hold == "mean":  # the input varies within the sample; the log holds its mean over the interval before
            fine = _between(u, every, "linear")
            means = fine.reshape(-1, every).mean(axis=1)
            logged = np.concatenate([[fine[0]], means[:-1]])
        else:
            logged = u
        run = simulate(axis, fine, 1 / FINE)
        v, q = run.velocity, run.angle
        noise = levels[0] * float(np.std(v)) * draws[0], levels[1] * float(np.std(q)) * draws[1]
        return _Motion(rate, logged, v, q, (noise[0], noise[1]))

    return make


def _replace(r: Recording, **changes: object) -> Recording:
    return dataclasses.replace(r, **changes)  # type: ignore[arg-type]


def _sign(m: _Motion, r: Recording, plant: Plant, rng: np.random.Generator) -> tuple[Recording, tuple[str, ...], str]:
    channel = str(rng.choice(["torque", "velocity", "angle"]))
    return _replace(r, **{channel: -r.column(channel)}), (channel,), f"{channel} turned"


_UNITS: tuple[tuple[str, float, str], ...] = (
    ("angle", 180 / math.pi, "degrees"), ("velocity", 30 / math.pi, "rpm"), ("velocity", 180 / math.pi, "degrees/s"),
    ("torque", 1e3, "mN m"), ("time", 1e3, "ms"),
)  # fmt: skip


def _unit(m: _Motion, r: Recording, plant: Plant, rng: np.random.Generator) -> tuple[Recording, tuple[str, ...], str]:
    channel, factor, name = _UNITS[int(rng.integers(len(_UNITS)))]
    if channel == "time":
        return _replace(r, time=factor * r.time, dt=factor * r.dt), ("time",), name
    only = rng.random() < 0.5 and channel in ("angle", "velocity")  # the other response is not logged
    changes: dict[str, object] = {channel: factor * r.column(channel)}
    if only:
        changes["velocity" if channel == "angle" else "angle"] = None
    return _replace(r, **changes), (channel,), name + (", alone" if only else "")


def _side(m: _Motion, r: Recording, plant: Plant, rng: np.random.Generator) -> tuple[Recording, tuple[str, ...], str]:
    """Torque or motion at the other side of the gear; their product is what the data show."""
    chain = plant.nominal.chain
    joint_side = abs(chain.gain) > 1  # the model's joint is behind the gear, and its input ahead
    gear = abs(chain.gain) if joint_side else 1 / abs(chain.total_ratio(len(chain.bodies) - 1))
    either = ("torque", "angle", "velocity")
    if rng.random() < 0.5:
        return _replace(r, torque=gear * r.torque), either, f"torque times {gear:.4g}"
    factor = gear if joint_side else 1 / gear
    assert r.velocity is not None
    assert r.angle is not None
    return _replace(r, velocity=factor * r.velocity, angle=factor * r.angle), either, f"motion times {factor:.4g}"


def _skew(m: _Motion, r: Recording, plant: Plant, rng: np.random.Generator) -> tuple[Recording, tuple[str, ...], str]:
    low = max(0.005, 1.25 / m.rate)
    shift = math.exp(rng.uniform(math.log(low), math.log(0.2))) * rng.choice([-1.0, 1.0])
    return m.log(shift), ("velocity", "angle"), f"{1e3 * shift:.1f} ms"


def _jitter(m: _Motion, r: Recording, plant: Plant, rng: np.random.Generator) -> tuple[Recording, tuple[str, ...], str]:
    size = rng.uniform(0.1, 0.4)
    return _replace(r, time=r.time + size * r.dt * rng.uniform(-1, 1, len(r))), ("time",), f"+-{100 * size:.0f} % of a sample"


def _clipping(m: _Motion, r: Recording, plant: Plant, rng: np.random.Generator) -> tuple[Recording, tuple[str, ...], str]:
    channel = str(rng.choice(["torque", "velocity"]))
    x = r.column(channel)
    limit = float(np.quantile(np.abs(x), rng.uniform(0.8, 0.95)))
    return _replace(r, **{channel: np.clip(x, -limit, limit)}), (channel,), f"{channel} at {limit:.3g}"


def _low_pass(m: _Motion, r: Recording, plant: Plant, rng: np.random.Generator) -> tuple[Recording, tuple[str, ...], str]:
    """A zero-phase filter of the fourth order on both responses, or every fourth sample with straight lines between."""
    n = len(r)
    if rng.random() < 0.5:
        f = np.fft.rfftfreq(4 * n) * 2
        corner = rng.uniform(0.1, 0.25)
        gain = 1 / (1 + (f / corner) ** 8)

        def change(x: np.ndarray) -> np.ndarray:
            padded = np.concatenate([x[::-1], x, x[::-1], x])
            return np.asarray(np.fft.irfft(np.fft.rfft(padded) * gain, 4 * n)[n : 2 * n])

        detail = f"filtered at {corner:.2f} of Nyquist"
    else:
        n = (n - 1) // 4 * 4 + 1
        r = r.slice(0, n)
        k, few = np.arange(n), np.arange(0, n, 4)

        def change(x: np.ndarray) -> np.ndarray:
            held: np.ndarray = np.interp(k, few, x[few])
            return held

        detail = "interpolated from a quarter of the samples"
    return _replace(r, velocity=change(r.column("velocity")), angle=change(r.column("angle"))), ("velocity", "angle"), detail


def _duplicated(m: _Motion, r: Recording, plant: Plant, rng: np.random.Generator) -> tuple[Recording, tuple[str, ...], str]:
    share = rng.uniform(0.02, 0.2)
    k = np.arange(len(r))
    k[1:] -= rng.random(len(r) - 1) < share
    return (
        _replace(r, torque=r.torque[k], velocity=r.column("velocity")[k], angle=r.column("angle")[k]), ("time",),
        f"{100 * share:.0f} % of the rows",
    )  # fmt: skip


_Fault = Callable[[_Motion, Recording, Plant, np.random.Generator], tuple[Recording, tuple[str, ...], str]]
_FAULTS: dict[str, _Fault] = {
    "sign": _sign, "unit": _unit, "side": _side, "skew": _skew, "jitter": _jitter, "clipping": _clipping,
    "low_pass": _low_pass, "duplicated_rows": _duplicated,
}  # fmt: skip
KINDS = (*_FAULTS, "hold")


def draw(number: int, seed: int) -> Case:
    """The case of a number: kinds and machines in turn, everything else drawn by (seed, number)."""
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    plants = MACHINES()
    plant = plants[(number // len(KINDS)) % len(plants)]
    if kind == "side" and not _geared(plant):
        plant = plants[2 * (number // (len(KINDS) * len(plants)) % 2)]
    rate = 250 if kind == "hold" else int(rng.choice(RATES))
    loops = ("chirp", "multisine") if plant.name == "three-mass axis" else ("chirp", "multisine", "velocity loop")
    experiment = str(rng.choice(loops))
    make = _run(plant, rng, rate, experiment)
    motion = make("held")
    clean = motion.log()
    if kind == "hold":
        detail = str(rng.choice(["linear", "mean"]))
        faulty = make(detail).log()
        channels: tuple[str, ...] = ("torque",)
    else:
        faulty, channels, detail = _FAULTS[kind](motion, clean, plant, rng)
    return Case(number, plant, f"{experiment}, {rate} Hz", kind, channels, detail, faulty, clean)


def _geared(plant: Plant) -> bool:
    chain = plant.nominal.chain
    return abs(chain.gain) > 1 or any(c.ratio != 1 for c in chain.couplings)
