"""What a mapping may say of a plate, and how well each explains what the plate has measured.

For one order of columns, everything that a mapping says of a plate is a turn, a place, units, and a
delay. Gauss's and Newton's steps on these (`PlateRows.fit`), from the 24 turns that take axes to
axes, all at once, end in the least of all turns: none is further than 63 degrees from a start.
Units are those pairs whose ratio is near; where a turn is near that a person would write, or that
the mapping says, it is tried.
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
from testbed.core.robot.rotations import from_rpy, from_vector, to_rpy
from testbed.importing.check.instants import Instants, delay
from testbed.importing.check.plate_frame import Frame, unit_ratio
from testbed.importing.check.plate_map import (
    LASTS,
    LATE,
    RATIO,
    SHIFT,
    SLOPES,
    TURN,
    WIDE,
    MapFit,
    PlateRows,
    ridge_regression,
)
from testbed.importing.check.prior import ScaledPrior
from testbed.importing.check.remedies import (
    STEPS,
    Hypothesis,
    exchanges,
)
from testbed.importing.foreign_table import FORCES, MOMENTS

AS_READ = (0, 1, 2, 3, 4, 5)

PLATE_ORDERS = (
    (3, 4, 5, 0, 1, 2),
    *exchanges(range(3), 6),
    *exchanges(range(3, 6), 6),
)
"""Moments before forces, and two channels exchanged; axes in another order are a turn."""

ROUNDS, LARGEST = 7, 0.6
"""Of Gauss and Newton; their largest step of a turn [rad] and of the ratio's logarithm."""

SNAP = 0.02
"""Distance of a turn's matrix to one that is plainer from which that is tried."""

NEAR = 0.1
"""By how much the ratio of gains may be off for a pair of units to be tried."""

SIGMAS = 4.0
"""By which a turn may be off where a plate is noise."""

WEIGHT = 2.5
"""Of the logarithm of a channel's unexplained share [nats]: what is left lasts, and is no noise."""

LEAST_LEFT = 1e-4
"""Share of a channel's variance that models leave at least."""

TINY = 1e-5
"""Share below which what is left says nothing more."""

ROUGH, MOST_SIZE = 0.35, 1e3
"""Sigma of the logarithm of a model file's masses; most that their size counts [nats]."""

EXPLAINED = 1e-3
"""Share below which, noise aside, nothing is odd about a channel."""

UNEXPLAINED = 0.05
"""Share of a channel that no reading of a right recording leaves, noise aside."""

MIXED, GAP = 3e-3, 10.0
"""Share that a matrix leaves at most where a plate mixes its channels, and times less than others.
"""

SHIFTED, CLEAR = 5e-3, 5.0
"""Least shift of a plate's frame that is one [m], and its sigmas."""

MOST_MAPS = 40
"""Maps that are judged together with the torques, the best first."""

CORRECTIONS, AROUND = 4, 0.15
"""Steps of Gauss and Newton to a correction; part of the frequencies over which what is left is
averaged."""

FAR = 0.02
"""Standard deviation from which a place is not known [m]."""

LOOSEST = 10.0
"""Times that a prior's sigmas are wider at most, where data depart from it by as many sigmas."""

MapHypothesis = tuple[tuple[Hypothesis, ...], Array]
"""Hypotheses about a plate, and the map from the recorded wrench by them, (6, 6)."""


def best_hypotheses(
    plate: PlateRows, frame: Frame, order: tuple[int, ...]
) -> Iterator[MapHypothesis]:
    """The turns and units that explain a plate best, its columns in one order.

    The sense is the sign of what the model file predicts; shift and delay are fitted beside.

    Args:
        plate: Products of its channels.
        frame: How the mapping has read it.
        order: In which column each channel is.
    """
    starts = [*_aligned(plate, frame, order), frame.turn]
    turn, ratio, sigma, _ = min(
        (_descend(plate, frame, order, start) for start in starts),
        key=lambda each: each[-1],
    )
    angles = [round(angle / STEPS[-1]) * STEPS[-1] for angle in to_rpy(turn)]
    near = max(SNAP, SIGMAS * sigma)
    turns = [turn, from_rpy(angles), frame.turn]
    turns = [each for each in turns if np.linalg.norm(turn - each) < near]
    for units in product(FORCES, MOMENTS):
        apart = abs(unit_ratio(units) / (ratio * unit_ratio(frame.units)) - 1)
        if apart > NEAR and units != frame.units:  # as read always: forces may be noise
            continue
        for each in turns:
            hypotheses = [Hypothesis("plate_order", (), order)] * (order != AS_READ)
            hypotheses += [Hypothesis("units", (), units)] * (units != frame.units)
            if np.linalg.norm(each - frame.turn) > 1e-6:
                angles = np.round(to_rpy(each), 6).tolist()
                hypotheses.append(Hypothesis("turn", (), tuple(angles)))
            yield tuple(hypotheses), frame.map(each, units, order)


