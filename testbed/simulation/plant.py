"""The plant: a compiled model on its plate, and the check that it is the robot we think it is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import base_wrench, joint_forces
from testbed.dynamics.motion import Motion
from testbed.errors import ModelError
from testbed.excitation.limits import limits_of
from testbed.robot.friction import ROTOR, friction_torque
from testbed.robot.tree import Tree

SAME = 1e-9
"""Largest relative difference between the plant and the tree's own equations."""

_SPEED = 0.5  # of the joints in the self-check: well outside the band where friction is soft


@dataclass(frozen=True, eq=False)
class Plant:
    """A compiled model with what is needed to drive it and to read its plate.

    Attributes:
        model: The MuJoCo model.
        order: For each joint of the tree, its index among MuJoCo's velocities, (n,).
        dofs: How MuJoCo's positions and velocities go with the joints', (nv, n): one for each
            joint, a ratio for what a joint takes along.
        positions: Where its position stands among the sensor data, (n,).
        velocities: Likewise its velocity, (n,).
        plate: Where the plate's force and moment stand among the sensor data, (6,).
        plate_turn: Rotation from the sensor's axes to the bedplate's, (3, 3).
        plate_origin: The sensor's origin in the bedplate frame, (3,) [m].
        tare: Static wrench of what stands on the plate without moving, (6,) [N, N m],
            bedplate axes, about O^0.
    """

    model: mujoco.MjModel
    order: Array
    dofs: Array
    positions: Array
    velocities: Array
    plate: Array
    plate_turn: Array
    plate_origin: Array
    tare: Array

    def bedplate_wrench(self, sensed: Array) -> Array:
        """From the sensor's axes and origin to the bedplate's, (..., 6) [N, N m]."""
        force = sensed[..., :3] @ self.plate_turn.T
        moment = sensed[..., 3:] @ self.plate_turn.T + np.cross(self.plate_origin, force)
        return np.concatenate([force, moment], axis=-1)


def check_plant(plant: Plant, tree: Tree, path: Path) -> None:
    """In one state: does the plant feel and need what the tree's equations say?

    Catches whatever else a model file holds that acts on the robot: springs, tendons,
    fluid, gravity compensation, a body that does not stand on the plate.

    Args:
        plant: The robot on its bedplate.
        tree: The robot as it was read, without friction where the plant has none.
        path: The file, for the message.

    Raises:
        ModelError: Says what differs.
    """
    rng = np.random.default_rng(0)
    limits = limits_of(tree)
    q = limits.middle + rng.uniform(-0.1, 0.1, tree.n) * (limits.high - limits.low)
    qd = _SPEED * rng.choice([-1.0, 1.0], tree.n) * rng.uniform(0.5, 1.0, tree.n)
    data = mujoco.MjData(plant.model)
    data.qpos[plant.order], data.qvel[plant.order] = q, qd
    mujoco.mj_forward(plant.model, data)
    qdd = data.qacc[plant.order]
    extra = -(data.qfrc_passive + data.qfrc_constraint)[plant.order]
    wrench = plant.bedplate_wrench(data.sensordata[plant.plate])
    if not (np.abs(qdd) < 1e12).all():
        raise ModelError(f"{path}: MuJoCo finds no finite acceleration; a body may lack inertia")
    motion = Motion(np.zeros(1), q[None], qd[None], qdd[None])
    friction = friction_torque(tree, qd)
    need = joint_forces(tree, motion)[0] + ROTOR.coefficients(tree) * qdd
    scale = np.abs(np.concatenate([need, friction])).max() + np.abs(wrench).max()
    names = ", ".join(
        f"'{name}'"
        for k, name in enumerate(tree.names)
        if abs(extra[k] - friction[k]) > SAME * scale
    )
    if names:
        raise ModelError(
            f"{path}: besides motor and friction something else acts on {names} (a spring, "
            "tendon, fluid or gravity compensation), which simulation does not support"
        )
    felt = np.abs(base_wrench(tree, motion)[0] + plant.tare - wrench).max()
    if max(felt, np.abs(need + extra).max()) > SAME * scale:
        raise ModelError(
            f"{path}: the plate or the joints do not feel the robot that was read (off by "
            f"{felt:.3g} N or N m); does every arm stand on the sensor, is it unfiltered?"
        )
