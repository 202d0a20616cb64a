"""What the recursions need from numbers, so that symbols can take their place.

The recursions of this room use +, -, *, @ on arrays and the three functions below. NumPy's
arrays of floats give numbers; arrays of expressions give equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from testbed.arrays import AnyArray


class Algebra(Protocol):
    """Sine, cosine, and a hook that sees every intermediate vector."""

    def sin(self, angle: AnyArray) -> AnyArray:
        """Elementwise sine."""

    def cos(self, angle: AnyArray) -> AnyArray:
        """Elementwise cosine."""

    def keep(self, name: str, value: AnyArray) -> AnyArray:
        """Called on each intermediate; what it returns is used from there on.

        Args:
            name: What the vector is, such as "w3".
            value: The vector or matrix.
        """


class Link(Protocol):
    """A joint's geometry: a `Joint`, or one whose lengths and axes are symbols."""

    @property
    def parent(self) -> int:
        """Index of the carrying body, -1 for the bedplate."""

    @property
    def revolute(self) -> bool:
        """Whether the joint turns (else it slides)."""

    @property
    def axis(self) -> AnyArray:
        """Unit vector e^j in body j's frame, (3,)."""

    @property
    def offset(self) -> AnyArray:
        """From O^i to the joint's attachment point, frame i, (3,)."""

    @property
    def rotation(self) -> AnyArray:
        """From frame j at q = 0 to frame i, (3, 3)."""


class Skeleton(Protocol):
    """A tree's geometry: a `Tree`, or one on paper."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def joints(self) -> Sequence[Link]:
        """One a body, parents first."""


class Numbers:
    """NumPy's floats; nothing is kept."""

    def sin(self, angle: AnyArray) -> AnyArray:
        """Elementwise sine."""
        return np.asarray(np.sin(angle))

    def cos(self, angle: AnyArray) -> AnyArray:
        """Elementwise cosine."""
        return np.asarray(np.cos(angle))

    def keep(self, name: str, value: AnyArray) -> AnyArray:
        """The value itself."""
        del name  # numbers need no names
        return value


NUMBERS = Numbers()
