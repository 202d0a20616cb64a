"""Derivatives of base wrench and joint torques by displacements of joints, frames and base.

One sweep to the leaves and one back give all of them, in place of many inverse dynamics and their
differences. All is about the bedplate's origin, in its axes. A displacement along the screw s
moves all that joint j carries. With the screws v and a of the velocity and acceleration (less
gravity) of the body before it, and W, I and B of all that is carried,

    psi = v x s        dW/dq   = s x* W + I phi + B psi
    phi = a x s        dW/dq'  = B s + 2 I psi
        + v x psi      dW/dq'' = I s

W is the wrench, I the inertia, and B the Coriolis matrix, the sum over bodies of

    (2 w x p,  -2 v_w x J w + 2 (h . v_u) w - 2 v_u (h . w))

where w is the screw's turning, p a body's momentum, h its first moment, and J its integral of r r'.
A torque is W along its joint's screw s_i: of a joint before the displacement, that of dW above; of
one behind it, whose screw moves too, I phi + B psi and so on with I and B of what joint i carries.

A screw is its turning and its sliding, a wrench its force and its moment, (6, m): numbers of all
instants lie side by side, a few hundred calls whatever the number of instants.

Source    [SRW22] eqs. of the derivatives in joint space, and summed to the base
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.core.base.arrays import Array, skew
from testbed.core.base.transform import Transform
from testbed.core.dynamics.newton_euler import Motion, blocks
from testbed.core.parameters.symbols import to_standard, with_standard
from testbed.core.robot.inertia import NOTHING, Inertia
from testbed.core.robot.tree import Joint, Tree

SIZE = 2048
"""Instants side by side: more are no faster, and need more memory."""


@dataclass(frozen=True, eq=False)
class ForceSlopes:
    """Derivatives of C forces by D displacements, (M, C, D) each [N or N m per rad or m].

    Attributes:
        position: By the displacements.
        velocity: By their rates [s].
        acceleration: By their second derivatives [s^2].
    """

    position: Array
    velocity: Array
    acceleration: Array

    def along(self, displacement: Array, rate: Array, second: Array) -> Array:
        """Changes of the forces by k displacements in time, (M, C, D, k).

        Args:
            displacement: (M, D, k) [rad or m].
            rate: Its derivative in time.
            second: Its second derivative.
        """
        change = self.position[..., None] * displacement[:, None]
        change += self.velocity[..., None] * rate[:, None]
        change += self.acceleration[..., None] * second[:, None]
        return change

    def of(self, displacements: slice) -> ForceSlopes:
        """Derivatives by some of the displacements.

        Args:
            displacements: Which.
        """
        return ForceSlopes(
            self.position[..., displacements],
            self.velocity[..., displacements],
            self.acceleration[..., displacements],
        )


@dataclass(frozen=True, eq=False)
class ForceDerivatives:
    """Base wrench and joint torques of a motion, and their derivatives by displacements.

    Displacements are of the joints, (n), first. If asked for, those of the frames follow, five
    before each joint: along the axes of its frame where the joint is at zero, and about two axes
    across its own; then six of the base along and about the bedplate's axes.

    Attributes:
        wrench: As the plate or the sensor measures it, (M, 6) [N, N m].
        torque: (M, n) [N m or N].
        wrench_slopes: Of the wrench.
        torque_slopes: Of the torques.
        screws: Of the joints, turning and sliding, (M, n, 6).
        origins: Of the bodies' frames, bedplate frame, (M, n, 3) [m].
        carries: Whether joint j carries body i, (n, n).
    """

    wrench: Array
    torque: Array
    wrench_slopes: ForceSlopes
    torque_slopes: ForceSlopes
    screws: Array
    origins: Array
    carries: NDArray[np.bool_]

    def torques_of(self, wrench: Array, body: int) -> Array:
        """Torques that a wrench on a body has at the joints, (M, n) [N m or N].

        Args:
            wrench: About the bedplate's origin, (M, 6) [N, N m].
            body: Index.
        """
        along = self.screws @ np.roll(wrench, 3, axis=1)[:, :, None]
        return np.asarray(along[..., 0] * self.carries[body])


def force_derivatives(
    tree: Tree,
    motion: Motion,
    theta: Array,
    gravity: ArrayLike | None = None,
    frames: bool = False,
) -> ForceDerivatives:
    """Base wrench, joint torques, and their derivatives by displacements.

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples, columns in the order of `tree.names`.
        theta: Barycentric parameters, (n, 10).
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
        frames: Whether displacements of the joints' frames and of the base are among them.
    """
    bodies = list(with_standard(tree, to_standard(tree, theta)).inertias)
    bodies[: tree.massless] = [NOTHING] * tree.massless
    g = tree.gravity_or(gravity)
    parts = [
        _derivatives(tree, motion[part], bodies, g, frames)
        for part in blocks(motion.samples, SIZE)
    ]
    wrench, torque, by_wrench, by_torque, screws, origins = (
        np.concatenate(each, axis=1 if k in (2, 3) else 0)
        for k, each in enumerate(zip(*parts, strict=True))
    )
    return ForceDerivatives(
        wrench,
        torque,
        ForceSlopes(*by_wrench),
        ForceSlopes(*by_torque),
        screws,
        origins,
        _carries(tree)[:, : tree.n],
    )


def _derivatives(
    tree: Tree, motion: Motion, bodies: list[Inertia], gravity: Array, frames: bool
) -> tuple[Array, ...]:
    """Wrench (m, 6), torques (m, n), slopes of both, (3, m, C, D), screws and origins."""
    states = _outward(tree, motion.q.T, motion.qd.T, motion.qdd.T, gravity)
    bedplate = states.pop()
    composite = [
        _Composite.of(body, at) for body, at in zip(bodies, states, strict=True)
    ]
    whole = _summed(tree, composite)
    displacements = [
        _Displacement.of(tree, states, bedplate, j, states[j].screw)
        for j in range(tree.n)
    ]
    if frames:
        for j, parent in enumerate(tree.parents):
            displacements += [
                _Displacement.of(tree, states, bedplate, j, screw)
                for screw in _frame_screws(
                    tree.joints[j], bedplate if parent < 0 else states[parent]
                )
            ]
        displacements += [
            _Displacement.of(tree, states, bedplate, -1, screw)
            for screw in _base_screws(motion.samples)
        ]
    slopes = np.stack(
        [
            each.wrench_slopes(whole if each.joint < 0 else composite[each.joint])
            for each in displacements
        ],
        axis=-1,
    )
    torques = _torque_slopes(tree, states, composite, displacements, slopes)
    wrench = np.ascontiguousarray(whole.wrench.T)
    by_wrench = slopes.transpose(0, 2, 1, 3)
    if tree.sensor is not None:
        by_wrench = by_wrench.copy()
        for j in range(tree.lead):  # the sensor itself turns and moves with these
            by_wrench[0, :, :, j] -= _cross_force(states[j].screw, whole.wrench).T
        X_SW = _sensor_pose(tree, states).inverse
        wrench = np.asarray(X_SW.wrench(wrench))
        by_wrench = np.moveaxis(X_SW.wrench(np.moveaxis(by_wrench, 3, 1)), 1, 3)
    forces = np.stack(
        [_along(s.screw, c.wrench) for s, c in zip(states, composite, strict=True)]
    )
    screws = np.stack([at.screw.T for at in states], axis=1)
    origins = np.stack([at.p_WB.T for at in states], axis=1)
    return wrench, forces.T, by_wrench, torques, screws, origins


def _frame_screws(joint: Joint, carrier: _BodyState) -> list[Array]:
    """Screws of five displacements before a joint, (6, m) each."""
    first = np.cross(joint.axis, np.eye(3)[np.abs(joint.axis).argmin()])
    across = [first / np.linalg.norm(first)]
    across.append(np.cross(joint.axis, across[0]))
    R_WF, p_WF, _ = _pose(joint, carrier, np.zeros(carrier.p_WB.shape[1]))
    none = np.zeros_like(p_WF)
    screws = [np.concatenate([none, axis @ R_WF]) for axis in np.eye(3)]
    for axis in across:
        turning = axis @ R_WF
        screws.append(np.concatenate([turning, _cross(p_WF, turning)]))
    return screws


def _base_screws(samples: int) -> list[Array]:
    """Screws of the base: slides along the bedplate's axes, then turns about them, (6, m)."""
    axes = np.eye(6)[[3, 4, 5, 0, 1, 2]]
    return [np.repeat(axis[:, None], samples, axis=1) for axis in axes]


