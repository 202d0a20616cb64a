"""A recording: what the instrument measured, and, walled off, what really happened.

Stored as Parquet: one column a channel, its unit in the schema; what is known about the
run (robot, seed, versions) in the file's metadata.

Wrench    of the bedplate on the robot, force first, bedplate axes, moment about O^0
Times     of the first instant of each sample
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from testbed.arrays import Array, readonly
from testbed.errors import RecordingError
from testbed.files import replacing
from testbed.robot.tree import Tree

AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
"""The plate's channels."""

GROUPS = ("time", "position", "torque", "wrench", "velocity", "acceleration")
"""What is measured; the last two only where the instrument senses them."""

LARGEST = 1e12
"""What no instrument measures, in any SI unit."""

GEOMETRY_TOLERANCE = 1e-9
"""Greatest difference of axes, offsets and rotations within one robot."""


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
    """

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    friction: Array
    wrench: Array


@dataclass(frozen=True, eq=False)
class Recording:
    """M samples of encoders, motor torques and the plate, at a constant rate.

    Attributes:
        names: Joint names; the order of all joint columns.
        time: (M,) [s].
        position: Encoders, (M, n) [rad or m].
        torque: Motor torques as the drives report them, (M, n) [N m or N].
        wrench: The plate, (M, 6) [N, N m]; contains `tare`.
        velocity: Where the instrument senses it, (M, n) [rad/s or m/s].
        acceleration: Where the instrument senses it, (M, n) [rad/s^2 or m/s^2].
        tare: Known static wrench of the pedestal that stands on the plate, (6,) [N, N m];
            None if the recording does not say: the model's pedestal is then assumed.
        truth: What really happened, where a simulation made the recording.
        facts: What is known about the run: robot, model hash, seed, versions.
    """

    names: tuple[str, ...]
    time: Array
    position: Array
    torque: Array
    wrench: Array
    velocity: Array | None = None
    acceleration: Array | None = None
    tare: Array | None = None
    truth: Truth | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        samples, n = len(self.time), len(self.names)
        shapes = {"time": (samples,), "wrench": (samples, 6), "tare": (6,)}
        for name in ("time", "position", "torque", "wrench", "velocity", "acceleration", "tare"):
            value = getattr(self, name)
            if value is not None:
                value = readonly(value, shapes.get(name, (samples, n)), name)
                object.__setattr__(self, name, value)

    @property
    def samples(self) -> int:
        """Number M of samples."""
        return len(self.time)

    @property
    def senses_kinematics(self) -> bool:
        """Whether velocities and accelerations were sensed, both."""
        return self.velocity is not None and self.acceleration is not None

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""
        return (self.samples - 1) / float(self.time[-1] - self.time[0])

    def part(self, first: int, last: int) -> Recording:
        """What was measured in samples `first` to `last` - 1; nothing is copied."""

        def cut(columns: Array | None) -> Array | None:
            return None if columns is None else columns[first:last]

        return replace(
            self,
            time=self.time[first:last],
            position=self.position[first:last],
            torque=self.torque[first:last],
            wrench=self.wrench[first:last],
            velocity=cut(self.velocity),
            acceleration=cut(self.acceleration),
            truth=None,
        )

    def blind(self) -> Recording:
        """The same recording without the truth: what an estimator is given."""
        return replace(self, truth=None)

    def ordered(self, tree: Tree) -> Recording:
        """Joint columns by name in the order of `tree.names`.

        Raises:
            RecordingError: The recording is of another robot.
        """
        check_robot(self, tree)
        order = [self.names.index(name) for name in tree.names]

        def pick(columns: Array | None) -> Array | None:
            return None if columns is None else columns[:, order]

        return replace(
            self,
            names=tree.names,
            position=self.position[:, order],
            torque=self.torque[:, order],
            velocity=pick(self.velocity),
            acceleration=pick(self.acceleration),
        )

    def save(self, path: str | Path) -> None:
        """Write to a Parquet file, whole or not at all.

        Raises:
            RecordingError: Something that is no Parquet file is there.
        """
        from testbed.recordings.formats.parquet import is_parquet, write

        if Path(path).is_file() and not is_parquet(Path(path)):
            raise RecordingError(f"'{path}' is there and is no recording; choose another name")
        with replacing(Path(path)) as fresh:
            write(self, fresh)

    @staticmethod
    def load(path: str | Path) -> Recording:
        """Read a Parquet file written by `save`, or one with the same columns.

        Raises:
            RecordingError: The file is missing, damaged or incomplete, or holds values
                that are not numbers, or its sampling is not uniform.
        """
        from testbed.recordings.formats.parquet import read

        recording = read(Path(path))
        check(recording, str(path))
        return recording


def geometry(tree: Tree) -> dict[str, Any]:
    """What a recording keeps of its robot: joints by name, with kind, axis and place."""
    parents = ["bedplate" if p < 0 else tree.names[p] for p in tree.parents]
    return {
        joint.name: {
            "kind": joint.kind,
            "parent": parent,
            "axis": joint.axis.tolist(),
            "offset": joint.offset.tolist(),
            "rotation": joint.rotation.tolist(),
        }
        for joint, parent in zip(tree.joints, parents, strict=True)
    }


class About(Protocol):
    """What says of which robot a recording is."""

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names."""

    @property
    def facts(self) -> Mapping[str, Any]:
        """What is known about the run."""


