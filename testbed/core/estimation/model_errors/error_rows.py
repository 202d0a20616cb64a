"""Regression rows of a problem, with columns of model errors."""

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
    block_diagonal_columns,
)
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.estimation.model_errors.linearizer import (
    Linearizer,
    WindowStates,
    with_common_sizes,
)
from testbed.core.estimation.noise.lagged_products import MAX_AUTOREGRESSION_ORDER
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    solve_scaled,
)
from testbed.core.estimation.regression.windows import Plan
from testbed.core.estimation.sensor.predicted_wrench import row_filter
from testbed.core.kernel.records import (
    MAX_REST_SHARE,
    MAX_REST_VARIANCE,
    REST_VARIANCE,
    SignalWindow,
)
from testbed.core.recordings.source import Source

ROWS_PER_CUTOFF = 2.0
"""Rows a second per Hz of the row filter's cutoff: the smallest rate without aliasing."""

MAX_ROWS, PIECES = 600, 4
"""Largest number of rows in use; number of pieces of a longer recording."""

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ErrorRows:
    """Regression rows of a recording, to which columns of model errors are added.

    Rows are filtered and in units of the measurement; rows in gaps are zero.

    Attributes:
        columns: Columns of the unknowns, (C, R, p), of C channels, R rows and p unknowns.
        measured: Measurements, (C, R) [N, N m].
        linearizer: Linearizer of the recording.
        states: Motion of each window.
        window_rows: First row and number of rows of each window.
        rest_covariances: Covariance of each window's rows due to friction at rest with unit
            variance, (C, rows, rows) each; (0, rows, rows) for the wrench.
    """

    columns: Array
    measured: Array
    linearizer: Linearizer
    states: tuple[WindowStates, ...]
    window_rows: tuple[tuple[int, int], ...]
    rest_covariances: tuple[Array, ...]

    @cached_property
    def linearizations(self) -> tuple[Linearization, ...]:
        """Linearisation of each window, with signal magnitudes of the whole recording."""
        return with_common_sizes(
            [self.linearizer.linearization(each, None) for each in self.states]
        )

    def encoder_share(self, residual: Array) -> float:
        """Largest share of encoder noise in any channel's squared residual.

        White noise of the accelerations below the row filter's cutoff is propagated by the
        derivatives of the forces with respect to the accelerations. The share may exceed one.

        Args:
            residual: Mean squared residuals, (C,) [N^2, (N m)^2].
        """
        cutoff = self.linearizer.problem.settings.row_low_pass or 0.0
        noise = np.mean([each.noise for each in self.states], axis=0)
        acceleration = noise * 2 * (2 * np.pi) ** 4 * cutoff**5 / 5
        n = len(noise)
        slopes = [
            linearization.slopes.acceleration[:, :, :n]
            for linearization in self.linearizations
        ]
        square = np.mean([(each**2).mean(axis=0) for each in slopes], axis=0)
        return float(
            np.max(square @ acceleration / np.maximum(residual, SMALLEST_POSITIVE))
        )

    @cached_property
    def row_mask(self) -> NDArray[np.bool_]:
        """True for the rows in use: rows with a nonzero column of the unknowns, (C, R)."""
        return np.asarray(self.columns.any(axis=2))

    def family_columns(
        self, families: Sequence[ModelErrorFamily]
    ) -> tuple[dict[str, Array], dict[str, Indices]]:
        """Columns of each family at the rows, (C, R, k), and indices of alternative columns.

        The columns of families are computed at fewer instants than `columns`. Their weighted
        least-squares projection on the unknowns' columns at these instants is replaced by the same
        combination of `columns`, so that the difference between the rates does not appear as an
        effect.

        Args:
            families: Families of model errors.

        Returns:
            Columns keyed by kind of family, whitened by `whitened_rows`; and, for families with
                alternatives, indices of the columns in use, (2 C,), which are the best pair of each
                joint (`_best_alternatives`).
        """
        alternatives = dict[str, Indices]()
        columns = [self._columns_at_rows(family, alternatives) for family in families]
        all_columns = np.concatenate(columns, axis=2)
        unknowns = self._filtered_rows(
            [
                self.linearizer.unknown_columns(linearization.motion)
                for linearization in self.linearizations
            ]
        )
        scale = (
            self.row_mask
            / np.sqrt((self.measured**2).mean(axis=1) + SMALLEST_POSITIVE)[:, None]
        )
        scaled = (unknowns * scale[..., None]).reshape(-1, unknowns.shape[2])
        right = scaled.T @ (all_columns * scale[..., None]).reshape(len(scaled), -1)
        imitation = solve_scaled(scaled.T @ scaled, right)
        all_columns = self.whitened_rows(
            all_columns + (self.columns - unknowns) @ imitation
        )
        ends = np.cumsum([each.shape[2] for each in columns])[:-1]
        kinds = [family.kind for family in families]
        return dict(
            zip(kinds, np.split(all_columns, ends, axis=2), strict=True)
        ), alternatives

    def _columns_at_rows(
        self, family: ModelErrorFamily, alternatives: dict[str, Indices]
    ) -> Array:
        """Columns of a family at the rows, (C, R, k), separate per joint for joint families.

        Args:
            family: Family of model errors.
            alternatives: Column indices of the best alternatives, keyed by kind; the indices of
                this family are added if it has alternatives.
        """
        if not isinstance(family, JointFamily):
            return self._filtered_rows(
                [family.columns(linearization) for linearization in self.linearizations]
            )
        torques = self._filtered_rows(
            [family.torques(linearization) for linearization in self.linearizations]
        )
        if family.alternatives > 1:
            torques, alternatives[family.kind] = self._best_alternatives(
                torques, family.alternatives
            )
        return block_diagonal_columns(torques)

    def _best_alternatives(self, columns: Array, count: int) -> tuple[Array, Indices]:
        """Best pair of columns for each channel, (C, R, 2), and column indices, (2 C,).

        The best pair has the largest sum of the reductions of the squared residual by either column
        alone. The residual is computed from the unknowns of the linearizer. Indices run over the
        columns of all channels, channel by channel.

        Args:
            columns: Pairs of columns of each channel, (C, R, 2 count).
            count: Number of pairs.
        """
        residual = self.row_mask * (
            self.measured - self.columns @ self.linearizer.values
        )
        products = (columns * residual[..., None]).sum(axis=1) ** 2
        explained = products / np.maximum((columns**2).sum(axis=1), SMALLEST_POSITIVE)
        pairs = explained.reshape(len(columns), count, 2).sum(axis=2)
        chosen = 2 * pairs.argmax(axis=1)[:, None] + np.arange(2)
        indices = 2 * count * np.arange(len(columns))[:, None] + chosen
        return np.take_along_axis(columns, chosen[:, None], axis=2), indices.ravel()

    def _filtered_rows(self, signals: Sequence[Array]) -> Array:
        """Signals of all windows, filtered to the rows, (C, R, k); zero in gaps.

        Args:
            signals: Signals of each window at its m instants, (m, C, k).
        """
        rows = np.zeros((*self.measured.shape, signals[0].shape[2]))
        for linearization, (row, count), each in zip(
            self.linearizations, self.window_rows, signals, strict=True
        ):
            rows[:, row : row + count] = linearization.filtered_rows(each)
        return rows

    def whitened_rows(self, rows: Array) -> Array:
        """Rows whitened for unknown friction at rest, (C, R, k); rows not in use are zero.

        Near rests of a joint, the covariance of the noise is 1 + REST_VARIANCE times the rest
        covariance. Rows with a large variance due to friction (`_rest_factors`) are also zero.

        Args:
            rows: Filtered rows, (C, R, k).
        """
        white = rows * self.row_mask[..., None]
        for channel, indices, factor, counts in self._rest_factors:
            scaled = solve_triangular(factor, white[channel, indices], lower=True)
            white[channel, indices] = counts[:, None] * scaled
        return white

    @cached_property
    def _rest_factors(self) -> list[tuple[int, Indices, Array, NDArray[np.bool_]]]:
        """Cholesky factors of the noise covariance of rows near standstills, by window and channel.

        Near a standstill, dry friction is uncertain and adds to the noise. A row is used if its
        variance, given earlier rows, is below 1 + MAX_REST_VARIANCE, and if the samples at
        standstill have less than MAX_REST_SHARE of the row's squared filter weights.

        Returns:
            Channel, row indices, Cholesky factor, and mask of the rows in use, for each group of
                rows.
        """
        factors = []
        for (row, _), covariances in zip(
            self.window_rows, self.rest_covariances, strict=True
        ):
            for channel, each in enumerate(covariances):
                indices = np.flatnonzero(each.diagonal())
                covariance = each[np.ix_(indices, indices)]
                factor = np.linalg.cholesky(
                    np.eye(len(indices)) + REST_VARIANCE * covariance
                )
                counts = np.diagonal(factor) ** 2 < 1 + MAX_REST_VARIANCE
                counts &= covariance.diagonal() < MAX_REST_SHARE
                factors.append((channel, indices + row, factor, counts))
        return factors


