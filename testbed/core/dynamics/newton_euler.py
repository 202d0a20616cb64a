"""The recursion: how bodies move, what joints transmit, in numbers or in symbols."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import AnyArray, Array, apply, freeze, skew
from testbed.core.base.summary_table import Value
from testbed.core.base.transform import Transform
from testbed.core.parameters.rules import Model
from testbed.core.parameters.symbols import TENSOR, barycentric
from testbed.core.robot.tree import Placement, Tree


@dataclass(frozen=True, eq=False)
class Motion(Value):
    """M samples of the motion of n joints, columns in the order of `tree.names`.

    Attributes:
        t: Time, (M,) [s].
        q: Joint positions, (M, n) [rad or m].
        qd: Velocities, (M, n) [rad/s or m/s].
        qdd: Accelerations, (M, n) [rad/s^2 or m/s^2].
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array

    def __post_init__(self) -> None:
        freeze(self, t=(None,))
        shape = (len(self.t), np.shape(self.q)[-1] if np.ndim(self.q) else 0)
        freeze(self, q=shape, qd=shape, qdd=shape)

    @staticmethod
    def at_rest(postures: Array) -> Motion:
        """Motion at rest, one sample for each posture.

        Args:
            postures: Joint positions, (M, n) [rad or m].
        """
        still = np.zeros_like(postures)
        return Motion(np.arange(float(len(postures))), postures, still, still)

    @property
    def samples(self) -> int:
        """Number M of samples."""
        return len(self.t)

    def __getitem__(self, part: slice) -> Motion:
        """The samples of a slice."""
        return Motion(self.t[part], self.q[part], self.qd[part], self.qdd[part])


Keep = Callable[[str, AnyArray], AnyArray]
"""Function of an intermediate's name, such as "w3", and value; its result replaces the value."""


def unchanged(name: str, value: AnyArray) -> AnyArray:
    """The value itself: numbers need no names."""
    del name
    return value


class Link(Protocol):
    """A joint's geometry: a `Joint`, or one whose lengths and axes are symbols."""

    @property
    def parent(self) -> int:
        """Index of the carrying body, -1 for the bedplate."""

    @property
    def revolute(self) -> bool:
        """Whether the joint turns (else it slides)."""

    @property
    def axis(self) -> AnyArray:
        """Unit vector e^j in body j's frame, (3,)."""

    @property
    def offset(self) -> AnyArray:
        """From O^i to the joint's attachment point, frame i, (3,)."""

    @property
    def rotation(self) -> AnyArray:
        """From frame j at q = 0 to frame i, (3, 3)."""


