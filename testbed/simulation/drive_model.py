"""What a drive believes of its robot when nobody has weighed it.

The drive's own model decides how well the reference is followed: it changes the motion, not
what is measured of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.robot.inertia import Inertia
from testbed.robot.tree import Joint, Tree


def believed(tree: Tree, error: float, rng: np.random.Generator) -> Tree:
    """A robot whose bodies and joints are all wrong by one relative size.

    Each body keeps its shape and mass centre and is too heavy or too light; each coefficient
    of friction and each rotor is too large or too small.

    Args:
        tree: The robot.
        error: Relative size of every error, less than 1.
        rng: Decides the signs.
    """

    def off() -> float:
        return float(1 + error * rng.choice([-1.0, 1.0]))

    def heavier(body: Inertia, factor: float) -> Inertia:
        return Inertia(factor * body.mass, factor * body.first_moment, factor * body.tensor)

    def rubbing(joint: Joint) -> Joint:
        return replace(
            joint,
            coulomb=off() * joint.coulomb,
            viscous=off() * joint.viscous,
            rotor_inertia=off() * joint.rotor_inertia,
        )

    return replace(
        tree,
        inertias=tuple(heavier(body, off()) for body in tree.inertias),
        joints=tuple(rubbing(joint) for joint in tree.joints),
    )
