"""What the recursions need from numbers, so that symbols can take their place.

The recursions of this room use +, -, *, @ on arrays and the three functions below. NumPy's
arrays of floats give numbers; arrays of expressions give equations.
"""

from __future__ import annotations

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
