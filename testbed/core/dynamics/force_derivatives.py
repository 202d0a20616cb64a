"""Derivatives of base wrench and joint torques with respect to joint, frame and base displacements.

One outward and one inward recursion give all derivatives, without finite differences. All
quantities are about the bedplate's origin, along its axes. A displacement along the screw s moves
all bodies that joint j carries. Let v and a be the velocity and the acceleration (minus gravity) of
the body before joint j, as screws, and W, I and B the sums over all carried bodies. Then

    psi = v x s        dW/dq   = s x* W + I phi + B psi
    phi = a x s        dW/dq'  = B s + 2 I psi
        + v x psi      dW/dq'' = I s

where W is the wrench, I the inertia, and B the Coriolis matrix, the sum over bodies of

    (2 w x p,  -2 v_w x J w + 2 (h . v_u) w - 2 v_u (h . w))

Here w is the angular part of a screw, p the momentum of a body, h its first moment, and J its
integral of r r'. A torque is the component of W along the screw s_i of its joint i. For a joint
before the displacement, dW is given above; for a joint behind it, whose screw moves too, dW is
I phi + B psi (and so on) with I and B of the bodies that joint i carries.

Screws (angular part first) and wrenches (force first) are arrays (6, m) with contiguous values of
the m instants, so the number of NumPy calls does not depend on m.

Source    [SRW22] eqs. of the derivatives in joint space, and summed to the base
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.core.base.arrays import Array, skew
from testbed.core.base.transform import Transform
from testbed.core.dynamics.newton_euler import Motion, sample_slices
from testbed.core.parameters.symbols import (
    standard_from_barycentric,
    with_standard_parameters,
)
from testbed.core.robot.inertia import ZERO_INERTIA, Inertia
from testbed.core.robot.tree import Joint, Tree

BLOCK_INSTANTS = 2048
"""Largest number of instants processed at once; more are no faster and need more memory."""


@dataclass(frozen=True, eq=False)
class ForceGradients:
    """Derivatives of C forces or torques with respect to D displacements, (M, C, D).

    Attributes:
        position: Derivatives with respect to the displacements [N or N m, per rad or m].
        velocity: Derivatives with respect to the rates of the displacements [s].
        acceleration: Derivatives with respect to their second time derivatives [s^2].
    """

    position: Array
    velocity: Array
    acceleration: Array

    def force_changes(self, displacement: Array, rate: Array, second: Array) -> Array:
        """Changes of the forces due to each displacement, for k time histories, (M, C, D, k).

        Args:
            displacement: Displacements, (M, D, k) [rad or m].
            rate: First time derivatives of the displacements, (M, D, k).
            second: Second time derivatives, (M, D, k).
        """
        change = self.position[..., None] * displacement[:, None]
        change += self.velocity[..., None] * rate[:, None]
        change += self.acceleration[..., None] * second[:, None]
        return change

    def select(self, displacements: slice) -> ForceGradients:
        """Derivatives with respect to a slice of the displacements."""
        return ForceGradients(
            self.position[..., displacements],
            self.velocity[..., displacements],
            self.acceleration[..., displacements],
        )


@dataclass(frozen=True, eq=False)
class ForceDerivatives:
    """Base wrench and joint torques of a motion, and derivatives with respect to displacements.

    The first n displacements are those of the joints. With `frames`, five displacements of each
    joint frame follow (along its three axes at q = 0, and about two axes normal to the joint axis),
    then six displacements of the base, along and about the bedplate's axes.

    Attributes:
        wrench: Wrench on the robot, in the frame of the bedplate or the sensor, (M, 6) [N, N m].
        torque: Joint torques, (M, n) [N m or N].
        wrench_slopes: Derivatives of the wrench.
        torque_slopes: Derivatives of the torques.
        screws: Screws of the joints in the bedplate frame, angular part first, (M, n, 6).
        origins: Origins of the body frames, bedplate frame, (M, n, 3) [m].
        carrier_mask: Element (i, j) is True if joint j carries body i, (n, n).
    """

    wrench: Array
    torque: Array
    wrench_slopes: ForceGradients
    torque_slopes: ForceGradients
    screws: Array
    origins: Array
    carrier_mask: NDArray[np.bool_]

    def joint_torques_of_wrench(self, wrench: Array, body: int) -> Array:
        """Joint torques equivalent to a wrench on a body, (M, n) [N m or N].

        Args:
            wrench: Wrench about the bedplate's origin, (M, 6) [N, N m].
            body: Index of the body.
        """
        components = self.screws @ np.roll(wrench, 3, axis=1)[:, :, None]
        return np.asarray(components[..., 0] * self.carrier_mask[body])


def force_derivatives(
    tree: Tree,
    motion: Motion,
    theta: Array,
    gravity: ArrayLike | None = None,
    frames: bool = False,
) -> ForceDerivatives:
    """Compute base wrench, joint torques, and derivatives with respect to displacements.

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples, columns in the order of `tree.names`.
        theta: Barycentric parameters, (n, 10).
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2]; default from the model.
        frames: True to include displacements of the joint frames and of the base.
    """
    bodies = list(
        with_standard_parameters(tree, standard_from_barycentric(tree, theta)).inertias
    )
    bodies[: tree.massless] = [ZERO_INERTIA] * tree.massless
    g = tree.gravity_or(gravity)
    parts = [
        _block_derivatives(tree, motion[part], bodies, g, frames)
        for part in sample_slices(motion.samples, BLOCK_INSTANTS)
    ]
    wrench, torque, by_wrench, by_torque, screws, origins = (
        np.concatenate(each, axis=1 if k in (2, 3) else 0)
        for k, each in enumerate(zip(*parts, strict=True))
    )
    return ForceDerivatives(
        wrench,
        torque,
        ForceGradients(*by_wrench),
        ForceGradients(*by_torque),
        screws,
        origins,
        _carrier_mask(tree)[:, : tree.n],
    )


def _block_derivatives(
    tree: Tree, motion: Motion, bodies: list[Inertia], gravity: Array, frames: bool
) -> tuple[Array, ...]:
    """Wrench, torques, derivatives of both, joint screws and body origins at m instants.

    Shapes (m, 6), (m, n), (3, m, 6, D), (3, m, n, D), (m, n, 6), (m, n, 3).
    """
    states = _body_states(tree, motion.q.T, motion.qd.T, motion.qdd.T, gravity)
    bedplate = states.pop()
    composite = [
        _Composite.from_body(b, s) for b, s in zip(bodies, states, strict=True)
    ]
    robot = _accumulate_composites(tree, composite)
    displacements = [
        _Displacement.from_screw(tree, states, bedplate, j, states[j].screw)
        for j in range(tree.n)
    ]
    if frames:
        for j, parent in enumerate(tree.parents):
            displacements += [
                _Displacement.from_screw(tree, states, bedplate, j, screw)
                for screw in _frame_screws(
                    tree.joints[j], bedplate if parent < 0 else states[parent]
                )
            ]
        displacements += [
            _Displacement.from_screw(tree, states, bedplate, -1, screw)
            for screw in _base_screws(motion.samples)
        ]
    slopes = np.stack(
        [
            each.wrench_slopes(robot if each.joint < 0 else composite[each.joint])
            for each in displacements
        ],
        axis=-1,
    )
    torques = _torque_slopes(tree, states, composite, displacements, slopes)
    wrench = np.ascontiguousarray(robot.wrench.T)
    by_wrench = slopes.transpose(0, 2, 1, 3)
    if tree.sensor is not None:
        by_wrench = by_wrench.copy()
        for j in range(tree.lead):  # the sensor itself moves with these joints
            by_wrench[0, :, :, j] -= _cross_force(states[j].screw, robot.wrench).T
        X_SW = _sensor_pose(tree, states).inverse
        wrench = np.asarray(X_SW.wrench(wrench))
        by_wrench = np.moveaxis(X_SW.wrench(np.moveaxis(by_wrench, 3, 1)), 1, 3)
    forces = np.stack(
        [_component(s.screw, c.wrench) for s, c in zip(states, composite, strict=True)]
    )
    screws = np.stack([at.screw.T for at in states], axis=1)
    origins = np.stack([at.p_WB.T for at in states], axis=1)
    return wrench, forces.T, by_wrench, torques, screws, origins


def _frame_screws(joint: Joint, carrier: _BodyState) -> list[Array]:
    """Screws of five displacements of a joint's frame, relative to the carrier, (6, m) each."""
    normal = np.cross(joint.axis, np.eye(3)[np.abs(joint.axis).argmin()])
    normals = [normal / np.linalg.norm(normal)]
    normals.append(np.cross(joint.axis, normals[0]))
    R_WF, p_WF, _ = _pose(joint, carrier, np.zeros(carrier.p_WB.shape[1]))
    zeros = np.zeros_like(p_WF)
    screws = [np.concatenate([zeros, axis @ R_WF]) for axis in np.eye(3)]
    for axis in normals:
        turning = axis @ R_WF
        screws.append(np.concatenate([turning, _cross(p_WF, turning)]))
    return screws


