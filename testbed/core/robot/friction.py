"""Joint torque laws in addition to rigid-body dynamics: friction, rotor inertia, torque offsets.

A law is a regressor column, a function of joint velocity and acceleration, to be multiplied by
a coefficient. Laws are defined here only: the kernel compiles these columns; simulation,
prediction, units, scores and the command line use them.

To add a law, write a module with a `JointLaw` in `testbed/core/robot/laws`. A law under trial need
not be in this folder: `Settings(terms=("coulomb", my_law))` takes any `JointLaw`.
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
from testbed.core.robot.shafts import joint_and_shaft_names, transmission_matrix
from testbed.core.robot.tree import Tree


def _sign_column(qd: Any, qdd: Any) -> Any:
    """Regressor column of Coulomb friction: sign of the velocity."""
    return np.sign(qd)


def _velocity_column(qd: Any, qdd: Any) -> Any:
    """Regressor column of viscous friction: velocity."""
    return qd


def _unit_column(qd: Any, qdd: Any) -> Any:
    """Regressor column of a constant torque: unity."""
    return 1.0


COULOMB = JointLaw(
    "coulomb", "N m", "N", _sign_column, "coulomb", dissipative=True, discontinuous=True
)
"""Coulomb friction: constant magnitude, opposed to the motion."""

VISCOUS = JointLaw(
    "viscous", "N m s/rad", "N s/m", _velocity_column, "viscous", dissipative=True
)
"""Viscous friction: proportional to the velocity."""

OFFSET = JointLaw("offset", "N m", "N", _unit_column)
"""Constant error of the torque reported by the drive."""

ROTOR = JointLaw("rotor", "kg m^2", "kg", lambda qd, qdd: qdd, "rotor_inertia")
"""Rotor inertia of the drive, reflected to the joint."""

FORWARD_CONSTANT = JointLaw("coulomb+offset", "N m", "N", _unit_column)
"""Sum of Coulomb friction and offset, which are inseparable for a joint that only moves forward."""

BACKWARD_CONSTANT = JointLaw("offset-coulomb", "N m", "N", _unit_column)
"""Difference of offset and Coulomb friction, inseparable for a joint that only moves backward."""

CONSTANT_LAWS = (OFFSET, FORWARD_CONSTANT, BACKWARD_CONSTANT)
"""Laws with a constant regressor column."""

OFFSET_DRIFT = JointLaw("slope", "N m/s", "N/s", _unit_column, by="time")
"""Linear drift of the offset during one recording, for example while a drive warms up."""

ROOM_TEMPERATURE = 25.0
"""Reference temperature to which friction laws without temperature dependence refer [degC]."""

WARM_VISCOUS = JointLaw(
    "warm_viscous", "N m s/(rad K)", "N s/(m K)", _velocity_column, by="temperature"
)
"""Change of viscous friction in proportion to the drive temperature above ROOM_TEMPERATURE."""

DRIFT_LAWS = (
    OFFSET_DRIFT,
    # change of Coulomb friction with the drive's temperature
    JointLaw(
        "warm_coulomb",
        "N m/K",
        "N/K",
        _sign_column,
        discontinuous=True,
        by="temperature",
    ),
    WARM_VISCOUS,
)
"""Laws that depend on time or temperature in addition to the motion."""

LOAD_MULTIPLIERS: Mapping[str, Callable[[Array, Array], Array]] = {
    "load": lambda load, smooth: load * np.sign(smooth),
    "signed load": lambda load, smooth: load,
    "squared load": lambda load, smooth: load * smooth,
}
"""Multipliers of the columns of load-dependent laws, keyed by `JointLaw.by`.

