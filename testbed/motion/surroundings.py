"""Selection of watched pairs among the bodies of robot, pedestal, floor and obstacles."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from testbed.bodies.shapes.appearance import load_shapes
from testbed.bodies.shapes.shapes import Shape, shape_bounds
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import ExperimentError, shortened_list
from testbed.core.robot.model_file import model_file_of
from testbed.core.robot.tree import Tree
from testbed.motion.clearance import MAX_DISTANCE, DistanceMeter
from testbed.motion.collision_model import (
    OBSTACLE_BODY,
    CollisionModel,
    collision_model,
)
from testbed.motion.limits import Limits
from testbed.motion.proof import MotionConstraints
from testbed.motion.terms import EffortTerm, ForceTerm

MIN_CONTACT_SHARE = 0.9
"""Fraction of random postures in contact from which a pair of bodies is not watched."""

MAX_NEAR_RATIO = 1.5
"""Ratio of usual distance to clearance below which the clearance is half the usual distance."""

MAX_DEPTH_RATIO = 0.1
"""Largest depth of joints below the floor, relative to the robot's reach."""


@dataclass(frozen=True, eq=False)
class WatchedPairs:
    """Watched pairs of bodies, whose distances are limited, and required distances.

    Attributes:
        collision: Shapes and watched pairs; None if no pair is watched.
        clearance: Required distances of the k watched pairs, (k,) [m].
        diagnostics: Diagnostics of pairs that are not watched or have a reduced clearance.
    """

    collision: CollisionModel | None = None
    clearance: Array = field(default_factory=lambda: np.zeros(0))
    diagnostics: tuple[Diagnostic, ...] = ()


def motion_constraints(
    tree: Tree,
    limits: Limits,
    margin: float,
    terms: Iterable[ForceTerm],
    watched_pairs: WatchedPairs | MotionConstraints,
) -> MotionConstraints:
    """Combine limits of joints, motors, plate, sensors and clearances into constraints of a motion.

    Args:
        tree: The robot.
        limits: Limits of the joints.
        margin: Usable fraction of the limits.
        terms: Limits of plate and force sensors; limits of motor efforts are added if some are
            finite.
        watched_pairs: Watched pairs of bodies, with clearances and diagnostics.
    """
    if np.isfinite(limits.effort).any():
        terms = (*terms, EffortTerm(tree, limits, margin))
    watched = (
        watched_pairs.collision,
        watched_pairs.clearance,
        watched_pairs.diagnostics,
    )
    return MotionConstraints(tree, limits, margin, tuple(terms), *watched)


def find_watched_pairs(
    tree: Tree,
    limits: Limits,
    clearance: float,
    obstacles: Sequence[Shape] = (),
    exclude: Iterable[tuple[str, str]] = (),
    floor: float | str | None = None,
) -> WatchedPairs:
    """Find the pairs of bodies that a motion can keep apart, and their required distances.

    Pairs are selected by `select_watched_pairs`. A model file without shapes yields no pairs and a
    diagnostic.

    Args:
        tree: The robot; its model file contains the shapes.
        limits: Limits of the joint positions.
        clearance: Required distance [m].
        obstacles: Shapes around the robot, in the bedplate's frame.
        exclude: Names of the bodies of excluded pairs.
        floor: Height of the floor in the bedplate's frame [m]. Any text, such as "off", means no
            floor. None means the lowest point of the pedestal; if the robot hangs below that point,
            there is no floor, with a diagnostic.

    Raises:
        ExperimentError: Obstacles are given, but the model file has no shapes.
        UnknownName: A body in `exclude` does not exist.
    """
    model = model_file_of(tree)
    appearance = load_shapes(model, tree)
    diagnostics = appearance.diagnostics
    if not any(shape.body >= 0 for shape in appearance.shapes):
        if obstacles:
            raise ExperimentError(
                f"{model.path} has no shapes: the distance to excitation.obstacle is unknown; "
                "give the file collision or visual geometry"
            )
        return WatchedPairs(
            diagnostics=(*diagnostics, make_diagnostic("motion.no-shapes"))
        )
    if floor is None:
        floor = _floor_height(tree, appearance.shapes)
        diagnostics += (
            () if floor is not None else (make_diagnostic("motion.no-floor"),)
        )
    height = None if isinstance(floor, str) else floor
    all_pairs = collision_model(
        tree, appearance.shapes, obstacles, height
    ).without_pairs(exclude)
    watched_pairs = select_watched_pairs(all_pairs, limits, clearance)
    return WatchedPairs(
        watched_pairs.collision,
        watched_pairs.clearance,
        (*diagnostics, *watched_pairs.diagnostics),
    )


def _floor_height(tree: Tree, shapes: tuple[Shape, ...]) -> float | None:
    """Height of the pedestal's lowest point, or of the plate's plane [m].

    The height is None if the robot hangs: in the zero posture, the origin of a body is lower by
    more than MAX_DEPTH_RATIO times the robot's reach.
    """
    lowest_points = (
        float(shape_bounds(shape)[0][2]) for shape in shapes if shape.body < 0
    )
    floor = min(lowest_points, default=0.0)
    origins = np.array([pose.p_AB_A for pose in tree.zero_poses])
    reach = float(np.linalg.norm(origins, axis=1).max())
    return None if origins[:, 2].min() < floor - MAX_DEPTH_RATIO * reach else floor


def select_watched_pairs(
    collision: CollisionModel, limits: Limits, clearance: float
) -> WatchedPairs:
    """Select pairs with informative shapes, and the distance that each pair can keep.

    Pairs in contact in at least a fraction MIN_CONTACT_SHARE of the random postures are dropped, as
    their shapes are too coarse. A distance below MAX_NEAR_RATIO times the clearance is small. The
    usual distance of a pair is its distance in the home posture; or its median distance, if this is
    smaller and the distance is small in a fraction MIN_CONTACT_SHARE of the random postures. If the
    usual distance is small, the clearance is reduced to half of it. Obstacles are always watched
    with the full clearance. Diagnostics list dropped pairs and reduced clearances.

    Args:
        collision: All pairs.
        limits: Limits of the joint positions.
        clearance: Required distance [m].
    """
    home_distances, *random_distances = (
        DistanceMeter(collision, clearance + MAX_DISTANCE)
        .measure(limits.postures)
        .values
    )
    is_obstacle = np.array([a == OBSTACLE_BODY for a, _ in collision.pairs], dtype=bool)
    is_watched = is_obstacle | (
        np.mean(np.array(random_distances) <= 0, axis=0) < MIN_CONTACT_SHARE
    )
    is_always_near = (
        np.mean(np.array(random_distances) < MAX_NEAR_RATIO * clearance, axis=0)
        >= MIN_CONTACT_SHARE
    )
    median_distances = np.where(
        is_always_near, np.median(random_distances, axis=0), np.inf
    )
    usual_distances = np.minimum(
        median_distances, np.where(home_distances > 0, home_distances, np.inf)
    )
    clearances = np.where(
        ~is_obstacle & (usual_distances < MAX_NEAR_RATIO * clearance),
        usual_distances / 2,
        clearance,
    )
    names = np.array(collision.names)
    diagnostics = [
        make_diagnostic("motion.touching", name) for name in names[~is_watched].tolist()
    ]
    reduced = names[is_watched & (clearances < clearance)].tolist()
    if reduced:
        diagnostics.append(make_diagnostic("motion.near", shortened_list(reduced)))
    watched_collision = collision.with_selected_pairs(is_watched.tolist())
    return WatchedPairs(
        watched_collision if watched_collision.pairs else None,
        clearances[is_watched],
        tuple(diagnostics),
    )
