"""How the base wrench changes with each joint's position, velocity and acceleration: exactly.

One sweep to the leaves and one back give all 3 n derivatives, in place of 3 n + 1 inverse dynamics
and their differences. All is about the bedplate's origin, in its axes. With joint j's screw s,
the screws v and a of its body's velocity and acceleration (less gravity), and W, I and B of all
that the joint carries,

    psi = v x s        dW/dq   = s x* W + I phi + B psi
    phi = a x s        dW/dq'  = B s + 2 I psi
        + v x psi      dW/dq'' = I s

W is the wrench, I the inertia, and B the Coriolis matrix, the sum over bodies of

    (2 w x p,  -2 v_w x J w + 2 (h . v_u) w - 2 v_u (h . w))

where w is the screw's turning, p a body's momentum, h its first moment, and J its integral of r r'.

A screw is its turning and its sliding, a wrench its force and its moment, (6, m): numbers of all
instants lie side by side, a few hundred calls whatever the number of instants.

Source    [SRW22] eqs. of the derivatives in joint space, summed to the base
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array, skew
from testbed.core.base.transform import Transform
from testbed.core.dynamics.newton_euler import Motion, blocks
from testbed.core.parameters.symbols import to_standard, with_standard
from testbed.core.robot.inertia import NOTHING, Inertia
from testbed.core.robot.tree import Joint, Tree


def base_wrench_derivatives(
    tree: Tree, motion: Motion, theta: Array, gravity: ArrayLike | None = None
) -> tuple[Array, Array]:
    """The measured wrench, its derivatives by each joint's position, velocity, acceleration.

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples, columns in the order of `tree.names`.
        theta: Barycentric parameters, (n, 10).
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.

    Returns:
        (M, 6) [N, N m], force first, about O^0 or a sensor's origin; and (n, 3, M, 6) [N or N m
        per rad or m, and with s and s^2].
    """
    bodies = list(with_standard(tree, to_standard(tree, theta)).inertias)
    bodies[: tree.massless] = [NOTHING] * tree.massless
    g = tree.gravity_or(gravity)
    wrench = np.empty((motion.samples, 6))
    slopes = np.empty((tree.n, 3, motion.samples, 6))
    # instants side by side: more are no faster, and need more memory
    for part in blocks(motion.samples, 2048):
        states = _outward(
            tree, motion.q[part].T, motion.qd[part].T, motion.qdd[part].T, g
        )
        composite = [
            _Composite.of(body, at) for body, at in zip(bodies, states, strict=True)
        ]
        whole = _inward(tree, states, composite, slopes[:, :, part])
        wrench[part] = whole.T
        if tree.sensor is not None:
            for j in range(tree.lead):  # the sensor itself turns and moves with these
                slopes[j, 0, part] -= _cross_force(states[j].screw, whole).T
            X_SW = _sensor_pose(tree, states).inverse
            for found in (
                wrench[part],
                *(each[part] for three in slopes for each in three),
            ):
                found[:] = X_SW.wrench(found)
    return wrench, slopes


def _sensor_pose(tree: Tree, states: list[_BodyState]) -> Transform:
    """Pose X_WS of the tree's sensor in the bedplate frame, or m of them where its base moves."""
    assert tree.sensor is not None
    if not tree.lead:
        return tree.sensor.X_BS
    base = states[tree.sensor_body]
    return Transform(np.moveaxis(base.R_WB, 2, 0), base.p_WB.T) @ tree.sensor.X_BS


@dataclass(frozen=True, eq=False)
class _BodyState:
    """A body at m instants.

    Attributes:
        R_WB: Rotation from the body's frame B to the bedplate's W, (3, 3, m).
        p_WB: Origin in the bedplate frame, (3, m) [m].
        screw: Its joint's, (6, m).
        velocity: Its screw, (6, m).
        acceleration: The same, less gravity.
    """

    R_WB: Array
    p_WB: Array
    screw: Array
    velocity: Array
    acceleration: Array


def _outward(
    tree: Tree, q: Array, qd: Array, qdd: Array, gravity: Array
) -> list[_BodyState]:
    """The motion of every body; coordinates (n, m)."""
    still, resting = np.zeros((3, q.shape[1])), np.zeros((6, q.shape[1]))
    flat = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, q.shape[1]))
    weight = np.concatenate([still, still - gravity[:, None]])
    bedplate = _BodyState(flat, still, resting, resting, weight)
    found: list[_BodyState] = []
    for j, joint in enumerate(tree.joints):
        carrier = bedplate if joint.parent < 0 else found[joint.parent]
        R_WB, p_WB, axis = _pose(joint, carrier, q[j])
        screw = np.concatenate(
            [axis, _cross(p_WB, axis)] if joint.revolute else [still, axis]
        )
        velocity = carrier.velocity + screw * qd[j]
        acceleration = carrier.acceleration + screw * qdd[j]
        acceleration += _cross_motion(velocity, screw) * qd[j]
        found.append(_BodyState(R_WB, p_WB, screw, velocity, acceleration))
    return found


