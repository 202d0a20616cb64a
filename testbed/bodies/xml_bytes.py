"""An XML file as bytes with places in them: what is not edited stays as it is.

Source    XML 1.0, fifth edition: a start tag's attributes stand between quotes, and nothing in a
          value or a comment can be mistaken for one
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from xml.parsers import expat

from testbed.core.base.errors import ModelError

_ATTRIBUTE = re.compile(rb"""\s+([^\s=]+)\s*=\s*("[^"]*"|'[^']*')""")
_TAG = re.compile(rb"""<[^\s/>]+((?:\s+[^\s=]+\s*=\s*(?:"[^"]*"|'[^']*'))*)\s*(/?)>""")
_WIDE = (b"\xff\xfe", b"\xfe\xff", b"\x00", b"<\x00")
"""How files begin whose letters have more than one byte."""


@dataclass(frozen=True)
class Element:
    """An element, and where it stands.

    Attributes:
        tag: Its name.
        attributes: By name, the value as it stands between the quotes.
        children: Elements in it, in order.
        start: Of its start tag.
        opened: After its start tag.
        alone: Whether it has no end tag.
    """

    tag: str
    attributes: Mapping[str, str]
    children: tuple[Element, ...]
    start: int
    opened: int
    alone: bool

    def named(self, *tags: str) -> list[Element]:
        """Its children of these names."""
        return [child for child in self.children if child.tag in tags]


class XmlBytes:
    """A file's bytes, its elements, and changes that are to be made."""

    def __init__(self, data: bytes, name: str) -> None:
        """Read the elements.

        Args:
            data: The file's bytes.
            name: The file's name, for messages.

        Raises:
            ModelError: It is no XML, declares entities, or is in an encoding of wide letters.
        """
        if data.startswith(_WIDE):
            raise ModelError(
                f"{name}: only files in UTF-8 or another encoding of bytes are edited"
            )
        self.data = data
        self._line = b"\r\n" if b"\r\n" in data else b"\n"
        self._changes: list[tuple[int, int, bytes]] = []
        self._open: list[tuple[dict[str, str], list[Element], int]] = [({}, [], 0)]
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.StartDoctypeDeclHandler = self._doctype
        self._name = name
        try:
            self._parser.Parse(data, True)
        except expat.ExpatError as error:
            raise ModelError(f"{name}: not well-formed XML ({error})") from None
        (self.root,) = self._open[0][1]

    def _doctype(self, *_: object) -> None:
        raise ModelError(
            f"{self._name}: a file with a DOCTYPE is not edited; take it out"
        )

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._open.append((attributes, [], self._parser.CurrentByteIndex))

    def _end(self, tag: str) -> None:
        attributes, children, start = self._open.pop()
        found = _TAG.match(self.data, start)
        if found is None:
            raise ModelError(
                f"{self._name}: <{tag:.40}> cannot be found in the file's bytes"
            )
        element = Element(
            tag, attributes, tuple(children), start, found.end(), bool(found[2])
        )
        self._open[-1][1].append(element)

    def set(self, element: Element, **values: str | None) -> None:
        """Change attributes; None takes one out, which need not be there.

        Args:
            element: Whose.
            values: By name; letters, digits and blanks only.
        """
        tag = _TAG.match(self.data, element.start)
        assert tag is not None
        there = {  # where it starts, with the blank before; its value, with quotes; its end
            each[1].decode(errors="replace"): (each.start(), each.start(2), each.end(2))
            for each in _ATTRIBUTE.finditer(self.data, tag.start(1), tag.end(1))
        }
        missing = b""
        for name, value in values.items():
            place = there.get(name)
            if place is not None and value is None:
                self._changes.append((place[0], place[2], b""))
            elif place is not None and value is not None:
                self._changes.append(
                    (place[1] + 1, place[2] - 1, value.encode("ascii"))
                )
            elif value is not None:
                missing += f' {name}="{value}"'.encode("ascii")
        if missing:
            end = element.opened - (2 if element.alone else 1)
            while self.data[end - 1 : end].isspace():
                end -= 1
            self._changes.append((end, end, missing))

    def insert(self, element: Element, text: str) -> None:
        """Put something first into an element.

        Args:
            element: Into which.
            text: Of lines, the first of which gets a line of its own, indented as is usual here.
        """
        before = self.data[self.data.rfind(b"\n", 0, element.start) + 1 : element.start]
        indent = before if before.isspace() else b""
        inner = self._line + indent + b"  " + text.encode("ascii")
        if element.alone:
            close = b">" + inner + self._line + indent + f"</{element.tag}>".encode()
            end = element.opened - 2
            while self.data[end - 1 : end].isspace():
                end -= 1
            self._changes.append((end, element.opened, close))
        else:
            self._changes.append((element.opened, element.opened, inner))

    def put(self, element: Element, tag: str, **values: str | None) -> None:
        """Change attributes of the first child of a name, which is put in if there is none.

        Args:
            element: In which it stands.
            tag: Its name.
            values: As for `set`.
        """
        there = element.named(tag)
        if there:
            self.set(there[0], **values)
        else:
            self.insert(element, as_tag(tag, values))

    def edit(self) -> bytes:
        """The bytes with all changes, which are then forgotten."""
        pieces, last = [], 0
        for start, end, text in sorted(self._changes, key=lambda change: change[:2]):
            pieces += [self.data[last:start], text]
            last = end
        self._changes = []
        return b"".join([*pieces, self.data[last:]])


def as_tag(tag: str, values: Mapping[str, str | None]) -> str:
    """An element without content."""
    listed = "".join(
        f' {key}="{value}"' for key, value in values.items() if value is not None
    )
    return f"<{tag}{listed}/>"


def comment(lines: list[str]) -> str:
    """A comment of some lines: ASCII, and no two dashes in a row."""
    plain = (
        " ".join(" ".join(lines).split()).encode("ascii", "backslashreplace").decode()
    )
    while "--" in plain:
        plain = plain.replace("--", "- -")
    return f"<!-- {plain} -->"
