"""Recursive Newton-Euler inverse dynamics of a tree, with numbers or symbols."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import (
    AnyArray,
    Array,
    freeze_arrays,
    multiply_vectors,
    skew,
)
from testbed.core.base.summary_table import Value
from testbed.core.base.transform import Transform
from testbed.core.parameters.rules import Signal
from testbed.core.parameters.symbols import TENSOR_FROM_SIX, barycentric
from testbed.core.robot.tree import SensorPlacement, Tree


@dataclass(frozen=True, eq=False)
class Motion(Value):
    """Motion of n joints at M samples; columns in the order of `tree.names`.

    Attributes:
        t: Time, (M,) [s].
        q: Joint positions, (M, n) [rad or m].
        qd: Joint velocities, (M, n) [rad/s or m/s].
        qdd: Joint accelerations, (M, n) [rad/s^2 or m/s^2].
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array

    def __post_init__(self) -> None:
        freeze_arrays(self, t=(None,))
        shape = (len(self.t), np.shape(self.q)[-1] if np.ndim(self.q) else 0)
        freeze_arrays(self, q=shape, qd=shape, qdd=shape)

    @staticmethod
    def at_rest(postures: Array) -> Motion:
        """Static motion with one sample per posture.

        Args:
            postures: Joint positions, (M, n) [rad or m].
        """
        zeros = np.zeros_like(postures)
        return Motion(np.arange(float(len(postures))), postures, zeros, zeros)

    @property
    def samples(self) -> int:
        """Number M of samples."""
        return len(self.t)

    def __getitem__(self, part: slice) -> Motion:
        """Motion at the samples of a slice."""
        return Motion(self.t[part], self.q[part], self.qd[part], self.qdd[part])


Substitution = Callable[[str, AnyArray], AnyArray]
"""Function of the name and value of an intermediate result, such as "w3"; returns a new value."""


def keep_value(name: str, value: AnyArray) -> AnyArray:
    """Return the value unchanged: default for computations with numbers."""
    del name
    return value


class LinkGeometry(Protocol):
    """Geometry of a joint: a `Joint`, or symbolic lengths and axes."""

    @property
    def parent(self) -> int:
        """Index of the carrying body, -1 for the bedplate."""

    @property
    def revolute(self) -> bool:
        """True for a revolute joint, False for a prismatic joint."""

    @property
    def axis(self) -> AnyArray:
        """Unit vector e^j in body j's frame, (3,)."""

    @property
    def offset(self) -> AnyArray:
        """Position of the joint's attachment point relative to O^i, in frame i, (3,) [m]."""

    @property
    def rotation(self) -> AnyArray:
        """Rotation matrix from frame j at q = 0 to frame i, (3, 3)."""


