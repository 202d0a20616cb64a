"""Passes over the samples: window by window, on several threads, in constant memory.

Windows and the order in which their answers come are the same whatever the source and the
number of threads, and so is, to the bit, all that is computed from them.
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
from testbed.core.kernel.records import Block, Signals, Sums, sensed
from testbed.core.recordings.columns import LARGEST, check_times, check_values
from testbed.core.recordings.recording import Recording

SAMPLES = 20_000
"""How many are looked at, about: enough to see ranges and limits, few enough to cost nothing."""

ORDER = 8
"""Of the differences of positions: of a motion at a tenth of the sampling rate they leave 2 %."""

HELD = 0.1
"""Part of the samples at which poses are recorded again, from which the encoders are slower."""

COUNTING = 0.05
"""Part of the square of a row's weights on samples that count, from which the row does."""

STRETCH = 256
"""Samples whose noise is averaged; of such means, the middle one counts: spikes are no noise."""


class Repeats(NamedTuple):
    """How often a sample is the same as the one before, while the encoders' are not.

    Attributes:
        steps: Pairs of samples whose encoders differ.
        channels: Of these, those in which a channel is the same, (C,).
        together: Those in which all channels are.
        held: Samples after such a one whose encoders are as they were: poses that were recorded
            again.
        pairs: Of samples.
    """

    steps: int
    channels: Array
    together: int
    held: int
    pairs: int


@dataclass(frozen=True, eq=False)
class Survey:
    """Samples of the raw signals.

    Attributes:
        position: Encoders, (m, n) [rad or m].
        measured: Motor torques, (m, n) [N m or N], or the plate's wrench without its tare,
            (m, 6) [N, N m].
        repeats: How often samples are like the ones before, among all samples.
        encoder_noise: Standard deviations, as if it were white, (n,) [rad or m]; zero where poses
            are recorded again.
        encoder_count: Least count of encoders that show whole counts and no noise between; zero
            for others, (n,) [rad or m].
    """

    position: Array
    measured: Array
    repeats: Repeats
    encoder_noise: Array
    encoder_count: Array


