"""A robot as `new` can take it: its root welded, its bodies repaired, what no tree moves held."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.errors import FreeRootError, LoopError, MimicError, ModelError, round_significant
from testbed.experiment.assumptions import calm_speeds, size
from testbed.identification.settings import Settings
from testbed.robot.friction import VISCOUS
from testbed.robot.locks import Travel
from testbed.robot.model_file import ModelFile, mimic_joints, nearest_bodies
from testbed.robot.repair import Bodies, Repair
from testbed.robot.tree import Tree

HOLDING = 1e3
"""Times the robot's weight, at a usual speed, is more than viscous friction takes of a joint that
moves."""
SWING = 0.5
"""Fastest that a usual motion is, of half a joint's range [1/s]."""


@dataclass(frozen=True)
class RobotFound:
    """A robot, and how its model file had to be read.

    Attributes:
        tree: The robot.
        weld_root: Whether a floating root is welded.
        lock_mimic: Whether joints that follow others are held.
        lock: Other joints that are held, and where [rad or m].
        repair: Of bodies that cannot be.
    """

    tree: Tree
    weld_root: bool
    lock_mimic: bool
    lock: Mapping[str, float]
    repair: Repair


def find_robot(model: Path, repair: Bodies | None) -> RobotFound:
    """Read the file; weld its root and hold what no tree can move, if that is what it takes.

    Args:
        model: MJCF or URDF.
        repair: Bodies in place of the file's; None for the nearest that can be.

    Raises:
        ModelError: The file cannot be read, or nothing in it moves that has a mass.
    """
    weld, masters, lock = False, set[str](), dict[str, float]()
    while True:
        try:
            held: dict[str, float | None] = dict.fromkeys(mimic_joints(model)) if masters else {}
            tree = ModelFile(model, weld, repair, held | lock).tree()
            break
        except FreeRootError:
            if weld:
                raise
            weld = True
        except MimicError as error:
            if masters:
                raise
            masters = set(error.masters.values())
        except LoopError as error:
            lock |= error.joints
    further = _grippers(tree, masters) | _stuck(tree) | _held_by_friction(tree)
    if further:
        lock |= further
        tree = ModelFile(model, weld, repair, held | lock).tree()
    if not any(inertia.mass for inertia in tree.inertias):
        raise ModelError(
            f"{model}: no link that moves has a mass; `testbed minimal` says what could be known"
        )
    nearest = nearest_bodies(model, weld_root=weld, lock=held | lock)
    return RobotFound(tree, weld, bool(masters), lock, nearest)


def _stuck(tree: Tree) -> dict[str, float]:
    """Joints without room, and where they rest; none if no other moves.

    Their range is one position, or so short that a motion is never faster than what counts as
    rest: no torque of theirs would tell anything, and none of the robot's without them.
    """
    found = {
        joint.name: round_significant(Travel(*joint.position_range).rest, 6)
        for joint in tree.joints
        if min(np.ptp(joint.position_range) / 2 * SWING, joint.max_velocity) < Settings().deadband
    }
    return found if len(found) < tree.n else {}


def _held_by_friction(tree: Tree) -> dict[str, float]:
    """Joints that files hold by their damping, and where they rest; none if no other moves."""
    weight = 9.81 * sum(body.mass for body in tree.inertias)
    lever = np.where([joint.revolute for joint in tree.joints], size(tree), 1.0)
    brakes = VISCOUS.coefficients(tree) * calm_speeds(tree) > HOLDING * weight * lever
    found = {
        joint.name: round_significant(Travel(*joint.position_range).rest, 6)
        for joint, held in zip(tree.joints, brakes, strict=True)
        if held
    }
    return found if len(found) < tree.n else {}


def _grippers(tree: Tree, masters: set[str]) -> dict[str, float]:
    """Joints that others follow and that carry none, and where they rest: a gripper's fingers.

    Their stroke is too short for their masses to be told.
    """
    carrying = {joint.parent for joint in tree.joints}
    own = [j for j, name in enumerate(tree.names) if name in masters and j not in carrying]
    if len(own) == tree.n:  # the robot is a gripper
        return {}
    joints = [tree.joints[j] for j in own]
    return {
        joint.name: round_significant(Travel(*joint.position_range).rest, 6) for joint in joints
    }
