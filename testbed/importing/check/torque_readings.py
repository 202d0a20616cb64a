"""Interpretations of a log of joint torques, with Bayesian evidence."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr

from testbed.core.base.arrays import Array
from testbed.core.estimation.evidence import (
    MIN_CHANNEL_SAMPLES,
    ChannelProducts,
    Evidence,
    linear_evidence,
)
from testbed.core.robot.gravity import DEFAULT_GRAVITY
from testbed.core.robot.tree import Tree
from testbed.importing.check.body_prior import BodyPrior
from testbed.importing.check.remedies import MAX_SEARCHED_JOINTS, Hypothesis
from testbed.importing.check.torque_products import (
    TorqueProducts,
    friction_coefficients,
    torque_products,
)
from testbed.importing.check.torque_signals import TorqueSignals

NOISE_FLOOR, MIN_RMS_SHARE, MIN_NOISE_RMS_SHARE = 0.004, 0.01, 0.02
"""Least noise of a torque relative to its rms; least rms, relative to the largest, of a channel,
and for its noise."""

MAX_EFFECTIVE_INSTANTS = 80
"""Largest effective number of instants of a channel: model errors do not average out."""

MAX_FRICTION_COST = 15.0
"""Largest cost of a negative friction coefficient [nats]."""

CORRELATION_THRESHOLD = 0.05
"""Autocorrelation of residuals above which they are correlated."""

SCREENING_INSTANTS = 80
"""Number of instants for the first comparison of readings with other positions."""


@dataclass(frozen=True, eq=False)
class LogReading:
    """Interpretation of a log by hypotheses on its mapping and gravity, with its evidence.

    The torques have C channels at T instants.

    Attributes:
        hypotheses: Hypotheses that hold together; empty for the log as given.
        evidence: Evidence of the torques.
        products: Products of the regressor columns.
        gravity: Gravity, (3,) [m/s^2].
        measured: Torques, (C, T), if they differ from the torques in `products`; otherwise None.
        kind: Category of the hypotheses.
        sigma: Standard deviations of continuous values: of a direction [rad] or a delay [s].
        log_odds: Log prior odds plus log posterior volume of continuous values [nats].
    """

    hypotheses: tuple[Hypothesis, ...]
    evidence: Evidence
    products: TorqueProducts
    gravity: Array
    measured: Array | None = None
    kind: str = "as given"
    sigma: Array = field(default_factory=lambda: np.zeros(0))
    log_odds: float = 0.0

    @property
    def log_posterior(self) -> float:
        """Log posterior probability, up to a constant that depends on the log [nats]."""
        return self.evidence.log_evidence + self.log_odds

    @cached_property
    def residual(self) -> Array:
        """Residual torques, zero for invalid samples, (C, T)."""
        return self.products.residual(self.gravity, self.evidence, self.measured)

    @cached_property
    def square_sums(self) -> Array:
        """Sum of squared torques for each channel, (C,) [N^2 m^2 or N^2]."""
        return self.products.square_sums(self.measured)

    def relative_rms(self, live: Array) -> float:
        """Rms residual over all joints, relative to the rms torque.

        Args:
            live: Mask of usable channels, (C,).
        """
        square_sum = self.square_sums[live].sum()
        return float(np.sqrt(self.evidence.residual_squares[live].sum() / square_sum))


@dataclass(frozen=True, eq=False)
class TorqueCase:
    """Joint torques of a log (C channels), the robot, and the prior of its bodies.

    Attributes:
        tree: Robot.
        signals: Joint torques and motion of the log.
        prior: Prior of the robot's bodies.
        gravity: Gravity as stated by the log, (3,) [m/s^2].
        inflation: Number of correlated instants of each channel that count as one, (C,).
        motion_known: True if positions and gravity are known, for example from a force plate.
        spring_joints: Indices of joints with a spring.
    """

    tree: Tree
    signals: TorqueSignals
    prior: BodyPrior
    gravity: Array
    inflation: Array
    motion_known: bool = False
    spring_joints: tuple[int, ...] = ()

    @cached_property
    def usable_channels(self) -> Array:
        """Mask of torque channels with enough valid samples, (C,)."""
        return np.asarray(self.signals.valid.sum(axis=0) > MIN_CHANNEL_SAMPLES)

    @cached_property
    def channel_rms(self) -> Array:
        """Rms of each channel's torques, (C,) [N m or N]; at least 1 % of the largest rms."""
        counted = self.signals.valid
        square = (counted * self.signals.torque**2).sum(axis=0)
        rms = (
            np.sqrt(square / np.maximum(counted.sum(axis=0), 1)) * self.usable_channels
        )
        return np.asarray(np.maximum(rms, MIN_RMS_SHARE * rms.max() + 1e-9))

    @cached_property
    def noise_floor(self) -> Array:
        """Least standard deviation of each channel's noise, (C,) [N m or N]: 0.4 % of the rms."""
        return np.asarray(
            NOISE_FLOOR
            * np.maximum(self.channel_rms, MIN_NOISE_RMS_SHARE * self.channel_rms.max())
        )

    @cached_property
    def gravity_magnitude(self) -> float:
        """Magnitude of the stated gravity, or of standard gravity if that is zero [m/s^2]."""
        return float(np.linalg.norm(self.gravity)) or DEFAULT_GRAVITY

    @cached_property
    def products(self) -> TorqueProducts:
        """Products of regressor columns for the log as given.

        Gravity is free for robots with up to 12 joints, unless positions and gravity are known.
        """
        return self.products_under(
            self.gravity if self.motion_known or self.has_many_joints else None
        )

    @property
    def has_many_joints(self) -> bool:
        """True if the robot has too many joints for testing all hypotheses."""
        return self.tree.n > MAX_SEARCHED_JOINTS

    def products_under(self, gravity: Array | None) -> TorqueProducts:
        """Products of regressor columns for the log under a given or free gravity.

        Args:
            gravity: Fixed gravity, (3,) [m/s^2]; None for a free gravity.
        """
        return torque_products(
            self.tree,
            self.signals,
            self.prior,
            self.channel_rms,
            gravity,
            self.spring_joints,
        )

    @cached_property
    def as_given(self) -> LogReading:
        """Interpretation of the log as stated by its mapping."""
        estimate = self.fit(self.products, self.gravity)
        return LogReading((), estimate, self.products, self.gravity)

    def with_inflation(self, reading: LogReading) -> TorqueCase:
        """Case with inflation factors from the residual autocorrelation of an interpretation.

        The factors leave at most 80 effective instants of each channel.

        Args:
            reading: Likeliest interpretation.
        """
        count = self.signals.valid.sum(axis=0)
        inflation = np.maximum(
            correlation_times(reading.residual), count / MAX_EFFECTIVE_INSTANTS
        )
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
        """Evidence of the torques with the regressor columns of one interpretation.

        Args:
            products: Products of the columns.
            gravity: Gravity, (3,) [m/s^2].
            measured: Torques, (C, T); default: the torques of the log.
            variance: Start values of the channels' noise variances, (C,).
            rounds: Number of iterations for the noise variances.
        """
        inputs = products.products(gravity, measured)
        return self.evidence(inputs, variance, rounds)

    def evidence(
        self, products: ChannelProducts, variance: Array | None, rounds: int
    ) -> Evidence:
        """Evidence of a model with dissipative friction.

        The log posterior probability of positive friction coefficients is added to the log evidence
        of the linear model.

        Args:
            products: Products of the columns and measurements.
            variance: Start values of the channels' noise variances, (C,).
            rounds: Number of iterations for the noise variances.
        """
        estimate = linear_evidence(
            products, self.noise_floor, self.inflation, variance, rounds
        )
        return replace(
            estimate,
            log_evidence=estimate.log_evidence
            + self._friction_log_probability(estimate),
        )

    def _friction_log_probability(self, estimate: Evidence) -> float:
        """Log posterior probability of positive friction coefficients, at least -15 each [nats]."""
        values, sigma = friction_coefficients(estimate)
        logs = np.maximum(log_ndtr(values / sigma), -MAX_FRICTION_COST)
        return float(logs[self.usable_channels].sum())

    def with_torques(
        self,
        hypotheses: tuple[Hypothesis, ...],
        odds: float,
        measured: Array,
        kind: str,
    ) -> LogReading:
        """Interpretation with other torques and the same regressor columns.

        Args:
            hypotheses: Hypotheses of the interpretation.
            odds: Log prior odds [nats].
            measured: Torques of the interpretation, (C, T).
            kind: Category of the hypotheses.
        """
        estimate = self.fit(self.products, self.gravity, measured)
        return LogReading(
            hypotheses,
            estimate,
            self.products,
            self.gravity,
            measured,
            kind,
            log_odds=odds,
        )

    def corrected_reading(
        self, hypotheses: tuple[Hypothesis, ...], odds: float, kind: str, count: int = 0
    ) -> LogReading:
        """Interpretation with regressor columns from signals corrected by hypotheses.

        Args:
            hypotheses: Hypotheses of the interpretation.
            odds: Log prior odds [nats].
            kind: Category of the hypotheses.
            count: Largest number of instants; 0 for all.
        """
        signals = self.signals.thinned(count) if count else self.signals
        case = replace(self, signals=signals.with_corrections(*hypotheses))
        products = case.products_under(self.gravity)
        estimate = case.fit(products, self.gravity)
        return LogReading(
            hypotheses, estimate, products, self.gravity, kind=kind, log_odds=odds
        )

    def reevaluated_reading(self, reading: LogReading) -> LogReading:
        """Interpretation re-evaluated with the inflation factors of this case.

        Args:
            reading: Interpretation evaluated with other inflation factors.
        """
        estimate = self.fit(
            reading.products, reading.gravity, reading.measured, rounds=5
        )
        return replace(reading, evidence=estimate)


def correlation_times(residual: Array) -> Array:
    """Integrated autocorrelation times of residuals, in samples, (C,).

    The sum ends before the first autocorrelation below 0.05; times are between 1 and T / 12.

    Args:
        residual: Residuals of C channels at T instants, (C, T).
    """
    times = np.ones(len(residual))
    samples = residual.shape[1]
    for k, channel in enumerate(residual):
        if not channel.any():
            continue
        lagged = np.correlate(channel, channel, "full")[samples - 1 :]
        correlation = lagged / lagged[0]
        correlated = np.append(correlation[1:] >= CORRELATION_THRESHOLD, False)
        last = 1 + np.argmin(correlated)
        times[k] = np.clip(1 + 2 * correlation[1:last].sum(), 1, samples / 12)
    return times
