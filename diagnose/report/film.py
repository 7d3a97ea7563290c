"""A film in a page: the user's own model, with a recording as a ghost, that follows the slider of the explorer."""

from __future__ import annotations

import base64
from dataclasses import dataclass

from markupsafe import Markup

from diagnose.report.curves import worst_stretch
from diagnose.report.plots import Explorer, Signals

__all__ = ["Film", "film_figure", "stretch_of"]


@dataclass(frozen=True)
class Film:
    """H.264 of a stretch of a recording: file name, first moment [s] and length [s], and what is seen."""

    source: str
    start: float
    seconds: float
    mp4: bytes
    about: str


def stretch_of(explorer: Explorer, seconds: float) -> tuple[Signals, float, float]:
    """Which recording is worth a film, with the start and the length of ``seconds`` around the model's largest error.

    The first held-out recording, else the first one.
    """
    s = next((r for r in explorer.recordings if r.role.startswith("held")), explorer.recordings[0])
    counted = s.counted if s.counted is not None else s.time == s.time
    worst = worst_stretch(s.time, s.measured, s.models[explorer.error_of], counted)
    middle = float(s.time[worst].mean())
    first, last = float(s.time[0]), float(s.time[-1])
    start = max(first, min(middle - seconds / 2, last - seconds))
    return s, start, min(seconds, last - start)


def film_figure(film: Film | str, explorer: Explorer | None = None) -> Markup:
    """The film, or in one sentence why there is none; with ``explorer`` it follows that slider."""
    if isinstance(film, str):
        return Markup('<p class="small">No film: {}.</p>').format(film)
    data = base64.b64encode(film.mp4).decode("ascii")
    tied, told = Markup(""), ""
    if explorer is not None:
        index = next(i for i, s in enumerate(explorer.recordings) if s.source == film.source)
        tied = Markup(' data-recording="{}" data-start="{}" data-speed="1"').format(index, film.start)
        told = "; it follows the slider"
    return Markup(
        '<figure class="film"><video controls muted playsinline preload="auto"{tied} aria-label="{about}" '
        'src="data:video/mp4;base64,{data}"></video>'
        "<figcaption>{about} From {start:.2f} to {end:.2f} s{told}.</figcaption></figure>"
    ).format(tied=tied, start=film.start, end=film.start + film.seconds, about=film.about, data=data, told=told)