def error_rows(
    problem: Problem,
    source: Source,
    values: Array,
    prior: Array,
    pieces: int = PIECES,
) -> ErrorRows:
    """Build the rows of a problem and the motion around each window.

    Rows near rests and reversals are included, since friction at rest is treated as noise in
    `ErrorRows.whitened_rows`.

    Args:
        problem: Problem with chosen terms and filters; rows are filtered.
        source: Recording corrected for sensor errors.
        values: Estimated unknowns, about which model errors are linearised, (p,).
        prior: Rows of prior information on the unknowns and their right-hand side, with unit noise,
            (r, p + 1). If there are prior rows, model errors are linearised about a fit to rows and
            prior together instead of `values`.
        pieces: Number of evenly spread pieces, with MAX_ROWS rows together, of a longer recording.
    """
    passes = problem.passes(1, source, whole=True, per_cutoff=ROWS_PER_CUTOFF)
    plan = passes.plan = replace(
        _shortened_plan(passes.plan, pieces), deadband=0.0, reversal_reach=0
    )
    linearizer = linearizer_of(problem, plan, values)
    windows: dict[int, tuple[WindowStates, Array]] = {}

    def inspect_window(signals: SignalWindow, row: int) -> Array:
        states = linearizer.states(signals, row)
        windows[row] = states, _rest_covariances(linearizer, states, signals)
        return np.zeros((plan.layout.channel_count, signals.row_count, 0))

    blocks = passes.rows_with_columns(np.eye(len(values)), inspect_window, gaps=False)
    parts = [(columns, measured) for columns, _, measured in blocks]
    columns, measured = (
        np.concatenate(each, axis=1) for each in zip(*parts, strict=True)
    )
    window_rows = _window_rows(plan)
    if len(prior):
        values = _solution_with_prior(columns, measured, prior)
        linearizer = replace(linearizer, values=values)
    return ErrorRows(
        _spaced_rows(columns, window_rows),
        _spaced_rows(measured, window_rows),
        linearizer,
        tuple(windows[row][0] for row in sorted(windows)),
        window_rows,
        tuple(windows[row][1] for row in sorted(windows)),
    )