@dataclass(frozen=True, eq=False)
class _Displacement:
    """Displacement of all that a joint carries, -1 for the base.

    Attributes:
        joint: Index.
        screw: s, (6, m).
        psi: v x s.
        phi: a x s + v x psi.
    """

    joint: int
    screw: Array
    psi: Array
    phi: Array

    @classmethod
    def of(
        cls,
        tree: Tree,
        states: list[_BodyState],
        bedplate: _BodyState,
        joint: int,
        screw: Array,
    ) -> _Displacement:
        """Displacement along a screw."""
        parent = tree.parents[joint] if joint >= 0 else -1
        before = bedplate if parent < 0 else states[parent]
        psi = _cross_motion(before.velocity, screw)
        phi = _cross_motion(before.acceleration, screw)
        return cls(joint, screw, psi, phi + _cross_motion(before.velocity, psi))

    def wrench_slopes(self, carried: _Composite) -> Array:
        """Derivatives of the wrench that moves what is carried, (3, 6, m)."""
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
    """Derivatives of the torques, (3, m, n, D), those of the wrenches being (3, 6, m, D)."""
    axes = np.stack([at.screw for at in states])
    inertia = np.stack([c.inertia(s) for c, s in zip(composite, axes, strict=True)])
    coriolis = np.stack([c.dual(s) for c, s in zip(composite, axes, strict=True)])
    screw, psi, phi = (
        np.stack([getattr(each, name) for each in displacements], axis=-1)
        for name in ("screw", "psi", "phi")
    )

    def product(rows: Array, columns: Array) -> Array:
        return rows.transpose(2, 0, 1) @ columns.transpose(1, 0, 2)  # (m, n, D)

    swapped = np.roll(inertia, 3, axis=1)  # moments meet turnings
    behind = np.stack(
        [
            product(swapped, phi) + product(coriolis, psi),
            product(coriolis, screw) + 2 * product(swapped, psi),
            product(swapped, screw),
        ]
    )
    before = np.stack([product(np.roll(axes, 3, axis=1), each) for each in slopes])
    joints = np.array([each.joint for each in displacements])
    carries = _carries(tree)[:, joints] | (joints < 0)
    above = _carries(tree)[joints, : tree.n].T & ~carries & (joints >= 0)
    return np.where(carries, behind, np.where(above, before, 0.0))


