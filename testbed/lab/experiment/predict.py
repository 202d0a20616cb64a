"""What a run's estimates predict of a recording, beside what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.estimate import Method
from testbed.core.estimation.estimate_summary import corrected_by, summary_of
from testbed.core.estimation.regression.windows import row_weights
from testbed.core.estimation.validate import friction, predictions
from testbed.core.recordings.columns import AXES, PLATE_UNITS
from testbed.core.recordings.recording import Recording
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


@dataclass(frozen=True, eq=False)
class Predictions:
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
    corrected = corrected_by(recording, run.tree, summary_of(external))
    return corrected.part(0, corrected.samples)


def predict(run: Run, recording: Recording | None = None) -> Predictions:
    """What a run's estimates say of a recording.

    Args:
        run: The run.
        recording: Of the same robot; default the run's own.

    Raises:
        RecordingError: The recording is of another robot.
    """
    tree, unseen = run.tree, recording is not None
    recording = run.recording if recording is None else recording.ordered(tree)
    recording = _without_faults(run, recording)
    motion, inner = shown_motion(recording, run.settings)
    wrench, torque = predictions(tree, recording, motion, run.estimates)
    signals = []
    if recording.wrench is not None:
        signals.append(Signal("wrench", AXES, PLATE_UNITS, recording.wrench[inner], wrench))
    if recording.torque is not None:
        units = tuple("N m" if joint.revolute else "N" for joint in tree.joints)
        signals.append(Signal("torque", tree.names, units, recording.torque[inner], torque))
    return Predictions(run, recording, motion, tuple(signals), unseen)
