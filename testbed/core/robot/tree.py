"""Robot model: rigid bodies joined in an open kinematic tree on a bedplate.

Joint j connects body j to the carrying body `parents[j]`; the bedplate has the index -1. Parents
have smaller indices than children. Names and columns of data are in the order of the joints.

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

from testbed.core.base.arrays import Array, freeze_arrays, readonly_array
from testbed.core.base.diagnostics import Diagnosed, Diagnostic
from testbed.core.base.errors import (
    ModelError,
    SettingsError,
    UnknownName,
    count_with_noun,
)
from testbed.core.base.summary_table import SummaryTable, Value
from testbed.core.base.transform import Transform
from testbed.core.robot.gravity import parse_gravity
from testbed.core.robot.inertia import ZERO_INERTIA, Inertia

JointKind = Literal["revolute", "prismatic"]


MIN_GRAVITY, MAX_GRAVITY = 1e-6, 1e4
"""Range of plausible magnitudes of nonzero gravity [m/s^2]."""

MAX_COORDINATE = 1e6
"""Largest accepted coordinate of a position in a model file [m]."""

AXIS_NORM_TOLERANCE = 1e-6
"""Largest accepted deviation of an axis vector's length from one, due to rounding in files."""

SETTABLE_FIELDS = (
    "position_range",
    "max_velocity",
    "max_effort",
    "coulomb",
    "viscous",
    "rotor_inertia",
)
"""Fields of `Joint` that may be replaced by more accurate values."""


@dataclass(frozen=True, eq=False)
class Joint(Value):
    """Joint with one degree of freedom, and pose of its body on the carrying body.

    A point x_j of body j has, in frame i of the carrying body, the coordinates
    x_i = l + A Rot(e, q) x_j (revolute joint) or x_i = l + A (e q + x_j) (prismatic joint).
    Limits not stated in the file are infinite, friction and rotor inertia not stated are zero.

    Attributes:
        name: Joint name in the model file.
        body: Name of the body that the joint moves.
        kind: "revolute" or "prismatic".
        parent: Index of the carrying body, -1 for the bedplate.
        axis: Unit vector e^j of the joint axis in body j's frame, (3,).
        offset: Vector l^ij from O^i to the joint's attachment point, in frame i, (3,) [m].
        rotation: Rotation matrix A from frame j at q = 0 to frame i, (3, 3).
        position_range: Lower and upper position limit, (2,) [rad or m].
        max_velocity: Largest speed [rad/s or m/s].
        max_effort: Largest motor torque or force at the joint side [N m or N].
        coulomb: Coulomb friction [N m or N].
        viscous: Viscous friction coefficient [N m s/rad or N s/m].
        rotor_inertia: Rotor inertia reflected to the joint side [kg m^2 or kg].
    """

    name: str
    body: str
    kind: JointKind
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
        freeze_arrays(
            self, axis=(3,), offset=(3,), rotation=(3, 3), position_range=(2,)
        )

    @property
    def revolute(self) -> bool:
        """True for a revolute joint, False for a prismatic joint."""
        return self.kind == "revolute"

    @property
    def X_PB(self) -> Transform:
        """Pose X_PB of body frame B in the carrying body's frame P, at `q = 0`."""
        return Transform(self.rotation, self.offset)

    @property
    def carried_axis(self) -> Array:
        """Unit vector of the joint axis in the carrying body's frame, (3,)."""
        axis: Array = self.rotation @ self.axis
        return axis

    def flaw(self) -> str | None:
        """First invalid property of the joint, as the object of "has"; None if valid."""
        return next(self._flaws(), None)

    def _flaws(self) -> Iterator[str]:
        """Yield descriptions of invalid placement, axis, limits, friction and rotor inertia.

        The texts are objects of "has"; later texts may be consequences of the first.
        """
        placement = np.concatenate([self.offset, self.rotation.ravel(), self.axis])
        if not np.isfinite(placement).all():
            yield "a place or axis that is not a number"
        if not (np.abs(self.offset) <= MAX_COORDINATE).all():
            yield (
                f"a place {np.abs(self.offset).max():.3g} m away; "
                f"{MAX_COORDINATE:g} m is the limit"
            )
        if abs(np.linalg.norm(self.axis) - 1) > AXIS_NORM_TOLERANCE:
            yield f"no direction: its axis is {self.axis.tolist()}"
        low, high = self.position_range
        if not low <= high:
            yield f"a range that ends before it begins: {low:g} to {high:g}"
        for field_name in ("coulomb", "viscous", "rotor_inertia"):
            value = getattr(self, field_name)
            if not 0 <= value < np.inf:
                yield f"{field_name.replace('_', ' ')} {value:g}, which is finite and not negative"
        for field_name in ("max_velocity", "max_effort"):
            value = getattr(self, field_name)
            if not value > 0:
                yield f"{field_name.replace('_', ' ')} {value:g}, which must be positive"

    def with_settings(self, settings: Mapping[str, object]) -> Joint:
        """Joint with some of SETTABLE_FIELDS replaced.

        Args:
            settings: Values keyed by field name: two numbers for `position_range`, one number for
                others.

        Raises:
            UnknownName: A name is not in SETTABLE_FIELDS.
            ModelError: A value is invalid for a joint.
        """
        values: dict[str, Any] = {}
        for name, value in settings.items():
            if name not in SETTABLE_FIELDS:
                raise UnknownName(
                    f"setting of joint '{self.name}'", name, SETTABLE_FIELDS
                )
            shape, form = (
                ((2,), "two numbers") if name == "position_range" else ((), "a number")
            )
            numbers = _float_array(value, shape)
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
    """Motor shaft coupled to several joints.

    Attributes:
        name: Shaft name; its friction coefficient is called coulomb/NAME.
        turns: Pairs of a joint index and the turns of the shaft per turn of this joint.
    """

    name: str
    turns: tuple[tuple[int, float], ...]


