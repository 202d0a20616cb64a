"""The columns of a recording: their names, their units, and what is known beside them.

Columns   time, position/JOINT, velocity/JOINT, acceleration/JOINT, torque/JOINT,
          temperature/JOINT, wrench/Fx ... wrench/Mz, sensors/NAME/Fx ... sensors/NAME/Mz,
          base/x ... base/qz; in simulated recordings truth/..., which no estimator reads
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, plural

AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
"""The plate's channels."""

PLATE_UNITS = ("N", "N", "N", "N m", "N m", "N m")
"""Theirs."""

JOINT_SIGNALS = ("position", "velocity", "acceleration", "torque", "temperature")
"""What is measured joint by joint."""

SIGNALS = ("time", *JOINT_SIGNALS, "wrench", "sensors", "base")
"""What is measured."""

TRUE_JOINT_SIGNALS = ("position", "velocity", "acceleration", "torque", "friction")

TRUE_SIGNALS = (*TRUE_JOINT_SIGNALS, "wrench", "sensors")
"""What a simulation knows besides."""

UNITS = {
    "revolute": {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2"}
    | dict.fromkeys(("torque", "friction"), "N m")
    | {"temperature": "degC"},
    "prismatic": {"position": "m", "velocity": "m/s", "acceleration": "m/s^2"}
    | dict.fromkeys(("torque", "friction"), "N")
    | {"temperature": "degC"},
}
"""Of what is measured at a joint, by the joint's kind."""


def unit_of(column: str, kinds: Mapping[str, str]) -> str:
    """Unit of a column.

    Args:
        column: Its name.
        kinds: Of the joints, by name; a joint that is not there is taken as revolute.
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
    """truth/position/elbow -> truth/position; position/elbow -> position; time -> time."""
    parts = column.split("/")
    return "/".join(parts[:2]) if parts[0] == "truth" else parts[0]


def members_of(
    signal: str, joints: tuple[str, ...], sensors: tuple[str, ...] = ()
) -> tuple[str, ...]:
    """What a signal's columns are of: the plate's channels, sensors', a pose's numbers, or joints.

    Args:
        signal: Of `SIGNALS`, those of the truth too.
        joints: Their names.
        sensors: Names of force sensors.
    """
    of_sensors = tuple(f"{name}/{axis}" for name in sensors for axis in AXES)
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
    own = {"wrench": AXES, "sensors": of_sensors, "base": pose}
    return own.get(signal.removeprefix("truth/"), joints)


def joints_in(columns: Sequence[str]) -> tuple[str, ...]:
    """Joint names: those that have a position."""
    return tuple(c.split("/", 1)[1] for c in columns if c.startswith("position/"))


def sensors_in(columns: Sequence[str]) -> tuple[str, ...]:
    """Names of force sensors besides the plate."""
    own = (
        c.split("/", 1)[1].rpartition("/")[0]
        for c in columns
        if c.startswith("sensors/")
    )
    return tuple(dict.fromkeys(own))


STILL = 1e-3
"""Motion below which a joint rests [rad or m]."""

LARGEST = 1e12
"""What no instrument measures, in any SI unit."""


def check_samples(count: int, source: str) -> None:
    """Refuse a recording of fewer than two samples.

    Args:
        count: Of its samples.
        source: Its name, for errors.

    Raises:
        RecordingError: It has fewer.
    """
    if count < 2:
        raise RecordingError(
            f"{source}: {plural(count, 'sample')}, which is no recording"
        )


Segments = tuple[tuple[int, int], ...]
"""Blocks without a gap: the first sample of each, and the one after its last."""


def segments_of(time: Array, gaps: Sequence[float]) -> Segments:
    """Segments of a recording.

    Args:
        time: Of its samples, (M,) [s].
        gaps: Times of the first samples after gaps [s]; others than its own change nothing.
    """
    edges = sorted({0, *np.searchsorted(time, gaps).tolist(), len(time)})
    return tuple(pairwise(edges)) or ((0, 0),)


def check_columns(
    columns: Mapping[str, Array], source: str, segments: Segments
) -> None:
    """Whether every value is a measurement and the sampling is uniform but for gaps.

    Args:
        columns: All measured columns, (M,) each, `time` among them.
        source: What the recording is called.
        segments: Between the gaps.

    Raises:
        RecordingError: Names the first bad channel, sample and time.
    """
    time = columns["time"]
    check_samples(len(time), source)
    check_values(columns, source)
    typical = float(np.median(np.diff(time)))
    for first, last in segments:
        check_times(time[first:last], source, typical, first)


def check_values(columns: Mapping[str, Array], source: str, first: int = 0) -> None:
    """Whether every value of a part of a recording is a measurement.

    Args:
        columns: Of consecutive samples, (M,) each, `time` among them.
        source: What the recording is called.
        first: Number of the part's first sample.

    Raises:
        RecordingError: Names the first bad channel, sample and time.
    """
    time = columns["time"]
    for label, values in columns.items():
        bad = np.flatnonzero(~(np.abs(values) < LARGEST))
        if bad.size:
            k = bad[0]
            raise RecordingError(
                f"{source}: channel '{label}' is {values[k]:g} at sample {k + first} "
                f"(t = {time[k]:.6g} s), one of {bad.size} such among samples {first} to "
                f"{first + len(time) - 1}; cut them out or repair the recording"
            )


def check_times(time: Array, source: str, typical: float, first: int = 0) -> None:
    """Whether the sampling of a part of a recording is uniform.

    Args:
        time: Of consecutive samples, (M,) [s].
        source: What the recording is called.
        typical: Its sampling time [s].
        first: Number of the part's first sample.

    Raises:
        RecordingError: Names the first bad sample.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(time)
    if steps.size == 0:
        return
    least, most = steps.min(), steps.max()
    if not least > 0:  # what is no number is not
        k = int(np.argmin(steps)) + first
        raise RecordingError(f"{source}: time does not increase after sample {k}")
    check_sampling_time(typical, source)
    # greatest deviation of a sampling time from the others, relative
    if max(most - typical, typical - least) > 0.01 * typical:
        worst = int(np.argmax(np.abs(steps - typical)))
        raise RecordingError(
            f"{source}: sampling is not uniform: {steps[worst]:.6g} s after sample "
            f"{worst + first}, {typical:.6g} s elsewhere; resample the recording to a constant rate"
        )


def check_sampling_time(step: float, source: str) -> None:
    """Whether a sampling time is one.

    Args:
        step: From sample to sample [s].
        source: What the recording is called.

    Raises:
        RecordingError: It is not.
    """
    if not 1e-9 <= step <= 1e6:
        raise RecordingError(
            f"{source}: {step:.3g} s from sample to sample is no sampling time; time is in seconds"
        )
