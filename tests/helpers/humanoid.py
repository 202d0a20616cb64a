"""A humanoid that squats on plates with a measured pose; the ground's wrench is Pinocchio's."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import testbed as tb
from testbed.arrays import Array
from testbed.excitation.fourier import Fourier
from testbed.recordings.recording import Recording
from testbed.robot.free_base import FREE
from tests.helpers.paths import REAL

G1 = REAL / "g1_description/urdf/g1_29dof_rev_1_0.urdf"


def of_pinocchio(
    model: pin.Model, names: tuple[str, ...], motion: tb.Motion, step: float, ends: list[tb.Motion]
) -> tuple[Array, Array]:
    """The ground's wrench about its origin along a motion, (M, 6), and poses, (M, 7)."""
    data = model.createData()
    place = [model.joints[model.getJointId(name)].idx_v for name in names]
    before, after = (_twists(each) for each in ends)
    twist, change = _twists(motion), (after - before) / (2 * step)
    wrenches, poses = [], []
    for k in range(motion.samples):
        turn = _turn(motion.q[k, 3:6])
        q, v, a = np.zeros(model.nq), np.zeros(model.nv), np.zeros(model.nv)
        q[:3], v[:6], a[:6] = motion.q[k, :3], twist[k], change[k]
        q[3:7] = pin.Quaternion(turn).coeffs()
        q[np.array(place) + 1], v[place], a[place] = (
            each[k, FREE:] for each in (motion.q, motion.qd, motion.qdd)
        )
        own = pin.rnea(model, data, q, v, a)[:6]
        force = turn @ own[:3]
        wrenches.append(np.concatenate([force, turn @ own[3:] + np.cross(q[:3], force)]))
        poses.append([*q[:3], q[6], *q[3:6]])
    return np.array(wrenches), np.array(poses)


def _turn(angles: Array) -> Array:
    """Rz Ry Rx of yaw, pitch and roll."""
    turns = [pin.utils.rotate(axis, float(x)) for axis, x in zip("zyx", angles, strict=True)]
    return np.asarray(turns[0] @ turns[1] @ turns[2])


def _twists(motion: tb.Motion) -> Array:
    """Of the base in its own axes, (M, 6): by the textbook's rates of yaw, pitch and roll."""
    found = np.zeros((motion.samples, 6))
    for k, (q, qd) in enumerate(zip(motion.q, motion.qd, strict=True)):
        _, pitch, roll = q[3:6]
        yaws, pitches, rolls = qd[3:6]
        found[k, :3] = _turn(q[3:6]).T @ qd[:3]
        found[k, 3:] = [
            rolls - yaws * np.sin(pitch),
            pitches * np.cos(roll) + yaws * np.cos(pitch) * np.sin(roll),
            -pitches * np.sin(roll) + yaws * np.cos(pitch) * np.cos(roll),
        ]
    return found


def squatting(tree: tb.Tree, seed: int) -> Fourier:
    """Knees bend and stretch, the base goes down and up and sways, arms and waist move."""
    rng, n = np.random.default_rng(seed), tree.n + FREE
    size = np.concatenate([[0.03] * 3, [0.1] * 3, [0.3] * tree.n])[:, None] / np.sqrt(20)
    sine, cosine = size * rng.normal(size=(2, n, 20))
    offset = np.zeros(n)
    offset[2] = 0.72
    cosine[2, 3] += 0.06
    bends = (("hip_pitch", -1.0), ("knee", 2.0), ("ankle_pitch", -1.0))
    for side in ("left", "right"):
        for part, share in bends:
            k = FREE + tree.index(f"{side}_{part}_joint")
            offset[k], cosine[k, 3] = 0.45 * share, cosine[k, 3] - 0.45 * share
    return within(tree, Fourier(0.05, offset, sine, cosine))


def within(tree: tb.Tree, motion: Fourier) -> Fourier:
    """The same with each joint inside its range: smaller where it must be, and moved."""
    low, high = np.array([joint.position_range for joint in tree.joints]).T
    q = motion.at(np.linspace(0, motion.period, 1000)).q[:, FREE:]
    share = np.minimum(1.0, 0.9 * (high - low) / np.ptp(q, axis=0))
    middle = motion.offset[FREE:]
    least, most = (middle + share * (each - middle) for each in (q.min(axis=0), q.max(axis=0)))
    room = 0.05 * (high - low)
    moved = np.maximum(low + room - least, 0.0) - np.maximum(most - high + room, 0.0)
    every = np.concatenate([np.ones(FREE), share])[:, None]
    offset = motion.offset + np.concatenate([np.zeros(FREE), moved])
    return Fourier(motion.fundamental, offset, every * motion.sine, every * motion.cosine)


def humanoid(duration: float, rate: float, seed: int, noise: float) -> tuple[tb.Tree, Recording]:
    """Encoders, pose and the sum of two plates, all with noise; the wrench is Pinocchio's."""
    tree = tb.load_tree(G1, weld_root=True)
    path, step = squatting(tree, seed), 1e-4
    time = np.arange(0, duration, 1 / rate)
    motion, *ends = (path.at(time + shift) for shift in (0.0, -step, step))
    model = pin.buildModelFromUrdf(str(G1), pin.JointModelFreeFlyer())
    wrench, base = of_pinocchio(model, tree.names, motion, step, ends)
    rng = np.random.default_rng(seed + 1)
    rough = rng.normal(size=wrench.shape) * ([0.5] * 3 + [0.05] * 3)
    return tree, Recording(
        tree.names,
        time,
        motion.q[:, FREE:] + noise * 1e-5 * rng.normal(size=(len(time), tree.n)),
        wrench=wrench + noise * rough,
        tare=np.zeros(6),
        base=base + noise * 1e-5 * rng.normal(size=base.shape),
    )
