"""The tags of an XML text as MuJoCo's parser (TinyXML-2) finds them, which takes texts that are not well-formed.

Bare ampersands, ``--`` in comments and any bytes in names are common in MJCF files. Checks of a file that go by another grammar
than the parser's can be passed by: a comment that begins in an attribute, a file name written in character references.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from mjsim.errors import InputError

__all__ = ["Tag", "tags", "with_plain_comments"]

_SPACE = rb"[ \t\n\v\f\r]*"
_NAME = rb"[A-Za-z:_\x80-\xff][A-Za-z0-9.:_\x80-\xff-]*"
_VALUE = rb"""(?:"[^"]*"|'[^']*')"""
_ATTRIBUTE = re.compile(rb"(" + _NAME + rb")" + _SPACE + rb"=" + _SPACE + rb"(" + _VALUE + rb")")
_COMMENT = rb"<!--.*?-->"
_MARKUP = re.compile(
    rb"(?P<comment>" + _COMMENT + rb")|<\?.*?\?>|<!\[CDATA\[.*?\]\]>|<!(?!--|\[CDATA\[)[^>]*>"
    rb"|</" + _SPACE + rb"(?P<close>" + _NAME + rb")" + _SPACE + rb">"
    rb"|<" + _SPACE + rb"(?P<open>" + _NAME + rb")(?P<attributes>(?:" + _SPACE + _ATTRIBUTE.pattern + rb")*)" + _SPACE +
    rb"(?P<empty>/?)>", re.DOTALL
)  # fmt: skip
_NOT_PLAIN = re.compile(rb"<!--(?:[^-]|-(?!-))*--[^>]")
_REFERENCE = re.compile(rb"&(?:#x([0-9a-fA-F]+)|#([0-9]+)|(quot|amp|apos|lt|gt));")
_ENTITIES = {b"quot": b'"', b"amp": b"&", b"apos": b"'", b"lt": b"<", b"gt": b">"}


@dataclass(frozen=True)
class Tag:
    """A start tag or an end tag: the name, the text of its attributes, whether it opens an element and whether it closes one."""

    name: str
    text: bytes = b""
    opens: bool = True
    closes: bool = False

    @property
    def attributes(self) -> tuple[tuple[str, bytes], ...]:
        """Names and values in their order, references resolved."""
        return tuple((name.decode("latin-1"), _resolved(value[1:-1])) for name, value in _ATTRIBUTE.findall(self.text))


def _markup(raw: bytes, source: object) -> Iterator[re.Match[bytes]]:
    at = raw.find(b"<")
    while at >= 0:
        found = _MARKUP.match(raw, at)
        if found is None:
            line = raw.count(b"\n", 0, at) + 1
            raise InputError(source, f"line {line} is not XML ({raw[at : at + 40]!r})", "an MJCF model", "correct the tag")
        yield found
        at = raw.find(b"<", found.end())


def tags(raw: bytes, source: object) -> Iterator[Tag]:
    """Tags of a text in their order. Raises InputError, with the line, where a ``<`` begins none."""
    for found in _markup(raw, source):
        if found["open"]:
            yield Tag(found["open"].decode("latin-1"), found["attributes"], True, bool(found["empty"]))
        elif found["close"]:
            yield Tag(found["close"].decode("latin-1"), b"", False, True)


def with_plain_comments(raw: bytes, source: object) -> bytes:
    """The text with ``--`` inside comments as ``==``, at the same places: XML forbids it, and MuJoCo takes it."""
    if not _NOT_PLAIN.search(raw):
        return raw
    parts, at = [], 0
    for found in _markup(raw, source):
        if found["comment"] is not None and b"-" in found["comment"][4:-3]:
            inner = found["comment"][4:-3]
            plain = re.sub(rb"-$", b"=", inner.replace(b"--", b"=="))
            parts += [raw[at : found.start()], b"<!--", plain, b"-->"]
            at = found.end()
    return b"".join([*parts, raw[at:]])


def _resolved(value: bytes) -> bytes:
    """An attribute's text with its references resolved, code points as UTF-8."""

    def one(found: re.Match[bytes]) -> bytes:
        if found[3]:
            return _ENTITIES[found[3]]
        code = int(found[1], 16) if found[1] else int(found[2])
        return chr(code).encode("utf-8", "surrogatepass") if code < 0x110000 else found[0]

    return _REFERENCE.sub(one, value)
