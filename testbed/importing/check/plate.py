"""Hypotheses on a force plate's frame, units and columns, and their fit to its data.

For one order of columns, rotation, origin, units and delay define a plate. The rotation is found by
Gauss-Newton steps (`PlateRows.fit`) that start from the least-squares alignment with the model
file's wrench (Wahba's problem) and from the mapping's frame. Pairs of units with a similar ratio
are tried; a rotation near rounded angles, or near the mapping's frame, is rounded to these.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.transform import Transform
from testbed.core.estimation.regression.normal_equations import inverse_and_solution
from testbed.core.robot.rotations import matrix_to_rpy, rotvec_to_matrix, rpy_to_matrix
from testbed.importing.check.instants import Instants, estimated_delay
from testbed.importing.check.plate_frame import PlateFrame, unit_ratio
from testbed.importing.check.plate_map import (
    CORRECTION_SIGMAS,
    CORRELATION_LENGTH,
    DELAY_INDEX,
    MAP_DERIVATIVES,
    RATIO_INDEX,
    ROTATION_INDICES,
    SHIFT_INDICES,
    MapFit,
    PlateRows,
    ridge_regression,
)
from testbed.importing.check.prior import ScaledPrior
from testbed.importing.check.remedies import (
    FRAME_ANGLE_STEPS,
    Hypothesis,
    pair_exchanges,
)
from testbed.importing.foreign_table import FORCE_UNITS, MOMENT_UNITS

ORDER_AS_READ = (0, 1, 2, 3, 4, 5)
"""Order of the channels as read."""

PLATE_ORDERS = (
    (3, 4, 5, 0, 1, 2),
    *pair_exchanges(range(3), 6),
    *pair_exchanges(range(3, 6), 6),
)
"""Moments before forces, and two channels exchanged; other orders of axes are rotations."""

MAX_ITERATIONS, MAX_STEP = 7, 0.6
"""Number of Gauss-Newton iterations; largest step of rotation [rad] and of the ratio's logarithm.
"""

SNAP_DISTANCE = 0.02
"""Frobenius distance of rotation matrices below which rounded angles are tried."""

GAIN_TOLERANCE = 0.1
"""Largest relative error of the ratio of gains for a pair of units to be tried."""

SNAP_Z_THRESHOLD = 4.0
"""Distance of rotations, in standard deviations, below which rounded angles are tried."""

LOG_RESIDUAL_WEIGHT = 2.5
"""Weight of the logarithm of a channel's unexplained share in the cost [nats]."""

MIN_RESIDUAL_SHARE = 1e-4
"""Least residual share of a channel's variance, for model errors."""

RESIDUAL_SHARE_FLOOR = 1e-5
"""Unexplained share below which differences are not significant."""

MASS_LOG_SIGMA, MAX_MASS_COST = 0.35, 1e3
"""Standard deviation of the logarithm of a model file's masses; largest cost of masses [nats]."""

EXPLAINED_SHARE = 1e-3
"""Unexplained share of a channel, apart from noise, below which the channel is explained."""

UNEXPLAINED_SHARE = 0.05
"""Unexplained share of a channel, apart from noise, from which the recording is certainly wrong."""

CROSSTALK_SHARE, CROSSTALK_RATIO = 3e-3, 10.0
"""Largest residual share with a full linear map for crosstalk, and least ratio without the map."""

MIN_SHIFT, SHIFT_Z_THRESHOLD = 5e-3, 5.0
"""Least shift of a plate's frame [m], and in standard deviations."""

MAX_MAPS = 40
"""Number of maps that are kept, the best first."""

CORRECTION_ITERATIONS, SMOOTHING_SHARE = 4, 0.15
"""Number of reweighting iterations; part of the frequencies over which residuals are averaged."""

MAX_ORIGIN_SIGMA = 0.02
"""Standard deviation above which a coordinate of the origin is not determined [m]."""

MAX_PRIOR_FACTOR = 10.0
"""Largest factor on a prior's standard deviations, for data that depart from the prior as much."""

MapHypothesis = tuple[tuple[Hypothesis, ...], Array]
"""Hypotheses on a plate, and the resulting map from the recorded wrench, (6, 6)."""


