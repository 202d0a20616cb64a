"""From a source of samples to windows of rows: what is measured, filters, ends, rows kept.

What is done to the measurement is done to every column of the regressor: the equations
stay exact, only the noise changes. A filter on positions alone would bias the estimate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.estimation.settings import Settings
from testbed.core.kernel.layout import Layout
from testbed.core.kernel.records import NO_LOAD, NONE, Signals
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.friction import BY_LOAD, ROOM

POSITION_ATTENUATION = 120.0
"""Of the filter on positions [dB]: what it takes from the motion would bias the estimate."""

ROW_ATTENUATION = 60.0
"""Of the filter on rows [dB]: both sides of the equations pass it, so it need not be flat."""

TRANSITION = 1.5
"""Width of the band between passing and stopping, in cutoffs; the cutoff is in its middle."""

REVERSAL_WEIGHT = 0.03
"""Part of the row filter's absolute weight that may lie on samples at a reversal."""

_DIFFERENCES = (4 / 5, -1 / 5, 4 / 105, -1 / 280), (8 / 5, -1 / 5, 8 / 315, -1 / 560)
"""First and second central differences of order eight, from the middle outwards."""

LONGEST_REACH = 1_000_000
"""Samples of a filter to either side."""

STENCIL = len(_DIFFERENCES[0])
"""Samples that a derivative reaches to either side."""


def low_pass_reach(rate: float, cutoff: float | None, attenuation: float) -> float:
    """Samples L to either side that a low-pass needs; infinity where there is no such number.

    Args:
        rate: Samples a second [Hz].
        cutoff: Where its gain is one half [Hz]; None for no filter.
        attenuation: As of `low_pass` [dB].
    """
    if cutoff is None:
        return 0.0
    width = 2 * np.pi * TRANSITION * cutoff / rate  # Kaiser's rules
    return (
        np.inf
        if width == 0
        else float(np.ceil((attenuation - 7.95) / (2.285 * width) / 2))
    )


def low_pass(rate: float, cutoff: float, attenuation: float) -> Array:
    """Weights of a symmetric low-pass, (2 L + 1,), of sum one; a windowed sinc.

    Args:
        rate: Samples a second [Hz].
        cutoff: Where its gain is one half [Hz].
        attenuation: Beyond cutoff (1 + TRANSITION / 2), and how flat it is below
            cutoff (1 - TRANSITION / 2) [dB].

    Raises:
        SettingsError: The cutoff is so low that no recording is as long as the filter.
    """
    needed = low_pass_reach(rate, cutoff, attenuation)
    if needed > LONGEST_REACH:
        raise SettingsError(
            f"a cutoff of {cutoff:g} Hz takes {needed:.0e} samples at {rate:g} Hz to either side, "
            f"more than {LONGEST_REACH:.0e}: raise it, or switch it off"
        )
    reach = int(needed)
    window = np.kaiser(2 * reach + 1, 0.1102 * (attenuation - 8.7))
    weights = window * np.sinc(2 * cutoff / rate * np.arange(-reach, reach + 1))
    return np.asarray(weights / weights.sum())


def motion_taps(rate: float, cutoff: float | None) -> Array:
    """Kernels that make position, velocity and acceleration of encoder positions.

    Args:
        rate: Samples a second [Hz].
        cutoff: Of the low-pass on positions [Hz]; None for none.

    Returns:
        (3, 2 L + 1), in the order of time: x[k] = sum over l of taps[l] q[k - L + l].
    """
    first, second = np.array(_DIFFERENCES) * [[rate], [rate**2]]
    position = np.zeros(2 * STENCIL + 1)
    position[STENCIL] = 1.0
    stencils = (
        position,
        np.concatenate([-first[::-1], [0.0], first]),
        np.concatenate([second[::-1], [-2 * second.sum()], second]),
    )
    weights = (
        np.ones(1) if cutoff is None else low_pass(rate, cutoff, POSITION_ATTENUATION)
    )
    return np.stack([np.convolve(weights, stencil) for stencil in stencils])


def slope_weights(weights: Array, places: NDArray[np.int64], rate: float) -> Array:
    """Weights that make a filtered signal's derivative of the signal at some samples, (k,) [1/s].

    By parts: the signal's derivative times the filter is the signal times the filter's, and a
    part at either end, where the filter stops.

    Args:
        weights: Of the filter, symmetric, (2 L + 1,).
        places: The samples, evenly spaced around the filter's middle, (k,).
        rate: Samples a second [Hz].
    """
    if len(places) == 1:
        return np.zeros(1)
    at = places + len(weights) // 2
    derivative = -float(places[1] - places[0]) * _slopes(weights)[at]
    derivative[[0, -1]] /= 2
    derivative[[0, -1]] += np.array([-1.0, 1.0]) * weights[at[-1]]
    return derivative * rate / (derivative @ places)


