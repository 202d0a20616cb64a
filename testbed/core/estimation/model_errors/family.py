"""Family of model errors: columns of first order, of a plausible size each."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import METHODS, Method
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.robot.tree import Tree


def by_channel(columns: Array) -> Array:
    """Columns of each channel alone, (C, R, C k), of k columns of each, (C, R, k)."""
    channels, rows, count = columns.shape
    found = np.zeros((channels, rows, channels, count))
    found[range(channels), :, range(channels)] = columns
    return found.reshape(channels, rows, -1)


class ModelErrorFamily(ABC):
    """Model errors of one kind; a class in a module of `families`."""

    kind: str
    """Name."""
    label: str
    """What people call it."""
    meaning: str
    """What in the robot does it."""
    remedy: str
    """What to do."""
    methods: tuple[Method, ...] = METHODS
    """Methods whose measurements show it."""
    physical: bool = True
    """Whether its columns follow from a law; else they are features of the state or of time."""
    lasting: bool = True
    """Whether another motion has the same error."""
    is_term: bool = False
    """Whether it is a law of a joint's torque that should be among the unknowns: such a one is not
    taken out, since friction without it predicts no torques."""
    noisy: bool = False
    """Whether noise of the encoders is in the columns, as in residuals: accelerations, or signs."""
    alternatives: int = 1
    """Alternatives of which each joint has the best: columns are joint by joint, alternative by
    alternative."""

    def applies(self, at: Linearization) -> bool:
        """Whether the robot can have it.

        Args:
            at: Motion and forces.
        """
        del at
        return True

    def numbers(self, tree: Tree) -> Sequence[tuple[str, str, float]]:
        """Names, units and plausible sizes of the columns; none where they are no quantities.

        Args:
            tree: The robot.
        """
        del tree
        return ()

    @abstractmethod
    def columns(self, at: Linearization) -> Array:
        """Effects on what is measured, each of a plausible size, (m, C, k) [N, N m].

        Args:
            at: Motion and forces.
        """

    def some(self, at: Linearization, kept: Sequence[int]) -> Array:
        """Some of the columns, (m, C, k); all where none is named.

        Args:
            at: Motion and forces.
            kept: Which.
        """
        columns = self.columns(at)
        return columns[:, :, list(kept)] if kept else columns


class JointFamily(ModelErrorFamily):
    """Model errors of single joints' torques."""

    methods: tuple[Method, ...] = ("internal",)

    def columns(self, at: Linearization) -> Array:
        """Effects on the torques, each joint's by itself, (m, n, n k) [N m or N]."""
        return by_channel(self.torques(at).transpose(1, 0, 2)).transpose(1, 0, 2)

    def some(self, at: Linearization, kept: Sequence[int]) -> Array:
        """Some of the columns, (m, n, k); of many alternatives the others are not made."""
        if not kept:
            return self.columns(at)
        torques = self.torques(at)
        columns = np.zeros((*torques.shape[:2], len(kept)))
        for k, place in enumerate(kept):
            joint, own = divmod(place, torques.shape[2])
            columns[:, joint, k] = torques[:, joint, own]
        return columns

    @abstractmethod
    def torques(self, at: Linearization) -> Array:
        """Effects on each joint's own torque, (m, n, k) [N m or N].

        Args:
            at: Motion and forces.
        """


class FrameFamily(ModelErrorFamily):
    """Model errors of frames or base."""

    def applies(self, at: Linearization) -> bool:
        """Whether the base is fixed and the plate below it."""
        return at.with_frames
