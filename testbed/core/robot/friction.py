"""Joint laws: what a joint's torque holds besides the forces that move the bodies.

A law is a column, a function of the joint's velocity and acceleration, to be multiplied by a
coefficient: friction, a rotor's inertia, an offset of the measured torque. This is the only
place where they are written down: the kernel compiles these columns; simulation, prediction,
units, scores and the command line read them here.

To add a law, write a module with a `JointLaw` in `testbed/core/robot/laws`. A law that is only
tried out need not be there: `Settings(terms=("coulomb", my_law))` takes any `JointLaw`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from operator import attrgetter
from pkgutil import iter_modules
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import UnknownName
from testbed.core.robot import laws
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.shafts import places, shares
from testbed.core.robot.tree import Tree


def _sign(qd: Any, qdd: Any) -> Any:
    return np.sign(qd)


def _velocity(qd: Any, qdd: Any) -> Any:
    return qd


def _one(qd: Any, qdd: Any) -> Any:
    return 1.0


COULOMB = JointLaw("coulomb", "N m", "N", _sign, "coulomb", resists=True, jumps=True)
"""Dry friction: against the motion, however fast."""

VISCOUS = JointLaw("viscous", "N m s/rad", "N s/m", _velocity, "viscous", resists=True)
"""Friction in proportion to the velocity."""

OFFSET = JointLaw("offset", "N m", "N", _one)
"""What the drive reports too much: a constant."""

ROTOR = JointLaw("rotor", "kg m^2", "kg", lambda qd, qdd: qdd, "rotor_inertia")
"""Inertia of the drive's rotor, reflected to the joint."""

FORWARD = JointLaw("coulomb+offset", "N m", "N", _one)
"""Dry friction and offset of a joint that only moves forward: all that shows is their sum."""

BACKWARD = JointLaw("offset-coulomb", "N m", "N", _one)
"""The same of a joint that only moves backward."""

CONSTANTS = (OFFSET, FORWARD, BACKWARD)
"""Laws whose column is one."""

SLOPE = JointLaw("slope", "N m/s", "N/s", _one, by="time")
"""Drift of the offset, as of a drive that warms up; of this recording only."""

ROOM = 25.0
"""Temperature at which friction is what its laws without temperature say [degC]."""

WARM_VISCOUS = JointLaw(
    "warm_viscous", "N m s/(rad K)", "N s/(m K)", _velocity, by="temperature"
)
"""Change of viscous friction with the drive's temperature, from ROOM on."""

VARYING = (
    SLOPE,
    # change of dry friction with the drive's temperature
    JointLaw("warm_coulomb", "N m/K", "N/K", _sign, jumps=True, by="temperature"),
    WARM_VISCOUS,
)
"""Laws that depend on more than the motion."""

BY_LOAD: Mapping[str, Callable[[Array, Array], Array]] = {
    "load": lambda load, smooth: load * np.sign(smooth),
    "signed load": lambda load, smooth: load,
    "squared load": lambda load, smooth: load * smooth,
}
"""What multiplies laws of the load, the torque that moves the link [N m or N]: only where the
plate's estimate says what it is. Functions of the load and of its mean over a short time: where
encoders are noisy, abs(load) is not zero on average where the load is."""

LOAD = JointLaw("load", "1", "1", _sign, jumps=True, by="load")
"""Dry friction that grows with the load: the part of it that a gear loses."""

QUADRATIC_LOAD = JointLaw(
    "quadratic_load", "1/(N m)", "1/N", _sign, jumps=True, by="squared load"
)
"""Dry friction that grows with the square of the load."""

LOADED = (
    LOAD,
    # viscous friction that grows with the load
    JointLaw("viscous_load", "s/rad", "s/m", _velocity, by="load"),
    # the same as far as a gear that drives has more of it than one that is driven back
    JointLaw(
        "driving_load", "s/rad", "s/m", lambda qd, qdd: np.abs(qd), by="signed load"
    ),
    QUADRATIC_LOAD,
)
"""Laws of the load. Dry friction that differs between driving and being driven is not among them:
its column, load - sign(v) abs(load), has nothing of its own beside the torque constant's."""


def _further_laws() -> Iterator[JointLaw]:
    """Laws of the modules in `testbed/core/robot/laws`, by the modules' names."""
    for module in sorted(
        iter_modules(laws.__path__, f"{laws.__name__}."), key=attrgetter("name")
    ):
        values = vars(import_module(module.name)).values()
        yield from (value for value in values if isinstance(value, JointLaw))


FURTHER: tuple[JointLaw, ...] = tuple(_further_laws())
"""Laws of `testbed/core/robot/laws`; a choice by held-out data is offered all of them."""

