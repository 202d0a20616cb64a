"""Rows of a problem beside which the columns of model errors stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import (
    JointFamily,
    ModelErrorFamily,
    by_channel,
)
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.estimation.model_errors.linearizer import (
    Linearizer,
    States,
    with_sizes,
)
from testbed.core.estimation.noise.lagged_products import HIGHEST
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import TINY, scaled_solve
from testbed.core.estimation.regression.windows import Plan
from testbed.core.estimation.sensor.predicted_wrench import row_filter
from testbed.core.kernel.records import (
    LARGEST_REST,
    LARGEST_VARIANCE,
    REST_VARIANCE,
    Signals,
)
from testbed.core.recordings.source import Source

PER_CUTOFF = 2.0
"""Rows a second per Hz of the filter on rows: the fewest that hold what passes it."""

MOST, PIECES = 600, 4
"""Rows that are looked at; pieces of a longer recording."""

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ErrorRows:
    """Rows of measurements and unknowns, few enough to be held, and what makes more columns.

    Attributes:
        columns: Of the unknowns, (C, R, p).
        measured: (C, R) [N, N m].
        linearizer: Of the recording.
        states: Motion window by window.
        places: First row of each window and how many.
        rests: What a window's rows share of each channel's rests, (C, rows, rows) each.
    """

    columns: Array
    measured: Array
    linearizer: Linearizer
    states: tuple[States, ...]
    places: tuple[tuple[int, int], ...]
    rests: tuple[Array, ...]

    @cached_property
    def linearizations(self) -> tuple[Linearization, ...]:
        """Predicted forces window by window."""
        return with_sizes(
            [self.linearizer.linearization(each, None) for each in self.states]
        )

    def encoder_share(self, residual: Array) -> float:
        """Greatest part of a channel's residual, in squares, that is the encoders' noise.

        Args:
            residual: Mean squares, (C,).
        """
        cutoff = self.linearizer.problem.settings.row_low_pass or 0.0
        noise = np.mean([each.noise for each in self.states], axis=0)
        acceleration = noise * 2 * (2 * np.pi) ** 4 * cutoff**5 / 5
        n = len(noise)
        slopes = [at.slopes.acceleration[:, :, :n] for at in self.linearizations]
        square = np.mean([(each**2).mean(axis=0) for each in slopes], axis=0)
        return float(np.max(square @ acceleration / np.maximum(residual, TINY)))

    @cached_property
    def used(self) -> NDArray[np.bool_]:
        """Whether a row counts, (C, R)."""
        return np.asarray(self.columns.any(axis=2))

    def families(
        self, families: Sequence[ModelErrorFamily]
    ) -> tuple[dict[str, Array], dict[str, Indices]]:
        """Columns of families by kind, (C, R, k) each, whitened of rests; alternatives kept.

        They are made of fewer instants than the unknowns' columns are. What unknowns imitate of
        them is taken from columns made alike, so that no such difference passes for an effect.

        Args:
            families: Of model errors.
        """
        kept = dict[str, Indices]()
        columns = [self._of_family(family, kept) for family in families]
        every = np.concatenate(columns, axis=2)
        alike = self._at_rows(
            [self.linearizer.unknowns(at.motion) for at in self.linearizations]
        )
        scale = self.used / np.sqrt((self.measured**2).mean(axis=1) + TINY)[:, None]
        scaled = (alike * scale[..., None]).reshape(-1, alike.shape[2])
        right = scaled.T @ (every * scale[..., None]).reshape(len(scaled), -1)
        imitated = scaled_solve(scaled.T @ scaled, right)
        every = self.whitened(every + (self.columns - alike) @ imitated)
        ends = np.cumsum([each.shape[2] for each in columns])[:-1]
        kinds = [family.kind for family in families]
        return dict(zip(kinds, np.split(every, ends, axis=2), strict=True)), kept

    def _of_family(self, family: ModelErrorFamily, kept: dict[str, Indices]) -> Array:
        """Columns of a family at the rows, (C, R, k); places of the best alternatives in `kept`."""
        if not isinstance(family, JointFamily):
            return self._at_rows([family.columns(at) for at in self.linearizations])
        own = self._at_rows([family.torques(at) for at in self.linearizations])
        if family.alternatives > 1:
            own, kept[family.kind] = self._best(own, family.alternatives)
        return by_channel(own)

    def _best(self, columns: Array, count: int) -> tuple[Array, Indices]:
        """Pair of columns of each channel, (C, R, 2), that explains most, and their places.

        Args:
            columns: Pairs of each channel, (C, R, 2 count).
            count: Of pairs.
        """
        residual = self.used * (self.measured - self.columns @ self.linearizer.values)
        across = (columns * residual[..., None]).sum(axis=1) ** 2
        explained = across / np.maximum((columns**2).sum(axis=1), TINY)
        pairs = explained.reshape(len(columns), count, 2).sum(axis=2)
        own = 2 * pairs.argmax(axis=1)[:, None] + np.arange(2)
        places = 2 * count * np.arange(len(columns))[:, None] + own
        return np.take_along_axis(columns, own[:, None], axis=2), places.ravel()

    def _at_rows(self, signals: Sequence[Array]) -> Array:
        """Signals of the windows, (m, C, k) each, filtered at the rows, (C, R, k)."""
        found = np.zeros((*self.measured.shape, signals[0].shape[2]))
        for at, (row, count), each in zip(
            self.linearizations, self.places, signals, strict=True
        ):
            found[:, row : row + count] = at.rows(each)
        return found

    def whitened(self, rows: Array) -> Array:
        """Rows, (C, R, k), whitened of the unknown friction at rest; others are zero.

        Args:
            rows: As filtered.
        """
        white = rows * self.used[..., None]
        for channel, near, root, counts in self._roots:
            scaled = solve_triangular(root, white[channel, near], lower=True)
            white[channel, near] = counts[:, None] * scaled
        return white

    @cached_property
    def _roots(self) -> list[tuple[int, Indices, Array, NDArray[np.bool_]]]:
        """Channel, rows near its rests, root of their noise's covariance, which count."""
        found = []
        for (row, _), share in zip(self.places, self.rests, strict=True):
            for channel, each in enumerate(share):
                near = np.flatnonzero(each.diagonal())
                own = each[np.ix_(near, near)]
                root = np.linalg.cholesky(np.eye(len(near)) + REST_VARIANCE * own)
                counts = np.diagonal(root) ** 2 < 1 + LARGEST_VARIANCE
                counts &= own.diagonal() < LARGEST_REST
                found.append((channel, near + row, root, counts))
        return found


