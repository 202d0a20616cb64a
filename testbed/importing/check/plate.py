"""What a mapping may say of a plate, and how well each explains what the plate has measured.

For one order of columns, everything that a mapping says of a plate is a turn, a place, units, and a
delay. Gauss's and Newton's steps on these (`PlateRows.fit`), from the 24 turns that take axes to
axes, all at once, end in the least of all turns: none is further than 63 degrees from a start.
Units are those pairs whose ratio is near; where a turn is near that a person would write, or that
the mapping says, it is tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import chain, permutations, product
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.robot.inertia import from_rpy, from_vector, to_rpy
from testbed.importing.check.instants import Instants, delay
from testbed.importing.check.plate_map import (
    LASTS,
    LATE,
    QUIET,
    RATIO,
    SHIFT,
    SLOPES,
    TURN,
    PlateRows,
    near_file,
    transform,
)
from testbed.importing.check.prior import Prior
from testbed.importing.check.remedies import STEPS, Hypothesis, wrench_tables
from testbed.importing.foreign_table import FORCES, MOMENTS, plain

AS_READ = (0, 1, 2, 3, 4, 5)

PLATE_ORDERS = (
    (3, 4, 5, 0, 1, 2), (1, 0, 2, 3, 4, 5), (0, 2, 1, 3, 4, 5), (2, 1, 0, 3, 4, 5),
    (0, 1, 2, 4, 3, 5), (0, 1, 2, 3, 5, 4), (0, 1, 2, 5, 4, 3),
)  # fmt: skip
"""Moments before forces, and two channels exchanged; axes in another order are a turn."""

ROUNDS, LARGEST_TURN, LARGEST_RATIO = 7, 0.5, 0.7
"""Of Gauss and Newton; their largest steps of a turn [rad] and of the ratio's logarithm."""

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

ROUGH = 0.35
"""Sigma of the logarithm of a model file's masses."""

EXPLAINED = 1e-3
"""Share below which, noise aside, nothing is odd about a channel."""

UNEXPLAINED = 0.05
"""Share of a channel that no reading of a right recording leaves, noise aside."""

MIXED, GAP = 3e-3, 10.0
"""Share that a matrix leaves at most where a plate mixes its channels, and times less than others.
"""

SHIFTED, CLEAR, MOST_SHIFT = 5e-3, 5.0, 50.0
"""Least shift of a plate's frame that is one [m], its sigmas, and its most cost [nats]."""

MOST_MAPS = 40
"""Maps that are judged together with the torques, the best first."""

WIDE = np.repeat([0.2, 1.0, 0.02], [3, 4, 1])
"""Standard deviations of a correction before the data: of the place [m], of the delay [s], of the
turn [rad] and of the ratio."""

CORRECTIONS, AROUND = 4, 0.15
"""Steps of Gauss and Newton to a correction; part of the frequencies over which what is left is
averaged."""

LOOSEST = 10.0
"""Times that a prior's sigmas are wider at most, where data depart from it by as many sigmas."""

MapHypothesis = tuple[tuple[Hypothesis, ...], Array]
"""Hypotheses about a plate, and the map from the recorded wrench by them, (6, 6)."""


@dataclass(frozen=True, eq=False)
class Frame:
    """How a mapping has read the plate.

    Attributes:
        turn: Of the sensor's frame, (3, 3).
        place: Of its origin, (3,) [m].
        units: Of forces and moments.
    """

    turn: Array
    place: Array
    units: tuple[str, str]

    @cached_property
    def _inverse(self) -> Array:
        """The wrench in the sensor's frame of one in the bedplate's, (6, 6)."""
        return np.asarray(np.linalg.inv(transform(self.turn, self.place)))

    def map(
        self, turn: Array, units: tuple[str, str], order: Sequence[int], ratio: float = 1.0
    ) -> Array:
        """The wrench in the bedplate's frame by another reading, of that by this one, (6, 6).

        Args:
            turn: Of the sensor's frame, (3, 3).
            units: Of forces and moments.
            order: In which column each channel is.
            ratio: Times that moments are larger than in these units.
        """
        size = np.repeat([FORCES[units[0]], ratio * MOMENTS[units[1]]], 3)
        own_size = np.repeat([FORCES[self.units[0]], MOMENTS[self.units[1]]], 3)
        columns = np.diag(size) @ np.eye(6)[list(order)] @ np.diag(1 / own_size)
        return transform(turn, self.place) @ columns @ self._inverse


