"""A sparse-regression residual model (SINDy, by pysindy): a torque on the motor, added to the refitted nominal model.

    torque = sum of c_i f_i(v, q, u)        v: motor velocity, q: motor angle, u: commanded torque

The residual of the refitted model is regressed on what each term, taken on the measured motion, would do to the velocity
through that model: the weak form, in which nothing noisy is differentiated. Sequentially thresholded least squares picks the
terms, on the first 70 % of the estimation recording; the threshold is the one whose free run is best on the rest. Terms are
kept only when that run beats the one without any by more than the standard error of the difference (by blocks): the usual guard
against fitting noise. The model found then runs free on the held-out recording, its angle terms tied to the measured angle as
in the diagnosis. Beyond the speeds of the estimation recording the terms keep their value, since a cubic that is extrapolated
lets most models diverge.

S. L. Brunton, J. L. Proctor, J. N. Kutz, PNAS 113 (2016) 3932; weak form: D. A. Messenger, D. M. Bortz, J. Comput. Phys. 443
(2021).
"""

from __future__ import annotations

import math
import warnings

import numpy as np
from numba import njit

from lab.benchmark.arms.base import Answer, Arm, Task
from lab.benchmark.arms.nominal import fitting, refitted
from mjsim.axis import Axis, Chain
from mjsim.errors import InputError
from mjsim.recording import Recording
from mjsim.system import assemble, state_matrix

__all__ = ["ARM", "TERMS", "fit", "free_run", "responses"]

ORDERS = 8  # sines and cosines of the motor angle, one to so many a turn
TERMS = (
    "1", "v", "v |v|", "v^3", "tanh(v / v0)", "|v|", "u", "u |u|", "u^3", "u v", "u tanh(v / v0)", "|u| tanh(v / v0)",
    *(f"{f}({n} q)" for n in range(1, ORDERS + 1) for f in ("sin", "cos")),
)  # fmt: skip
SLOW = 0.5  # v0 [rad/s]: a sign that can be integrated, and that noise does not flip
THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.4)  # of the norm of the residual, for columns of norm one
RIDGE = 1e-3  # for columns of norm one
PERIODS = 1.5  # over the travel: what repeats less often is not offered
TRAINED = 0.7  # share of the estimation recording
SUBSTEPS = 8  # of a row, over which the torque found is held
BLOCKS = 10  # of the validation part


@njit(cache=True)
def _terms(v: float, q: float, u: float, out: np.ndarray) -> None:
    """The values of `TERMS` at one instant."""
    s = math.tanh(v / SLOW)
    out[0] = 1.0
    out[1] = v
    out[2] = v * abs(v)
    out[3] = v * v * v
    out[4] = s
    out[5] = abs(v)
    out[6] = u
    out[7] = u * abs(u)
    out[8] = u * u * u
    out[9] = u * v
    out[10] = u * s
    out[11] = abs(u) * s
    for n in range(ORDERS):
        out[12 + 2 * n] = math.sin((n + 1) * q)
        out[13 + 2 * n] = math.cos((n + 1) * q)


@njit(cache=True)
def _run(
    A: np.ndarray, B: np.ndarray, at: int, u: np.ndarray, q: np.ndarray, c: np.ndarray, gain: float, substeps: int, most: float,
    out: np.ndarray
) -> bool:  # fmt: skip
    """Velocity of body 0, ``x' = A x + B torque`` exact for a torque held over each substep; False if it diverges."""
    n = A.shape[0]
    x, y, f = np.zeros(n), np.zeros(n), np.empty(c.size)
    for k in range(u.size):
        out[k] = x[at]
        for j in range(substeps):
            torque = gain * u[k]
            angle = q[k] + (q[min(k + 1, u.size - 1)] - q[k]) * j / substeps
            _terms(min(max(x[at], -most), most), angle, u[k], f)
            for i in range(c.size):
                torque += c[i] * f[i]
            for i in range(n):
                y[i] = B[i] * torque
                for m in range(n):
                    y[i] += A[i, m] * x[m]
            x[:] = y
        if not abs(x[at]) < 1e6:
            return False
    return True


@njit(cache=True)
def _features(v: np.ndarray, q: np.ndarray, u: np.ndarray, out: np.ndarray) -> None:
    for k in range(v.size):
        _terms(v[k], q[k], u[k], out[k])


