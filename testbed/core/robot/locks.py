"""Locking of joints at fixed positions, and the resulting positions of mimic joints.

A tree has one degree of freedom per joint. A mimic joint (URDF's <mimic>, MJCF's equality between
joints) follows a master joint and has no degree of freedom: a tree can contain the joint only if
the mimic joint or its master is locked.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from graphlib import CycleError, TopologicalSorter
from typing import TypeAlias

from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import ModelError, UnknownName, shortened_list
from testbed.core.robot.parsing import parse_decimals
from testbed.core.robot.refusals import MimicError

JointLocks: TypeAlias = Mapping[str, float | None]
"""Positions of locked joints, keyed by name [rad or m]; None for the rest position of the joint."""

_RANGE_TOLERANCE = 1e-6
"""Largest accepted excess of a locked position over the joint range, as files round limits
[rad or m]."""


@dataclass(frozen=True)
class MimicCoupling:
    """Position of a mimic joint as a polynomial of the master joint's position.

    Attributes:
        master: Name of the master joint; None for a constant position.
        coefficients: Coefficients of the powers 0, 1, 2, ... of the master's position, for
            positions in rad or m.
    """

    master: str | None
    coefficients: tuple[float, ...]

    def position(self, master: float) -> float:
        """Position of the mimic joint [rad or m] for a position of the master joint [rad or m]."""
        return sum(c * master**k for k, c in enumerate(self.coefficients))


@dataclass(frozen=True)
class JointTravel:
    """Range and coupling of a joint, as stated in a model file.

    Attributes:
        low: Lower position limit [rad or m], -inf if unknown.
        high: Upper position limit [rad or m], inf if unknown.
        coupling: Coupling to a master joint; None for an independent joint.
    """

    low: float = -math.inf
    high: float = math.inf
    coupling: MimicCoupling | None = None

    @property
    def master(self) -> str | None:
        """Name of the master joint; None for no coupling or a constant position."""
        return self.coupling.master if self.coupling else None

    @property
    def rest_position(self) -> float:
        """Rest position of the joint [rad or m].

        The rest position is zero if the range contains zero. Otherwise it is the middle of the
        range or, if only one limit is finite, this limit.
        """
        if self.low <= 0 <= self.high:
            return 0.0
        if math.isinf(self.low) or math.isinf(self.high):
            return self.high if math.isinf(self.low) else self.low
        return self.low / 2 + self.high / 2


def parse_lock(
    texts: Iterable[str], names: Callable[[], Sequence[str]] = tuple
) -> dict[str, float | None]:
    """Parse lock options: JOINT, JOINT=q, a name pattern, or !pattern for all other joints.

    A pattern may be followed by =q. Names without wildcards are not checked against the model file.

    Args:
        texts: Words of the command line.
        names: Function that returns the joint names of the model file; called only if a pattern has
            to be matched.

    Returns:
        Positions keyed by joint name [rad or m]; None for an option without a position.

    Raises:
        ModelError: A name is empty, a position is not a number, a pattern matches no joint or all
            joints, or a joint has two different positions.
    """
    lock: dict[str, float | None] = {}
    for text in texts:
        name, equals, number = text.partition("=")
        value = parse_decimals(number, 1)
        if not name or (equals and value is None):
            raise ModelError(
                f"--lock takes JOINT or JOINT=q [rad or m], found '{text}'"
            )
        position = value[0] if value else None
        joints = [name]
        if name[0] == "!" or re.search(r"[*?\[]", name):
            known, inverted = names(), name[0] == "!"
            joints = [
                j for j in known if fnmatchcase(j, name.removeprefix("!")) != inverted
            ]
            if not joints or len(joints) == len(known):
                extent = "all" if joints else "none"
                raise ModelError(
                    f"--lock {name} matches {extent} of the joints {shortened_list(known)}"
                )
        for joint in joints:
            if lock.setdefault(joint, position) != position:
                raise ModelError(f"--lock {joint} is given two positions")
    return lock


def lock_positions(
    joints: Mapping[str, JointTravel], lock: JointLocks, source: str
) -> tuple[dict[str, float], tuple[Diagnostic, ...]]:
    """Positions of locked joints and of mimic joints with a locked master.

    Args:
        joints: Range and coupling of every moving joint of the file, keyed by name.
        lock: Positions of the joints to be locked, keyed by name [rad or m]. None stands for the
            position that the coupling implies from the position of the master, or for the rest
            position of a joint without coupling.
        source: File name, for messages.

    Returns:
        Positions keyed by name [rad or m], masters before mimic joints; and diagnostics of locked
        mimic joints whose master moves or implies another position.

    Raises:
        UnknownName: A joint to be locked is not in the file.
        MimicError: A mimic joint and its master are both not locked.
        ModelError: A position is not a number or out of range, or couplings form a cycle.
    """
    for name in lock:
        if name not in joints:
            raise UnknownName("joint to lock", name, joints)
    graph = {name: joints.keys() & {joint.master} for name, joint in joints.items()}
    try:
        order = tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        raise ModelError(
            f"{source}: joint '{error.args[1][0]}' follows itself"
        ) from None
    locked: dict[str, float] = {}
    positions: dict[str, float] = {}
    free_followers: dict[str, str] = {}
    for name in order:
        joint, target = joints[name], lock.get(name)
        coupling, master = joint.coupling, joint.master
        if target is not None:
            positions[name] = _checked_position(name, target, joint, source)
        elif coupling is not None:
            positions[name] = coupling.position(positions.get(master or "", 0.0))
        else:
            positions[name] = joint.rest_position
        if name in lock or (
            coupling is not None and (master is None or master in locked)
        ):
            locked[name] = positions[name]
        elif master is not None:
            free_followers[name] = master
    if free_followers:
        raise MimicError(
            source,
            free_followers,
            tuple(m if m in joints else f for f, m in free_followers.items()),
        )
    return locked, tuple(_follower_diagnostics(joints, locked))


def _follower_diagnostics(
    joints: Mapping[str, JointTravel], locked: Mapping[str, float]
) -> Iterator[Diagnostic]:
    """Diagnostics of locked mimic joints whose master moves or implies another position.

    Positions count as different if they differ by more than _RANGE_TOLERANCE.

    Args:
        joints: Range and coupling of every moving joint of the file, keyed by name.
        locked: Positions of locked joints, keyed by name [rad or m].
    """
    for name, position in locked.items():
        coupling, master = joints[name].coupling, joints[name].master
        if coupling is None or master is None:
            continue
        if master not in locked:
            yield make_diagnostic("model.follower-held", name, position, master=master)
        elif (
            abs(deviation := coupling.position(locked[master]) - position)
            > _RANGE_TOLERANCE
        ):
            end = position + deviation
            yield make_diagnostic(
                "model.follower-off", name, position, master=master, taken=end
            )


def _checked_position(
    name: str, value: float, joint: JointTravel, source: str
) -> float:
    """Position of a locked joint as a finite number within the joint's range [rad or m].

    Args:
        name: Joint name, for messages.
        value: Given position [rad or m].
        joint: Joint, whose range may be exceeded by up to _RANGE_TOLERANCE.
        source: File name, for messages.

    Raises:
        ModelError: The value is not finite, or out of the range.
    """
    try:
        position = float(value)
    except (TypeError, ValueError, OverflowError):
        position = math.nan
    if not math.isfinite(position):
        raise ModelError(f"{source}: joint '{name}' cannot be held at {value!r:.40}")
    if not joint.low - _RANGE_TOLERANCE <= position <= joint.high + _RANGE_TOLERANCE:
        raise ModelError(
            f"{source}: joint '{name}' cannot be held at {position:g}, out of its range "
            f"{joint.low:g} ... {joint.high:g}"
        )
    return position
