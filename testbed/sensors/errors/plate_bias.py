"""Constant zero error of the plate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from testbed.core.base.arrays import Array, multiply_vectors
from testbed.core.dynamics.newton_euler import wrench_transforms
from testbed.core.recordings.recording import Recording
from testbed.core.robot.tree import Tree
from testbed.sensors.kind_table import RANDOM_SIGN, PerAxis
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import (
    Coefficient,
    PlateError,
    channel_coefficients,
)


@dataclass(frozen=True)
class PlateBias(PlateError):
    """Zero error: a constant offset of each channel.

    Source    Zero error of amplifiers in data sheets: 0.2 to 0.5 % of full scale.

    Attributes:
        force: Offset of the forces [N].
        moment: Offset of the moments [N m].
    """

    kind: ClassVar[str] = "plate_bias"
    term: ClassVar[str] = "bias"
    fixed: ClassVar[tuple[Coefficient, ...]] = channel_coefficients("bias")
    stage: ClassVar[StageOrder] = StageOrder.NOISE
    tested: ClassVar[bool] = False
    of_one_recording: ClassVar[bool] = True
    added: ClassVar[bool] = True
    force: Annotated[PerAxis, RANDOM_SIGN] = 2.0
    moment: Annotated[PerAxis, RANDOM_SIGN] = 0.5

    @classmethod
    def coefficients(cls, tree: Tree) -> tuple[Coefficient, ...]:
        """Offsets of the plate's channels, (6,), then offsets of the further force sensors."""
        cuts = (channel_coefficients(f"{cls.term}/{cut.name}") for cut in tree.cuts)
        return sum(cuts, cls.fixed)

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench plus the offsets, (M, 6) [N, N m]."""
        del time
        return signal + values

    @classmethod
    def corrected_recording(
        cls, recording: Recording, values: Array, time: Array, tree: Tree
    ) -> Recording:
        """Recording without the offsets of plate and force sensors.

        Offsets of force sensors in the robot are transformed to the bedplate for each posture.
        """
        del time
        plate_offset, *sensor_offsets = values.reshape(-1, 6)
        wrench = recording.measured("wrench") - plate_offset
        transforms = (
            wrench_transforms(tree, recording.position).values()
            if sensor_offsets
            else ()
        )
        for wrench_transform, offset in zip(transforms, sensor_offsets, strict=True):
            wrench = wrench + multiply_vectors(wrench_transform, offset)
        return replace(recording, wrench=wrench)

    @classmethod
    def regressor_columns(cls, predicted: PredictedWrench) -> Array:
        """Regressor columns of the offsets of plate and force sensors, (rows, 6, k).

        The columns are the identity for the first sensor (or the plate), and the negative filtered
        wrench transform to the first sensor for each further force sensor.
        """
        rows = np.broadcast_to(np.eye(6), (len(predicted.time), 6, 6))
        if not predicted.tree.cuts:
            return rows
        transforms = [*wrench_transforms(predicted.tree, predicted.motion.q).values()]
        return np.concatenate(
            [rows, predicted.filter_signals(-np.concatenate(transforms, axis=2))],
            axis=2,
        )

    columns_from_measured = regressor_columns
