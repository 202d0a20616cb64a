"""Gaussian distributions of named parameters: estimates, and what is known before data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.codec import with_properties
from testbed.core.base.errors import plural
from testbed.core.base.frames import frame_of
from testbed.core.base.summary_table import Summarized, SummaryTable, parameter_rows


@dataclass(frozen=True, eq=False, repr=False)
class Gaussian(Summarized):
    """Gaussian distribution of named parameters.

    Attributes:
        names: (p,).
        units: One a parameter, (p,).
        values: Mean, (p,).
        covariance: (p, p); of parameters that are not identifiable a choice.
        unidentifiable: Names of parameters that the data do not determine.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    covariance: Array
    unidentifiable: tuple[str, ...] = ()

    __get_pydantic_core_schema__ = with_properties("sigma")

    def __post_init__(self) -> None:
        p = len(self.names)
        freeze(self, values=(p,), covariance=(p, p))

    @cached_property
    def identifiable(self) -> NDArray[np.bool_]:
        """Whether the data determine each parameter, (p,)."""
        return np.array([name not in self.unidentifiable for name in self.names], dtype=bool)

    @cached_property
    def sigma(self) -> Array:
        """Standard deviations, (p,); infinite of parameters that are not identifiable."""
        spread = np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))
        return np.where(self.identifiable, spread, np.inf)

    def marginal(self, names: Sequence[str]) -> Gaussian:
        """Distribution of some of the parameters.

        Args:
            names: Of these, in this order.
        """
        at = [self.names.index(name) for name in names]
        return Gaussian(
            tuple(names),
            tuple(self.units[k] for k in at),
            self.values[at],
            self.covariance[np.ix_(at, at)],
            tuple(name for name in names if name in self.unidentifiable),
        )

    @property
    def summary(self) -> SummaryTable:
        """Names, values with standard deviations, units."""
        rows = parameter_rows(self.names, self.values, self.sigma, self.units)
        return SummaryTable(plural(len(self.names), "parameter"), rows)

    def to_frame(self) -> Any:
        """Names, values, standard deviations and units as a frame of pandas, polars or Arrow."""
        columns = {
            "name": list(self.names),
            "value": self.values.tolist(),
            "sigma": self.sigma.tolist(),
            "unit": list(self.units),
        }
        return frame_of(columns)
