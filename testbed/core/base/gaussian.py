"""Gaussian distributions of named parameters: estimates and priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.codec import schema_with_properties
from testbed.core.base.errors import count_with_noun
from testbed.core.base.frames import data_frame
from testbed.core.base.summary_table import Summarized, SummaryTable, parameter_rows


@dataclass(frozen=True, eq=False, repr=False)
class Gaussian(Summarized):
    """Gaussian distribution of named parameters.

    Attributes:
        names: Parameter names, (p,).
        units: Units of the parameters, (p,).
        values: Mean, (p,).
        covariance: Covariance, (p, p); arbitrary for parameters that are not identifiable.
        unidentifiable: Names of parameters that the data do not determine.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    covariance: Array
    unidentifiable: tuple[str, ...] = ()

    __get_pydantic_core_schema__ = schema_with_properties("sigma")

    def __post_init__(self) -> None:
        p = len(self.names)
        freeze_arrays(self, values=(p,), covariance=(p, p))

    @cached_property
    def identifiable(self) -> NDArray[np.bool_]:
        """Mask of the parameters that the data determine, (p,)."""
        return np.array(
            [name not in self.unidentifiable for name in self.names], dtype=bool
        )

    @cached_property
    def sigma(self) -> Array:
        """Standard deviations, (p,); infinite for parameters that are not identifiable."""
        spread = np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))
        return np.where(self.identifiable, spread, np.inf)

    def marginal(self, names: Sequence[str]) -> Gaussian:
        """Marginal distribution of some parameters.

        Args:
            names: Names of these parameters, in the order of the result.
        """
        indices = [self.names.index(name) for name in names]
        return Gaussian(
            tuple(names),
            tuple(self.units[k] for k in indices),
            self.values[indices],
            self.covariance[np.ix_(indices, indices)],
            tuple(name for name in names if name in self.unidentifiable),
        )

    def transform(
        self, matrix: Array, names: Sequence[str], units: Sequence[str]
    ) -> Gaussian:
        """Distribution of linear combinations of the parameters.

        A combination is unidentifiable if it contains a parameter that is not identifiable.

        Args:
            matrix: Coefficients of the combinations, (k, p).
            names: Names of the combinations, (k,).
            units: Units of the combinations, (k,).
        """
        is_unidentifiable = (np.asarray(matrix)[:, ~self.identifiable] != 0).any(axis=1)
        return Gaussian(
            tuple(names),
            tuple(units),
            matrix @ self.values,
            matrix @ self.covariance @ matrix.T,
            tuple(compress(names, is_unidentifiable)),
        )

    def conditional(
        self, matrix: Array, values: Array, covariance: ArrayLike = 0.0
    ) -> Gaussian:
        """Conditional distribution given `matrix @ parameters = values + e`, with an error e.

        This is the update step of the Kalman filter, with the covariance in Joseph form.

        Args:
            matrix: Combinations of identifiable parameters, (k, p).
            values: Values of the combinations, (k,).
            covariance: Covariance of e, (k, k); zero for exact constraints.
        """
        noise = np.broadcast_to(covariance, (len(matrix),) * 2)
        cross_covariance = matrix @ self.covariance
        gain = np.linalg.solve(cross_covariance @ matrix.T + noise, cross_covariance).T
        projection = np.eye(len(self.names)) - gain @ matrix
        return replace(
            self,
            values=self.values + gain @ (values - matrix @ self.values),
            covariance=projection @ self.covariance @ projection.T
            + gain @ noise @ gain.T,
        )

    def sample(self, count: int, seed: int = 0) -> Array:
        """Random samples, (count, p); NaN for parameters that are not identifiable.

        Args:
            count: Number of samples.
            seed: Seed of the random numbers.
        """
        rng = np.random.default_rng(seed)
        draws = rng.multivariate_normal(
            self.values, self.covariance, count, method="eigh"
        )
        return np.where(self.identifiable, draws, np.nan)

    @property
    def summary(self) -> SummaryTable:
        """Table of names, values with standard deviations, and units."""
        rows = parameter_rows(self.names, self.values, self.sigma, self.units)
        return SummaryTable(count_with_noun(len(self.names), "parameter"), rows)

    def to_frame(self) -> Any:
        """Data frame with names, values, standard deviations and units of the parameters."""
        columns = {
            "name": list(self.names),
            "value": self.values.tolist(),
            "sigma": self.sigma.tolist(),
            "unit": list(self.units),
        }
        return data_frame(columns)
