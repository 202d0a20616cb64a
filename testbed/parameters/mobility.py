"""How the body that carries a joint can move: the question every rule asks first.

Mobility is judged over all joints ahead, at q = 0: whether the axes ahead of a joint are
all parallel, coaxial or concurrent does not depend on the posture when it is asked of the
whole chain (asked of the adjacent joint only, it does).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from testbed.arrays import Array
from testbed.tree.tree import Tree

ALIGNED = 1e-9
"""Sine below which two directions count as parallel; also [m] for points on a line."""


@dataclass(frozen=True, eq=False)
class Mobility:
    """What joint j's carrying body i can do, seen from the joint.

    Attributes:
        rotation: "none": body i never turns; "along": it turns only about directions
            parallel to the joint axis; "across": only about one direction, not parallel
            to the axis; "free": about more than one direction.
        direction: The one direction w, frame i, (3,); None unless "along" or "across".
        at_rest: xdd^j stays parallel to the joint axis in every motion, and so does gravity.
        pivot: Without gravity, the distance s along the axis from O^j to a point that
            never moves; None if there is no such point [m].
    """

    rotation: Literal["none", "along", "across", "free"]
    direction: Array | None
    at_rest: bool
    pivot: float | None


def parallel(a: Array, b: Array) -> bool:
    """Whether two vectors are parallel or one of them is zero."""
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    return scale == 0 or float(np.linalg.norm(np.cross(a, b))) <= ALIGNED * scale


def mobilities(tree: Tree, gravity: Array) -> tuple[Mobility, ...]:
    """The mobility ahead of every joint.

    Args:
        tree: The robot.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2].
    """
    chains, turns, axes, origins = _posture(tree)
    return tuple(
        _mobility(tree, j, gravity, chains[j], turns, axes, origins) for j in range(tree.n)
    )


def _mobility(
    tree: Tree,
    j: int,
    gravity: Array,
    ahead: tuple[int, ...],
    turns: Array,
    axes: Array,
    origins: Array,
) -> Mobility:
    axis, parent = axes[j], tree.parents[j]
    spins = [k for k in ahead if tree.joints[k].revolute]
    slides = [k for k in ahead if not tree.joints[k].revolute]
    straight = all(parallel(axes[k], axes[spins[0]]) for k in spins)
    rotation: Literal["none", "along", "across", "free"]
    if not spins:
        rotation = "none"
    elif not straight:
        rotation = "free"
    else:
        rotation = "along" if parallel(axes[spins[0]], axis) else "across"
    direction = turns[parent].T @ axes[spins[0]] if rotation in ("along", "across") else None
    coaxial = all(parallel(axes[k], axis) for k in ahead) and all(
        np.linalg.norm(np.cross(origins[k] - origins[j], axis)) <= ALIGNED for k in spins
    )
    pivot = None if gravity.any() or slides else _pivot(j, spins, axes, origins)
    return Mobility(rotation, direction, coaxial and parallel(gravity, axis), pivot)


def _posture(tree: Tree) -> tuple[list[tuple[int, ...]], Array, Array, Array]:
    """Chains ahead of every joint; rotations, axes and origins in the bedplate frame at q = 0."""
    chains: list[tuple[int, ...]] = []
    turns, origins = np.empty((tree.n, 3, 3)), np.empty((tree.n, 3))
    axes = np.empty((tree.n, 3))
    for j, joint in enumerate(tree.joints):
        i = joint.parent
        chains.append((*chains[i], i) if i >= 0 else ())
        turn, origin = (turns[i], origins[i]) if i >= 0 else (np.eye(3), np.zeros(3))
        turns[j], origins[j] = turn @ joint.rotation, origin + turn @ joint.offset
        axes[j] = turns[j] @ joint.axis
    return chains, turns, axes, origins


def _pivot(j: int, spins: list[int], axes: Array, origins: Array) -> float | None:
    """Where axis j meets every axis ahead in one point: its distance from O^j; None if nowhere."""
    s: float | None = None
    for k in spins:
        normal = np.cross(axes[k], axes[j])
        if np.linalg.norm(normal) <= ALIGNED:  # parallel: coaxial, or they never meet
            if np.linalg.norm(np.cross(origins[k] - origins[j], axes[j])) > ALIGNED:
                return None
            continue
        gap = origins[k] - origins[j]
        here = float(np.cross(gap, axes[k]) @ np.cross(axes[j], axes[k]) / (normal @ normal))
        if np.linalg.norm(np.cross(gap - here * axes[j], axes[k])) > ALIGNED:
            return None
        if s is not None and abs(here - s) > ALIGNED:
            return None
        s = here
    return s
