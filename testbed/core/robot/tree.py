"""What the robot is: bodies joined in an open tree on a bedplate.

Body j is carried by body `parents[j]` through joint j; the bedplate is -1; numbering is
ascending, parents first. Names, orders and data are by joint.

Source    [FRS96] section 2: INBODY, T of eq. (1), l^ij of eq. (2)
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array, freeze, readonly
from testbed.core.base.diagnostics import Diagnosed, Diagnostic
from testbed.core.base.errors import ModelError, SettingsError, UnknownName, plural
from testbed.core.base.summary_table import SummaryTable, Value
from testbed.core.base.transform import Transform
from testbed.core.robot.gravity import gravity_of
from testbed.core.robot.inertia import NOTHING, Inertia

Kind = Literal["revolute", "prismatic"]


WEAKEST, STRONGEST = 1e-6, 1e4
"""Magnitudes of gravity that are not a mistake [m/s^2]."""

FARTHEST = 1e6
"""Lengths beyond this are a mistake [m]."""

UNIT = 1e-6
"""How far an axis's length may be from one: rounding in files."""

SETTABLE = (
    "position_range",
    "max_velocity",
    "max_effort",
    "coulomb",
    "viscous",
    "rotor_inertia",
)
"""What may be known better than the model file knows it."""


@dataclass(frozen=True, eq=False)
class Joint(Value):
    """One joint of one degree of freedom, and how its body sits on the carrying body.

    x_i = l + A Rot(e, q) x_j for a revolute joint, x_i = l + A (e q + x_j) for a prismatic
    one. Limits unknown to the file are infinite, losses unknown to it are zero.

    Attributes:
        name: The joint's name in the model file.
        body: The name of the body it moves.
        kind: "revolute" or "prismatic".
        parent: Index of the carrying body, -1 for the bedplate.
        axis: Unit vector e^j, (3,), constant in the frames of both bodies when taken
            through `rotation`; expressed in body j's frame.
        offset: l^ij from O^i to the joint's attachment point, (3,) [m], frame i.
        rotation: A, from frame j at q = 0 to frame i, (3, 3).
        position_range: Least and greatest position, (2,) [rad or m].
        max_velocity: [rad/s or m/s].
        max_effort: Greatest motor effort at the joint side [N m or N].
        coulomb: Dry friction level [N m or N].
        viscous: Viscous friction coefficient [N m s/rad or N s/m].
        rotor_inertia: Inertia of the drive reflected to the joint side [kg m^2 or kg].
    """

    name: str
    body: str
    kind: Kind
    parent: int
    axis: Array
    offset: Array
    rotation: Array
    position_range: Array = field(default_factory=lambda: np.array([-np.inf, np.inf]))
    max_velocity: float = np.inf
    max_effort: float = np.inf
    coulomb: float = 0.0
    viscous: float = 0.0
    rotor_inertia: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, axis=(3,), offset=(3,), rotation=(3, 3), position_range=(2,))

    @property
    def revolute(self) -> bool:
        """Whether the joint turns (else it slides)."""
        return self.kind == "revolute"

    @property
    def X_PB(self) -> Transform:
        """Pose of the body's frame B at q = 0 in that of its carrier, the parent P."""
        return Transform(self.rotation, self.offset)

    @property
    def carried_axis(self) -> Array:
        """The joint axis in the carrying body's frame, (3,)."""
        axis: Array = self.rotation @ self.axis
        return axis

    def flaw(self) -> str | None:
        """What no joint can have, in words that follow "has"; None if there is nothing."""
        return next(self._flaws(), None)

    def _flaws(self) -> Iterator[str]:
        """The first of them is a flaw in any case; others may follow from it."""
        placement = np.concatenate([self.offset, self.rotation.ravel(), self.axis])
        if not np.isfinite(placement).all():
            yield "a place or axis that is not a number"
        if not (np.abs(self.offset) <= FARTHEST).all():
            yield f"a place {np.abs(self.offset).max():.3g} m away; {FARTHEST:g} m is the limit"
        if abs(np.linalg.norm(self.axis) - 1) > UNIT:
            yield f"no direction: its axis is {self.axis.tolist()}"
        low, high = self.position_range
        if not low <= high:
            yield f"a range that ends before it begins: {low:g} to {high:g}"
        for what in ("coulomb", "viscous", "rotor_inertia"):
            value = getattr(self, what)
            if not 0 <= value < np.inf:
                yield f"{what.replace('_', ' ')} {value:g}, which is finite and not negative"
        for what in ("max_velocity", "max_effort"):
            value = getattr(self, what)
            if not value > 0:
                yield f"{what.replace('_', ' ')} {value:g}, which must be positive"

    def with_settings(self, settings: Mapping[str, object]) -> Joint:
        """The same joint with some of SETTABLE replaced.

        Args:
            settings: Values by name: numbers, and two numbers for `position_range`.

        Raises:
            UnknownName: A name is not in SETTABLE.
            ModelError: A value is none that a joint can have.
        """
        values: dict[str, Any] = {}
        for name, value in settings.items():
            if name not in SETTABLE:
                raise UnknownName(f"setting of joint '{self.name}'", name, SETTABLE)
            shape, form = (
                ((2,), "two numbers") if name == "position_range" else ((), "a number")
            )
            numbers = _numbers(value, shape)
            if numbers is None:
                raise ModelError(
                    f"joint '{self.name}': {name} is {form}, found {value!r:.60}"
                )
            values[name] = numbers if shape else float(numbers)
        joint = replace(self, **values)
        flaw = joint.flaw()
        if flaw:
            raise ModelError(f"joint '{self.name}' is given {flaw}")
        return joint