@dataclass(frozen=True, eq=False)
class SensorPlacement:
    """Pose of a force sensor on a body or on the bedplate.

    Attributes:
        position: Sensor origin in the body's frame, (3,) [m].
        rotation: Rotation matrix from sensor axes to body axes, (3, 3).
        name: Sensor name.
        body: Index of the body that carries the sensor, -1 for the bedplate.
    """

    position: Array
    rotation: Array
    name: str = ""
    body: int = -1

    def __post_init__(self) -> None:
        freeze_arrays(self, position=(3,), rotation=(3, 3))

    @property
    def X_BS(self) -> Transform:
        """Pose of the sensor frame S in the body frame B."""
        return Transform(self.rotation, self.position)


@dataclass(frozen=True)
class ModelSource(Value):
    """Path of a model file, and options for reading.

    Attributes:
        path: MJCF or URDF file.
        weld_root: True to weld a floating root to the bedplate.
        repair: Replacements for physically inconsistent inertias of lumped bodies, keyed by the
            link to which the others are fixed; {} rejects inconsistent inertias, None selects the
            nearest consistent inertias.
        lock: Positions of locked joints, keyed by name [rad or m]; None for the rest position.
    """

    path: Path
    weld_root: bool = False
    repair: Mapping[str, Inertia] | None = None
    lock: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, repr=False)
