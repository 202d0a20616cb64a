"""Conversion of foreign columns to signals of joints, plate, force sensors and base."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.base.transform import Transform
from testbed.core.robot.free_base import QUATERNION_NORM_TOLERANCE
from testbed.core.robot.rotations import rpy_to_matrix
from testbed.importing.foreign_table import (
    RAW_UNITS,
    UNITS_BY_QUANTITY,
    ForeignTable,
    canonical_unit,
    is_length_unit,
    unit_size,
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
    """Signal at the joints in SI units, (M, n): `G A (gain sign unit x) + offset`.

    A is the mapping's matrix. G converts a signal measured on the motor side to the joint side: it
    is the transposed gear matrix for torques, and the inverse gear matrix for other signals.

    Args:
        kind: Quantity, for example "position" or "torque".
        table: Table of the signal in the mapping.
        gear: Gear between motors and joints; None if there is no gear.
        columns: Values x in the units of the file, (M, k).
    """
    scale = np.array([unit_size(kind, unit) for unit in table.units])
    for factors in (table.gain, table.sign):
        if factors is not None:
            scale = scale * np.asarray(factors, dtype=np.float64)
    signal: Array = np.asarray(columns * scale, dtype=np.float64)
    if table.matrix is not None:
        signal = signal @ np.array(table.matrix, dtype=np.float64).T
    if gear is not None and table.side == "motor":
        motor_of_joint = gear.motor_of_joint
        signal = (
            signal @ motor_of_joint
            if kind == "torque"
            else np.asarray(np.linalg.solve(motor_of_joint, signal.T).T)
        )
    return (
        signal
        if table.offset is None
        else signal + np.array(table.offset, dtype=np.float64)
    )


SIGN_BITS = (1 << 10, 1 << 11, 1 << 15)
"""Sign bits of servos' loads and currents, as values."""


def without_sign_bit(values: Array, bit: int) -> Array:
    """Signed values of integers in sign-magnitude form.

    Args:
        values: Non-negative integers.
        bit: Value of the sign bit, an element of `SIGN_BITS`.
    """
    return np.where(values >= bit, bit - values, values)


def detected_sign_bit(values: Array) -> int:
    """Sign bit of integers, detected from the continuity of the signal; 0 if not detected.

    The highest bit is taken as the sign bit if it is in `SIGN_BITS` and this interpretation more
    than halves the sum of the squared differences between successive samples.

    Args:
        values: All columns of a signal, (M, k).
    """
    largest = float(values.max())
    bit = next((each for each in SIGN_BITS if each <= largest < 2 * each), 0)
    if not bit or values.min() < 0 or (values != np.round(values)).any():
        return 0
    raw, signed = (
        np.square(np.diff(each, axis=0)).sum()
        for each in (values, without_sign_bit(values, bit))
    )
    return bit if 2 * signed < raw else 0


def torques_with_sign(table: SignalTable, values: Array) -> Array:
    """Torques in units of the file, signed according to the mapping's sign bit, (M, k).

    Args:
        table: Table of the torques in the mapping.
        values: Values as in the file, (M, k).

    Raises:
        RecordingError: `detected_sign_bit` finds a sign bit, and the mapping has no `sign_bit`.
    """
    bit = detected_sign_bit(values) if table.sign_bit is None else 0
    if bit:
        raise RecordingError(
            f"torque: values of {bit} and more are a sign bit and a size, as of servos' loads "
            f"({(values >= bit).mean():.0%} of all): say [torque] sign_bit = {bit}, or 0 if not"
        )
    return without_sign_bit(values, table.sign_bit) if table.sign_bit else values


def wrench_from_columns(table: SixAxisTable, columns: Array) -> Array:
    """Wrench on the robot, or on the links beyond a force sensor, (M, 6) [N, N m].

    It is expressed in the bedplate's frame, or in the frame of the first link beyond the sensor,
    about the origin of that frame.

    Args:
        table: Table of the wrench in the mapping.
        columns: Values in the units of the file, (M, k).
    """
    if table.matrix is not None:
        columns = columns @ np.array(table.matrix, dtype=np.float64).T
    sense = 1.0 if table.sense == "on_robot" else -1.0
    force = sense * unit_size("force", table.units[0]) * columns[:, :3]
    moment = sense * unit_size("moment", table.units[1]) * columns[:, 3:]
    wrench = np.hstack([force, moment])
    if table.place is None:
        return wrench
    return Transform(rpy_to_matrix(table.place.rpy), np.array(table.place.xyz)).wrench(
        wrench
    )


