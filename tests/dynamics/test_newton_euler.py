"""One recursion for numbers and for whatever else adds and multiplies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.dynamics.algebra import NUMBERS
from testbed.dynamics.kinematics import kinematics
from testbed.dynamics.newton_euler import transmitted
from tests.helpers.robots import random_robot, random_states


@pytest.mark.parametrize("seed", range(5))
def test_the_recursion_serves_other_algebras(seed: int) -> None:
    """On arrays of Python objects, one sample, it gives what it gives on floats."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 5).tree()
    state = random_states(rng, 1, tree.n)
    seen: list[str] = []

    class Objects:
        def sin(self, angle: Any) -> Any:
            return np.array(float(np.sin(float(angle))), dtype=object)

        def cos(self, angle: Any) -> Any:
            return np.array(float(np.cos(float(angle))), dtype=object)

        def keep(self, name: str, value: Any) -> Any:
            seen.append(name)
            return value

    theta = tb.barycentric(tree)[..., None]
    results = []
    for algebra, dtype in ((NUMBERS, float), (Objects(), object)):
        q, qd, qdd = (x[0].astype(dtype) for x in state)
        moving = kinematics(tree, q, qd, qdd, tree.gravity, algebra)
        results.append(transmitted(tree, moving, theta.astype(dtype), algebra))
    for numbers, objects in zip(*results, strict=True):
        np.testing.assert_allclose(objects.astype(float), numbers, rtol=1e-13, atol=1e-13)
    vectors = [f"{name}{j + 1}" for name in ("w", "wd", "W", "a", "F", "L") for j in range(5)]
    vectors += [f"zdd{j + 1}" for j, joint in enumerate(tree.joints) if not joint.revolute]
    assert sorted(seen) == sorted(vectors)
