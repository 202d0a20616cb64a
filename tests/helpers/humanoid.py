"""A humanoid that squats with a measured pose; what carries it, or a part of it, is Pinocchio's."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.robot.free_base import N_BASE_COORDINATES
from tests.helpers.paths import REAL

G1 = REAL / "g1_description/urdf/g1_29dof_rev_1_0.urdf"


def by_pinocchio(
    names: tuple[str, ...], path: tb.Fourier, time: Array, step: float = 1e-4, joint: str = ""
) -> tuple[Array, Array]:
    """The ground's wrench about its origin along a motion, (M, 6), and poses, (M, 7).

    With a joint, what its carrier exerts on the link beyond it, in that link's frame. Velocities
    and accelerations are differences of configurations so many seconds apart.
    """
    model = pin.buildModelFromUrdf(str(G1), pin.JointModelFreeFlyer())
    data = model.createData()
    place = [model.joints[model.getJointId(name)].idx_q for name in names]

    def configurations(shift: float) -> Array:
        q = path.at(time + shift).q
        found = np.zeros((len(q), model.nq))
        found[:, :3], found[:, place] = q[:, :3], q[:, N_BASE_COORDINATES:]
        found[:, 3:7] = Rotation.from_euler("ZYX", q[:, 3:6]).as_quat()
        return found

    now, wrenches = configurations(0.0), []
    for q, before, after in zip(now, configurations(-step), configurations(step), strict=True):
        back, on = (pin.difference(model, q, other) for other in (before, after))
        own = pin.rnea(model, data, q, (on - back) / (2 * step), (on + back) / step**2)[:6]
        if joint:
            wrenches.append(np.array(data.f[model.getJointId(joint)].vector))
            continue
        turn = pin.Quaternion(q[3:7]).matrix()
        force = turn @ own[:3]
        wrenches.append(np.concatenate([force, turn @ own[3:] + np.cross(q[:3], force)]))
    return np.array(wrenches), now[:, [0, 1, 2, 6, 3, 4, 5]]


def squatting(tree: tb.Tree, seed: int) -> tb.Fourier:
    """Knees bend and stretch, the base goes down and up and sways, arms and waist move."""
    rng, n = np.random.default_rng(seed), tree.n + N_BASE_COORDINATES
    size = np.concatenate([[0.03] * 3, [0.1] * 3, [0.3] * tree.n])[:, None] / np.sqrt(20)
    sine, cosine = size * rng.normal(size=(2, n, 20))
    offset = np.zeros(n)
    offset[2] = 0.72
    cosine[2, 3] += 0.06
    bends = (("hip_pitch", -1.0), ("knee", 2.0), ("ankle_pitch", -1.0))
    for side in ("left", "right"):
        for part, share in bends:
            k = N_BASE_COORDINATES + tree.index(f"{side}_{part}_joint")
            offset[k], cosine[k, 3] = 0.45 * share, cosine[k, 3] - 0.45 * share
    return within(tree, tb.Fourier(0.05, offset, sine, cosine))


def within(tree: tb.Tree, motion: tb.Fourier) -> tb.Fourier:
    """The same with each joint inside its range: smaller where it must be, and moved."""
    low, high = np.array([joint.position_range for joint in tree.joints]).T
    q = motion.at(np.linspace(0, motion.period, 1000)).q[:, N_BASE_COORDINATES:]
    share = np.minimum(1.0, 0.9 * (high - low) / np.ptp(q, axis=0))
    middle = motion.offset[N_BASE_COORDINATES:]
    least, most = (middle + share * (each - middle) for each in (q.min(axis=0), q.max(axis=0)))
    room = 0.05 * (high - low)
    moved = np.maximum(low + room - least, 0.0) - np.maximum(most - high + room, 0.0)
    every = np.concatenate([np.ones(N_BASE_COORDINATES), share])[:, None]
    offset = motion.offset + np.concatenate([np.zeros(N_BASE_COORDINATES), moved])
    return tb.Fourier(motion.fundamental, offset, every * motion.sine, every * motion.cosine)


def humanoid(
    duration: float, rate: float, seed: int, noise: float, joint: str = ""
) -> tuple[tb.Tree, tb.Recording]:
    """Encoders, pose and the sum of two plates, all with noise; the wrench is Pinocchio's.

    With a joint it hangs in the air, and a force sensor at that joint takes the plates' place.
    """
    tree = tb.load_tree(G1, weld_root=True)
    path, time = squatting(tree, seed), np.arange(0, duration, 1 / rate)
    motion, (wrench, base) = path.at(time), by_pinocchio(tree.names, path, time, joint=joint)
    rng = np.random.default_rng(seed + 1)
    rough = rng.normal(size=wrench.shape) * ([0.5] * 3 + [0.05] * 3)
    return tree, tb.Recording(
        tree.names,
        time,
        motion.q[:, N_BASE_COORDINATES:] + noise * 1e-5 * rng.normal(size=(len(time), tree.n)),
        wrench=wrench + noise * rough,
        tare=None if joint else np.zeros(6),
        base=base + noise * 1e-5 * rng.normal(size=base.shape),
    )
