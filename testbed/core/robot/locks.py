"""Joints held still: which of them, where, and what goes along with them.

A tree has one degree of freedom a joint. A joint that follows another (URDF's <mimic>,
MJCF's equality between joints) has none of its own: it can be part of a tree only where
it is held, or where the joint that it follows is.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from graphlib import CycleError, TopologicalSorter
from typing import TypeAlias

from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import ModelError, UnknownName, few
from testbed.core.robot.parsing import decimals
from testbed.core.robot.refusals import MimicError

Lock: TypeAlias = Mapping[str, float | None]
"""Positions of held joints by name [rad or m]; None: where a joint rests of itself."""

_SLACK = 1e-6
"""How far beyond its range a joint may be held: limits are rounded in files [rad or m]."""


@dataclass(frozen=True)
class Coupling:
    """A joint's position as a polynomial of another's.

    Attributes:
        master: The joint that is followed; None if the position is constant.
        coefficients: Of the powers 0, 1, 2, ... of the master's position [rad, m].
    """

    master: str | None
    coefficients: tuple[float, ...]

    def position(self, master: float) -> float:
        """Where the joint is when its master is there [rad or m]."""
        return sum(c * master**k for k, c in enumerate(self.coefficients))


@dataclass(frozen=True)
class Travel:
    """What a file says of how a joint moves.

    Attributes:
        low: Least position [rad or m], -inf if unknown.
        high: Greatest position [rad or m], inf if unknown.
        coupling: What it follows, if it does.
    """

    low: float = -math.inf
    high: float = math.inf
    coupling: Coupling | None = None

    @property
    def master(self) -> str | None:
        """The joint that is followed, if any."""
        return self.coupling.master if self.coupling else None

    @property
    def rest(self) -> float:
        """Zero, or the middle of the range where that leaves zero out [rad or m]."""
        if self.low <= 0 <= self.high:
            return 0.0
        if math.isinf(self.low) or math.isinf(self.high):
            return self.high if math.isinf(self.low) else self.low
        return self.low / 2 + self.high / 2


def parse_lock(
    texts: Iterable[str], names: Callable[[], Sequence[str]] = tuple
) -> dict[str, float | None]:
    """Positions of held joints, as typed: JOINT, JOINT=q, a pattern, or !pattern for all others.

    Args:
        texts: Words of the command line.
        names: Gives the joints of the model file, which patterns are matched with.

    Raises:
        ModelError: A position is not a number, a pattern matches nothing, or one joint is given
            two positions.
    """
    lock: dict[str, float | None] = {}
    for text in texts:
        name, equals, place = text.partition("=")
        value = decimals(place, 1)
        if not name or (equals and value is None):
            raise ModelError(
                f"--lock takes JOINT or JOINT=q [rad or m], found '{text}'"
            )
        position = value[0] if value else None
        joints = [name]
        if name[0] == "!" or re.search(r"[*?\[]", name):
            known, other = names(), name[0] == "!"
            joints = [
                j for j in known if fnmatchcase(j, name.removeprefix("!")) != other
            ]
            if not joints or len(joints) == len(known):
                many = "all" if joints else "none"
                raise ModelError(
                    f"--lock {name} matches {many} of the joints {few(known)}"
                )
        for joint in joints:
            if lock.setdefault(joint, position) != position:
                raise ModelError(f"--lock {joint} is given two positions")
    return lock


def lock_positions(
    joints: Mapping[str, Travel], lock: Lock, source: str
) -> tuple[dict[str, float], tuple[Diagnostic, ...]]:
    """Where which joints are held, followers of held joints included.

    Args:
        joints: All joints of the file that move.
        lock: Those to be held.
        source: The file, for messages.

    Returns:
        Positions by name [rad or m], and followers whose masters go elsewhere.

    Raises:
        UnknownName: A joint to be held is not there.
        MimicError: A joint follows another that moves, and neither is held.
        ModelError: A position is no number or out of range, or joints follow in a circle.
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
    held: dict[str, float] = {}
    positions: dict[str, float] = {}
    free: dict[str, str] = {}
    for name in order:
        joint, wanted = joints[name], lock.get(name)
        coupling, master = joint.coupling, joint.master
        if wanted is not None:
            positions[name] = _within(name, wanted, joint, source)
        elif coupling is not None:
            positions[name] = coupling.position(positions.get(master or "", 0.0))
        else:
            positions[name] = joint.rest
        if name in lock or (
            coupling is not None and (master is None or master in held)
        ):
            held[name] = positions[name]
        elif master is not None:
            free[name] = master
    if free:
        raise MimicError(
            source, free, tuple(m if m in joints else f for f, m in free.items())
        )
    return held, tuple(_departures(joints, held))


def _departures(
    joints: Mapping[str, Travel], held: Mapping[str, float]
) -> Iterator[Diagnostic]:
    """Followers that are held where their masters would not take them."""
    for name, position in held.items():
        coupling, master = joints[name].coupling, joints[name].master
        if coupling is None or master is None:
            continue
        if master not in held:
            yield diagnose("model.follower-held", name, position, master=master)
        elif abs(taken := coupling.position(held[master]) - position) > _SLACK:
            end = position + taken
            yield diagnose(
                "model.follower-off", name, position, master=master, taken=end
            )


def _within(name: str, wanted: float, joint: Travel, source: str) -> float:
    """The position, if it is one that the joint can have."""
    try:
        position = float(wanted)
    except (TypeError, ValueError, OverflowError):
        position = math.nan
    if not math.isfinite(position):
        raise ModelError(f"{source}: joint '{name}' cannot be held at {wanted!r:.40}")
    if not joint.low - _SLACK <= position <= joint.high + _SLACK:
        raise ModelError(
            f"{source}: joint '{name}' cannot be held at {position:g}, out of its range "
            f"{joint.low:g} ... {joint.high:g}"
        )
    return position
