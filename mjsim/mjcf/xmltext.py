"""Editing XML in its own text: only the touched attributes change; comments, order and layout stay as their author left them."""

from __future__ import annotations

import codecs
import re
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from mjsim.errors import InputError
from mjsim.mjcf.tags import with_plain_comments

__all__ = ["Node", "XmlText", "decoded"]


@dataclass
class Node:
    """An element: where its start tag (start..head) and the whole of it (start..end) stand in the text.

    above: its parent, weakly, so that a tree is freed with the text that holds its root.
    """

    tag: str
    attributes: dict[str, str]
    above: weakref.ref[Node] | None
    start: int
    head: int = 0
    end: int = 0
    close: int = 0  # where its end tag starts; equal to head when it has none
    children: list[Node] = field(default_factory=list)

    @property
    def parent(self) -> Node | None:
        """The element that holds this one; None of the root."""
        return None if self.above is None else self.above()

    def walk(self) -> Iterator[Node]:
        """This element and all below it."""
        yield self
        for child in self.children:
            yield from child.walk()

    def child(self, tag: str) -> Node | None:
        """First child with a tag."""
        return next((c for c in self.children if c.tag == tag), None)


def decoded(raw: bytes) -> tuple[str, str]:
    """The text of an XML file and its encoding: UTF-8, else the encoding that it declares, else Latin-1."""
    declared = re.match(rb"""\s*<\?xml[^>]*?encoding\s*=\s*["']([\w.-]+)["']""", raw)
    names = ["utf-8-sig" if raw.startswith(codecs.BOM_UTF8) else "utf-8", "latin-1"]
    if declared:
        names.insert(1, declared[1].decode())
    for name in names:
        try:
            return raw.decode(name), name
        except (UnicodeDecodeError, LookupError):
            continue
    raise AssertionError("Latin-1 decodes any bytes")


TAG = re.compile(rb"""[^"'>]*(?:(?:"[^"]*"|'[^']*')[^"'>]*)*>""")  # to its end, which is no > inside a quoted value


class XmlText:
    """A well-formed XML text, but for ``--`` in its comments, and its elements, parsed anew after each edit."""

    def __init__(self, text: str, encoding: str = "utf-8") -> None:
        self.data = text.encode()
        self.encoding = encoding
        self.root = self._parse()

    @classmethod
    def read(cls, path: Path) -> XmlText:
        """The text of a file, decoded as `decoded` says. Raises InputError where it is not well-formed."""
        try:
            return cls(*decoded(path.read_bytes()))
        except expat.ExpatError as error:
            raise InputError(
                path, f"not well-formed XML ({error})", "XML whose special characters are escaped", "write & as &amp;, < as &lt;"
            ) from None

    @property
    def raw(self) -> bytes:
        """The file as it stands, in the encoding that it came in; what that lacks is written as character references."""
        return self.text.encode(self.encoding, "xmlcharrefreplace")

    @property
    def text(self) -> str:
        """The text as it stands."""
        return self.data.decode()

    def _parse(self) -> Node:
        parser = expat.ParserCreate("utf-8")
        stack: list[Node] = []
        roots: list[Node] = []

        def opened(tag: str, attributes: dict[str, str]) -> None:
            node = Node(tag, attributes, weakref.ref(stack[-1]) if stack else None, parser.CurrentByteIndex)
            node.head = self._tag_end(node.start)
            (stack[-1].children if stack else roots).append(node)
            stack.append(node)

        def closed(tag: str) -> None:
            node = stack.pop()
            at = parser.CurrentByteIndex
            alone = self.data[node.head - 2 : node.head] == b"/>"
            node.close = node.head if alone else at
            node.end = node.head if alone else self.data.index(b">", at) + 1

        parser.StartElementHandler = opened
        parser.EndElementHandler = closed
        try:
            parser.Parse(with_plain_comments(self.data, "the file"), True)
        finally:  # the functions hold the parser: without this its native memory waits for the garbage collector
            parser.StartElementHandler = parser.EndElementHandler = None
        return roots[0]

    def _tag_end(self, start: int) -> int:
        found = TAG.match(self.data, start)
        if found is None:
            raise ValueError("unclosed tag")
        return found.end()

    def _replace(self, start: int, end: int, new: str) -> None:
        self.data = self.data[:start] + new.encode() + self.data[end:]
        self.root = self._parse()

    def find(self, wanted: Callable[[Node], bool]) -> Node | None:
        """First element, in document order, that is wanted."""
        return next((n for n in self.root.walk() if wanted(n)), None)

    def set(self, node: Node, name: str, value: str | None) -> None:
        """Set an attribute in place, append a new one, or remove it (None)."""
        tag = self.data[node.start : node.head].decode()
        quoted = quoteattr(value) if value is not None else ""
        pattern = re.compile(rf"""(\s+)({re.escape(name)})(\s*=\s*)("[^"]*"|'[^']*')""")
        if name in node.attributes:
            new = pattern.sub("" if value is None else (lambda m: m[1] + m[2] + m[3] + quoted), tag, count=1)
        elif value is None:
            return
        else:
            tail = re.search(r"\s*/?>$", tag)
            assert tail is not None
            new = f"{tag[: tail.start()]} {name}={quoted}{tag[tail.start() :]}"
        self._replace(node.start, node.head, new)

    def rename(self, node: Node, tag: str) -> None:
        """Give an element another tag."""
        new = b"<" + tag.encode() + self.data[node.start + 1 + len(node.tag.encode()) : node.close]
        if node.close > node.head:
            new += f"</{tag}>".encode()
        self._replace(node.start, node.end, new.decode())

    def indent(self, node: Node) -> str:
        """White space before an element on its line."""
        line = self.data.rfind(b"\n", 0, node.start) + 1
        lead = self.data[line : node.start].decode()
        return lead if not lead.strip() else ""

    def append(self, parent: Node, lines: list[str]) -> None:
        """Add lines (an element, a comment) as the last content of an element, indented below it."""
        pad = self.indent(parent)
        inner = (self.indent(parent.children[-1]) if parent.children else "") or pad + "  "
        body = "".join(f"{inner}{line}\n" for line in lines)
        if parent.close == parent.head and self.data[parent.head - 2 : parent.head] == b"/>":
            self._replace(parent.head - 2, parent.head, f">\n{body}{pad}</{parent.tag}>")
            return
        line = self.data.rfind(b"\n", 0, parent.close) + 1
        if self.data[line : parent.close].strip():  # the end tag stands behind other content
            self._replace(parent.close, parent.close, f"\n{body}{pad}")
        else:
            self._replace(line, line, body)

    def insert_before(self, node: Node, lines: list[str]) -> None:
        """Add lines before an element, indented like it."""
        pad = self.indent(node)
        line = self.data.rfind(b"\n", 0, node.start) + 1
        at = line if not self.data[line : node.start].strip() else node.start
        self._replace(at, at, "".join(f"{pad}{text}\n" for text in lines))

    def remove(self, node: Node) -> None:
        """Remove an element, with its line when it stands alone on it."""
        start, end = node.start, node.end
        line = self.data.rfind(b"\n", 0, start) + 1
        after = self.data.find(b"\n", end)
        if not self.data[line:start].strip() and after >= 0 and not self.data[end:after].strip():
            start, end = line, after + 1
        self._replace(start, end, "")
