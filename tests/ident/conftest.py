"""Systems of known truth for the estimator's tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.signal import lfilter

from ident import IOData, PolyModel, Structure


@dataclass(frozen=True)
class Truth:
    model: PolyModel

    def record(self, n: int, seed: int, sigma: float = 0.3) -> IOData:
        rng = np.random.default_rng(seed)
        m = self.model
        u = np.where(rng.standard_normal(n) > 0, 1.0, -1.0)
        e = sigma * rng.standard_normal(n)
        f = np.polymul(m.A, m.F)
        y = lfilter(np.r_[np.zeros(m.structure.nk), m.B], f, u) + lfilter(m.C, np.polymul(m.A, m.D), e)
        return IOData(u, y, m.dt)


_A = [1, -1.5, 0.7]
_ONE = [1.0]
TRUTHS = {
    "bj": Truth(PolyModel(Structure.bj(2, 2, 2, 2, 1), 0.1, _ONE, [1, 0.5], [1, -1, 0.2], [1, 1.5, 0.7], _A)),
    "bj_delay": Truth(PolyModel(Structure.bj(1, 1, 1, 2, 3), 0.1, _ONE, [1.0], [1, 0.5], [1, -0.8], _A)),
    "oe": Truth(PolyModel(Structure.oe(2, 2, 1), 0.1, _ONE, [1, 0.5], _ONE, _ONE, _A)),
    "arx": Truth(PolyModel(Structure.arx(2, 2, 1), 0.1, _A, [1, 0.5], _ONE, _ONE, _ONE)),
    "armax": Truth(PolyModel(Structure.armax(2, 2, 2, 1), 0.1, _A, [1, 0.5], [1, -1, 0.2], _ONE, _ONE)),
    "ararx": Truth(PolyModel(Structure.ararx(2, 2, 1, 1), 0.1, _A, [1, 0.5], _ONE, [1, 0.6], _ONE)),
}


@pytest.fixture(params=list(TRUTHS))
def truth(request: pytest.FixtureRequest) -> Truth:
    return TRUTHS[request.param]


@pytest.fixture(scope="session")
def bj_truth() -> Truth:
    return TRUTHS["bj"]
