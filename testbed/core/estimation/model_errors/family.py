"""Base classes of families (types) of model errors, given by columns of plausible size."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.robot.tree import Tree


def block_diagonal_columns(columns: Array) -> Array:
    """Block-diagonal columns, (C, R, C k), from k columns of each channel, (C, R, k)."""
    channels, rows, count = columns.shape
    columns_out = np.zeros((channels, rows, channels, count))
    columns_out[range(channels), :, range(channels)] = columns
    return columns_out.reshape(channels, rows, -1)


class ModelErrorFamily(ABC):
    """Base class of families (types) of model errors that are linear in their coefficients.

    A coefficient of one corresponds to an error of plausible size. Concrete families are defined in
    the modules of `families`; `SensorFamily` represents a sensor error.
    """

    kind: str
    """Unique key."""
    label: str
    """Name for reports."""
    meaning: str
    """Cause in the robot."""
    remedy: str
    """Remedy for the user."""
    methods: tuple[Signal, ...] = SIGNALS
    """Methods whose measurements show the error."""
    physical: bool = True
    """True if columns follow from a physical law; else they are features of state or time."""
    lasting: bool = True
    """True if other motions of the robot have the same error."""
    is_term: bool = False
    """True for a law of joint torque that should be among the unknowns. It is not subtracted from
    the measurements: friction without it predicts no torques."""
    noisy: bool = False
    """True if encoder noise enters the columns and the residuals, by accelerations or signs."""
    alternatives: int = 1
    """Number of alternative pairs of columns, of which the best pair of each joint is used; columns
    are ordered by joint, then by alternative."""

    def applies(self, point: Linearization) -> bool:
        """True if the robot can have the error.

        Args:
            point: Motion and predicted forces about which the error is linearised.
        """
        del point
        return True

    def coefficient_scales(self, tree: Tree) -> Sequence[tuple[str, str, float]]:
        """Names, units and plausible sizes of coefficients to be reported; empty by default.

        Args:
            tree: Kinematic tree of the robot.
        """
        del tree
        return ()

    @abstractmethod
    def columns(self, point: Linearization) -> Array:
        """Effects of errors of plausible size on the measurements, (m, C, k) [N, N m].

        Args:
            point: Motion at m instants and predicted forces in C channels, about which the error is
                linearised.
        """

    def selected_columns(self, point: Linearization, indices: Sequence[int]) -> Array:
        """Columns with the given indices, (m, C, k); all columns for empty indices.

        Args:
            point: Motion and predicted forces about which the error is linearised.
            indices: Column indices.
        """
        columns = self.columns(point)
        return columns[:, :, list(indices)] if indices else columns


class JointFamily(ModelErrorFamily):
    """Model errors in the torques of single joints, with separate coefficients for each joint."""

    methods: tuple[Signal, ...] = ("torque",)

    def columns(self, point: Linearization) -> Array:
        """Effects on the torques, with separate columns for each joint, (m, n, n k) [N m or N]."""
        return block_diagonal_columns(self.torques(point).transpose(1, 0, 2)).transpose(
            1, 0, 2
        )

    def selected_columns(self, point: Linearization, indices: Sequence[int]) -> Array:
        """Columns with the given indices, (m, n, k); all columns for empty indices.

        With c columns in `torques`, column index c j + i denotes column i of joint j, which is zero
        for other joints. Only the selected columns are assembled.

        Args:
            point: Motion at m instants and predicted forces about which the error is linearised.
            indices: Column indices.
        """
        if not indices:
            return self.columns(point)
        torques = self.torques(point)
        columns = np.zeros((*torques.shape[:2], len(indices)))
        for k, index in enumerate(indices):
            joint, column = divmod(index, torques.shape[2])
            columns[:, joint, k] = torques[:, joint, column]
        return columns

    @abstractmethod
    def torques(self, point: Linearization) -> Array:
        """Effects on each joint's own torque, (m, n, k) [N m or N].

        Args:
            point: Motion and predicted forces about which the error is linearised.
        """


class FrameFamily(ModelErrorFamily):
    """Model errors of joint frames or of the base."""

    def applies(self, point: Linearization) -> bool:
        """True if the base is fixed and no force sensor is inside the robot."""
        return point.has_frame_derivatives
