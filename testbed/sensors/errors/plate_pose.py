"""Pose error of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.transform import Transform
from testbed.core.robot.rotations import rotvec_to_matrix
from testbed.sensors.kind_table import RANDOM_SIGN, PerAxis
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import Coefficient, PlateError


@dataclass(frozen=True)
class PlatePose(PlateError):
    """Rotation and translation of the plate relative to the bedplate frame.

    The frame of the plate has the origin p and the axes R, both in the bedplate frame. The reading
    is R^T F and R^T (M - p x F), for the robot as well as for the tare.

    Source    Alignment with square and ruler: 0.2 degrees, 1 mm.

    Attributes:
        rotation: Rotation vector of R [rad].
        translation: Translation p [m].
    """

    kind: ClassVar[str] = "plate_pose"
    term: ClassVar[str] = "pose"
    fixed: ClassVar[tuple[Coefficient, ...]] = tuple(
        Coefficient(f"pose/{part}{axis}", unit)
        for part, unit in (("r", "rad"), ("p", "m"))
        for axis in "xyz"
    )
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    rotation: Annotated[PerAxis, RANDOM_SIGN] = 3.5e-3
    translation: Annotated[PerAxis, RANDOM_SIGN] = 1e-3

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench in the plate frame P, from that in the bedplate frame B, (M, 6) [N, N m]."""
        del time
        X_BP = Transform(rotvec_to_matrix(values[:3]), values[3:])
        return np.asarray(X_BP.inverse.wrench(signal))

    @classmethod
    def corrected_signal(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench in the bedplate frame B, from that in the plate frame P, (M, 6) [N, N m]."""
        del time
        X_BP = Transform(rotvec_to_matrix(values[:3]), values[3:])
        return np.asarray(X_BP.wrench(signal))

    @classmethod
    def derivative(cls, signal: Array, time: Array, neutral: Array) -> Array:
        """Derivative with respect to rotation and translation, at zero, (M, 6, 6).

        The columns are cross products of force and moment with the axes.
        """
        del time, neutral
        force, moment = signal[:, :3], signal[:, 3:]
        columns = np.zeros((len(signal), 6, 6))
        for k, axis in enumerate(np.eye(3)):
            columns[:, :3, k] = columns[:, 3:, 3 + k] = np.cross(force, axis)
            columns[:, 3:, k] = np.cross(moment, axis)
        return columns
