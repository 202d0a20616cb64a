"""Byte-preserving editing of XML files by the byte offsets of the elements.

Source    XML 1.0, fifth edition: the attributes of a start tag are between quotes, and no value or
    comment contains text that can be mistaken for an attribute
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from xml.parsers import expat

from testbed.core.base.errors import ModelError

_ATTRIBUTE = re.compile(rb"""\s+([^\s=]+)\s*=\s*("[^"]*"|'[^']*')""")
_TAG = re.compile(rb"""<[^\s/>]+((?:\s+[^\s=]+\s*=\s*(?:"[^"]*"|'[^']*'))*)\s*(/?)>""")
_WIDE_PREFIXES = (b"\xff\xfe", b"\xfe\xff", b"\x00", b"<\x00")
"""First bytes of files in encodings with more than one byte a character."""


@dataclass(frozen=True)
class XmlElement:
    """XML element with byte offsets in the file.

    Attributes:
        tag: Name of the element.
        attributes: Values as written between the quotes, keyed by attribute.
        children: Child elements in file order.
        start: Byte offset of the start tag.
        content_start: Byte offset after the start tag.
        is_empty: True if the element is an empty-element tag, without an end tag.
    """

    tag: str
    attributes: Mapping[str, str]
    children: tuple[XmlElement, ...]
    start: int
    content_start: int
    is_empty: bool

    def children_named(self, *tags: str) -> list[XmlElement]:
        """Child elements with one of the given names, in file order.

        Args:
            tags: Names of the elements.
        """
        return [child for child in self.children if child.tag in tags]


class XmlBytes:
    """Bytes of an XML file, its elements, and pending changes."""

    def __init__(self, data: bytes, name: str) -> None:
        """Parse the elements of an XML file.

        Args:
            data: Bytes of the file.
            name: Name of the file, for messages.

        Raises:
            ModelError: The file is not XML, has a DOCTYPE, or has more than one byte per character.
        """
        if data.startswith(_WIDE_PREFIXES):
            raise ModelError(
                f"{name}: only files in UTF-8 or another encoding of bytes are edited"
            )
        self.data = data
        self._line = b"\r\n" if b"\r\n" in data else b"\n"
        self._changes: list[tuple[int, int, bytes]] = []
        self._open: list[tuple[dict[str, str], list[XmlElement], int]] = [({}, [], 0)]
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._start_element
        self._parser.EndElementHandler = self._end_element
        self._parser.StartDoctypeDeclHandler = self._reject_doctype
        self._name = name
        try:
            self._parser.Parse(data, True)
        except expat.ExpatError as error:
            raise ModelError(f"{name}: not well-formed XML ({error})") from None
        (self.root,) = self._open[0][1]

    def _reject_doctype(self, *_: object) -> None:
        """Raise an error for a document type declaration; handler for expat."""
        raise ModelError(
            f"{self._name}: a file with a DOCTYPE is not edited; take it out"
        )

    def _start_element(self, tag: str, attributes: dict[str, str]) -> None:
        """Record the start tag of an element; handler for expat."""
        self._open.append((attributes, [], self._parser.CurrentByteIndex))

    def _end_element(self, tag: str) -> None:
        """Add a complete element to the children of its parent; handler for expat."""
        attributes, children, start = self._open.pop()
        match = _TAG.match(self.data, start)
        if match is None:
            raise ModelError(
                f"{self._name}: <{tag:.40}> cannot be found in the file's bytes"
            )
        element = XmlElement(
            tag, attributes, tuple(children), start, match.end(), bool(match[2])
        )
        self._open[-1][1].append(element)

    def set_attributes(self, element: XmlElement, **values: str | None) -> None:
        """Change attributes of an element; None removes an attribute if it exists.

        New attributes are written after the existing attributes. The change is pending until
        `apply_changes`.

        Args:
            element: Element to change.
            values: New values in ASCII without characters that need escaping, keyed by attribute;
                None to remove the attribute.
        """
        tag = _TAG.match(self.data, element.start)
        assert tag is not None
        positions = {  # start with the blank before, start of the quoted value, end
            match[1].decode(errors="replace"): (
                match.start(),
                match.start(2),
                match.end(2),
            )
            for match in _ATTRIBUTE.finditer(self.data, tag.start(1), tag.end(1))
        }
        missing = b""
        for name, value in values.items():
            position = positions.get(name)
            if position is not None and value is None:
                self._changes.append((position[0], position[2], b""))
            elif position is not None and value is not None:
                self._changes.append(
                    (position[1] + 1, position[2] - 1, value.encode("ascii"))
                )
            elif value is not None:
                missing += f' {name}="{value}"'.encode("ascii")
        if missing:
            end = element.content_start - (2 if element.is_empty else 1)
            while self.data[end - 1 : end].isspace():
                end -= 1
            self._changes.append((end, end, missing))

    def insert_text(self, element: XmlElement, text: str) -> None:
        """Insert text as the first content of an element, pending until `apply_changes`.

        Args:
            element: Element that receives the text.
            text: Text in ASCII; it begins on a new line, indented by two spaces more than the
                element.
        """
        prefix = self.data[self.data.rfind(b"\n", 0, element.start) + 1 : element.start]
        indent = prefix if prefix.isspace() else b""
        inner = self._line + indent + b"  " + text.encode("ascii")
        if element.is_empty:
            content = b">" + inner + self._line + indent + f"</{element.tag}>".encode()
            end = element.content_start - 2
            while self.data[end - 1 : end].isspace():
                end -= 1
            self._changes.append((end, element.content_start, content))
        else:
            self._changes.append((element.content_start, element.content_start, inner))

    def set_child(self, element: XmlElement, tag: str, **values: str | None) -> None:
        """Change attributes of the first child with a given name; insert the child if missing.

        The change is pending until `apply_changes`.

        Args:
            element: Parent of the child.
            tag: Name of the child.
            values: New values keyed by attribute, as for `set_attributes`.
        """
        children = element.children_named(tag)
        if children:
            self.set_attributes(children[0], **values)
        else:
            self.insert_text(element, empty_element_tag(tag, values))

    def apply_changes(self) -> bytes:
        """Apply the pending changes to the original bytes, and clear the changes."""
        pieces, last = [], 0
        for start, end, text in sorted(self._changes, key=lambda change: change[:2]):
            pieces += [self.data[last:start], text]
            last = end
        self._changes = []
        return b"".join([*pieces, self.data[last:]])


def empty_element_tag(tag: str, values: Mapping[str, str | None]) -> str:
    """Text of an empty-element tag with attributes.

    Args:
        tag: Name of the element.
        values: Values keyed by attribute; None omits the attribute.
    """
    listed = "".join(
        f' {key}="{value}"' for key, value in values.items() if value is not None
    )
    return f"<{tag}{listed}/>"


def xml_comment(lines: list[str]) -> str:
    """XML comment with the lines joined into one, in ASCII without double dashes.

    Args:
        lines: Lines of the comment.
    """
    plain = (
        " ".join(" ".join(lines).split()).encode("ascii", "backslashreplace").decode()
    )
    while "--" in plain:
        plain = plain.replace("--", "- -")
    return f"<!-- {plain} -->"