def error_rows(
    problem: Problem,
    source: Source,
    values: Array,
    prior: Array,
    pieces: int = PIECES,
) -> ErrorRows:
    """Rows of a problem, and predicted forces around them.

    Args:
        problem: Its terms and filters are chosen; rows are filtered.
        source: The recording, errors of the sensors taken back.
        values: Of the unknowns, by an estimate, (p,).
        prior: Rows of what is known of them before, (r, p + 1); if any, forces are predicted by
            rows and prior together.
        pieces: Of a longer recording.
    """
    passes = problem.passes(1, source, whole=True, per_cutoff=PER_CUTOFF)
    plan = passes.plan = replace(
        _in_pieces(passes.plan, pieces), deadband=0.0, rest_reach=0
    )
    linearizer = linearizer_of(problem, plan, values)
    found: dict[int, tuple[States, Array]] = {}

    def look(signals: Signals, row: int) -> Array:
        states = linearizer.states(signals, row)
        found[row] = states, _rests(linearizer, states, signals)
        return np.zeros((plan.layout.width, signals.number, 0))

    blocks = passes.rows_beside(np.eye(len(values)), look, gaps=False)
    parts = [(columns, measured) for columns, _, measured in blocks]
    every, measured = (
        np.concatenate(each, axis=1) for each in zip(*parts, strict=True)
    )
    places = _places(plan)
    if len(prior):
        values = _with_prior(every, measured, prior)
        linearizer = replace(linearizer, values=values)
    return ErrorRows(
        _apart(every, places),
        _apart(measured, places),
        linearizer,
        tuple(found[row][0] for row in sorted(found)),
        places,
        tuple(found[row][1] for row in sorted(found)),
    )


