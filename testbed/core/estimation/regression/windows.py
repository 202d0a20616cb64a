"""Plan of the regression: filters, windows of samples and rows of a recording.

The filter on rows is applied to the measurement and to every column of the regressor, so that the
equations stay exact and only the noise changes. A filter on positions alone would bias the
estimate.
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
from testbed.core.kernel.records import EMPTY_MATRIX, EMPTY_VECTOR, SignalWindow
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.friction import LOAD_MULTIPLIERS, ROOM_TEMPERATURE

POSITION_ATTENUATION = 120.0
"""Stop-band attenuation and pass-band flatness of the low-pass on positions [dB]: what it removes
from the motion would bias the estimate."""

ROW_ATTENUATION = 60.0
"""Stop-band attenuation of the low-pass on rows [dB]; both sides of the equations are filtered, so
that the pass band need not be flat."""

TRANSITION = 1.5
"""Width of the transition band relative to the cutoff, which is in its middle."""

MAX_REVERSAL_WEIGHT = 0.03
"""Largest fraction of the row filter's absolute weight on samples at a reversal."""

_DIFFERENCES = (4 / 5, -1 / 5, 4 / 105, -1 / 280), (8 / 5, -1 / 5, 8 / 315, -1 / 560)
"""Weights of the first and second central difference of order eight, from the centre outwards."""

MAX_REACH = 1_000_000
"""Largest reach of a filter to either side [samples]."""

STENCIL_REACH = len(_DIFFERENCES[0])
"""Reach of the differences to either side [samples]."""


