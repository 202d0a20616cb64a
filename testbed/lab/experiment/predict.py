"""Predict a recording's signals by the estimates of a run, and compare with measurements."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from testbed.applications.prediction import (
    predicted_signals,
    prediction_variances,
    steady_joint_torque,
)
from testbed.applications.validate import Z_95_PERCENT
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.core.base.frames import data_frame
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.estimate import (
    Estimate,
    channel_units,
)
from testbed.core.estimation.information import Information
from testbed.core.estimation.model_errors.model_errors import ModelErrorFreeSource
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.windows import row_weights
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.columns import WRENCH_COMPONENTS, WRENCH_UNITS
from testbed.core.recordings.geometry import with_recorded_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import longest_segment
from testbed.lab.experiment.run import Run, recorded_motion
from testbed.sensors.corrected import corrected


@dataclass(frozen=True, eq=False)
class Channel:
    """Measured and predicted signal of one channel.

    Attributes:
        kind: "wrench" or "torque".
        index: Index among the channels of its kind.
        name: "Fx" ... "Mz", or the joint's name.
        unit: N or N m.
        measured: Measured signal, (M,) [N, N m].
        predicted: Predicted signals by method, (M,).
    """

    kind: Literal["wrench", "torque"]
    index: int
    name: str
    unit: str
    measured: Array
    predicted: Mapping[Signal, Array]

    @property
    def curves(self) -> dict[Any, Array]:
        """Measured and predicted signals by name, (M,) each."""
        return {"measured": self.measured, **self.predicted}

    @property
    def residuals(self) -> dict[Signal, Array]:
        """Measured minus predicted signal by method, (M,)."""
        return {method: self.measured - each for method, each in self.predicted.items()}


def _channels(
    kind: Literal["wrench", "torque"],
    names: Sequence[str],
    units: Sequence[str],
    measured: Array,
    predicted: Mapping[Signal, Array],
) -> Iterator[Channel]:
    """Yield the k channels of the wrench or of the joint torques.

    Args:
        kind: "wrench" or "torque".
        names: Names of the channels, (k,).
        units: Units of the channels, (k,).
        measured: Measured signals, (M, k).
        predicted: Predicted signals by method, (M, k).
    """
    for c, (name, unit) in enumerate(zip(names, units, strict=True)):
        column = {method: each[:, c] for method, each in predicted.items()}
        yield Channel(kind, c, name, unit, measured[:, c], column)


@dataclass(frozen=True, eq=False, repr=False)
class Predictions(Summarized):
    """Measured signals of a recording, and predictions by the estimates of a run.

    Attributes:
        run: Run with the estimates.
        recording: Recording of the run, or another of the same robot; joints in the tree's order.
        motion: Motion of the recording without the ends lost to filters, M samples.
        channels: Channels of the wrench, the joint torques, or both. The wrench contains the
            pedestal's; joint torques by the plate's estimate lack friction. Sensor errors and model
            errors that were estimated are removed from the measured signals.
        unseen: True if the recording is not that of the run.
        doubt: Mean squares of the uncertainty of the removed model errors by method, (C,).
    """

    run: Run
    recording: Recording
    motion: Motion
    channels: tuple[Channel, ...]
    unseen: bool = False
    doubt: Mapping[Signal, Array] = field(default_factory=dict)

    @property
    def summary(self) -> SummaryTable:
        """Table with the rms of each channel and of its residuals by every estimate."""
        rows = []
        for each in self.channels:
            values = each.measured, *each.residuals.values()
            size, *residuals = (f"{np.sqrt(np.mean(x**2)):.3g}" for x in values)
            rows.append((each.name, size, each.unit, f"left: {', '.join(residuals)}"))
        return SummaryTable(f"{self.motion.samples} samples, rms", tuple(rows))

    @property
    def time(self) -> Array:
        """Times of the samples, (M,) [s]."""
        return self.motion.t

    def to_frame(self) -> Any:
        """Measured and predicted signals over time, as a data frame of pandas, polars or Arrow.

        Columns "time" [s] and "KIND/CHANNEL/CURVE", such as "wrench/Fx/measured".
        """
        columns: dict[str, Array] = {"time": self.time}
        for each in self.channels:
            name = f"{each.kind}/{each.name}"
            columns |= {
                f"{name}/{curve}": values for curve, values in each.curves.items()
            }
        return data_frame(columns)

    @cached_property
    def band(self) -> dict[Signal, Array]:
        """Half widths of 95 % bands about predictions, by method, (M, C) [N, N m].

        Each method has the band of its own signal. It contains the covariance of the parameters,
        the variance of model errors, and noise below the cutoff of the estimate's rows: `smoothed`
        signals should be within.
        """
        widths = {}
        for method, estimate in self.run.estimates.items():
            variance = prediction_variances(
                self.run.tree, self.recording, self.motion, estimate
            )
            variance += estimate.residual**2
            variance += self.doubt.get(method, 0.0)
            widths[method] = Z_95_PERCENT * np.sqrt(variance)
        return widths

    @cached_property
    def unexplained_torque(self) -> Array | None:
        """Motor torque minus the rigid bodies' torque by the plate's estimate, (M, n) [N m or N].

        It consists of friction and errors of the drives. None without torques or that estimate.
        """
        residuals = [
            each.residuals["wrench"]
            for each in self.channels
            if each.kind == "torque" and "wrench" in each.predicted
        ]
        return np.column_stack(residuals) if residuals else None

    def smoothed(self, cutoff: float) -> Predictions:
        """Copy with all signals low-pass filtered, without the ends lost to the filter.

        Unchanged if the recording is too short for the filter.

        Args:
            cutoff: Frequency at which the gain is one half [Hz].
        """
        weights = row_weights(self.recording.rate, cutoff)
        half_width = len(weights) // 2
        if self.motion.samples <= 2 * len(weights):
            return self

        def filtered(values: Array) -> Array:
            return np.convolve(values, weights, "valid")

        channels = [
            replace(
                each,
                measured=filtered(each.measured),
                predicted={
                    method: filtered(values)
                    for method, values in each.predicted.items()
                },
            )
            for each in self.channels
        ]
        samples = slice(half_width, self.motion.samples - half_width)
        return replace(self, motion=self.motion[samples], channels=tuple(channels))

    def friction(self, speed: Array) -> Array | None:
        """Joint friction by the torque estimate at given speeds, (k, n) [N m or N].

        None without a torque estimate.

        Args:
            speed: Joint velocities, (k, n) [rad/s or m/s].
        """
        estimate = self.run.estimates.get("torque")
        return None if estimate is None else steady_joint_torque(speed, estimate)


def _corrected_recording(
    run: Run, recording: Recording
) -> tuple[Recording, dict[Signal, Array]]:
    """Recording without the estimated sensor and model errors, with the model errors' uncertainty.

    With such errors it is the longest segment of the recording, otherwise the recording itself. The
    uncertainty is the mean square of the errors in the removed model errors by channel, (C,), by
    method.
    """
    variance: dict[Signal, Array] = {}
    plate_estimate = run.estimates.get("wrench")
    if plate_estimate is not None and plate_estimate.nuisances:
        part = recording.part(*longest_segment(recording))
        source = corrected(part, run.tree, plate_estimate.sensor_errors)
        recording = source.part(0, source.samples)
    for method, estimate in run.estimates.items():
        if estimate.correction is None or method not in recording.signals:
            continue
        part = recording.part(*longest_segment(recording))
        tree = with_recorded_gravity(run.tree, part)
        problem = Problem.from_recording(tree, part, method, estimate.settings)
        source = problem.source
        values = estimate.values
        corrected_source = ModelErrorFreeSource(
            problem, source, values, estimate.correction
        )
        recording = corrected_source.part(0, corrected_source.samples)
        variance[method] = corrected_source.doubt
    return recording, variance


def run_from_estimates(data: Recording, *estimates: Estimate | Information) -> Run:
    """Build a run from a recording and estimates of its robot.

    Args:
        data: Recording of the robot.
        estimates: At least one estimate, or sums of information with estimates; robot and settings
            are those of the first, and of two estimates by one method the later is used.

    Raises:
        SettingsError: There is no estimate, or another value is given.
    """
    inputs: list[object] = []
    for each in estimates:
        inputs += each.estimates if isinstance(each, Information) else [each]
    valid_estimates = [each for each in inputs if isinstance(each, Estimate)]
    if not valid_estimates or len(valid_estimates) < len(inputs):
        raise SettingsError(
            "a recording is shown with estimates of its robot: give one or more"
        )
    tree = valid_estimates[0].minimal.robot
    return Run(
        name=tree.name,
        tree=tree,
        recording=data.ordered(tree),
        estimates={each.method: each for each in valid_estimates},
        settings=valid_estimates[0].settings,
    )


def predict(
    data: Recording | Run, *inputs: Estimate | Information | Recording | None
) -> Predictions:
    """Predict a recording's signals by estimates, and compare with the measurements.

    Args:
        data: Recording of the robot, or a run with its own estimates.
        inputs: For a recording, the estimates; for a run, another recording to be predicted, or
            nothing for the run's own.

    Raises:
        RecordingError: The recording is of another robot.
    """
    recordings = [each for each in inputs if isinstance(each, Recording)]
    estimates = [each for each in inputs if isinstance(each, Estimate | Information)]
    run = data if isinstance(data, Run) else run_from_estimates(data, *estimates)
    recording = recordings[0].ordered(run.tree) if recordings else run.recording
    recording, variance = _corrected_recording(run, recording)
    motion, samples = recorded_motion(recording, run.settings)
    wrench, torque = predicted_signals(run.tree, recording, motion, run.estimates)
    channels: list[Channel] = []
    if recording.wrench is not None:
        measured = recording.wrench[samples]
        channels += _channels(
            "wrench", WRENCH_COMPONENTS, WRENCH_UNITS, measured, wrench
        )
    if recording.torque is not None:
        units, measured = channel_units(run.tree, "torque"), recording.torque[samples]
        channels += _channels("torque", run.tree.names, units, measured, torque)
    return Predictions(
        run, recording, motion, tuple(channels), bool(recordings), variance
    )
