"""A diagnosis in plain sentences: verdicts, names, shares."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from diagnose.report.figures import number, percent, unit
from diagnose.result import Diagnosis, Mismatch, Share, Verdict

__all__ = ["VERDICTS", "VerdictWords", "effect_name", "formula", "linear_name", "placed", "structure_name", "where"]

_SMALL = 0.05


@dataclass(frozen=True)
class VerdictWords:
    """How a verdict is written: badge, colour class, one sentence of meaning."""

    badge: str
    colour: str
    meaning: str


VERDICTS = {
    Verdict.NO_MISMATCH: VerdictWords(
        "No mismatch", "good", "The nominal model, as given, explains the recordings down to their noise."
    ),
    Verdict.PARAMETERS_ONLY: VerdictWords(
        "Parameters only", "info", "The physics of the nominal model suffices; its numbers were off and have been fitted anew."
    ),
    Verdict.MISSING_PHYSICS: VerdictWords(
        "Missing physics",
        "warn",
        "No choice of the nominal model's numbers explains the recordings; the physics below was left out.",
    ),
    Verdict.UNEXPLAINED: VerdictWords(
        "Unexplained", "alarm", "Simulation and recording differ by something that is none of the known effects."
    ),
}


def effect_name(identifier: str) -> str:
    """``coulomb_friction`` -> ``Coulomb friction``."""
    words = identifier.replace("_", " ")
    for proper in ("coulomb", "stribeck"):
        words = words.replace(proper, proper.capitalize())
    return words[:1].upper() + words[1:]


def structure_name(keys: Sequence[str]) -> str:
    """A set of ``effect@place`` in words."""
    if not keys:
        return "nominal model refitted, nothing added"
    parts = [key.partition("@") for key in keys]
    return " + ".join(f"{effect_name(e)} ({p})" if p else effect_name(e) for e, _, p in parts)


_LETTERS = {"J": "inertia", "f": "viscous friction", "k": "stiffness", "d": "damping"}
_PLACES = {"m": "motor", "g": "gearbox", "a": "arm"}


def formula(text: str) -> str:
    """A law in plain letters as HTML: Greek names, powers, indices, primes and relations in print."""
    out = (
        text.replace("&", "&amp;")
        .replace("<=", "≤")
        .replace(">=", "≥")
        .replace("->", "→")
        .replace("-+", "∓")
        .replace(" * ", " · ")
    )
    out = out.replace("<", "&lt;").replace(">", "&gt;").replace("''", "″").replace("'", "′")
    out = re.sub(r"(?<![\w-])-(?=[\w(])|(?<= )-(?= )", "\N{MINUS SIGN}", out)
    # an apostrophe inside a word is no derivative
    out = re.sub(r"(?<=[a-z]{2})′s\b", "’s", out)
    for name, letter in (("tau", "τ"), ("phi", "φ"), ("alpha", "α"), ("beta", "β")):
        out = re.sub(rf"\b{name}(?=_|\b)", letter, out)
    out = re.sub(r"\^(\d+|\w)", r"<sup>\1</sup>", out)
    return re.sub(r"(?<=\w)_(\w+)", r"<sub>\1</sub>", out)


def linear_name(name: str, unit_text: str) -> str:
    """``Jm`` -> ``inertia, motor``; the name itself when it is of another kind."""
    kind, place = _LETTERS.get(name[:1]), name[1:].lstrip("_")
    if kind is None or not place:
        return name
    return f"{'mass' if unit_text == 'kg' else kind}, {_PLACES.get(place, place)}"


def placed(d: Diagnosis) -> bool:
    """Whether there is a mismatch to place: not when the refitted nominal model leaves noise only."""
    return d.mismatch.above_noise >= _SMALL or d.verdict not in (Verdict.NO_MISMATCH, Verdict.PARAMETERS_ONLY)


def where(d: Diagnosis, other: Mismatch | None = None) -> list[str]:
    """The place of the mismatch in a few sentences: how much, when, at which frequencies, by which state, at which place.

    ``other``: on that recording instead of the first one.
    """
    m = d.mismatch if other is None else other
    known = math.isfinite(d.noise_floor)
    if not placed(d):
        left = f"{percent(m.above_noise)} of its squared error above" if m.above_noise > 0 else "nothing above"
        return [f"With its numbers fitted anew, the nominal model leaves {left} the noise: there is nothing to place."]
    linear = "."
    if math.isfinite(m.linear_share):  # there is an input
        linear = f"; {percent(m.linear_share)} of that follows the input linearly, the rest is nonlinear or a disturbance."
    if known:
        out = [f"Of the refitted nominal model's squared error, {percent(m.above_noise)} is more than noise{linear}"]
    else:
        whole = "The noise of this channel is not known beforehand: all of the refitted nominal model's error is placed"
        out = [f"{whole}{linear}"]
    if m.time:
        out.append("In time: " + _listed(_merged(m.time), "s") + ".")
    else:
        out.append("In time it is spread evenly: no stretch holds much more than its part.")
    if m.frequency:
        out.append("In frequency: " + _listed(m.frequency, "Hz") + ".")
    if m.state and m.state[0].share >= _SMALL:
        first, *rest = m.state
        more = [s for s in rest if s.share > 0.5 * first.share][:2]
        also = f" ({', '.join(f'{s.state} {percent(s.share)}' for s in more)})" if more else ""
        out.append(
            f"Over the state: a function of {first.state} alone explains {percent(first.share)} of the torque that would close "
            f"the gap{also}."
        )
    elif m.state:
        out.append("Over the state: no single state explains the torque that would close the gap.")
    return [*out, *_mechanism(d, m)]


def _mechanism(d: Diagnosis, m: Mismatch) -> list[str]:
    """The place in the mechanism: that of what is named, else the place where one state explains most."""
    signals = m.place[0] if m.place and m.place[0].explained >= _SMALL else None
    size = ""
    if signals is not None:
        rms = f"{number(signals.rms, 3)} {unit(signals.unit)} rms, " if signals.unit != "as the channel" else ""
        size = f"({rms}{percent(signals.explained)} explained by {signals.by})"
    named = list(dict.fromkeys(f.place for f in d.findings))
    if named:
        told = f"In the mechanism: at the {' and the '.join(named)}, the place of what is named."
        if signals is not None and signals.place not in named:
            told += (
                f" By signals alone one variable explains most at the {signals.place} {size}: they do not tell the places apart."
            )
        return [told]
    return [] if signals is None else [f"In the mechanism: one variable explains most at the {signals.place} {size}."]


def _merged(shares: Sequence[Share]) -> list[Share]:
    """Stretches that touch, as one; strongest first."""
    out: list[Share] = []
    for s in sorted(shares, key=lambda s: s.low):
        near = 0.05 * (s.high - s.low)
        if out and s.low - out[-1].high <= near:
            out[-1] = Share(out[-1].low, s.high, out[-1].share + s.share)
        else:
            out.append(s)
    return sorted(out, key=lambda s: -s.share)


def _listed(shares: Sequence[Share], unit_text: str, most: int = 3) -> str:
    return ", ".join(f"{percent(s.share)} between {number(s.low, 3)} and {number(s.high, 3)} {unit_text}" for s in shares[:most])
