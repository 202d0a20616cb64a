"""A random tree that rides on a base whose pose is measured, and a recording that is true of it."""

from __future__ import annotations

from functools import cache

import numpy as np

import testbed as tb
from testbed.core.robot.free_base import N_BASE_COORDINATES, base_poses
from testbed.core.robot.free_root import with_free_base
from tests.helpers.measured import random_fourier
from tests.helpers.robots import random_robot


@cache
def riding(seed: int) -> tuple[tb.Tree, tb.Recording]:
    """The tree on its free base, and 12 s of positions, pose and wrench.

    Args:
        seed: Of robot, motion and noise.
    """
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 3).tree()
    free = with_free_base(tree)
    whole = random_fourier(free, rng, 1.0)
    share = np.where(np.arange(free.n) < N_BASE_COORDINATES, 0.3, 1.0)[:, None]
    motion = tb.Fourier(
        whole.fundamental, share[:, 0] * whole.offset, share * whole.sine, share * whole.cosine
    )
    time = np.arange(0, 12, 5e-3)
    path = motion.at(time)
    wrench = tb.base_wrench(free, path) + rng.normal(size=(len(time), 6)) * 0.05
    base = base_poses(path.q[:, :N_BASE_COORDINATES])
    recording = tb.Recording(
        tree.names, time, path.q[:, N_BASE_COORDINATES:], wrench=wrench, tare=np.zeros(6), base=base
    )
    return free, recording
