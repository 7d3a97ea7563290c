"""Order selection: every structure of a grid fitted and scored."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ident.data import IOData
from ident.estimate import Estimate, pem
from ident.options import Options
from ident.predict import simulated
from ident.quality import fit_percent, information
from ident.structure import Structure
from mjsim.errors import InputError

__all__ = ["OrderChoice", "OrderSelection", "select_order"]


@dataclass(frozen=True)
class OrderChoice:
    """One structure of the grid with its scores; validation_percent is the simulation fit on the held-out data, or None."""

    structure: Structure
    loss: float
    fpe: float
    aic: float
    bic: float
    validation_percent: float | None
    estimate: Estimate


@dataclass(frozen=True)
class OrderSelection:
    """All choices, in the order given."""

    choices: tuple[OrderChoice, ...]

    @property
    def best(self) -> OrderChoice:
        """The one with the smallest BIC (consistent: it finds the true order as N grows)."""
        return min(self.choices, key=lambda c: c.bic)

    @property
    def best_aic(self) -> OrderChoice:
        """The one with the smallest AIC (best prediction; tends to larger orders)."""
        return min(self.choices, key=lambda c: c.aic)

    @property
    def best_validation(self) -> OrderChoice:
        """The one with the best simulation fit on the held-out data."""
        scored = [c for c in self.choices if c.validation_percent is not None]
        if not scored:
            raise InputError("order selection", "no held-out data", "a validation record")
        return max(scored, key=lambda c: c.validation_percent or 0.0)


def select_order(
    data: IOData, structures: Iterable[Structure], options: Options | None = None, validation: IOData | None = None
) -> OrderSelection:
    """Fit each structure and score it by FPE, AIC, BIC and, with ``validation``, its simulation fit there (MATLAB ``selstruc``).

    A structure that the data cannot carry is left out; InputError when none is left.
    """
    choices = []
    last: InputError | None = None
    for structure in structures:
        try:
            estimate = pem(data, structure, options)
        except InputError as error:
            last = error
            continue
        fpe, aic, bic, _ = information(estimate.loss, len(data), structure.n_parameters)
        fit = None if validation is None else fit_percent(validation.y, simulated(estimate.model, validation))
        choices.append(OrderChoice(structure, estimate.loss, float(fpe), float(aic), float(bic), fit, estimate))
    if not choices:
        raise last or InputError("order selection", "an empty grid", "at least one structure")
    return OrderSelection(tuple(choices))
