"""Estimates of model errors, and their effect on the unknowns."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    solve_scaled,
)
from testbed.core.estimation.sensor.estimates import NuisanceEstimate

MIN_RELATIVE_VARIANCE = 1e-12
"""Variance of a direction of the unknowns, relative to the others, below which it is known."""


@dataclass(frozen=True, eq=False)
class ModelErrorEstimate:
    """Estimated model error of one family, which is a type of model error.

    Attributes:
        family: Unique key (`kind`) of the family.
        label: Name for reports.
        meaning: Cause in the robot.
        remedy: Remedy for the user.
        gain: Gain of the restricted log likelihood due to the family [nats].
        physical: True if the columns follow from a physical law.
        named: True if the gain is at least MIN_NAMED_GAIN: the family is reported as the cause.
        corrected: True if the error is subtracted from the measurements.
        effect: Rms of the error in each channel, without the part collinear with the unknowns, (C,)
            [N, N m].
        share: Effect relative to the rms residual of the unknowns alone, (C,).
        coefficients: Reported coefficients in order of decreasing significance; empty for most
            families.
    """

    family: str
    label: str
    meaning: str
    remedy: str
    gain: float
    physical: bool
    named: bool
    corrected: bool
    effect: Array
    share: Array
    coefficients: tuple[NuisanceEstimate, ...] = ()


@dataclass(frozen=True, eq=False)
class SignalSizes:
    """Greatest magnitudes of signals in a recording, used to scale plausible model errors.

    Attributes:
        torque: Joint torques, (n,) [N m or N].
        wrench: Base wrench, (6,) [N, N m].
        speed: Joint speeds, (n,) [rad/s or m/s].
        acceleration: Joint accelerations, (n,) [rad/s^2 or m/s^2].
        range: Distances of the positions from their means, (n,) [rad or m].
        middle: Mean positions, (n,) [rad or m].
        duration: Half the duration of the recording [s].
    """

    torque: Array
    wrench: Array
    speed: Array
    acceleration: Array
    range: Array
    middle: Array
    duration: float


@dataclass(frozen=True, eq=False)
class ModelErrorCorrection:
    """Coefficients of model errors, from which the errors in any recording are predicted.

    Attributes:
        families: Kinds of the families.
        counts: Number of columns of each family.
        columns: Column indices used in each family; () for all columns of the family.
        coefficients: Coefficients relative to the plausible sizes of the errors, (k,).
        spread: Second moments of the coefficients' errors, (k, k).
        gain: Change of the unknowns per coefficient if the errors are not subtracted, (p, k).
        sizes: Signal magnitudes of the recording from which the coefficients were estimated.
    """

    families: tuple[str, ...]
    counts: tuple[int, ...]
    columns: tuple[tuple[int, ...], ...]
    coefficients: Array
    spread: Array
    gain: Array
    sizes: SignalSizes

    @property
    def covariance(self) -> Array:
        """Covariance of the unknowns due to the coefficients' errors, (p, p)."""
        return np.asarray(self.gain @ self.spread @ self.gain.T)

    def for_families(self, kinds: Collection[str]) -> ModelErrorCorrection:
        """Correction restricted to the given families.

        Args:
            kinds: Kinds of the families.
        """
        flags = np.array([kind in kinds for kind in self.families])
        column_flags = np.repeat(flags, self.counts)
        return replace(
            self,
            families=tuple(np.array(self.families)[flags].tolist()),
            counts=tuple(np.array(self.counts)[flags].tolist()),
            columns=tuple(
                c for c, flag in zip(self.columns, flags, strict=True) if flag
            ),
            coefficients=self.coefficients[column_flags],
            spread=self.spread[np.ix_(column_flags, column_flags)],
            gain=self.gain[:, column_flags],
        )


@dataclass(frozen=True, eq=False)
class RepeatableError:
    """Part of the residuals that repeats with the motion.

    Attributes:
        period: Period of the motion, or duration that the recordings have in common [s].
        recordings: Number of recordings compared; 1 for periods of one recording.
        chance: P-value of the F test, the probability of an equally large repetition in noise
            alone.
        rms: Rms of the repeatable part in each channel, (C,) [N, N m].
        share: Share of the repeatable part in each channel's squared residual, (C,).
    """

    period: float
    recordings: int
    chance: float
    rms: Array
    share: Array

    @property
    def repetition_text(self) -> str:
        """Phrase that describes the repetition: "in 3 recordings of it", or "every 2.5 s"."""
        if self.recordings > 1:
            return f"in {self.recordings} recordings of it"
        return f"every {self.period:.4g} s"


@dataclass(frozen=True, eq=False)
class ModelErrorEffect:
    """Effect of model errors with uncertain coefficients on the unknowns.

    Attributes:
        spread: Second moments of the coefficients' errors after the correction, (k, k).
        information: Information matrix X' X of the unknowns, with rows in units of the noise,
            (p, p).
        cross: Products X' Z of the columns of unknowns and coefficients, (p, k).
    """

    spread: Array
    information: Array
    cross: Array

    def root(self, covariance: Array, prior: Array | None = None) -> Array:
        """Factor A of the covariance A A' that model errors add to the unknowns, (p, k).

        Args:
            covariance: Covariance of the unknowns without model errors, (p, p).
            prior: Prior covariance of the unknowns, (p, p); None for no prior.
        """
        sizes, axes = eigh(self.spread)
        size = np.sqrt(np.maximum(sizes, 0.0))
        return np.asarray(self.gain(covariance, prior) @ (axes * size))

    def gain(self, covariance: Array, prior: Array | None = None) -> Array:
        """Sensitivity of the estimated unknowns to the error coefficients, (p, k).

        It is (J + P^-1)^-1 X' Z, where J is the information and P the prior covariance.

        Args:
            covariance: Covariance of the unknowns without model errors, (p, p); directions with a
                relative variance below MIN_RELATIVE_VARIANCE stay fixed.
            prior: Prior covariance of the unknowns, (p, p); None for no prior.
        """
        information = self.information
        if prior is not None:
            information = information + np.linalg.pinv(prior, hermitian=True)
        scale = np.sqrt(np.maximum(np.diagonal(covariance), SMALLEST_POSITIVE))
        spread, directions = eigh(covariance / np.outer(scale, scale))
        free = scale[:, None] * directions[:, spread > MIN_RELATIVE_VARIANCE]
        right = free.T @ self.cross
        return np.asarray(free @ solve_scaled(free.T @ information @ free, right))
