"""Between model files and the parsers that read them.

Parsers in C recurse over elements and print names; what would make them crash or would
disturb a terminal is refused here, before they see it: nothing larger, deeper or worse named
goes further. What they write to standard error is kept.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
import unicodedata
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from xml.parsers.expat import ExpatError, ParserCreate

from testbed.core.base.errors import ModelError, no_file

LARGEST = 64 * 2**20
"""Size of a model file [bytes]; meshes are files of their own."""
MOST_ELEMENTS = 200_000
DEEPEST = 450
"""Elements within each other; MuJoCo's own parser stops at 500."""
MOST_ATTRIBUTES = 500
"""Of one element; parsers compare each with all others."""
LONGEST_NAME = 200
LONGEST_NUMBER = 400
"""Characters: Python takes quadratic time over digits."""
_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_NAMES = {
    "name",
    "model",
    "link",
    "joint",
    "joint1",
    "joint2",
    "body",
    "body1",
    "body2",
    "class",
    "childclass",
    "type",
    "prefix",
    "file",
    "filename",
    "mesh",
    "material",
}
"""Attributes that name something: they come back in columns, files and messages."""
_UNSEEN = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode's control, format (bidirectional ones too), surrogate and separator characters."""


def read_xml(path: Path) -> ET.Element:
    """The root element of a model file.

    Raises:
        ModelError: There is no such file, it is not XML, or it is beyond a limit.
    """
    if not path.is_file():
        raise ModelError(no_file(path, "model file"))
    with errors_of(path):
        size = path.stat().st_size
        if size > LARGEST:
            raise ModelError(f"{size / 2**20:.0f} MiB; a model file has at most 64 MiB")
        try:
            return _parsed(path)
        except (
            ExpatError,
            LookupError,
            ValueError,
        ) as error:  # the latter: odd encodings
            with path.open("rb") as file:
                # bytes by which a web page is recognised
                page = file.read(1024).lstrip(b"\xef\xbb\xbf\r\n\t ").lower()
            if page.startswith((b"<!doctype html", b"<html")):
                raise ModelError(
                    "a web page, no model; download the raw file"
                ) from None
            hint = "; an experiment file is run by testbed run" * (
                path.suffix.lower() == ".toml"
            )
            raise ModelError(f"not well-formed XML ({error}){hint}") from None


def _parsed(path: Path) -> ET.Element:
    """Parse XML without namespaces, whose prefixes robot files may leave undeclared."""
    parser, found = ParserCreate(), _Limited()
    parser.StartElementHandler, parser.EndElementHandler = found.start, found.end
    with path.open("rb") as file:
        parser.ParseFile(file)
    return found.close()


@contextmanager
def errors_of(path: Path) -> Iterator[None]:
    """Errors in a model file begin with its name; those of a kind of their own have it already."""
    try:
        yield
    except ModelError as error:
        if type(error) is not ModelError:
            raise
        raise ModelError(f"{path}: {error}") from None


def check_name(name: str, what: str) -> None:
    """Whether a name can stand in a table, a file and a message.

    Args:
        name: As in the file.
        what: Whose name it is, for the message.

    Raises:
        ModelError: It is too long, or holds characters that control a terminal or are unseen.
    """
    if len(name) > LONGEST_NAME:
        raise ModelError(
            f"{what} of {len(name)} characters, '{ascii(name[:20])[1:-1]}...'; a name has at most "
            f"{LONGEST_NAME}"
        )
    if any(unicodedata.category(letter) in _UNSEEN for letter in name):
        raise ModelError(
            f"{what} {name!a:.60} holds control characters; names are plain text"
        )


class _Limited(ET.TreeBuilder):
    """Elements as they come, counted."""

    def __init__(self) -> None:
        super().__init__()
        self._depth, self._count = 0, 0

    def start(self, tag: str, attrs: dict[str, str]) -> ET.Element:
        """An element begins."""
        self._depth, self._count = self._depth + 1, self._count + 1
        if self._depth > DEEPEST:
            raise ModelError(f"elements stand more than {DEEPEST} deep in each other")
        if self._count > MOST_ELEMENTS:
            raise ModelError(f"more than {MOST_ELEMENTS} elements")
        if len(attrs) > MOST_ATTRIBUTES:
            raise ModelError(
                f"<{tag:.40}> has {len(attrs)} attributes; {MOST_ATTRIBUTES} are the limit"
            )
        for key, value in attrs.items():
            if key in _NAMES:
                check_name(value, f"{key} in <{tag:.40}>")
        return super().start(tag, attrs)

    def end(self, tag: str) -> ET.Element:
        """An element ends."""
        self._depth -= 1
        return super().end(tag)


def decimals(text: str, count: int) -> list[float] | None:
    """So many finite decimal numbers with blanks between and around; None if it is not that.

    One grammar for model files and options alike. Parsers differ in what they let pass: Python
    takes "1_0" and "nan", urdfdom drops a mass of "3 " without a word.

    Args:
        text: As in a file, or as typed.
        count: How many.
    """
    words = text.split()
    if len(words) != count or any(len(word) > LONGEST_NUMBER for word in words):
        return None
    if not all(_DECIMAL.fullmatch(word) for word in words):
        return None
    values = [float(word) for word in words]
    return values if all(abs(value) < float("inf") for value in values) else None


def plain(values: Iterable[float]) -> str:
    """Numbers as a file holds them, to the last digit."""
    return " ".join(repr(float(value)) for value in values)


@contextmanager
def capture_stderr() -> Iterator[Callable[[], str]]:
    """Collect what C++ code writes to standard error; yields a reader of it.

    What Python writes meanwhile, such as another thread's progress, goes where it did before.
    """
    ours = sys.stderr
    ours.flush()
    saved = os.dup(2)
    with (
        tempfile.TemporaryFile() as sink,
        os.fdopen(saved, "w", encoding="utf-8") as before,
    ):
        with suppress(AttributeError, OSError, ValueError):
            if ours.fileno() == 2:  # a test's or a notebook's is another, or has none
                sys.stderr = before
        os.dup2(sink.fileno(), 2)

        def said() -> str:
            sink.seek(0)
            return sink.read().decode(errors="replace")

        try:
            yield said
        finally:
            before.flush()
            os.dup2(saved, 2)
            sys.stderr = ours
