"""Box-Jenkins against pysib 0.2.5 and sippy_unipi 1.0.1: same data, same run.

    pip install -e '.[bench]'        (in a virtual environment of its own)
    OMP_NUM_THREADS=1 python lab/speed/ident_vs_rivals.py --seeds 200 --out out/ident_vs_rivals.jsonl

Each fit is a line of the output file; a second run takes up where the first stopped. ``--summary`` prints the table only, over
the seeds that every method has done.

Error: rms over 200 frequencies of |G_hat / G - 1|. Wrong minimum: the loss of the returned model (from rest) exceeds the loss
that a search from the true coefficients reaches so far that N log(V / V_ref) > 10. Seconds are processor time, so that other work
on the machine does not count. SIPPY counts the delay as nk - 1. ``ident_statistics.py`` has the other bars.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from ident_systems import SYSTEMS, System
from scipy.signal import lfilter

N = 4000
W = np.linspace(0.01, np.pi * 0.99, 200)
Model = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # B from q^-1, C, D, F


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silence prints of compiled code too."""
    sys.stdout.flush()
    saved, null = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    try:
        with open(os.devnull, "w") as sink, contextlib.redirect_stdout(sink):
            yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(null)


def ours(s: System, u: np.ndarray, y: np.ndarray) -> Model:
    from ident.data import IOData
    from ident.estimate import bj

    m = bj(IOData(u, y, s.dt), s.orders).model
    return m.B, m.C, m.D, m.F


def pysib_bj(s: System, u: np.ndarray, y: np.ndarray) -> Model:
    import pysib

    m = pysib.bj(u, y, *s.orders)[1]
    return m["B"][1:], m["C"], m["D"], m["F"]


def sippy_bj(s: System, u: np.ndarray, y: np.ndarray) -> Model:
    from sippy_unipi import system_identification

    m = system_identification(y, u, "BJ", BJ_orders=[*s.orders[:4], s.orders[4] - 1], max_iterations=300)
    g, h = m.G, m.H
    num, den = np.asarray(g.num[0][0]), np.asarray(g.den[0][0])
    hn, hd = np.asarray(h.num[0][0]), np.asarray(h.den[0][0])
    b = np.r_[np.zeros(den.size - num.size), num][1:]
    return b / den[0], hn / hn[0], hd / hd[0], den / den[0]


METHODS: dict[str, Callable[[System, np.ndarray, np.ndarray], Model]] = {"ident": ours, "pysib": pysib_bj, "sippy": sippy_bj}


def loss(m: Model, u: np.ndarray, y: np.ndarray) -> float:
    b, c, d, f = m
    with np.errstate(all="ignore"):
        value = float(np.mean(lfilter(d, c, y - lfilter(np.r_[0.0, b], f, u)) ** 2))
    return value if np.isfinite(value) else float("inf")


def reference_loss(s: System, u: np.ndarray, y: np.ndarray) -> float:
    from ident.search import search

    theta = np.r_[s.B, s.C[1:], s.D[1:], s.F[1:]]
    n = np.array([0, *s.orders[:4], 0, 0])
    return search(theta, n, s.orders[4], u, y, np.ones(theta.size, np.int64), 200, 1e-10, False, np.full(7, 1 - 1e-7))[1] / y.size


def run(out: Path, seeds: int, names: list[str], methods: list[str]) -> None:
    done = {(r["system"], r["seed"], r["method"]) for r in read(out)}
    out.parent.mkdir(parents=True, exist_ok=True)
    for name in names:
        s = SYSTEMS[name]
        truth = s.response(W)
        for method in methods:  # compile and import outside the clock
            with quiet(), contextlib.suppress(Exception):
                METHODS[method](s, *s.record(0, 400)[:2])
        for seed in range(seeds):
            todo = [m for m in methods if (name, seed, m) not in done]
            if not todo:
                continue
            u, y, _ = s.record(seed, N)
            reference = reference_loss(s, u, y)
            for method in todo:
                began = time.process_time()
                row: dict[str, object] = {"system": name, "seed": seed, "method": method}
                try:
                    with quiet():
                        m = METHODS[method](s, u, y)
                    row["seconds"] = time.process_time() - began
                    b, _, _, f = m
                    z = np.exp(-1j * W)
                    g = z * np.polyval(b[::-1], z) / np.polyval(f[::-1], z)
                    row["error"] = float(np.sqrt(np.mean(np.abs(g / truth - 1) ** 2)))
                    row["excess"] = float(N * np.log(loss(m, u, y) / reference))
                except Exception as error:
                    row |= {
                        "seconds": time.process_time() - began,
                        "error": float("inf"),
                        "excess": float("inf"),
                        "failed": str(error)[:200],
                    }
                with out.open("a") as file:
                    file.write(json.dumps(row) + "\n")


def read(out: Path) -> list[dict]:
    return [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []


def summary(out: Path) -> None:
    rows = read(out)
    print(
        f"{'system':8s} {'method':6s} {'seeds':>5s} {'median error':>13s} {'max error':>11s} {'wrong minima':>12s} "
        f"{'median s':>9s} {'max s':>8s}"
    )
    for name in dict.fromkeys(r["system"] for r in rows):
        here = [r for r in rows if r["system"] == name]
        common = set.intersection(*({r["seed"] for r in here if r["method"] == m} for m in {r["method"] for r in here}))
        for method in METHODS:
            of = [r for r in here if r["method"] == method and r["seed"] in common]
            if not of:
                continue
            error, excess, seconds = (np.array([r[k] for r in of], float) for k in ("error", "excess", "seconds"))
            wrong = int(np.sum(~(excess <= 10)))
            print(
                f"{name:8s} {method:6s} {len(of):5d} {np.median(error):13.6f} {error.max():11.6f} {wrong:12d} "
                f"{np.median(seconds):9.4f} {seconds.max():8.3f}"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--systems", nargs="+", default=list(SYSTEMS), choices=list(SYSTEMS))
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=list(METHODS))
    parser.add_argument("--out", type=Path, default=Path("out/ident_vs_rivals.jsonl"))
    parser.add_argument("--summary", action="store_true")
    args = parser.parse_args()
    if not args.summary:
        run(args.out, args.seeds, args.systems, args.methods)
    summary(args.out)


if __name__ == "__main__":
    main()
