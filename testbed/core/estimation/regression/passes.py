"""Passes over the samples, window by window, on several threads, in constant memory.

Windows and the order of their results do not depend on the source or the number of threads, so that
all numbers computed from them are bitwise reproducible.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from math import comb
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, TypeVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.stages import Progress
from testbed.core.estimation.regression.windows import Plan, Window
from testbed.core.kernel import numpy_engine
from testbed.core.kernel.layout import Layout
from testbed.core.kernel.records import Block, SignalWindow, Sums, signals_of_motion
from testbed.core.recordings.columns import MAX_VALUE, check_times, check_values
from testbed.core.recordings.recording import Recording

SURVEY_SAMPLES = 20_000
"""Approximate number of samples of a survey: enough to show ranges and limits."""

DIFFERENCE_ORDER = 8
"""Order of the differences of positions: of a motion at a tenth of the sampling rate 2 % remain."""

MAX_HELD_FRACTION = 0.1
"""Largest fraction of repeated poses; above it the encoders are sampled more slowly."""

MIN_INCLUDED_SHARE = 0.05
"""Smallest part of the square of a row's weights on included samples for the row to be included."""

NOISE_SEGMENT = 256
"""Number of samples over which squared noise is averaged; the median of the averages is robust
against spikes."""


class Repeats(NamedTuple):
    """Counts of samples equal to the previous sample although the encoder readings differ.

    Attributes:
        moving_pairs: Number of pairs of consecutive samples with different encoder readings.
        equal_by_channel: Number of these pairs in which a channel is equal, (C,).
        all_equal: Number of these pairs in which all channels are equal.
        repeated_poses: Number of these pairs followed by a sample with equal encoder readings,
            which is a repeated pose.
        pairs: Number of pairs of consecutive samples.
    """

    moving_pairs: int
    equal_by_channel: Array
    all_equal: int
    repeated_poses: int
    pairs: int


@dataclass(frozen=True, eq=False)
class Survey:
    """Subsample of the raw signals, with repeats, noise and least counts of the encoders.

    Attributes:
        position: Encoder positions, (m, n) [rad or m].
        measured: Motor torques, (m, n) [N m or N], or wrench without tare, (m, 6) [N, N m].
        repeats: Numbers of repeated samples, among all samples.
        encoder_noise: Standard deviation of the encoders' noise, assumed white, (n,) [rad or m];
            zero for repeated poses.
        encoder_count: Least count of encoders whose quantization exceeds their noise; zero for the
            others, (n,) [rad or m].
    """

    position: Array
    measured: Array
    repeats: Repeats
    encoder_noise: Array
    encoder_count: Array