def _with_prior(columns: Array, measured: Array, prior: Array) -> Array:
    """Least squares of rows (C, R, p) beside a prior, (p,)."""
    count = np.maximum(columns.any(axis=2).sum(axis=1), 1.0)
    size = np.sqrt((measured**2).sum(axis=1) / count)
    values = np.zeros(columns.shape[2])
    for _ in range(3):
        scale = (1 / np.maximum(size, TINY))[:, None]
        rows = (columns * scale[..., None]).reshape(-1, len(values))
        every = np.concatenate([rows, prior[:, :-1]])
        right = np.concatenate([(measured * scale).ravel(), prior[:, -1]])
        values = scaled_solve(every.T @ every, every.T @ right)
        size = np.sqrt(((measured - columns @ values) ** 2).sum(axis=1) / count)
    return values


def linearizer_of(problem: Problem, plan: Plan, values: Array) -> Linearizer:
    """Linearizer of a problem's rows.

    Args:
        problem: Robot and recording; rows are filtered.
        plan: The rows.
        values: Of the unknowns, (p,).
    """
    cutoff = problem.settings.row_low_pass
    assert cutoff is not None
    return Linearizer(problem, values, plan, row_filter(plan, cutoff))


def _in_pieces(plan: Plan, number: int) -> Plan:
    """Plan of MOST rows at most, of a longer recording in pieces that are far apart."""
    total = sum(count for _, count in plan.spans)
    if total <= MOST:
        return plan
    rows = np.concatenate([first + np.arange(count) for first, count in plan.spans])
    size = MOST // number
    starts = np.linspace(0, total - size, number).astype(int)
    pieces = []
    for start in starts.tolist():
        own = rows[start : start + size]
        together = int(np.argmax(np.append(np.diff(own) > 1, True))) + 1
        pieces.append((int(own[0]), together))
    return replace(plan, spans=tuple(pieces))


def _places(plan: Plan) -> tuple[tuple[int, int], ...]:
    """Place of each window's rows among those that are held; what a gap parts lies apart."""
    places, at, end = [], 0, -1
    for window in plan.windows():
        at += HIGHEST * (end >= 0 and window.row != end)
        places.append((at, window.rows))
        at, end = at + window.rows, window.row + window.rows
    return tuple(places)


def _apart(rows: Array, places: tuple[tuple[int, int], ...]) -> Array:
    """Consecutive rows at their places, (C, R, ...), zero between."""
    last, count = places[-1]
    found = np.zeros((len(rows), last + count, *rows.shape[2:]))
    done = 0
    for first, number in places:
        found[:, first : first + number] = rows[:, done : done + number]
        done += number
    return found


def _rests(linearizer: Linearizer, states: States, signals: Signals) -> Array:
    """What rows share of the joints' rests, in squares of their weights, (n, rows, rows)."""
    filtered, step = linearizer.filter, linearizer.step
    problem = linearizer.problem
    if problem.method == "external":
        return np.zeros((0, signals.number, signals.number))
    middle = len(filtered.every_weight) // 2
    reach = slice(middle - filtered.reach, middle + filtered.reach + 1, step)
    weights = filtered.every_weight[reach]
    own = np.zeros((signals.number, states.fine.samples))
    for k, row in enumerate(own):
        begin = k * (signals.step // step)
        row[begin : begin + len(weights)] = weights
    own /= np.sqrt(weights @ weights)
    least = np.maximum(problem.settings.deadband, states.uncertain)
    rests = np.abs(states.fine.qd.T) <= least[:, None]
    return np.stack([own[:, each] @ own[:, each].T for each in rests])