class Tree(Diagnosed, Value):
    """Open kinematic tree of rigid bodies on a bedplate.

    Attributes:
        name: Robot name.
        joints: Joints, one per body, parents first.
        inertias: Inertias, one per body, relative to the body's frame.
        pedestal: Known inertia of the parts welded to the bedplate, in the bedplate frame.
        gravity: Gravity acceleration, (3,) [m/s^2], bedplate frame.
        diagnostics: Diagnostics of faults in the model file that were accepted on loading.
        shafts: Motor shafts coupled to several joints.
        floating: True if the first six joints are the coordinates of a free base.
        lead: Number of leading joints, in series, that move the base, the body of the last leading
            joint; the bodies before are massless. 0 if the bedplate is the base.
        sensor: Placement of the force sensor on the base; None for the bedplate.
        cuts: Placements of the next force sensors; the links beyond these sensors are not part of
            the tree, as their wrench is measured.
        bare: Indices of bodies without mass, as all their links are beyond a sensor of `cuts`.
        file: Model file that the tree was read from, if any.
    """

    name: str
    joints: tuple[Joint, ...]
    inertias: tuple[Inertia, ...]
    pedestal: Inertia = ZERO_INERTIA
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    diagnostics: tuple[Diagnostic, ...] = ()
    shafts: tuple[Shaft, ...] = ()
    floating: bool = False
    lead: int = 0
    sensor: SensorPlacement | None = None
    cuts: tuple[SensorPlacement, ...] = ()
    bare: tuple[int, ...] = ()
    file: ModelSource | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self, gravity=(3,))
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
        return f"<Tree {self.name!r}, {count_with_noun(self.n, 'joint')}: {joints}>"

    @property
    def summary(self) -> SummaryTable:
        """Table of joints with kinds, bodies and masses, for display."""
        rows = [
            (joint.name, joint.kind, joint.body, f"{body.mass:.4g} kg")
            for joint, body in zip(self.joints, self.inertias, strict=True)
        ]
        return SummaryTable(
            f"{self.name}: {count_with_noun(self.n, 'joint')}", tuple(rows)
        )

    @property
    def n(self) -> int:
        """Number of joints, equal to the number of moving bodies."""
        return len(self.joints)

    @property
    def massless(self) -> int:
        """Number of massless leading bodies between the bedplate and a moving base."""
        return max(self.lead - 1, 0)

    @property
    def is_part(self) -> bool:
        """True for a segment between force sensors, False for a whole robot."""
        return self.sensor is not None or bool(self.cuts)

    @property
    def sensor_body(self) -> int:
        """Index of the body that carries the wrench sensor, -1 for the bedplate."""
        return -1 if self.sensor is None else self.sensor.body

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Joint names, in the order of all data columns."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """Index of the body that carries each joint (INBODY), -1 for the bedplate."""
        return tuple(joint.parent for joint in self.joints)

    @property
    def reach(self) -> Array:
        """Ancestor matrix T of [FRS96] eq. (1), (n, n).

        T[i, j] = 1 if body i lies on the chain from the bedplate to body j, else 0.
        """
        reach = np.eye(self.n)
        for j, parent in enumerate(self.parents):
            if parent >= 0:
                reach[:, j] += reach[:, parent]
        return readonly_array(reach, (self.n, self.n), "reach")

    @cached_property
    def zero_poses(self) -> tuple[Transform, ...]:
        """Pose X_WB of each body in the bedplate frame W at q = 0."""
        poses: list[Transform] = []
        for joint in self.joints:
            X_PB = joint.X_PB
            poses.append(X_PB if joint.parent < 0 else poses[joint.parent] @ X_PB)
        return tuple(poses)

    def gravity_or(self, gravity: ArrayLike | None) -> Array:
        """Checked gravity vector in the bedplate frame, (3,) [m/s^2].

        Args:
            gravity: Three numbers [m/s^2], a text for `parse_gravity`, or None for the tree's
                gravity.

        Raises:
            ModelError: The value is not three finite numbers, or its magnitude is neither zero nor
                between MIN_GRAVITY and MAX_GRAVITY.
            SettingsError: The text is neither three numbers nor a key of GRAVITY_BY_MOUNTING.
        """
        vector = _float_array(
            parse_gravity(self.gravity if gravity is None else gravity), (3,)
        )
        if vector is None or not np.isfinite(vector).all():
            raise ModelError(
                f"gravity is three finite numbers [m/s^2], found {gravity!s:.60}"
            )
        size = math.hypot(*vector)  # hypot avoids overflow and underflow of squares
        if vector.any() and not MIN_GRAVITY <= size <= MAX_GRAVITY:
            raise ModelError(
                f"gravity of {size:.3g} m/s^2 is outside {MIN_GRAVITY:g} ... {MAX_GRAVITY:g}; "
                "0 0 0 is weightlessness"
            )
        return readonly_array(vector, (3,), "gravity")

    def with_gravity(self, gravity: ArrayLike | None) -> Tree:
        """Tree with another gravity vector.

        Args:
            gravity: Gravity in the bedplate frame, (3,) [m/s^2]; None for the tree's gravity.

        Raises:
            ModelError: The value is invalid for `gravity_or`.
        """
        return replace(self, gravity=self.gravity_or(gravity))

    def with_joints(self, settings: Mapping[str, Mapping[str, object]]) -> Tree:
        """Tree with limits, friction or rotor inertias of some joints replaced.

        Args:
            settings: New values, keyed by joint name, then by field: `position_range` (two
                numbers), `max_velocity`, `max_effort`, `coulomb`, `viscous`, `rotor_inertia`; units
                as in `Joint`.

        Raises:
            UnknownName: No joint or no field has the name.
            ModelError: A value is invalid for a joint.
        """
        joints = list(self.joints)
        for name, values in settings.items():
            k = self.index(name)
            joints[k] = joints[k].with_settings(values)
        return replace(self, joints=tuple(joints))

    def children(self, body: int) -> tuple[int, ...]:
        """Indices of the bodies carried directly by `body`; -1 is the bedplate."""
        return self._children.get(body, ())

    @cached_property
    def _children(self) -> dict[int, tuple[int, ...]]:
        """Indices of the directly carried bodies, keyed by carrying body; -1 is the bedplate."""
        carried: dict[int, tuple[int, ...]] = {}
        for j, joint in enumerate(self.joints):
            carried[joint.parent] = (*carried.get(joint.parent, ()), j)
        return carried

    def chain(self, body: int) -> tuple[int, ...]:
        """Indices of the bodies from the bedplate to `body`, inclusive; () for -1."""
        links: list[int] = []
        while body >= 0:
            links.append(body)
            body = self.parents[body]
        return tuple(reversed(links))

    def index(self, name: str) -> int:
        """Index of the joint with the name `name`.

        Raises:
            UnknownName: No joint has the name.
        """
        if name not in self.names:
            raise UnknownName("joint", name, self.names)
        return self.names.index(name)

    def with_inertia(self, body: int, addition: Inertia) -> Tree:
        """Tree with an inertia added to one body.

        Args:
            body: Index of the body, -1 for the bedplate.
            addition: Added inertia, relative to the body's frame.
        """
        if body < 0:
            return replace(self, pedestal=self.pedestal + addition)
        inertias = [
            inertia + addition if k == body else inertia
            for k, inertia in enumerate(self.inertias)
        ]
        return replace(self, inertias=tuple(inertias))

    def without_friction(self) -> Tree:
        """Tree with zero Coulomb and viscous friction in all joints."""
        joints = tuple(
            replace(joint, coulomb=0.0, viscous=0.0) for joint in self.joints
        )
        return replace(self, joints=joints)

    def without_inertias(self) -> Tree:
        """Tree with zero body inertias, friction and rotor inertias, and unchanged geometry."""
        joints = tuple(
            replace(joint, rotor_inertia=0.0)
            for joint in self.without_friction().joints
        )
        return replace(self, inertias=(ZERO_INERTIA,) * self.n, joints=joints)


def require_tree(value: object, call: str) -> None:
    """Raise an error if the first argument of a function is not a `Tree`.

    Args:
        value: First argument.
        call: Text of the call, for example "identify(robot, data)".

    Raises:
        SettingsError: The value is of another type.
    """
    if not isinstance(value, Tree):
        kind = type(value).__name__
        what = f"'{value}'" if isinstance(value, str | Path) else f"a {kind}"
        raise SettingsError(
            f"{call}: the robot is a Tree, as load_tree(path) reads it; {what} was given in its "
            "place"
        )


def _float_array(value: object, shape: tuple[int, ...]) -> Array | None:
    """Array of floats of a required shape; None for NaN, booleans, texts and other shapes.

    Infinity is accepted.
    """
    kinds = {type(part) for part in (value if isinstance(value, list | tuple) else ())}
    if kinds & {bool, str, bytes} or isinstance(value, bool | str | bytes):
        return None
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):  # no number, ragged, or over 1e308
        return None
    return None if numbers.shape != shape or np.isnan(numbers).any() else numbers
