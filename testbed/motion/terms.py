"""Limits on forces of plate, force sensors and motors, as functions of a motion.

Bounds of the second time derivatives allow proofs between samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.errors import NoFeasibleMotion
from testbed.core.dynamics.newton_euler import Motion, base_wrench, pedestal_wrench
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.parameters.rules import Signal
from testbed.core.robot.friction import COULOMB, ROTOR, VISCOUS
from testbed.core.robot.tree import Joint, Tree
from testbed.motion.limits import Limits
from testbed.motion.samples import KernelForces, MotionSamples, SampledRows


@dataclass(frozen=True, eq=False)
class ForceCurvatureBounds:
    """Upper bounds of the absolute second time derivatives of forces, in W time intervals.

    Attributes:
        joints: Bounds for the joint forces, excluding drives and friction, (n, W)
            [N m/s^2 or N/s^2].
        force: Bounds for the force of the bedplate or of a force sensor, (W,) [N/s^2].
        moment: Bounds for the moment about O^0, or about the sensor's origin, (W,) [N m/s^2].
        motion: Bounds of the joint positions and their first four derivatives, (5, n, W).
    """

    joints: Array
    force: Array
    moment: Array
    motion: Array

    def of_signal(self, model: Signal) -> Array:
        """Bounds for the joint forces, (n, W), or for the wrench, (6, W).

        Args:
            model: "torque" or "wrench".
        """
        if model == "torque":
            return self.joints
        return np.repeat([self.force, self.moment], 3, axis=0)


def force_curvature_bounds(tree: Tree, motion: Array) -> ForceCurvatureBounds:
    """Upper bounds of the second time derivatives of joint forces and wrench.

    The bounds result from a Newton-Euler recursion with norms in place of vectors.

    Args:
        tree: The robot, with a-priori inertias.
        motion: Bounds of |q|, |qd|, |qdd| and of the next two derivatives, (5, n, W).
    """
    intervals, bodies = motion.shape[2], _body_bounds(tree, motion)
    # the last entry is the bedplate's
    force, moment = np.zeros((2, tree.n + 1, 3, intervals))
    joints = np.empty((tree.n, intervals))
    for j in reversed(range(tree.n)):
        joint, body, bounds = tree.joints[j], tree.inertias[j], bodies[j]
        first_moment = float(np.linalg.norm(body.first_moment))
        second_moment = float(np.linalg.norm(body.tensor, 2))
        force[j] += abs(body.mass) * bounds.linear + first_moment * bounds.turning
        moment[j] += first_moment * bounds.linear + second_moment * (
            bounds.angular + _jet_product(bounds.speed, bounds.speed)
        )
        joints[j] = (moment if joint.revolute else force)[j, 2]
        carried_force = _jet_product(bounds.rotation, force[j])
        force[joint.parent] += carried_force
        moment[joint.parent] += _jet_product(bounds.rotation, moment[j]) + _jet_product(
            bounds.lever, carried_force
        )
    sensor_force, sensor_moment = (
        force[tree.sensor_body, 2],
        moment[tree.sensor_body, 2],
    )
    if tree.sensor is not None:
        sensor_moment = (
            sensor_moment + float(np.linalg.norm(tree.sensor.position)) * sensor_force
        )
    return ForceCurvatureBounds(joints, sensor_force, sensor_moment, motion)


@dataclass(frozen=True, eq=False)
class _MotionBounds:
    """Bounds of a body's motion and its first two time derivatives, (3, W) each.

    Row 0 bounds the norm of the vector in the body's axes; rows 1 and 2 bound the norms of its
    first and second time derivatives.
    """

    speed: Array  # angular velocity
    angular: Array  # angular acceleration
    linear: Array  # acceleration of the origin minus gravity
    rotation: Array  # rotation from body axes to parent axes
    lever: Array  # vector from the parent's origin to the body's origin

    @property
    def turning(self) -> Array:
        """Bound of the acceleration relative to the origin per unit distance [1/s^2]."""
        return self.angular + _jet_product(self.speed, self.speed)


def _body_bounds(tree: Tree, motion: Array) -> list[_MotionBounds]:
    """Bounds of the motion of all bodies in W time intervals.

    Args:
        tree: The robot.
        motion: Bounds of the joint positions and their first four derivatives, (5, n, W).
    """
    zeros, gravity = np.zeros((2, 3, motion.shape[2]))
    gravity[0] = np.linalg.norm(tree.gravity)
    ground = _MotionBounds(zeros, zeros, gravity, zeros, zeros)
    bodies: list[_MotionBounds] = []
    for joint, joint_bounds in zip(tree.joints, motion.transpose(1, 0, 2), strict=True):
        parent = ground if joint.parent < 0 else bodies[joint.parent]
        bodies.append(_child_bounds(joint, parent, joint_bounds))
    return bodies


def _child_bounds(
    joint: Joint, parent: _MotionBounds, joint_bounds: Array
) -> _MotionBounds:
    """Bounds of a body's motion from the bounds of its parent and its joint.

    Args:
        joint: Joint between parent and body.
        parent: Bounds of the parent's motion.
        joint_bounds: Bounds of the joint position and its first four derivatives, (5, W).
    """
    position, speed, acceleration = (
        joint_bounds[:3],
        joint_bounds[1:4],
        joint_bounds[2:5],
    )
    lever = np.zeros_like(position)
    lever[0] = np.linalg.norm(joint.offset)
    rotation = np.zeros_like(position)
    rotation[0] = 1.0
    if joint.revolute:
        rotation[1], rotation[2] = (
            joint_bounds[1],
            joint_bounds[2] + joint_bounds[1] ** 2,
        )
        parent_speed = _jet_product(rotation, parent.speed)
        angular = (
            _jet_product(rotation, parent.angular)
            + _jet_product(parent_speed, speed)
            + acceleration
        )
        linear = _jet_product(
            rotation, parent.linear + _jet_product(parent.turning, lever)
        )
        return _MotionBounds(parent_speed + speed, angular, linear, rotation, lever)
    lever = lever + position
    linear = parent.linear + _jet_product(parent.turning, lever) + acceleration
    linear = linear + 2 * _jet_product(parent.speed, speed)
    return _MotionBounds(parent.speed, parent.angular, linear, rotation, lever)


def _jet_product(a: Array, b: Array) -> Array:
    """Value and first two derivatives of a product of two factors, (3, ...) each."""
    second = a[2] * b[0] + 2 * a[1] * b[1] + a[0] * b[2]
    return np.stack([a[0] * b[0], a[1] * b[0] + a[0] * b[1], second])


CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
SIGNS = np.array([[1.0], [-1.0]])
"""Signs of a force; both signs are limited."""
PRESSURE_UNIT = 100.0
"""Force that normalises the limits of the centre of pressure [N]."""


@dataclass(frozen=True, eq=False)
class PlateRange:
    """Measuring ranges of a force plate, and its support area.

    Attributes:
        wrench: Largest absolute value of each channel, including the pedestal, (6,) [N, N m];
            infinite for no limit.
        half_lengths: Half lengths along x and y of the area in which the centre of pressure must
            stay, (2,) [m]; None for a plate that is bolted down.
    """

    wrench: Array
    half_lengths: Array | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self, wrench=(6,))
        if self.half_lengths is not None:
            freeze_arrays(self, half_lengths=(2,))
        if not (self.wrench > 0).all() or (
            self.half_lengths is not None and not (self.half_lengths > 0).all()
        ):
            raise NoFeasibleMotion(
                "the plate's ranges and half lengths must be positive"
            )

    def rows(self, margin: float) -> tuple[tuple[str, ...], Array, Array]:
        """Labels, matrix A (k, 6) and bounds b (k,) of the limits `A wrench <= b`.

        The first limits apply to both signs of every channel with a finite range, normalised by the
        range. With `half_lengths` x and y, the limits |My| <= margin x Fz and |Mx| <= margin y Fz
        of the centre of pressure follow, normalised by PRESSURE_UNIT x and PRESSURE_UNIT y,
        respectively. The wrench includes the pedestal.

        Args:
            margin: Usable fraction of each range.
        """
        limited = np.flatnonzero(np.isfinite(self.wrench))
        labels = [f"plate {CHANNELS[c]}" for c in limited]
        rows = np.kron(np.eye(6)[limited] / self.wrench[limited, None], SIGNS)
        bounds = np.full(len(rows), margin)
        if self.half_lengths is not None:  # |My| <= x Fz, |Mx| <= y Fz
            labels += [f"centre of pressure along {axis}" for axis in "xy"]
            half = np.repeat(self.half_lengths, 2)
            pressure_rows = np.kron(np.eye(6)[[4, 3]], SIGNS)
            pressure_rows[:, 2] = -margin * half
            rows = np.concatenate(
                [rows, pressure_rows / (PRESSURE_UNIT * half[:, None])]
            )
            bounds = np.append(bounds, np.zeros(4))
        return tuple(np.repeat(labels, 2).tolist()), rows, bounds


class ForceTerm:
    """Upper bounds on linear combinations of forces.

    Attributes:
        model: Signal of the forces: "torque" for joint forces, "wrench" for the wrench.
        labels: Name of each limit, (k,).
        rows: Coefficients of k linear combinations of c forces, (k, c).
        most: Upper bounds of the combinations, (k,).
    """

    def __init__(
        self, model: Signal, labels: tuple[str, ...], rows: Array, most: Array
    ) -> None:
        self.model, self.labels, self.rows, self.most = model, labels, rows, most

    def forces(self, samples: MotionSamples) -> Array:
        """Limited forces at G instants, (c, G)."""
        return samples.forces(self.model)

    def force_slopes(self, samples: KernelForces) -> Array:
        """Derivatives of the forces with respect to q, then qd, then qdd, (c, 3 n, G)."""
        return samples.force_slopes(self.model)

    def force_curvatures(self, bounds: ForceCurvatureBounds) -> Array:
        """Bounds of the second time derivatives of the forces, (c, W)."""
        return bounds.of_signal(self.model)

    def values(self, samples: MotionSamples) -> Array:
        """Normalised excess of the forces over the bounds, (k, G); negative where respected."""
        return self.rows @ self.forces(samples) - self.most[:, None]

    def slopes(self, samples: KernelForces) -> Array:
        """Derivatives of the values with respect to q, then qd, then qdd, (k, 3 n, G)."""
        return np.tensordot(self.rows, self.force_slopes(samples), 1)

    def curvatures(self, bounds: ForceCurvatureBounds) -> Array:
        """Bounds of the second time derivatives of the values, (k, W) [1/s^2]."""
        return np.abs(self.rows) @ self.force_curvatures(bounds)


class PlateTerm(ForceTerm):
    """Measuring ranges of the force plate, and limits of its centre of pressure."""

    def __init__(self, plate: PlateRange, pedestal: Array, margin: float) -> None:
        """Prepare the limits.

        Args:
            plate: Measuring ranges.
            pedestal: Wrench on the pedestal, (6,) [N, N m].
            margin: Usable fraction of each range.
        """
        labels, rows, bounds = plate.rows(margin)
        super().__init__("wrench", labels, rows, bounds - rows @ pedestal)


class SensorTerm(PlateTerm):
    """Measuring ranges of a force sensor in the robot."""

    def __init__(
        self,
        tree: Tree,
        beyond: Tree,
        ranges: PlateRange,
        margin: float,
        name: str = "plate",
    ) -> None:
        """Prepare the limits.

        Args:
            tree: The moving robot.
            beyond: Part of the robot beyond the sensor, with a-priori inertias.
            ranges: Measuring ranges of the sensor.
            margin: Usable fraction of each range.
            name: Name of the sensor, in place of "plate" in the labels.
        """
        super().__init__(ranges, pedestal_wrench(beyond), margin)
        self.labels = tuple(label.replace("plate", name) for label in self.labels)
        self._part = beyond
        self._joints = [tree.index(joint) for joint in beyond.names]
        minimal = minimal_set(beyond, "wrench")
        self._sampled = SampledRows(beyond, minimal, self._joints)

    def forces(self, samples: MotionSamples) -> Array:
        """Wrench at the sensor, excluding the pedestal, at G instants, (6, G) [N, N m]."""
        motion = samples.motion
        states = (state[:, self._joints] for state in (motion.q, motion.qd, motion.qdd))
        return base_wrench(self._part, Motion(motion.t, *states)).T

    def force_slopes(self, samples: KernelForces) -> Array:
        """Derivatives of the sensor's wrench with respect to q, qd, then qdd, (6, 3 n, G)."""
        assert samples.stencil is not None, "derivatives were not asked for"
        displaced = samples.stencil.displaced_motion(samples.motion)
        wrench = self._sampled.model @ self._sampled.slots(displaced)
        return samples.stencil.weights @ wrench.reshape(6, -1, samples.motion.samples)

    def force_curvatures(self, bounds: ForceCurvatureBounds) -> Array:
        """Bounds of the second time derivatives of the sensor's wrench, (6, W)."""
        part_bounds = force_curvature_bounds(self._part, bounds.motion[:, self._joints])
        return part_bounds.of_signal(self.model)


