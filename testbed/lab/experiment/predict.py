"""What a run's estimates predict of a recording, beside what was measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from testbed.applications.validate import LEVEL, friction, predictions, variances
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.core.base.frames import frame_of
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.estimate import (
    SIGNAL_OF,
    Estimate,
    Method,
    channel_units,
)
from testbed.core.estimation.information import Information
from testbed.core.estimation.model_errors.model_errors import WithoutModelErrors
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.windows import row_weights
from testbed.core.recordings.columns import AXES, PLATE_UNITS
from testbed.core.recordings.geometry import in_its_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import longest_segment
from testbed.lab.experiment.run import Run, shown_motion
from testbed.sensors.corrected import corrected


@dataclass(frozen=True, eq=False)
class Channel:
    """One channel of a measurement and what the estimates say of it.

    Attributes:
        kind: "wrench" or "torque".
        index: Place among the channels of its kind.
        name: "Fx", or of the joint.
        unit: N or N m.
        measured: (M,) [N, N m].
        predicted: By method, (M,).
    """

    kind: Literal["wrench", "torque"]
    index: int
    name: str
    unit: str
    measured: Array
    predicted: Mapping[Method, Array]

    @property
    def curves(self) -> dict[Any, Array]:
        """Measured and predicted values, (M,) each."""
        return {"measured": self.measured, **self.predicted}

    @property
    def residuals(self) -> dict[Method, Array]:
        """Measured less predicted, (M,), by method."""
        return {by: self.measured - each for by, each in self.predicted.items()}


def _channels(
    kind: Literal["wrench", "torque"],
    names: Sequence[str],
    units: Sequence[str],
    measured: Array,
    predicted: Mapping[Method, Array],
) -> Iterator[Channel]:
    """Channels of one kind, measured and predicted, by method, in columns, (M, k)."""
    for c, (name, unit) in enumerate(zip(names, units, strict=True)):
        found = {by: each[:, c] for by, each in predicted.items()}
        yield Channel(kind, c, name, unit, measured[:, c], found)


@dataclass(frozen=True, eq=False, repr=False)
class Predictions(Summarized):
    """A recording beside what a run's estimates say of it.

    Attributes:
        run: Whose estimates.
        recording: Of the run, or another of the same robot; joints in the tree's order.
        motion: What the recording shows, without the ends that filters take, M samples.
        channels: What was measured: the wrench, the joint torques, or both. The wrench contains
            the pedestal's; joint torques of the external estimate lack friction. Faults and model
            errors that the estimates found are taken out.
        unseen: Whether the recording is another one.
        doubt: By method, mean squares of what model errors may be beside what was taken out, (C,).
    """

    run: Run
    recording: Recording
    motion: Motion
    channels: tuple[Channel, ...]
    unseen: bool = False
    doubt: Mapping[Method, Array] = field(default_factory=dict)

    @property
    def summary(self) -> SummaryTable:
        """Rms of each channel and of what every estimate leaves of it."""
        rows = []
        for each in self.channels:
            values = each.measured, *each.residuals.values()
            size, *left = (f"{np.sqrt(np.mean(x**2)):.3g}" for x in values)
            rows.append((each.name, size, each.unit, f"left: {', '.join(left)}"))
        return SummaryTable(f"{self.motion.samples} samples, rms", tuple(rows))

    @property
    def time(self) -> Array:
        """Of the samples, (M,) [s]."""
        return self.motion.t

    def to_frame(self) -> Any:
        """Measured and predicted signals over time, as a frame of pandas, polars or Arrow."""
        columns: dict[str, Array] = {"time": self.time}
        for each in self.channels:
            name = f"{each.kind}/{each.name}"
            columns |= {f"{name}/{by}": values for by, values in each.curves.items()}
        return frame_of(columns)

    @cached_property
    def band(self) -> dict[Method, Array]:
        """Half widths of 95 % about predictions of each method's own signal, (M, C) [N, N m].

        They count the covariance of the parameters, doubt about model errors, and noise below the
        cutoff of the estimate's rows: `smoothed` signals should be within.
        """
        found = {}
        for method, estimate in self.run.estimates.items():
            variance = variances(self.run.tree, self.recording, self.motion, estimate)
            variance += estimate.residual**2
            variance += self.doubt.get(method, 0.0)
            found[method] = LEVEL * np.sqrt(variance)
        return found

    @cached_property
    def unexplained_torque(self) -> Array | None:
        """Motor torque less what the robot needs by the plate's estimate, (M, n) [N m or N].

        Friction, and what the drives report wrongly. None without torques or that estimate.
        """
        left = [
            each.residuals["external"]
            for each in self.channels
            if each.kind == "torque" and "external" in each.predicted
        ]
        return np.column_stack(left) if left else None

    def smoothed(self, cutoff: float) -> Predictions:
        """Through one low-pass, without the ends it takes; as it is where it is too short for it.

        Args:
            cutoff: Where the low-pass has a gain of one half [Hz].
        """
        weights = row_weights(self.recording.rate, cutoff)
        reach = len(weights) // 2
        if self.motion.samples <= 2 * len(weights):
            return self

        def passed(values: Array) -> Array:
            return np.convolve(values, weights, "valid")

        channels = [
            replace(
                each,
                measured=passed(each.measured),
                predicted={by: passed(values) for by, values in each.predicted.items()},
            )
            for each in self.channels
        ]
        inner = slice(reach, self.motion.samples - reach)
        return replace(self, motion=self.motion[inner], channels=tuple(channels))

    def friction(self, speed: Array) -> Array | None:
        """Joint friction at speeds, (k, n) [N m or N], by the torque estimate; None without one.

        Args:
            speed: Joint velocities, (k, n) [rad/s or m/s].
        """
        internal = self.run.estimates.get("internal")
        return None if internal is None else friction(speed, internal)


def _without_faults(
    run: Run, recording: Recording
) -> tuple[Recording, dict[Method, Array]]:
    """The longest segment without faults and model errors that estimates found, and their doubt.

    Where they found none, the recording. The doubt is one of each method, (C,).
    """
    doubt: dict[Method, Array] = {}
    external = run.estimates.get("external")
    if external is not None and external.nuisances:
        part = recording.part(*longest_segment(recording))
        source = corrected(part, run.tree, external.sensor_errors)
        recording = source.part(0, source.samples)
    for method, estimate in run.estimates.items():
        if estimate.correction is None or SIGNAL_OF[method] not in recording.signals:
            continue
        part = recording.part(*longest_segment(recording))
        tree = in_its_gravity(run.tree, part)
        problem = Problem.of(tree, part, method, estimate.settings)
        source = problem.source
        values = estimate.values
        found = WithoutModelErrors(problem, source, values, estimate.correction)
        recording = found.part(0, found.samples)
        doubt[method] = found.doubt
    return recording, doubt


def run_of(data: Recording, *estimates: Estimate | Information) -> Run:
    """A recording and estimates of its robot as one value.

    Args:
        data: The recording.
        estimates: Of the robot, at least one; those of a sum count one by one.

    Raises:
        SettingsError: There is none.
    """
    listed: list[object] = []
    for each in estimates:
        listed += each.estimates if isinstance(each, Information) else [each]
    found = [each for each in listed if isinstance(each, Estimate)]
    if not found or len(found) < len(listed):
        raise SettingsError(
            "a recording is shown with estimates of its robot: give one or more"
        )
    tree = found[0].minimal.robot
    return Run(
        name=tree.name,
        tree=tree,
        recording=data.ordered(tree),
        estimates={each.method: each for each in found},
        settings=found[0].settings,
    )


def predict(
    data: Recording | Run, *more: Estimate | Information | Recording | None
) -> Predictions:
    """What estimates predict of a recording, beside what was measured.

    Args:
        data: A recording of the robot; or a run.
        more: The estimates; of a run, another recording or nothing.

    Raises:
        RecordingError: The recording is of another robot.
    """
    others = [each for each in more if isinstance(each, Recording)]
    estimates = [each for each in more if isinstance(each, Estimate | Information)]
    run = data if isinstance(data, Run) else run_of(data, *estimates)
    recording = others[0].ordered(run.tree) if others else run.recording
    recording, doubt = _without_faults(run, recording)
    motion, inner = shown_motion(recording, run.settings)
    wrench, torque = predictions(run.tree, recording, motion, run.estimates)
    channels: list[Channel] = []
    if recording.wrench is not None:
        measured = recording.wrench[inner]
        channels += _channels("wrench", AXES, PLATE_UNITS, measured, wrench)
    if recording.torque is not None:
        units, measured = channel_units(run.tree, "internal"), recording.torque[inner]
        channels += _channels("torque", run.tree.names, units, measured, torque)
    return Predictions(run, recording, motion, tuple(channels), bool(others), doubt)
