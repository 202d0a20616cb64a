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
    """How a mapping has read the plate.

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
        """The wrench in the sensor's frame of one in the bedplate's, (6, 6)."""
        return Transform(self.turn, self.place).inverse.wrench_matrix

    def map(
        self,
        turn: Array,
        units: tuple[str, str],
        order: Sequence[int],
        ratio: float = 1.0,
    ) -> Array:
        """The wrench in the bedplate's frame by another reading, of that by this one, (6, 6).

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
    """How a mapping has read its plate; as the bedplate's own where it has none, or several.

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
    """What one of a moment's unit is in SI, for one of a force's.

    Args:
        units: Of forces and moments.
    """
    return MOMENTS[units[1]] / FORCES[units[0]]
