"""Friction as a power of the speed: its exponent is found, and at the bounds of a fit it is no finding."""

from __future__ import annotations

import numpy as np
import pytest

from diagnose.options import Options
from diagnose.pipeline import diagnose
from mjsim.axis import Axis, Body, Chain
from mjsim.effects import Scales, effect_class
from mjsim.recording import Recording

LAW = effect_class("sublinear_viscous_friction")
NOMINAL = Axis(Chain((Body("motor", 0.07, 0.05, "hinge"),), ()))
DT, N, SUBSTEPS = 2e-3, 2500, 20


def log(seed, exponent):
    """A rotor with friction .2 |v|^n sign v, by semi-implicit Euler; a law of its own."""
    rng, t = np.random.default_rng(seed), DT * np.arange(N)
    u = 0.8 * sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in (0.3, 1.1, 4.0))
    v, q, h, out = 0.0, 0.0, DT / SUBSTEPS, np.empty((2, N))
    for k in range(N):
        out[:, k] = v, q
        for _ in range(SUBSTEPS):
            v += h * (u[k] - 0.05 * v - 0.2 * np.sign(v) * abs(v) ** exponent) / 0.07
            q += h * v
    velocity, angle = out + [[0.01], [1e-4]] * rng.standard_normal((2, N))
    return Recording(t, u, velocity, angle, DT, source=f"{seed}.csv")


@pytest.mark.parametrize("exponent", [0.2, pytest.param(0.6, marks=pytest.mark.slow)])
def test_the_exponent_is_found(exponent):
    logs = [log(seed, exponent) for seed in (1, 2)]
    result = diagnose(NOMINAL, logs[:1], logs[1:], Options(jobs=1, effects=("coulomb_friction", LAW.id)))
    (found,) = result.findings
    assert found.effect == LAW.id
    assert found.parameters["exponent"].value == pytest.approx(exponent, abs=0.02)
    assert found.parameters["coefficient"].value == pytest.approx(0.2, rel=0.03)


def test_an_exponent_at_a_bound_is_not_shown():
    scales = Scales(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, DT, 1.0)
    (spec,) = (s for s in LAW.specs() if s.name == "exponent")

    def holds(n):
        (r,) = LAW(coefficient=1.0, exponent=n).admissible(scales)
        return r.holds

    assert not holds(spec.lower)
    assert not holds(spec.upper)
    assert holds(1.2 * spec.lower)
    assert holds(0.98 * spec.upper)
    assert all(holds(start["exponent"]) for start in LAW.starts(scales))
