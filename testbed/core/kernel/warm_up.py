"""Compile the kernel ahead of its first use."""

from __future__ import annotations

import numpy as np

from testbed.core.kernel.compiler import settings
from testbed.core.kernel.layout import layout
from testbed.core.kernel.numba_engine import sweep, workspace
from testbed.core.kernel.records import sensed
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.robot.inertia import NOTHING
from testbed.core.robot.tree import Joint, Tree


def warm_up() -> str:
    """Compile ahead of the first use; returns where the compiled code is kept."""
    axis, eye = np.array([0.0, 0.0, 1.0]), np.eye(3)
    joint = Joint("joint", "body", "revolute", -1, axis, np.zeros(3), eye)
    tree = Tree("one joint", (joint,), (NOTHING,))
    rows_of_it = layout(tree, minimal_set(tree, "dynamic"))
    still = np.zeros((1, 1))
    signals = sensed(still, still, still, 1)
    sweep(rows_of_it, signals, workspace(rows_of_it, signals))
    return str(settings.CACHE_DIR)
