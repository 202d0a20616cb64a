"""Constant error of the plate's zero."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from testbed.core.base.arrays import Array, apply
from testbed.core.dynamics.newton_euler import wrench_transforms
from testbed.core.recordings.recording import Recording
from testbed.core.robot.tree import Tree
from testbed.sensors.kind_table import SIGN, PerAxis
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import Coefficient, PlateError, of_channels


@dataclass(frozen=True)
class PlateBias(PlateError):
    """A constant error of the zero.

    Source    Zero error of amplifiers in data sheets: 0.2 to 0.5 % of full scale.

    Attributes:
        force: What the forces show too much [N].
        moment: What the moments show too much [N m].
    """

    kind: ClassVar[str] = "plate_bias"
    term: ClassVar[str] = "bias"
    fixed: ClassVar[tuple[Coefficient, ...]] = of_channels("bias")
    stage: ClassVar[StageOrder] = StageOrder.NOISE
    tested: ClassVar[bool] = False
    of_one_recording: ClassVar[bool] = True
    added: ClassVar[bool] = True
    force: Annotated[PerAxis, SIGN] = 2.0
    moment: Annotated[PerAxis, SIGN] = 0.5

    @classmethod
    def coefficients(cls, tree: Tree) -> tuple[Coefficient, ...]:
        """Constants of the channels, (6,), then those of the force sensors after the plate."""
        cuts = (of_channels(f"{cls.term}/{cut.name}") for cut in tree.cuts)
        return sum(cuts, cls.fixed)

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Wrench plus the constants, (M, 6) [N, N m]."""
        del time
        return signal + values

    @classmethod
    def undo(
        cls, recording: Recording, values: Array, time: Array, tree: Tree
    ) -> Recording:
        """Recording without constants; those of the next force sensors turn with the links."""
        del time
        plate, *others = values.reshape(-1, 6)
        wrench = recording.measured("wrench") - plate
        transforms = (
            wrench_transforms(tree, recording.position).values() if others else ()
        )
        for wrench_transform, constants in zip(transforms, others, strict=True):
            wrench = wrench + apply(wrench_transform, constants)
        return replace(recording, wrench=wrench)

    @classmethod
    def columns(cls, predicted: PredictedWrench) -> Array:
        """Unit matrices, and the wrenches that constants of the next sensors make."""
        rows = np.broadcast_to(np.eye(6), (len(predicted.time), 6, 6))
        if not predicted.tree.cuts:
            return rows
        moved = [*wrench_transforms(predicted.tree, predicted.motion.q).values()]
        return np.concatenate(
            [rows, predicted.rows(-np.concatenate(moved, axis=2))], axis=2
        )

    measured_columns = columns