class Skeleton(Protocol):
    """A tree's geometry: a `Tree`, or one on paper."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def joints(self) -> Sequence[Link]:
        """One a body, parents first."""


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """The motion of body j in frame j; leading axes are samples.

    Attributes:
        R_PB: Rotation from the body's frame B to its carrier's, the parent P, (..., 3, 3).
        z: Displacement of a prismatic joint, zero for a revolute one, (..., 3) [m].
        zdd: Absolute second derivative of z, (..., 3) [m/s^2].
        w: Angular velocity, (..., 3) [rad/s].
        wd: Angular acceleration, (..., 3) [rad/s^2].
        W: wd~ + w~ w~, (..., 3, 3) [1/s^2].
        a: xdd^j - g, acceleration of O^j less gravity, (..., 3) [m/s^2].
    """

    R_PB: AnyArray
    z: AnyArray
    zdd: AnyArray
    w: AnyArray
    wd: AnyArray
    W: AnyArray
    a: AnyArray


def kinematics(
    tree: Skeleton,
    q: AnyArray,
    qd: AnyArray,
    qdd: AnyArray,
    gravity: AnyArray,
    keep: Keep = unchanged,
) -> tuple[BodyMotion, ...]:
    """The motion of every body of the tree.

    Args:
        tree: The robot's geometry.
        q: Joint positions, (..., n) [rad or m], numbers or symbols.
        qd: Joint velocities, likewise.
        qdd: Joint accelerations, likewise.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2].
        keep: Called on each intermediate.
    """
    still = np.zeros((*q.shape[:-1], 3), dtype=q.dtype)
    flat = np.zeros((*q.shape[:-1], 3, 3), dtype=q.dtype)
    bedplate = BodyMotion(flat, still, still, still, still, flat, still - gravity)
    moving: list[BodyMotion] = []
    for j, joint in enumerate(tree.joints):
        carrier = bedplate if joint.parent < 0 else moving[joint.parent]
        moving.append(
            _step(joint, j, carrier, q[..., j], qd[..., j], qdd[..., j], keep)
        )
    return tuple(moving)


def poses(tree: Skeleton, q: Array) -> list[Transform]:
    """Poses X_WB of every body in the bedplate frame W, M of each.

    Args:
        tree: The robot's geometry.
        q: Joint positions, (M, n) [rad or m].
    """
    X_WB: list[Transform] = []
    for joint, position in zip(tree.joints, q.T, strict=True):
        R_PB = _rotation(joint, position)
        z = _along(joint.axis, 0.0 * position if joint.revolute else position)
        X_PB = Transform(R_PB, joint.offset + apply(R_PB, z))
        X_WB.append(X_PB if joint.parent < 0 else X_WB[joint.parent] @ X_PB)
    return X_WB


def _step(
    joint: Link,
    j: int,
    carrier: BodyMotion,
    q: AnyArray,
    qd: AnyArray,
    qdd: AnyArray,
    keep: Keep,
) -> BodyMotion:
    """From body i to body j."""
    e, label = joint.axis, str(j + 1)
    R_PB = _rotation(joint, q)
    R_BP = np.swapaxes(R_PB, -1, -2)
    w, wd = apply(R_BP, carrier.w), apply(R_BP, carrier.wd)
    point = apply(R_BP, carrier.a + apply(carrier.W, joint.offset))  # xdd - g of O'^j
    speed, rate = _along(e, qd), _along(e, qdd)
    if joint.revolute:
        wd = keep("wd" + label, wd + apply(skew(w), speed) + rate)
        w = keep("w" + label, w + speed)
        z = zdd = np.zeros_like(w)
    else:
        w, wd = keep("w" + label, w), keep("wd" + label, wd)
        z = _along(e, q)
        whirl = skew(wd) + skew(w) @ skew(w)
        zdd = keep("zdd" + label, apply(whirl, z) + 2 * apply(skew(w), speed) + rate)
    W = keep("W" + label, skew(wd) + skew(w) @ skew(w))
    return BodyMotion(R_PB, z, zdd, w, wd, W, keep("a" + label, point + zdd))


def _along(e: AnyArray, scalar: AnyArray) -> AnyArray:
    """Scalar times e.  scalar: (...); returns (..., 3)."""
    return np.asarray(scalar)[..., None] * e


def _rotation(joint: Link, q: AnyArray) -> AnyArray:
    """R_PB: A, times Rot(e, q) = e e' + c (1 - e e') + s e~ if revolute."""
    if not joint.revolute:
        fixed = np.broadcast_to(joint.rotation, (*np.shape(q), 3, 3))
        return fixed.astype(np.asarray(q).dtype)
    e = joint.axis
    c, s = (np.asarray(f(q))[..., None, None] for f in (np.cos, np.sin))
    axial = np.outer(e, e)
    R_PB: AnyArray = joint.rotation @ (axial + c * (np.eye(3) - axial) + s * skew(e))
    return R_PB


def transmitted(
    tree: Skeleton,
    moving: Sequence[BodyMotion],
    theta: AnyArray,
    keep: Keep = unchanged,
    sensor: Placement | None = None,
    base: int = -1,
) -> tuple[AnyArray, AnyArray]:
    """Joint forces and the wrench that is measured.

    Args:
        tree: The robot's geometry.
        moving: The motion of its bodies.
        theta: Barycentric parameters, (n, 10, p).
        keep: Called on each intermediate.
        sensor: Where the wrench is measured; None for the bedplate.
        base: Index of the body that a sensor moves with.

    Returns:
        Q, what the motors deliver, (..., n, p) [N m or N], and the wrench of the bedplate
        on the robot about O^0 in bedplate axes, force first, (..., 6, p) [N, N m]; of a sensor,
        about its origin in its axes.
    """
    lead, p = moving[0].w.shape[:-1], theta.shape[-1]
    dtype = np.result_type(moving[0].w.dtype, theta.dtype)
    # what children pass on to P
    force = np.zeros((tree.n + 1, *lead, 3, p), dtype=dtype)
    moment = np.zeros_like(force)  # and to L; the last of each is the bedplate's
    whole = np.zeros_like(force[-1])  # F_0: to the bedplate children pass on F^j itself
    efforts: list[AnyArray] = [whole] * tree.n
    for j in reversed(range(tree.n)):
        joint, body = tree.joints[j], moving[j]
        own = own_wrench(body) @ theta[j]  # (..., 6, p)
        F = keep(f"F{j + 1}", own[..., :3, :] + force[j])
        L = own[..., 3:, :] + moment[j]
        if not joint.revolute:
            L = L + skew(body.z) @ F
        L = keep(f"L{j + 1}", L)
        if j == base:
            whole = np.concatenate([F, L - skew(body.z) @ F], axis=-2)
        efforts[j] = np.tensordot(L if joint.revolute else F, joint.axis, (-2, 0))
        # the carrier's parameters hold the child's mass at O'^j already: pass on the rest
        passed = F - body.a[..., None] * theta[j, 0] + body.zdd[..., None] * theta[j, 0]
        i = joint.parent
        passed = body.R_PB @ (passed if i >= 0 else F)
        force[i] += passed
        moment[i] += skew(joint.offset) @ passed + body.R_PB @ L
    if base < 0:
        whole = np.concatenate([force[-1], moment[-1]], axis=-2)
    if sensor is not None:
        whole = sensor.X_BS.inverse.wrench_matrix @ whole
    return np.stack(efforts, axis=-2), whole


def sensor_pose(tree: Tree, q: Array) -> Transform:
    """Poses X_WS of what measures the wrench in the bedplate frame W, M of them.

    Args:
        tree: The robot.
        q: Joint positions, (M, n) [rad or m].
    """
    return _sensor_poses(tree, q, [tree.sensor])[0]


def _sensor_poses(
    tree: Tree, q: Array, sensors: Sequence[Placement | None]
) -> list[Transform]:
    """Pose X_WS of each sensor in the bedplate frame W, M of them; None is the bedplate."""
    still = Transform(np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3)))
    moving = poses(tree, q) if any(at and at.body >= 0 for at in sensors) else []
    found = []
    for at in sensors:
        X_WB = still if at is None or at.body < 0 else moving[at.body]
        found.append(X_WB if at is None else X_WB @ at.X_BS)
    return found


def wrench_transforms(tree: Tree, q: Array) -> dict[str, Array]:
    """Wrench transforms from each of a tree's next force sensors to the tree's own.

    Args:
        tree: What lies between force sensors.
        q: Joint positions, (M, n) [rad or m].

    Returns:
        By sensor, (M, 6, 6): takes a wrench about its origin along its axes, force first.
    """
    X_WS, *following = _sensor_poses(tree, q, [tree.sensor, *tree.cuts])
    pairs = zip(tree.cuts, following, strict=True)
    return {cut.name: (X_WS.inverse @ X_WC).wrench_matrix for cut, X_WC in pairs}


def own_wrench(body: BodyMotion) -> AnyArray:
    """Wrench about O^j of one augmented body per barycentric parameter, (..., 6, 10).

    F = mbar a + W mb;  L = mb x a + K wd + w x K w.
    """
    top = np.concatenate(
        [body.a[..., None], body.W, np.zeros((*body.w.shape, 6), dtype=body.w.dtype)],
        axis=-1,
    )
    spin = np.tensordot(body.wd, TENSOR, (-1, 1)) + skew(body.w) @ np.tensordot(
        body.w, TENSOR, (-1, 1)
    )
    bottom = np.concatenate(
        [np.zeros_like(body.a[..., None]), -skew(body.a), spin], axis=-1
    )
    return np.concatenate([top, bottom], axis=-2)


BLOCK = 1024
"""Samples taken at once."""


def joint_forces(tree: Tree, motion: Motion, gravity: ArrayLike | None = None) -> Array:
    """What the motors deliver at the joints, friction excluded, (M, n) [N m or N].

    [FRS96] eqs. (6), (7), (20), (34): inverse dynamics.

    Args:
        tree: The robot.
        motion: M samples, columns in the order of `tree.names`.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    return linear(tree, motion, barycentric(tree)[..., None], gravity)[0][..., 0]


