"""A recording: what the instrument measured, and, walled off, what really happened.

Wrench    of the bedplate on the robot, force first, bedplate axes, moment about O^0
Times     of the first instant of each sample
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array, readonly
from testbed.core.base.errors import RecordingError
from testbed.core.base.files import replacing
from testbed.core.base.frames import columns_of, frame_of
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.recordings.columns import (
    JOINT_SIGNALS,
    SIGNALS,
    TRUE_JOINT_SIGNALS,
    TRUE_SIGNALS,
    Segments,
    check_columns,
    check_sampling_time,
    joints_in,
    members_of,
    segments_of,
    sensors_in,
    signal_of,
    unit_of,
)
from testbed.core.recordings.geometry import check_robot
from testbed.core.recordings.metadata import NO_METADATA, Metadata
from testbed.core.robot.tree import Tree, require_tree

READ = (*SIGNALS, *(f"truth/{signal}" for signal in TRUE_SIGNALS))
"""Signals that are read from a file; its other columns are left alone."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What really happened, sampled as the measurements are. For comparison only.

    Attributes:
        position: (M, n) [rad or m].
        velocity: (M, n) [rad/s or m/s].
        acceleration: (M, n) [rad/s^2 or m/s^2].
        torque: What the motors delivered, (M, n) [N m or N].
        friction: What friction took from it, (M, n) [N m or N].
        wrench: (M, 6) [N, N m].
        sensors: Of the robot's force sensors, (M, 6 S) [N, N m]; None where there are none.
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
    """M samples of encoders, and of motor torques or the plate or both, at a constant rate.

    Samples may be missing: `segments` are without a gap.

    Attributes:
        names: Joint names; the order of all joint columns.
        time: (M,) [s].
        position: Encoders, (M, n) [rad or m].
        torque: Motor torques as the drives report them, (M, n) [N m or N]; None if they
            were not recorded.
        wrench: The plate, (M, 6) [N, N m]; contains `tare`; None if there was no plate.
        velocity: Where the instrument senses it, (M, n) [rad/s or m/s].
        acceleration: Where the instrument senses it, (M, n) [rad/s^2 or m/s^2].
        tare: Known static wrench of the pedestal that stands on the plate, (6,) [N, N m];
            None if the recording does not say: the model's pedestal is then assumed.
        sensors: Wrenches of force sensors in the robot, one after the other, (M, 6 S) [N, N m]:
            what each exerts on the links beyond it, about its origin in its axes.
        sensor_names: Their names; `metadata.sensors` says where they are.
        base: Position and quaternion (w, x, y, z) of a base that moves, on the ground, (M, 7)
            [m]; the wrench is then the ground's, about the ground's origin.
        temperature: Of the joints' drives, (M, n) [degC].
        truth: What really happened, where a simulation made the recording.
        metadata: Robot, gravity, mapping, and what else is known.
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
        for name in (*SIGNALS, "tare"):
            value = getattr(self, name)
            if value is not None:
                value = readonly(value, shapes.get(name, (samples, n)), name)
                object.__setattr__(self, name, value)

    @property
    def samples(self) -> int:
        """Number M of samples."""
        return len(self.time)

    @property
    def segments(self) -> Segments:
        """Blocks without a gap: the first sample of each, and the one after its last."""
        return segments_of(self.time, self.metadata.gaps)

    @property
    def signals(self) -> tuple[str, ...]:
        """What was measured, of `SIGNALS`."""
        return tuple(name for name in SIGNALS if getattr(self, name) is not None)

    @property
    def senses_kinematics(self) -> bool:
        """Whether velocities and accelerations were sensed, both."""
        return self.velocity is not None and self.acceleration is not None

    @property
    def rate(self) -> float:
        """Samples a second [Hz].

        Raises:
            RecordingError: Its times are no times of samples.
        """
        first, last = self.segments[0]
        length, steps = float(self.time[last - 1] - self.time[first]), last - first - 1
        check_sampling_time(length / max(steps, 1), "the recording")
        return steps / length

    def measured(self, signal: str) -> Array:
        """A signal that must be there, (M, n), (M, 6) or (M,).

        Args:
            signal: Of `SIGNALS`.

        Raises:
            RecordingError: It was not measured.
        """
        values: Array | None = getattr(self, signal)
        if values is None:
            raise RecordingError(f"the recording has no {signal}")
        return values

    def part(self, first: int, last: int) -> Recording:
        """What was measured in samples `first` to `last` - 1; nothing is copied."""
        cut: dict[str, Any] = {s: self.measured(s)[first:last] for s in self.signals}
        return replace(self, truth=None, **cut)

    def blind(self) -> Recording:
        """The same recording without the truth: what an estimator is given."""
        return replace(self, truth=None)

    def ordered(self, tree: Tree) -> Recording:
        """Joint columns by name in the order of `tree.names`, those of the truth too.

        Raises:
            RecordingError: The recording is of another robot.
        """
        check_robot(self, tree)
        return self if self.names == tree.names else self.of_joints(tree.names)

    def of_joints(self, names: Sequence[str]) -> Recording:
        """Columns of some joints, those of the truth too.

        Args:
            names: Of joints that it has, in the order of their columns.
        """
        order = [self.names.index(name) for name in names]
        there = [signal for signal in JOINT_SIGNALS if signal in self.signals]
        picked: dict[str, Any] = {s: self.measured(s)[:, order] for s in there}
        truth = self.truth
        if truth is not None:
            joints = {s: getattr(truth, s)[:, order] for s in TRUE_JOINT_SIGNALS}
            truth = replace(truth, **joints)
        return replace(self, names=tuple(names), truth=truth, **picked)

    def columns(self) -> dict[str, Array]:
        """Measured channels by column name, (M,) each."""
        found: dict[str, Array] = {}
        for signal in self.signals:
            found |= _split(
                signal, self.measured(signal), self.names, self.sensor_names
            )
        return found

    def true_columns(self) -> dict[str, Array]:
        """What really happened by column name, (M,) each; none where it is not known."""
        found: dict[str, Array] = {}
        for signal in TRUE_SIGNALS if self.truth is not None else ():
            values = getattr(self.truth, signal)
            if values is None:
                continue
            own = _split(signal, values, self.names, self.sensor_names)
            found |= {f"truth/{k}": v for k, v in own.items()}
        return found

    def units(self) -> dict[str, str]:
        """Unit of every column, those of the truth too."""
        kinds = {
            name: each.kind or "revolute"
            for name, each in self.metadata.geometry.items()
        }
        every = (*self.columns(), *self.true_columns())
        return {column: unit_of(column, kinds) for column in every}

    @property
    def header(self) -> dict[str, Any]:
        """Tare and metadata, as JSON of files takes them."""
        tare = None if self.tare is None else self.tare.tolist()
        return {"tare": tare, "facts": self.metadata.table()}

    @staticmethod
    def from_columns(
        columns: Mapping[str, Array], header: Any, source: str
    ) -> Recording:
        """A recording of columns and metadata as a file yields them.

        Args:
            columns: By name, (M,) each; `time` and a position for every joint must be there.
            header: As of `Recording.header`, unchecked.
            source: What the recording is called.

        Raises:
            RecordingError: A channel is missing, or the metadata are not what they should be.
        """
        names, sensors = joints_in(list(columns)), sensors_in(list(columns))
        if "time" not in columns:
            raise RecordingError(f"{source}: channel 'time' is missing")
        if not names:
            raise RecordingError(f"{source}: there is no channel 'position/JOINT'")
        try:
            tare, metadata = parse_header(header)
        except ValueError as error:
            raise RecordingError(f"{source}: not a recording: {error}") from None
        known = {signal_of(column) for column in columns}
        read: dict[str, Any] = {
            s: _joined(s, columns, names, sensors, source) for s in READ if s in known
        }
        true = {s: read.pop(f"truth/{s}") for s in TRUE_SIGNALS if f"truth/{s}" in read}
        return Recording(
            names=names,
            tare=tare,
            truth=Truth(**true) if {*TRUE_SIGNALS} - {*true} <= {"sensors"} else None,
            sensor_names=sensors,
            metadata=metadata,
            **read,
        )

    @staticmethod
    def from_frame(frame: Any, robot: Tree) -> Recording:
        """A recording of one's own data, at a constant rate.

        Args:
            frame: A data frame of pandas or polars, an Arrow table, or arrays by name. Columns are
                `time` [s] and `position/JOINT` [rad or m], and what there is of `torque/JOINT`
                [N m or N], `velocity/JOINT`, `acceleration/JOINT` and the wrench of the plate on
                the robot `wrench/Fx` ... `wrench/Mz` [N, N m]. In a mapping, `position`, `torque`
                and `wrench` may be arrays, (M, joints) or (M, 6).
            robot: The robot; joints of arrays are in the order of its names.

        Raises:
            RecordingError: A channel is missing, or sampling is not uniform.
        """
        require_tree(robot, "from_frame(frame, robot)")
        columns: dict[str, Array] = {}
        for name, values in columns_of(frame).items():
            columns |= (
                {name: values}
                if values.ndim == 1
                else _split(name, values, robot.names, ())
            )
        found = Recording.from_columns(columns, {}, "the frame")
        check_columns(found.columns(), "the frame", found.segments)
        return found.ordered(robot)

    def to_frame(self) -> Any:
        """What was measured, a column a channel, as a frame of pandas, polars or Arrow."""
        return frame_of(self.columns())

    @property
    def summary(self) -> SummaryTable:
        """Length, and rms and range of every channel."""
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
        """Write to a Parquet file, whole or not at all.

        Raises:
            RecordingError: Something that is no Parquet file is there.
        """
        from testbed.core.recordings.formats.parquet import is_parquet, write_table

        if Path(path).is_file() and not is_parquet(Path(path)):
            raise RecordingError(
                f"'{path}' is there and is no recording; choose another name"
            )
        with replacing(Path(path)) as fresh:
            columns = self.columns() | self.true_columns()
            write_table(fresh, self.units(), self.header, [columns])

    @staticmethod
    def load(path: str | Path) -> Recording:
        """Read a Parquet file with a recording's columns.

        Raises:
            RecordingError: The file is missing, damaged or incomplete, or holds values
                that are not numbers, or its sampling is not uniform.
        """
        from testbed.core.recordings.formats.parquet import open_table

        table = open_table(Path(path))
        wanted = [column for column in table.columns if signal_of(column) in READ]
        columns = table.read(wanted, 0, table.samples)
        recording = Recording.from_columns(columns, table.metadata, str(path))
        check_columns(recording.columns(), str(path), recording.segments)
        return recording


def parse_header(header: Any) -> tuple[Array | None, Metadata]:
    """Tare and metadata of a file.

    Args:
        header: As it was read.

    Raises:
        ValueError: It is no header.
    """
    if not isinstance(header, Mapping):
        raise ValueError("its metadata are no table")
    tare, content = header.get("tare"), header.get("facts") or {}
    if tare is not None:
        try:
            tare = readonly(np.array(tare, dtype=np.float64), (6,), "tare")
        except (TypeError, ValueError):
            raise ValueError("its 'tare' is not six numbers") from None
        if not np.isfinite(tare).all():
            raise ValueError("its 'tare' is not six finite numbers")
    if not isinstance(content, Mapping):
        raise ValueError("its 'facts' are no table")
    return tare, Metadata.parse(content)


def _split(
    signal: str, values: Array, joints: tuple[str, ...], sensors: tuple[str, ...]
) -> dict[str, Array]:
    """A signal's columns by name."""
    if signal == "time":
        return {signal: values}
    members = members_of(signal, joints, sensors)
    return {f"{signal}/{member}": values[:, k] for k, member in enumerate(members)}


def _joined(
    signal: str,
    columns: Mapping[str, Array],
    joints: tuple[str, ...],
    sensors: tuple[str, ...],
    source: str,
) -> Array:
    """A signal of its columns.

    Raises:
        RecordingError: It has some of them only.
    """
    if signal == "time":
        return columns[signal]
    keys = [f"{signal}/{member}" for member in members_of(signal, joints, sensors)]
    missing = [key for key in keys if key not in columns]
    if missing:
        raise RecordingError(f"{source}: channel '{missing[0]}' is missing")
    return np.stack([columns[key] for key in keys], axis=1)
