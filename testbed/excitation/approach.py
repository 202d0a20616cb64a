"""How fast two bodies can approach each other at most."""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.excitation.collision_model import CollisionModel
from testbed.excitation.limits import Limits


def levers(collision: CollisionModel, limits: Limits) -> Array:
    """Bounds of how distances of pairs change with the joints' positions, (k, n) [m/rad or 1].

    Seen from the last body that carries both, a point of either moves by no more than each joint's
    own movement times how far from that joint it can be.

    Args:
        collision: Shapes, and the pairs.
        limits: Of the joints' positions.
    """
    tree, size = collision.tree, _sizes(collision)
    travel = np.maximum(np.abs(limits.low), np.abs(limits.high))
    found = np.zeros((len(collision.pairs), tree.n))
    for k, (a, b) in enumerate(collision.pairs):
        both = set(tree.chain(a)) & set(tree.chain(b))
        for body in (a, b):
            away = size.get(body, 0.0)
            for j in reversed(tree.chain(body)):
                if j in both:
                    break
                joint = tree.joints[j]
                found[k, j] = away if joint.revolute else 1.0
                away += float(np.linalg.norm(joint.offset))
                away += 0.0 if joint.revolute else float(travel[j])
    return found


def _sizes(collision: CollisionModel) -> dict[int, float]:
    """How far from a moving body's origin its shapes reach [m]."""
    model = collision.model
    found: dict[int, float] = {}
    for (a, b), geoms in zip(collision.pairs, collision.geoms, strict=True):
        for body, own in zip((a, b), geoms, strict=True):
            reach = np.linalg.norm(model.geom_pos[own], axis=1) + model.geom_rbound[own]
            if body >= 0:
                found[body] = max(found.get(body, 0.0), float(reach.max()))
    return found