def _base_screws(samples: int) -> list[Array]:
    """Screws of the base: translations along, then rotations about, the bedplate's axes, (6, m)."""
    axes = np.eye(6)[[3, 4, 5, 0, 1, 2]]
    return [np.repeat(axis[:, None], samples, axis=1) for axis in axes]


@dataclass(frozen=True, eq=False)
class _Displacement:
    """Displacement of all bodies that a joint carries.

    Attributes:
        joint: Index of the joint, -1 for the base.
        screw: Screw s of the displacement, (6, m).
        psi: v x s, (6, m).
        phi: a x s + v x psi, (6, m).
    """

    joint: int
    screw: Array
    psi: Array
    phi: Array

    @classmethod
    def from_screw(
        cls,
        tree: Tree,
        states: list[_BodyState],
        bedplate: _BodyState,
        joint: int,
        screw: Array,
    ) -> _Displacement:
        """Build a displacement along a screw from the motion of the body before the joint."""
        parent = tree.parents[joint] if joint >= 0 else -1
        before = bedplate if parent < 0 else states[parent]
        psi = _cross_motion(before.velocity, screw)
        phi = _cross_motion(before.acceleration, screw)
        return cls(joint, screw, psi, phi + _cross_motion(before.velocity, psi))

    def wrench_slopes(self, carried: _Composite) -> Array:
        """Derivatives of the carried bodies' wrench with respect to q, q' and q'', (3, 6, m)."""
        turned = _cross_force(self.screw, carried.wrench)
        return np.stack(
            [
                turned + carried.inertia(self.phi) + carried.coriolis(self.psi),
                carried.coriolis(self.screw) + 2 * carried.inertia(self.psi),
                carried.inertia(self.screw),
            ]
        )