def _carries(tree: Tree) -> NDArray[np.bool_]:
    """Whether joint j, or the base (the last column), carries joint i or is it, (n, n + 1)."""
    carried = np.eye(tree.n, tree.n + 1, dtype=np.bool_)
    for i in range(tree.n):
        if tree.parents[i] >= 0:
            carried[i] |= carried[tree.parents[i]]
    return carried


def _along(screw: Array, wrench: Array) -> Array:
    """A wrench along a screw, (m,) [N or N m]."""
    return np.asarray((np.roll(screw, 3, axis=0) * wrench).sum(axis=0))


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
    """The motion of every body, and that of the bedplate; coordinates (n, m)."""
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
    return [*found, bedplate]


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

    def dual(self, screw: Array) -> Array:
        """B' times a screw: what a wrench B x along it is in x's turning and sliding."""
        turning, sliding = np.split(screw, 2)
        moved = np.einsum("abm,am->bm", self.coupling, turning)
        moved += 2 * _cross(self.momentum, sliding)
        return np.concatenate([moved, np.zeros_like(moved)])

    def add(self, other: _Composite) -> None:
        """Add what another body carries."""
        self.mass += other.mass
        self.wrench = self.wrench + other.wrench
        self.first += other.first
        self.second += other.second
        self.momentum += other.momentum
        self.coupling += other.coupling


def _summed(tree: Tree, composite: list[_Composite]) -> _Composite:
    """Bodies made composites of all that they carry, and the whole robot."""
    count = composite[0].first.shape[1]
    none, square = np.zeros((3, count)), np.zeros((3, 3, count))
    wrench = np.zeros((6, count))
    whole = _Composite(0.0, none, square, none.copy(), square.copy(), wrench)
    for j in reversed(range(tree.n)):
        parent = tree.parents[j]
        (whole if parent < 0 else composite[parent]).add(composite[j])
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
