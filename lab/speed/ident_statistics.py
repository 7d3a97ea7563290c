"""What the estimator promises about itself: coverage of its bands, the Cramer-Rao bound, false alarms, time and memory over N.

    OMP_NUM_THREADS=1 python lab/speed/ident_statistics.py coverage --seeds 400
    OMP_NUM_THREADS=1 python lab/speed/ident_statistics.py bound --seeds 2000
    OMP_NUM_THREADS=1 python lab/speed/ident_statistics.py alarms --seeds 1000
    OMP_NUM_THREADS=1 python lab/speed/ident_statistics.py scaling

coverage: share of (seed, frequency) at which the 95 % magnitude band holds the truth, N = 4000.
bound: variance of each coefficient over seeds against the Cramer-Rao bound at the true coefficients (Gauss-Newton Hessian at the
truth over a record of the same length, mean over 20 records; Gaussian noise, so that the bound is s^2 (J'J)^-1).
alarms: how often the residual tests reject complete models, and the nonlinearity tests linear systems, at 1 and 5 %: each
system with white and coloured noise; detection lines on six periods of a multisine, the amplitude test on two chirps.
scaling: seconds and peak memory per fit from 1e3 to 1e6 samples, five orders each, after warm-up.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np
from ident_systems import SYSTEMS, System
from scipy.signal import lfilter

from ident import IOData, amplitude_test, bj, bode, detection_lines, odd_multisine, residual_tests
from ident.search import factor, residual


def coverage(systems: list[System], seeds: int, n: int) -> None:
    print(f"{'system':8s} {'band holds the truth':>21s} {'worst frequency':>16s} {'best':>7s} {'phase band':>11s}")
    for s in systems:
        f = np.geomspace(0.01, 0.95, 40) * 0.5 / s.dt
        truth = s.response(2 * np.pi * f * s.dt)
        inside, phase = [], []
        for seed in range(seeds):
            u, y, _ = s.record(10_000 + seed, n)
            b = bode(bj(IOData(u, y, s.dt), s.orders).model, f)
            low, high = b.magnitude_db_interval()
            db = 20 * np.log10(np.abs(truth))
            inside.append((low <= db) & (db <= high))
            off = np.degrees(np.angle(truth / b.response))
            phase.append(np.abs(off) <= 1.959964 * b.phase_std_deg)
        rate = np.mean(inside, axis=0)
        print(
            f"{s.name:8s} {100 * rate.mean():19.2f} % {100 * rate.min():14.1f} % "
            f"{100 * rate.max():5.1f} % {100 * np.mean(phase):9.2f} %"
        )


def hessian(s: System, seed: int, n: int) -> np.ndarray:
    u, y, _ = s.record(seed, n)
    sizes = np.array([0, *s.orders[:4], 0, 0])
    theta = np.r_[s.B, s.C[1:], s.D[1:], s.F[1:]]
    w, v, e, pulse = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    residual(theta, sizes, s.orders[4], u, y, w, v, e, np.full(7, 1 - 1e-9))
    r = factor(theta, sizes, s.orders[4], u, y, w, v, e, np.zeros((8, n)), pulse)[:-1, :-1]
    return r.T @ r


def bound(systems: list[System], seeds: int, n: int) -> None:
    print(
        f"{'system':8s} {'seeds':>6s} {'variance / bound: mean':>22s} "
        f"{'smallest':>9s} {'largest':>8s} {'own estimate / bound':>21s}"
    )
    for s in systems:
        information = np.mean([hessian(s, 50_000 + i, n) for i in range(20)], axis=0)
        sigma = s.record(0, n)[2]
        scale = np.sqrt(np.diag(information))
        limit = sigma**2 * np.diag(np.linalg.inv(information / np.outer(scale, scale))) / scale**2
        thetas, own = [], []
        for seed in range(seeds):
            u, y, _ = s.record(20_000 + seed, n)
            m = bj(IOData(u, y, s.dt), s.orders).model
            thetas.append(m.theta)
            own.append(np.diag(m.covariance))
        truth = np.r_[s.B, s.C[1:], s.D[1:], s.F[1:]]
        ratio = np.mean((np.array(thetas) - truth) ** 2, axis=0) / limit
        print(
            f"{s.name:8s} {seeds:6d} {ratio.mean():22.3f} {ratio.min():9.3f} {ratio.max():8.3f} "
            f"{np.median(np.mean(own, axis=0) / limit):21.3f}   (sampling error of one ratio: {np.sqrt(2 / seeds):.3f})"
        )


COLOURS = {"white": ([1], [1]), "slow": ([1], [1, -0.9]), "peaked": ([1], [1, -1.8 * np.cos(0.9), 0.81])}
LEVELS = (0.01, 0.05)


def alarms(systems: list[System], seeds: int, n: int) -> None:
    def show(name: str, what: str, p: list[float]) -> None:
        rates = "".join(f"{100 * np.mean(np.array(p) < level):9.2f} %" for level in LEVELS)
        print(f"{name:8s} {what:34s} {len(p):6d}{rates}", flush=True)

    print(f"{'system':8s} {'test':34s} {'runs':>6s}" + "".join(f"{f'at {100 * x:g} %':>11s}" for x in LEVELS))
    for s in systems:
        white, independent = [], []
        for seed in range(seeds):
            u, y, _ = s.record(30_000 + seed, n)
            tests = residual_tests(bj(IOData(u, y, s.dt), s.orders))
            white.append(tests.whiteness_p)
            independent.append(tests.independence_p)
        show(s.name, "whiteness of the residuals", white)
        show(s.name, "independence of the input", independent)
        for colour, (num, den) in COLOURS.items():
            lines, levels = [], []
            for seed in range(seeds):
                rng = np.random.default_rng(40_000 + seed)

                def noisy(u: np.ndarray, rng: np.random.Generator = rng) -> IOData:
                    y = lfilter(np.r_[0.0, s.B], s.F, u)  # noqa: B023
                    v = lfilter(num, den, rng.standard_normal(u.size))  # noqa: B023
                    return IOData(u, y + 0.1 * np.std(y) * v / np.std(v), s.dt)  # noqa: B023

                m = odd_multisine(1000, s.dt, (0.0025 / s.dt, 0.2 / s.dt), 1.0, rng)
                lines.append(detection_lines(noisy(m.repeated(7)), m).p_value)
                chirp = np.sin(np.pi * np.arange(n) ** 2 * 0.15 / n)
                levels.append(amplitude_test(noisy(0.5 * chirp), noisy(2.0 * chirp)).p_value)
            show(s.name, f"detection lines, {colour} noise", lines)
            show(s.name, f"amplitude test, {colour} noise", levels)


def scaling() -> None:
    s = SYSTEMS["axis"]
    bj(IOData(*s.record(0, 1000)[:2], s.dt), s.orders)
    print(f"{'N':>9s} {'seconds':>9s} {'us per sample':>14s} {'peak memory MB':>15s} {'starts':>7s} {'iterations':>11s}")
    for n in (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000):
        u, y, _ = s.record(1, n)
        data = IOData(u, y, s.dt)
        began = time.process_time()
        estimate = bj(data, s.orders)
        seconds = time.process_time() - began
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{n:9d} {seconds:9.3f} {1e6 * seconds / n:14.2f} {peak:15.0f} {len(estimate.starts):7d} "
            f"{sum(x.iterations for x in estimate.starts):11d}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["coverage", "bound", "alarms", "scaling"])
    parser.add_argument("--seeds", type=int, default=400)
    parser.add_argument("--samples", type=int, default=4000)
    parser.add_argument("--systems", nargs="+", default=list(SYSTEMS), choices=list(SYSTEMS))
    args = parser.parse_args()
    systems = [SYSTEMS[name] for name in args.systems]
    if args.what == "scaling":
        scaling()
    else:
        {"coverage": coverage, "bound": bound, "alarms": alarms}[args.what](systems, args.seeds, args.samples)


if __name__ == "__main__":
    main()
