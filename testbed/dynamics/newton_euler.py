"""The vector equations: what every joint transmits, leaf to base.

Linear in the barycentric parameters. These are given as (n, 10, p): p = 1 for the wrenches
of one robot, p = 10 n (unit matrix) for the regressor, p = N (the lift of a minimal set)
for the minimal regressor. One recursion serves all three.

Wrenches  force first; on body j, by the body that carries it; moment about O'^j
Source    [FRS96] eqs. (6), (7) in recursive form; (20), (34)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.arrays import AnyArray, skew
from testbed.dynamics.algebra import Algebra, Skeleton
from testbed.dynamics.kinematics import BodyMotion
from testbed.parameters.barycentric import TENSOR


def transmitted(
    tree: Skeleton, moving: Sequence[BodyMotion], theta: AnyArray, algebra: Algebra
) -> tuple[AnyArray, AnyArray]:
    """Joint forces and the bedplate's wrench.

    Args:
        tree: The robot's geometry.
        moving: The motion of its bodies.
        theta: Barycentric parameters, (n, 10, p).
        algebra: Numbers or symbols.

    Returns:
        Q, what the motors deliver, (..., n, p) [N m or N], and the wrench of the bedplate
        on the robot about O^0 in bedplate axes, force first, (..., 6, p) [N, N m].
    """
    lead, p = moving[0].w.shape[:-1], theta.shape[-1]
    dtype = np.result_type(moving[0].w.dtype, theta.dtype)
    force = np.zeros((tree.n + 1, *lead, 3, p), dtype=dtype)  # what children pass on to P
    moment = np.zeros_like(force)  # and to L; the last of each is the bedplate's
    whole = np.zeros_like(force[-1])  # F_0: to the bedplate children pass on F^j itself
    joint_forces: list[AnyArray] = [whole] * tree.n
    for j in reversed(range(tree.n)):
        joint, body = tree.joints[j], moving[j]
        own = own_wrench(body) @ theta[j]  # (..., 6, p)
        F = algebra.keep(f"F{j + 1}", own[..., :3, :] + force[j])
        L = own[..., 3:, :] + moment[j]
        if not joint.revolute:
            L = L + skew(body.z) @ F
        L = algebra.keep(f"L{j + 1}", L)
        joint_forces[j] = np.tensordot(L if joint.revolute else F, joint.axis, (-2, 0))
        # the carrier's parameters hold the child's mass at O'^j already: pass on the rest
        passed = F - body.a[..., None] * theta[j, 0] + body.zdd[..., None] * theta[j, 0]
        i = joint.parent
        passed = body.turn @ (passed if i >= 0 else F)
        force[i] += passed
        moment[i] += skew(joint.offset) @ passed + body.turn @ L
    return np.stack(joint_forces, axis=-2), np.concatenate([force[-1], moment[-1]], axis=-2)


def own_wrench(body: BodyMotion) -> AnyArray:
    """Wrench about O^j of one augmented body per barycentric parameter, (..., 6, 10).

    F = mbar a + W mb;  L = mb x a + K wd + w x K w.
    """
    top = np.concatenate(
        [body.a[..., None], body.W, np.zeros((*body.w.shape, 6), dtype=body.w.dtype)], axis=-1
    )
    spin = np.tensordot(body.wd, TENSOR, (-1, 1)) + skew(body.w) @ np.tensordot(
        body.w, TENSOR, (-1, 1)
    )
    bottom = np.concatenate([np.zeros_like(body.a[..., None]), -skew(body.a), spin], axis=-1)
    return np.concatenate([top, bottom], axis=-2)
