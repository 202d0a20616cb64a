"""A model file -> Tree, whichever of the two formats it is written in."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from testbed.errors import ModelError
from testbed.robot.locks import Lock
from testbed.robot.model_xml import read_xml
from testbed.robot.repair import Bodies, Repair
from testbed.robot.tree import Tree
from testbed.robot.validation import check_tree


def model_format(path: Path) -> Literal["mjcf", "urdf"]:
    """Which language the file speaks, by its root element.

    Raises:
        ModelError: The file is missing, not XML, or neither MJCF nor URDF.
    """
    root = read_xml(path)
    if root.tag == "mujoco":
        return "mjcf"
    if root.tag == "robot":
        return "urdf"
    raise ModelError(
        f"{path}: the root element is <{root.tag:.40}>; MJCF starts with <mujoco>, URDF with "
        "<robot>"
    )


def load_tree(
    path: str | Path,
    *,
    weld_root: bool = False,
    repair: Bodies | None = None,
    lock: Lock | None = None,
) -> Tree:
    """Read a robot from MJCF or URDF.

    Joints are revolute or prismatic; fixed ones are merged. Meshes do not matter, unless
    an MJCF body takes its inertia from one.

    Args:
        path: The model file.
        weld_root: Weld a floating root to the bedplate instead of refusing it.
        repair: Bodies in place of those that no matter can make (links that are fixed to
            each other are one body): what `nearest_bodies` finds, say; {} refuses such a file.
            None takes the nearest bodies that can be and notes them in the tree's `warnings`.
        lock: Positions at which joints are held, by name [rad or m]: their bodies become part
            of those that carry them. None is where the joint rests: at zero, in the middle of
            a range without zero, or where the joint that it follows takes it. Joints that
            follow a held one are held with it.

    Raises:
        ModelError: The file cannot be read or holds what is not supported; a floating root,
            bodies that cannot be and joints that follow others are the subclasses
            FreeRootError, InertiaError, MimicError.
        UnknownName: A joint to be held is not in the file.
    """
    path = Path(path)
    if model_format(path) == "mjcf":
        from testbed.robot.formats.mjcf import read_mjcf as read
    else:
        from testbed.robot.formats.urdf import read_urdf as read
    tree = read(path, weld_root=weld_root, repair=repair, lock=lock)
    check_tree(tree, path)
    return tree


def nearest_bodies(
    path: str | Path,
    *,
    weld_root: bool = False,
    lock: Lock | None = None,
    repair: Bodies | None = None,
) -> Repair:
    """The bodies of a model file that no matter can make, and the nearest that can be.

    A file whose moments are off by rounding alone has none of them: such are repaired whatever
    is asked for.

    Args:
        path: The model file.
        weld_root: As for `load_tree`.
        lock: As for `load_tree`.
        repair: As for `load_tree`.

    Raises:
        ModelError: As for `load_tree`.
    """
    path = Path(path)
    if model_format(path) == "mjcf":
        from testbed.robot.formats.mjcf import repaired_spec

        return repaired_spec(path, weld_root=weld_root, lock=lock, repair=repair).repair
    from testbed.robot.formats.urdf import repaired_xml

    return repaired_xml(path, weld_root=weld_root, lock=lock, repair=repair)[1]


def mimic_joints(path: str | Path) -> tuple[str, ...]:
    """The joints of a model file that follow others, and so are none of a tree.

    `load_tree(path, lock=dict.fromkeys(mimic_joints(path)))` holds them where the zeros of
    the joints that they follow take them.

    Args:
        path: The model file.

    Raises:
        ModelError: The file cannot be read.
    """
    path = Path(path)
    if model_format(path) == "mjcf":
        from testbed.robot.formats.mjcf_spec import follower_names as names
    else:
        from testbed.robot.formats.urdf_xml import follower_names as names
    return names(path)