def _aligned(plate: PlateRows, frame: Frame, order: Sequence[int]) -> Iterator[Array]:
    """Turns that bring the channels nearest to what the model file predicts, in either sense.

    Wahba's problem.
    """
    from scipy.spatial.transform import Rotation

    channels = (
        plate.channels[:, :6]
        @ frame.map(np.eye(3), frame.units, order).T
        * plate.weight
    )
    vectors, expected = channels.reshape(-1, 3), plate.expected.reshape(-1, 3)
    with warnings.catch_warnings():
        # of vectors along one line: any turn will do
        warnings.simplefilter("ignore", UserWarning)
        both = [
            Rotation.align_vectors(expected, sense * vectors)[0]
            for sense in (1.0, -1.0)
        ]
    yield from (turn.as_matrix() for turn in both)


def _descend(
    plate: PlateRows, frame: Frame, order: Sequence[int], turn: Array
) -> tuple[Array, float, float, float]:
    """The best turn of the frame from a start, (3, 3), by Gauss's and Newton's steps.

    Beside it how many times too small its moments are, the turn's largest sigma [rad], and the
    cost.
    """
    ratio = plate.gain_ratio(frame.map(frame.turn, frame.units, order))
    moves = [*TURN, RATIO]
    for _ in range(ROUNDS):
        fit = plate.fit(
            frame.map(turn, frame.units, order, ratio), (*SHIFT, LATE, *moves)
        )
        step = fit.extras[moves]
        step = step * min(1.0, LARGEST / max(float(np.linalg.norm(step)), LARGEST))
        turn = from_vector(step[:3]) @ turn
        ratio *= float(np.exp(step[3]))
    cost = float(np.log(fit.unexplained + TINY).sum())
    return turn, ratio, float(fit.sigma[TURN].max()), cost


@dataclass(frozen=True, eq=False)
class PlateExplanation:
    """A plate by some hypotheses.

    Attributes:
        hypotheses: About the plate.
        map: From the recorded wrench to the bedplate's, (6, 6).
        late: How late the wrench is [s].
        unexplained: Part of each channel's variance, (6,).
        noise: Part of it that is the channels' own noise, (6,).
        cost: Minus the logarithm of how likely it is [nats].
    """

    hypotheses: tuple[Hypothesis, ...]
    map: Array
    late: float
    unexplained: Array
    noise: Array
    cost: float

    def explained(self, share: float = EXPLAINED) -> bool:
        """Whether nothing is odd, noise aside.

        Args:
            share: Part of a channel's variance that may be left.
        """
        return bool((self.unexplained < share + 3 * self.noise).all())


NO_PLATE = PlateExplanation((), np.eye(6), 0.0, np.zeros(0), np.zeros(0), 0.0)


@dataclass(frozen=True, eq=False)
class WrenchFit:
    """A plate's channels at T instants against what the robot can make of them, for a picture.

    Attributes:
        time: (T,) [s].
        wrench: As it is read, (T, 6) [N, N m].
        fit: The nearest that base parameters and constants make, (T, 6) [N, N m].
        unexplained: Part of each channel's variance, (6,).
    """

    time: Array
    wrench: Array
    fit: Array
    unexplained: Array


