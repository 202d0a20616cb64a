"""MuJoCo in single states and along short motions: plants, and a witness of inverse dynamics."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.recordings.recording import Truth
from testbed.lab.simulation.plant import Plant, build_plant
from testbed.lab.simulation.rollout import Rollout, Sampling, simulate_motion
from testbed.motion.fourier import Fourier
from tests.helpers.paths import ROOT

PUMA = ROOT / "models/puma562.xml"


def sensed(plant: Plant, q: Array, qd: Array, effort: Array) -> tuple[Array, Array, Array]:
    """Acceleration, joint friction and bedplate wrench in one state of the plant."""
    data = mujoco.MjData(plant.model)
    data.qpos[plant.velocity_index], data.qvel[plant.velocity_index], data.ctrl[:] = q, qd, effort
    mujoco.mj_forward(plant.model, data)
    friction = -(data.qfrc_passive + data.qfrc_constraint)[plant.velocity_index]
    wrench = plant.X_BS.wrench(data.sensordata[plant.plate_index])
    return data.qacc[plant.velocity_index].copy(), friction, wrench


def check_laws(tree: tb.Tree, time: Array, true: Truth, size: float) -> None:
    """Torque less friction moves the robot, and the plate feels that motion and the pedestal.

    Args:
        tree: The robot.
        time: Instants [s].
        true: What happened then.
        size: Largest relative error.
    """
    motion = tb.Motion(time, true.position, true.velocity, true.acceleration)
    forces = tb.joint_forces(tree, motion)
    wrench = tb.base_wrench(tree, motion) + tb.pedestal_wrench(tree)
    assert np.abs(true.torque - true.friction - forces).max() <= size * np.abs(forces).max()
    assert np.abs(true.wrench - wrench).max() <= size * np.abs(wrench).max()


def run(
    tree: tb.Tree,
    path: Path,
    motion: Fourier,
    sampling: Sampling,
    step: float,
    friction: bool = True,
) -> Rollout:
    changed = tree.names if friction else ()
    plant = build_plant(
        tb.ModelFile(path), tree, step, with_friction=friction, changed_joints=changed
    )
    tree = tree if friction else tree.without_friction()
    return simulate_motion(plant, tree, motion, 1.0, 60.0, sampling)


def waving(n: int) -> Fourier:
    rng = np.random.default_rng(n)
    return Fourier(0.5, np.zeros(n), 0.2 * rng.normal(size=(n, 2)), 0.2 * rng.normal(size=(n, 2)))


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