def _solution_with_prior(columns: Array, measured: Array, prior: Array) -> Array:
    """Least-squares solution from rows (C, R, p) and a prior, (p,).

    Channels are weighted by the inverse RMS of their residuals, in three iterations.

    Args:
        columns: Columns of the unknowns, (C, R, p).
        measured: Measurements, (C, R).
        prior: Rows of prior information and their right-hand side, with unit noise, (r, p + 1).
    """
    count = np.maximum(columns.any(axis=2).sum(axis=1), 1.0)
    size = np.sqrt((measured**2).sum(axis=1) / count)
    values = np.zeros(columns.shape[2])
    for _ in range(3):
        scale = (1 / np.maximum(size, SMALLEST_POSITIVE))[:, None]
        rows = (columns * scale[..., None]).reshape(-1, len(values))
        matrix = np.concatenate([rows, prior[:, :-1]])
        right = np.concatenate([(measured * scale).ravel(), prior[:, -1]])
        values = solve_scaled(matrix.T @ matrix, matrix.T @ right)
        size = np.sqrt(((measured - columns @ values) ** 2).sum(axis=1) / count)
    return values


def linearizer_of(problem: Problem, plan: Plan, values: Array) -> Linearizer:
    """Linearizer of a problem at the rows of a plan.

    Args:
        problem: Robot and recording; rows are filtered.
        plan: Plan of the rows.
        values: Unknowns, (p,).
    """
    cutoff = problem.settings.row_low_pass
    assert cutoff is not None
    return Linearizer(problem, values, plan, row_filter(plan, cutoff))


