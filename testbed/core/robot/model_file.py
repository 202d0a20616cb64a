"""A model file, whichever of the two languages it is written in: its tree, and all it refers to.

The same way of reading for the tree, the plant and the pictures; and one gate: only numbers that
a robot can have.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from testbed.core.base.diagnostics import diagnose
from testbed.core.base.errors import WIDTH, ModelError, few
from testbed.core.base.file_kinds import expecting
from testbed.core.base.installation import own_or_shipped
from testbed.core.robot.asset_files import asset_fault, mjcf_files
from testbed.core.robot.force_sensor import ForceSensor, beyond_sensor
from testbed.core.robot.inertia import HEAVIEST
from testbed.core.robot.locks import Lock, Travel
from testbed.core.robot.parsing import check_name, errors_of, read_xml
from testbed.core.robot.refusals import FreeRootError, LoopError, MimicError
from testbed.core.robot.repair import Bodies, FileLink, Repair
from testbed.core.robot.right_angles import with_right_angles
from testbed.core.robot.tree import ModelSource, Tree

if TYPE_CHECKING:
    from testbed.core.robot.formats.mjcf import MjcfModel
    from testbed.core.robot.formats.urdf import UrdfModel

MOST_JOINTS = 1_000
"""Matrices of a robot grow with the square of its joints."""


@dataclass(frozen=True)
class ModelFile(ModelSource):
    """An MJCF or URDF file, and how to read it."""

    def read(self) -> MjcfModel | UrdfModel:
        """Its links, and what its language makes of them.

        Raises:
            ModelError: The file cannot be read or holds what is not supported.
        """
        if model_format(self.path) == "mjcf":
            from testbed.core.robot.formats import mjcf

            return mjcf.read(self)
        from testbed.core.robot.formats import urdf

        return urdf.read(self)

    def links(self) -> tuple[FileLink, ...]:
        """Its links in the bodies of the tree, carriers before what they carry.

        Raises:
            ModelError: The file cannot be read.
        """
        return self.read().links

    def tree(self) -> Tree:
        """The robot.

        Raises:
            ModelError: The file cannot be read or holds what is not supported.
        """
        return load_tree(
            self.path, weld_root=self.weld_root, repair=self.repair, lock=self.lock
        )


def file_of(tree: Tree) -> ModelFile:
    """The model file of a robot.

    Raises:
        ModelError: It was not read from one.
    """
    if not isinstance(tree.file, ModelFile):
        raise ModelError(
            f"robot '{tree.name}' has no model file: load_tree(path) reads one"
        )
    return tree.file


def model_format(path: Path) -> Literal["mjcf", "urdf"]:
    """Which language the file is in, by its root element.

    Raises:
        ModelError: The file is missing, not XML, or neither MJCF nor URDF.
    """
    with expecting(path, "model file"):
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
    sensor: ForceSensor | None = None,
) -> Tree:
    """Read a robot from MJCF or URDF.

    Joints are revolute or prismatic; fixed ones are merged. Meshes do not matter, unless
    an MJCF body takes its inertia from one.

    Args:
        path: The model file; or the name of one that testbed ships, as "puma562.xml".
        weld_root: Weld a floating root to the bedplate instead of refusing it.
        repair: Bodies in place of those that no matter can make (links that are fixed to
            each other are one body): what `nearest_bodies` finds, say; {} refuses such a file.
            None takes the nearest bodies that can be and names them in the tree's `diagnostics`.
        lock: Positions at which joints are held, by name [rad or m]: their bodies become part
            of those that carry them. None is where the joint rests: at zero, in the middle of
            a range without zero, or where the joint that it follows takes it. Joints that
            follow a held one are held with it.
        sensor: A force sensor in the robot: the tree is then of what lies beyond it, and of the
            joints that lead there.

    Raises:
        ModelError: The file cannot be read or holds what is not supported; a floating root,
            bodies that cannot be and joints that follow others are the subclasses
            FreeRootError, InertiaError, MimicError.
        UnknownName: A joint to be held, or the sensor's link, is not in the file.
    """
    file = ModelFile(own_or_shipped(path), weld_root, repair, lock or {})
    source = file.read()
    tree = replace(with_right_angles(source.tree()), file=file)
    with errors_of(file.path):
        check_tree(tree)
    if strange := {
        f"'{each.name}' ({why})": 0 for each, _, why in _named_files(file.path) if why
    }:
        said = diagnose("model.not-copied", few([*strange], WIDTH, "; "))
        tree = replace(tree, diagnostics=(*tree.diagnostics, said))
    return tree if sensor is None else beyond_sensor(tree, source.links, sensor)


def nearest_bodies(
    path: str | Path, *, weld_root: bool = False, lock: Lock | None = None
) -> Repair:
    """The bodies of a model file that no matter can make, and the nearest that can be.

    A file whose moments are off by rounding alone has none of them: such are repaired whatever
    is asked for.

    Arguments and errors are those of `load_tree`.
    """
    return ModelFile(Path(path), weld_root, lock=lock or {}).read().repair


def mimic_joints(path: str | Path) -> tuple[str, ...]:
    """The joints of a model file that follow others, and so are none of a tree.

    `load_tree(path, lock=dict.fromkeys(mimic_joints(path)))` holds them where the zeros of
    the joints that they follow take them.

    Raises:
        ModelError: The file cannot be read.
    """
    found = _travels(Path(path))
    return tuple(name for name, each in found.items() if each.master)


def expressible(file: ModelFile) -> tuple[ModelFile, Tree, frozenset[str]]:
    """Model file with its root welded and joints held as far as a tree needs it, and the tree.

    Args:
        file: The model file, and how it was asked to be read.

    Returns:
        The file as it can be read, its tree, and the joints that others follow.

    Raises:
        ModelError: The file cannot be read, or holds what is not supported.
    """
    followed: frozenset[str] = frozenset()
    while True:
        try:
            return file, file.tree(), followed
        except FreeRootError:
            if file.weld_root:
                raise
            file = replace(file, weld_root=True)
        except MimicError as error:
            if followed:
                raise
            followed = frozenset(error.masters.values())
            file = replace(
                file, lock={**dict.fromkeys(mimic_joints(file.path)), **file.lock}
            )
        except LoopError as error:
            file = replace(file, lock={**file.lock, **error.joints})


def joint_names(path: str | Path) -> tuple[str, ...]:
    """Names of all joints of a model file that move, those that follow others too.

    Raises:
        ModelError: The file cannot be read.
    """
    return tuple(_travels(Path(path)))


def _travels(path: Path) -> Mapping[str, Travel]:
    if model_format(path) == "mjcf":
        from testbed.core.robot.formats.mjcf_spec import travels
    else:
        from testbed.core.robot.formats.urdf_xml import travels
    return travels(path)


def check_tree(tree: Tree) -> None:
    """Whether every number of a tree makes sense.

    Raises:
        ModelError: Names the joint or body and the number.
    """
    if tree.n == 0:
        raise ModelError("the robot has no joint that moves")
    if tree.n > MOST_JOINTS:
        raise ModelError(f"{tree.n} joints that move; {MOST_JOINTS} is the limit")
    check_name(tree.name, "the robot's name")
    for joint in tree.joints:
        check_name(joint.name, "a joint's name")
        check_name(joint.body, "a body's name")
    tree.gravity_or(tree.gravity)
    if len(set(tree.names)) < tree.n:
        raise ModelError("two joints have the same name")
    for joint in tree.joints:
        if flaw := joint.flaw():
            raise ModelError(f"joint '{joint.name}' has {flaw}")
    owners = [*(f"body '{joint.body}'" for joint in tree.joints), "the pedestal"]
    for owner, inertia in zip(owners, (*tree.inertias, tree.pedestal), strict=True):
        if not inertia.within_limits:
            raise ModelError(
                f"{owner} has a mass, centre or inertia that is no number, or beyond {HEAVIEST:g}"
            )


def copy_model(path: Path, folder: Path) -> Path:
    """Copy a model file with all that it refers to.

    The files keep their places relative to each other, so that the copy finds them; what is
    missing is left out, as it is when the model is read, and what `asset_fault` finds strange.

    Args:
        path: The model file.
        folder: Where to; made if it is not there.

    Returns:
        The copy of the model file.

    Raises:
        ModelError: The model file cannot be read.
    """
    path = path.resolve()
    held = references(path)
    root = Path(
        os.path.commonpath([path.parent, *held.values(), *(f.parent for f in held)])
    )
    for file in (path, *held):
        place = folder / file.relative_to(root)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, place)
    return folder / path.relative_to(root)


def references(path: Path) -> dict[Path, Path]:
    """Files that a model refers to, and the folder from which their names lead there.

    Raises:
        ModelError: The model file cannot be read.
    """
    return {file: at for file, at, fault in _named_files(path) if fault is None}


def _named_files(path: Path) -> Iterator[tuple[Path, Path, str | None]]:
    """Files that a model refers to, the folders of their names, and why copies lack them."""
    home = path.resolve()
    for file, at in (
        mjcf_files(path) if model_format(path) == "mjcf" else _of_urdf(path)
    ):
        yield file, at, asset_fault(file, home)


def _of_urdf(path: Path) -> Iterator[tuple[Path, Path]]:
    for mesh in read_xml(path).iterfind("link/visual/geometry/mesh"):
        found = find_mesh(mesh.get("filename", ""), path)
        if found is not None:
            place, file = found
            yield Path(os.path.normpath(file)), place


def find_mesh(name: str, model: Path) -> tuple[Path, Path] | None:
    """A mesh's file, and the folder from which its name leads there; None if there is none.

    package://PACKAGE/... is looked for below all folders above the model, with and without
    the package's name.

    Args:
        name: As in the model file.
        model: The model file.
    """
    places = [model.resolve().parent, *model.resolve().parent.parents]
    bare = Path(name.removeprefix("file://"))
    tried = [(places[0], bare)]
    if name.startswith("package://"):
        rest = Path(name.removeprefix("package://"))
        inside = Path(*rest.parts[1:]) if len(rest.parts) > 1 else rest
        tried = [(place, part) for place in places for part in (rest, inside)]
    for place, part in tried:
        if (place / part).is_file():
            return place, place / part
    return None
