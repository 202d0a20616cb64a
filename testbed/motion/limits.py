"""What a motion may ask of the robot, and whether it does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.errors import InfeasibleMotion
from testbed.core.dynamics.newton_euler import Motion, joint_forces
from testbed.core.robot.friction import COULOMB, ROTOR, VISCOUS, drive_torque
from testbed.core.robot.tree import Joint, Tree
from testbed.motion.samples import Instants, Samples

CALM = {"revolute": (np.pi, 2.0, 6.0), "prismatic": (0.5, 0.5, 2.0)}
"""Half range, velocity and acceleration where neither file nor user gives a limit."""
ENDLESS = 100.0
"""Times that half range: a range beyond is none, as the 1e16 rad of a rotor that turns freely."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds on positions, velocities, accelerations and efforts, joint by joint.

    Attributes:
        low: Least position, (n,) [rad or m].
        high: Greatest position, (n,) [rad or m].
        velocity: Greatest speed, (n,) [rad/s or m/s].
        acceleration: Greatest acceleration, (n,) [rad/s^2 or m/s^2].
        effort: Greatest motor effort, (n,) [N m or N].
    """

    low: Array
    high: Array
    velocity: Array
    acceleration: Array
    effort: Array

    def __post_init__(self) -> None:
        n = len(self.low)
        freeze(self, low=(n,), high=(n,), velocity=(n,), acceleration=(n,), effort=(n,))

    @property
    def middle(self) -> Array:
        """Of the ranges of positions, (n,) [rad or m]."""
        return (self.low + self.high) / 2

    @property
    def half(self) -> Array:
        """Half the ranges of positions, (n,) [rad or m]."""
        return (self.high - self.low) / 2

    @property
    def home(self) -> Array:
        """The posture of zeros, or what is nearest to it within the limits, (n,) [rad or m]."""
        return np.clip(np.zeros(len(self.low)), self.low, self.high)


def limits_of(
    tree: Tree,
    velocity: Mapping[str, float] | None = None,
    acceleration: Mapping[str, float] | None = None,
) -> Limits:
    """The model file's limits, narrowed by the user's, completed by calm defaults.

    Args:
        tree: The robot.
        velocity: Greatest speed by joint name [rad/s or m/s].
        acceleration: Greatest acceleration by joint name [rad/s^2 or m/s^2].

    Raises:
        UnknownName: A limit is given for a joint that the robot lacks.
        InfeasibleMotion: A joint has no room to move.
    """
    velocity, acceleration = velocity or {}, acceleration or {}
    for name in (*velocity, *acceleration):
        tree.index(name)

    def speed(joint: Joint) -> float:
        known = min(joint.max_velocity, velocity.get(joint.name, np.inf))
        return known if np.isfinite(known) else CALM[joint.kind][1]

    ranges = np.array([_range(joint) for joint in tree.joints])
    for joint, (low, high) in zip(tree.joints, ranges, strict=True):
        if low == high:
            raise InfeasibleMotion(f"joint '{joint.name}' has no room to move: {low:g} to {high:g}")
    return Limits(
        low=ranges[:, 0],
        high=ranges[:, 1],
        velocity=np.array([speed(joint) for joint in tree.joints]),
        acceleration=np.array([acceleration.get(j.name, CALM[j.kind][2]) for j in tree.joints]),
        effort=np.array([joint.max_effort for joint in tree.joints]),
    )


def motor_efforts(tree: Tree, motion: Motion) -> Array:
    """What the motors must deliver, friction and rotor inertia included, (M, n) [N m or N]."""
    return joint_forces(tree, motion) + drive_torque(tree, motion.qd, motion.qdd)


def _range(joint: Joint) -> tuple[float, float]:
    half = CALM[joint.kind][0]
    low, high = (
        end if abs(end) <= ENDLESS * half else np.copysign(np.inf, end)
        for end in joint.position_range
    )
    if np.isfinite(low) and np.isfinite(high):
        return low, high
    return (
        (low, low + 2 * half) if np.isfinite(low) else (min(high, half) - 2 * half, min(high, half))
    )


@dataclass(frozen=True, eq=False)
class ForceBounds:
    """Bounds of the magnitudes of second derivatives, in W spans of time.

    Attributes:
        joints: Of the joints' forces, drives and friction aside, (n, W) [N m/s^2 or N/s^2].
        force: Of the bedplate's force, or of a force sensor's, (W,) [N/s^2].
        moment: Of its moment about O^0, or about the sensor's origin, (W,) [N m/s^2].
        motion: Of the joints' derivatives of order 0 to 4 themselves, (5, n, W).
    """

    joints: Array
    force: Array
    moment: Array
    motion: Array


def force_bounds(tree: Tree, motion: Array) -> ForceBounds:
    """Bounds of how fast forces change.

    Args:
        tree: The robot, its inertias an a-priori model.
        motion: Bounds of |q|, |qd|, |qdd| and of the next two derivatives, (5, n, W).
    """
    still = np.zeros((3, motion.shape[2]))
    falling = still.copy()
    falling[0] = np.linalg.norm(tree.gravity)
    ground = _Moving(still, still, falling, still, still)
    moving: list[_Moving] = []
    for joint, own in zip(tree.joints, motion.transpose(1, 0, 2), strict=True):
        carrier = ground if joint.parent < 0 else moving[joint.parent]
        moving.append(_carried(joint, carrier, own))
    force, moment = np.zeros((2, tree.n + 1, *still.shape))  # the last one is the bedplate's
    joints = np.empty((tree.n, motion.shape[2]))
    for j in reversed(range(tree.n)):
        joint, body, here = tree.joints[j], tree.inertias[j], moving[j]
        first = float(np.linalg.norm(body.first_moment))
        second = float(np.linalg.norm(body.tensor, 2))
        force[j] += abs(body.mass) * here.linear + first * here.turning
        moment[j] += first * here.linear + second * (here.angular + _times(here.speed, here.speed))
        joints[j] = (moment if joint.revolute else force)[j, 2]
        passed = _times(here.rotation, force[j])
        force[joint.parent] += passed
        moment[joint.parent] += _times(here.rotation, moment[j]) + _times(here.lever, passed)
    felt, turned = force[tree.sensor_body, 2], moment[tree.sensor_body, 2]
    if tree.sensor is not None:
        turned = turned + float(np.linalg.norm(tree.sensor.position)) * felt
    return ForceBounds(joints, felt, turned, motion)


@dataclass(frozen=True, eq=False)
class _Moving:
    """Jets of a body's motion, (3, W) each, in its own axes."""

    speed: Array  # angular velocity
    angular: Array  # angular acceleration
    linear: Array  # acceleration of its origin less gravity
    rotation: Array  # from its axes to its carrier's
    lever: Array  # from its carrier's origin to its own

    @property
    def turning(self) -> Array:
        """What a point a metre away has more of acceleration."""
        return self.angular + _times(self.speed, self.speed)