class EffortTerm(ForceTerm):
    """Limits of motor efforts, with dry friction of either sign.

    The limits are reduced by the Coulomb friction, which may have either direction at zero speed.
    """

    def __init__(self, tree: Tree, limits: Limits, margin: float) -> None:
        """Prepare the limits.

        Args:
            tree: The robot, with a-priori inertias and friction.
            limits: Limits of the motors.
            margin: Usable fraction of each limit.

        Raises:
            NoFeasibleMotion: A motor cannot overcome the dry friction of its joint.
        """
        limited = np.flatnonzero(np.isfinite(limits.effort))
        names = np.repeat(np.array(tree.names)[limited], 2).tolist()
        self._viscous = VISCOUS.coefficients(tree)
        self._rotor = ROTOR.coefficients(tree)
        dry_friction_share = (COULOMB.coefficients(tree) / limits.effort)[limited]
        bounds = np.repeat(margin - dry_friction_share, 2)
        for name, bound in zip(names, bounds, strict=True):
            if bound <= 0:
                raise NoFeasibleMotion(
                    f"the motor of joint '{name}' is too weak for its dry friction: nothing of its "
                    "effort limit is left for a motion; correct max_effort or coulomb"
                )
        rows = np.kron(np.eye(tree.n)[limited] / limits.effort[limited, None], SIGNS)
        labels = tuple(f"effort of '{name}'" for name in names)
        super().__init__("torque", labels, rows, bounds)

    def forces(self, samples: MotionSamples) -> Array:
        """Motor torques without dry friction, (n, G) [N m or N]."""
        return super().forces(samples) + self._drive_losses(
            samples.motion.qd.T, samples.motion.qdd.T
        )

    def force_slopes(self, samples: KernelForces) -> Array:
        """Derivatives of the motor torques with respect to q, qd, then qdd, (n, 3 n, G)."""
        zeros = np.zeros_like(self._viscous)
        drive_slopes = np.hstack(
            [
                np.diag(coefficients)
                for coefficients in (zeros, self._viscous, self._rotor)
            ]
        )
        return super().force_slopes(samples) + drive_slopes[:, :, None]

    def force_curvatures(self, bounds: ForceCurvatureBounds) -> Array:
        """Bounds of the second time derivatives of the motor torques, (n, W)."""
        return super().force_curvatures(bounds) + self._drive_losses(*bounds.motion[3:])

    def _drive_losses(self, qd: Array, qdd: Array) -> Array:
        """Torque of viscous friction and rotor inertia, (n, ...) [N m or N].

        Args:
            qd: Joint velocities, (n, ...).
            qdd: Joint accelerations, (n, ...).
        """
        return self._viscous[:, None] * qd + self._rotor[:, None] * qdd
