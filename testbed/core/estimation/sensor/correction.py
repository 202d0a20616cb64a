"""Covariance of a plate calibration, as constraints on coefficients of sensor errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.estimation.regression.constraints import LinearConstraints
from testbed.core.robot.tree import Tree
from testbed.sensors.catalogue import estimable_errors
from testbed.sensors.systematic_error import SystematicError


@dataclass(frozen=True, eq=False)
class CalibrationCovariance:
    """Covariance of the sensor coefficients used to correct a recording.

    Attributes:
        names: Names of the coefficients, (k,).
        root: Square root R of the covariance R R' of the coefficients, (k, r).
    """

    names: tuple[str, ...]
    root: Array

    def __post_init__(self) -> None:
        shape = (len(self.names), np.shape(self.root)[-1])
        freeze_arrays(self, root=shape)

    def calibrated_errors(
        self, tree: Tree, estimated: Sequence[type[SystematicError]]
    ) -> list[type[SystematicError]]:
        """Sensor errors with calibrated coefficients that are not among the estimated errors.

        Errors whose coefficients differ between recordings are excluded.

        Args:
            tree: Robot.
            estimated: Sensor errors that are estimated.
        """
        names = set(self.names)
        return [
            error
            for error in estimable_errors()
            if error not in estimated
            and not error.of_one_recording
            and names & {coefficient.name for coefficient in error.coefficients(tree)}
        ]

    def with_calibration(
        self,
        constraints: LinearConstraints,
        neutral: dict[str, float],
        unknowns: Sequence[str],
    ) -> LinearConstraints:
        """Constraints extended by neutral sensor coefficients with the calibration's covariance.

        After correction, the coefficients have neutral values except for errors of the calibration.

        Args:
            constraints: Constraints on the unknowns.
            neutral: Values of the coefficients for sensors without errors, by name.
            unknowns: Names of all unknowns, in the order of the constraints' columns.
        """
        rows = np.zeros((len(neutral), len(unknowns)))
        rows[range(len(neutral)), [list(unknowns).index(name) for name in neutral]] = (
            1.0
        )
        root = np.zeros((len(neutral), self.root.shape[1]))
        for row, name in zip(root, neutral, strict=True):
            if name in self.names:
                row[:] = self.root[self.names.index(name)]
        return replace(
            constraints,
            names=(*constraints.names, *neutral),
            rows=np.vstack([constraints.rows, rows]),
            values=np.append(constraints.values, list(neutral.values())),
            root=block_diag(constraints.root, root),
            scale=np.vstack([constraints.scale, np.zeros_like(rows)]),
            present_scale=np.append(constraints.present_scale, np.zeros(len(neutral))),
        )