def _carried(joint: Joint, carrier: _Moving, own: Array) -> _Moving:
    """The jets of a body on its carrier; `own` are bounds of its joint's derivatives, (5, W)."""
    position, speed, acceleration = own[:3], own[1:4], own[2:5]
    lever = np.zeros_like(position)
    lever[0] = np.linalg.norm(joint.offset)
    rotation = np.zeros_like(position)
    rotation[0] = 1.0
    if joint.revolute:
        rotation[1], rotation[2] = own[1], own[2] + own[1] ** 2
        turned = _times(rotation, carrier.speed)
        angular = _times(rotation, carrier.angular) + _times(turned, speed) + acceleration
        linear = _times(rotation, carrier.linear + _times(carrier.turning, lever))
        return _Moving(turned + speed, angular, linear, rotation, lever)
    lever = lever + position
    linear = carrier.linear + _times(carrier.turning, lever) + acceleration
    linear = linear + 2 * _times(carrier.speed, speed)
    return _Moving(carrier.speed, carrier.angular, linear, rotation, lever)


def _times(a: Array, b: Array) -> Array:
    """The jet of a product."""
    second = a[2] * b[0] + 2 * a[1] * b[1] + a[0] * b[2]
    return np.stack([a[0] * b[0], a[1] * b[0] + a[0] * b[1], second])


class LimitTerm(Protocol):
    """Some limits at every instant."""

    @property
    def labels(self) -> tuple[str, ...]:
        """What each is a limit of, (k,)."""

    def values(self, samples: Instants) -> Array:
        """Shares less what is allowed, (k, G); below zero inside."""

    def slopes(self, samples: Samples) -> Array:
        """Their derivatives by q, then qd, then qdd, (k, 3 n, G)."""


class SmoothTerm(LimitTerm, Protocol):
    """Limits whose second derivative by time has a bound: they can be proven between samples."""

    def curvatures(self, bounds: ForceBounds) -> Array:
        """Bounds of the second derivatives of `values` by time, (k, W) [1/s^2]."""


