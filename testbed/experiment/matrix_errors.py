"""A plate's matrix as a run estimated it: what was wrong with it, and what is left open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array, readonly
from testbed.experiment.run import Run
from testbed.recordings.columns import AXES

SAID = "of what the channel (row) reaches, by what the component (column) reaches [%]"
"""What the numbers are parts of."""


@dataclass(frozen=True, eq=False)
class MatrixErrors:
    """In parts of what the channel reaches, by what the component reaches [%].

    Attributes:
        error: Of the plate as it is, (6, 6): what calibration takes away.
        sigma: Of the calibration, (6, 6): what it leaves.
    """

    error: Array
    sigma: Array

    def __post_init__(self) -> None:
        for name in ("error", "sigma"):
            object.__setattr__(self, name, readonly(getattr(self, name), (6, 6), name))

    @property
    def most(self) -> float:
        """The largest of all, without sign [%]."""
        return float(max(np.abs(self.error).max(), self.sigma.max()))


def matrix_errors(run: Run) -> MatrixErrors | None:
    """Of a run in which the plate's matrix was estimated; else None.

    Args:
        run: The run.
    """
    external = run.estimates.get("external")
    found = {n.name: n for n in external.nuisances} if external is not None else {}
    if not any(name.startswith("crosstalk/") for name in found) or run.recording.wrench is None:
        return None
    error, sigma = np.zeros((2, 6, 6))
    for i, shown in enumerate(AXES):
        for j, felt in enumerate(AXES):
            number = found.get(f"gain/{shown}" if i == j else f"crosstalk/{shown}/{felt}")
            if number is not None:
                error[i, j], sigma[i, j] = number.value - (i == j), number.sigma
    reach = np.abs(run.recording.wrench).max(axis=0)
    share = 100 * np.outer(1 / np.where(reach > 0, reach, 1.0), reach)
    return MatrixErrors(error * share, sigma * share)
