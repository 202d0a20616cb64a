"""Columns of a recording: names, units, segments and checks of values.

Columns   time, position/JOINT, velocity/JOINT, acceleration/JOINT, torque/JOINT,
          temperature/JOINT, wrench/Fx ... wrench/Mz, sensors/NAME/Fx ... sensors/NAME/Mz,
          base/x ... base/qz; in simulated recordings truth/..., not used by estimators
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, count_with_noun

WRENCH_COMPONENTS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
"""Names of the components of a wrench, which are the channels of the plate."""

WRENCH_UNITS = ("N", "N", "N", "N m", "N m", "N m")
"""Units of the components of a wrench."""

JOINT_SIGNALS = ("position", "velocity", "acceleration", "torque", "temperature")
"""Signals measured joint by joint."""

RECORDED_SIGNALS = ("time", *JOINT_SIGNALS, "wrench", "sensors", "base")
"""All signals that can be measured."""

TRUE_JOINT_SIGNALS = ("position", "velocity", "acceleration", "torque", "friction")
"""True signals of a simulation, joint by joint."""

TRUE_SIGNALS = (*TRUE_JOINT_SIGNALS, "wrench", "sensors")
"""All true signals of a simulation."""

UNITS = {
    "revolute": {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}
    | dict.fromkeys(("torque", "friction"), "N m")
    | {"temperature": "degC"},
    "prismatic": {"position": "m", "velocity": "m/s", "acceleration": "m/s^2"}
    | dict.fromkeys(("torque", "friction"), "N")
    | {"temperature": "degC"},
}
"""Units of joint signals, keyed by joint type and signal."""


def unit_of(column: str, kinds: Mapping[str, str]) -> str:
    """Unit of a column.

    Args:
        column: Name of the column.
        kinds: Joint types keyed by joint name; other joints are assumed to be revolute.
    """
    if column == "time":
        return "s"
    signal, _, member = column.removeprefix("truth/").partition("/")
    if signal in ("wrench", "sensors"):
        return "N" if member.rpartition("/")[2].startswith("F") else "N m"
    if signal == "base":
        return "1" if member.startswith("q") else "m"
    return UNITS[kinds.get(member, "revolute")][signal]


def signal_of(column: str) -> str:
    """Signal of a column.

    For example, the signal of truth/position/elbow is truth/position, the signal of position/elbow
    is position, and the signal of time is time.
    """
    parts = column.split("/")
    return "/".join(parts[:2]) if parts[0] == "truth" else parts[0]


def column_members(
    signal: str, joints: tuple[str, ...], sensors: tuple[str, ...] = ()
) -> tuple[str, ...]:
    """Suffixes of a signal's column names: components of wrenches or poses, or joint names.

    Args:
        signal: Name from `RECORDED_SIGNALS`, or from `TRUE_SIGNALS` with or without "truth/".
        joints: Joint names.
        sensors: Names of force sensors.
    """
    sensor_channels = tuple(
        f"{name}/{axis}" for name in sensors for axis in WRENCH_COMPONENTS
    )
    # position [m] and quaternion on the ground
    pose = (
        "x",
        "y",
        "z",
        "qw",
        "qx",
        "qy",
        "qz",
    )
    members = {"wrench": WRENCH_COMPONENTS, "sensors": sensor_channels, "base": pose}
    return members.get(signal.removeprefix("truth/"), joints)


def joint_names_of_columns(columns: Sequence[str]) -> tuple[str, ...]:
    """Joint names from the column names of positions."""
    return tuple(c.split("/", 1)[1] for c in columns if c.startswith("position/"))


def sensor_names_of_columns(columns: Sequence[str]) -> tuple[str, ...]:
    """Names of the robot's force sensors from the column names of their wrenches."""
    names = (
        c.split("/", 1)[1].rpartition("/")[0]
        for c in columns
        if c.startswith("sensors/")
    )
    return tuple(dict.fromkeys(names))


MIN_MOTION_RANGE = 1e-3
"""Smallest range of positions of a moving joint [rad or m]."""