class Surveyor:
    """Accumulator of the `Survey` of a recording over its windows, in any order."""

    def __init__(self, samples: int) -> None:
        """Start a survey of a recording with the given number of samples."""
        self.stride = max(1, samples // SURVEY_SAMPLES)
        self._subsamples: dict[int, tuple[Array, Array, Repeats]] = {}
        self._noise_by_window: dict[int, tuple[Array, Array]] = {}

    def add(
        self, signals: SignalWindow, first: int, count: int, analyse_noise: bool = True
    ) -> None:
        """Add a subsample of a window, its repeated samples and its encoder noise.

        Args:
            signals: Signals of the window.
            first: Index of the window's first sample.
            count: Number of samples before the first sample of the next window.
            analyse_noise: True to estimate the encoders' noise and least counts.
        """
        kept_samples = slice(-first % self.stride, count, self.stride)
        position, measured = signals.position, signals.measured
        repeats = _count_repeats(position[: count + 1], measured[: count + 1])
        self._subsamples[first] = (
            position[kept_samples].copy(),
            measured[kept_samples].copy(),
            repeats,
        )
        if analyse_noise:
            noise = _per_encoder(noise_variance, position[: count + DIFFERENCE_ORDER])
            self._noise_by_window[first] = (
                noise,
                _per_encoder(_least_count, position[: count + 1]),
            )

    def survey(self) -> Survey:
        """Subsample, repeats, encoder noise and least counts of all windows, in time order.

        Noise and least counts are medians over windows. The noise is zero if the fraction of
        repeated poses is at least MAX_HELD_FRACTION.
        """
        parts = zip(
            *(self._subsamples[first] for first in sorted(self._subsamples)),
            strict=True,
        )
        positions, measured, repeats_by_window = parts
        repeats = Repeats(
            *(sum(counts) for counts in zip(*repeats_by_window, strict=True))
        )
        noise_squares, least_counts = zip(
            *(self._noise_by_window[k] for k in sorted(self._noise_by_window)),
            strict=True,
        )
        # repeated poses do not show the noise
        noise = (repeats.repeated_poses < MAX_HELD_FRACTION * repeats.pairs) * np.sqrt(
            np.median(noise_squares, axis=0)
        )
        counts = _counts_above_noise(np.stack(least_counts), noise)
        return Survey(
            np.concatenate(positions), np.concatenate(measured), repeats, noise, counts
        )


def _count_repeats(position: Array, measured: Array) -> Repeats:
    """Count samples equal to the previous sample, in encoders and channels.

    Args:
        position: Encoder positions, (m, n).
        measured: Samples of the channels, (m, C).
    """
    # a product of booleans is true where any is: ten times faster than `any` along short rows
    any_joint, any_channel = (
        np.ones(signal.shape[1], np.bool_) for signal in (position, measured)
    )
    moved = (position[1:] != position[:-1]) @ any_joint
    held_count = int(np.sum(moved[:-1] & ~moved[1:]))
    equal = measured[1:] == measured[:-1]
    equal = equal[moved & (equal @ any_channel)]
    channels = equal.sum(axis=0).astype(np.float64)
    together = len(equal) - int(np.sum(~equal @ any_channel))
    return Repeats(int(np.sum(moved)), channels, together, held_count, len(moved))


def _per_encoder(quantity: Callable[[Array], float], position: Array) -> Array:
    """Values of a function of each encoder's positions, (n,).

    Args:
        quantity: Function of the positions of one encoder, (m,).
        position: Encoder positions, (m, n).
    """
    return np.array([quantity(column) for column in np.ascontiguousarray(position.T)])


def noise_variance(position: Array) -> float:
    """Mean square of white noise in consecutive positions; zero for too few positions.

    Differences of order DIFFERENCE_ORDER remove the motion. The result is the median of their mean
    squares over segments of NOISE_SEGMENT samples.

    Args:
        position: Positions of one encoder, (m,) [rad or m].
    """
    differences = np.diff(position, DIFFERENCE_ORDER)
    if not len(differences):
        return 0.0
    starts = np.arange(0, max(len(differences) - NOISE_SEGMENT, 0) + 1, NOISE_SEGMENT)
    ends = np.append(starts[1:], len(differences))
    means = np.add.reduceat(differences**2, starts) / (ends - starts)
    return float(np.median(means)) / comb(2 * DIFFERENCE_ORDER, DIFFERENCE_ORDER)


def _least_count(position: Array) -> float:
    """Least count of an encoder; zero without quantisation, nan if undetermined.

    Of at least 16 changes up to 4.5 times the smallest change, 95 % have to be multiples of it.

    Args:
        position: Consecutive positions of one encoder, (m,) [rad or m].
    """
    changes = np.abs(np.diff(position))
    smallest = changes.min(initial=np.inf, where=changes > 0)
    small_changes = changes[changes < 4.5 * smallest]
    small_changes = small_changes[small_changes > 0]
    # smallest number of small changes that determines a least count
    if len(small_changes) < 16:
        return float("nan")
    count = float(small_changes[small_changes < 1.5 * smallest].mean())
    # largest deviation of a difference from a multiple of the least count, by rounding
    is_whole = np.abs(small_changes / count - np.round(small_changes / count)) < 0.1
    # smallest share of differences that are multiples of the least count
    return count if is_whole.mean() >= 0.95 else 0.0


def _counts_above_noise(counts: Array, noise: Array) -> Array:
    """Median least count of each encoder, (n,); zero for noise above 0.4 counts.

    Args:
        counts: Least counts in each window, (windows, n); nan where unknown.
        noise: Standard deviation of the encoders' noise, (n,).
    """
    least_counts = np.nanmedian(
        np.where(np.isnan(counts).all(axis=0), 0.0, counts), axis=0
    )
    # noise in least counts above which these are blurred; rounding alone makes 0.29 at most
    return np.where(noise < 0.4 * least_counts, least_counts, 0.0)


ColumnFunction = Callable[[SignalWindow, int], Array]
"""Function that returns additional columns of a window, (C, rows, s), from its signals and the
index of its first row."""

Result = TypeVar("Result")

MIN_COMPILED_SECONDS = 0.05
"""Computing time of NumPy for rows above which the compiled kernel is used [s]; it takes 0.4 s to
load."""


def is_compiled(plan: Plan) -> bool:
    """True if the compiled kernel is used: if NumPy would take MIN_COMPILED_SECONDS or more."""
    # measured time of NumPy per sample, and per sample and number of `Layout.theta` [s]
    seconds = plan.source.samples * (4e-6 + 6e-9 * plan.layout.theta.size)
    preferred = plan.engine == "compiled" or (
        plan.engine == "by size" and seconds >= MIN_COMPILED_SECONDS
    )
    return preferred and plan.layout.is_compiled


def _engine(plan: Plan) -> Any:
    """Module that computes a plan's rows: compiled kernel or NumPy."""
    if not is_compiled(plan):
        return numpy_engine
    from testbed.core.kernel import numba_engine  # imports Numba

    return numba_engine


def motion_rows(plan: Plan, q: Array, qd: Array, qdd: Array) -> Array:
    """Unfiltered regressor rows of a motion, with zero measurements, (slots, M).

    `slots` is the number of matrix entries per sample in the layout of the plan.

    Args:
        plan: Plan of the rows.
        q: Positions, (M, n) [rad or m].
        qd: Velocities, (M, n).
        qdd: Accelerations, (M, n).
    """
    signals, engine = (
        signals_of_motion(q, qd, qdd, plan.layout.channel_count),
        _engine(plan),
    )
    blocks = engine.rows(plan.layout, signals, engine.workspace(plan.layout, signals))
    return np.concatenate([block.rows for block in blocks], axis=1)


def scale_to_unit_noise(
    layout: Layout, signals: SignalWindow, blocks: Sequence[Block]
) -> list[Block]:
    """Scale rows with excluded samples to the white-noise variance of complete rows.

    Rows with less than MIN_INCLUDED_SHARE of their squared weights on included samples become zero.

    Args:
        layout: Layout of the rows.
        signals: Signals of the window.
        blocks: Rows of the window.
    """
    squares = signals.weights**2 / np.sum(signals.weights**2)
    indices = signals.start + signals.step * np.arange(signals.row_count)
    included_share = np.stack(
        [np.convolve(each, squares, "same")[indices] for each in signals.sample_mask.T]
    )
    scale = np.where(
        included_share < MIN_INCLUDED_SHARE,
        0.0,
        np.maximum(included_share, MIN_INCLUDED_SHARE) ** -0.5,
    )
    factor = np.repeat(scale, layout.rows.width, axis=0)
    scaled = []
    for block in blocks:
        rows = block.rows * factor[:, block.first :][:, : block.rows.shape[1]]
        channels = np.split(rows, layout.rows.start[1:])
        used = [np.count_nonzero(each.any(axis=0)) for each in channels]
        scaled.append(Block(block.first, rows, np.array(used, np.float64)))
    return scaled


class Passes:
    """Passes over all rows of a plan, for sums of products or the rows themselves."""

    def __init__(
        self, plan: Plan, threads: int | None, progress: Progress, number: int
    ) -> None:
        """Prepare the passes.

        Args:
            plan: Plan of the rows.
            threads: Number of threads; None for one per processor.
            progress: Callback with the number of samples done and the total of all passes.
            number: Number of passes, for progress reports.
        """
        self.number = number
        self.plan = plan
        self.compiled, self._engine = is_compiled(plan), _engine(plan)
        self.threads = max(1, threads or os.cpu_count() or 1) if self.compiled else 1
        self.progress = progress
        self.done = 0
        self.surveyor, self._close_windows = (
            Surveyor(plan.source.samples),
            plan.analysed_windows,
        )
        self._workspaces: SimpleQueue[Any] = SimpleQueue()
        self._cached_blocks: dict[int, list[Block]] = {}
        # other rows are computed as fast as they are read
        thinned = not self.compiled or len(plan.weights) > 1
        # number of first rows that are cached between passes, up to 100 MB
        self._cached_rows = 100e6 // (plan.layout.rows.slots * 8) if thinned else 0

    def sums(self) -> Iterator[Sums]:
        """Sums of products of all windows in order, with a check of the samples read."""
        return self._window_results(self._checked_sums)

    def rows(self, combined: Array) -> Iterator[tuple[Array, Array]]:
        """Blocks of all rows: combined columns, (C, k, q), and measurements, (C, k).

        Args:
            combined: Matrix that combines the columns, (p, q).
        """
        return (
            (columns, measured)
            for columns, measured in self.rows_with_columns(combined)
        )

    def rows_with_columns(
        self,
        combined: Array,
        *column_functions: ColumnFunction | None,
        gaps: bool = True,
    ) -> Iterator[tuple[Array, ...]]:
        """Yield blocks of all rows: combined columns, additional columns, and measurements.

        Args:
            combined: Matrix that combines the columns, (p, q).
            column_functions: Functions that return additional columns of a window, (C, rows, s)
                each; None for no columns.
            gaps: True to yield zero rows for gaps; else gaps are skipped.
        """
        layout, done = self.plan.layout, 0
        basis = layout.basis @ combined
        results = self._window_results(
            partial(self._rows_and_columns, column_functions)
        )
        for window, (blocks, extra_columns) in zip(
            self.plan.windows(), results, strict=True
        ):
            # rows in a gap are zero, so that time lags stay correct
            if gaps and window.row > done:
                widths = basis.shape[1], *(each.shape[2] for each in extra_columns)
                gap = layout.channel_count, window.row - done
                yield *(np.zeros((*gap, width)) for width in widths), np.zeros(gap)
            done, first = window.row + window.rows, 0
            for block in blocks:
                last = first + block.shape[1]
                parts = (each[:, first:last] for each in extra_columns)
                yield (
                    layout.combine_columns(block, basis),
                    *parts,
                    block[layout.rows.measured],
                )
                first = last

    def _window_results(
        self, compute: Callable[[Recording, Window], Result]
    ) -> Iterator[Result]:
        """Yield results of a function for all windows, in order, computed by several threads.

        Args:
            compute: Function of a window's samples and of the window.
        """
        with ThreadPoolExecutor(self.threads) as pool:
            pending: deque[tuple[Window, Future[Result]]] = deque()
            try:
                for window in self.plan.windows():
                    part = self.plan.source.part(window.first, window.last)
                    future: Future[Result] = Future()
                    if self.threads > 1:
                        future = pool.submit(compute, part, window)
                    else:
                        future.set_result(compute(part, window))
                    pending.append((window, future))
                    if len(pending) > self.threads or self.threads == 1:
                        yield self._next_result(pending)
                while pending:
                    yield self._next_result(pending)
            finally:
                pool.shutdown(cancel_futures=True)

    def _next_result(self, pending: deque[tuple[Window, Future[Result]]]) -> Result:
        """Wait for the oldest pending result and report progress."""
        window, future = pending.popleft()
        result = future.result()
        self.done += window.rows * self.plan.step
        self.progress(self.done, self.number * self.plan.rows * self.plan.step)
        return result

    def _checked_sums(self, part: Recording, window: Window) -> Sums:
        """Sums of products of a window, after its samples were checked and surveyed."""
        check_times(part.time, "the recording", 1 / self.plan.source.rate, window.first)
        signals = self.plan.signals(part, window)
        sums = self._products(signals, window)
        analyse_noise = window.row in self._close_windows
        self.surveyor.add(
            signals, window.first, self.plan.own_sample_count(window), analyse_noise
        )
        if not sums.squares[0] < MAX_VALUE**2:  # false for nan
            check_values(part.columns(), "the recording", window.first)
        return sums

    def _products(self, signals: SignalWindow, window: Window) -> Sums:
        """Sums of products of a window's rows, by the compiled kernel or by NumPy."""
        layout = self.plan.layout
        if self._is_cached(window) or not self.compiled or len(signals.sample_mask):
            return numpy_engine.row_products(
                layout, signals, self._blocks(signals, window)
            )
        with self._workspace(signals) as work:
            sums: Sums = self._engine.row_products(layout, signals, work)
        return sums

    def _rows_and_columns(
        self,
        column_functions: Sequence[ColumnFunction | None],
        part: Recording,
        window: Window,
    ) -> tuple[list[Array], list[Array]]:
        """Rows of a window, block by block, and its additional columns."""
        signals = self.plan.signals(part, window)
        no_columns = np.zeros((self.plan.layout.channel_count, window.rows, 0))
        extra_columns = [
            no_columns if function is None else function(signals, window.row)
            for function in column_functions
        ]
        return [block.rows for block in self._blocks(signals, window)], extra_columns

    def _blocks(self, signals: SignalWindow, window: Window) -> list[Block]:
        """Rows of a window, block by block; cached for the first windows."""
        if window.row in self._cached_blocks:
            return self._cached_blocks[window.row]
        with self._workspace(signals) as work:
            blocks: list[Block] = self._engine.rows(self.plan.layout, signals, work)
        if len(signals.sample_mask):
            blocks = scale_to_unit_noise(self.plan.layout, signals, blocks)
        if self._is_cached(window):
            self._cached_blocks[window.row] = blocks
        return blocks

    def _is_cached(self, window: Window) -> bool:
        """True if the rows of a window are cached between passes."""
        return window.row + window.rows <= self._cached_rows

    @contextmanager
    def _workspace(self, signals: SignalWindow) -> Iterator[Any]:
        """Context manager for a kernel workspace that no other thread uses."""
        try:
            work = self._workspaces.get_nowait()
        except Empty:
            work = self._engine.workspace(self.plan.layout, signals)
        try:
            yield work
        finally:
            self._workspaces.put(work)
