"""Uncertainty of a calibration, as constraints on coefficients of sensor errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from testbed.core.base.arrays import Array, freeze
from testbed.core.estimation.regression.constraints import LinearConstraints
from testbed.core.robot.tree import Tree
from testbed.sensors.catalogue import estimable_errors
from testbed.sensors.systematic_error import SystematicError


@dataclass(frozen=True, eq=False)
class CalibrationCovariance:
    """Doubt about numbers of the plate that were taken back from a recording.

    Attributes:
        names: Of the numbers, (k,).
        root: R with R R' their covariance, (k, r).
    """

    names: tuple[str, ...]
    root: Array

    def __post_init__(self) -> None:
        shape = (len(self.names), np.shape(self.root)[-1])
        freeze(self, root=shape)

    def nuisances(
        self, tree: Tree, asked: Sequence[type[SystematicError]]
    ) -> list[type[SystematicError]]:
        """Sensor errors of these coefficients, but for those that are estimated anyway.

        Args:
            tree: The robot.
            asked: Those that are estimated.
        """
        named = set(self.names)
        return [
            n
            for n in estimable_errors()
            if n not in asked
            and not n.of_one_recording
            and named & {each.name for each in n.coefficients(tree)}
        ]

    def added(
        self, given: LinearConstraints, right: dict[str, float], unknowns: Sequence[str]
    ) -> LinearConstraints:
        """Facts with those about the plate: numbers are as they should be, but for the doubt.

        Args:
            given: Facts about the unknowns.
            right: Values of the plate's numbers where nothing is wrong, by name.
            unknowns: Names of all unknowns, in the order of the facts' columns.
        """
        rows = np.zeros((len(right), len(unknowns)))
        rows[range(len(right)), [list(unknowns).index(name) for name in right]] = 1.0
        root = np.zeros((len(right), self.root.shape[1]))
        for row, name in zip(root, right, strict=True):
            if name in self.names:
                row[:] = self.root[self.names.index(name)]
        return replace(
            given,
            names=(*given.names, *right),
            rows=np.vstack([given.rows, rows]),
            values=np.append(given.values, list(right.values())),
            root=block_diag(given.root, root),
            scale=np.vstack([given.scale, np.zeros_like(rows)]),
            reached=np.append(given.reached, np.zeros(len(right))),
        )