class Surveyor:
    """Gathers a survey from windows, in whatever order they come."""

    def __init__(self, samples: int) -> None:
        """Nothing yet, of a recording of that many samples."""
        self.stride = max(1, samples // SAMPLES)
        self._looks: dict[int, tuple[Array, Array, Repeats]] = {}
        self._closely: dict[int, tuple[Array, Array]] = {}

    def look(
        self, signals: Signals, first: int, count: int, closely: bool = True
    ) -> None:
        """Keep some of a window's samples.

        Args:
            signals: The window's.
            first: Number of its first sample.
            count: How many samples are its own: the next window has the others, too.
            closely: Whether its encoders' noise and counts are wanted: some windows show them.
        """
        own = slice(-first % self.stride, count, self.stride)
        position, measured = signals.position, signals.measured
        repeats = _repeats(position[: count + 1], measured[: count + 1])
        self._looks[first] = position[own].copy(), measured[own].copy(), repeats
        if closely:
            noise = _each(noise_square, position[: count + ORDER])
            self._closely[first] = noise, _each(_least_count, position[: count + 1])

    def survey(self) -> Survey:
        """All that was kept, in the order of time."""
        looks = zip(*(self._looks[first] for first in sorted(self._looks)), strict=True)
        positions, measured, each = looks
        repeats = Repeats(*(sum(counts) for counts in zip(*each, strict=True)))
        rough, least = zip(
            *(self._closely[k] for k in sorted(self._closely)), strict=True
        )
        # poses that were recorded again say nothing of it
        noise = (repeats.held < HELD * repeats.pairs) * np.sqrt(
            np.median(rough, axis=0)
        )
        counts = _without_noise(np.stack(least), noise)
        return Survey(
            np.concatenate(positions), np.concatenate(measured), repeats, noise, counts
        )


def _repeats(position: Array, measured: Array) -> Repeats:
    # a product of booleans is true where any is: ten times faster than `any` along short rows
    any_joint, any_channel = (
        np.ones(each.shape[1], np.bool_) for each in (position, measured)
    )
    moved = (position[1:] != position[:-1]) @ any_joint
    held = int(np.sum(moved[:-1] & ~moved[1:]))
    same = measured[1:] == measured[:-1]
    same = same[moved & (same @ any_channel)]
    channels = same.sum(axis=0).astype(np.float64)
    together = len(same) - int(np.sum(~same @ any_channel))
    return Repeats(int(np.sum(moved)), channels, together, held, len(moved))


def _each(number: Callable[[Array], float], position: Array) -> Array:
    """A number of every encoder, (n,): column by column, which fits into a cache."""
    return np.array([number(column) for column in np.ascontiguousarray(position.T)])


def noise_square(position: Array) -> float:
    """Mean square of white noise in consecutive positions; zero where they are too few.

    Args:
        position: Of one encoder, (m,) [rad or m].
    """
    rough = np.diff(position, ORDER)
    if not len(rough):
        return 0.0
    starts = np.arange(0, max(len(rough) - STRETCH, 0) + 1, STRETCH)
    ends = np.append(starts[1:], len(rough))
    sums = np.add.reduceat(rough**2, starts) / (ends - starts)
    return float(np.median(sums)) / comb(2 * ORDER, ORDER)


def _least_count(position: Array) -> float:
    """Of consecutive positions; zero where there is none, nan where few differ a little."""
    changes = np.abs(np.diff(position))
    least = changes.min(initial=np.inf, where=changes > 0)
    few = changes[changes < 4.5 * least]
    few = few[few > 0]
    # small changes of a position by which its least count is known
    if len(few) < 16:
        return float("nan")
    count = float(few[few < 1.5 * least].mean())
    # part of a count by which differences may be no whole counts: what rounding makes of them
    whole = np.abs(few / count - np.round(few / count)) < 0.1
    # part of the smallest differences that are whole counts, if a position is in counts
    return count if whole.mean() >= 0.95 else 0.0


def _without_noise(counts: Array, noise: Array) -> Array:
    """Least counts of all windows, (windows, n), where noise, (n,), does not blur them."""
    least = np.nanmedian(np.where(np.isnan(counts).all(axis=0), 0.0, counts), axis=0)
    # counts of noise that blur the counts: of rounding alone there are 0.29 at most
    return np.where(noise < 0.4 * least, least, 0.0)


Columns = Callable[[Signals, int], Array]
"""Columns of a window's rows, (C, rows, s), of its signals and the number of its first row."""

Answer = TypeVar("Answer")

SMALL = 0.05
"""Seconds that NumPy may take for rows; longer jobs are worth loading the compiled kernel, 0.4 s:
few commands make rows once. Both methods do, filters that are tried, coarse encoders."""


def is_compiled(plan: Plan) -> bool:
    """Whether the compiled kernel makes a plan's rows: by size where NumPy takes longer."""
    # seconds that NumPy takes for a sample, and more for each number of `Layout.theta`; measured
    seconds = plan.source.samples * (4e-6 + 6e-9 * plan.layout.theta.size)
    wanted = plan.engine == "compiled" or (
        plan.engine == "by size" and seconds >= SMALL
    )
    return wanted and plan.layout.compiles


def _engine(plan: Plan) -> Any:
    """Module that makes a plan's rows."""
    if not is_compiled(plan):
        return numpy_engine
    from testbed.core.kernel import numba_engine  # loads Numba

    return numba_engine


def motion_rows(plan: Plan, q: Array, qd: Array, qdd: Array) -> Array:
    """Rows of a motion by what makes a plan's, unfiltered, zero where measurements are, (slots, M).

    Args:
        plan: The rows.
        q: Positions, (M, n) [rad or m].
        qd: Velocities, (M, n).
        qdd: Accelerations, (M, n).
    """
    signals, engine = sensed(q, qd, qdd, plan.layout.width), _engine(plan)
    made = engine.rows(plan.layout, signals, engine.workspace(plan.layout, signals))
    return np.concatenate([block.rows for block in made], axis=1)


def of_unit_noise(
    layout: Layout, signals: Signals, blocks: Sequence[Block]
) -> list[Block]:
    """Rows whose samples are left out in part, their white noise as large as that of others.

    Args:
        layout: The rows.
        signals: The window.
        blocks: Its rows.
    """
    squares = signals.weights**2 / np.sum(signals.weights**2)
    at = signals.start + signals.step * np.arange(signals.number)
    share = np.stack(
        [np.convolve(each, squares, "same")[at] for each in signals.counts.T]
    )
    scale = np.where(share < COUNTING, 0.0, np.maximum(share, COUNTING) ** -0.5)
    factor = np.repeat(scale, layout.rows.width, axis=0)
    scaled = []
    for block in blocks:
        rows = block.rows * factor[:, block.first :][:, : block.rows.shape[1]]
        channels = np.split(rows, layout.rows.start[1:])
        used = [np.count_nonzero(each.any(axis=0)) for each in channels]
        scaled.append(Block(block.first, rows, np.array(used, np.float64)))
    return scaled


class Passes:
    """Answers questions about all rows of a plan, pass by pass."""

    def __init__(
        self, plan: Plan, threads: int | None, progress: Progress, number: int
    ) -> None:
        """Ready for the first pass.

        Args:
            plan: The rows.
            threads: How many to use; default one a processor.
            progress: Called with samples done and samples in all passes.
            number: How many passes there will be.
        """
        self.number = number
        self.plan = plan
        self.compiled, self._engine = is_compiled(plan), _engine(plan)
        self.threads = max(1, threads or os.cpu_count() or 1) if self.compiled else 1
        self.progress = progress
        self.done = 0
        self.surveyor, self._close_windows = (
            Surveyor(plan.source.samples),
            plan.close_windows,
        )
        self._workspaces: SimpleQueue[Any] = SimpleQueue()
        self._kept: dict[int, list[Block]] = {}
        # else made again as fast as read
        thinned = not self.compiled or len(plan.weights) > 1
        # bytes of rows that are kept from the first pass to the next: the first ones
        self._rows_kept = 100e6 // (plan.layout.rows.slots * 8) if thinned else 0

    def sums(self) -> Iterator[Sums]:
        """Products of all windows, in order; what was read is checked."""
        return self._pass(self._sums)

    def rows(self, combined: Array) -> Iterator[tuple[Array, Array]]:
        """All rows, a block at a time: combined columns, (C, k, q), and measurements, (C, k).

        Args:
            combined: How the unknowns' columns are combined, (p, q).
        """
        return ((columns, measured) for columns, measured in self.rows_beside(combined))

    def rows_beside(
        self, combined: Array, *beside: Columns | None, gaps: bool = True
    ) -> Iterator[tuple[Array, ...]]:
        """The same with further columns between the two, (C, k, s) by each that makes some.

        Args:
            combined: How the unknowns' columns are combined, (p, q).
            beside: Make the further columns of a window, (C, rows, s); None makes none.
            gaps: Whether rows that gaps leave out are zero; else they are skipped.
        """
        layout, done = self.plan.layout, 0
        basis = layout.basis @ combined
        answers = self._pass(partial(self._rows, beside))
        for window, (blocks, further) in zip(self.plan.windows(), answers, strict=True):
            # what a gap leaves out counts for nothing, but takes its time
            if gaps and window.row > done:
                widths = basis.shape[1], *(each.shape[2] for each in further)
                gap = layout.width, window.row - done
                yield *(np.zeros((*gap, width)) for width in widths), np.zeros(gap)
            done, first = window.row + window.rows, 0
            for block in blocks:
                last = first + block.shape[1]
                parts = (each[:, first:last] for each in further)
                yield layout.combined(block, basis), *parts, block[layout.rows.measured]
                first = last

    def _pass(self, ask: Callable[[Recording, Window], Answer]) -> Iterator[Answer]:
        with ThreadPoolExecutor(self.threads) as pool:
            pending: deque[tuple[Window, Future[Answer]]] = deque()
            try:
                for window in self.plan.windows():
                    part = self.plan.source.part(window.first, window.last)
                    answer: Future[Answer] = Future()
                    if self.threads > 1:
                        answer = pool.submit(ask, part, window)
                    else:
                        answer.set_result(ask(part, window))
                    pending.append((window, answer))
                    if len(pending) > self.threads or self.threads == 1:
                        yield self._next(pending)
                while pending:
                    yield self._next(pending)
            finally:
                pool.shutdown(cancel_futures=True)

    def _next(self, pending: deque[tuple[Window, Future[Answer]]]) -> Answer:
        window, answer = pending.popleft()
        result = answer.result()
        self.done += window.rows * self.plan.step
        self.progress(self.done, self.number * self.plan.rows * self.plan.step)
        return result

    def _sums(self, part: Recording, window: Window) -> Sums:
        check_times(part.time, "the recording", 1 / self.plan.source.rate, window.first)
        signals = self.plan.signals(part, window)
        sums = self._products(signals, window)
        closely = window.row in self._close_windows
        self.surveyor.look(signals, window.first, self.plan.own(window), closely)
        if not sums.squares[0] < LARGEST**2:  # what is no number is not
            check_values(part.columns(), "the recording", window.first)
        return sums

    def _products(self, signals: Signals, window: Window) -> Sums:
        layout = self.plan.layout
        if self._keeps(window) or not self.compiled or len(signals.counts):
            return numpy_engine.sweep(layout, signals, self._blocks(signals, window))
        with self._workspace(signals) as work:
            sums: Sums = self._engine.sweep(layout, signals, work)
        return sums

    def _rows(
        self, beside: Sequence[Columns | None], part: Recording, window: Window
    ) -> tuple[list[Array], list[Array]]:
        signals = self.plan.signals(part, window)
        none = np.zeros((self.plan.layout.width, window.rows, 0))
        further = [
            none if make is None else make(signals, window.row) for make in beside
        ]
        return [block.rows for block in self._blocks(signals, window)], further

    def _blocks(self, signals: Signals, window: Window) -> list[Block]:
        if window.row in self._kept:
            return self._kept[window.row]
        with self._workspace(signals) as work:
            made: list[Block] = self._engine.rows(self.plan.layout, signals, work)
        if len(signals.counts):
            made = of_unit_noise(self.plan.layout, signals, made)
        if self._keeps(window):
            self._kept[window.row] = made
        return made

    def _keeps(self, window: Window) -> bool:
        return window.row + window.rows <= self._rows_kept

    @contextmanager
    def _workspace(self, signals: Signals) -> Iterator[Any]:
        """A workspace that no other thread is using."""
        try:
            work = self._workspaces.get_nowait()
        except Empty:
            work = self._engine.workspace(self.plan.layout, signals)
        try:
            yield work
        finally:
            self._workspaces.put(work)
