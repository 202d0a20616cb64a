"""Readings of a log of torques, and how likely each is by a robot's model file."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr

from testbed.core.base.arrays import Array
from testbed.core.estimation.evidence import (
    FEWEST,
    ChannelProducts,
    Evidence,
    evidence,
)
from testbed.core.robot.gravity import SIZE
from testbed.core.robot.tree import Tree
from testbed.importing.check.body_prior import BodyPrior
from testbed.importing.check.remedies import MOST_JOINTS, Hypothesis
from testbed.importing.check.torque_products import (
    TorqueProducts,
    friction,
    torque_products,
)
from testbed.importing.check.torque_signals import TorqueSignals

FLOOR, FAINT, QUIET = 0.004, 0.01, 0.02
"""Noise in parts of a torque's rms at least; rms in parts of the largest that a torque counts with
at least, and that its noise counts with."""

MOST = 80
"""Instants of a channel that count at most: errors of models do not average out."""

DRIVES = 15.0
"""Most that friction that drives costs, each coefficient [nats]."""

CORRELATED = 0.05
"""Autocorrelation of residuals from which they are correlated."""

SCREENED = 80
"""Instants by which readings of other positions are compared at first."""


@dataclass(frozen=True, eq=False)
class LogReading:
    """Interpretation of a log by hypotheses on its mapping and gravity, with its evidence.

    Attributes:
        hypotheses: About what the mapping says, all together; none for the log as given.
        evidence: Of its torques.
        products: Of its columns.
        gravity: (3,) [m/s^2].
        measured: Other torques than those of the products, (C, T), or None.
        kind: Family of hypotheses.
        sigma: Standard deviations of what is continuous: of a direction [rad], a delay [s].
        odds: Logarithm of the prior odds and of the volume of what is continuous [nats].
    """

    hypotheses: tuple[Hypothesis, ...]
    evidence: Evidence
    products: TorqueProducts
    gravity: Array
    measured: Array | None = None
    kind: str = "as given"
    sigma: Array = field(default_factory=lambda: np.zeros(0))
    odds: float = 0.0

    @property
    def log(self) -> float:
        """Logarithm of the posterior probability, up to a constant of the log [nats]."""
        return self.evidence.log + self.odds

    @cached_property
    def residual(self) -> Array:
        """Residual torques, zero where none count, (C, T)."""
        return self.products.residual(self.gravity, self.evidence, self.measured)

    @cached_property
    def whole(self) -> Array:
        """Sums of squared torques per channel, (C,) [N^2 m^2 or N^2]."""
        return self.products.whole(self.measured)

    def pooled(self, live: Array) -> float:
        """Rms residual over all joints, relative to the rms torque.

        Args:
            live: Channels that count, (C,).
        """
        whole = self.whole[live].sum()
        return float(np.sqrt(self.evidence.residual[live].sum() / whole))


@dataclass(frozen=True, eq=False)
class TorqueCase:
    """Joint torques of a log, the robot, and the prior of its bodies.

    Attributes:
        tree: The robot.
        signals: Of the log.
        prior: Of the robot's bodies.
        gravity: As the log states, (3,) [m/s^2].
        inflation: Instants of each channel that count as one, (C,).
        fixed: Whether positions and gravity are known, as by a force plate.
        sprung: Indices of joints with a torque in proportion to their position.
    """

    tree: Tree
    signals: TorqueSignals
    prior: BodyPrior
    gravity: Array
    inflation: Array
    fixed: bool = False
    sprung: tuple[int, ...] = ()

    @cached_property
    def live(self) -> Array:
        """Whether each torque channel has enough samples, (C,)."""
        return np.asarray(self.signals.counted.sum(axis=0) > FEWEST)

    @cached_property
    def size(self) -> Array:
        """Rms of each channel's torques, (C,) [N m or N]."""
        counted = self.signals.counted
        square = (counted * self.signals.torque**2).sum(axis=0)
        rms = np.sqrt(square / np.maximum(counted.sum(axis=0), 1)) * self.live
        return np.asarray(np.maximum(rms, FAINT * rms.max() + 1e-9))

    @cached_property
    def floor(self) -> Array:
        """Least noise of each channel, (C,)."""
        return np.asarray(FLOOR * np.maximum(self.size, QUIET * self.size.max()))

    @cached_property
    def standard(self) -> float:
        """Magnitude of gravity [m/s^2]."""
        return float(np.linalg.norm(self.gravity)) or SIZE

    @cached_property
    def products(self) -> TorqueProducts:
        """Column products of the log as given, with free gravity for few joints."""
        return self.products_under(self.gravity if self.fixed or self.large else None)

    @property
    def large(self) -> bool:
        """Whether the joints are too many for all hypotheses."""
        return self.tree.n > MOST_JOINTS

    def products_under(self, gravity: Array | None) -> TorqueProducts:
        """Column products of the log under a given or free gravity.

        Args:
            gravity: (3,) [m/s^2], where it is not open.
        """
        return torque_products(
            self.tree, self.signals, self.prior, self.size, gravity, self.sprung
        )

    @cached_property
    def as_given(self) -> LogReading:
        """Reading of the log as its mapping states it."""
        estimate = self.fit(self.products, self.gravity)
        return LogReading((), estimate, self.products, self.gravity)

    def with_inflation(self, reading: LogReading) -> TorqueCase:
        """Case with inflation factors from the residual autocorrelation of a reading.

        Args:
            reading: The likeliest.
        """
        count = self.signals.counted.sum(axis=0)
        inflation = np.maximum(correlation_times(reading.residual), count / MOST)
        changed = replace(self, inflation=inflation)
        changed.__dict__["products"] = self.products
        return changed

    def fit(
        self,
        products: TorqueProducts,
        gravity: Array,
        measured: Array | None = None,
        variance: Array | None = None,
        rounds: int = 4,
    ) -> Evidence:
        """Evidence of the torques for the columns of one reading.

        Args:
            products: Of the columns.
            gravity: (3,) [m/s^2].
            measured: Other torques, (C, T).
            variance: Of each channel's noise, where its search begins, (C,).
            rounds: Of that search.
        """
        inputs = products.products(gravity, measured)
        return self.evidence(inputs, variance, rounds)

    def evidence(
        self, products: ChannelProducts, variance: Array | None, rounds: int
    ) -> Evidence:
        """Evidence of a model with dissipative friction.

        Args:
            products: Of its columns and measurements.
            variance: Of each channel's noise, where its search begins, (C,).
            rounds: Of that search.
        """
        estimate = evidence(products, self.floor, self.inflation, variance, rounds)
        return replace(estimate, log=estimate.log + self._braking(estimate))

    def _braking(self, estimate: Evidence) -> float:
        """Log posterior probability of dissipative friction coefficients [nats]."""
        values, sigma = friction(estimate)
        logs = np.maximum(log_ndtr(values / sigma), -DRIVES)
        return float(logs[self.live].sum())

    def with_torques(
        self,
        hypotheses: tuple[Hypothesis, ...],
        odds: float,
        measured: Array,
        kind: str,
    ) -> LogReading:
        """Reading with other torques and the same columns.

        Args:
            hypotheses: What it says.
            odds: Logarithm of the prior odds [nats].
            measured: Its torques, (C, T).
            kind: Family of hypotheses.
        """
        estimate = self.fit(self.products, self.gravity, measured)
        return LogReading(
            hypotheses,
            estimate,
            self.products,
            self.gravity,
            measured,
            kind,
            odds=odds,
        )

    def corrected(
        self, hypotheses: tuple[Hypothesis, ...], odds: float, kind: str, count: int = 0
    ) -> LogReading:
        """Reading with columns of corrected signals.

        Args:
            hypotheses: What it says.
            odds: Logarithm of the prior odds [nats].
            kind: Family of hypotheses.
            count: Instants by which it is judged; all by default.
        """
        signals = self.signals.thinned(count) if count else self.signals
        case = replace(self, signals=signals.corrected(*hypotheses))
        products = case.products_under(self.gravity)
        estimate = case.fit(products, self.gravity)
        return LogReading(
            hypotheses, estimate, products, self.gravity, kind=kind, odds=odds
        )

    def again(self, reading: LogReading) -> LogReading:
        """Reading re-evaluated with the inflation factors of this case.

        Args:
            reading: One that was made with another.
        """
        estimate = self.fit(
            reading.products, reading.gravity, reading.measured, rounds=5
        )
        return replace(reading, evidence=estimate)


def correlation_times(residual: Array) -> Array:
    """Integrated autocorrelation times of residuals, in samples, (C,).

    Args:
        residual: (C, T).
    """
    from scipy.signal import correlate

    times = np.ones(len(residual))
    samples = residual.shape[1]
    for k, channel in enumerate(residual):
        if not channel.any():
            continue
        lagged = correlate(channel, channel, method="fft")[samples - 1 :]
        correlation = lagged / lagged[0]
        small = np.flatnonzero(correlation[1:] < CORRELATED)
        last = small[0] + 1 if len(small) else samples
        total = 1 + 2 * correlation[1:last].sum()
        times[k] = np.clip(total, 1, max(samples / 12, 1))
    return times
