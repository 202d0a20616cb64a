"""The shapes of a model file, whichever of the two formats it is written in."""

from __future__ import annotations

from pathlib import Path

from testbed.robot.load import model_format
from testbed.robot.locks import Lock
from testbed.robot.tree import Tree
from testbed.robot.visuals.shapes import DrawnShapes


def load_shapes(
    path: str | Path, tree: Tree, *, weld_root: bool = False, lock: Lock | None = None
) -> DrawnShapes:
    """What the model file gives to be seen of the robot, and what of it cannot be shown.

    Args:
        path: The model file, MJCF or URDF.
        tree: The tree read from it.
        weld_root: Whether a floating root was welded to the bedplate.
        lock: Joints that are held, as when the tree was read.

    Raises:
        ModelError: The file cannot be read.
    """
    path = Path(path)
    if model_format(path) == "mjcf":
        from testbed.robot.visuals.mjcf_shapes import read_shapes as read
    else:
        from testbed.robot.visuals.urdf_shapes import read_shapes as read
    return read(path, tree, weld_root=weld_root, lock=lock)