def _torque_slopes(
    tree: Tree,
    states: list[_BodyState],
    composite: list[_Composite],
    displacements: list[_Displacement],
    slopes: Array,
) -> Array:
    """Derivatives of the torques, (3, m, n, D), from `slopes` of the wrenches, (3, 6, m, D)."""
    axes = np.stack([at.screw for at in states])
    inertia = np.stack([c.inertia(s) for c, s in zip(composite, axes, strict=True)])
    coriolis = np.stack([c.dual(s) for c, s in zip(composite, axes, strict=True)])
    screw, psi, phi = (
        np.stack([getattr(each, name) for each in displacements], axis=-1)
        for name in ("screw", "psi", "phi")
    )

    def product(rows: Array, columns: Array) -> Array:
        return rows.transpose(2, 0, 1) @ columns.transpose(1, 0, 2)  # (m, n, D)

    # moment and force in the order of the angular and linear part
    inertia_wrenches = np.roll(inertia, 3, axis=1)
    behind_slopes = np.stack(
        [
            product(inertia_wrenches, phi) + product(coriolis, psi),
            product(coriolis, screw) + 2 * product(inertia_wrenches, psi),
            product(inertia_wrenches, screw),
        ]
    )
    before_slopes = np.stack(
        [product(np.roll(axes, 3, axis=1), each) for each in slopes]
    )
    joints = np.array([each.joint for each in displacements])
    is_behind = _carrier_mask(tree)[:, joints] | (joints < 0)
    is_before = _carrier_mask(tree)[joints, : tree.n].T & ~is_behind & (joints >= 0)
    return np.where(is_behind, behind_slopes, np.where(is_before, before_slopes, 0.0))