@dataclass(frozen=True, eq=False)
class PlateRange:
    """What the plate can measure, and on what it stands.

    Attributes:
        wrench: Largest magnitude of each channel, pedestal included, (6,) [N, N m]; infinite
            for no limit.
        half: Half lengths along x and y of the area in which the centre of pressure stays, (2,)
            [m]; None for a plate that is bolted down.
    """

    wrench: Array
    half: Array | None = None

    def __post_init__(self) -> None:
        freeze(self, wrench=(6,))
        if self.half is not None:
            freeze(self, half=(2,))
        if not (self.wrench > 0).all() or (self.half is not None and not (self.half > 0).all()):
            raise InfeasibleMotion("the plate's ranges and half lengths must be positive")

    def rows(self, margin: float) -> tuple[tuple[str, ...], Array, Array]:
        """Labels, combinations of the wrench as shares of limits, (k, 6), and their bounds, (k,).

        Args:
            margin: Share of each range that may be used.
        """
        labels, rows, most = [], [], []
        for c in np.flatnonzero(np.isfinite(self.wrench)):
            labels += 2 * [f"plate {CHANNELS[c]}"]
            rows += [sign * np.eye(6)[c] / self.wrench[c] for sign in (1.0, -1.0)]
            most += [margin, margin]
        for axis, half in enumerate(() if self.half is None else self.half):
            labels += 2 * [f"centre of pressure along {'xy'[axis]}"]
            for sign in (1.0, -1.0):  # |My| <= x Fz, |Mx| <= y Fz
                row = sign * np.eye(6)[4 - axis]
                row[2] = -margin * half
                rows.append(row / (PRESSURE * half))
                most.append(0.0)
        return tuple(labels), np.array(rows).reshape(-1, 6), np.array(most)


CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
PRESSURE = 100.0
"""Force at which a centre of pressure at the edge counts as a share of one [N]."""


class PlateTerm:
    """The plate's ranges, and the centre of pressure on it.

    Attributes:
        labels: What each is a limit of, (k,).
    """

    def __init__(self, plate: PlateRange, pedestal: Array, margin: float) -> None:
        """Ready to be asked.

        Args:
            plate: The ranges.
            pedestal: Wrench on what stands on the plate without moving, (6,) [N, N m].
            margin: Share of each range that may be used.
        """
        self.labels, self._rows, most = plate.rows(margin)
        self._most = most - self._rows @ pedestal

    def values(self, samples: Instants) -> Array:
        """Shares less what is allowed, (k, G)."""
        return self._rows @ samples.forces("reaction") - self._most[:, None]

    def slopes(self, samples: Samples) -> Array:
        """Derivatives, (k, 3 n, G)."""
        return np.tensordot(self._rows, samples.force_slopes("reaction"), 1)

    def curvatures(self, bounds: ForceBounds) -> Array:
        """Bounds of second derivatives by time, (k, W)."""
        force, moment = (np.linalg.norm(part, axis=1) for part in np.hsplit(self._rows, 2))
        return np.outer(force, bounds.force) + np.outer(moment, bounds.moment)


class EffortTerm:
    """Motor efforts, with friction of either sign: a joint that rests may stick either way."""

    def __init__(self, tree: Tree, limits: Limits, margin: float) -> None:
        """Ready to be asked.

        Args:
            tree: The robot, its inertias and friction an a-priori model.
            limits: Of the motors.
            margin: Share of each that may be used.

        Raises:
            InfeasibleMotion: A motor cannot overcome its joint's dry friction.
        """
        self._joints = np.flatnonzero(np.isfinite(limits.effort))
        self._names = tuple(tree.names[j] for j in self._joints)
        self._effort = limits.effort[self._joints]
        self._viscous, self._rotor = VISCOUS.coefficients(tree), ROTOR.coefficients(tree)
        self._most = margin - COULOMB.coefficients(tree)[self._joints] / self._effort
        for name, left in zip(self._names, self._most, strict=True):
            if left <= 0:
                raise InfeasibleMotion(
                    f"the motor of joint '{name}' is too weak for its dry friction: nothing of its "
                    "effort limit is left for a motion; correct max_effort or coulomb"
                )

    @property
    def labels(self) -> tuple[str, ...]:
        """What each is a limit of."""
        return tuple(f"effort of '{name}'" for name in self._names for _ in range(2))

    def values(self, samples: Instants) -> Array:
        """Shares less what is allowed, (2 k, G)."""
        torque = samples.forces("dynamic") + _along(self._viscous, samples.qd)
        torque += _along(self._rotor, samples.qdd)
        share = torque[self._joints] / self._effort[:, None]
        both = np.stack([share, -share], axis=1) - self._most[:, None, None]
        return both.reshape(-1, share.shape[1])

    def slopes(self, samples: Samples) -> Array:
        """Derivatives, (2 k, 3 n, G)."""
        n = samples.q.shape[1]
        slopes = samples.force_slopes("dynamic").copy()
        own = np.arange(n)
        slopes[own, n + own] += self._viscous[:, None]
        slopes[own, 2 * n + own] += self._rotor[:, None]
        share = slopes[self._joints] / self._effort[:, None, None]
        return np.stack([share, -share], axis=1).reshape(-1, *share.shape[1:])

    def curvatures(self, bounds: ForceBounds) -> Array:
        """Bounds of second derivatives by time, (2 k, W)."""
        lost = self._viscous[:, None] * bounds.motion[3] + self._rotor[:, None] * bounds.motion[4]
        share = (bounds.joints + lost)[self._joints] / self._effort[:, None]
        return np.repeat(share, 2, axis=0)


def _along(coefficients: Array, motion: Array) -> Array:
    """Coefficients times what joints do, (n, G)."""
    return coefficients[:, None] * motion.T
