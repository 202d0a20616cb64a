"""A model file -> Tree, whichever of the two formats it is written in."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Literal

from testbed.errors import ModelError
from testbed.robot.tree import Tree
from testbed.robot.validation import check_tree


def model_format(path: Path) -> Literal["mjcf", "urdf"]:
    """Which language the file speaks, by its root element.

    Raises:
        ModelError: The file is missing, not XML, or neither MJCF nor URDF.
    """
    if not path.is_file():
        raise ModelError(f"there is no model file '{path}'")
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, LookupError, ValueError) as error:  # the latter: odd encodings
        raise ModelError(f"{path}: not well-formed XML ({error})") from None
    if root.tag == "mujoco":
        return "mjcf"
    if root.tag == "robot":
        return "urdf"
    raise ModelError(
        f"{path}: the root element is <{root.tag}>; MJCF starts with <mujoco>, URDF with <robot>"
    )


def load_tree(path: str | Path, *, weld_root: bool = False, accept_inertia: bool = False) -> Tree:
    """Read a robot from MJCF or URDF.

    Joints are revolute or prismatic; fixed ones are merged. Meshes do not matter, unless
    an MJCF body takes its inertia from one.

    Args:
        path: The model file.
        weld_root: Weld a floating root to the bedplate instead of refusing it.
        accept_inertia: Take inertias that no rigid body can have as they are, and note
            them in the tree's `warnings`, instead of refusing them.

    Raises:
        ModelError: The file cannot be read or holds what is not supported; a floating
            root and impossible inertias are the subclasses FreeRootError, InertiaError.
    """
    path = Path(path)
    if model_format(path) == "mjcf":
        from testbed.robot.formats.mjcf import read_mjcf as read
    else:
        from testbed.robot.formats.urdf import read_urdf as read
    tree = read(path, weld_root=weld_root, accept_inertia=accept_inertia)
    check_tree(tree, path)
    return tree