def frame_of(mapping: Mapping[str, Any]) -> Frame:
    """How a mapping has read its plate; as the bedplate's own where it has none, or several.

    Args:
        mapping: What the recording's mapping file says; empty if it has none.
    """
    tables = wrench_tables(mapping)
    table = next((each for name, each in tables.items() if not name.startswith("plates.")), {})
    place = table.get("place") or {"xyz": [0.0] * 3, "rpy": [0.0] * 3}
    force, moment = (plain(each) for each in table.get("units", ("N", "N m")))
    return Frame(from_rpy(place["rpy"]), np.array(place["xyz"], float), (force, moment))


@cache
def quarter_turns() -> tuple[Array, ...]:
    """The 24 turns that take axes to axes, (3, 3), the identity first."""
    turns = [
        np.array(signs)[:, None] * np.eye(3)[list(places)] + 0.0  # no negative zeros
        for places, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
    ]
    proper = [turn for turn in turns if np.linalg.det(turn) > 0]
    return tuple(sorted(proper, key=lambda turn: -float(np.trace(turn))))


def best_hypotheses(
    plate: PlateRows, frame: Frame, order: Sequence[int]
) -> Iterator[MapHypothesis]:
    """The turns and units that explain a plate best, its columns in one order.

    The sense is the sign of what the model file predicts; shift and delay are fitted beside.

    Args:
        plate: Products of its channels.
        frame: How the mapping has read it.
        order: In which column each channel is.
    """
    turn, ratio = _best_turn(plate, frame, order)
    own = MOMENTS[frame.units[1]] / FORCES[frame.units[0]]
    for units in product(FORCES, MOMENTS):
        apart = abs(MOMENTS[units[1]] / FORCES[units[0]] / (ratio * own) - 1)
        if apart > NEAR and units != frame.units:  # as read always: forces may be noise
            continue
        exact, sigma = _refine(plate, frame, turn, units, order)
        angles = [round(angle / STEPS[-1]) * STEPS[-1] for angle in to_rpy(exact)]
        plainer, most = (from_rpy(angles), frame.turn), max(SNAP, SIGMAS * sigma)
        near = [each for each in plainer if np.linalg.norm(exact - each) < most]
        for each in (exact, *near):
            hypotheses = [Hypothesis("plate_order", (), tuple(order))] * (tuple(order) != AS_READ)
            hypotheses += [Hypothesis("units", (), units)] * (units != frame.units)
            hypotheses += [_turn_hypothesis(each)] * bool(np.linalg.norm(each - frame.turn) > 1e-6)
            yield tuple(hypotheses), frame.map(each, units, order)


def _turn_hypothesis(turn: Array) -> Hypothesis:
    """A frame that is turned so, (3, 3)."""
    return Hypothesis("turn", (), tuple(np.round(to_rpy(turn), 6).tolist()))


def _best_turn(plate: PlateRows, frame: Frame, order: Sequence[int]) -> tuple[Array, float]:
    """The best turn of the frame, (3, 3), and how many times too small its moments are."""
    turns = [turn @ frame.turn for turn in quarter_turns()]
    ratios = np.full(len(turns), plate.gain_ratio(frame.map(frame.turn, frame.units, order)))
    for _ in range(ROUNDS):
        pairs = zip(turns, ratios, strict=True)
        maps = [frame.map(turn, frame.units, order, ratio) for turn, ratio in pairs]
        fits = plate.fit(maps, (*SHIFT, LATE, *TURN, RATIO), likely=True)
        best = int(np.argmin(np.log(fits.unexplained + TINY).sum(axis=1)))
        steps = fits.extras[:, list(TURN)]
        size = np.linalg.norm(steps, axis=1, keepdims=True)
        steps = steps * np.minimum(1, LARGEST_TURN / np.maximum(size, LARGEST_TURN))
        turns = [from_vector(step) @ turn for step, turn in zip(steps, turns, strict=True)]
        change = np.clip(fits.extras[:, RATIO], -LARGEST_RATIO, LARGEST_RATIO)
        ratios = ratios * np.exp(change)
    return turns[best], float(ratios[best])