@dataclass(frozen=True)
class Shaft:
    """One shaft.

    Attributes:
        name: Its name; its friction is called coulomb/NAME.
        turns: Indices of its joints, and how much it turns with each.
    """

    name: str
    turns: tuple[tuple[int, float], ...]


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a wrench is measured, if not on the bedplate.

    Attributes:
        position: Of the sensor's origin in the body's frame, (3,) [m].
        rotation: From its axes to the body's, (3, 3).
        name: Of the sensor.
        body: Index of the body that it moves with, -1 for the bedplate.
    """

    position: Array
    rotation: Array
    name: str = ""
    body: int = -1

    def __post_init__(self) -> None:
        freeze(self, position=(3,), rotation=(3, 3))

    @property
    def X_BS(self) -> Transform:
        """Pose of the sensor S in the body's frame B."""
        return Transform(self.rotation, self.position)


@dataclass(frozen=True)
class ModelSource(Value):
    """A model file, and how it was read.

    Attributes:
        path: The MJCF or URDF file.
        weld_root: Weld a floating root to the bedplate.
        repair: Bodies in place of those that cannot be, by the link that carries them; {} refuses
            such a file, None takes the nearest bodies.
        lock: Joints that are held, and where [rad or m]; None: where the joint rests.
    """

    path: Path
    weld_root: bool = False
    repair: Mapping[str, Inertia] | None = None
    lock: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, repr=False)