def _carrier_mask(tree: Tree) -> NDArray[np.bool_]:
    """Mask of the joints that carry or equal each joint, (n, n + 1); base column False."""
    carried = np.eye(tree.n, tree.n + 1, dtype=np.bool_)
    for i in range(tree.n):
        if tree.parents[i] >= 0:
            carried[i] |= carried[tree.parents[i]]
    return carried


def _component(screw: Array, wrench: Array) -> Array:
    """Component of a wrench along a screw, (m,) [N or N m]."""
    return np.asarray((np.roll(screw, 3, axis=0) * wrench).sum(axis=0))


def _sensor_pose(tree: Tree, states: list[_BodyState]) -> Transform:
    """Pose X_WS of the tree's sensor in the bedplate frame; m poses for moving bases."""
    assert tree.sensor is not None
    if not tree.lead:
        return tree.sensor.X_BS
    base = states[tree.sensor_body]
    return Transform(np.moveaxis(base.R_WB, 2, 0), base.p_WB.T) @ tree.sensor.X_BS


@dataclass(frozen=True, eq=False)
class _BodyState:
    """Pose, velocity and acceleration of a body at m instants.

    Attributes:
        R_WB: Rotation from the body frame B to the bedplate frame W, (3, 3, m).
        p_WB: Origin of the body frame in the bedplate frame, (3, m) [m].
        screw: Screw of the body's joint, (6, m).
        velocity: Velocity as a screw, (6, m).
        acceleration: Acceleration minus gravity, as a screw, (6, m).
    """

    R_WB: Array
    p_WB: Array
    screw: Array
    velocity: Array
    acceleration: Array


def _body_states(
    tree: Tree, q: Array, qd: Array, qdd: Array, gravity: Array
) -> list[_BodyState]:
    """Motion of every body and, last, of the bedplate, for joint coordinates (n, m)."""
    zeros, zero_screws = np.zeros((3, q.shape[1])), np.zeros((6, q.shape[1]))
    identity = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, q.shape[1]))
    minus_gravity = np.concatenate([zeros, zeros - gravity[:, None]])
    bedplate = _BodyState(identity, zeros, zero_screws, zero_screws, minus_gravity)
    states: list[_BodyState] = []
    for j, joint in enumerate(tree.joints):
        carrier = bedplate if joint.parent < 0 else states[joint.parent]
        R_WB, p_WB, axis = _pose(joint, carrier, q[j])
        screw = np.concatenate(
            [axis, _cross(p_WB, axis)] if joint.revolute else [zeros, axis]
        )
        velocity = carrier.velocity + screw * qd[j]
        acceleration = carrier.acceleration + screw * qdd[j]
        acceleration += _cross_motion(velocity, screw) * qd[j]
        states.append(_BodyState(R_WB, p_WB, screw, velocity, acceleration))
    return [*states, bedplate]


def _pose(joint: Joint, carrier: _BodyState, q: Array) -> tuple[Array, Array, Array]:
    """Rotation and origin of a body, and its joint axis, in the bedplate frame."""
    R_WB = joint.rotation.T @ carrier.R_WB
    p_WB = carrier.p_WB + joint.offset @ carrier.R_WB
    axis = joint.axis @ R_WB
    if not joint.revolute:
        return R_WB, p_WB + axis * q, axis
    axial = np.outer(joint.axis, joint.axis) @ R_WB
    transverse = skew(joint.axis).T @ R_WB
    return axial + np.cos(q) * (R_WB - axial) + np.sin(q) * transverse, p_WB, axis