The load is the torque that moves the link [N m or N]; only the force-plate estimate provides it.
The arguments are the load and its short-time mean. The sign is taken from the short-time mean,
because with noisy encoders the mean of abs(load) is not zero where the load is zero."""

LOAD_FRICTION = JointLaw("load", "1", "1", _sign_column, discontinuous=True, by="load")
"""Coulomb friction proportional to the load: fraction of the load lost in the gear."""

QUADRATIC_LOAD_FRICTION = JointLaw(
    "quadratic_load",
    "1/(N m)",
    "1/N",
    _sign_column,
    discontinuous=True,
    by="squared load",
)
"""Coulomb friction proportional to the square of the load."""

LOAD_LAWS = (
    LOAD_FRICTION,
    # viscous friction proportional to the load
    JointLaw("viscous_load", "s/rad", "s/m", _velocity_column, by="load"),
    # difference of this friction between a driving and a back-driven gear
    JointLaw(
        "driving_load", "s/rad", "s/m", lambda qd, qdd: np.abs(qd), by="signed load"
    ),
    QUADRATIC_LOAD_FRICTION,
)
"""Load-dependent friction laws.

A difference of Coulomb friction between driving and back-driving is not included: its column,
load - sign(v) abs(load), is collinear with the error of the torque constant."""


def _additional_laws() -> Iterator[JointLaw]:
    """Yield the laws defined in modules of `testbed/core/robot/laws`, ordered by module name."""
    for module in sorted(
        iter_modules(laws.__path__, f"{laws.__name__}."), key=attrgetter("name")
    ):
        values = vars(import_module(module.name)).values()
        yield from (value for value in values if isinstance(value, JointLaw))


ADDITIONAL_LAWS: tuple[JointLaw, ...] = tuple(_additional_laws())
"""Laws of `testbed/core/robot/laws`; all are candidates for selection by cross-validation."""

JOINT_LAWS: tuple[JointLaw, ...] = (COULOMB, VISCOUS, OFFSET, ROTOR, *ADDITIONAL_LAWS)
"""Laws selectable by name, in addition to stribeck@SPEED and the laws of one-way joints."""

STRIBECK_KIND = "stribeck"
"""Kind of the Stribeck laws, without @SPEED."""

MIN_STRIBECK_SPEED, MAX_STRIBECK_SPEED = 1e-3, 10.0
"""Range of accepted Stribeck speeds [rad/s or m/s]."""


@lru_cache
def stribeck_law(speed: float) -> JointLaw:
    """Stribeck friction law: additional friction at low speed, sign(v) exp(-(v / speed)^2).

    The name of the law is stribeck@SPEED.

    Args:
        speed: Stribeck speed, at which the additional friction has fallen to 1/e [rad/s or m/s].
    """

    def column(qd: Any, qdd: Any) -> Any:
        return np.sign(qd) * stribeck_decay(qd, speed)

    return JointLaw(
        f"{STRIBECK_KIND}@{speed:g}", "N m", "N", column, discontinuous=True
    )


def stribeck_decay(qd: Any, speed: Any) -> Any:
    """Stribeck decay factor exp(-(v / speed)^2): ratio of the additional friction to that at rest.

    Args:
        qd: Velocity v [rad/s or m/s].
        speed: Stribeck speed [rad/s or m/s].
    """
    return np.exp(-((qd / speed) ** 2))


@dataclass(frozen=True)
class JointTerm:
    """Joint torque law applied at one joint or motor shaft.

    Attributes:
        law: Joint law.
        joint: Index of the joint or shaft in `joint_and_shaft_names`: joints first.
    """

    law: JointLaw
    joint: int

    @property
    def nonnegative(self) -> bool:
        """True if the coefficient cannot be negative: dissipative friction or rotor inertia."""
        return self.law.dissipative or self.law == ROTOR

    def name(self, tree: Tree) -> str:
        """Name of the coefficient, KIND/JOINT or KIND/SHAFT, such as rotor/waist."""
        return f"{self.law.kind}/{joint_and_shaft_names(tree)[self.joint]}"

    def unit(self, tree: Tree) -> str:
        """Unit of the coefficient for a revolute or prismatic joint.

        The kind of a shaft is that of its joints.
        """
        shaft = self.joint - tree.n
        joint = self.joint if shaft < 0 else tree.shafts[shaft].turns[0][0]
        return self.law.unit(tree.joints[joint])


def joint_terms(tree: Tree, words: Iterable[str | JointLaw]) -> tuple[JointTerm, ...]:
    """Joint terms of the given laws, without duplicates.

    Laws are in the order of their first mention, and the terms of a law are in the order of
    `joint_and_shaft_names`.

    Args:
        tree: Robot.
        words: Laws, as `JointLaw` or by name: "rotor" for all joints and shafts, "rotor/elbow" for
            a single joint or shaft. Constant laws and laws with a `by` apply to joints only, unless
            a shaft is named: the offset of a shaft is collinear with the offsets of its joints.

    Raises:
        UnknownName: No law, joint or shaft has the name.
    """
    names = joint_and_shaft_names(tree)
    indices_by_law: dict[JointLaw, set[int]] = {}
    for word in words:
        law, place = (
            law_of_term(word),
            "" if isinstance(word, JointLaw) else word.partition("/")[2],
        )
        if place and place not in names:
            raise UnknownName(f"place of '{law.kind}'", place, names)
        all_indices = range(tree.n if law in CONSTANT_LAWS or law.by else len(names))
        indices_by_law.setdefault(law, set()).update(
            [names.index(place)] if place else all_indices
        )
    return tuple(
        JointTerm(law, k)
        for law, indices in indices_by_law.items()
        for k in sorted(indices)
    )


def law_of_term(word: str | JointLaw) -> JointLaw:
    """Joint law of a term name such as "rotor" or "rotor/elbow".

    Args:
        word: Term name; or the law itself, which is returned unchanged.

    Raises:
        UnknownName: No law has the name.
    """
    return word if isinstance(word, JointLaw) else joint_law(word.partition("/")[0])


def joint_law(kind: str) -> JointLaw:
    """Joint law named in JOINT_LAWS, CONSTANT_LAWS, DRIFT_LAWS or LOAD_LAWS, or stribeck@SPEED.

    Raises:
        UnknownName: No law has the name, or SPEED is not between MIN_STRIBECK_SPEED and
            MAX_STRIBECK_SPEED.
    """
    known = {
        law.kind: law for law in (*JOINT_LAWS, *CONSTANT_LAWS, *DRIFT_LAWS, *LOAD_LAWS)
    }
    family, _, speed = kind.partition("@")
    if family == STRIBECK_KIND:
        with suppress(ValueError):
            if MIN_STRIBECK_SPEED <= float(speed) <= MAX_STRIBECK_SPEED:
                return stribeck_law(float(speed))
    if kind not in known:
        listed_laws = (stribeck_law(0.1), *JOINT_LAWS, *DRIFT_LAWS, *LOAD_LAWS)
        raise UnknownName(
            "term of a joint's torque", kind, [law.kind for law in listed_laws]
        )
    return known[kind]


def term_torque(
    tree: Tree, term: JointTerm, qd: Array, qdd: Array, multiplier: Array | float = 1.0
) -> Array:
    """Joint torques of a term with unit coefficient, (M, n) [N m or N]: M samples, n joints.

    The torque of a shaft acts on every joint in proportion to the transmission ratio.

    Args:
        tree: Robot.
        term: Law at a joint or a shaft.
        qd: Joint velocities, (M, n) [rad/s or m/s].
        qdd: Joint accelerations, (M, n) [rad/s^2 or m/s^2].
        multiplier: Signal named by `JointLaw.by`, which multiplies the column, (M,); not used for a
            law without `by`.
    """
    ratios = transmission_matrix(tree)[term.joint]
    column = term.law.columns(qd @ ratios, qdd @ ratios)
    return np.outer(column * multiplier if term.law.by else column, ratios)
