"""Numbers as a reader wants them: four significant digits or as many as the interval supports, and units in print."""

from __future__ import annotations

import math
import re

from diagnose.result import Estimate

__all__ = ["estimate", "interval", "number", "p_value", "percent", "power", "prose", "unit"]

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_THIN = "\N{NARROW NO-BREAK SPACE}"
_TIMES = "\N{MULTIPLICATION SIGN}"
_MINUS = "\N{MINUS SIGN}"


def number(x: float | None, digits: int = 4) -> str:
    """``digits`` significant digits; powers of ten in print outside 0.001 .. 99999; a dash when there is no number."""
    if x is None or math.isnan(x):
        return "–"
    if math.isinf(x):
        return "∞" if x > 0 else f"{_MINUS}∞"
    if x == 0:
        return "0"
    exponent = _exponent(x, digits)
    return _print(x, exponent, digits - 1 - exponent)


def _exponent(x: float, digits: int) -> int:
    """Power of ten of x once it is rounded."""
    return int(f"{x:.{max(digits, 1) - 1}e}".split("e")[1])


def _print(x: float, exponent: int, decimals: int) -> str:
    """x rounded to ``decimals`` places, written by the power of ten ``exponent`` where plain digits would be many."""
    if -4 < exponent < 5:
        rounded = round(x, decimals)
        text = f"{rounded:,.{max(decimals, 0)}f}".replace(",", _THIN)
    else:
        mantissa = f"{x / 10.0**exponent:.{max(decimals + exponent, 0)}f}"
        text = f"{mantissa}{_THIN}{_TIMES}{_THIN}10{str(exponent).translate(_RAISED)}"
    text = text.replace("-", _MINUS)
    return text.removeprefix(_MINUS) if not re.search("[1-9]", text) else text


def _decimals(e: Estimate) -> tuple[int, int]:
    """(power of ten, decimal places) in which a value and its interval are written: two digits of the half-width."""
    low, high = e.ci95
    top = max(abs(v) for v in (e.value, low, high) if math.isfinite(v)) if math.isfinite(e.value) else 0.0
    if top == 0:
        return 0, 3
    exponent = _exponent(top, 4)
    half = (high - low) / 2
    if not (math.isfinite(half) and half > 0):
        return exponent, 3 - exponent
    # not more than seven digits, not fewer than three
    return exponent, min(max(1 - _exponent(half, 2), 2 - exponent), 6 - exponent)


def estimate(e: Estimate) -> str:
    """The value alone, with the digits that its interval supports."""
    if not math.isfinite(e.value):
        return number(e.value)
    return _print(e.value, *_decimals(e))


def interval(e: Estimate) -> str:
    """``low … high``, with the digits of the value; said where the value is at a bound."""
    if not all(map(math.isfinite, e.ci95)):
        return "not determined"
    low, high = (_print(v, *_decimals(e)) for v in e.ci95)
    return f"{low} … {high}" + (", at a bound" if e.at_bound else "")


def percent(share: float | None, digits: int = 2) -> str:
    """A share in per cent; near one, by what is missing: 99.97 %."""
    if share is None or not math.isfinite(share):
        return "–"
    x = 100 * share
    if 90 <= x < 100:
        return f"{_floor(x, 2 if x >= 99 else max(digits - 2, 0))}{_THIN}%"
    return f"{number(x, digits)}{_THIN}%" if abs(x) >= 0.01 or x == 0 else f"< 0.01{_THIN}%"


def _floor(x: float, decimals: int) -> str:
    """x < 100 cut, never rounded up to 100."""
    scale = 10**decimals
    return f"{math.floor(x * scale) / scale:.{decimals}f}"


def p_value(p: float | None) -> str:
    """A probability; below 1e-12 only its bound, since no model of noise holds that far out."""
    if p is None or not math.isfinite(p):
        return "–"
    if p < 1e-12:
        return f"< 10{'-12'.translate(_RAISED)}"
    return number(p, 2)


def power(exponent: float) -> str:
    """10 to an integer power, for the ticks of a logarithmic axis: ``10⁻³``, plain from 0.1 to 1000."""
    k = round(exponent)
    return f"{10.0**k:g}" if -1 <= k <= 3 else f"10{str(k).translate(_RAISED)}"


def prose(text: str) -> str:
    """A sentence with its units and minus signs in print; a number does not part from its unit."""
    powers = re.sub(r"(?<![\w.])(\d+(?:\.\d+)?)e([+-])0*(\d+)\b", _written, text)
    raised = re.sub(r"(?<=[\w)])\^(-?\d+)", lambda m: m[1].translate(_RAISED), powers)
    dotted = re.sub(r"(?<!\w)(N|kg) (?=[ms](?:\b|[²³])|\()", r"\1·", raised)
    dotted = re.sub(r"(?<=·m) s(?=[²/ ,.;:)]|$)", "·s", dotted)
    pointed = dotted.replace(" -> ", "\N{NO-BREAK SPACE}\N{RIGHTWARDS ARROW} ")
    signed = re.sub(r"(?<![\w-])-(?=\d)", _MINUS, pointed)
    return re.sub(r"(?<=\d) (?=(?:N|rad|m|mm|s|ms|Hz|kg|%)(?:\b|[²³/·]|$)|%)", "\N{NO-BREAK SPACE}", signed)


def _written(m: re.Match[str]) -> str:
    """``8.998e+10`` in print."""
    return f"{m[1]}{_THIN}{_TIMES}{_THIN}10{(m[2].strip('+') + m[3]).translate(_RAISED)}"


def unit(text: str) -> str:
    """``N m s^2/rad^2`` -> ``N·m·s²/rad²``; the unit 1 is not written."""
    if text in ("", "1"):
        return ""
    text = re.sub(r"\bNm\b", "N m", text)
    raised = re.sub(r"\^(-?\d+)", lambda m: m[1].translate(_RAISED), text)
    return re.sub(r"(?<=[\w²³)]) (?=[\w(])", "·", raised)
