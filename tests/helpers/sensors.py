"""Robots cut at a force sensor, for tests."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import testbed as tb
from testbed.core.base.transform import Transform
from testbed.core.robot.force_sensor import ForceSensor, tree_beyond_sensor
from testbed.core.robot.repair import ModelLink


def links_of(tree: tb.Tree) -> tuple[ModelLink, ...]:
    """A link a body, as of a file without fixed joints."""
    names = ["pedestal", *(joint.body for joint in tree.joints)]
    bodies = [tree.pedestal, *tree.inertias]
    parents = ["", *(names[parent + 1] for parent in tree.parents)]
    return tuple(
        ModelLink(name, k - 1, parent, name, Transform(), body)
        for k, (name, parent, body) in enumerate(zip(names, parents, bodies, strict=True))
    )


def random_sensors(tree: tb.Tree, rng: np.random.Generator) -> list[ForceSensor]:
    """One to three, before some bodies, anywhere on them, any way round."""
    count = int(rng.integers(1, min(tree.n, 3) + 1))
    return [
        ForceSensor(
            tree.joints[body].body,
            rng.uniform(-0.3, 0.3, 3),
            Rotation.random(rng=rng).as_matrix(),
            f"sensor {body}",
        )
        for body in rng.choice(tree.n, count, replace=False)
    ]


def random_cut(tree: tb.Tree, rng: np.random.Generator) -> tb.Tree:
    """What lies between a force sensor somewhere in the robot and the next, if there are any."""
    own, *others = random_sensors(tree, rng)
    return tree_beyond_sensor(tree, links_of(tree), own, others)