def _refine(
    plate: PlateRows, frame: Frame, turn: Array, units: tuple[str, str], order: Sequence[int]
) -> tuple[Array, float]:
    """The turn with gains of these units, (3, 3), and its largest sigma [rad]."""
    for _ in range(3):
        maps = [frame.map(turn, units, order)]
        fits = plate.fit(maps, (*SHIFT, LATE, *TURN), likely=True)
        turn = from_vector(fits.extras[0, list(TURN)]) @ turn
    return turn, float(fits.sigma[0, list(TURN)].max())


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

    @property
    def shown(self) -> bool:
        """Whether it explains the plate, two channels or more of which are no noise."""
        heard = self.noise < UNEXPLAINED
        return bool(heard.sum() >= 2 and self.explained(UNEXPLAINED))


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

    def __init__(self, prior: Prior, frame: Frame, rows: Array, instants: Instants) -> None:
        """Products of rows and channels.

        Args:
            prior: The robot.
            frame: How the mapping has read the plate.
            rows: Of the wrench on all barycentric parameters, (T, 6, 10 n).
            instants: Of the recording.
        """
        self._prior, self._frame, self.rows, self._instants = prior, frame, rows, instants
        self.measured = instants.wrench.size > 0
        if self.measured:
            self._products = PlateRows(rows @ prior.root, rows @ prior.mean, instants)

    @cached_property
    def least(self) -> float:
        """Share that no map can mend."""
        return self._products.least_share(late=True) if self.measured else 0.0

    @cached_property
    def least_in_time(self) -> float:
        """The same for a plate that is not late."""
        return self._products.least_share()

    def mixed(self, unexplained: Array) -> bool:
        """Whether a matrix of all six channels explains the plate far better than what leaves this.

        Args:
            unexplained: Part of each channel's variance, (6,).
        """
        return self.least_in_time < min(MIXED, float(unexplained.mean()) / GAP)

    @cached_property
    def delay(self) -> tuple[float, float]:
        """How late the plate is by the model file's masses [s], and times less that is left then.

        What the masses predict is held against all maps of the channels.
        """
        wrench = self._instants.wrench
        channels = np.hstack([wrench, np.ones((len(wrench), 1))])
        each = np.einsum("tk,cd->tcdk", channels, np.eye(6)).reshape(len(channels), 6, -1)
        late, times = delay(each, self._products.expected, self._instants.spacing)
        return -late, times

    @cached_property
    def explanations(self) -> list[PlateExplanation]:
        """All that is open: the best turns and units, the columns in their order or in another."""
        if not self.measured:
            return [NO_PLATE]
        plate, frame = self._products, self._frame
        several = self._judge([*best_hypotheses(plate, frame, AS_READ)])
        if not any(each.explained() for each in several):
            others = (best_hypotheses(plate, frame, order) for order in PLATE_ORDERS)
            several += self._judge([*chain.from_iterable(others)])
        return several

    def _judge(self, hypotheses: Sequence[MapHypothesis]) -> list[PlateExplanation]:
        """Explanations by maps, a shift and lateness fitted."""
        if not hypotheses:
            return []
        fits = self._products.fit([each for _, each in hypotheses])
        size = np.log(np.maximum(np.abs(fits.size), 1e-9)) / ROUGH
        costs = WEIGHT * (np.log(fits.unexplained + TINY).sum(axis=1) + size**2)
        several = []
        for k in np.argsort(costs, kind="stable")[:MOST_MAPS]:
            about, each, shift = list(hypotheses[k][0]), hypotheses[k][1], fits.extras[k, SHIFT]
            distance, sigma = (float(np.linalg.norm(x)) for x in (shift, fits.sigma[k, SHIFT]))
            if distance > max(SHIFTED, CLEAR * sigma):
                place = np.round(self._frame.place + shift, 4)
                about.append(Hypothesis("shift", (), tuple(place.tolist())))
            each = each + np.einsum("e,ecd->cd", shift, SLOPES[:3]) @ each
            if fits.size[k] < 0:
                about.append(Hypothesis("sense"))
                each = -each
            late, noise = float(fits.extras[k, LATE]), self._products.noise_share(each)
            shares, cost = fits.unexplained[k], float(costs[k])
            several.append(PlateExplanation(tuple(about), each, late, shares, noise, cost))
        return several

    @cached_property
    def as_read(self) -> PlateExplanation:
        """The plate as it was read; lateness is nobody's mistake."""
        if not self.measured:
            return NO_PLATE
        same = np.eye(6)
        fits = self._products.fit([same], [LATE])
        size = np.log(max(fits.size[0], 1e-9)) / ROUGH
        unexplained = fits.unexplained[0] if fits.size[0] > 0 else np.ones(6)  # of negative masses
        cost = WEIGHT * (np.log(unexplained + TINY).sum() + min(size**2, 1e3)) + self.shift_cost
        late, noise = float(fits.extras[0, LATE]), self._products.noise_share(same)
        return PlateExplanation((), same, late, unexplained, noise, float(cost))

    @cached_property
    def shift_cost(self) -> float:
        """What the frame where it was read costs beside one that is fitted [nats]."""
        if not self.measured:
            return 0.0
        fits = self._products.fit([np.eye(6)])
        distance, sigma = (float(np.linalg.norm(x[0, SHIFT])) for x in (fits.extras, fits.sigma))
        beyond = max(0.0, distance - SHIFTED) / (CLEAR * sigma + 1e-9)
        return min(0.5 * beyond**2, MOST_SHIFT)

    def wrench(self, each: PlateExplanation) -> Array:
        """The bedplate's wrench by an explanation, in time, (T, 6) [N, N m]."""
        data = self._instants
        return (data.wrench + each.late * data.wrench_rate) @ each.map.T

    def posterior(self, each: PlateExplanation) -> tuple[Array, Array]:
        """Parameters by the varying part of the wrench, (10 n,), and their sigmas' root, (10 n, k).

        Args:
            each: Of the plate.
        """
        prior, wrench = self._prior, self.wrench(each)
        rest, moved = wrench - self.rows @ prior.mean, self.rows @ prior.root
        share = np.maximum(each.unexplained, LEAST_LEFT) * LASTS
        sigma = np.sqrt(share * np.maximum(wrench.var(axis=0), 1e-12))
        columns = ((moved - moved.mean(axis=0)) / sigma[:, None]).reshape(-1, moved.shape[2])
        target = ((rest - rest.mean(axis=0)) / sigma).ravel()
        spread, axes = eigh(columns.T @ columns + np.eye(columns.shape[1]))
        scaled = axes / np.sqrt(np.maximum(spread, 1.0))
        root = prior.root @ scaled
        return prior.mean + root @ (scaled.T @ (columns.T @ target)), root

    def zero(self, each: PlateExplanation) -> tuple[Array, Array]:
        """What the plate shows without the robot, and its sigma, (6,) [N, N m].

        The robot's share is of the parameters that the varying part of the wrench identifies, with
        the model file as prior; no motion identifies its weight on a base at rest.

        Args:
            each: Of the plate.
        """
        mean, root = self.posterior(each)
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
        from scipy.ndimage import uniform_filter1d

        data, prior, count = self._instants, self._prior, len(self._instants.wrench)
        constants = np.broadcast_to(np.eye(6), (count, 6, 6))
        signals = (data.wrench, data.wrench_rate, self.rows @ prior.mean)
        wrench, rate, expected = (dct(x, axis=0, norm="ortho") for x in signals)
        model = np.concatenate([self.rows @ prior.root, constants], axis=2)
        model = dct(model, axis=0, norm="ortho")
        parameters, own = prior.root.shape[1], slice(model.shape[2], None)
        precision = np.concatenate([np.ones(parameters), np.zeros(6), 1 / WIDE**2])
        before = np.zeros(len(precision))
        before[own][list(SHIFT)] = -self._frame.place  # where the prior has its mean
        left = np.maximum(each.unexplained * data.wrench.var(axis=0), 1e-30)
        around = 1 + int(AROUND * count)
        weight, predicted = np.tile(1 / np.sqrt(left), (count, 1)), wrench
        for _ in range(CORRECTIONS):
            slopes = -np.einsum("ecd,td->tce", SLOPES, predicted)
            slopes[:, :, LATE] = -rate
            columns = np.concatenate([model, slopes], axis=2) * weight[..., None]
            columns = columns.reshape(6 * count, -1)
            target = ((wrench - expected) * weight).ravel()
            covariance = np.linalg.inv(columns.T @ columns + np.diag(precision))
            values = covariance @ (columns.T @ target + precision * before)
            residual = (target - columns @ values).reshape(count, 6) / weight
            predicted = wrench - residual
            free = 1 - np.einsum("ti,ti->t", columns @ covariance, columns).reshape(count, 6)
            free, square = (uniform_filter1d(x, around, axis=0) for x in (free, residual**2))
            weight = np.sqrt(np.maximum(free, 1e-9) / np.maximum(square, 1e-24))
            odd = float(np.abs(values[:parameters]).max())
            precision[:parameters] = 1 / np.clip(odd, 1.0, LOOSEST) ** 2
        return values[own], covariance[own, own]

    def wrench_fit(self, each: PlateExplanation) -> WrenchFit:
        """The channels by an explanation, and what parameters and constants make of them.

        Args:
            each: Of the plate.
        """
        wrench = self.wrench(each)
        variance = np.maximum(wrench.var(axis=0), 1e-24)
        sigma = np.sqrt(variance * (QUIET + LASTS * each.noise))
        target = (wrench - self.rows @ self._prior.mean)[..., None]
        left = near_file(self.rows @ self._prior.root, target, sigma)[1][..., 0]
        unexplained = (left**2).mean(axis=0) / variance
        time = self._instants.spacing * np.arange(len(wrench), dtype=np.float64)
        return WrenchFit(time, wrench, wrench - left, unexplained)
