"""What an MJCF file would become, counted before MuJoCo sees it.

A file may include others, attach other models and replicate its parts. MuJoCo follows a
model that holds itself until the stack ends, and makes a billion copies if it is told to.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from math import prod
from pathlib import Path

from testbed.errors import ModelError
from testbed.robot.decimals import decimals
from testbed.robot.model_xml import read_xml

MOST_ELEMENTS = 100_000
"""Elements that a file may become, copies counted."""
DEEPEST_FILES = 8
"""Files that may hold each other in a row."""
_COPIED = ("replicate", "composite", "flexcomp")
"""Elements whose attribute `count` says how many copies are made."""


def check_files(path: Path) -> None:
    """Whether a file, with all that it includes, attaches and copies, is of a size to be read.

    Raises:
        ModelError: It holds itself, or becomes too large; a file is not XML.
    """
    root = path.resolve()
    made = _Files(root.parent).elements(root, ())
    if made > MOST_ELEMENTS:
        raise ModelError(
            f"{path}: would become {_rounded(made)} elements with its copies; {MOST_ELEMENTS} is "
            "the limit (see <replicate>, <attach>, <include>)"
        )


class _Files:
    """Model files that hold each other, each read and counted once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._counted: dict[Path, int] = {}

    def elements(self, path: Path, within: tuple[Path, ...]) -> int:
        """How many elements a file becomes.

        Args:
            path: The file.
            within: The files that hold it, outermost first.
        """
        if path in within:
            raise ModelError(f"{within[0]}: '{path.name}' holds itself, by <include> or <model>")
        if len(within) >= DEEPEST_FILES:
            raise ModelError(f"{within[0]}: more than {DEEPEST_FILES} files hold each other")
        if path not in self._counted:
            self._counted[path] = self._count(path, (*within, path))
        return self._counted[path]

    def _count(self, path: Path, within: tuple[Path, ...]) -> int:
        root = read_xml(path)
        models: dict[str, int] = {}
        for model in root.iter("model"):
            size = self._held(model, path, within)
            for name in (model.get("name"), Path(model.get("file", "")).stem):
                models[name or ""] = max(size, models.get(name or "", 0))
        attached = max(models.values(), default=0)
        made = 0
        for element, copies in _copies(root):
            made += copies
            if element.tag == "attach":
                made += copies * models.get(element.get("model", ""), attached)
            elif element.tag in ("include", "model"):
                made += copies * self._held(element, path, within)
        return made

    def _held(self, element: ET.Element, path: Path, within: tuple[Path, ...]) -> int:
        """How many elements the file becomes that an element names."""
        name = element.get("file", "")
        places = (
            {(folder / name).resolve() for folder in (path.parent, self._folder)} if name else ()
        )
        return max((self.elements(place, within) for place in places if place.exists()), default=0)


def _copies(root: ET.Element) -> Iterator[tuple[ET.Element, int]]:
    """All elements, and how many times each is made."""
    waiting = [(root, 1)]
    while waiting:
        element, copies = waiting.pop()
        yield element, copies
        if element.tag in _COPIED:
            counts = [decimals(word, 1) for word in element.get("count", "1").split()]
            copies *= prod(max(1, int(count[0])) for count in counts if count)
        waiting += [(child, copies) for child in element]


def _rounded(number: int) -> str:
    return str(number) if number < 10**9 else f"over 10^{len(str(number)) - 1}"
