"""What is estimated of model errors, and what they do to the unknowns."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.estimation.regression.normal_equations import TINY, scaled_solve
from testbed.core.estimation.sensor.estimates import NuisanceEstimate

KNOWN = 1e-12
"""Variance of a direction of the unknowns, relative to theirs, that is known."""


@dataclass(frozen=True, eq=False)
class ModelErrorEstimate:
    """Model error of one family.

    Attributes:
        family: Its kind.
        label: What people call it.
        meaning: What in the robot does it.
        remedy: What to do.
        gain: Log likelihood that it is worth [nats].
        physical: Whether its columns follow from a law.
        named: Whether its gain is beyond doubt.
        corrected: Whether it is taken out of the measurements.
        effect: Rms beside the parameters in each channel, (C,) [N, N m].
        share: The same over that of the residual without it, (C,).
        coefficients: The clearest first, where they are quantities.
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
class Sizes:
    """Greatest magnitudes in a recording, of which plausible model errors are parts.

    Attributes:
        torque: Of the joints' torques, (n,) [N m or N].
        wrench: Of the base wrench, (6,) [N, N m].
        speed: (n,) [rad/s or m/s].
        acceleration: (n,) [rad/s^2 or m/s^2].
        range: Of the positions about their means, (n,) [rad or m].
        middle: Mean positions, (n,) [rad or m].
        duration: Half that of the recording [s].
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
    """Coefficients of model errors: what they make in the measurements of any motion.

    Attributes:
        families: Kinds.
        counts: Columns of each.
        columns: Which these are of a family with alternatives; () where there are all.
        coefficients: In plausible sizes, (k,).
        spread: Second moments of the coefficients about what is true, (k, k).
        gain: Change of the unknowns by the coefficients where these are not taken out, (p, k).
        sizes: Of the recording that showed them.
    """

    families: tuple[str, ...]
    counts: tuple[int, ...]
    columns: tuple[tuple[int, ...], ...]
    coefficients: Array
    spread: Array
    gain: Array
    sizes: Sizes

    @property
    def covariance(self) -> Array:
        """What the coefficients' spread makes in the unknowns, (p, p)."""
        return np.asarray(self.gain @ self.spread @ self.gain.T)

    def of(self, kinds: Collection[str]) -> ModelErrorCorrection:
        """The part of some families.

        Args:
            kinds: Which.
        """
        kept = np.array([kind in kinds for kind in self.families])
        at = np.repeat(kept, self.counts)
        return replace(
            self,
            families=tuple(np.array(self.families)[kept].tolist()),
            counts=tuple(np.array(self.counts)[kept].tolist()),
            columns=tuple(
                c for c, keep in zip(self.columns, kept, strict=True) if keep
            ),
            coefficients=self.coefficients[at],
            spread=self.spread[np.ix_(at, at)],
            gain=self.gain[:, at],
        )


@dataclass(frozen=True, eq=False)
class RepeatableError:
    """Part of the residuals that repeats with the motion.

    Attributes:
        period: Of the motion, or of what recordings of it have in common [s].
        recordings: Number of recordings compared; 1 for periods of one.
        chance: Probability of as much in noise.
        rms: In each channel, (C,) [N, N m].
        share: In squares of the channel's residual, (C,).
    """

    period: float
    recordings: int
    chance: float
    rms: Array
    share: Array

    @property
    def again(self) -> str:
        """When the motion comes again, in words."""
        if self.recordings > 1:
            return f"in {self.recordings} recordings of it"
        return f"every {self.period:.4g} s"


@dataclass(frozen=True, eq=False)
class ModelErrorEffect:
    """Effect of model errors of uncertain coefficients on the unknowns.

    Attributes:
        spread: Second moments of what they may be beside those taken out, (k, k).
        information: Of the unknowns, (p, p).
        cross: Of unknowns and coefficients, (p, k).
    """

    spread: Array
    information: Array
    cross: Array

    def root(self, covariance: Array, prior: Array | None = None) -> Array:
        """Root of the covariance that the errors add to the unknowns, (p, k).

        Args:
            covariance: As of `gain`.
            prior: As of `gain`.
        """
        sizes, axes = eigh(self.spread)
        size = np.sqrt(np.maximum(sizes, 0.0))
        return np.asarray(self.gain(covariance, prior) @ (axes * size))

    def gain(self, covariance: Array, prior: Array | None = None) -> Array:
        """Change of the unknowns by the coefficients, (p, k).

        Args:
            covariance: Of the unknowns otherwise, (p, p): what is known stays known.
            prior: Covariance of the unknowns before the data, (p, p); None for none.
        """
        information = self.information
        if prior is not None:
            information = information + np.linalg.pinv(prior, hermitian=True)
        scale = np.sqrt(np.maximum(np.diagonal(covariance), TINY))
        spread, directions = eigh(covariance / np.outer(scale, scale))
        free = scale[:, None] * directions[:, spread > KNOWN]
        right = free.T @ self.cross
        return np.asarray(free @ scaled_solve(free.T @ information @ free, right))