MAX_VALUE = 1e12
"""Upper bound on the magnitude of measured values, in any SI unit."""


def check_samples(count: int, source: str) -> None:
    """Check that a recording has at least two samples.

    Args:
        count: Number of samples.
        source: Name of the recording, for error messages.

    Raises:
        RecordingError: There are fewer than two samples.
    """
    if count < 2:
        raise RecordingError(
            f"{source}: {count_with_noun(count, 'sample')}, which is no recording"
        )


Segments = tuple[tuple[int, int], ...]
"""Blocks without gaps: index of the first sample, and index after the last sample."""


def segments_of(time: Array, gaps: Sequence[float]) -> Segments:
    """Segments of a recording between its gaps, as index ranges.

    Args:
        time: Times of the samples, (M,) [s].
        gaps: Times of the first samples after gaps [s]; times outside the recording are ignored.
    """
    edges = sorted({0, *np.searchsorted(time, gaps).tolist(), len(time)})
    return tuple(pairwise(edges)) or ((0, 0),)


def check_columns(
    columns: Mapping[str, Array], source: str, segments: Segments
) -> None:
    """Check that all values are valid and sampling is uniform within the segments.

    Args:
        columns: All measured columns, (M,) each, including `time`.
        source: Name of the recording, for error messages.
        segments: Segments between the gaps.

    Raises:
        RecordingError: A value or time is invalid; the message names the first invalid one.
    """
    time = columns["time"]
    check_samples(len(time), source)
    check_values(columns, source)
    typical = float(np.median(np.diff(time)))
    for first, last in segments:
        check_times(time[first:last], source, typical, first)


def check_values(columns: Mapping[str, Array], source: str, first: int = 0) -> None:
    """Check that all values of a part of a recording are finite and below `MAX_VALUE`.

    Args:
        columns: Columns of consecutive samples, (M,) each, including `time`.
        source: Name of the recording, for error messages.
        first: Index of the part's first sample.

    Raises:
        RecordingError: A value is invalid; the message names channel, sample and time.
    """
    time = columns["time"]
    for label, values in columns.items():
        bad = np.flatnonzero(~(np.abs(values) < MAX_VALUE))
        if bad.size:
            k = bad[0]
            raise RecordingError(
                f"{source}: channel '{label}' is {values[k]:g} at sample {k + first} "
                f"(t = {time[k]:.6g} s), one of {bad.size} such among samples {first} to "
                f"{first + len(time) - 1}; cut them out or repair the recording"
            )


def check_times(time: Array, source: str, typical: float, first: int = 0) -> None:
    """Check that the sampling of a part of a recording is uniform to within 1 %.

    Args:
        time: Times of consecutive samples, (M,) [s]; fewer than two are not checked.
        source: Name of the recording, for error messages.
        typical: Sampling time of the recording [s].
        first: Index of the part's first sample.

    Raises:
        RecordingError: The times do not increase, or a sampling time differs from `typical` by more
            than 1 %; the message names the sample.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(time)
    if steps.size == 0:
        return
    least, most = steps.min(), steps.max()
    if not least > 0:  # also for NaN
        k = int(np.argmin(steps)) + first
        raise RecordingError(f"{source}: time does not increase after sample {k}")
    check_sampling_time(typical, source)
    # largest relative deviation of a sampling time from the typical sampling time
    if max(most - typical, typical - least) > 0.01 * typical:
        worst = int(np.argmax(np.abs(steps - typical)))
        raise RecordingError(
            f"{source}: sampling is not uniform: {steps[worst]:.6g} s after sample "
            f"{worst + first}, {typical:.6g} s elsewhere; resample the recording to a constant rate"
        )


def check_sampling_time(step: float, source: str) -> None:
    """Check that a sampling time is between 1e-9 and 1e6 s.

    Args:
        step: Sampling time [s].
        source: Name of the recording, for error messages.

    Raises:
        RecordingError: The sampling time is out of range.
    """
    if not 1e-9 <= step <= 1e6:
        raise RecordingError(
            f"{source}: {step:.3g} s from sample to sample is no sampling time; time is in seconds"
        )