def low_pass_reach(rate: float, cutoff: float | None, attenuation: float) -> float:
    """Half-length of a low-pass filter [samples]; infinite for a cutoff of zero.

    Args:
        rate: Sampling rate [Hz].
        cutoff: Frequency of half gain [Hz]; None for no filter.
        attenuation: Attenuation, as in `low_pass` [dB].
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
    """Weights of a symmetric low-pass, (2 L + 1,): a Kaiser-windowed sinc with unit sum.

    Args:
        rate: Sampling rate [Hz].
        cutoff: Frequency of half gain [Hz].
        attenuation: Attenuation above cutoff (1 + TRANSITION / 2), and flatness below cutoff (1 -
            TRANSITION / 2) [dB].

    Raises:
        SettingsError: The cutoff is so low that the filter would exceed MAX_REACH.
    """
    needed = low_pass_reach(rate, cutoff, attenuation)
    if needed > MAX_REACH:
        raise SettingsError(
            f"a cutoff of {cutoff:g} Hz takes {needed:.0e} samples at {rate:g} Hz to either side, "
            f"more than {MAX_REACH:.0e}: raise it, or switch it off"
        )
    reach = int(needed)
    window = np.kaiser(2 * reach + 1, 0.1102 * (attenuation - 8.7))
    weights = window * np.sinc(2 * cutoff / rate * np.arange(-reach, reach + 1))
    return np.asarray(weights / weights.sum())


def motion_taps(rate: float, cutoff: float | None) -> Array:
    """Convolution kernels for position, velocity and acceleration from encoder positions.

    The kernels combine central differences of order eight with the low-pass on positions.

    Args:
        rate: Sampling rate [Hz].
        cutoff: Cutoff of the low-pass on positions [Hz]; None for no filter.

    Returns:
        Kernels in chronological order, (3, 2 L + 1): x[k] = sum over l of taps[l] q[k - L + l].
    """
    first, second = np.array(_DIFFERENCES) * [[rate], [rate**2]]
    position = np.zeros(2 * STENCIL_REACH + 1)
    position[STENCIL_REACH] = 1.0
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
    """Weights of selected samples for the derivative of a low-passed signal, (k,) [1/s].

    By integration by parts, the filtered derivative is the signal times the derivative of the
    filter, plus a term at either end of the filter. The weights are scaled to be exact for a ramp;
    the weight of a single sample is zero.

    Args:
        weights: Weights of the symmetric filter, (2 L + 1,).
        places: Indices of the samples relative to the filter's middle, evenly spaced, (k,).
        rate: Sampling rate [Hz].
    """
    if len(places) == 1:
        return np.zeros(1)
    indices = places + len(weights) // 2
    derivative = (
        -float(places[1] - places[0]) * _polynomial_derivatives(weights)[indices]
    )
    derivative[[0, -1]] /= 2
    derivative[[0, -1]] += np.array([-1.0, 1.0]) * weights[indices[-1]]
    return derivative * rate / (derivative @ places)


def _polynomial_derivatives(values: Array) -> Array:
    """Derivatives of evenly spaced values, (k,), from polynomials through the nearest values."""
    size = min(2 * STENCIL_REACH + 1, len(values))
    powers, nodes = np.arange(size), np.arange(size) - size // 2
    power_derivatives = powers * nodes[:, None] ** np.maximum(powers - 1.0, 0.0)
    # derivative at each node, as a combination of the values
    differences = power_derivatives @ np.linalg.inv(np.vander(nodes, increasing=True))
    indices = np.arange(len(values))
    first = np.clip(indices - size // 2, 0, len(values) - size)
    neighbours = np.lib.stride_tricks.sliding_window_view(values, size)[first]
    return np.asarray((differences[indices - first] * neighbours).sum(axis=1))


def row_weights(rate: float, cutoff: float | None) -> Array:
    """Weights of the low-pass on rows, (2 L + 1,); a single one for no filter.

    Args:
        rate: Sampling rate [Hz].
        cutoff: Frequency of half gain [Hz]; None for no filter.
    """
    return np.ones(1) if cutoff is None else low_pass(rate, cutoff, ROW_ATTENUATION)


def joint_law_filter(settings: Settings, rate: float) -> tuple[Array, int]:
    """Weights of a short Hann filter on rows of joint laws, and margin around reversals.

    The window is as long as a period of the cutoff, half as long as `row_weights`. It passes more
    encoder noise, since its gain falls only with the third power of the frequency, but the jump of
    dry friction at a reversal affects fewer rows, all of which are excluded.

    Args:
        settings: Settings with the low-pass on rows.
        rate: Sampling rate [Hz].

    Returns:
        Weights, (2 L + 1,), and number of samples to either side of a row at which its joint has to
        move.
    """
    cutoff, reach = settings.row_low_pass, settings.reversal_reach
    weights = np.ones(1)
    if cutoff is not None:
        weights = np.hanning(2 * round(rate / cutoff / 2) + 1)[1:-1]
    half = len(weights) // 2
    rest_reach = half if reach is None else reversal_samples(weights, reach, rate)
    return weights / weights.sum(), rest_reach


def reversal_samples(weights: Array, reach: float | None, rate: float) -> int:
    """Number of samples before and after a row in which its joint has to move.

    Dry friction jumps at a reversal, and the filter on rows spreads the jump over its length.

    Args:
        weights: Weights of the filter on rows, (2 L + 1,).
        reach: Time before and after a row [s], at most half the filter's length; None for the time
            beyond which the filter has MAX_REVERSAL_WEIGHT of its absolute weight.
        rate: Sampling rate [Hz].
    """
    half = len(weights) // 2
    if reach is not None:
        return min(half, round(reach * rate))
    magnitudes = np.abs(weights)
    # for reaches of half - 1, ..., 0
    beyond = 2 * np.cumsum(magnitudes)[:half] / magnitudes.sum()
    return half - int(np.count_nonzero(beyond < MAX_REVERSAL_WEIGHT))


ROWS_PER_CUTOFF, DENSE_ROWS_PER_CUTOFF = 2.0, 4.0
"""Rows per second per Hz of the row filter's cutoff. The first number suits autoregressions: as
many rows as the filter leaves independent, so that their spectrum has no empty part. The second is
twice that."""

WINDOW_SAMPLES = 32_768
"""Approximate number of samples of a window."""

ANALYSED_WINDOWS = 16
"""Number of windows, evenly spread, whose encoder noise is analysed: nine minutes at 1 kHz."""


@dataclass(frozen=True)
class Window:
    """Consecutive rows, and the range of the samples that determine the rows.

    Attributes:
        row: Index of the first row.
        rows: Number of rows.
        first: Index of the first sample.
        last: Index after the last sample.
    """

    row: int
    rows: int
    first: int
    last: int


@dataclass(frozen=True, eq=False)
class Plan:
    """Plan of the regressor rows of a recording: kernels, filter, row spacing, excluded samples.

    Attributes:
        source: Source of the samples.
        layout: Layout of the robot's rows.
        tare: Static wrench subtracted from the measured wrench, (6,) [N, N m].
        motion_kernels: Convolution kernels for position, velocity and acceleration, (3, 2 L + 1).
        weights: Weights of the filter on rows, (2 L + 1,).
        deadband: Speed below which a joint rests [rad/s or m/s].
        reversal_reach: Number of samples before and after a rest of a joint within which its rows
            are excluded.
        step: Number of samples from row to row.
        spans: First row and number of rows of each run without a gap.
        engine: Implementation that computes the rows, as in `Settings.engine`.
        load: Coefficients of the body columns, (P',), for load-dependent joint laws; None without
            such laws.
        excluded_samples: Half-open index ranges of the excluded samples of each channel, (k, 2)
            each; () if none.
    """

    source: Source
    layout: Layout
    tare: Array
    motion_kernels: Array
    weights: Array
    deadband: float
    reversal_reach: int
    step: int
    spans: tuple[tuple[int, int], ...]
    engine: str
    load: Array | None = None
    excluded_samples: tuple[NDArray[np.int64], ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows, including the zero rows in gaps."""
        first, number = self.spans[-1]
        return first + number

    @property
    def reach(self) -> int:
        """Number of samples on either side that are used to compute a row."""
        return int(self.motion_kernels.shape[1]) // 2 + len(self.weights) // 2

    @property
    def rate(self) -> float:
        """Rate of the rows [Hz]."""
        return self.source.rate / self.step

    def windows(self) -> Iterator[Window]:
        """Yield the windows of all rows in order, of about WINDOW_SAMPLES samples each.

        Windows contain whole blocks of rows, except before gaps, and are the same for any kind of
        source.
        """
        block = self.layout.rows.block
        size = max(1, WINDOW_SAMPLES // (block * self.step)) * block
        ends = [last for _, last in self.source.segments]
        for first_row, row_count in self.spans:
            for row in range(first_row, first_row + row_count, size):
                rows = min(size, first_row + row_count - row)
                first = row * self.step
                last = first + (rows - 1) * self.step + 2 * self.reach + 1
                end = min(end for end in ends if end >= last)
                # one more sample, so that some window contains each step of time
                yield Window(row, rows, first, min(last + 1, end))

    @property
    def analysed_windows(self) -> frozenset[int]:
        """First rows of the windows, at most ANALYSED_WINDOWS, whose encoder noise is analysed."""
        rows = [window.row for window in self.windows()]
        if len(rows) > ANALYSED_WINDOWS:
            rows = [
                rows[k]
                for k in np.linspace(0, len(rows) - 1, ANALYSED_WINDOWS)
                .round()
                .astype(int)
            ]
        return frozenset(rows)

    def own_sample_count(self, window: Window) -> int:
        """Number of a window's samples before the first sample of the next window."""
        last = any(window.row + window.rows == sum(span) for span in self.spans)
        return window.last - window.first if last else window.rows * self.step

    def signals(self, part: Recording, window: Window) -> SignalWindow:
        """Kernel input for a window: motion, measurement, filters and excluded samples.

        Arrays are made contiguous by sample, since the summation order of BLAS, and thus the last
        bits of the result, depend on the memory layout.

        Args:
            part: Samples of the window.
            window: Window.
        """
        if part.names != self.layout.tree.names:
            part = part.ordered(self.layout.tree)
        torques = self.layout.model == "torque"
        velocity = acceleration = np.empty((0, len(part.names)))
        if (
            part.senses_kinematics
            and part.velocity is not None
            and part.acceleration is not None
        ):
            velocity, acceleration = part.velocity, part.acceleration
        inputs = {term.law.by for term in self.layout.terms} - {"", *LOAD_MULTIPLIERS}
        measured = (
            part.measured("torque") if torques else part.measured("wrench") - self.tare
        )
        arrays = part.position, velocity, acceleration, measured
        q, qd, qdd, y = map(np.ascontiguousarray, arrays)
        return SignalWindow(
            position=q,
            velocity=qd,
            acceleration=qdd,
            measured=y,
            taps=self.motion_kernels,
            weights=self.weights,
            deadband=self.deadband,
            rest_reach=self.reversal_reach,
            start=self.reach,
            step=self.step,
            row_count=window.rows,
            covariates=self._covariates(part, window) if inputs else EMPTY_MATRIX,
            load=EMPTY_VECTOR if self.load is None else self.load,
            sample_mask=self._sample_mask(window.first, part.samples),
        )

    def _sample_mask(self, first: int, number: int) -> Array:
        """Mask of included samples, (M, C), one or zero; empty if all samples are included.

        Args:
            first: Index of the first sample.
            number: Number of samples M.
        """
        changes = np.zeros((number + 1, len(self.excluded_samples)))
        for channel, spans in zip(changes.T, self.excluded_samples, strict=True):
            begin, end = np.clip(spans.T - first, 0, number)
            np.add.at(channel, begin, 1)
            np.add.at(channel, end, -1)
        excluded = np.cumsum(changes[:-1], axis=0) > 0
        return np.where(excluded, 0.0, 1.0) if excluded.any() else EMPTY_MATRIX

    def _covariates(self, part: Recording, window: Window) -> Array:
        """Time from the middle of the source [s] and drive temperatures above 25 degC, (M, 1 + n).

        Temperatures that were not recorded are zero.
        """
        time = (
            window.first + np.arange(part.samples) - self.source.samples / 2
        ) / self.source.rate
        temperature = (
            np.zeros_like(part.position)
            if part.temperature is None
            else part.temperature - ROOM_TEMPERATURE
        )
        return np.column_stack([time, temperature])


def make_plan(
    source: Source,
    layout: Layout,
    tare: Array,
    settings: Settings,
    rows_per_cutoff: float = ROWS_PER_CUTOFF,
) -> Plan:
    """Plan the regressor rows of a recording: filters, row spacing and spans without gaps.

    Args:
        source: Source of the samples.
        layout: Layout of the robot's rows.
        tare: Static wrench subtracted from the measured wrench, (6,) [N, N m].
        settings: Settings with cutoffs that fit the sampling rate (`Settings.fitted`).
        rows_per_cutoff: Rows per second per Hz of the low-pass on rows.

    Raises:
        RecordingError: The recording is too short, or its sampling rate too low.
    """
    rate, sensed = source.rate, source.senses_kinematics
    row_cutoff, position_cutoff = (
        settings.row_low_pass,
        None if sensed else settings.position_low_pass,
    )
    excessive = [
        cutoff
        for cutoff in (row_cutoff, position_cutoff)
        if cutoff is not None and cutoff >= rate / 2
    ]
    if excessive:
        raise RecordingError(
            f"the recording has {rate:g} samples a second, too few for a filter at "
            f"{excessive[0]:g} Hz"
        )
    reach = low_pass_reach(rate, row_cutoff, ROW_ATTENUATION) + (
        0 if sensed else STENCIL_REACH
    )
    reach += low_pass_reach(rate, position_cutoff, POSITION_ATTENUATION)
    step = 1
    if row_cutoff is not None:
        step = max(
            1,
            int(
                min((1 + 1e-9) * rate / (rows_per_cutoff * row_cutoff), source.samples)
            ),
        )
    spans = tuple(_rows_of_segment(segment, reach, step) for segment in source.segments)
    for k, (_, rows) in enumerate(spans):
        if rows < 2:  # before the weights are computed: their number could be huge
            raise _too_short_error(source, k, reach)
    weights = row_weights(rate, row_cutoff)
    return Plan(
        source=source,
        layout=layout,
        tare=tare,
        motion_kernels=np.array([[1.0], [0.0], [0.0]])
        if sensed
        else motion_taps(rate, position_cutoff),
        weights=weights,
        deadband=settings.deadband if layout.model == "torque" else 0.0,
        reversal_reach=reversal_samples(weights, settings.reversal_reach, rate),
        step=step,
        spans=spans,
        engine=settings.engine,
    )


def _rows_of_segment(
    segment: tuple[int, int], reach: float, step: int
) -> tuple[int, int]:
    """First row whose samples lie in one segment, and the number of such rows.

    Args:
        segment: First sample and index after the last.
        reach: Half-length of the filters [samples].
        step: Number of samples from row to row.
    """
    first, last = -(-segment[0] // step), segment[1]
    return first, len(range(first * step + int(min(2 * reach, last)), last, step))


def _too_short_error(source: Source, number: int, reach: float) -> RecordingError:
    """Error for a segment that is too short for the filters.

    Args:
        source: Source of the samples.
        number: Index of the segment.
        reach: Half-length of the filters [samples].
    """
    segments = source.segments
    first, last = segments[number]
    label = "the recording" if len(segments) == 1 else f"recording {number + 1}"
    return RecordingError(
        f"{label} lasts {(last - first) / source.rate:.3g} s, too short: the filters take "
        f"{reach / source.rate:.3g} s at each end; record longer or raise the cutoff frequencies"
    )