class PlateEvidence:
    """How well maps of a plate's channels can be the wrench on this robot; without one, nothing.

    Attributes:
        measured: Whether there is a plate.
        rows: Of the wrench on all barycentric parameters, (T, 6, 10 n).
    """

    def __init__(
        self, prior: ScaledPrior, frame: Frame, rows: Array, instants: Instants
    ) -> None:
        """Products of rows and channels.

        Args:
            prior: The robot.
            frame: How the mapping has read the plate.
            rows: Of the wrench on all barycentric parameters, (T, 6, 10 n).
            instants: Of the recording.
        """
        self._prior, self._frame, self.rows, self._instants = (
            prior,
            frame,
            rows,
            instants,
        )
        self.measured = instants.wrench.size > 0
        if self.measured:
            self._spread, self._expected = rows @ prior.root, rows @ prior.mean
            self._products = PlateRows(self._spread, self._expected, instants)

    @property
    def least(self) -> float:
        """Share that no map can mend."""
        return self._products.least_share if self.measured else 0.0

    def mixed(self, unexplained: Array) -> bool:
        """Whether a matrix of all six channels explains the plate far better than what leaves this.

        Args:
            unexplained: Part of each channel's variance, (6,).
        """
        return self.least < min(MIXED, float(unexplained.mean()) / GAP)

    @cached_property
    def delay(self) -> tuple[float, float]:
        """How late the plate is by the model file's masses [s], and times less that is left then.

        What the masses predict is held against all maps of the channels.
        """
        wrench = self._instants.wrench
        channels = np.hstack([wrench, np.ones((len(wrench), 1))])
        each = np.einsum("tk,cd->tcdk", channels, np.eye(6)).reshape(
            len(channels), 6, -1
        )
        late, times = delay(each, self._products.expected, self._instants.spacing)
        return -late, times

    @cached_property
    def explanations(self) -> list[PlateExplanation]:
        """All that is open: the best turns and units, the columns in their order or in another."""
        if not self.measured:
            return [NO_PLATE]
        plate, frame = self._products, self._frame
        several = self._judge(best_hypotheses(plate, frame, AS_READ))
        if not any(each.explained() for each in several):
            several += self._judge(
                each
                for order in PLATE_ORDERS
                for each in best_hypotheses(plate, frame, order)
            )
        return several

    def _judge(self, hypotheses: Iterable[MapHypothesis]) -> list[PlateExplanation]:
        """Explanations by maps, a shift and lateness fitted."""
        several = []
        for known, each in hypotheses:
            fit, about = self._products.fit(each), list(known)
            shift = fit.extras[SHIFT]
            sigma = float(np.linalg.norm(fit.sigma[SHIFT]))
            if np.linalg.norm(shift) > max(SHIFTED, CLEAR * sigma):
                place = np.round(self._frame.place + shift, 4)
                about.append(Hypothesis("shift", (), tuple(place.tolist())))
            moved = Transform(p_AB_A=shift).wrench_matrix @ each
            if fit.size < 0:
                about.append(Hypothesis("sense"))
                moved = -moved
            several.append(self._explanation(about, moved, fit))
        return sorted(several, key=lambda each: each.cost)[:MOST_MAPS]

    def _explanation(
        self, hypotheses: Sequence[Hypothesis], each: Array, fit: MapFit
    ) -> PlateExplanation:
        """Explanation by a map and what it leaves."""
        size = min((np.log(max(abs(fit.size), 1e-9)) / ROUGH) ** 2, MOST_SIZE)
        cost = WEIGHT * float(np.log(fit.unexplained + TINY).sum() + size)
        late = float(fit.extras[LATE])
        return PlateExplanation(
            tuple(hypotheses), each, late, fit.unexplained, fit.noise, cost
        )

    @cached_property
    def as_read(self) -> PlateExplanation:
        """The plate as it was read; lateness is nobody's mistake."""
        if not self.measured:
            return NO_PLATE
        fit = self._products.fit(np.eye(6), [LATE])
        if fit.size < 0:  # of negative masses
            fit = fit._replace(unexplained=np.ones(6), size=0.0)
        return self._explanation((), np.eye(6), fit)

    def wrench(self, each: PlateExplanation) -> Array:
        """The bedplate's wrench by an explanation, in time, (T, 6) [N, N m]."""
        data = self._instants
        return (data.wrench + each.late * data.wrench_rate) @ each.map.T

    def posterior(self, each: PlateExplanation) -> tuple[Array, Array, Array]:
        """Parameters by the varying part of the wrench, (10 n,), and their sigmas' root, (10 n, k).

        Args:
            each: Of the plate.

        Returns:
            Besides these what they leave of the wrench, (T, 6) [N, N m].
        """
        prior, (departure, root, left) = (
            self._prior,
            self._regression(each, self._spread),
        )
        return prior.mean + prior.root @ departure, prior.root @ root, left

    def residual(
        self, each: PlateExplanation, columns: Array
    ) -> tuple[Array, Array, Array]:
        """Residual, (T, 6), with further columns; their values and sigmas, (k,).

        Args:
            each: Of the plate.
            columns: Of the bedplate's wrench, (T, 6, k).
        """
        values, root, left = self._regression(
            each, np.concatenate([self._spread, columns], axis=2)
        )
        others = self._spread.shape[2]
        return left, values[others:], np.linalg.norm(root[others:], axis=1)

    def _regression(
        self, each: PlateExplanation, columns: Array
    ) -> tuple[Array, Array, Array]:
        """Values of columns, a root of their covariance, and the residual, by an explanation."""
        wrench = self.wrench(each)
        share = np.maximum(each.unexplained, LEAST_LEFT) * LASTS
        sigma = np.sqrt(share * np.maximum(wrench.var(axis=0), 1e-12))
        rest = wrench - self._expected
        values, root, left = ridge_regression(columns, rest[..., None], sigma)
        return values[:, 0], root, left[..., 0]

    def zero(self, each: PlateExplanation) -> tuple[Array, Array]:
        """What the plate shows without the robot, and its sigma, (6,) [N, N m].

        The robot's share is of the parameters that the varying part of the wrench identifies, with
        the model file as prior; no motion identifies its weight on a base at rest.

        Args:
            each: Of the plate.
        """
        mean, root, _ = self.posterior(each)
        rest = self.wrench(each) - self.rows @ mean
        return rest.mean(axis=0), np.linalg.norm(self.rows.mean(axis=0) @ root, axis=1)

    def correction(self, each: PlateExplanation) -> tuple[Array, Array]:
        """What a plate that is right but for little must be moved by.

        With a mapping that is right but for little, w = Y delta + b - sum x_e S_e w - late dw/dt +
        noise: turn, shift, ratio (S_e, `SLOPES`) and delay enter linearly. They are estimated with
        the parameters, the model file as prior, and w on the right-hand side is what the last step
        predicts, so that its noise biases nothing. What is left is no white noise: encoders' is
        differentiated twice, models lack what is slow. So all is done in the cosine transform,
        where it is uncorrelated, and each frequency of a channel is weighed by what is left around
        it. A prior from which the data depart counts as much less (`LOOSEST`). A direction of the
        place that the data do not identify goes to zero.

        Args:
            each: Of the plate, without hypotheses about it.

        Returns:
            Shift (3) [m], delay [s], turn (3) [rad], ratio of moments to forces, relative; in the
            bedplate's frame, the turn first, (8,). Their covariance, (8, 8).
        """
        from scipy.fft import dct

        data, count = self._instants, len(self._instants.wrench)
        constants = np.broadcast_to(np.eye(6), (count, 6, 6))
        model = np.concatenate([self._spread, constants], axis=2)
        model = dct(model, axis=0, norm="ortho")
        wrench, rate = (
            dct(x, axis=0, norm="ortho") for x in (data.wrench, data.wrench_rate)
        )
        target = wrench - dct(self._expected, axis=0, norm="ortho")
        parameters, moves = slice(self._spread.shape[2]), slice(model.shape[2], None)
        precision = np.concatenate([np.ones(parameters.stop), np.zeros(6), 1 / WIDE**2])
        mean = np.zeros(len(precision))
        mean[moves][SHIFT] = -self._frame.place
        left = np.maximum(each.unexplained * data.wrench.var(axis=0), 1e-30)
        weight, predicted = np.tile(1 / np.sqrt(left), (count, 1)), wrench
        for _ in range(CORRECTIONS):
            slopes = -np.einsum("ecd,td->tce", SLOPES, predicted)
            slopes[:, :, LATE] = -rate
            columns = np.concatenate([model, slopes], axis=2)
            scaled = (columns * weight[..., None]).reshape(6 * count, -1)
            right = scaled.T @ (target * weight).ravel() + precision * mean
            matrix = scaled.T @ scaled + np.diag(precision)
            covariance, values = inverse_and_solution(matrix, right)
            residual = target - columns @ values
            predicted = wrench - residual
            leverage = ((scaled @ covariance) * scaled).sum(axis=1).reshape(count, 6)
            weight = _spectral_weights(residual, leverage)
            odd = np.abs(values[parameters]).max()
            precision[parameters] = 1 / np.clip(odd, 1.0, LOOSEST) ** 2
        return self._with_loose_place(values[moves], covariance[moves, moves])

    def _with_loose_place(self, moves: Array, covariance: Array) -> tuple[Array, Array]:
        """Correction with an unknown place at zero, and the others as they are then."""
        loose = [k for k in SHIFT if covariance[k, k] > FAR**2]
        gain = np.linalg.solve(covariance[np.ix_(loose, loose)], covariance[loose])
        return moves - (moves[loose] + self._frame.place[loose]) @ gain, covariance

    def wrench_fit(self, each: PlateExplanation) -> WrenchFit:
        """The channels by an explanation, and what parameters and constants make of them.

        Args:
            each: Of the plate.
        """
        wrench, left = self.wrench(each), self.posterior(each)[2]
        return WrenchFit(
            self._instants.motion.t, wrench, wrench - left, each.unexplained
        )


def _spectral_weights(residual: Array, leverage: Array) -> Array:
    """One over the sigma of what is left around each frequency of a channel, (T, 6)."""
    from scipy.ndimage import uniform_filter1d

    around = 1 + int(AROUND * len(residual))
    free = uniform_filter1d(1 - leverage, around, axis=0)
    square = uniform_filter1d(residual**2, around, axis=0)
    return np.asarray(np.sqrt(np.maximum(free, 1e-9) / np.maximum(square, 1e-24)))
