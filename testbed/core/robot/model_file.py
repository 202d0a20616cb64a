"""Model files in MJCF or URDF: reading as a tree, referenced files, copies.

The tree, the simulated plant and pictures are built from model files that are read in the same way
and with the same checks.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from testbed.core.base.diagnostics import make_diagnostic
from testbed.core.base.errors import MAX_LIST_WIDTH, ModelError, shortened_list
from testbed.core.base.file_kinds import explain_wrong_kind
from testbed.core.base.installation import user_or_shipped_file
from testbed.core.robot.asset_files import copy_obstacle, mjcf_references
from testbed.core.robot.force_sensor import ForceSensor, tree_beyond_sensor
from testbed.core.robot.inertia import MAX_INERTIAL_PARAMETER
from testbed.core.robot.locks import JointLocks, JointTravel
from testbed.core.robot.parsing import check_name, prefix_model_errors, read_xml
from testbed.core.robot.refusals import FreeRootError, LoopError, MimicError
from testbed.core.robot.repair import InertiasByLink, ModelLink, Repair
from testbed.core.robot.right_angles import with_right_angles
from testbed.core.robot.tree import ModelSource, Tree

if TYPE_CHECKING:
    from testbed.core.robot.formats.mjcf import MjcfModel
    from testbed.core.robot.formats.urdf import UrdfModel

MAX_JOINTS = 1_000
"""Largest number of joints, as the size of a robot's matrices grows with its square."""


@dataclass(frozen=True)
class ModelFile(ModelSource):
    """MJCF or URDF file of a robot, with options for reading."""

    def read(self) -> MjcfModel | UrdfModel:
        """Read the file with the reader for its format.

        Raises:
            ModelError: The file cannot be read or holds unsupported elements.
        """
        if model_format(self.path) == "mjcf":
            from testbed.core.robot.formats import mjcf

            return mjcf.read(self)
        from testbed.core.robot.formats import urdf

        return urdf.read(self)

    def links(self) -> tuple[ModelLink, ...]:
        """Read the links of the file, each after the link that carries it.

        Raises:
            ModelError: The file cannot be read.
        """
        return self.read().links

    def tree(self) -> Tree:
        """Read the file as a kinematic tree.

        Raises:
            ModelError: The file cannot be read or holds unsupported elements.
        """
        return load_tree(
            self.path, weld_root=self.weld_root, repair=self.repair, lock=self.lock
        )


def model_file_of(tree: Tree) -> ModelFile:
    """Model file from which a tree was read.

    Raises:
        ModelError: The tree was not read from a file.
    """
    if not isinstance(tree.file, ModelFile):
        raise ModelError(
            f"robot '{tree.name}' has no model file: load_tree(path) reads one"
        )
    return tree.file


def model_format(path: Path) -> Literal["mjcf", "urdf"]:
    """Format of a model file from its root element: "mjcf" for <mujoco>, "urdf" for <robot>.

    Raises:
        ModelError: The file is missing, not XML, or neither MJCF nor URDF.
    """
    with explain_wrong_kind(path, "model file"):
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
    repair: InertiasByLink | None = None,
    lock: JointLocks | None = None,
    sensor: ForceSensor | None = None,
) -> Tree:
    """Read a robot from an MJCF or URDF file.

    Joints are revolute or prismatic; fixed joints are merged. Meshes have no effect, unless an MJCF
    body takes its inertia from a mesh. Rounded right angles are made exact (`with_right_angles`);
    the tree's `diagnostics` list all accepted faults.

    Args:
        path: Model file; or name of a file shipped with testbed, such as "puma562.xml".
        weld_root: True to weld a floating root to the bedplate instead of raising an error.
        repair: Replacements for physically inconsistent inertias of bodies (links fixed to each
            other form one body), such as `nearest_consistent_bodies(path).bodies`; {} raises an
            error for inconsistent inertias. None selects the nearest consistent inertias, and lists
            the bodies in the tree's `diagnostics`.
        lock: Positions of locked joints, keyed by name [rad or m]; the bodies of locked joints
            become part of the carrying bodies. None stands for the rest position: zero, the middle
            of a range without zero, or the position that the master joint implies. A mimic joint is
            locked together with its master.
        sensor: Force sensor in the robot; the tree then consists of the links beyond the sensor and
            of the joints that lead to the sensor.

    Raises:
        ModelError: The file cannot be read or contains unsupported elements. The subclasses
            FreeRootError, InertiaError and MimicError stand for a floating root, inconsistent
            inertias and mimic joints that are not locked.
        UnknownName: A joint to be locked, or the sensor's link, is not in the file.
    """
    file = ModelFile(user_or_shipped_file(path), weld_root, repair, lock or {})
    source = file.read()
    tree = replace(with_right_angles(source.tree()), file=file)
    with prefix_model_errors(file.path):
        check_tree(tree)
    if excluded := {
        f"'{each.name}' ({why})": 0
        for each, _, why in _referenced_files(file.path)
        if why
    }:
        diagnostic = make_diagnostic(
            "model.not-copied", shortened_list([*excluded], MAX_LIST_WIDTH, "; ")
        )
        tree = replace(tree, diagnostics=(*tree.diagnostics, diagnostic))
    return tree if sensor is None else tree_beyond_sensor(tree, source.links, sensor)


def nearest_consistent_bodies(
    path: str | Path, *, weld_root: bool = False, lock: JointLocks | None = None
) -> Repair:
    """Physically inconsistent bodies of a model file, with the nearest consistent inertias.

    `Repair.bodies` omits bodies with rounding errors only, which are always repaired.

    Arguments and errors are those of `load_tree`.
    """
    return ModelFile(Path(path), weld_root, lock=lock or {}).read().repair


