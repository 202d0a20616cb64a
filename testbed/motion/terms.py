"""Limits of forces as functions of a motion: plate, force sensors, motors; with their bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.errors import InfeasibleMotion
from testbed.core.dynamics.newton_euler import Motion, base_wrench, pedestal_wrench
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.parameters.rules import Model
from testbed.core.robot.friction import COULOMB, ROTOR, VISCOUS
from testbed.core.robot.tree import Joint, Tree
from testbed.motion.limits import Limits
from testbed.motion.samples import MotionSamples, SampledRows, Samples


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

    def of(self, model: Model) -> Array:
        """Of the joints' forces, (n, W), or of the wrench, (6, W)."""
        if model == "dynamic":
            return self.joints
        return np.repeat([self.force, self.moment], 3, axis=0)


def force_bounds(tree: Tree, motion: Array) -> ForceBounds:
    """Bounds of how fast forces change.

    Args:
        tree: The robot, its inertias an a-priori model.
        motion: Bounds of |q|, |qd|, |qdd| and of the next two derivatives, (5, n, W).
    """
    spans, moving = motion.shape[2], _jets(tree, motion)
    # the last one is the bedplate's
    force, moment = np.zeros((2, tree.n + 1, 3, spans))
    joints = np.empty((tree.n, spans))
    for j in reversed(range(tree.n)):
        joint, body, here = tree.joints[j], tree.inertias[j], moving[j]
        first = float(np.linalg.norm(body.first_moment))
        second = float(np.linalg.norm(body.tensor, 2))
        force[j] += abs(body.mass) * here.linear + first * here.turning
        moment[j] += first * here.linear + second * (
            here.angular + _times(here.speed, here.speed)
        )
        joints[j] = (moment if joint.revolute else force)[j, 2]
        passed = _times(here.rotation, force[j])
        force[joint.parent] += passed
        moment[joint.parent] += _times(here.rotation, moment[j]) + _times(
            here.lever, passed
        )
    felt, turned = force[tree.sensor_body, 2], moment[tree.sensor_body, 2]
    if tree.sensor is not None:
        turned = turned + float(np.linalg.norm(tree.sensor.position)) * felt
    return ForceBounds(joints, felt, turned, motion)


@dataclass(frozen=True, eq=False)
class _Moving:
    """Bounds of a body's motion and of its first two time derivatives, (3, W) each, in its axes."""

    speed: Array  # angular velocity
    angular: Array  # angular acceleration
    linear: Array  # acceleration of its origin less gravity
    rotation: Array  # from its axes to its carrier's
    lever: Array  # from its carrier's origin to its own

    @property
    def turning(self) -> Array:
        """Bound of the acceleration relative to the origin, per metre of distance [1/s^2]."""
        return self.angular + _times(self.speed, self.speed)


def _jets(tree: Tree, motion: Array) -> list[_Moving]:
    """Bounds of the motion of all bodies over W time intervals.

    Args:
        tree: Robot.
        motion: Bounds of joint positions and their four derivatives, (5, n, W) [rad or m, s].
    """
    still, falling = np.zeros((2, 3, motion.shape[2]))
    falling[0] = np.linalg.norm(tree.gravity)
    ground = _Moving(still, still, falling, still, still)
    moving: list[_Moving] = []
    for joint, own in zip(tree.joints, motion.transpose(1, 0, 2), strict=True):
        carrier = ground if joint.parent < 0 else moving[joint.parent]
        moving.append(_carried(joint, carrier, own))
    return moving


def _carried(joint: Joint, carrier: _Moving, own: Array) -> _Moving:
    """Bounds of a body's motion by its carrier's and by its joint's, (5, W)."""
    position, speed, acceleration = own[:3], own[1:4], own[2:5]
    lever = np.zeros_like(position)
    lever[0] = np.linalg.norm(joint.offset)
    rotation = np.zeros_like(position)
    rotation[0] = 1.0
    if joint.revolute:
        rotation[1], rotation[2] = own[1], own[2] + own[1] ** 2
        turned = _times(rotation, carrier.speed)
        angular = (
            _times(rotation, carrier.angular) + _times(turned, speed) + acceleration
        )
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


CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
SIGNS = np.array([[1.0], [-1.0]])
"""A limit holds for a force and for its negative."""
PRESSURE = 100.0
"""Force at which a centre of pressure at the edge counts as a share of one [N]."""


@dataclass(frozen=True, eq=False)
class PlateRange:
    """Measuring range of a plate, and the area on which it stands.

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
        if not (self.wrench > 0).all() or (
            self.half is not None and not (self.half > 0).all()
        ):
            raise InfeasibleMotion(
                "the plate's ranges and half lengths must be positive"
            )

    def rows(self, margin: float) -> tuple[tuple[str, ...], Array, Array]:
        """Labels, combinations of the wrench as shares of limits, (k, 6), and their bounds, (k,).

        Args:
            margin: Share of each range that may be used.
        """
        known = np.flatnonzero(np.isfinite(self.wrench))
        labels = [f"plate {CHANNELS[c]}" for c in known]
        rows = np.kron(np.eye(6)[known] / self.wrench[known, None], SIGNS)
        most = np.full(len(rows), margin)
        if self.half is not None:  # |My| <= x Fz, |Mx| <= y Fz
            labels += [f"centre of pressure along {axis}" for axis in "xy"]
            half = np.repeat(self.half, 2)
            pressed = np.kron(np.eye(6)[[4, 3]], SIGNS)
            pressed[:, 2] = -margin * half
            rows = np.concatenate([rows, pressed / (PRESSURE * half[:, None])])
            most = np.append(most, np.zeros(4))
        return tuple(np.repeat(labels, 2).tolist()), rows, most


class ForceTerm:
    """Combinations of forces that stay below bounds: they can be proven between samples.

    Attributes:
        model: Whose forces: the joints' ("dynamic") or the bedplate's ("reaction").
        labels: What each is a limit of, (k,).
        rows: Combinations of the forces, (k, c).
        most: Their bounds, (k,).
    """

    def __init__(
        self, model: Model, labels: tuple[str, ...], rows: Array, most: Array
    ) -> None:
        self.model, self.labels, self.rows, self.most = model, labels, rows, most

    def forces(self, samples: MotionSamples) -> Array:
        """The forces, (c, G)."""
        return samples.forces(self.model)

    def force_slopes(self, samples: Samples) -> Array:
        """Their derivatives by q, then qd, then qdd, (c, 3 n, G)."""
        return samples.force_slopes(self.model)

    def force_curvatures(self, bounds: ForceBounds) -> Array:
        """Bounds of their second derivatives by time, (c, W)."""
        return bounds.of(self.model)

    def values(self, samples: MotionSamples) -> Array:
        """Shares less what is allowed, (k, G)."""
        return self.rows @ self.forces(samples) - self.most[:, None]

    def slopes(self, samples: Samples) -> Array:
        """Derivatives, (k, 3 n, G)."""
        return np.tensordot(self.rows, self.force_slopes(samples), 1)

    def curvatures(self, bounds: ForceBounds) -> Array:
        """Bounds of the second derivatives of `values` by time, (k, W) [1/s^2]."""
        return np.abs(self.rows) @ self.force_curvatures(bounds)


class PlateTerm(ForceTerm):
    """Measuring range of the bedplate, and the centre of pressure on it."""

    def __init__(self, plate: PlateRange, pedestal: Array, margin: float) -> None:
        """Set up the limits.

        Args:
            plate: The ranges.
            pedestal: Wrench on what stands on the plate without moving, (6,) [N, N m].
            margin: Share of each range that may be used.
        """
        labels, rows, most = plate.rows(margin)
        super().__init__("reaction", labels, rows, most - rows @ pedestal)


class SensorTerm(PlateTerm):
    """Measuring range of a force sensor in the robot, a plate that moves."""

    def __init__(
        self,
        tree: Tree,
        beyond: Tree,
        ranges: PlateRange,
        margin: float,
        name: str = "plate",
    ) -> None:
        """Set up the limits.

        Args:
            tree: The robot that moves.
            beyond: What the sensor feels, its inertias an a-priori model.
            ranges: Of its channels.
            margin: Share of each that may be used.
            name: Of the sensor.
        """
        super().__init__(ranges, pedestal_wrench(beyond), margin)
        self.labels = tuple(label.replace("plate", name) for label in self.labels)
        self._beyond = beyond
        self._joints = [tree.index(joint) for joint in beyond.names]
        minimal = minimal_set(beyond, "reaction")
        self._sampled = SampledRows(beyond, minimal, self._joints)

    def forces(self, samples: MotionSamples) -> Array:
        """The sensor's wrench, (6, G)."""
        at = samples.motion
        own = (each[:, self._joints] for each in (at.q, at.qd, at.qdd))
        return base_wrench(self._beyond, Motion(at.t, *own)).T

    def force_slopes(self, samples: Samples) -> Array:
        """Its derivatives, (6, 3 n, G)."""
        assert samples.stencil is not None, "derivatives were not asked for"
        looks = samples.stencil.around(samples.motion)
        wrench = self._sampled.model @ self._sampled.slots(looks)
        return samples.stencil.weights @ wrench.reshape(6, -1, samples.motion.samples)

    def force_curvatures(self, bounds: ForceBounds) -> Array:
        """Bounds of its second derivatives by time, (6, W)."""
        own = force_bounds(self._beyond, bounds.motion[:, self._joints])
        return own.of(self.model)


