"""Foreign columns as signals: at the joints, of the bedplate, of a base, by what a mapping says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.base.transform import Transform
from testbed.core.robot.free_base import UNIT
from testbed.core.robot.rotations import from_rpy
from testbed.importing.foreign_table import (
    RAW,
    UNITS,
    ForeignTable,
    factor,
    plain,
    slides,
)
from testbed.importing.mapping import (
    AnyTable,
    BaseTable,
    GearTable,
    Mapping,
    SignalTable,
    SixAxisTable,
)


def joint_signal(
    kind: str, table: SignalTable, gear: GearTable | None, columns: Array
) -> Array:
    """A signal at the joints in SI units, (M, n).

    Args:
        kind: What is measured.
        table: What the mapping says of it.
        gear: Between motors and joints, if there is one.
        columns: As the file holds them, (M, k).
    """
    scale = np.array([factor(kind, unit) for unit in table.units])
    for given in (table.gain, table.sign):
        if given is not None:
            scale = scale * np.asarray(given, dtype=np.float64)
    found: Array = np.asarray(columns * scale, dtype=np.float64)
    if table.matrix is not None:
        found = found @ np.array(table.matrix, dtype=np.float64).T
    if gear is not None and table.side == "motor":
        motor = gear.motor_of_joint
        found = (
            found @ motor
            if kind == "torque"
            else np.asarray(np.linalg.solve(motor, found.T).T)
        )
    return (
        found
        if table.offset is None
        else found + np.array(table.offset, dtype=np.float64)
    )


SIGN_BITS = (1 << 10, 1 << 11, 1 << 15)
"""Of servos' loads and currents: from this value on what is above it counts the other way."""


def without_sign_bit(values: Array, bit: int) -> Array:
    """Signed numbers of unsigned numbers with a sign bit.

    Args:
        values: Whole, not negative.
        bit: One of `SIGN_BITS`.
    """
    return np.where(values >= bit, bit - values, values)


def sign_bit_of(values: Array) -> int:
    """Sign bit of whole numbers, by the continuity of the signal; 0 for none.

    Args:
        values: Of all columns of a signal, (M, k).
    """
    large = float(values.max())
    bit = next((each for each in SIGN_BITS if each <= large < 2 * each), 0)
    if not bit or values.min() < 0 or (values != np.round(values)).any():
        return 0
    raw, signed = (
        np.square(np.diff(each, axis=0)).sum()
        for each in (values, without_sign_bit(values, bit))
    )
    return bit if 2 * signed < raw else 0


def signed(table: SignalTable, values: Array) -> Array:
    """Torques as signed counts, (M, k).

    Args:
        table: What the mapping says of them.
        values: As the file holds them, (M, k).

    Raises:
        RecordingError: They seem to have one, and the mapping does not say.
    """
    found = sign_bit_of(values) if table.sign_bit is None else 0
    if found:
        raise RecordingError(
            f"torque: values of {found} and more are a sign bit and a size, as of servos' loads "
            f"({(values >= found).mean():.0%} of all): say [torque] sign_bit = {found}, or 0 if not"
        )
    return without_sign_bit(values, table.sign_bit) if table.sign_bit else values


def wrench_of(table: SixAxisTable, columns: Array) -> Array:
    """The wrench on the robot, or on the links beyond a sensor, (M, 6) [N, N m].

    In the bedplate's frame, about its origin, or in that of the first link beyond the sensor.

    Args:
        table: What the mapping says of it.
        columns: As the file holds them, (M, k).
    """
    if table.matrix is not None:
        columns = columns @ np.array(table.matrix, dtype=np.float64).T
    sense = 1.0 if table.sense == "on_robot" else -1.0
    force = sense * factor("force", table.units[0]) * columns[:, :3]
    moment = sense * factor("moment", table.units[1]) * columns[:, 3:]
    wrench = np.hstack([force, moment])
    if table.place is None:
        return wrench
    return Transform(from_rpy(table.place.rpy), np.array(table.place.xyz)).wrench(
        wrench
    )


def without_turnovers(quaternions: Array) -> Array:
    """The same turns without jumps of sign: q and -q are one, (M, 4).

    Args:
        quaternions: Sample by sample, (M, 4).
    """
    along = np.einsum("mi,mi->m", quaternions[1:], quaternions[:-1])
    signs = np.cumprod(np.where(along < 0, -1.0, 1.0))
    return np.vstack([quaternions[:1], quaternions[1:] * signs[:, None]])


def base_pose(table: BaseTable, columns: Array) -> Array:
    """A base's position and quaternion, (M, 7) [m].

    Args:
        table: What the mapping says of it.
        columns: As the file holds them, (M, 7).

    Raises:
        RecordingError: A quaternion is none.
    """
    turn = columns[:, 3:]
    size = np.linalg.norm(turn, axis=1, keepdims=True)
    if not (np.abs(size - 1) <= UNIT).all():
        raise RecordingError(
            f"base.quaternion: its length is {float(size.min()):.3g} to {float(size.max()):.3g}, "
            "that of a quaternion is one: are the columns w, x, y, z?"
        )
    return np.hstack([factor("position", table.unit) * columns[:, :3], turn / size])


def joint_kinds(table: SignalTable, joints: Sequence[str]) -> dict[str, dict[str, str]]:
    """Whether each joint turns or slides, by the positions' units, as recordings keep it.

    Joints of columns that a matrix mixes, in units of both kinds, are left open.

    Args:
        table: Of positions.
        joints: Their names.
    """
    sliding = [slides(unit) for unit in table.units]
    if table.matrix is not None:
        if len(set(sliding)) > 1:
            return {}
        sliding = sliding[:1] * len(joints)
    return {
        name: {"kind": "prismatic" if slide else "revolute"}
        for name, slide in zip(joints, sliding, strict=True)
    }


EFFORTS = {"pwm": "pwm", "A": "current", "mA": "current"}
"""What a torque is made of, by its unit."""


def effort_kinds(mapping: Mapping) -> dict[str, str]:
    """What each joint's torque is made of: current, pwm or motor, which move rotors, or torque.

    Args:
        mapping: Of which columns that a matrix mixes are taken for the first.
    """
    if (table := mapping.torque) is None:
        return {}
    units = (
        table.units if table.matrix is None else table.units[:1] * len(mapping.joints)
    )
    other = "motor" if table.side == "motor" else "torque"
    return {
        j: EFFORTS.get(plain(u), other)
        for j, u in zip(mapping.joints, units, strict=True)
    }


def check_units(label: str, table: AnyTable, file: ForeignTable) -> None:
    """Compare the units that a file states with those of a mapping.

    Args:
        label: Of the mapping's table.
        table: What the mapping says.
        file: Where its columns are.

    Raises:
        RecordingError: They differ.
    """
    if isinstance(table, BaseTable):
        kinds, units = ["position"] * 3, [table.unit] * 3
    elif isinstance(table, SignalTable):
        units = table.units if table.gain is None else []
        kinds = [label] * len(units)
    else:
        units = np.repeat(table.units, 3).tolist() if table.matrix is None else []
        kinds = ["force"] * 3 + ["moment"] * 3
    for kind, column, unit in zip(kinds, table.columns, units, strict=False):
        said = plain(file.unit(column) or "")
        if (
            said in {*UNITS[kind], *RAW}
            and said != plain(unit)
            and plain(unit) in UNITS[kind]
        ):
            how = {
                "torque": "; say its `gain`",
                "force": "; say the plate's gains, `matrix`",
            }
            raise RecordingError(
                f"{label}: the file says that '{column}' is in {said}, the mapping says {unit}"
                + how.get(kind, "") * (said in RAW)
            )