def _pose(joint: Joint, carrier: _BodyState, q: Array) -> tuple[Array, Array, Array]:
    """A body's axes and origin, and its joint's axis, in the bedplate's."""
    R_WB = joint.rotation.T @ carrier.R_WB
    p_WB = carrier.p_WB + joint.offset @ carrier.R_WB
    axis = joint.axis @ R_WB
    if not joint.revolute:
        return R_WB, p_WB + axis * q, axis
    along = np.outer(joint.axis, joint.axis) @ R_WB
    across = skew(joint.axis).T @ R_WB
    return along + np.cos(q) * (R_WB - along) + np.sin(q) * across, p_WB, axis


@dataclass(eq=False)
class _Composite:
    """A body and all that it carries, about the bedplate's origin, at m instants.

    Attributes:
        mass: [kg].
        first: Moment, h, (3, m) [kg m].
        second: Integral of r r', J, (3, 3, m) [kg m^2].
        momentum: p, (3, m) [kg m/s].
        coupling: From a screw's turning to B's moment, (3, 3, m) [kg m^2/s].
        wrench: That moves them, (6, m).
    """

    mass: float
    first: Array
    second: Array
    momentum: Array
    coupling: Array
    wrench: Array

    @classmethod
    def of(cls, body: Inertia, at: _BodyState) -> _Composite:
        """One body."""
        mass = body.mass
        arm = body.first_moment @ at.R_WB
        turned = body.pseudo[:3, :3] @ at.R_WB
        about = np.einsum("abm,cbm->acm", turned, at.R_WB)
        across = arm[:, None] * at.p_WB
        about += across + across.swapaxes(0, 1) + mass * at.p_WB[:, None] * at.p_WB
        found = cls(mass, arm + mass * at.p_WB, about, arm, about, at.velocity)
        turning, sliding = np.split(at.velocity, 2)
        momentum = found.inertia(at.velocity)
        found.wrench = found.inertia(at.acceleration) + _cross_force(
            at.velocity, momentum
        )
        found.momentum = momentum[:3]
        found.coupling = (
            -2 * _cross(turning[:, None], about) - 2 * sliding[:, None] * found.first
        )
        found.coupling[range(3), range(3)] += 2 * (found.first * sliding).sum(axis=0)
        return found

    def inertia(self, screw: Array) -> Array:
        """I times a screw."""
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
        """B times a screw."""
        turning = screw[:3]
        force = 2 * _cross(turning, self.momentum)
        return np.concatenate([force, np.einsum("abm,bm->am", self.coupling, turning)])

    def add(self, other: _Composite) -> None:
        """Add what another body carries."""
        self.mass += other.mass
        self.wrench = self.wrench + other.wrench
        self.first += other.first
        self.second += other.second
        self.momentum += other.momentum
        self.coupling += other.coupling


def _inward(
    tree: Tree, states: list[_BodyState], composite: list[_Composite], slopes: Array
) -> Array:
    """The base wrench, (6, m); derivatives of it into `slopes`, (n, 3, m, 6)."""
    whole = np.zeros_like(states[0].screw)
    for j in reversed(range(tree.n)):
        at, carried = states[j], composite[j]
        psi = _cross_motion(at.velocity, at.screw)
        phi = _cross_motion(at.acceleration, at.screw) + _cross_motion(at.velocity, psi)
        turned = _cross_force(at.screw, carried.wrench)
        slopes[j, 0] = (turned + carried.inertia(phi) + carried.coriolis(psi)).T
        slopes[j, 1] = (carried.coriolis(at.screw) + carried.inertia(psi) * 2.0).T
        slopes[j, 2] = carried.inertia(at.screw).T
        if tree.parents[j] < 0:
            whole += carried.wrench
        else:
            composite[tree.parents[j]].add(carried)
    return whole


def _cross_motion(velocity: Array, screw: Array) -> Array:
    """The cross product velocity x screw: the rate of a screw that a body carries."""
    (w, u), (turning, sliding) = np.split(velocity, 2), np.split(screw, 2)
    return np.concatenate([_cross(w, turning), _cross(u, turning) + _cross(w, sliding)])


def _cross_force(velocity: Array, wrench: Array) -> Array:
    """The cross product velocity x* wrench: the rate of a wrench that a body carries."""
    (w, u), (force, moment) = np.split(velocity, 2), np.split(wrench, 2)
    return np.concatenate([_cross(w, force), _cross(w, moment) + _cross(u, force)])


def _cross(a: Array, b: Array) -> Array:
    """Of vectors whose components come first, the second of the result's shape."""
    found = np.empty_like(b)
    for i, j, k in (0, 1, 2), (1, 2, 0), (2, 0, 1):
        np.multiply(a[j], b[k], out=found[i])
        found[i] -= a[k] * b[j]
    return found