def base_wrench(tree: Tree, motion: Motion, gravity: ArrayLike | None = None) -> Array:
    """Wrench of the bedplate on the moving bodies, (M, 6) [N, N m].

    Force first, bedplate axes, moment about O^0; the pedestal is not included. [FRS96]
    eqs. (6), (7) for the first joints.

    Args:
        tree: The robot.
        motion: M samples, columns in the order of `tree.names`.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    return linear(tree, motion, barycentric(tree)[..., None], gravity)[1][..., 0]


def parameter_regressor(
    tree: Tree, motion: Motion, model: Model, gravity: ArrayLike | None = None
) -> Array:
    """The regressor on all barycentric parameters, (M, n or 6, 10 n).

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples, columns in the order of `tree.names`.
        model: "dynamic" for joint forces, "reaction" for the base wrench.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
    joints, base = linear(tree, motion, theta, gravity)
    return joints if model == "dynamic" else base


def pedestal_wrench(tree: Tree, gravity: ArrayLike | None = None) -> Array:
    """What is measured of the pedestal, which does not move, (6,) [N, N m].

    By the bedplate, or by a force sensor that carries a part of it.

    Args:
        tree: The robot.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    g = tree.gravity_or(gravity)
    pedestal = tree.pedestal
    wrench = -np.concatenate([pedestal.mass * g, np.cross(pedestal.first_moment, g)])
    return wrench if tree.sensor is None else tree.sensor.X_BS.inverse.wrench(wrench)


def blocks(samples: int, size: int = BLOCK) -> Iterator[slice]:
    """Consecutive slices of at most `size` samples."""
    return (slice(first, first + size) for first in range(0, samples, size))


def linear(
    tree: Tree, motion: Motion, theta: Array, gravity: ArrayLike | None = None
) -> tuple[Array, Array]:
    """Joint forces (M, n, p) and base wrench (M, 6, p) of p sets of parameters.

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples, columns in the order of `tree.names`.
        theta: Barycentric parameters, (n, 10, p).
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
    """
    if motion.q.shape[1] != tree.n:
        raise ValueError(f"a motion of {motion.q.shape[1]} joints, a robot of {tree.n}")
    g = tree.gravity_or(gravity)
    joints, base = (
        np.empty((motion.samples, rows, theta.shape[-1])) for rows in (tree.n, 6)
    )
    for part in blocks(motion.samples):
        at = motion[part]
        joints[part], base[part] = transmitted(
            tree,
            kinematics(tree, at.q, at.qd, at.qdd, g),
            theta,
            sensor=tree.sensor,
            base=tree.sensor_body,
        )
    return joints, base