def _shortened_plan(plan: Plan, number: int) -> Plan:
    """Plan of at most MAX_ROWS rows, in pieces spread evenly over a longer recording.

    A piece ends at the first gap in its rows. A plan of at most MAX_ROWS rows is unchanged.

    Args:
        plan: Plan of the rows.
        number: Number of pieces.
    """
    total = sum(count for _, count in plan.spans)
    if total <= MAX_ROWS:
        return plan
    rows = np.concatenate([first + np.arange(count) for first, count in plan.spans])
    size = MAX_ROWS // number
    starts = np.linspace(0, total - size, number).astype(int)
    pieces = []
    for start in starts.tolist():
        piece = rows[start : start + size]
        length = int(np.argmax(np.append(np.diff(piece) > 1, True))) + 1
        pieces.append((int(piece[0]), length))
    return replace(plan, spans=tuple(pieces))


def _window_rows(plan: Plan) -> tuple[tuple[int, int], ...]:
    """First row and number of rows of each window, with empty rows for gaps.

    A gap of any duration is represented by MAX_AUTOREGRESSION_ORDER rows, the largest lag of the
    noise models.
    """
    window_rows, row, end = [], 0, -1
    for window in plan.windows():
        row += MAX_AUTOREGRESSION_ORDER * (end >= 0 and window.row != end)
        window_rows.append((row, window.rows))
        row, end = row + window.rows, window.row + window.rows
    return tuple(window_rows)


def _spaced_rows(rows: Array, window_rows: tuple[tuple[int, int], ...]) -> Array:
    """Rows moved to the given positions, (C, R, ...), with zeros in gaps.

    Args:
        rows: Consecutive rows of all windows, (C, rows, ...).
        window_rows: First row and number of rows of each window.
    """
    last, count = window_rows[-1]
    spaced = np.zeros((len(rows), last + count, *rows.shape[2:]))
    done = 0
    for first, number in window_rows:
        spaced[:, first : first + number] = rows[:, done : done + number]
        done += number
    return spaced


def _rest_covariances(
    linearizer: Linearizer, states: WindowStates, signals: SignalWindow
) -> Array:
    """Covariance of rows due to white torque noise at rests of each joint, (n, rows, rows).

    The noise has variance one at instants with a speed up to the deadband or, if larger, the
    window's `speed_threshold`, and zero elsewhere. The squared weights of a row sum to one. For the
    wrench, the shape is (0, rows, rows).

    Args:
        linearizer: Linearizer of the recording.
        states: Motion of the window.
        signals: Signals of the window.
    """
    filtered, step = linearizer.filter, linearizer.fine_step
    problem = linearizer.problem
    if problem.method == "wrench":
        return np.zeros((0, signals.row_count, signals.row_count))
    centre = len(filtered.sample_weights) // 2
    reach = slice(centre - filtered.half_width, centre + filtered.half_width + 1, step)
    weights = filtered.sample_weights[reach]
    row_weights = np.zeros((signals.row_count, states.fine.samples))
    for k, row in enumerate(row_weights):
        begin = k * (signals.step // step)
        row[begin : begin + len(weights)] = weights
    row_weights /= np.sqrt(weights @ weights)
    min_speed = np.maximum(problem.settings.deadband, states.speed_threshold)
    rests = np.abs(states.fine.qd.T) <= min_speed[:, None]
    return np.stack([row_weights[:, each] @ row_weights[:, each].T for each in rests])
