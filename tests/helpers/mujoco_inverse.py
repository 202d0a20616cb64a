"""Inverse dynamics by MuJoCo from a file: a witness that shares no code with the project."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

import testbed as tb
from testbed.core.base.arrays import Array


def by_mj_inverse(path: Path, tree: tb.Tree, states: tuple[Array, ...]) -> Array:
    """Joint forces by mj_inverse, (M, n), dry friction aside, which needs the solver's velocities.

    Args:
        path: The MJCF file.
        tree: Gives the joints' order.
        states: Positions, velocities, accelerations, (M, n) each.
    """
    model = mujoco.MjModel.from_xml_path(str(path))
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    at = [int(model.joint(name).qposadr[0]) for name in tree.names]
    found = []
    for q, qd, qdd in zip(*states, strict=True):
        data.qpos[at], data.qvel[at], data.qacc[at] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse[at].copy())
    return np.asarray(found, dtype=float)