def continuous_quaternions(quaternions: Array) -> Array:
    """Quaternions of the same orientations without jumps of sign, (M, 4).

    Args:
        quaternions: Quaternions of successive samples, (M, 4); q and -q are the same orientation.
    """
    products = np.einsum("mi,mi->m", quaternions[1:], quaternions[:-1])
    signs = np.cumprod(np.where(products < 0, -1.0, 1.0))
    return np.vstack([quaternions[:1], quaternions[1:] * signs[:, None]])


def base_pose_from_columns(table: BaseTable, columns: Array) -> Array:
    """Position [m] and unit quaternion (w, x, y, z) of a moving base, (M, 7).

    The pose is that of the root link's frame in the ground's frame.

    Args:
        table: Table of the base in the mapping.
        columns: Values in the units of the file, (M, 7).

    Raises:
        RecordingError: The norm of a quaternion differs from one by more than 0.01.
    """
    turn = columns[:, 3:]
    size = np.linalg.norm(turn, axis=1, keepdims=True)
    if not (np.abs(size - 1) <= QUATERNION_NORM_TOLERANCE).all():
        raise RecordingError(
            f"base.quaternion: its length is {float(size.min()):.3g} to {float(size.max()):.3g}, "
            "that of a quaternion is one: are the columns w, x, y, z?"
        )
    return np.hstack([unit_size("position", table.unit) * columns[:, :3], turn / size])


def joint_kinds(table: SignalTable, joints: Sequence[str]) -> dict[str, dict[str, str]]:
    """Kind of each joint, revolute or prismatic, according to the unit of its position.

    The dictionary has the form of a recording's metadata; it is empty if a matrix mixes columns
    with units of both kinds.

    Args:
        table: Table of the positions in the mapping.
        joints: Joint names.
    """
    sliding = [is_length_unit(unit) for unit in table.units]
    if table.matrix is not None:
        if len(set(sliding)) > 1:
            return {}
        sliding = sliding[:1] * len(joints)
    return {
        name: {"kind": "prismatic" if slide else "revolute"}
        for name, slide in zip(joints, sliding, strict=True)
    }


EFFORT_OF_UNIT = {"pwm": "pwm", "A": "current", "mA": "current"}
"""Physical quantity behind a torque, by unit."""


def torque_quantities(mapping: Mapping) -> dict[str, str]:
    """Measured quantity of each joint's torque: "current", "pwm", "motor" or "torque".

    Current and pwm follow from the unit; otherwise the side of the gear decides between motor
    torque and joint torque. If a matrix mixes the columns, the unit of the first column decides.

    Args:
        mapping: Content of the mapping file.
    """
    if (table := mapping.torque) is None:
        return {}
    units = (
        table.units if table.matrix is None else table.units[:1] * len(mapping.joints)
    )
    default = "motor" if table.side == "motor" else "torque"
    return {
        j: EFFORT_OF_UNIT.get(canonical_unit(u), default)
        for j, u in zip(mapping.joints, units, strict=True)
    }


def check_stated_units(label: str, table: AnyTable, file: ForeignTable) -> None:
    """Refuse a mapping whose units differ from the units that the file states.

    Columns that are converted by `gain` or by the matrix of a wrench are not compared.

    Args:
        label: Label of the table in the mapping.
        table: Table of the signal in the mapping.
        file: Table of the foreign file with the columns.

    Raises:
        RecordingError: A unit in the mapping differs from the unit in the file.
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
        stated = canonical_unit(file.unit(column) or "")
        if (
            stated in {*UNITS_BY_QUANTITY[kind], *RAW_UNITS}
            and stated != canonical_unit(unit)
            and canonical_unit(unit) in UNITS_BY_QUANTITY[kind]
        ):
            remedies = {
                "torque": "; say its `gain`",
                "force": "; say the plate's gains, `matrix`",
            }
            raise RecordingError(
                f"{label}: the file has '{column}' in {stated}, the mapping in {unit}"
                + remedies.get(kind, "") * (stated in RAW_UNITS)
            )
