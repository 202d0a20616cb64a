"""How a mapping has read a plate: turn, place and units of its sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.transform import Transform
from testbed.core.robot.rotations import from_rpy
from testbed.importing.check.remedies import place_of, tables_of
from testbed.importing.foreign_table import FORCES, MOMENTS, plain


@dataclass(frozen=True, eq=False)
class Frame:
    """Frame and units by which a mapping reads the force plate.

    Attributes:
        turn: Of the sensor's frame, (3, 3).
        place: Of its origin, (3,) [m].
        units: Of forces and moments.
    """

    turn: Array
    place: Array
    units: tuple[str, str]

    @cached_property
    def map_inverse(self) -> Array:
        """Matrix from wrenches in the bedplate's frame to the sensor's frame, (6, 6)."""
        return Transform(self.turn, self.place).inverse.wrench_matrix

    def map(
        self,
        turn: Array,
        units: tuple[str, str],
        order: Sequence[int],
        ratio: float = 1.0,
    ) -> Array:
        """Matrix from wrenches read by this frame to wrenches read by another one, (6, 6).

        Both are along and about the bedplate's frame [N, N m].

        Args:
            turn: Of the sensor's frame, (3, 3).
            units: Of forces and moments.
            order: In which column each channel is.
            ratio: Times that moments are larger than in these units.
        """
        size = np.repeat([FORCES[units[0]], ratio * MOMENTS[units[1]]], 3)
        own_size = np.repeat([FORCES[self.units[0]], MOMENTS[self.units[1]]], 3)
        columns = np.eye(6)[list(order)] * np.outer(size, 1 / own_size)
        return Transform(turn, self.place).wrench_matrix @ columns @ self.map_inverse


def frame_of(mapping: Mapping[str, Any]) -> Frame:
    """Frame and units of a mapping's only force plate; else the bedplate's own frame in SI.

    Args:
        mapping: What the recording's mapping file says; empty if it has none.
    """
    tables = tables_of(mapping, "wrench")
    table = next(
        (each for name, each in tables.items() if not name.startswith("plates.")), {}
    )
    rpy, xyz = place_of(table)
    force, moment = (plain(each) for each in table.get("units", ("N", "N m")))
    return Frame(from_rpy(rpy), xyz, (force, moment))


def unit_ratio(units: tuple[str, str]) -> float:
    """Unit of moments over unit of forces [m].

    Args:
        units: Of forces and moments.
    """
    return MOMENTS[units[1]] / FORCES[units[0]]
