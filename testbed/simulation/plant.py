"""The plant: a compiled model on its plate, and the check that it is the robot we think it is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import base_wrench, joint_forces
from testbed.dynamics.motion import Motion
from testbed.errors import ModelError
from testbed.excitation.limits import limits_of
from testbed.robot.friction import ROTOR, friction_torque
from testbed.robot.tree import Tree

SAME = 1e-9
"""Largest relative difference between the plant and the tree's own equations."""

_OWN = 1e-6
"""The same of what acts on a joint, in parts of the greatest that this joint has."""

_NAMED = 3  # joints in one line

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
    order: NDArray[np.int64]
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
    """In a few states: does the plant feel and need what the tree's equations say?

    The motors drive it through each as they would in motion, all joints moving, or every other one
    at rest. MuJoCo's dry friction is Coulomb's only where it is overcome: without the motors a
    light link would not overcome it. Catches whatever else a model file holds that acts on the
    robot: springs, tendons, fluid, gravity compensation, a body that does not stand on the plate.

    Args:
        plant: The robot on its bedplate.
        tree: The robot as it was read, without friction where the plant has none.
        path: The file, for the message.

    Raises:
        ModelError: Says what differs.
    """
    states = [_state(plant, tree, path, moving) for moving in _moving(tree.n)]
    own = np.max([np.abs(state.motor) + np.abs(state.friction) for state in states], axis=0)
    for state in states:
        _check_forces(state, tree, own, path)
        felt = np.abs(state.expected_wrench - state.wrench).max()
        if max(felt, np.abs(state.need - state.motor - state.other).max()) > SAME * state.scale:
            raise ModelError(
                f"{path}: the plate or the joints do not feel the robot that was read (off by "
                f"{felt:.3g} N or N m); does every arm stand on the sensor, is it unfiltered?"
            )


@dataclass(frozen=True, eq=False)
class _State:
    """What acts in the plant, and what the tree expects, by joint [N m or N].

    Attributes:
        motor: What the motors do, (n,).
        friction: What friction takes, (n,).
        other: What acts besides the motors, (n,).
        need: What the joints need for the acceleration that the plant has, (n,).
        wrench: What the plate feels, bedplate axes, about O^0, (6,) [N, N m].
        expected_wrench: What it should, (6,).
    """

    motor: Array
    friction: Array
    other: Array
    need: Array
    wrench: Array
    expected_wrench: Array

    @property
    def scale(self) -> float:
        """The greatest of all that acts."""
        return float(
            np.abs(np.concatenate([self.need, self.motor])).max() + np.abs(self.wrench).max()
        )


def _moving(n: int) -> tuple[Array, ...]:
    """Which joints move, state by state: all, and every other one, (n,) each."""
    even = np.arange(n) % 2 == 0
    return np.ones(n, dtype=bool), even, ~even


def _state(plant: Plant, tree: Tree, path: Path, moving: Array) -> _State:
    """Drive the plant through a state near the middle of all ranges."""
    rng, limits = np.random.default_rng(0), limits_of(tree)
    q = limits.middle + rng.uniform(-0.1, 0.1, tree.n) * (limits.high - limits.low)
    qd = moving * _SPEED * rng.choice([-1.0, 1.0], tree.n) * rng.uniform(0.5, 1.0, tree.n)
    qdd = moving * rng.uniform(-1.0, 1.0, tree.n)
    friction = friction_torque(tree, qd)

    def need(acceleration: Array) -> tuple[Array, Motion]:
        motion = Motion(np.zeros(1), q[None], qd[None], acceleration[None])
        return joint_forces(tree, motion)[0] + ROTOR.coefficients(tree) * acceleration, motion

    motor = need(qdd)[0] + friction
    data = mujoco.MjData(plant.model)
    data.qpos[plant.order], data.qvel[plant.order], data.ctrl[:] = q, qd, motor
    mujoco.mj_forward(plant.model, data)
    found = data.qacc[plant.order]
    if not (np.abs(found) < 1e12).all():
        raise ModelError(f"{path}: MuJoCo finds no finite acceleration; a body may lack inertia")
    needed, motion = need(found)
    return _State(
        motor=motor,
        friction=friction,
        other=(data.qfrc_passive + data.qfrc_constraint)[plant.order],
        need=needed,
        wrench=plant.bedplate_wrench(data.sensordata[plant.plate]),
        expected_wrench=base_wrench(tree, motion)[0] + plant.tare,
    )


def _check_forces(state: _State, tree: Tree, own: Array, path: Path) -> None:
    """Whether friction is all that acts besides the motors.

    Args:
        state: Of the plant.
        tree: The robot.
        own: The greatest forces of each joint, (n,): a light one's are small beside others'.
        path: The file, for the message.

    Raises:
        ModelError: Names the joints, and how much acts there.
    """
    allowed = np.minimum(SAME * state.scale, _OWN * own)
    wrong = np.flatnonzero(np.abs(state.other + state.friction) > allowed)
    if not wrong.size:
        return
    said = [
        f"'{tree.names[k]}' ({state.other[k]:.4g} {_unit(tree, int(k))} found, "
        f"{-state.friction[k]:.4g} of friction expected)"
        for k in wrong[:_NAMED]
    ]
    more = f" and {wrong.size - _NAMED} more" if wrong.size > _NAMED else ""
    raise ModelError(
        f"{path}: besides motor and friction something else acts on {', '.join(said)}{more}, "
        "which the robot that was read does not have"
    )


def _unit(tree: Tree, joint: int) -> str:
    return "N m" if tree.joints[joint].revolute else "N"
