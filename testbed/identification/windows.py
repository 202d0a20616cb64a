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
from testbed.identification.filters import motion_taps, reversal_samples, row_weights
from testbed.identification.settings import Settings
from testbed.kernel.layout import Layout
from testbed.kernel.records import Signals
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source

ROWS_PER_CUTOFF = {"white": 4.0, "ar": 2.0}
"""Rows kept a second per Hz of the parallel filter's cutoff: for an autoregression as many as
the filter leaves independent, or their spectrum would have an empty part."""

WINDOW = 32_768
"""Samples of a window, about."""


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
        rows: Number of rows.
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
    rows: int
    engine: str

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
        for row in range(0, self.rows, size):
            rows = min(size, self.rows - row)
            first = row * self.step
            last = first + (rows - 1) * self.step + 2 * self.reach + 1
            # one more, so that every step of time is within some window
            yield Window(row, rows, first, min(last + 1, self.source.samples))

    def own(self, window: Window) -> int:
        """How many of a window's samples come before the next window's first."""
        last = window.row + window.rows == self.rows
        return window.last - window.first if last else window.rows * self.step

    def signals(self, part: Recording, window: Window) -> Signals:
        """What the kernel needs of a window's samples."""
        if part.names != self.layout.tree.names:
            part = part.ordered(self.layout.tree)
        dynamic = self.layout.model == "dynamic"
        nothing = np.empty((0, len(part.names)))
        sensed = part.senses_kinematics
        return Signals(
            position=part.position,
            velocity=part.velocity if sensed and part.velocity is not None else nothing,
            acceleration=part.acceleration if sensed and part.acceleration is not None else nothing,
            measured=part.measured("torque") if dynamic else part.measured("wrench") - self.tare,
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
        settings: How to treat the signals.

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
    unit = np.array([[1.0], [0.0], [0.0]])
    taps = unit if sensed else motion_taps(rate, position)
    weights = row_weights(rate, slow)
    reach = taps.shape[1] // 2 + len(weights) // 2
    step = (
        1
        if slow is None
        else int((1 + 1e-9) * rate / (ROWS_PER_CUTOFF[settings.noise] * slow)) or 1
    )
    rows = len(range(reach, source.samples - reach, step))
    if rows < 2:
        raise RecordingError(
            f"the recording lasts {source.samples / rate:.3g} s, too short: the filters take "
            f"{reach / rate:.3g} s at each end; record longer or raise the cutoff frequencies"
        )
    deadband = settings.deadband if layout.model == "dynamic" else 0.0
    nearby = reversal_samples(weights, settings.reversal_reach, rate)
    engine = settings.engine
    return Plan(source, layout, tare, taps, weights, deadband, nearby, step, rows, engine)
