"""Frame and units of a force plate according to a mapping."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.transform import Transform
from testbed.core.robot.rotations import rpy_to_matrix
from testbed.importing.check.remedies import sensor_placement, signal_tables
from testbed.importing.foreign_table import FORCE_UNITS, MOMENT_UNITS, canonical_unit


@dataclass(frozen=True, eq=False)
class PlateFrame:
    """Frame and units of the force plate according to a mapping.

    Attributes:
        rotation: Rotation matrix from the sensor frame to the bedplate frame, (3, 3).
        origin: Origin of the sensor frame in the bedplate frame, (3,) [m].
        units: Units of forces and moments.
    """

    rotation: Array
    origin: Array
    units: tuple[str, str]

    @cached_property
    def wrench_to_sensor(self) -> Array:
        """Matrix that transforms wrenches from the bedplate frame to the sensor frame, (6, 6)."""
        return Transform(self.rotation, self.origin).inverse.wrench_matrix

    def map(
        self,
        rotation: Array,
        units: tuple[str, str],
        order: Sequence[int],
        ratio: float = 1.0,
    ) -> Array:
        """Matrix that converts wrenches recorded with this frame to another frame, (6, 6).

        Both wrenches are expressed in the bedplate frame, about its origin [N, N m].

        Args:
            rotation: Rotation matrix of the other sensor frame, (3, 3).
            units: Units of forces and moments.
            order: Column index of each channel.
            ratio: Additional factor on the moments.
        """
        size = np.repeat([FORCE_UNITS[units[0]], ratio * MOMENT_UNITS[units[1]]], 3)
        own_size = np.repeat(
            [FORCE_UNITS[self.units[0]], MOMENT_UNITS[self.units[1]]], 3
        )
        columns = np.eye(6)[list(order)] * np.outer(size, 1 / own_size)
        return (
            Transform(rotation, self.origin).wrench_matrix
            @ columns
            @ self.wrench_to_sensor
        )


def plate_frame_of(mapping: Mapping[str, Any]) -> PlateFrame:
    """Frame and units of a mapping's only force plate; otherwise bedplate frame and SI.

    Args:
        mapping: Content of the recording's mapping file; empty if there is no mapping.
    """
    tables = signal_tables(mapping, "wrench")
    table = next(
        (each for name, each in tables.items() if not name.startswith("plates.")), {}
    )
    rpy, xyz = sensor_placement(table)
    force, moment = (canonical_unit(each) for each in table.get("units", ("N", "N m")))
    return PlateFrame(rpy_to_matrix(rpy), xyz, (force, moment))


def unit_ratio(units: tuple[str, str]) -> float:
    """Ratio of the unit of moments to the unit of forces [m].

    Args:
        units: Units of forces and moments.
    """
    return MOMENT_UNITS[units[1]] / FORCE_UNITS[units[0]]