LAWS: tuple[JointLaw, ...] = (COULOMB, VISCOUS, OFFSET, ROTOR, *FURTHER)
"""All that can be asked for by name; beside them stribeck@SPEED and what one direction leaves."""

STRIBECK = "stribeck"
"""Kind of the laws that fade out above a speed."""

SLOWEST, FASTEST = 1e-3, 10.0
"""Speeds at which friction may fade out [rad/s or m/s]."""


@lru_cache
def stribeck(speed: float) -> JointLaw:
    """Friction that dry friction has more at low speed: sign(v) exp(-(v / speed)^2).

    Args:
        speed: At which it fades out [rad/s or m/s].
    """

    def column(qd: Any, qdd: Any) -> Any:
        return np.sign(qd) * fading(qd, speed)

    return JointLaw(f"{STRIBECK}@{speed:g}", "N m", "N", column, jumps=True)


def fading(qd: Any, speed: Any) -> Any:
    """Part of friction at rest that is left at a speed: exp(-(v / speed)^2).

    Args:
        qd: Velocity v [rad/s or m/s].
        speed: At which it fades out [rad/s or m/s].
    """
    return np.exp(-((qd / speed) ** 2))


@dataclass(frozen=True)
class JointTerm:
    """One law at one joint, or at a shaft that turns with several.

    Attributes:
        law: Which.
        joint: Index of the joint; of a shaft, that among `places`.
    """

    law: JointLaw
    joint: int

    @property
    def positive(self) -> bool:
        """Whether it cannot be negative: friction takes energy, and rotors have inertia."""
        return self.law.resists or self.law == ROTOR

    def name(self, tree: Tree) -> str:
        """Name of the coefficient: rotor/waist."""
        return f"{self.law.kind}/{places(tree)[self.joint]}"

    def unit(self, tree: Tree) -> str:
        """Unit of the coefficient."""
        shaft = self.joint - tree.n
        joint = self.joint if shaft < 0 else tree.shafts[shaft].turns[0][0]
        return self.law.unit(tree.joints[joint])


def joint_terms(tree: Tree, words: Iterable[str | JointLaw]) -> tuple[JointTerm, ...]:
    """The terms that words ask for, law by law, each in the order of `places`.

    Args:
        tree: The robot.
        words: A law, by name or as a value, holds at every joint and shaft; "rotor/elbow" holds
            there alone. Offsets are the joints' alone: a shaft's is not distinct from two of those.

    Raises:
        UnknownName: There is no such law, joint or shaft.
    """
    names = places(tree)
    wanted: dict[JointLaw, set[int]] = {}
    for word in words:
        law, place = (
            law_of(word),
            "" if isinstance(word, JointLaw) else word.partition("/")[2],
        )
        if place and place not in names:
            raise UnknownName(f"place of '{law.kind}'", place, names)
        everywhere = range(tree.n if law in CONSTANTS or law.by else len(names))
        wanted.setdefault(law, set()).update(
            [names.index(place)] if place else everywhere
        )
    return tuple(JointTerm(law, k) for law, at in wanted.items() for k in sorted(at))


def law_of(word: str | JointLaw) -> JointLaw:
    """The law of a word such as "rotor" or "rotor/elbow".

    Args:
        word: Or the law itself.

    Raises:
        UnknownName: There is no such law.
    """
    return word if isinstance(word, JointLaw) else joint_law(word.partition("/")[0])


def joint_law(kind: str) -> JointLaw:
    """The law of that name: one of LAWS, CONSTANTS, VARYING, LOADED, or stribeck@SPEED.

    Raises:
        UnknownName: There is none.
    """
    known = {law.kind: law for law in (*LAWS, *CONSTANTS, *VARYING, *LOADED)}
    family, _, speed = kind.partition("@")
    if family == STRIBECK:
        with suppress(ValueError):
            if SLOWEST <= float(speed) <= FASTEST:
                return stribeck(float(speed))
    if kind not in known:
        named = (stribeck(0.1), *LAWS, *VARYING, *LOADED)
        raise UnknownName("term of a joint's torque", kind, [law.kind for law in named])
    return known[kind]


def term_torque(
    tree: Tree, term: JointTerm, qd: Array, qdd: Array, by: Array | float = 1.0
) -> Array:
    """What a unit of a term's coefficient adds to the joints' torques, (M, n) [N m or N].

    Args:
        tree: The robot.
        term: At a joint or a shaft.
        qd: Joint velocities, (M, n) [rad/s or m/s].
        qdd: Joint accelerations, (M, n) [rad/s^2 or m/s^2].
        by: What multiplies the column of a law that says so, (M,).
    """
    turn = shares(tree)[term.joint]
    column = term.law.columns(qd @ turn, qdd @ turn)
    return np.outer(column * by if term.law.by else column, turn)
