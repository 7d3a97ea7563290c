"""The orders of a polynomial model, with MATLAB's meaning of every number."""

from __future__ import annotations

from dataclasses import dataclass

from mjsim.errors import InputError

__all__ = ["Structure"]

_LISTED = {
    "bj": ("nb", "nc", "nd", "nf"),
    "oe": ("nb", "nf"),
    "arx": ("na", "nb"),
    "armax": ("na", "nb", "nc"),
    "ararx": ("na", "nb", "nd"),
}


@dataclass(frozen=True)
class Structure:
    """Orders of ``A(q) y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t)``.

    ``A = 1 + a1 q^-1 + ... + a_na q^-na`` and likewise C, D, F (all monic). ``B = b1 q^-nk + ... + b_nb q^-(nk+nb-1)``: nb counts
    coefficients and nk = 1 is one sample of delay, as in MATLAB (Ljung, System Identification, 2nd ed., section 4.2).
    """

    na: int = 0
    nb: int = 1
    nc: int = 0
    nd: int = 0
    nf: int = 0
    nk: int = 1

    def __post_init__(self) -> None:
        for name in ("na", "nb", "nc", "nd", "nf", "nk"):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < 0 or value > 200:
                raise InputError(f"order {name}", f"{value!r}", "a whole number from 0 to 200")
        if self.nb < 1:
            raise InputError("order nb", "0", "at least one coefficient in B")

    @classmethod
    def bj(cls, nb: int, nc: int, nd: int, nf: int, nk: int = 1) -> Structure:
        """Box-Jenkins ``y = B/F u + C/D e``; MATLAB ``bj(data, [nb nc nd nf nk])``."""
        return cls(nb=nb, nc=nc, nd=nd, nf=nf, nk=nk)

    @classmethod
    def oe(cls, nb: int, nf: int, nk: int = 1) -> Structure:
        """Output error ``y = B/F u + e``; MATLAB ``oe(data, [nb nf nk])``."""
        return cls(nb=nb, nf=nf, nk=nk)

    @classmethod
    def arx(cls, na: int, nb: int, nk: int = 1) -> Structure:
        """``A y = B u + e``; MATLAB ``arx(data, [na nb nk])``."""
        return cls(na=na, nb=nb, nk=nk)

    @classmethod
    def armax(cls, na: int, nb: int, nc: int, nk: int = 1) -> Structure:
        """``A y = B u + C e``; MATLAB ``armax(data, [na nb nc nk])``."""
        return cls(na=na, nb=nb, nc=nc, nk=nk)

    @classmethod
    def ararx(cls, na: int, nb: int, nd: int, nk: int = 1) -> Structure:
        """``A y = B u + 1/D e``; MATLAB ``polyest(data, [na nb 0 nd 0 nk])``."""
        return cls(na=na, nb=nb, nd=nd, nk=nk)

    @property
    def name(self) -> str:
        """``bj``, ``oe``, ``arx``, ``armax``, ``ararx``, or ``poly`` for any other combination."""
        if self.na == 0:
            return "oe" if self.nc == self.nd == 0 else "bj"
        if self.nf == 0 and not (self.nc and self.nd):
            return "armax" if self.nc else "ararx" if self.nd else "arx"
        return "poly"

    @property
    def listed(self) -> tuple[int, ...]:
        """The orders as MATLAB's command of this name lists them, the delay last."""
        names = _LISTED.get(self.name, ("na", "nb", "nc", "nd", "nf"))
        return (*(getattr(self, n) for n in names), self.nk)

    @classmethod
    def from_listed(cls, name: str, orders: tuple[int, ...] | list[int]) -> Structure:
        """Inverse of ``name`` and ``listed``."""
        names = (*_LISTED.get(name, ("na", "nb", "nc", "nd", "nf")), "nk")
        if len(orders) != len(names):
            raise InputError(f"orders of {name}", f"{len(orders)} numbers", " ".join(names))
        return cls(**{n: int(o) for n, o in zip(names, orders, strict=True)})

    @property
    def n_parameters(self) -> int:
        """Number of free coefficients."""
        return self.na + self.nb + self.nc + self.nd + self.nf

    @property
    def n_plant_state(self) -> int:
        """Coefficients of the polynomial I(q) in ``(B u + I delta)/F`` that carries the plant's initial state."""
        return max(self.na + self.nf, self.nb + self.nk - 1)

    @property
    def n_noise_state(self) -> int:
        """Coefficients of the polynomial K(q) in ``C e = D v + K delta`` that carries the noise filter's initial state."""
        return max(self.nc, self.nd)

    @property
    def reach(self) -> int:
        """Oldest sample that one prediction uses."""
        return max(self.na, self.nb + self.nk - 1, self.nc, self.nd, self.nf)

    def __str__(self) -> str:
        return f"{self.name}[{' '.join(map(str, self.listed))}]"
