"""A self-contained HTML page: theme, scripts and a content security policy that allows nothing else.

The policy lists the SHA-256 of each inline style and script; no request leaves the page. ``document`` is all that a page of this
project needs around its body.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from mjsim.errors import writing

__all__ = ["document", "theme", "write_page"]


@cache
def _resource(name: str) -> str:
    return (files("diagnose.report") / name).read_text(encoding="utf-8")


def theme() -> str:
    """The style sheet of all pages."""
    return _resource("theme.css")


def document(title: str, body: str, data: Mapping[str, Any] | None = None, style: str = "") -> str:
    """A page of ``body`` (HTML, escaped by whoever made it).

    ``data``: what `plots.page_data` returns, for a page whose plots are interactive; without it the page has no script but the
    one that switches the theme. ``style``: rules of this page beside those of the theme. The same input gives the same bytes.
    """
    scripts = [_resource("theme.js")]
    styles = [theme() + style]
    plotly = ""
    payload = ""
    if data is not None:
        scripts += [
            _resource("vendor/plotly-basic.min.js"),
            *map(_resource, ("signals.js", "panels.js", "views.js", "explorer.js", "page.js")),
        ]
        # Plotly makes no style element of its own where it finds this one
        plotly = f'<style id="plotly.js-style-global" class="no-inline-styles">{_resource("vendor/plotly-basic.css")}</style>\n'
        styles.append(_resource("vendor/plotly-basic.css"))
        payload = f'<script type="application/json" id="simgap-data">{_json(data)}</script>\n'
    first, *later = scripts
    policy = "; ".join(
        (
            "default-src 'none'",
            f"script-src {' '.join(map(_hash, scripts))}",
            f"style-src {' '.join(map(_hash, styles))}",
            "img-src data: blob:",
            "media-src data: blob:",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)}</title>\n<style>{styles[0]}</style>\n{plotly}<script>{first}</script>\n</head>\n<body>\n"
        '<a class="skip" href="#content">Skip to the content</a>\n'
        f"{body}\n{payload}" + "".join(f"<script>{text}</script>\n" for text in later) + "</body>\n</html>\n"
    )


def _hash(text: str) -> str:
    """The source expression of an inline element in a content security policy."""
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"


def _json(data: Mapping[str, Any]) -> str:
    """JSON that ends no script element and opens no comment."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def write_page(text: str, path: Path) -> None:
    """Write a page in one move; nothing half-written is left under ``path``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, scratch = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with writing(path), os.fdopen(handle, "w", encoding="utf-8", newline="\n") as out:
            out.write(text)
        os.chmod(scratch, 0o644)
        os.replace(scratch, path)
    except BaseException:
        Path(scratch).unlink(missing_ok=True)
        raise
