"""From a source of samples to windows of rows: what is measured, filters, ends, rows kept.

What is done to the measurement is done to every column of the regressor: the equations
stay exact, only the noise changes. A filter on positions alone would bias the estimate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.identification.regression.filters import (
    POSITION_ATTENUATION,
    ROW_ATTENUATION,
    low_pass_reach,
    motion_taps,
    reversal_samples,
    row_weights,
)
from testbed.identification.settings import Settings
from testbed.kernel.layout import Layout
from testbed.kernel.records import Signals
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source, segments_of

ROWS_PER_CUTOFF = {"white": 4.0, "ar": 2.0}
"""Rows kept a second per Hz of the parallel filter's cutoff: for an autoregression as many as
the filter leaves independent, or their spectrum would have an empty part."""

WINDOW = 32_768
"""Samples of a window, about."""

LOOKED_AT = 16
"""Windows, evenly spread, in which traces of faults are looked for: nine minutes at 1 kHz."""


@dataclass(frozen=True)
class Window:
    """Consecutive rows, and the samples they need.

    Attributes:
        row: Number of the first row.
        rows: How many.
        first: First sample.
        last: Sample after the last.
    """

    row: int
    rows: int
    first: int
    last: int


@dataclass(frozen=True, eq=False)
class Plan:
    """How a source becomes rows.

    Attributes:
        source: The samples.
        layout: The robot's rows.
        tare: What is taken off the plate's wrench, (6,) [N, N m].
        taps: Kernels that make the motion, (3, 2 L + 1).
        weights: Of the parallel filter, (2 L + 1,).
        deadband: Joints at lower speeds rest [rad/s or m/s].
        rest_reach: Rows of a joint that rests within so many samples do not count.
        step: Samples from row to row.
        spans: Rows that no gap of the source touches: the first of each run, and how many.
        engine: What makes the rows, as `Settings.engine` says it.
    """

    source: Source
    layout: Layout
    tare: Array
    taps: Array
    weights: Array
    deadband: float
    rest_reach: int
    step: int
    spans: tuple[tuple[int, int], ...]
    engine: str

    @property
    def rows(self) -> int:
        """Number of rows, those that gaps leave out counted: they are zero."""
        first, number = self.spans[-1]
        return first + number

    @property
    def reach(self) -> int:
        """Samples that a row needs to either side."""
        return int(self.taps.shape[1]) // 2 + len(self.weights) // 2

    @property
    def rate(self) -> float:
        """Rows a second [Hz]."""
        return self.source.rate / self.step

    def windows(self) -> Iterator[Window]:
        """All rows in order, in windows of whole blocks: the same whatever the source."""
        block = self.layout.rows.block
        size = max(1, WINDOW // (block * self.step)) * block
        ends = [last for _, last in segments_of(self.source)]
        for begin, number in self.spans:
            for row in range(begin, begin + number, size):
                rows = min(size, begin + number - row)
                first = row * self.step
                last = first + (rows - 1) * self.step + 2 * self.reach + 1
                end = min(end for end in ends if end >= last)
                # one more, so that every step of time is within some window
                yield Window(row, rows, first, min(last + 1, end))

    @property
    def looked_at(self) -> frozenset[int]:
        """First rows of the windows in which traces of faults are looked for: all, if few."""
        rows = [window.row for window in self.windows()]
        if len(rows) > LOOKED_AT:
            rows = [rows[k] for k in np.linspace(0, len(rows) - 1, LOOKED_AT).round().astype(int)]
        return frozenset(rows)

    @property
    def looked_at_all(self) -> bool:
        """Whether they are looked for in all windows."""
        return len(self.looked_at) == sum(1 for _ in self.windows())

    def own(self, window: Window) -> int:
        """How many of a window's samples come before the next window's first."""
        last = any(window.row + window.rows == sum(span) for span in self.spans)
        return window.last - window.first if last else window.rows * self.step

    def signals(self, part: Recording, window: Window) -> Signals:
        """What the kernel needs of a window's samples.

        Samples lie row by row however the source keeps them: BLAS adds in another order where
        columns lie together, and bits would depend on it.
        """
        if part.names != self.layout.tree.names:
            part = part.ordered(self.layout.tree)
        dynamic = self.layout.model == "dynamic"
        nothing = np.empty((0, len(part.names)))
        sensed = part.senses_kinematics
        velocity = part.velocity if sensed and part.velocity is not None else nothing
        acceleration = part.acceleration if sensed and part.acceleration is not None else nothing
        measured = part.measured("torque") if dynamic else part.measured("wrench") - self.tare
        return Signals(
            position=np.ascontiguousarray(part.position),
            velocity=np.ascontiguousarray(velocity),
            acceleration=np.ascontiguousarray(acceleration),
            measured=np.ascontiguousarray(measured),
            taps=self.taps,
            weights=self.weights,
            deadband=self.deadband,
            rest_reach=self.rest_reach,
            start=self.reach,
            step=self.step,
            number=window.rows,
        )


def make_plan(source: Source, layout: Layout, tare: Array, settings: Settings) -> Plan:
    """How a source becomes rows.

    Args:
        source: The samples.
        layout: The robot's rows.
        tare: What is taken off the plate's wrench, (6,) [N, N m].
        settings: How to treat the signals; filters fit the sampling rate (`Settings.fitted`).

    Raises:
        RecordingError: The recording is too short, or sampled too slowly.
    """
    rate, sensed = source.rate, source.senses_kinematics
    slow, position = settings.row_low_pass, None if sensed else settings.position_low_pass
    fast = [cutoff for cutoff in (slow, position) if cutoff is not None and cutoff >= rate / 2]
    if fast:
        raise RecordingError(
            f"the recording has {rate:g} samples a second, too few for a filter at {fast[0]:g} Hz"
        )
    far = low_pass_reach(rate, slow, ROW_ATTENUATION)
    far += low_pass_reach(rate, position, POSITION_ATTENUATION)
    segments = segments_of(source)
    lengths = [last - first for first, last in segments]
    if 2 * far >= max(lengths):  # before weights are made: they could be endless
        raise _too_short(source, int(np.argmax(lengths)), far)
    unit = np.array([[1.0], [0.0], [0.0]])
    taps = unit if sensed else motion_taps(rate, position)
    weights = row_weights(rate, slow)
    reach = taps.shape[1] // 2 + len(weights) // 2
    step = (
        1
        if slow is None
        else int((1 + 1e-9) * rate / (ROWS_PER_CUTOFF[settings.noise] * slow)) or 1
    )
    spans = tuple(_rows_in(segment, reach, step) for segment in segments)
    short = [k for k, (_, rows) in enumerate(spans) if rows < 2]
    if short:
        raise _too_short(source, short[0], reach)
    deadband = settings.deadband if layout.model == "dynamic" else 0.0
    nearby = reversal_samples(weights, settings.reversal_reach, rate)
    engine = settings.engine
    return Plan(source, layout, tare, taps, weights, deadband, nearby, step, spans, engine)


def _rows_in(segment: tuple[int, int], reach: int, step: int) -> tuple[int, int]:
    """The first row whose samples are all of one segment, and how many there are."""
    first = -(-segment[0] // step)
    return first, len(range(first * step + 2 * reach, segment[1], step))


def _too_short(source: Source, number: int, reach: float) -> RecordingError:
    """What to say of the segment of a number."""
    segments = segments_of(source)
    first, last = segments[number]
    which = "the recording" if len(segments) == 1 else f"recording {number + 1}"
    return RecordingError(
        f"{which} lasts {(last - first) / source.rate:.3g} s, too short: the filters take "
        f"{reach / source.rate:.3g} s at each end; record longer or raise the cutoff frequencies"
    )
