"""The numbers of a URDF file, read by one grammar and written anew.

urdfdom drops a whole inertial whose mass is "3 " and says so only on standard error; other
parsers take other texts. What is no plain number is refused here, and what is one is
written as every parser takes it, so that Pinocchio and MuJoCo read the same numbers.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from difflib import get_close_matches

from testbed.errors import ModelError
from testbed.robot.decimals import decimals
from testbed.robot.inertia import HEAVIEST
from testbed.robot.tree import FARTHEST

TENSOR = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
"""Entries of an inertia, by attribute."""

RIGHT = 1e-5
"""Angles of rpy so near a multiple of a right angle are one, rounded in the file [rad]."""


@dataclass(frozen=True)
class _Numbers:
    """What an attribute holds.

    Attributes:
        count: So many numbers.
        absent: What it is where it is not given; None where it must be.
        greatest: Magnitude that none of them exceeds.
        signed: Whether they may be negative.
        angles: Whether right angles are meant where they nearly are.
    """

    count: int
    absent: str | None
    greatest: float = float("inf")
    signed: bool = True
    angles: bool = False


_PLACE = {
    "xyz": _Numbers(3, "0 0 0", FARTHEST),
    "rpy": _Numbers(3, "0 0 0", FARTHEST, angles=True),
}
_ATTRIBUTES = {
    "origin": _PLACE,
    "axis": {"xyz": _Numbers(3, "1 0 0", FARTHEST)},
    "mass": {"value": _Numbers(1, None, HEAVIEST)},
    "inertia": {
        key: _Numbers(1, None, HEAVIEST) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    },
    "limit": {
        **{key: _Numbers(1, "0") for key in ("lower", "upper")},
        **{key: _Numbers(1, "0", signed=False) for key in ("effort", "velocity")},
    },
    "dynamics": {"damping": _Numbers(1, "0"), "friction": _Numbers(1, "0", signed=False)},
    "mimic": {"multiplier": _Numbers(1, "1"), "offset": _Numbers(1, "0")},
    "box": {"size": _Numbers(3, None, FARTHEST)},
    "sphere": {"radius": _Numbers(1, None, FARTHEST)},
    "cylinder": {key: _Numbers(1, None, FARTHEST) for key in ("radius", "length")},
    "capsule": {key: _Numbers(1, None, FARTHEST) for key in ("radius", "length")},
    "mesh": {"scale": _Numbers(3, "1 1 1", FARTHEST)},
    "color": {"rgba": _Numbers(4, None, 1.0)},
}
_TEXTS = {"mimic": "joint", "mesh": "filename"}
"""Attributes that hold no numbers."""
_EXTENDED = ("limit", "dynamics", "mimic", "mesh")
"""Elements to which vendors add attributes of their own."""
_NO_NUMBERS = ("nan", "inf", "infinity")


def rewrite_numbers(owner: ET.Element, where: str, *, allow_nan: bool = False) -> None:
    """Read the numbers of an element's parts strictly, and write them plainly.

    Args:
        owner: A joint or an inertial; its parts are changed.
        where: File and owner, for messages.
        allow_nan: Leave texts like "nan" as NaN: an inertia that is none is told as such.

    Raises:
        ModelError: Names the attribute that holds something else.
    """
    for part in owner:
        for key, numbers in _ATTRIBUTES.get(part.tag, {}).items():
            text = part.get(key, numbers.absent)
            if text is None:
                raise ModelError(f"{where}: <{part.tag}> has no {key}")
            part.set(key, _plain(text, numbers, f"{where}: <{part.tag}> {key}", allow_nan))
        if part.tag in _ATTRIBUTES:
            _check_attributes(part, where)


def numbers_of(element: ET.Element | None, key: str, absent: str = "0") -> list[float]:
    """The numbers of an attribute that has been rewritten."""
    text = absent if element is None else element.get(key, absent)
    return [float(word) for word in text.split()]


def plain(values: list[float]) -> str:
    """Numbers as a file holds them."""
    return " ".join(repr(float(value)) for value in values)


def _plain(text: str, numbers: _Numbers, where: str, allow_nan: bool) -> str:
    values = decimals(text, numbers.count)
    if values is None:
        words = text.lower().split()
        if allow_nan and len(words) == numbers.count:
            finite = [w for w in words if w.lstrip("+-") not in _NO_NUMBERS]
            if len(finite) < len(words) and all(decimals(word, 1) for word in finite):
                return " ".join(["nan"] * numbers.count)
        wanted = "a decimal number" if numbers.count == 1 else f"{numbers.count} decimal numbers"
        raise ModelError(f"{where}={text!r:.60} is not {wanted}")
    for value in values:
        if abs(value) > numbers.greatest:
            raise ModelError(f"{where} holds {value:g}; {numbers.greatest:g} is the limit")
        if value < 0 and not numbers.signed:
            raise ModelError(f"{where} holds {value:g}, which cannot be negative")
    return plain([_right(value) for value in values] if numbers.angles else values)


def _right(angle: float) -> float:
    right = round(2 * angle / math.pi) * math.pi / 2
    return right if abs(angle - right) <= RIGHT else angle


def _check_attributes(part: ET.Element, where: str) -> None:
    """Whether an attribute is a misspelled one."""
    known = {*_ATTRIBUTES[part.tag], _TEXTS.get(part.tag, "")} - {""}
    for key in sorted(set(part.attrib) - known):
        meant = get_close_matches(key.lower(), known, n=1, cutoff=0.85)
        if meant or part.tag not in _EXTENDED:
            hint = f"did you mean {meant[0]}?" if meant else f"it has {', '.join(sorted(known))}"
            raise ModelError(f"{where}: <{part.tag}> holds the unknown {key!r:.40}; {hint}")