def mimic_joints(path: str | Path) -> tuple[str, ...]:
    """Names of the mimic joints with a master joint in a model file.

    `load_tree(path, lock=dict.fromkeys(mimic_joints(path)))` locks them at the positions that
    the rest positions of their master joints imply.

    Raises:
        ModelError: The file cannot be read.
    """
    travels = _travels(Path(path))
    return tuple(name for name, travel in travels.items() if travel.master)


def readable_model(file: ModelFile) -> tuple[ModelFile, Tree, frozenset[str]]:
    """Read a model file, with root welded and joints locked where a tree requires it.

    A floating root is welded, all mimic joints are locked at the positions that their masters
    imply, and the joints of a kinematic loop at their rest positions. Locks given in `file` take
    precedence.

    Args:
        file: Model file with options for reading.

    Returns:
        Model file with changed options, the tree, and the names of the master joints of mimic
        joints (empty if no mimic joint had to be locked).

    Raises:
        ModelError: The file cannot be read, or holds unsupported elements.
    """
    masters: frozenset[str] = frozenset()
    while True:
        try:
            return file, file.tree(), masters
        except FreeRootError:
            if file.weld_root:
                raise
            file = replace(file, weld_root=True)
        except MimicError as error:
            if masters:
                raise
            masters = frozenset(error.masters.values())
            file = replace(
                file, lock={**dict.fromkeys(mimic_joints(file.path)), **file.lock}
            )
        except LoopError as error:
            file = replace(file, lock={**file.lock, **error.joints})


def joint_names(path: str | Path) -> tuple[str, ...]:
    """Names of all moving joints of a model file, mimic joints included.

    Raises:
        ModelError: The file cannot be read.
    """
    return tuple(_travels(Path(path)))


def _travels(path: Path) -> Mapping[str, JointTravel]:
    """Range and coupling of every moving joint, keyed by name; no ranges for MJCF."""
    if model_format(path) == "mjcf":
        from testbed.core.robot.formats.mjcf_spec import mjcf_joint_travels

        return mjcf_joint_travels(path)
    from testbed.core.robot.formats.urdf_xml import urdf_joint_travels

    return urdf_joint_travels(path)


def check_tree(tree: Tree) -> None:
    """Check that names, placements, limits, gravity and inertias of a tree are valid.

    The tree must have 1 to MAX_JOINTS joints with unique names.

    Raises:
        ModelError: A name or number is invalid; the message names the joint or body.
    """
    if tree.n == 0:
        raise ModelError("the robot has no joint that moves")
    if tree.n > MAX_JOINTS:
        raise ModelError(f"{tree.n} joints that move; {MAX_JOINTS} is the limit")
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
                f"{owner} has a mass, centre or inertia that is no number, or beyond "
                f"{MAX_INERTIAL_PARAMETER:g}"
            )


def copy_model(path: Path, folder: Path) -> Path:
    """Copy a model file together with the files to which it refers.

    Relative positions of the files are kept, so that references stay valid. Missing files and files
    with a `copy_obstacle` are left out.

    Args:
        path: Model file.
        folder: Target folder; created if missing.

    Returns:
        Path of the copied model file.

    Raises:
        ModelError: The model file cannot be read.
    """
    path = path.resolve()
    referenced = referenced_files(path)
    root = Path(
        os.path.commonpath(
            [path.parent, *referenced.values(), *(f.parent for f in referenced)]
        )
    )
    for file in (path, *referenced):
        target = folder / file.relative_to(root)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, target)
    return folder / path.relative_to(root)


def referenced_files(path: Path) -> dict[Path, Path]:
    """Files to be copied with a model, with the base folders of their names.

    Files with a `copy_obstacle` are left out.

    Raises:
        ModelError: The model file cannot be read.
    """
    return {
        file: base for file, base, fault in _referenced_files(path) if fault is None
    }


def _referenced_files(path: Path) -> Iterator[tuple[Path, Path, str | None]]:
    """Yield files referenced by a model, base folders, and obstacles to copying (or None)."""
    model = path.resolve()
    for file, base in (
        mjcf_references(path) if model_format(path) == "mjcf" else _urdf_meshes(path)
    ):
        yield file, base, copy_obstacle(file, model)


def _urdf_meshes(path: Path) -> Iterator[tuple[Path, Path]]:
    """Yield existing visual meshes of a URDF file, with the base folders of their names."""
    for mesh in read_xml(path).iterfind("link/visual/geometry/mesh"):
        location = find_mesh(mesh.get("filename", ""), path)
        if location is not None:
            folder, file = location
            yield Path(os.path.normpath(file)), folder


def find_mesh(name: str, model: Path) -> tuple[Path, Path] | None:
    """Base folder and file of a mesh named in a URDF; None if missing.

    A name package://PACKAGE/... is resolved relative to the folders above the model, nearest first,
    with the package name and then without it. Any other name is resolved relative to the model's
    folder.

    Args:
        name: Name in the model file.
        model: Model file.
    """
    folders = [model.resolve().parent, *model.resolve().parent.parents]
    plain_path = Path(name.removeprefix("file://"))
    candidates = [(folders[0], plain_path)]
    if name.startswith("package://"):
        package_path = Path(name.removeprefix("package://"))
        inner_path = (
            Path(*package_path.parts[1:])
            if len(package_path.parts) > 1
            else package_path
        )
        candidates = [
            (folder, part) for folder in folders for part in (package_path, inner_path)
        ]
    for folder, part in candidates:
        if (folder / part).is_file():
            return folder, folder / part
    return None
