"""The shapes of a model file, whichever of the two formats it is written in."""

from __future__ import annotations

from pathlib import Path

from testbed.robot.load import model_format
from testbed.robot.tree import Tree
from testbed.robot.visuals.shapes import Shape


def load_shapes(path: str | Path, tree: Tree, *, weld_root: bool = False) -> tuple[Shape, ...]:
    """The shapes that the model file gives the robot to be seen; () if it gives none.

    Mesh files that are missing are left out.

    Args:
        path: The model file, MJCF or URDF.
        tree: The tree read from it.
        weld_root: Whether a floating root was welded to the bedplate.

    Raises:
        ModelError: The file cannot be read.
    """
    path = Path(path)
    if model_format(path) == "mjcf":
        from testbed.robot.visuals.mjcf_shapes import read_shapes as read
    else:
        from testbed.robot.visuals.urdf_shapes import read_shapes as read
    return tuple(read(path, tree, weld_root=weld_root))
