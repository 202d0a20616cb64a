"""Recordings: signals measured by an instrument and, separately, the simulated truth.

Wrench    wrench of the bedplate on the robot, force first, along the bedplate's axes, about O^0
Times     first instant of each sample
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array, readonly_array
from testbed.core.base.errors import RecordingError
from testbed.core.base.files import atomic_output
from testbed.core.base.frames import data_frame, frame_columns
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.recordings.columns import (
    JOINT_SIGNALS,
    RECORDED_SIGNALS,
    TRUE_JOINT_SIGNALS,
    TRUE_SIGNALS,
    Segments,
    check_columns,
    check_sampling_time,
    column_members,
    joint_names_of_columns,
    segments_of,
    sensor_names_of_columns,
    signal_of,
    unit_of,
)
from testbed.core.recordings.geometry import check_robot
from testbed.core.recordings.metadata import NO_METADATA, Metadata
from testbed.core.robot.tree import Tree, require_tree

FILE_SIGNALS = (*RECORDED_SIGNALS, *(f"truth/{signal}" for signal in TRUE_SIGNALS))
"""Signals that are read from a file; other columns are ignored."""


@dataclass(frozen=True, eq=False)
class Truth:
    """True signals of a simulation at the sampling times, for comparison only.

    Attributes:
        position: Joint positions, (M, n) [rad or m].
        velocity: Joint velocities, (M, n) [rad/s or m/s].
        acceleration: Joint accelerations, (M, n) [rad/s^2 or m/s^2].
        torque: Motor torques, (M, n) [N m or N].
        friction: Friction torques, part of the motor torques, (M, n) [N m or N].
        wrench: Wrench of the bedplate, (M, 6) [N, N m].
        sensors: Wrenches of the robot's force sensors, (M, 6 S) [N, N m]; None without sensors.
    """

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    friction: Array
    wrench: Array
    sensors: Array | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Summarized):
    """Recording at a constant rate: joint positions with motor torques, plate wrench, or both.

    A recording may have gaps; `segments` are the blocks of samples between the gaps.

    Attributes:
        names: Joint names; the order of all joint columns.
        time: Sampling times, (M,) [s].
        position: Encoder positions, (M, n) [rad or m].
        torque: Motor torques as reported by the drives, (M, n) [N m or N]; None if not
            recorded.
        wrench: Wrench of the plate, (M, 6) [N, N m], including `tare`; None without a plate.
        velocity: Sensed velocities, (M, n) [rad/s or m/s]; None if not sensed.
        acceleration: Sensed accelerations, (M, n) [rad/s^2 or m/s^2]; None if not sensed.
        tare: Known static wrench of the pedestal on the plate, (6,) [N, N m]; if None, the
            model's pedestal is assumed.
        sensors: Wrenches of the S force sensors in the robot, side by side, (M, 6 S) [N, N m]: the
            wrench that each sensor exerts on the links beyond, about its origin, along its axes.
        sensor_names: Names of these force sensors; `metadata.sensors` has their positions.
        base: Position and quaternion (w, x, y, z) of a moving base in the ground frame, (M, 7) [m];
            the wrench is then that of the ground, about the origin of the ground frame.
        temperature: Temperatures of the joints' drives, (M, n) [degC].
        truth: True signals of a simulated recording; None for real recordings.
        metadata: Robot, gravity, mapping, and other metadata.
    """

    names: tuple[str, ...]
    time: Array
    position: Array
    torque: Array | None = None
    wrench: Array | None = None
    velocity: Array | None = None
    acceleration: Array | None = None
    tare: Array | None = None
    sensors: Array | None = None
    sensor_names: tuple[str, ...] = ()
    base: Array | None = None
    temperature: Array | None = None
    truth: Truth | None = None
    metadata: Metadata = NO_METADATA

    def __post_init__(self) -> None:
        samples, n = len(self.time), len(self.names)
        shapes = {
            "time": (samples,),
            "wrench": (samples, 6),
            "tare": (6,),
            "base": (samples, 7),
        }
        shapes["sensors"] = (samples, 6 * len(self.sensor_names))
        for name in (*RECORDED_SIGNALS, "tare"):
            value = getattr(self, name)
            if value is not None:
                value = readonly_array(value, shapes.get(name, (samples, n)), name)
                object.__setattr__(self, name, value)

    @property
    def samples(self) -> int:
        """Number M of samples."""
        return len(self.time)

    @property
    def segments(self) -> Segments:
        """Blocks without gaps: index of the first sample, and index after the last sample."""
        return segments_of(self.time, self.metadata.gaps)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the measured signals, from `RECORDED_SIGNALS`."""
        return tuple(
            name for name in RECORDED_SIGNALS if getattr(self, name) is not None
        )

    @property
    def senses_kinematics(self) -> bool:
        """True if both velocities and accelerations were sensed."""
        return self.velocity is not None and self.acceleration is not None

    @property
    def rate(self) -> float:
        """Sampling rate [Hz], from the first segment.

        Raises:
            RecordingError: The sampling time is invalid.
        """
        first, last = self.segments[0]
        length, steps = float(self.time[last - 1] - self.time[first]), last - first - 1
        check_sampling_time(length / max(steps, 1), "the recording")
        return steps / length

    def measured(self, signal: str) -> Array:
        """Values of a measured signal, (M, n), (M, 6) or (M,).

        Args:
            signal: Name from `RECORDED_SIGNALS`.

        Raises:
            RecordingError: The signal was not measured.
        """
        values: Array | None = getattr(self, signal)
        if values is None:
            raise RecordingError(f"the recording has no {signal}")
        return values

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last - 1`, without the true signals and without copying."""
        signals: dict[str, Any] = {
            s: self.measured(s)[first:last] for s in self.signals
        }
        return replace(self, truth=None, **signals)

    def blind(self) -> Recording:
        """Recording without the true signals, as passed to estimators."""
        return replace(self, truth=None)

    def ordered(self, tree: Tree) -> Recording:
        """Recording with joint columns in the order of `tree.names`, including true signals.

        Raises:
            RecordingError: The recording belongs to another robot.
        """
        check_robot(self, tree)
        return self if self.names == tree.names else self.of_joints(tree.names)

    def of_joints(self, names: Sequence[str]) -> Recording:
        """Recording with the columns of some joints, including true signals.

        Args:
            names: Names of recorded joints, in the order of the new columns.
        """
        order = [self.names.index(name) for name in names]
        joint_signals = [signal for signal in JOINT_SIGNALS if signal in self.signals]
        selected: dict[str, Any] = {
            s: self.measured(s)[:, order] for s in joint_signals
        }
        truth = self.truth
        if truth is not None:
            joints = {s: getattr(truth, s)[:, order] for s in TRUE_JOINT_SIGNALS}
            truth = replace(truth, **joints)
        return replace(self, names=tuple(names), truth=truth, **selected)

    def columns(self) -> dict[str, Array]:
        """Measured channels keyed by column name, (M,) each."""
        columns: dict[str, Array] = {}
        for signal in self.signals:
            columns |= _signal_columns(
                signal, self.measured(signal), self.names, self.sensor_names
            )
        return columns

    def true_columns(self) -> dict[str, Array]:
        """True signals keyed by column name, (M,) each; empty for real recordings."""
        columns: dict[str, Array] = {}
        for signal in TRUE_SIGNALS if self.truth is not None else ():
            values = getattr(self.truth, signal)
            if values is None:
                continue
            channels = _signal_columns(signal, values, self.names, self.sensor_names)
            columns |= {f"truth/{k}": v for k, v in channels.items()}
        return columns

    def units(self) -> dict[str, str]:
        """Unit of each column, including true signals, keyed by column name."""
        joint_types = {
            name: joint.kind or "revolute"
            for name, joint in self.metadata.geometry.items()
        }
        columns = (*self.columns(), *self.true_columns())
        return {column: unit_of(column, joint_types) for column in columns}

    @property
    def header(self) -> dict[str, Any]:
        """Tare and metadata as values for the JSON text of a file."""
        tare = None if self.tare is None else self.tare.tolist()
        return {"tare": tare, "facts": self.metadata.table()}

    @staticmethod
    def from_columns(
        columns: Mapping[str, Array], header: Any, source: str
    ) -> Recording:
        """Build a recording from the columns and metadata of a file.

        Args:
            columns: Columns keyed by name, (M,) each; `time` and the position of each joint are
                required. Columns of unknown signals are ignored, and so are true signals unless
                they are complete (wrenches of sensors are optional).
            header: Tare and metadata as in `Recording.header`, not yet checked.
            source: Name of the recording, for error messages.

        Raises:
            RecordingError: A channel is missing, or the metadata are invalid.
        """
        names, sensors = (
            joint_names_of_columns(list(columns)),
            sensor_names_of_columns(list(columns)),
        )
        if "time" not in columns:
            raise RecordingError(f"{source}: channel 'time' is missing")
        if not names:
            raise RecordingError(f"{source}: there is no channel 'position/JOINT'")
        try:
            tare, metadata = parse_header(header)
        except ValueError as error:
            raise RecordingError(f"{source}: not a recording: {error}") from None
        signals = {signal_of(column) for column in columns}
        values: dict[str, Any] = {
            s: _stacked_signal(s, columns, names, sensors, source)
            for s in FILE_SIGNALS
            if s in signals
        }
        true_signals = {
            s: values.pop(f"truth/{s}") for s in TRUE_SIGNALS if f"truth/{s}" in values
        }
        return Recording(
            names=names,
            tare=tare,
            truth=Truth(**true_signals)
            if {*TRUE_SIGNALS} - {*true_signals} <= {"sensors"}
            else None,
            sensor_names=sensors,
            metadata=metadata,
            **values,
        )

    @staticmethod
    def from_frame(frame: Any, robot: Tree) -> Recording:
        """Build a recording from a data frame or from arrays, at a constant rate.

        Args:
            frame: A data frame of pandas or polars, an Arrow table, or a mapping from names to
                arrays. Columns are `time` [s] and `position/JOINT` [rad or m], and optionally
                `torque/JOINT` [N m or N], `velocity/JOINT`, `acceleration/JOINT` and the wrench of
                the plate on the robot, `wrench/Fx` ... `wrench/Mz` [N, N m]. In a mapping,
                `position`, `torque` and `wrench` may be arrays, (M, joints) or (M, 6).
            robot: The robot; columns of arrays are in the order of its joint names.

        Raises:
            RecordingError: A channel is missing, or sampling is not uniform.
        """
        require_tree(robot, "from_frame(frame, robot)")
        columns: dict[str, Array] = {}
        for name, values in frame_columns(frame).items():
            columns |= (
                {name: values}
                if values.ndim == 1
                else _signal_columns(name, values, robot.names, ())
            )
        recording = Recording.from_columns(columns, {}, "the frame")
        check_columns(recording.columns(), "the frame", recording.segments)
        return recording.ordered(robot)

    def to_frame(self) -> Any:
        """Measured channels as columns of a pandas, polars or Arrow frame."""
        return data_frame(self.columns())

    @property
    def summary(self) -> SummaryTable:
        """Table of the recording's length, and of the rms value and range of each channel."""
        rows: list[tuple[str, ...]] = [("channel", "rms", "least", "greatest")]
        for name, values in self.columns().items():
            if name != "time":
                rms = float(np.sqrt(np.mean(values**2)))
                rows.append(
                    (name, *(f"{x:.4g}" for x in (rms, values.min(), values.max())))
                )
        length = float(self.time[-1] - self.time[0]) if self.samples else 0.0
        head = f"recording of {', '.join(self.names)}: {self.samples} samples, {length:.4g} s"
        return SummaryTable(head, tuple(rows))

    def save(self, path: str | Path) -> None:
        """Write the recording to a Parquet file, completely or not at all.

        Raises:
            RecordingError: The path is an existing file in another format.
        """
        from testbed.core.recordings.formats.parquet import is_parquet, write_table

        if Path(path).is_file() and not is_parquet(Path(path)):
            raise RecordingError(
                f"'{path}' is there and is no recording; choose another name"
            )
        with atomic_output(Path(path)) as temporary:
            columns = self.columns() | self.true_columns()
            write_table(temporary, self.units(), self.header, [columns])

    @staticmethod
    def load(path: str | Path) -> Recording:
        """Read a recording from a Parquet file, and check its values.

        Raises:
            RecordingError: The file is missing, damaged or incomplete, contains values that are not
                numbers, or its sampling is not uniform.
        """
        from testbed.core.recordings.formats.parquet import open_table

        table = open_table(Path(path))
        names = [
            column for column in table.columns if signal_of(column) in FILE_SIGNALS
        ]
        columns = table.read(names, 0, table.samples)
        recording = Recording.from_columns(columns, table.metadata, str(path))
        check_columns(recording.columns(), str(path), recording.segments)
        return recording


def parse_header(header: Any) -> tuple[Array | None, Metadata]:
    """Parse tare and metadata from the keys "tare" and "facts" of a file header.

    Args:
        header: Header as read from the file, not yet checked.

    Returns:
        Tare, (6,) [N, N m], or None; and metadata, empty if the key is missing.

    Raises:
        ValueError: The header is invalid.
    """
    if not isinstance(header, Mapping):
        raise ValueError("its metadata are no table")
    tare, content = header.get("tare"), header.get("facts") or {}
    if tare is not None:
        try:
            tare = readonly_array(np.array(tare, dtype=np.float64), (6,), "tare")
        except (TypeError, ValueError):
            raise ValueError("its 'tare' is not six numbers") from None
        if not np.isfinite(tare).all():
            raise ValueError("its 'tare' is not six finite numbers")
    if not isinstance(content, Mapping):
        raise ValueError("its 'facts' are no table")
    return tare, Metadata.parse(content)


def _signal_columns(
    signal: str, values: Array, joints: tuple[str, ...], sensors: tuple[str, ...]
) -> dict[str, Array]:
    """Columns of a signal keyed by name, (M,) each.

    Args:
        signal: Name of the signal.
        values: Values of the signal, (M, k), or (M,) for the time.
        joints: Joint names.
        sensors: Names of force sensors.
    """
    if signal == "time":
        return {signal: values}
    members = column_members(signal, joints, sensors)
    return {f"{signal}/{member}": values[:, k] for k, member in enumerate(members)}


def _stacked_signal(
    signal: str,
    columns: Mapping[str, Array],
    joints: tuple[str, ...],
    sensors: tuple[str, ...],
    source: str,
) -> Array:
    """Stack the columns of a signal into an array, (M, k), or (M,) for the time.

    Raises:
        RecordingError: A column of the signal is missing.
    """
    if signal == "time":
        return columns[signal]
    keys = [f"{signal}/{member}" for member in column_members(signal, joints, sensors)]
    missing = [key for key in keys if key not in columns]
    if missing:
        raise RecordingError(f"{source}: channel '{missing[0]}' is missing")
    return np.stack([columns[key] for key in keys], axis=1)