def _slopes(values: Array) -> Array:
    """Derivatives at evenly spaced values, (k,), of the polynomial through the nearest ones."""
    size = min(2 * STENCIL + 1, len(values))
    powers, nodes = np.arange(size), np.arange(size) - size // 2
    slope = powers * nodes[:, None] ** np.maximum(powers - 1.0, 0.0)
    # at each of the nodes
    differences = slope @ np.linalg.inv(np.vander(nodes, increasing=True))
    at = np.arange(len(values))
    first = np.clip(at - size // 2, 0, len(values) - size)
    near = np.lib.stride_tricks.sliding_window_view(values, size)[first]
    return np.asarray((differences[at - first] * near).sum(axis=1))


def row_weights(rate: float, cutoff: float | None) -> Array:
    """Weights of the parallel filter on rows, (2 L + 1,); a single one for none.

    Args:
        rate: Samples a second [Hz].
        cutoff: Where its gain is one half [Hz]; None for none.
    """
    return np.ones(1) if cutoff is None else low_pass(rate, cutoff, ROW_ATTENUATION)


def drive_filter(settings: Settings, rate: float) -> tuple[Array, int]:
    """Of rows of drives: Hann's window, as long as a period of the cutoff, half `row_weights`.

    More of an encoder's noise passes, since its gain falls with the third power of the frequency
    only, and less of a reversal: dry friction's jump spoils fewer rows, and none that are kept.

    Args:
        settings: With the filter on rows.
        rate: Samples a second [Hz].

    Returns:
        Weights, (2 L + 1,), and samples to either side of a row at which its joint has to move.
    """
    cutoff, reach = settings.row_low_pass, settings.reversal_reach
    weights = np.ones(1)
    if cutoff is not None:
        weights = np.hanning(2 * round(rate / cutoff / 2) + 1)[1:-1]
    half = len(weights) // 2
    nearby = half if reach is None else reversal_samples(weights, reach, rate)
    return weights / weights.sum(), nearby


def reversal_samples(weights: Array, reach: float | None, rate: float) -> int:
    """Samples to either side of a row at which its joint has to move.

    Dry friction jumps at a reversal, and the filter on rows carries the jump to all rows that
    it reaches.

    Args:
        weights: Of the filter on rows, (2 L + 1,).
        reach: As a time [s], at most the filter's own; None for what leaves REVERSAL_WEIGHT of
            the filter's absolute weight beyond.
        rate: Samples a second [Hz].
    """
    half = len(weights) // 2
    if reach is not None:
        return min(half, round(reach * rate))
    size = np.abs(weights)
    beyond = 2 * np.cumsum(size)[:half] / size.sum()  # of reaches half - 1, ..., 0
    return half - int(np.count_nonzero(beyond < REVERSAL_WEIGHT))


ROWS_PER_CUTOFF, DENSE = 2.0, 4.0
"""Rows kept a second per Hz of the parallel filter's cutoff: for an autoregression as many as
the filter leaves independent, or their spectrum would have an empty part; and twice as many."""

WINDOW = 32_768
"""Samples of a window, about."""

CLOSE_WINDOWS = 16
"""Windows, evenly spread, whose encoders are looked at closely: nine minutes at 1 kHz."""


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
        load: Values of the body columns, (P',), for laws of the load; None without such.
        left_out: Samples of each channel that do not count, from the first to before the second,
            (k, 2) each; () where all count.
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
    load: Array | None = None
    left_out: tuple[NDArray[np.int64], ...] = ()

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
        ends = [last for _, last in self.source.segments]
        for begin, number in self.spans:
            for row in range(begin, begin + number, size):
                rows = min(size, begin + number - row)
                first = row * self.step
                last = first + (rows - 1) * self.step + 2 * self.reach + 1
                end = min(end for end in ends if end >= last)
                # one more, so that every step of time is within some window
                yield Window(row, rows, first, min(last + 1, end))

    @property
    def close_windows(self) -> frozenset[int]:
        """First rows of the windows whose encoders are looked at closely: all, if few."""
        rows = [window.row for window in self.windows()]
        if len(rows) > CLOSE_WINDOWS:
            rows = [
                rows[k]
                for k in np.linspace(0, len(rows) - 1, CLOSE_WINDOWS)
                .round()
                .astype(int)
            ]
        return frozenset(rows)

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
        velocity = acceleration = np.empty((0, len(part.names)))
        if (
            part.senses_kinematics
            and part.velocity is not None
            and part.acceleration is not None
        ):
            velocity, acceleration = part.velocity, part.acceleration
        varying = {term.law.by for term in self.layout.terms} - {"", *BY_LOAD}
        measured = (
            part.measured("torque") if dynamic else part.measured("wrench") - self.tare
        )
        arrays = part.position, velocity, acceleration, measured
        q, qd, qdd, y = map(np.ascontiguousarray, arrays)
        return Signals(
            position=q,
            velocity=qd,
            acceleration=qdd,
            measured=y,
            taps=self.taps,
            weights=self.weights,
            deadband=self.deadband,
            rest_reach=self.rest_reach,
            start=self.reach,
            step=self.step,
            number=window.rows,
            varying=self._varying(part, window) if varying else NONE,
            load=NO_LOAD if self.load is None else self.load,
            counts=self._counts(window.first, part.samples),
        )

    def _counts(self, first: int, number: int) -> Array:
        """Ones for samples that count and zeros for others, (number, C); empty if all do."""
        edges = np.zeros((number + 1, len(self.left_out)))
        for channel, spans in zip(edges.T, self.left_out, strict=True):
            begin, end = np.clip(spans.T - first, 0, number)
            np.add.at(channel, begin, 1)
            np.add.at(channel, end, -1)
        missing = np.cumsum(edges[:-1], axis=0) > 0
        return np.where(missing, 0.0, 1.0) if missing.any() else NONE

    def _varying(self, part: Recording, window: Window) -> Array:
        """Time since the middle of the source [s], and the drives' temperatures over 25 degC."""
        time = (
            window.first + np.arange(part.samples) - self.source.samples / 2
        ) / self.source.rate
        warmth = (
            np.zeros_like(part.position)
            if part.temperature is None
            else part.temperature - ROOM
        )
        return np.column_stack([time, warmth])


def make_plan(
    source: Source,
    layout: Layout,
    tare: Array,
    settings: Settings,
    per_cutoff: float = ROWS_PER_CUTOFF,
) -> Plan:
    """How a source becomes rows.

    Args:
        source: The samples.
        layout: The robot's rows.
        tare: What is taken off the plate's wrench, (6,) [N, N m].
        settings: How to treat the signals; filters fit the sampling rate (`Settings.fitted`).
        per_cutoff: Rows a second per Hz of the filter on rows.

    Raises:
        RecordingError: The recording is too short, or sampled too slowly.
    """
    rate, sensed = source.rate, source.senses_kinematics
    slow, position = (
        settings.row_low_pass,
        None if sensed else settings.position_low_pass,
    )
    fast = [
        cutoff
        for cutoff in (slow, position)
        if cutoff is not None and cutoff >= rate / 2
    ]
    if fast:
        raise RecordingError(
            f"the recording has {rate:g} samples a second, too few for a filter at {fast[0]:g} Hz"
        )
    reach = low_pass_reach(rate, slow, ROW_ATTENUATION) + (0 if sensed else STENCIL)
    reach += low_pass_reach(rate, position, POSITION_ATTENUATION)
    step = 1
    if slow is not None:
        step = max(1, int(min((1 + 1e-9) * rate / (per_cutoff * slow), source.samples)))
    spans = tuple(_rows_in(segment, reach, step) for segment in source.segments)
    for k, (_, rows) in enumerate(spans):
        if rows < 2:  # before weights are made: they could be endless
            raise _too_short(source, k, reach)
    weights = row_weights(rate, slow)
    return Plan(
        source=source,
        layout=layout,
        tare=tare,
        taps=np.array([[1.0], [0.0], [0.0]]) if sensed else motion_taps(rate, position),
        weights=weights,
        deadband=settings.deadband if layout.model == "dynamic" else 0.0,
        rest_reach=reversal_samples(weights, settings.reversal_reach, rate),
        step=step,
        spans=spans,
        engine=settings.engine,
    )


def _rows_in(segment: tuple[int, int], reach: float, step: int) -> tuple[int, int]:
    """The first row whose samples are all of one segment, and how many there are."""
    first, last = -(-segment[0] // step), segment[1]
    return first, len(range(first * step + int(min(2 * reach, last)), last, step))


def _too_short(source: Source, number: int, reach: float) -> RecordingError:
    """What to say of the segment of a number."""
    segments = source.segments
    first, last = segments[number]
    which = "the recording" if len(segments) == 1 else f"recording {number + 1}"
    return RecordingError(
        f"{which} lasts {(last - first) / source.rate:.3g} s, too short: the filters take "
        f"{reach / source.rate:.3g} s at each end; record longer or raise the cutoff frequencies"
    )
