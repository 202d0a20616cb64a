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
from testbed.core.estimation.estimate import Estimate, channel_units
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
        predicted: Signal predicted by each method's estimate, (M,).
    """

    kind: Literal["wrench", "torque"]
    index: int
    name: str
    unit: str
    measured: Array
    predicted: Mapping[Signal, Array]

    @property
    def curves(self) -> dict[Any, Array]:
        """Measured and predicted signals, keyed by "measured" or method, (M,) each."""
        return {"measured": self.measured, **self.predicted}

    @property
    def residuals(self) -> dict[Signal, Array]:
        """Residuals `measured - predicted`, keyed by method, (M,) each."""
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
        predicted: Predicted signals, keyed by method, (M, k) each.
    """
    for c, (name, unit) in enumerate(zip(names, units, strict=True)):
        column = {method: each[:, c] for method, each in predicted.items()}
        yield Channel(kind, c, name, unit, measured[:, c], column)


@dataclass(frozen=True, eq=False, repr=False)
class Predictions(Summarized):
    """Measured signals of a recording, and predictions from the estimates of a run.

    Attributes:
        run: Run with the estimates.
        recording: Recording of the run, or another one of the same robot; joints in the tree's
            order.
        motion: Motion of the recording, M samples; the ends lost to filters are excluded.
        channels: Channels of the wrench, of the joint torques, or of both. The wrench includes the
            pedestal's share; joint torques predicted from the plate's estimate contain no friction.
            Estimated sensor errors and model errors are removed from the measured signals.
        unseen: True if the recording is not the run's own.
        doubt: Mean square of the uncertainty of the removed model errors in each of the C channels,
            (C,), keyed by method.
    """

    run: Run
    recording: Recording
    motion: Motion
    channels: tuple[Channel, ...]
    unseen: bool = False
    doubt: Mapping[Signal, Array] = field(default_factory=dict)

    @property
    def summary(self) -> SummaryTable:
        """Table with the rms of each channel, and of its residuals for every estimate."""
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
        """Measured and predicted signals over time, as a pandas, polars or Arrow data frame.

        The columns are "time" [s] and "KIND/CHANNEL/CURVE", such as "wrench/Fx/measured".
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
        """Half widths of 95 % bands about the predictions, keyed by method, (M, C) [N, N m].

        The band of a method applies to the C channels of its own signal. It accounts for the
        covariance of the parameters, the variance of model errors, and the noise below the cutoff
        of the estimate's rows, so that about 95 % of the `smoothed` measurements should lie within.
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
        """Motor torque less the rigid-body torque predicted from the plate, (M, n) [N m or N].

        The difference consists of friction and errors of the drives. The result is None if torques
        were not recorded or the plate gave no estimate.
        """
        residuals = [
            each.residuals["wrench"]
            for each in self.channels
            if each.kind == "torque" and "wrench" in each.predicted
        ]
        return np.column_stack(residuals) if residuals else None

    def smoothed(self, cutoff: float) -> Predictions:
        """Copy with all signals low-pass filtered, without the ends lost to the filter.

        The predictions are unchanged if the recording is too short for the filter.

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
        """Joint friction at given speeds from the torque estimate, (k, n) [N m or N].

        The result is None if there is no torque estimate.

        Args:
            speed: Joint velocities, (k, n) [rad/s or m/s].
        """
        estimate = self.run.estimates.get("torque")
        return None if estimate is None else steady_joint_torque(speed, estimate)


def _corrected_recording(
    run: Run, recording: Recording
) -> tuple[Recording, dict[Signal, Array]]:
    """Recording with the estimated sensor and model errors removed, and their uncertainty.

    If there are such errors, the result is the longest segment of the recording; otherwise it is
    the whole recording. The uncertainty, keyed by method, is the mean square error of the removed
    model errors in each of the C channels, (C,).
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
        estimates: At least one estimate, or `Information` that yields one. Robot and settings are
            taken from the first; if two estimates use the same method, the later is used.

    Raises:
        SettingsError: No estimate is given, or a value of another type.
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
    """Predict a recording's signals from estimates, for comparison with the measurements.

    Args:
        data: Recording of the robot, or a run with its own estimates.
        inputs: For a recording, the estimates. For a run, another recording to predict; if omitted,
            the run's own recording.

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