@dataclass(eq=False)
class _Composite:
    """Composite body at m instants: a body together with all bodies that it carries.

    Attributes:
        mass: Mass [kg].
        first: First moment h about the bedplate's origin, (3, m) [kg m].
        second: Integral J of r r', (3, 3, m) [kg m^2].
        momentum: Linear momentum p, (3, m) [kg m/s].
        coupling: Block of B from the angular part of a screw to the moment, (3, 3, m) [kg m^2/s].
        wrench: Wrench required for the motion, including gravity, (6, m) [N, N m].
    """

    mass: float
    first: Array
    second: Array
    momentum: Array
    coupling: Array
    wrench: Array

    @classmethod
    def from_body(cls, body: Inertia, state: _BodyState) -> _Composite:
        """Build the composite body that contains a single body."""
        mass = body.mass
        h = body.first_moment @ state.R_WB
        turned = body.pseudo[:3, :3] @ state.R_WB
        J = np.einsum("abm,cbm->acm", turned, state.R_WB)
        h_p = h[:, None] * state.p_WB
        J += h_p + h_p.swapaxes(0, 1) + mass * state.p_WB[:, None] * state.p_WB
        result = cls(mass, h + mass * state.p_WB, J, h, J, state.velocity)
        turning, sliding = np.split(state.velocity, 2)
        momentum = result.inertia(state.velocity)
        result.wrench = result.inertia(state.acceleration) + _cross_force(
            state.velocity, momentum
        )
        result.momentum = momentum[:3]
        result.coupling = (
            -2 * _cross(turning[:, None], J) - 2 * sliding[:, None] * result.first
        )
        result.coupling[range(3), range(3)] += 2 * (result.first * sliding).sum(axis=0)
        return result

    def inertia(self, screw: Array) -> Array:
        """Product of the inertia I and a screw, (6, m)."""
        turning, sliding = np.split(screw, 2)
        trace = np.einsum("aam->m", self.second)
        force = self.mass * sliding + _cross(turning, self.first)
        moment = (
            trace * turning
            - np.einsum("abm,bm->am", self.second, turning)
            + _cross(self.first, sliding)
        )
        return np.concatenate([force, moment])

    def coriolis(self, screw: Array) -> Array:
        """Product of the Coriolis matrix B and a screw, (6, m)."""
        turning = screw[:3]
        force = 2 * _cross(turning, self.momentum)
        return np.concatenate([force, np.einsum("abm,bm->am", self.coupling, turning)])

    def dual(self, screw: Array) -> Array:
        """Product of the transposed Coriolis matrix B' and a screw, (6, m)."""
        turning, sliding = np.split(screw, 2)
        angular = np.einsum("abm,am->bm", self.coupling, turning)
        angular += 2 * _cross(self.momentum, sliding)
        return np.concatenate([angular, np.zeros_like(angular)])

    def add(self, other: _Composite) -> None:
        """Add the bodies of another composite body."""
        self.mass += other.mass
        self.wrench = self.wrench + other.wrench
        self.first += other.first
        self.second += other.second
        self.momentum += other.momentum
        self.coupling += other.coupling


def _accumulate_composites(tree: Tree, composite: list[_Composite]) -> _Composite:
    """Add each composite body to its carrier, in place; return the composite of the robot."""
    count = composite[0].first.shape[1]
    vector, matrix = np.zeros((3, count)), np.zeros((3, 3, count))
    wrench = np.zeros((6, count))
    robot = _Composite(0.0, vector, matrix, vector.copy(), matrix.copy(), wrench)
    for j in reversed(range(tree.n)):
        parent = tree.parents[j]
        (robot if parent < 0 else composite[parent]).add(composite[j])
    return robot


def _cross_motion(velocity: Array, screw: Array) -> Array:
    """Cross product velocity x screw: time derivative of a screw fixed in a moving body."""
    (w, u), (turning, sliding) = np.split(velocity, 2), np.split(screw, 2)
    return np.concatenate([_cross(w, turning), _cross(u, turning) + _cross(w, sliding)])


def _cross_force(velocity: Array, wrench: Array) -> Array:
    """Cross product velocity x* wrench: time derivative of a wrench fixed in a moving body."""
    (w, u), (force, moment) = np.split(velocity, 2), np.split(wrench, 2)
    return np.concatenate([_cross(w, force), _cross(w, moment) + _cross(u, force)])


def _cross(a: Array, b: Array) -> Array:
    """Cross product of vectors along the first axis, (3, ...); result in the shape of b."""
    product = np.empty_like(b)
    for i, j, k in (0, 1, 2), (1, 2, 0), (2, 0, 1):
        np.multiply(a[j], b[k], out=product[i])
        product[i] -= a[k] * b[j]
    return product