class Tree(Diagnosed, Value):
    """An open tree of bodies on a bedplate.

    Attributes:
        name: The robot's name.
        joints: One joint a body, parents first.
        inertias: One inertia a body, about and along the body's frame.
        pedestal: What is welded to the bedplate, in the bedplate frame; known, not moving.
        gravity: Gravity acceleration, (3,) [m/s^2], bedplate frame.
        diagnostics: What was accepted on loading although it is wrong.
        shafts: Motor shafts that turn with several joints.
        floating: Whether the first six joints are the coordinates of a free base.
        lead: How many of the first joints, one after the other, move the base, which is the last
            one's body: the bodies before have no matter. 0 where the bedplate is the base.
        sensor: Where the wrench is measured, on the base; None for the bedplate.
        cuts: The next force sensors: what hangs beyond them is no part of the tree, its wrench
            is measured.
        bare: Bodies without matter of their own: all of it lies beyond such a sensor.
        file: The model file that it was read from; None for none.
    """

    name: str
    joints: tuple[Joint, ...]
    inertias: tuple[Inertia, ...]
    pedestal: Inertia = NOTHING
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    diagnostics: tuple[Diagnostic, ...] = ()
    shafts: tuple[Shaft, ...] = ()
    floating: bool = False
    lead: int = 0
    sensor: Placement | None = None
    cuts: tuple[Placement, ...] = ()
    bare: tuple[int, ...] = ()
    file: ModelSource | None = None

    def __post_init__(self) -> None:
        freeze(self, gravity=(3,))
        if len(self.joints) != len(self.inertias):
            raise ValueError(
                f"{len(self.joints)} joints carry {len(self.inertias)} inertias"
            )
        for j, joint in enumerate(self.joints):
            if not -1 <= joint.parent < j:
                raise ValueError(
                    f"joint '{joint.name}' ({j}) precedes its parent {joint.parent}"
                )

    def __repr__(self) -> str:
        joints = ", ".join(f"{each.name} ({each.kind})" for each in self.joints)
        return f"<Tree {self.name!r}, {plural(self.n, 'joint')}: {joints}>"

    @property
    def summary(self) -> SummaryTable:
        """Joints, their kinds, and their bodies with masses."""
        rows = [
            (joint.name, joint.kind, joint.body, f"{body.mass:.4g} kg")
            for joint, body in zip(self.joints, self.inertias, strict=True)
        ]
        return SummaryTable(f"{self.name}: {plural(self.n, 'joint')}", tuple(rows))

    @property
    def n(self) -> int:
        """Number of moving bodies, which is the number of joints."""
        return len(self.joints)

    @property
    def massless(self) -> int:
        """How many of the first bodies have no matter: those that lead to a base that moves."""
        return max(self.lead - 1, 0)

    @property
    def is_part(self) -> bool:
        """Whether it is what lies between force sensors, not the whole robot."""
        return self.sensor is not None or bool(self.cuts)

    @property
    def sensor_body(self) -> int:
        """Index of the body that what measures the wrench moves with, -1 for the bedplate."""
        return -1 if self.sensor is None else self.sensor.body

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Joint names; the order of all columns."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """INBODY: index of the body that carries each joint, -1 for the bedplate."""
        return tuple(joint.parent for joint in self.joints)

    @property
    def reach(self) -> Array:
        """T of [FRS96] eq. (1): T[i, j] = 1 if body i lies on the chain to body j; (n, n)."""
        reach = np.eye(self.n)
        for j, parent in enumerate(self.parents):
            if parent >= 0:
                reach[:, j] += reach[:, parent]
        return readonly(reach, (self.n, self.n), "reach")

    @cached_property
    def zero_poses(self) -> tuple[Transform, ...]:
        """Pose X_WB of every body in the bedplate frame W at q = 0."""
        poses: list[Transform] = []
        for joint in self.joints:
            X_PB = joint.X_PB
            poses.append(X_PB if joint.parent < 0 else poses[joint.parent] @ X_PB)
        return tuple(poses)

    def gravity_or(self, gravity: ArrayLike | None) -> Array:
        """The given gravity, or the model file's if None, (3,) [m/s^2], bedplate frame.

        Raises:
            ModelError: It is not three finite numbers.
            SettingsError: It is a text, and none of `MOUNTINGS`.
        """
        vector = _numbers(
            gravity_of(self.gravity if gravity is None else gravity), (3,)
        )
        if vector is None or not np.isfinite(vector).all():
            raise ModelError(
                f"gravity is three finite numbers [m/s^2], found {gravity!s:.60}"
            )
        size = math.hypot(*vector)  # overflows and vanishes only where numbers do
        if vector.any() and not WEAKEST <= size <= STRONGEST:
            raise ModelError(
                f"gravity of {size:.3g} m/s^2 is outside {WEAKEST:g} ... {STRONGEST:g}; "
                "0 0 0 is weightlessness"
            )
        return readonly(vector, (3,), "gravity")

    def with_gravity(self, gravity: ArrayLike | None) -> Tree:
        """The same tree under another gravity.

        Args:
            gravity: (3,) [m/s^2], bedplate frame; None leaves the model file's.

        Raises:
            ModelError: It is not three finite numbers, or no gravity there is.
        """
        return replace(self, gravity=self.gravity_or(gravity))

    def with_joints(self, settings: Mapping[str, Mapping[str, object]]) -> Tree:
        """The same tree with limits, friction or rotor inertias that the model file lacks.

        Args:
            settings: By joint name, what is to be replaced: `position_range` (two numbers),
                `max_velocity`, `max_effort`, `coulomb`, `viscous`, `rotor_inertia`; units as
                in Joint.

        Raises:
            UnknownName: There is no such joint, or no such setting.
            ModelError: A value is none that a joint can have.
        """
        joints = list(self.joints)
        for name, values in settings.items():
            k = self.index(name)
            joints[k] = joints[k].with_settings(values)
        return replace(self, joints=tuple(joints))

    def children(self, body: int) -> tuple[int, ...]:
        """Bodies carried directly by `body` (-1: by the bedplate)."""
        return self._children.get(body, ())

    @cached_property
    def _children(self) -> dict[int, tuple[int, ...]]:
        carried: dict[int, tuple[int, ...]] = {}
        for j, joint in enumerate(self.joints):
            carried[joint.parent] = (*carried.get(joint.parent, ()), j)
        return carried

    def chain(self, body: int) -> tuple[int, ...]:
        """The bodies from the bedplate's child up to and including `body`; () for -1."""
        links: list[int] = []
        while body >= 0:
            links.append(body)
            body = self.parents[body]
        return tuple(reversed(links))

    def index(self, name: str) -> int:
        """Position of the joint called `name`.

        Raises:
            UnknownName: There is no such joint.
        """
        if name not in self.names:
            raise UnknownName("joint", name, self.names)
        return self.names.index(name)

    def with_inertia(self, link: int, more: Inertia) -> Tree:
        """The same tree with more on one link.

        Args:
            link: Index of the body, -1 for the bedplate.
            more: What is added, about and along the body's frame.
        """
        if link < 0:
            return replace(self, pedestal=self.pedestal + more)
        bodies = [
            body + more if k == link else body for k, body in enumerate(self.inertias)
        ]
        return replace(self, inertias=tuple(bodies))

    def without_friction(self) -> Tree:
        """The same tree with joints that do not rub."""
        joints = tuple(
            replace(joint, coulomb=0.0, viscous=0.0) for joint in self.joints
        )
        return replace(self, joints=joints)

    def without_inertias(self) -> Tree:
        """The same tree with no masses and no friction: all that an estimator may know."""
        joints = tuple(
            replace(joint, rotor_inertia=0.0)
            for joint in self.without_friction().joints
        )
        return replace(self, inertias=(NOTHING,) * self.n, joints=joints)


def require_tree(value: object, call: str) -> None:
    """Refuse a first argument that is no robot.

    Args:
        value: The argument.
        call: The call, as "identify(robot, data)".

    Raises:
        SettingsError: Says what it is instead.
    """
    if not isinstance(value, Tree):
        kind = type(value).__name__
        what = f"'{value}'" if isinstance(value, str | Path) else f"a {kind}"
        raise SettingsError(
            f"{call}: the robot is a Tree, as load_tree(path) reads it; {what} was given in its "
            "place"
        )


def _numbers(value: object, shape: tuple[int, ...]) -> Array | None:
    """Numbers of a shape, as they come from files and callers; None if they are none.

    NaN is no number here, infinity is one.
    """
    kinds = {type(part) for part in (value if isinstance(value, list | tuple) else ())}
    if kinds & {bool, str, bytes} or isinstance(value, bool | str | bytes):
        return None
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):  # no number, ragged, or over 1e308
        return None
    return None if numbers.shape != shape or np.isnan(numbers).any() else numbers