def plate_hypotheses(
    plate: PlateRows, frame: PlateFrame, order: tuple[int, ...]
) -> Iterator[MapHypothesis]:
    """Yield the rotations and units that best explain a plate, for one order of columns.

    Units are within 10 % of the fitted ratio; shift, delay and sense are fitted later for each map.
    """
    starts = [*_aligned_rotations(plate, frame, order), frame.rotation]
    rotation, ratio, sigma, _ = min(
        (_optimal_rotation(plate, frame, order, start) for start in starts),
        key=lambda each: each[-1],
    )
    angles = [
        round(angle / FRAME_ANGLE_STEPS[-1]) * FRAME_ANGLE_STEPS[-1]
        for angle in matrix_to_rpy(rotation)
    ]
    limit = max(SNAP_DISTANCE, SNAP_Z_THRESHOLD * sigma)
    rotations = [rotation, rpy_to_matrix(angles), frame.rotation]
    rotations = [each for each in rotations if np.linalg.norm(rotation - each) < limit]
    for units in product(FORCE_UNITS, MOMENT_UNITS):
        gain_error = abs(unit_ratio(units) / (ratio * unit_ratio(frame.units)) - 1)
        if gain_error > GAIN_TOLERANCE and units != frame.units:
            continue  # units as read are always tried: forces may be noise
        for each in rotations:
            hypotheses = [Hypothesis("plate_order", (), order)] * (
                order != ORDER_AS_READ
            )
            hypotheses += [Hypothesis("units", (), units)] * (units != frame.units)
            if np.linalg.norm(each - frame.rotation) > 1e-6:
                angles = np.round(matrix_to_rpy(each), 6).tolist()
                hypotheses.append(Hypothesis("turn", (), tuple(angles)))
            yield tuple(hypotheses), frame.map(each, units, order)


def _aligned_rotations(
    plate: PlateRows, frame: PlateFrame, order: Sequence[int]
) -> Iterator[Array]:
    """Yield least-squares rotations to the model's wrench (Wahba's problem), for both senses."""
    from scipy.spatial.transform import Rotation

    channels = (
        plate.channels[:, :6]
        @ frame.map(np.eye(3), frame.units, order).T
        * plate.weight
    )
    vectors, expected = channels.reshape(-1, 3), plate.expected.reshape(-1, 3)
    with warnings.catch_warnings():
        # vectors along one line: any rotation about the line is a solution
        warnings.simplefilter("ignore", UserWarning)
        rotations = [
            Rotation.align_vectors(expected, sense * vectors)[0]
            for sense in (1.0, -1.0)
        ]
    yield from (rotation.as_matrix() for rotation in rotations)


def _optimal_rotation(
    plate: PlateRows, frame: PlateFrame, order: Sequence[int], rotation: Array
) -> tuple[Array, float, float, float]:
    """Optimal rotation of the frame from a start value, by Gauss-Newton steps.

    Returns:
        Rotation, factor on the moments, largest standard deviation of the rotation [rad], and cost.
    """
    ratio = plate.moment_factor(frame.map(frame.rotation, frame.units, order))
    indices = [*ROTATION_INDICES, RATIO_INDEX]
    for _ in range(MAX_ITERATIONS):
        fit = plate.fit(
            frame.map(rotation, frame.units, order, ratio),
            (*SHIFT_INDICES, DELAY_INDEX, *indices),
        )
        step = fit.corrections[indices]
        step = step * min(1.0, MAX_STEP / max(float(np.linalg.norm(step)), MAX_STEP))
        rotation = rotvec_to_matrix(step[:3]) @ rotation
        ratio *= float(np.exp(step[3]))
    cost = float(np.log(fit.unexplained + RESIDUAL_SHARE_FLOOR).sum())
    return rotation, ratio, float(fit.sigma[ROTATION_INDICES].max()), cost


@dataclass(frozen=True, eq=False)
class PlateExplanation:
    """Explanation of a plate's data by a linear map of its channels.

    Attributes:
        hypotheses: Hypotheses on the plate.
        map: Map from the recorded wrench to the wrench in the bedplate frame, (6, 6).
        delay: Delay of the wrench [s].
        unexplained: Unexplained share of each channel's variance, (6,).
        noise: Noise share of each channel's variance, (6,).
        cost: Negative log likelihood [nats].
    """

    hypotheses: tuple[Hypothesis, ...]
    map: Array
    delay: float
    unexplained: Array
    noise: Array
    cost: float

    def is_explained(self, share: float = EXPLAINED_SHARE) -> bool:
        """Test whether each channel's unexplained share is below `share` plus 3 times its noise."""
        return bool((self.unexplained < share + 3 * self.noise).all())


