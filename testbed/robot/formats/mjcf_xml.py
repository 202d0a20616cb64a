"""What an MJCF file would become, counted before MuJoCo sees it.

A file may include others, attach other models and replicate its parts. MuJoCo follows a
model that holds itself until the stack ends, and makes a billion copies if it is told to.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from pathlib import Path

from testbed.errors import ModelError
from testbed.robot.parsing import decimals, read_xml

MOST_MADE_BODIES, MOST_MADE_ELEMENTS = 5_000, 50_000
"""Bodies, and elements of all kinds, that a file may become, copies counted."""
MOST_CELLS = 10**7
"""Of a height field: rows times columns."""
MOST_RESERVED = 10**6
"""Of anything that <size> reserves, memory aside, which MuJoCo bounds itself."""
FINEST_MESH = 500
"""Largest parameter of a mesh that MuJoCo makes: its resolution, squared in vertices."""
DEEPEST_FILES = 8
"""Files that may hold each other in a row."""
_BODIES = ("body", "composite", "flexcomp")
_COPIED = ("replicate", "composite", "flexcomp")
"""Elements whose attribute `count` says how many copies are made."""


@dataclass(frozen=True)
class _Size:
    """How many elements and bodies something becomes."""

    elements: int = 0
    bodies: int = 0

    def __add__(self, other: _Size) -> _Size:
        return _Size(self.elements + other.elements, self.bodies + other.bodies)

    def __mul__(self, copies: int) -> _Size:
        return _Size(self.elements * copies, self.bodies * copies)


def check_files(path: Path) -> None:
    """Whether a file, with all that it includes, attaches and copies, is of a size to be read.

    Raises:
        ModelError: It holds itself, or becomes too large; a file is not XML, or not UTF-8.
    """
    made = _Files(path).size(path, ())
    if made.elements > MOST_MADE_ELEMENTS or made.bodies > MOST_MADE_BODIES:
        raise ModelError(
            f"{path}: would become {_rounded(made.bodies)} bodies, {_rounded(made.elements)} "
            f"elements in all; {MOST_MADE_BODIES} and {MOST_MADE_ELEMENTS} are the limits (see "
            "<replicate>, <attach>, <include>)"
        )


class _Files:
    """Model files that hold each other, each read and counted once."""

    def __init__(self, first: Path) -> None:
        self._first = first
        self._counted: dict[Path, _Size] = {}

    def size(self, path: Path, within: tuple[Path, ...]) -> _Size:
        """What a file becomes.

        Args:
            path: The file.
            within: The files that hold it, outermost first.
        """
        place = path.resolve()
        if place in within:
            raise ModelError(f"{self._first}: '{path.name}' holds itself, by <include> or <model>")
        if len(within) >= DEEPEST_FILES:
            raise ModelError(f"{self._first}: more than {DEEPEST_FILES} files hold each other")
        if place not in self._counted:
            self._counted[place] = self._count(path, (*within, place))
        return self._counted[place]

    def _count(self, path: Path, within: tuple[Path, ...]) -> _Size:
        root = read_xml(path)
        try:
            path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            raise ModelError(f"{path}: not UTF-8, which is all that MuJoCo reads") from None
        models: dict[str, _Size] = {}
        for model in root.iter("model"):
            found = self._held(model, path, within)
            models |= dict.fromkeys(
                (model.get("name", ""), Path(model.get("file", "")).stem), found
            )
        unnamed = max(models.values(), key=lambda size: size.elements, default=_Size())
        made = _Size()
        for element, copies in _copies(root):
            made += _Size(1, element.tag in _BODIES) * copies
            if element.tag == "attach":
                made += models.get(element.get("model", ""), unnamed) * copies
            elif element.tag in ("include", "model"):
                made += self._held(element, path, within) * copies
            elif element.tag in ("hfield", "size", "mesh"):
                self._check_numbers(element)
        return made

    def _held(self, element: ET.Element, path: Path, within: tuple[Path, ...]) -> _Size:
        """What the file becomes that an element names, beside its own or the first one."""
        name = element.get("file", "")
        places = [folder / name for folder in {path.parent, self._first.parent} if name]
        sizes = [self.size(place, within) for place in places if place.exists()]
        return max(sizes, key=lambda size: size.elements, default=_Size())

    def _check_numbers(self, element: ET.Element) -> None:
        """Whether what an element's numbers ask for can be made in a moment."""
        if element.tag == "hfield":
            if _largest(element, "nrow") * _largest(element, "ncol") > MOST_CELLS:
                raise ModelError(f"{self._first}: a height field of more than {MOST_CELLS} cells")
        elif element.tag == "mesh":
            if _largest(element, "params") > FINEST_MESH:
                raise ModelError(f"{self._first}: a mesh of params above {FINEST_MESH}")
        else:
            reserved = {key: _largest(element, key) for key in element.attrib if key != "memory"}
            large = [key for key, value in reserved.items() if value > MOST_RESERVED]
            if large:
                raise ModelError(
                    f"{self._first}: <size {large[0]}> reserves more than {MOST_RESERVED}"
                )


def _largest(element: ET.Element, key: str) -> float:
    """The largest number of an attribute; zero where there is none."""
    words = [decimals(word, 1) for word in element.get(key, "").split()]
    return max((abs(word[0]) for word in words if word), default=0.0)


def _copies(root: ET.Element) -> Iterator[tuple[ET.Element, int]]:
    """All elements, and how many times each is made."""
    waiting = [(root, 1)]
    while waiting:
        element, copies = waiting.pop()
        if element.tag in _COPIED:
            counts = [decimals(word, 1) for word in element.get("count", "1").split()]
            copies *= prod(max(1, int(count[0])) for count in counts if count)
        yield element, copies
        waiting += [(child, copies) for child in element]


def _rounded(number: int) -> str:
    return str(number) if number < 10**9 else f"over 10^{len(str(number)) - 1}"