def _stepped(chain: Chain, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Exact step over ``dt`` with the torque held."""
    from scipy.linalg import expm

    system = assemble(Axis(chain))
    n = 2 * system.n
    A, B = state_matrix(system.f), np.zeros(n)
    B[system.n] = 1.0 / chain.bodies[0].inertia
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = A * dt, B * dt
    E = expm(block)
    return np.ascontiguousarray(E[:n, :n]), np.ascontiguousarray(E[:n, n])


def _angle(recording: Recording) -> np.ndarray:
    if recording.angle is None or recording.velocity is None:
        raise InputError(recording.source, "velocity or angle is missing", "both channels")
    return recording.angle


def free_run(chain: Chain, recording: Recording, coefficients: np.ndarray, most: float = math.inf) -> np.ndarray | None:
    """Motor velocity [rad/s] of the chain with the torque found, from rest; None when it diverges.

    ``most``: speed [rad/s] beyond which the terms keep their value.
    """
    A, B = _stepped(chain, recording.dt / SUBSTEPS)
    out = np.empty(len(recording))
    q = np.array(_angle(recording))
    fine = _run(A, B, len(chain.bodies), np.array(recording.torque), q, coefficients, chain.gain, SUBSTEPS, most, out)
    return out if fine else None


def responses(chain: Chain, recording: Recording) -> np.ndarray:
    """(N, terms): velocity that each term, as a torque on the motor over the measured motion, makes through the chain."""
    from scipy.signal import dlsim

    q = _angle(recording)
    assert recording.velocity is not None
    F = np.empty((len(recording), len(TERMS)))
    _features(np.array(recording.velocity), np.array(q), np.array(recording.torque), F)
    A, B = _stepped(chain, recording.dt)
    C = np.zeros((1, len(B)))
    C[0, len(chain.bodies)] = 1.0
    columns = [dlsim((A, B[:, None], C, np.zeros((1, 1)), recording.dt), F[:, i])[1][:, 0] for i in range(F.shape[1])]
    return np.stack(columns, axis=1)


def _sparse(Y: np.ndarray, e: np.ndarray, dt: float, threshold: float) -> np.ndarray:
    """Coefficients by sequentially thresholded least squares."""
    import pysindy

    norms = np.linalg.norm(Y, axis=0)
    # without "unbias", which would solve once more without the ridge: terms that resemble each other then take huge numbers
    optimizer = pysindy.STLSQ(threshold=threshold * float(np.linalg.norm(e)), alpha=RIDGE, unbias=False)
    model = pysindy.SINDy(optimizer=optimizer, feature_library=pysindy.IdentityLibrary())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a threshold leaves no term is an answer
        model.fit(Y / norms, t=dt, x_dot=e[:, None])
    coefficients: np.ndarray = np.array(model.coefficients(), float).ravel() / norms
    return coefficients


def _offered(travel: float) -> np.ndarray:
    """Mask of the terms: of those over the angle the ones that repeat within the travel [rad]."""
    out = np.ones(len(TERMS), bool)
    for n in range(1, ORDERS + 1):
        out[len(TERMS) - 2 * (ORDERS - n + 1) :][:2] = n * travel >= 2 * math.pi * PERIODS
    return out


def _blocks(e: np.ndarray) -> np.ndarray:
    """Mean squares of the blocks of an error."""
    return np.array([np.mean(part**2) for part in np.array_split(e, BLOCKS)])


def fit(task: Task) -> Answer:
    """Regress, choose the threshold, run free."""
    with fitting(task) as fitter:
        base = refitted(fitter)
        chain = base.fitted.axis.chain
    e = task.estimation
    assert e.velocity is not None
    Y, left = responses(chain, e), e.velocity - base.on_estimation
    most = float(np.max(np.abs(e.velocity)))
    offered = _offered(float(np.ptp(_angle(e))))
    split = round(TRAINED * len(e))
    without = _blocks(left[split:])
    best, least = np.zeros(len(TERMS)), math.inf
    for threshold in THRESHOLDS:
        c = np.zeros(len(TERMS))
        c[offered] = _sparse(Y[:split, offered], left[:split], e.dt, threshold)
        run = free_run(chain, e, c, most) if np.any(c) else None
        if run is None:
            continue
        errors = _blocks((e.velocity - run)[split:])
        gain = without - errors
        if np.mean(gain) > np.std(gain, ddof=1) / math.sqrt(BLOCKS) and np.mean(errors) < least:
            best, least = c, float(np.mean(errors))
    named = tuple(t for t, c in zip(TERMS, best, strict=True) if c != 0.0)
    note = ", ".join(f"{c:.3g} {t}" for t, c in zip(TERMS, best, strict=True) if c != 0.0) or "no term"
    if not named:
        return Answer(base.held_out_rms, base.held_out_rms, named=(), note=note)
    h = task.held_out
    run = free_run(chain, h, best, most)
    if run is None or h.velocity is None:
        raise InputError(h.source, "the identified model diverges on it", "a stable model")
    return Answer(float(np.sqrt(np.mean((h.velocity - run) ** 2))), base.held_out_rms, named=named, note=note)


ARM = Arm("sparse", "Sparse regression of the residual (pysindy)", fit, names="terms", needs=("pysindy",))