class TreeGeometry(Protocol):
    """Geometry of a tree: a `Tree`, or symbolic lengths and axes."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def joints(self) -> Sequence[LinkGeometry]:
        """Geometry of each joint, parents first."""


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """Rotation, velocity and acceleration of body j in frame j; leading axes are samples.

    Attributes:
        R_PB: Rotation from the body's frame B to its carrier's frame P, (..., 3, 3).
        z: Displacement of a prismatic joint, zero for a revolute joint, (..., 3) [m].
        zdd: Absolute second derivative of z, (..., 3) [m/s^2].
        w: Angular velocity, (..., 3) [rad/s].
        wd: Angular acceleration, (..., 3) [rad/s^2].
        W: Matrix wd~ + w~ w~ with w~ v = w x v, (..., 3, 3) [1/s^2].
        a: Acceleration of the frame's origin O^j minus gravity, xdd^j - g, (..., 3) [m/s^2].
    """

    R_PB: AnyArray
    z: AnyArray
    zdd: AnyArray
    w: AnyArray
    wd: AnyArray
    W: AnyArray
    a: AnyArray


def forward_recursion(
    tree: TreeGeometry,
    q: AnyArray,
    qd: AnyArray,
    qdd: AnyArray,
    gravity: AnyArray,
    substitute: Substitution = keep_value,
) -> tuple[BodyMotion, ...]:
    """Motion of every body by the forward recursion, [FRS96].

    Args:
        tree: Geometry of the robot.
        q: Joint positions, (..., n) [rad or m], numbers or symbols.
        qd: Joint velocities, (..., n).
        qdd: Joint accelerations, (..., n).
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2].
        substitute: Function that replaces each intermediate result, for example by a symbol.
    """
    zeros = np.zeros((*q.shape[:-1], 3), dtype=q.dtype)
    zero_matrices = np.zeros((*q.shape[:-1], 3, 3), dtype=q.dtype)
    bedplate = BodyMotion(
        zero_matrices, zeros, zeros, zeros, zeros, zero_matrices, zeros - gravity
    )
    motions: list[BodyMotion] = []
    for j, joint in enumerate(tree.joints):
        carrier = bedplate if joint.parent < 0 else motions[joint.parent]
        motions.append(
            _body_motion(
                joint, j, carrier, q[..., j], qd[..., j], qdd[..., j], substitute
            )
        )
    return tuple(motions)


def poses(tree: TreeGeometry, q: Array) -> list[Transform]:
    """Pose X_WB of every body in the bedplate frame W, at M samples.

    Args:
        tree: Geometry of the robot.
        q: Joint positions, (M, n) [rad or m].
    """
    X_WB: list[Transform] = []
    for joint, position in zip(tree.joints, q.T, strict=True):
        R_PB = _rotation(joint, position)
        z = _scaled_vectors(joint.axis, 0.0 * position if joint.revolute else position)
        X_PB = Transform(R_PB, joint.offset + multiply_vectors(R_PB, z))
        X_WB.append(X_PB if joint.parent < 0 else X_WB[joint.parent] @ X_PB)
    return X_WB


def _body_motion(
    joint: LinkGeometry,
    j: int,
    carrier: BodyMotion,
    q: AnyArray,
    qd: AnyArray,
    qdd: AnyArray,
    substitute: Substitution,
) -> BodyMotion:
    """Motion of body j from the motion of its carrier, body i.

    Args:
        joint: Geometry of the joint.
        j: Index of the body, for the names of intermediate results.
        carrier: Motion of body i.
        q: Joint position, (...).
        qd: Joint velocity, (...).
        qdd: Joint acceleration, (...).
        substitute: Function that replaces each intermediate result.
    """
    e, number = joint.axis, str(j + 1)
    R_PB = _rotation(joint, q)
    R_BP = np.swapaxes(R_PB, -1, -2)
    w, wd = multiply_vectors(R_BP, carrier.w), multiply_vectors(R_BP, carrier.wd)
    point = multiply_vectors(
        R_BP, carrier.a + multiply_vectors(carrier.W, joint.offset)
    )  # xdd - g of O'^j
    speed, rate = _scaled_vectors(e, qd), _scaled_vectors(e, qdd)
    if joint.revolute:
        wd = substitute("wd" + number, wd + multiply_vectors(skew(w), speed) + rate)
        w = substitute("w" + number, w + speed)
        z = zdd = np.zeros_like(w)
    else:
        w, wd = substitute("w" + number, w), substitute("wd" + number, wd)
        z = _scaled_vectors(e, q)
        acceleration_matrix = skew(wd) + skew(w) @ skew(w)
        zdd = substitute(
            "zdd" + number,
            multiply_vectors(acceleration_matrix, z)
            + 2 * multiply_vectors(skew(w), speed)
            + rate,
        )
    W = substitute("W" + number, skew(wd) + skew(w) @ skew(w))
    return BodyMotion(R_PB, z, zdd, w, wd, W, substitute("a" + number, point + zdd))


def _scaled_vectors(e: AnyArray, scalar: AnyArray) -> AnyArray:
    """Product of scalars, (...), and a vector e, (3,); shape (..., 3)."""
    return np.asarray(scalar)[..., None] * e


def _rotation(joint: LinkGeometry, q: AnyArray) -> AnyArray:
    """Rotation R_PB from the body frame to the carrier frame, (..., 3, 3).

    R_PB is A Rot(e, q) for a revolute joint and A for a prismatic joint, where A is the rotation at
    q = 0 and Rot(e, q) = e e' + cos(q) (1 - e e') + sin(q) e~.
    """
    if not joint.revolute:
        fixed = np.broadcast_to(joint.rotation, (*np.shape(q), 3, 3))
        return fixed.astype(np.asarray(q).dtype)
    e = joint.axis
    c, s = (np.asarray(f(q))[..., None, None] for f in (np.cos, np.sin))
    axial = np.outer(e, e)
    R_PB: AnyArray = joint.rotation @ (axial + c * (np.eye(3) - axial) + s * skew(e))
    return R_PB


def backward_recursion(
    tree: TreeGeometry,
    motions: Sequence[BodyMotion],
    theta: AnyArray,
    substitute: Substitution = keep_value,
    sensor: SensorPlacement | None = None,
    base: int = -1,
) -> tuple[AnyArray, AnyArray]:
    """Joint forces and the measured wrench by the backward recursion, [FRS96].

    Args:
        tree: Geometry of the robot.
        motions: Motion of each body.
        theta: Barycentric parameters mbar mbx mby mbz Kxx Kxy Kxz Kyy Kyz Kzz, (n, 10, p).
        substitute: Function that replaces each intermediate result.
        sensor: Placement of the force sensor; None for the bedplate.
        base: Index of the body that carries the sensor, -1 for the bedplate.

    Returns:
        Joint forces Q, exerted by the motors, (..., n, p) [N m or N]; and the wrench of the
        bedplate on the robot about O^0 along the bedplate's axes, force first, (..., 6, p)
        [N, N m], or with a sensor the wrench about the sensor's origin along its axes.
    """
    sample_shape, p = motions[0].w.shape[:-1], theta.shape[-1]
    dtype = np.result_type(motions[0].w.dtype, theta.dtype)
    # sums of the forces and moments of the children, on each carrier
    force = np.zeros((tree.n + 1, *sample_shape, 3, p), dtype=dtype)
    moment = np.zeros_like(force)  # the last of each is for the bedplate
    measured_wrench = np.zeros_like(force[-1])  # F_0 is the sum of F^j, uncorrected
    efforts: list[AnyArray] = [measured_wrench] * tree.n
    for j in reversed(range(tree.n)):
        joint, body = tree.joints[j], motions[j]
        body_wrench = body_regressor(body) @ theta[j]  # (..., 6, p)
        F = substitute(f"F{j + 1}", body_wrench[..., :3, :] + force[j])
        L = body_wrench[..., 3:, :] + moment[j]
        if not joint.revolute:
            L = L + skew(body.z) @ F
        L = substitute(f"L{j + 1}", L)
        if j == base:
            measured_wrench = np.concatenate([F, L - skew(body.z) @ F], axis=-2)
        efforts[j] = np.tensordot(L if joint.revolute else F, joint.axis, (-2, 0))
        # less the inertial force of the mass, which the carrier's parameters include at O'^j
        carrier_force = (
            F - body.a[..., None] * theta[j, 0] + body.zdd[..., None] * theta[j, 0]
        )
        i = joint.parent
        carrier_force = body.R_PB @ (carrier_force if i >= 0 else F)
        force[i] += carrier_force
        moment[i] += skew(joint.offset) @ carrier_force + body.R_PB @ L
    if base < 0:
        measured_wrench = np.concatenate([force[-1], moment[-1]], axis=-2)
    if sensor is not None:
        measured_wrench = sensor.X_BS.inverse.wrench_matrix @ measured_wrench
    return np.stack(efforts, axis=-2), measured_wrench


def sensor_poses(tree: Tree, q: Array) -> Transform:
    """Pose X_WS of the wrench sensor in the bedplate frame W, at M samples.

    Args:
        tree: The robot.
        q: Joint positions, (M, n) [rad or m].
    """
    return _sensor_poses(tree, q, [tree.sensor])[0]


def _sensor_poses(
    tree: Tree, q: Array, sensors: Sequence[SensorPlacement | None]
) -> list[Transform]:
    """Pose X_WS of each sensor in the bedplate frame W, at M samples.

    Args:
        tree: The robot.
        q: Joint positions, (M, n) [rad or m].
        sensors: Placements of the sensors; None for the bedplate.
    """
    identity = Transform(
        np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
    )
    body_poses = (
        poses(tree, q) if any(sensor and sensor.body >= 0 for sensor in sensors) else []
    )
    X_WS = []
    for sensor in sensors:
        X_WB = (
            identity if sensor is None or sensor.body < 0 else body_poses[sensor.body]
        )
        X_WS.append(X_WB if sensor is None else X_WB @ sensor.X_BS)
    return X_WS


def wrench_transforms(tree: Tree, q: Array) -> dict[str, Array]:
    """Transforms of wrenches from the sensors at a tree's cuts to the tree's sensor.

    Args:
        tree: Part of a robot between force sensors.
        q: Joint positions, (M, n) [rad or m].

    Returns:
        Wrench transforms by name of the cut, (M, 6, 6), for wrenches about the sensor's origin
        along its axes, force first.
    """
    X_WS, *X_WC_of_cuts = _sensor_poses(tree, q, [tree.sensor, *tree.cuts])
    pairs = zip(tree.cuts, X_WC_of_cuts, strict=True)
    return {cut.name: (X_WS.inverse @ X_WC).wrench_matrix for cut, X_WC in pairs}


def body_regressor(body: BodyMotion) -> AnyArray:
    """Regressor of the wrench about O^j that moves one augmented body, (..., 6, 10).

    The columns belong to mbar mbx mby mbz Kxx Kxy Kxz Kyy Kyz Kzz; the rows are force, then moment,
    along the axes of frame j. The Newton-Euler equations are linear in these parameters:
        F = mbar a + W mb
        L = mb x a + K wd + w x K w
    """
    force_rows = np.concatenate(
        [body.a[..., None], body.W, np.zeros((*body.w.shape, 6), dtype=body.w.dtype)],
        axis=-1,
    )
    inertia_columns = np.tensordot(body.wd, TENSOR_FROM_SIX, (-1, 1)) + skew(
        body.w
    ) @ np.tensordot(body.w, TENSOR_FROM_SIX, (-1, 1))
    moment_rows = np.concatenate(
        [np.zeros_like(body.a[..., None]), -skew(body.a), inertia_columns], axis=-1
    )
    return np.concatenate([force_rows, moment_rows], axis=-2)


BLOCK_SAMPLES = 1024
"""Largest number of samples processed at once."""


def joint_forces(tree: Tree, motion: Motion, gravity: ArrayLike | None = None) -> Array:
    """Inverse dynamics: joint forces of the motors, friction excluded, (M, n) [N m or N].

    [FRS96] eqs. (6), (7), (20), (34).

    Args:
        tree: The robot.
        motion: M samples, columns in the order of `tree.names`.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2]; default the model file's.
    """
    return linear_inverse_dynamics(tree, motion, barycentric(tree)[..., None], gravity)[
        0
    ][..., 0]


def base_wrench(tree: Tree, motion: Motion, gravity: ArrayLike | None = None) -> Array:
    """Wrench of the bedplate on the moving bodies, (M, 6) [N, N m].

    Force first, along the bedplate's axes, moment about O^0; the pedestal is not included. For a
    tree with a force sensor, the wrench is that of the sensor, about its origin and along its axes.
    [FRS96] eqs. (6), (7).

    Args:
        tree: The robot.
        motion: M samples, columns in the order of `tree.names`.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2]; default the model file's.
    """
    return linear_inverse_dynamics(tree, motion, barycentric(tree)[..., None], gravity)[
        1
    ][..., 0]


def parameter_regressor(
    tree: Tree, motion: Motion, model: Signal, gravity: ArrayLike | None = None
) -> Array:
    """Regressor of joint forces or base wrench on all barycentric parameters, (M, n or 6, 10 n).

    Columns are in the order mbar mbx mby mbz Kxx Kxy Kxz Kyy Kyz Kzz, body by body.

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples, columns in the order of `tree.names`.
        model: "torque" for joint forces, "wrench" for the base wrench.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2]; default the model file's.
    """
    theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
    joints, base = linear_inverse_dynamics(tree, motion, theta, gravity)
    return joints if model == "torque" else base


def pedestal_wrench(tree: Tree, gravity: ArrayLike | None = None) -> Array:
    """Static wrench that the bedplate or the force sensor exerts on the pedestal, (6,) [N, N m].

    The pedestal is the part of the robot that does not move; a force sensor may carry some of it.
    The wrench is force first, in the frame of the bedplate or of the sensor.

    Args:
        tree: The robot.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2]; default the model file's.
    """
    g = tree.gravity_or(gravity)
    pedestal = tree.pedestal
    wrench = -np.concatenate([pedestal.mass * g, np.cross(pedestal.first_moment, g)])
    return wrench if tree.sensor is None else tree.sensor.X_BS.inverse.wrench(wrench)


def sample_slices(samples: int, size: int = BLOCK_SAMPLES) -> Iterator[slice]:
    """Consecutive slices of at most `size` samples."""
    return (slice(first, first + size) for first in range(0, samples, size))


def linear_inverse_dynamics(
    tree: Tree, motion: Motion, theta: Array, gravity: ArrayLike | None = None
) -> tuple[Array, Array]:
    """Joint forces, (M, n, p), and base wrench, (M, 6, p), for p sets of parameters.

    Inverse dynamics is linear in the parameters, so a column of `theta` may be the parameters of a
    robot or a direction in parameter space. Frames and signs are as in `joint_forces` and
    `base_wrench`.

    Args:
        tree: The robot; only its geometry matters.
        motion: M samples, columns in the order of `tree.names`.
        theta: Barycentric parameters mbar mbx mby mbz Kxx Kxy Kxz Kyy Kyz Kzz, (n, 10, p).
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2]; default the model file's.
    """
    if motion.q.shape[1] != tree.n:
        raise ValueError(f"a motion of {motion.q.shape[1]} joints, a robot of {tree.n}")
    g = tree.gravity_or(gravity)
    joints, base = (
        np.empty((motion.samples, rows, theta.shape[-1])) for rows in (tree.n, 6)
    )
    for part in sample_slices(motion.samples):
        block = motion[part]
        joints[part], base[part] = backward_recursion(
            tree,
            forward_recursion(tree, block.q, block.qd, block.qdd, g),
            theta,
            sensor=tree.sensor,
            base=tree.sensor_body,
        )
    return joints, base
