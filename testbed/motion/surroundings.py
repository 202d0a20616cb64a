"""Pairs of bodies that a motion keeps apart: of the robot, pedestal, floor and obstacles."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from testbed.bodies.shapes.appearance import load_shapes
from testbed.bodies.shapes.shapes import Shape, bounds
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import ExperimentError, few
from testbed.core.robot.model_file import file_of
from testbed.core.robot.tree import Tree
from testbed.motion.clearance import FAR, DistanceMeter
from testbed.motion.collision_model import (
    CELL,
    CollisionModel,
    collision_model,
)
from testbed.motion.limits import Limits
from testbed.motion.proof import Rules
from testbed.motion.terms import EffortTerm, ForceTerm

ALWAYS = 0.9
"""A pair that touches in this share of random postures always does: its shapes say nothing."""

NARROW = 1.5
"""Pairs that have so much of the clearance, or less, keep half of what they have."""

HANGS = 0.1
"""Part of a robot's reach by which its joints may lie below its floor."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Pairs of bodies that are watched.

    Attributes:
        collision: The shapes and pairs; None where nothing is watched.
        clearance: Distance that each pair keeps, (k,) [m].
        diagnostics: Pairs that are not watched, or keep less.
    """

    collision: CollisionModel | None = None
    clearance: Array = field(default_factory=lambda: np.zeros(0))
    diagnostics: tuple[Diagnostic, ...] = ()


def rules_within(
    tree: Tree,
    limits: Limits,
    margin: float,
    terms: Iterable[ForceTerm],
    around: Surroundings | Rules,
) -> Rules:
    """Rules of a motion, with the efforts of motors that are limited.

    Args:
        tree: The robot.
        limits: Of its joints.
        margin: Share of them that may be used.
        terms: Limits of plate and force sensors.
        around: Pairs of bodies to keep apart.
    """
    if np.isfinite(limits.effort).any():
        terms = (*terms, EffortTerm(tree, limits, margin))
    watched = around.collision, around.clearance, around.diagnostics
    return Rules(tree, limits, margin, tuple(terms), *watched)


def surroundings(
    tree: Tree,
    limits: Limits,
    clearance: float,
    obstacles: Sequence[Shape] = (),
    exclude: Iterable[tuple[str, str]] = (),
    floor: float | str | None = None,
) -> Surroundings:
    """Find the pairs of bodies that a motion can be asked to keep apart.

    Args:
        tree: The robot, its model file for shapes.
        limits: Of the joints' positions.
        clearance: Distance to be kept [m].
        obstacles: Shapes around the robot, in the bedplate's frame.
        exclude: Pairs that do not count, by name.
        floor: Height of the floor [m]; "off" for none; None for the lowest point of the pedestal.

    Raises:
        ExperimentError: There are obstacles, and the model file has no shapes.
        UnknownName: There is no body of a name in `exclude`.
    """
    model = file_of(tree)
    found = load_shapes(model, tree)
    said = found.diagnostics
    if not any(shape.body >= 0 for shape in found.shapes):
        if obstacles:
            raise ExperimentError(
                f"{model.path} has no shapes: the distance to excitation.obstacle is unknown; "
                "give the file collision or visual geometry"
            )
        return Surroundings(diagnostics=(*said, diagnose("motion.no-shapes")))
    if floor is None:
        floor = _floor(tree, found.shapes)
        said += () if floor is not None else (diagnose("motion.no-floor"),)
    height = None if isinstance(floor, str) else floor
    every = collision_model(tree, found.shapes, obstacles, height).without(exclude)
    kept = watched(every, limits, clearance)
    return Surroundings(kept.collision, kept.clearance, (*said, *kept.diagnostics))


def _floor(tree: Tree, shapes: tuple[Shape, ...]) -> float | None:
    """The lowest point of what stands on the plate, or the plate's plane [m].

    None for a robot that hangs below it in the posture of zeros: that plane is no floor.
    """
    standing = (float(bounds(shape)[0][2]) for shape in shapes if shape.body < 0)
    floor = min(standing, default=0.0)
    origins = np.array([X_WB.p_AB_A for X_WB in tree.zero_poses])
    reach = float(np.linalg.norm(origins, axis=1).max())
    return None if origins[:, 2].min() < floor - HANGS * reach else floor


def watched(
    collision: CollisionModel, limits: Limits, clearance: float
) -> Surroundings:
    """Choose pairs whose shapes say something, and the distance that each can keep.

    Pairs that touch in nearly every posture are left out: their shapes are too coarse. Pairs that
    are about as near to each other as the clearance in the posture of zeros, or in nearly all,
    keep half of what they have there. Obstacles are watched in any case.

    Args:
        collision: All pairs.
        limits: Of the joints' positions.
        clearance: Distance to be kept [m].
    """
    home, *found = (
        DistanceMeter(collision, clearance + FAR).measure(limits.postures).values
    )
    around = np.array([a == CELL for a, _ in collision.pairs], dtype=bool)
    free = around | (np.mean(np.array(found) <= 0, axis=0) < ALWAYS)
    always = np.mean(np.array(found) < NARROW * clearance, axis=0) >= ALWAYS
    built = np.where(always, np.median(found, axis=0), np.inf)
    usual = np.minimum(built, np.where(home > 0, home, np.inf))
    kept = np.where(~around & (usual < NARROW * clearance), usual / 2, clearance)
    names = np.array(collision.names)
    said = [diagnose("motion.touching", name) for name in names[~free].tolist()]
    nearer = names[free & (kept < clearance)].tolist()
    if nearer:
        said.append(diagnose("motion.near", few(nearer)))
    watch = collision.only(free.tolist())
    return Surroundings(watch if watch.pairs else None, kept[free], tuple(said))