def check_robot(recording: About, tree: Tree) -> None:
    """Whether the recording is of this robot: joints by name, and their geometry if known.

    Raises:
        RecordingError: It is not.
    """
    if sorted(recording.names) != sorted(tree.names):
        raise RecordingError(
            f"the recording is of another robot: it has the joints {', '.join(recording.names)}, "
            f"the model has {', '.join(tree.names)}"
        )
    known: Mapping[str, Any] = recording.facts.get("geometry", {})
    for name, here in geometry(tree).items():
        for what, value in here.items():
            there = known.get(name, {}).get(what, value)
            same = (
                there == value
                if isinstance(value, str)
                else np.shape(there) == np.shape(value)
                and np.abs(np.subtract(there, value)).max() <= GEOMETRY_TOLERANCE
            )
            if not same:
                raise RecordingError(
                    f"the recording is of another robot: its joint '{name}' has {what} "
                    f"{json.dumps(there)}, the model has {json.dumps(value)}"
                )


def alike(parts: Iterable[Recording]) -> Iterator[Recording]:
    """The parts of one recording, as long as they belong together.

    Raises:
        RecordingError: There are none, or their channels differ.
    """
    layout: tuple[object, ...] = ()
    for part in parts:
        here = (part.names, *(getattr(part, name) is None for name in (*GROUPS, "truth")))
        if layout and here != layout:
            raise RecordingError("the parts of the recording have different channels")
        layout = here
        yield part
    if not layout:
        raise RecordingError("the recording has no parts")


def check(recording: Recording, source: str) -> None:
    """Whether every value is a measurement and the sampling is uniform.

    Raises:
        RecordingError: Names the first bad channel, sample and time.
    """
    if recording.samples < 2:
        raise RecordingError(f"{source}: {recording.samples} samples are no recording")
    check_values(recording, source)
    check_times(recording, source, float(np.median(np.diff(recording.time))))


def check_values(part: Recording, source: str, first: int = 0) -> None:
    """Whether every value of a part of a recording is a measurement.

    Args:
        part: Consecutive samples.
        source: What the recording is called.
        first: Number of the part's first sample.

    Raises:
        RecordingError: Names the first bad channel, sample and time.
    """
    for group in GROUPS:
        values = getattr(part, group)
        # one pass: a sum of squares that is small holds nothing large, and only numbers
        if values is not None and not np.vdot(values, values) < LARGEST**2:
            _refuse_values(part, source, first)


def check_times(part: Recording, source: str, typical: float, first: int = 0) -> None:
    """Whether the sampling of a part of a recording is uniform.

    Args:
        part: Consecutive samples.
        source: What the recording is called.
        typical: Its sampling time [s].
        first: Number of the part's first sample.

    Raises:
        RecordingError: Names the first bad sample.
    """
    steps = np.diff(part.time)
    if steps.size == 0:
        return
    least, most = steps.min(), steps.max()
    if not least > 0:  # what is no number is not
        k = int(np.argmin(steps)) + first
        raise RecordingError(f"{source}: time does not increase after sample {k}")
    if max(most - typical, typical - least) > 0.01 * typical:
        worst = int(np.argmax(np.abs(steps - typical)))
        raise RecordingError(
            f"{source}: sampling is not uniform: {steps[worst]:.6g} s after sample "
            f"{worst + first}, {typical:.6g} s elsewhere; resample the recording to a constant rate"
        )


def _refuse_values(part: Recording, source: str, first: int) -> None:
    for label, values in channels(part).items():
        bad = np.flatnonzero(~(np.abs(values) < LARGEST))
        if bad.size:
            k = bad[0]
            raise RecordingError(
                f"{source}: channel '{label}' is {values[k]} at sample {k + first} "
                f"(t = {part.time[k]:.6g} s), one of {bad.size} such among samples {first} to "
                f"{first + part.samples - 1}; cut them out or repair the recording"
            )


def channels(recording: Recording) -> dict[str, Array]:
    """Measured channels by column name, (M,) each."""
    columns: dict[str, Array] = {"time": recording.time}
    for group in ("position", "velocity", "acceleration", "torque"):
        values = getattr(recording, group)
        if values is not None:
            columns |= {f"{group}/{n}": values[:, k] for k, n in enumerate(recording.names)}
    return columns | {f"wrench/{axis}": recording.wrench[:, k] for k, axis in enumerate(AXES)}
