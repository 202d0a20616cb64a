"""Compilation of the kernel before its first use."""

from __future__ import annotations

import numpy as np

from testbed.core.kernel.compiler import settings
from testbed.core.kernel.layout import make_layout
from testbed.core.kernel.numba_engine import row_products, workspace
from testbed.core.kernel.records import signals_of_motion
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.robot.inertia import ZERO_INERTIA
from testbed.core.robot.tree import Joint, Tree


def warm_up() -> str:
    """Compile the kernel on a robot of one joint; return the cache folder."""
    axis, eye = np.array([0.0, 0.0, 1.0]), np.eye(3)
    joint = Joint("joint", "body", "revolute", -1, axis, np.zeros(3), eye)
    tree = Tree("one joint", (joint,), (ZERO_INERTIA,))
    row_layout = make_layout(tree, minimal_set(tree, "torque"))
    zeros = np.zeros((1, 1))
    signals = signals_of_motion(zeros, zeros, zeros, 1)
    row_products(row_layout, signals, workspace(row_layout, signals))
    return str(settings.CACHE_DIR)
