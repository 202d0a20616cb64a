"""What a run's estimates predict of a recording, beside what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from testbed.applications.validate import friction, predictions
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.core.base.frames import frame_of
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.estimate import Estimate, Method
from testbed.core.estimation.information import Information
from testbed.core.estimation.regression.windows import row_weights
from testbed.core.estimation.sensor.lasting import lastingly_corrected
from testbed.core.recordings.columns import AXES, PLATE_UNITS
from testbed.core.recordings.recording import Recording
from testbed.core.robot.model_file import ModelFile
from testbed.lab.experiment.run import Run, shown_motion


@dataclass(frozen=True, eq=False)
class Signal:
    """One kind of measurement and what the estimates say of it.

    Attributes:
        kind: "wrench" or "torque".
        channels: Names, (k,).
        units: One a channel.
        measured: (M, k) [N, N m].
        predicted: By method, (M, k). The wrench contains the pedestal's; joint torques of the
            external estimate lack friction.
    """

    kind: Literal["wrench", "torque"]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    measured: Array
    predicted: Mapping[Method, Array]

    def residual(self, method: Method) -> Array:
        """Measured less predicted, (M, k)."""
        return self.measured - self.predicted[method]


@dataclass(frozen=True, eq=False, repr=False)
class Predictions(Summarized):
    """A recording beside what a run's estimates say of it.

    Attributes:
        run: Whose estimates.
        recording: Of the run, or another of the same robot; joints in the tree's order.
        motion: What the recording shows, without the ends that filters take, M samples.
        signals: What was measured: the wrench, the joint torques, or both.
        unseen: Whether the recording is another one.
    """

    run: Run
    recording: Recording
    motion: Motion
    signals: tuple[Signal, ...]
    unseen: bool = False

    @property
    def summary(self) -> SummaryTable:
        """Rms of each channel and of what every estimate leaves of it."""
        rows: list[tuple[str, ...]] = []
        for signal in self.signals:
            for k, channel in enumerate(signal.channels):
                left = [signal.residual(by)[:, k] for by in signal.predicted]
                sizes = [f"{np.sqrt(np.mean(x**2)):.3g}" for x in (signal.measured[:, k], *left)]
                rows.append((channel, sizes[0], signal.units[k], f"left: {', '.join(sizes[1:])}"))
        return SummaryTable(f"{self.motion.samples} samples, rms", tuple(rows))

    @property
    def time(self) -> Array:
        """Of the samples, (M,) [s]."""
        return self.motion.t

    def to_frame(self) -> Any:
        """Measured and predicted signals over time, as a frame of pandas, polars or Arrow."""
        columns: dict[str, Array] = {"time": self.time}
        for signal in self.signals:
            for k, channel in enumerate(signal.channels):
                name = f"{signal.kind}/{channel}"
                columns[f"{name}/measured"] = signal.measured[:, k]
                columns |= {f"{name}/{by}": each[:, k] for by, each in signal.predicted.items()}
        return frame_of(columns)

    @cached_property
    def unexplained_torque(self) -> Array | None:
        """Motor torque less what the robot needs by the plate's estimate, (M, n) [N m or N].

        Friction, and what the drives report wrongly. None without torques or that estimate.
        """
        for signal in self.signals:
            if signal.kind == "torque" and "external" in signal.predicted:
                return signal.residual("external")
        return None

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
            return np.column_stack([np.convolve(each, weights, "valid") for each in values.T])

        signals = [
            replace(
                signal,
                measured=passed(signal.measured),
                predicted={method: passed(each) for method, each in signal.predicted.items()},
            )
            for signal in self.signals
        ]
        inner = slice(reach, self.motion.samples - reach)
        return replace(self, motion=self.motion[inner], signals=tuple(signals))

    def friction(self, speed: Array) -> Array | None:
        """Joint friction at speeds, (k, n) [N m or N], by the torque estimate; None without one.

        Args:
            speed: Joint velocities, (k, n) [rad/s or m/s].
        """
        internal = self.run.estimates.get("internal")
        return None if internal is None else friction(speed, internal)


def _without_faults(run: Run, recording: Recording) -> Recording:
    """The recording, faults that an estimate of the run has found taken back."""
    external = run.estimates.get("external")
    if external is None or not external.nuisances:
        return recording
    corrected = lastingly_corrected(recording, run.tree, external.sensor_errors)
    return corrected.part(0, corrected.samples)


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
        raise SettingsError("a recording is shown with estimates of its robot: give one or more")
    tree = found[0].minimal.robot
    return Run(
        name=tree.name,
        tree=tree,
        recording=data.ordered(tree),
        estimates={each.method: each for each in found},
        settings=found[0].settings,
        model=tree.file if isinstance(tree.file, ModelFile) else None,
    )


def predict(data: Recording | Run, *more: Estimate | Information | Recording | None) -> Predictions:
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
    recording = _without_faults(run, recording)
    motion, inner = shown_motion(recording, run.settings)
    wrench, torque = predictions(run.tree, recording, motion, run.estimates)
    signals = []
    if recording.wrench is not None:
        signals.append(Signal("wrench", AXES, PLATE_UNITS, recording.wrench[inner], wrench))
    if recording.torque is not None:
        units = tuple("N m" if joint.revolute else "N" for joint in run.tree.joints)
        signals.append(Signal("torque", run.tree.names, units, recording.torque[inner], torque))
    return Predictions(run, recording, motion, tuple(signals), bool(others))
