"""How a log becomes a model: the report's way, a better one, and the steps between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from ident import Estimate, IOData

__all__ = ["BETTER", "FAITHFUL", "LADDER", "Pipeline"]


@dataclass(frozen=True)
class Pipeline:
    """Decimation, low-pass (order 8 at 0.4 of the new Nyquist frequency, or none), orders, focus and length of the search.

    ``iterations``, ``tolerance``, ``starts``, ``noise_radius``: see `ident.SearchOptions`; None means its defaults.
    """

    name: str
    decimate: int = 10
    low_pass: bool = True
    orders: tuple[int, int, int, int, int] = (5, 5, 5, 5, 1)
    simulation_focus: bool = False
    long_search: bool = False

    def prepare(self, torque: np.ndarray, velocity: np.ndarray, dt: float, source: str) -> IOData:
        """Both channels through the shared filter."""
        from ident import Decimation, IOData, shared_filter

        raw = IOData(torque, velocity, dt, "torque", "velocity", "Nm", "rad/s", source)
        return shared_filter(raw, Decimation(self.decimate), filtered=self.low_pass)

    def fit(self, data: IOData) -> Estimate:
        """The Box-Jenkins model. Raises InputError for data that cannot carry it."""
        from ident import Focus, Options, SearchOptions, bj

        # MATLAB's documented defaults: 20 iterations, tolerance 0.01 %, one start, the noise model limited only by stability
        short = SearchOptions(max_iterations=20, tolerance=1e-4, starts=1, noise_radius=1.0)
        focus = Focus.SIMULATION if self.simulation_focus else Focus.PREDICTION
        return bj(data, self.orders, Options(focus=focus, search=SearchOptions() if self.long_search else short))


FAITHFUL = Pipeline("report")
"""2000 Hz / 10, low-pass order 8 at 40 Hz, [5 5 5 5 1], the search with MATLAB's defaults."""

BETTER = Pipeline("better", 5, False, (7, 5, 5, 6, 0), True, True)
"""2000 Hz / 5, no low-pass, a direct term (decimated signals are band-limited, not held), one order more, simulation focus."""

LADDER: tuple[tuple[str, Pipeline, float], ...] = (
    ("as published", FAITHFUL, 30.0),
    ("+ longer search, several starts", replace(FAITHFUL, name="search", long_search=True), 30.0),
    ("+ direct term [6 5 5 5 0]", replace(FAITHFUL, name="direct", orders=(6, 5, 5, 5, 0), long_search=True), 30.0),
    (
        "+ 400 Hz, no low-pass, simulation focus",
        Pipeline("rate", 5, False, (6, 5, 5, 5, 0), True, True),
        30.0,
    ),
    ("+ one order more [7 5 5 6 0]", BETTER, 30.0),
    ("+ chirp to 45 Hz", BETTER, 45.0),
)
"""(what is changed, pipeline, upper edge of the chirp [Hz]): from the report's way to the better one, a step at a time."""
