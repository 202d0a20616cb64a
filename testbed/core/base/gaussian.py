"""Gaussian distributions of named parameters: estimates, and what is known before data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
        return np.array(
            [name not in self.unidentifiable for name in self.names], dtype=bool
        )

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

    def transform(
        self, matrix: Array, names: Sequence[str], units: Sequence[str]
    ) -> Gaussian:
        """Distribution of linear combinations of the parameters.

        Args:
            matrix: The combinations, (k, p).
            names: (k,).
            units: (k,).
        """
        open_ones = (np.asarray(matrix)[:, ~self.identifiable] != 0).any(axis=1)
        return Gaussian(
            tuple(names),
            tuple(units),
            matrix @ self.values,
            matrix @ self.covariance @ matrix.T,
            tuple(compress(names, open_ones)),
        )

    def conditional(
        self, matrix: Array, values: Array, covariance: ArrayLike = 0.0
    ) -> Gaussian:
        """Distribution given matrix @ parameters = values + e, in Joseph's form.

        Args:
            matrix: Combinations of identifiable parameters, (k, p).
            values: (k,).
            covariance: Of e, (k, k); zero for what holds exactly.
        """
        noise = np.broadcast_to(covariance, (len(matrix),) * 2)
        across = matrix @ self.covariance
        gain = np.linalg.solve(across @ matrix.T + noise, across).T
        rest = np.eye(len(self.names)) - gain @ matrix
        return replace(
            self,
            values=self.values + gain @ (values - matrix @ self.values),
            covariance=rest @ self.covariance @ rest.T + gain @ noise @ gain.T,
        )

    def sample(self, count: int, seed: int = 0) -> Array:
        """Random draws, (count, p); not a number for parameters that are not identifiable.

        Args:
            count: How many.
            seed: Of the random numbers.
        """
        rng = np.random.default_rng(seed)
        draws = rng.multivariate_normal(
            self.values, self.covariance, count, method="eigh"
        )
        return np.where(self.identifiable, draws, np.nan)

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
