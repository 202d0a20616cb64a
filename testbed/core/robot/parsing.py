"""Reading of XML model files within limits, number formats, and capture of standard error.

C parsers recurse over elements and print names. Files that are too large or too deeply nested could
crash a parser, and malformed names could disturb a terminal; these files are rejected first.
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

from testbed.core.base.errors import ModelError, missing_file_message

MAX_FILE_BYTES = 64 * 2**20
"""Largest size of a model file, meshes excluded [bytes]."""
MAX_ELEMENTS = 200_000
"""Largest number of XML elements in a file."""
MAX_ELEMENT_DEPTH = 450
"""Largest nesting depth of XML elements; MuJoCo's own parser stops at 500."""
MAX_ATTRIBUTES = 500
"""Largest number of attributes of an element; parsers compare every attribute with all others."""
MAX_NAME_LENGTH = 200
"""Largest number of characters of a name."""
MAX_NUMBER_LENGTH = 400
"""Largest number of characters of a number, as Python's conversion takes quadratic time."""
_DECIMAL_PATTERN = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_NAME_ATTRIBUTES = {
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
"""Attributes that hold names; names appear in column headings, files and messages."""
_CONTROL_CATEGORIES = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode categories of control, format (bidirectional too), surrogate and separator characters."""


def read_xml(path: Path) -> ET.Element:
    """Read an XML model file within the size limits and return the root element.

    The limits apply to the file size, the number and nesting depth of elements, the number of
    attributes per element, and the length of names.

    Raises:
        ModelError: The file does not exist, is not XML, exceeds a limit, or holds malformed names;
            the message starts with the path.
    """
    if not path.is_file():
        raise ModelError(missing_file_message(path, "model file"))
    with prefix_model_errors(path):
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise ModelError(f"{size / 2**20:.0f} MiB; a model file has at most 64 MiB")
        try:
            return _parse_xml(path)
        except (
            ExpatError,
            LookupError,
            ValueError,
        ) as error:  # the last two: unknown encodings
            with path.open("rb") as file:
                # bytes by which a web page is recognised
                start = file.read(1024).lstrip(b"\xef\xbb\xbf\r\n\t ").lower()
            if start.startswith((b"<!doctype html", b"<html")):
                raise ModelError(
                    "a web page, no model; download the raw file"
                ) from None
            hint = "; an experiment file is run by testbed run" * (
                path.suffix.lower() == ".toml"
            )
            raise ModelError(f"not well-formed XML ({error}){hint}") from None


def _parse_xml(path: Path) -> ET.Element:
    """Parse XML without namespace processing and return the root element.

    Robot files may use undeclared namespace prefixes.
    """
    parser, builder = ParserCreate(), _LimitedTreeBuilder()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    with path.open("rb") as file:
        parser.ParseFile(file)
    return builder.close()


@contextmanager
def prefix_model_errors(path: Path) -> Iterator[None]:
    """Prefix the messages of `ModelError` raised within a context with the file path.

    Messages of subclasses of `ModelError` already contain the file name, and are left unchanged.
    """
    try:
        yield
    except ModelError as error:
        if type(error) is not ModelError:
            raise
        raise ModelError(f"{path}: {error}") from None


def check_name(name: str, what: str) -> None:
    """Check that a name has at most MAX_NAME_LENGTH characters and no control characters.

    Args:
        name: Name in the file.
        what: Kind of the name, for the message.

    Raises:
        ModelError: The name is too long, or holds control or invisible characters.
    """
    if len(name) > MAX_NAME_LENGTH:
        raise ModelError(
            f"{what} of {len(name)} characters, '{ascii(name[:20])[1:-1]}...'; a name has at most "
            f"{MAX_NAME_LENGTH}"
        )
    if any(unicodedata.category(letter) in _CONTROL_CATEGORIES for letter in name):
        raise ModelError(
            f"{what} {name!a:.60} holds control characters; names are plain text"
        )


class _LimitedTreeBuilder(ET.TreeBuilder):
    """XML tree builder that checks element count, depth, attributes and names."""

    def __init__(self) -> None:
        super().__init__()
        self._depth, self._count = 0, 0

    def start(self, tag: str, attrs: dict[str, str]) -> ET.Element:
        """Open an element.

        Raises:
            ModelError: A limit is exceeded, or a name is malformed.
        """
        self._depth, self._count = self._depth + 1, self._count + 1
        if self._depth > MAX_ELEMENT_DEPTH:
            raise ModelError(
                f"elements stand more than {MAX_ELEMENT_DEPTH} deep in each other"
            )
        if self._count > MAX_ELEMENTS:
            raise ModelError(f"more than {MAX_ELEMENTS} elements")
        if len(attrs) > MAX_ATTRIBUTES:
            raise ModelError(
                f"<{tag:.40}> has {len(attrs)} attributes; {MAX_ATTRIBUTES} are the limit"
            )
        for key, value in attrs.items():
            if key in _NAME_ATTRIBUTES:
                check_name(value, f"{key} in <{tag:.40}>")
        return super().start(tag, attrs)

    def end(self, tag: str) -> ET.Element:
        """Close an element."""
        self._depth -= 1
        return super().end(tag)


def parse_decimals(text: str, count: int) -> list[float] | None:
    """Parse a given count of finite decimal numbers; return None for any other text.

    Model files and options share this grammar. Parsers differ in what they accept: Python accepts
    "1_0" and "nan", and urdfdom ignores a mass of "3 " without a message.

    Args:
        text: Numbers separated by blanks.
        count: Required count of numbers.
    """
    words = text.split()
    if len(words) != count or any(len(word) > MAX_NUMBER_LENGTH for word in words):
        return None
    if not all(_DECIMAL_PATTERN.fullmatch(word) for word in words):
        return None
    values = [float(word) for word in words]
    return values if all(abs(value) < float("inf") for value in values) else None


def format_numbers(values: Iterable[float]) -> str:
    """Format numbers at full precision, separated by blanks."""
    return " ".join(repr(float(value)) for value in values)


@contextmanager
def capture_stderr() -> Iterator[Callable[[], str]]:
    """Capture standard error of C++ code; yield a function that returns the captured text.

    Output of Python code, for example progress messages of another thread, is written to the
    original standard error.
    """
    python_stderr = sys.stderr
    python_stderr.flush()
    original_descriptor = os.dup(2)
    with (
        tempfile.TemporaryFile() as sink,
        os.fdopen(original_descriptor, "w", encoding="utf-8") as original,
    ):
        with suppress(AttributeError, OSError, ValueError):
            if python_stderr.fileno() == 2:  # tests and notebooks replace sys.stderr
                sys.stderr = original
        os.dup2(sink.fileno(), 2)

        def captured_text() -> str:
            sink.seek(0)
            return sink.read().decode(errors="replace")

        try:
            yield captured_text
        finally:
            original.flush()
            os.dup2(original_descriptor, 2)
            sys.stderr = python_stderr