NO_PLATE = PlateExplanation((), np.eye(6), 0.0, np.zeros(0), np.zeros(0), 0.0)
"""Explanation of a recording without a force plate."""


@dataclass(frozen=True, eq=False)
class WrenchFit:
    """Channels of a force plate and their best fit at T instants, for a plot.

    Attributes:
        time: Time, (T,) [s].
        wrench: Wrench as recorded, (T, 6) [N, N m].
        fit: Best fit with base parameters and constants, (T, 6) [N, N m].
        unexplained: Unexplained share of each channel's variance, (6,).
    """

    time: Array
    wrench: Array
    fit: Array
    unexplained: Array


class PlateEvidence:
    """Evidence that linear maps of a plate's channels are the wrench on this robot.

    Attributes:
        has_wrench: True if there is a force plate.
        rows: Regressor of the wrench with respect to barycentric parameters, (T, 6, 10 n).
    """

    def __init__(
        self, prior: ScaledPrior, frame: PlateFrame, rows: Array, instants: Instants
    ) -> None:
        """Compute the products of regressor and channels.

        Args:
            prior: Prior of the robot's parameters.
            frame: Frame and units of the plate according to the mapping.
            rows: Regressor of the wrench with respect to barycentric parameters, (T, 6, 10 n).
            instants: Low-pass filtered signals of the recording, at T instants.
        """
        self._prior, self._frame, self.rows, self._instants = (
            prior,
            frame,
            rows,
            instants,
        )
        self.has_wrench = instants.wrench.size > 0
        if self.has_wrench:
            self._columns, self._expected = (
                rows @ prior.covariance_root,
                rows @ prior.mean,
            )
            self._rows = PlateRows(self._columns, self._expected, instants)

    @property
    def least_residual_share(self) -> float:
        """Residual share with the best linear map of the channels; 0 without a plate."""
        return self._rows.least_residual_share if self.has_wrench else 0.0

    def has_crosstalk(self, unexplained: Array) -> bool:
        """Test for crosstalk: a full linear map leaves far smaller shares than `unexplained`, (6,).

        The share must be below `CROSSTALK_SHARE` and below a tenth of the mean of `unexplained`.
        """
        return self.least_residual_share < min(
            CROSSTALK_SHARE, float(unexplained.mean()) / CROSSTALK_RATIO
        )

    @cached_property
    def delay(self) -> tuple[float, float]:
        """Delay of the plate from the model file's masses [s], and residual ratio.

        The wrench predicted with these masses is fitted by all maps of the channels.
        """
        wrench = self._instants.wrench
        channels = np.hstack([wrench, np.ones((len(wrench), 1))])
        columns = np.einsum("tk,cd->tcdk", channels, np.eye(6)).reshape(
            len(channels), 6, -1
        )
        delay_value, ratio = estimated_delay(
            columns, self._rows.expected, self._instants.spacing
        )
        return -delay_value, ratio

    @cached_property
    def explanations(self) -> list[PlateExplanation]:
        """Explanations by the best rotations and units, if necessary with other column orders."""
        if not self.has_wrench:
            return [NO_PLATE]
        plate, frame = self._rows, self._frame
        explanations = self._ranked_explanations(
            plate_hypotheses(plate, frame, ORDER_AS_READ)
        )
        if not any(each.is_explained() for each in explanations):
            explanations += self._ranked_explanations(
                each
                for order in PLATE_ORDERS
                for each in plate_hypotheses(plate, frame, order)
            )
        return explanations

    def _ranked_explanations(
        self, candidates: Iterable[MapHypothesis]
    ) -> list[PlateExplanation]:
        """Up to 40 explanations by maps with fitted shift, delay and sense, sorted by cost."""
        ranked = []
        for known, matrix in candidates:
            fit, hypotheses = self._rows.fit(matrix), list(known)
            shift = fit.corrections[SHIFT_INDICES]
            sigma = float(np.linalg.norm(fit.sigma[SHIFT_INDICES]))
            if np.linalg.norm(shift) > max(MIN_SHIFT, SHIFT_Z_THRESHOLD * sigma):
                place = np.round(self._frame.origin + shift, 4)
                hypotheses.append(Hypothesis("shift", (), tuple(place.tolist())))
            shifted = Transform(p_AB_A=shift).wrench_matrix @ matrix
            if fit.mass_scale < 0:
                hypotheses.append(Hypothesis("sense"))
                shifted = -shifted
            ranked.append(self._explanation(hypotheses, shifted, fit))
        return sorted(ranked, key=lambda each: each.cost)[:MAX_MAPS]

    def _explanation(
        self, hypotheses: Sequence[Hypothesis], matrix: Array, fit: MapFit
    ) -> PlateExplanation:
        """Explanation by a fitted map, with the cost of residuals and of implausible masses."""
        mass_cost = min(
            (np.log(max(abs(fit.mass_scale), 1e-9)) / MASS_LOG_SIGMA) ** 2,
            MAX_MASS_COST,
        )
        cost = LOG_RESIDUAL_WEIGHT * float(
            np.log(fit.unexplained + RESIDUAL_SHARE_FLOOR).sum() + mass_cost
        )
        delay_value = float(fit.corrections[DELAY_INDEX])
        return PlateExplanation(
            tuple(hypotheses), matrix, delay_value, fit.unexplained, fit.noise, cost
        )

    @cached_property
    def explanation_as_read(self) -> PlateExplanation:
        """Explanation of the plate as recorded, with a fitted delay."""
        if not self.has_wrench:
            return NO_PLATE
        fit = self._rows.fit(np.eye(6), [DELAY_INDEX])
        if fit.mass_scale < 0:  # negative masses
            fit = fit._replace(unexplained=np.ones(6), mass_scale=0.0)
        return self._explanation((), np.eye(6), fit)

    def wrench(self, explanation: PlateExplanation) -> Array:
        """Wrench in the bedplate frame under an explanation, delay corrected, (T, 6) [N, N m]."""
        data = self._instants
        return (data.wrench + explanation.delay * data.wrench_rate) @ explanation.map.T

    def posterior(self, explanation: PlateExplanation) -> tuple[Array, Array, Array]:
        """Posterior of the barycentric parameters from the varying part of the wrench.

        Args:
            explanation: Explanation of the plate.

        Returns:
            Mean, (10 n,), root of the covariance, (10 n, k), and residual, (T, 6) [N, N m].
        """
        prior, (departure, root, residual) = (
            self._prior,
            self._regression(explanation, self._columns),
        )
        return (
            prior.mean + prior.covariance_root @ departure,
            prior.covariance_root @ root,
            residual,
        )

    def residual(
        self, explanation: PlateExplanation, columns: Array
    ) -> tuple[Array, Array, Array]:
        """Residual wrench, (T, 6), and values and standard deviations of additional columns, (k,).

        Args:
            explanation: Explanation of the plate.
            columns: Additional regressor columns of the wrench, (T, 6, k).
        """
        values, root, residual = self._regression(
            explanation, np.concatenate([self._columns, columns], axis=2)
        )
        count = self._columns.shape[2]
        return residual, values[count:], np.linalg.norm(root[count:], axis=1)

    def _regression(
        self, explanation: PlateExplanation, columns: Array
    ) -> tuple[Array, Array, Array]:
        """Values of columns, root of their covariance, and residual, under an explanation."""
        wrench = self.wrench(explanation)
        share = (
            np.maximum(explanation.unexplained, MIN_RESIDUAL_SHARE) * CORRELATION_LENGTH
        )
        sigma = np.sqrt(share * np.maximum(wrench.var(axis=0), 1e-12))
        target = wrench - self._expected
        values, root, residual = ridge_regression(columns, target[..., None], sigma)
        return values[:, 0], root, residual[..., 0]

    def zero_wrench(self, explanation: PlateExplanation) -> tuple[Array, Array]:
        """Wrench on the plate without moving bodies, and standard deviation, (6,) [N, N m].

        The moving bodies' share is predicted by `posterior`; motion cannot identify their weight.
        """
        mean, root, _ = self.posterior(explanation)
        residual = self.wrench(explanation) - self.rows @ mean
        return residual.mean(axis=0), np.linalg.norm(
            self.rows.mean(axis=0) @ root, axis=1
        )

    def frame_correction(self, explanation: PlateExplanation) -> tuple[Array, Array]:
        """Small corrections of a plate's frame, delay and gain ratio, with covariance.

        Near the true mapping, the wrench is w = Y delta + b - sum x_e S_e w - delay dw/dt + noise,
        with regressor Y, parameters delta (prior: model file), constants b, and corrections x_e
        (S_e: `MAP_DERIVATIVES`); w on the right is the last prediction, so noise causes no bias.
        Residuals are not white: after a cosine transform, each frequency is weighted by the
        residuals around it. If data depart from the prior, it is widened (`MAX_PRIOR_FACTOR`); an
        undetermined origin coordinate is zero.

        Args:
            explanation: Explanation of the plate, without hypotheses on the plate.

        Returns:
            Shift (3) [m], delay [s], rotation (3) [rad], relative ratio of moments to forces, (8,),
            in the bedplate frame, with the rotation applied first; and their covariance, (8, 8).
        """
        from scipy.fft import dct

        data, count = self._instants, len(self._instants.wrench)
        constants = np.broadcast_to(np.eye(6), (count, 6, 6))
        model = np.concatenate([self._columns, constants], axis=2)
        model = dct(model, axis=0, norm="ortho")
        wrench, rate = (
            dct(x, axis=0, norm="ortho") for x in (data.wrench, data.wrench_rate)
        )
        target = wrench - dct(self._expected, axis=0, norm="ortho")
        parameters, offsets = slice(self._columns.shape[2]), slice(model.shape[2], None)
        precision = np.concatenate(
            [np.ones(parameters.stop), np.zeros(6), 1 / CORRECTION_SIGMAS**2]
        )
        mean = np.zeros(len(precision))
        mean[offsets][SHIFT_INDICES] = -self._frame.origin
        variance = np.maximum(explanation.unexplained * data.wrench.var(axis=0), 1e-30)
        weight, predicted = np.tile(1 / np.sqrt(variance), (count, 1)), wrench
        for _ in range(CORRECTION_ITERATIONS):
            slopes = -np.einsum("ecd,td->tce", MAP_DERIVATIVES, predicted)
            slopes[:, :, DELAY_INDEX] = -rate
            columns = np.concatenate([model, slopes], axis=2)
            scaled = (columns * weight[..., None]).reshape(6 * count, -1)
            right = scaled.T @ (target * weight).ravel() + precision * mean
            matrix = scaled.T @ scaled + np.diag(precision)
            covariance, values = inverse_and_solution(matrix, right)
            residual = target - columns @ values
            predicted = wrench - residual
            leverage = ((scaled @ covariance) * scaled).sum(axis=1).reshape(count, 6)
            weight = _spectral_weights(residual, leverage)
            deviation = np.abs(values[parameters]).max()
            precision[parameters] = 1 / np.clip(deviation, 1.0, MAX_PRIOR_FACTOR) ** 2
        return self._with_known_origin(values[offsets], covariance[offsets, offsets])

    def _with_known_origin(
        self, values: Array, covariance: Array
    ) -> tuple[Array, Array]:
        """Correction with undetermined origin coordinates (sigma > 2 cm) zero, and covariance."""
        free = [k for k in SHIFT_INDICES if covariance[k, k] > MAX_ORIGIN_SIGMA**2]
        gain = np.linalg.solve(covariance[np.ix_(free, free)], covariance[free])
        return values - (values[free] + self._frame.origin[free]) @ gain, covariance

    def wrench_fit(self, explanation: PlateExplanation) -> WrenchFit:
        """Channels mapped by an explanation, and their best fit with parameters and constants."""
        wrench, residual = self.wrench(explanation), self.posterior(explanation)[2]
        return WrenchFit(
            self._instants.motion.t, wrench, wrench - residual, explanation.unexplained
        )


def _spectral_weights(residual: Array, leverage: Array) -> Array:
    """Inverse standard deviations of residuals around each frequency of a channel, (T, 6).

    Args:
        residual: Residuals in the cosine transform, (T, 6).
        leverage: Leverage of each residual, (T, 6).
    """
    from scipy.ndimage import uniform_filter1d

    width = 1 + int(SMOOTHING_SHARE * len(residual))
    freedom = uniform_filter1d(1 - leverage, width, axis=0)
    square = uniform_filter1d(residual**2, width, axis=0)
    return np.asarray(np.sqrt(np.maximum(freedom, 1e-9) / np.maximum(square, 1e-24)))