class EffortTerm(ForceTerm):
    """Motor efforts, with friction of either sign: a joint that rests may stick either way."""

    def __init__(self, tree: Tree, limits: Limits, margin: float) -> None:
        """Set up the limits.

        Args:
            tree: The robot, its inertias and friction an a-priori model.
            limits: Of the motors.
            margin: Share of each that may be used.

        Raises:
            InfeasibleMotion: A motor cannot overcome its joint's dry friction.
        """
        limited = np.flatnonzero(np.isfinite(limits.effort))
        names = np.repeat(np.array(tree.names)[limited], 2).tolist()
        self._viscous = VISCOUS.coefficients(tree)
        self._rotor = ROTOR.coefficients(tree)
        dry = (COULOMB.coefficients(tree) / limits.effort)[limited]
        most = np.repeat(margin - dry, 2)
        for name, left in zip(names, most, strict=True):
            if left <= 0:
                raise InfeasibleMotion(
                    f"the motor of joint '{name}' is too weak for its dry friction: nothing of its "
                    "effort limit is left for a motion; correct max_effort or coulomb"
                )
        rows = np.kron(np.eye(tree.n)[limited] / limits.effort[limited, None], SIGNS)
        labels = tuple(f"effort of '{name}'" for name in names)
        super().__init__("dynamic", labels, rows, most)

    def forces(self, samples: MotionSamples) -> Array:
        """Torques of the motors, dry friction aside, (n, G)."""
        return super().forces(samples) + self._lost(
            samples.motion.qd.T, samples.motion.qdd.T
        )

    def force_slopes(self, samples: Samples) -> Array:
        """Their derivatives, (n, 3 n, G)."""
        nothing = np.zeros_like(self._viscous)
        own = np.hstack(
            [np.diag(each) for each in (nothing, self._viscous, self._rotor)]
        )
        return super().force_slopes(samples) + own[:, :, None]

    def force_curvatures(self, bounds: ForceBounds) -> Array:
        """Bounds of their second derivatives by time, (n, W)."""
        return super().force_curvatures(bounds) + self._lost(*bounds.motion[3:])

    def _lost(self, qd: Array, qdd: Array) -> Array:
        """Viscous friction and what rotors take, (n, ...), of rates, (n, ...) each."""
        return self._viscous[:, None] * qd + self._rotor[:, None] * qdd
