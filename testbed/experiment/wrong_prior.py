"""A model file that is wrong: bodies that an experiment starts from instead of the true ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.robot.inertia import Inertia, upper_root
from testbed.robot.tree import Tree


def wrong_bodies(tree: Tree, error: float, rng: np.random.Generator) -> Tree:
    """The robot with other possible bodies.

    J = U U' becomes U G G' U', G a matrix that differs from one by random numbers: mass, centre
    and inertia change together, each by about the same part of itself. Bodies whose J has no
    such root (rods, plates, none) stay.

    Args:
        tree: The robot with its true bodies.
        error: Standard deviation of every coordinate of J, in parts of the body.
        rng: Draws the numbers.
    """
    return replace(tree, inertias=tuple(_wrong(body, error, rng) for body in tree.inertias))


def _wrong(body: Inertia, error: float, rng: np.random.Generator) -> Inertia:
    change = np.eye(4) + error / 2 * rng.normal(size=(4, 4))
    try:
        root = upper_root(body.pseudo) @ change
    except np.linalg.LinAlgError:
        return body
    return Inertia.of_pseudo(root @ root.T)
