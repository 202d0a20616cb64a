"""The columns of a recording: their names, their units, and what is known beside them.

Columns   time, position/JOINT, velocity/JOINT, acceleration/JOINT, torque/JOINT,
          temperature/JOINT, wrench/Fx ... wrench/Mz, sensors/NAME/Fx ... sensors/NAME/Mz,
          base/x ... base/qz; in simulated recordings truth/..., which no estimator reads
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import of_recording
from testbed.core.base.errors import RecordingError, plural

AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
"""The plate's channels."""

PLATE_UNITS = ("N", "N", "N", "N m", "N m", "N m")
"""Theirs."""

JOINT_SIGNALS = ("position", "velocity", "acceleration", "torque", "temperature")
"""What is measured joint by joint."""

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Of a base that moves: position [m] and quaternion of its frame on the ground."""

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


def axis_unit(axis: str) -> str:
    """Of one of the plate's channels: N or N m."""
    return "N" if axis.startswith("F") else "N m"


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
        return axis_unit(member.rpartition("/")[2])
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
    own = {"wrench": AXES, "sensors": of_sensors, "base": POSE}
    return own.get(signal.removeprefix("truth/"), joints)


def joints_in(columns: Sequence[str]) -> tuple[str, ...]:
    """Joint names: those that have a position."""
    return tuple(c.split("/", 1)[1] for c in columns if c.startswith("position/"))


def sensors_in(columns: Sequence[str]) -> tuple[str, ...]:
    """Names of force sensors besides the plate."""
    own = (c.split("/", 1)[1].rpartition("/")[0] for c in columns if c.startswith("sensors/"))
    return tuple(dict.fromkeys(own))


LARGEST = 1e12
"""What no instrument measures, in any SI unit."""

UNIFORM = 0.01
"""Greatest deviation of a sampling time from the others, relative."""

COUNTED = "counted"
"""Fact of a recording: from when to when its samples are for an estimate [s]."""

EARLIEST, LATEST = 1e-9, 1e6
"""Sampling times that are no mistake [s]."""


def check_samples(count: int, source: str) -> None:
    """Refuse a recording of fewer than two samples.

    Args:
        count: Of its samples.
        source: Its name, for errors.

    Raises:
        RecordingError: It has fewer.
    """
    if count < 2:
        raise RecordingError(f"{source}: {plural(count, 'sample')}, which is no recording")


def check_columns(columns: Mapping[str, Array], source: str) -> None:
    """Whether every value is a measurement and the sampling is uniform.

    Args:
        columns: All measured columns, (M,) each, `time` among them.
        source: What the recording is called.

    Raises:
        RecordingError: Names the first bad channel, sample and time.
    """
    time = columns["time"]
    check_samples(len(time), source)
    check_values(columns, source)
    check_times(time, source, float(np.median(np.diff(time))))


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
    if max(most - typical, typical - least) > UNIFORM * typical:
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
    if not EARLIEST <= step <= LATEST:
        raise RecordingError(
            f"{source}: {step:.3g} s from sample to sample is no sampling time; time is in seconds"
        )


def checked_metadata(found: Any) -> tuple[tuple[float, ...] | None, dict[str, Any]]:
    """What a file says of its recording: the tare, if any, and facts.

    Args:
        found: As it was read; facts of other names than those known here are kept as they are.

    Returns:
        Six numbers [N, N m], bedplate axes, or None; and the facts.

    Raises:
        ValueError: Something is not what it should be; says what.
    """
    if not isinstance(found, Mapping):
        raise ValueError("its metadata are not a table")
    tare, facts = found.get("tare"), found.get("facts")
    facts = {} if facts is None else facts
    if not isinstance(facts, dict):
        raise ValueError("its 'facts' are not a table")
    if facts.get("gravity") is not None:
        _numbers(facts["gravity"], (3,), "'gravity'")
    if facts.get(COUNTED) is not None:
        _numbers(facts[COUNTED], (2,), f"'{COUNTED}'")
    of_recording(facts)
    sensors = facts.get("sensors", {})
    if not isinstance(sensors, dict) or not all(isinstance(s, dict) for s in sensors.values()):
        raise ValueError("its 'sensors' are not a table by sensor")
    geometry = facts.get("geometry", {})
    if not isinstance(geometry, dict):
        raise ValueError("its 'geometry' is not a table by joint")
    for name, joint in geometry.items():
        _check_joint(name, joint)
    return None if tare is None else _numbers(tare, (6,), "'tare'"), facts


def _check_joint(name: str, joint: Any) -> None:
    """Whether a joint's geometry, as far as it is given, is one."""
    if not isinstance(joint, dict):
        raise ValueError("its 'geometry' is not a table by joint")
    label = f"the geometry of joint '{name}': "
    if joint.get("kind", "revolute") not in ("revolute", "prismatic"):
        raise ValueError(f"{label}kind is revolute or prismatic")
    if not isinstance(joint.get("parent", ""), str):
        raise ValueError(f"{label}parent is no name")
    for what, shape in (("axis", (3,)), ("offset", (3,)), ("rotation", (3, 3))):
        if what in joint:
            _numbers(joint[what], shape, f"{label}{what}")


def _numbers(value: Any, shape: tuple[int, ...], label: str) -> tuple[float, ...]:
    """A list, or list of lists, of finite numbers, as one list.

    Raises:
        ValueError: It is something else.
    """
    size, *rest = shape
    wanted = " x ".join(map(str, shape))
    if not isinstance(value, list) or len(value) != size:
        raise ValueError(f"its {label} is not {wanted} numbers")
    if rest:
        return tuple(x for line in value for x in _numbers(line, tuple(rest), label))
    for number in value:
        known = isinstance(number, int | float) and not isinstance(number, bool)
        if not known or not -LARGEST < number < LARGEST or math.isnan(number):
            raise ValueError(f"its {label} is not {wanted} numbers")
    return tuple(float(number) for number in value)
