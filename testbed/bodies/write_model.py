"""Copies of model files with the bodies, friction and rotor inertias of trees.

Only these numbers change. The copy is read again and checked before it replaces a file.

A body of the tree is all that moves together: a link, the links fixed to it, and links on joints
that are held. Its matter is written to the carrying link, or in proportion to all its links; links
on held joints keep their proportion, because they move in the file.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import ModelError
from testbed.core.base.files import atomic_output, check_writable
from testbed.core.base.whole_files import write_atomically
from testbed.core.robot.inertia import ZERO_INERTIA, Inertia, upper_cholesky_factor
from testbed.core.robot.model_file import (
    ModelFile,
    copy_model,
    model_format,
    referenced_files,
)
from testbed.core.robot.parsing import read_xml
from testbed.core.robot.repair import ModelEdit, ModelLink, total_inertia
from testbed.core.robot.rotations import matrix_to_quaternion
from testbed.core.robot.tree import Tree

FixedLinkShare = Literal["lump", "share"]

MIN_EIGENVALUE = 1e-9
"""Smallest eigenvalue of a body's scaled pseudo-inertia that can be divided among links."""

RELATIVE_TOLERANCE = 1e-9
"""Relative tolerance between written and read inertias."""

JOINT_FIELDS = ("coulomb", "viscous", "rotor_inertia")
"""Fields of a joint that are written."""

ARCHIVE_NAME = "robots.npz"
"""Name of the archive with MuJoCo's fields of many robots."""

EXTENSIONS = {"mjcf": ".xml", "urdf": ".urdf"}
"""File name extension by format."""


def write_model(
    model: ModelFile,
    tree: Tree,
    path: Path,
    *,
    fixed: FixedLinkShare = "lump",
    note: Sequence[str] = (),
    over_source: bool = False,
    gears: Mapping[str, float] | None = None,
    delay: float = 0.0,
) -> tuple[Diagnostic, ...]:
    """Write a copy of a model file with a tree's masses, friction and rotors.

    All other bytes are unchanged. The copy is read again and checked before it is written.

    Args:
        model: Model file, and the options it was read with.
        tree: Tree with the joints of the file and other numbers.
        path: Path of the copy.
        fixed: Share of a body for links that are fixed to others: nothing ("lump"), or in
            proportion to their matter in the file ("share").
        note: Lines of a comment with the source of the numbers.
        over_source: True if `path` may be the model file itself.
        gears: True torque over the drive's reported torque, by joint: factors on MJCF's motors,
            which are added where missing.
        delay: Delay from a command to its torque, of these motors [s].

    Returns:
        Diagnostics of values that the format cannot express or that readers change.

    Raises:
        ModelError: The file cannot be edited or must not be overwritten, or `path` has the wrong
            extension for its format; or the copy would not be read with the tree's inertias.
        OSError: The path is not writable.
    """
    check_copy_path(model.path, path, over_source=over_source)
    (change,) = model_edits(model, [tree], fixed)
    change = replace(change, torque_ratios=gears or {}, delay=delay)
    ((data, diagnostics),) = _edited_copies(model, [change], note)
    read_diagnostics = _check_copy(model, data, tree)
    write_atomically(path, data)
    return (
        *change.diagnostics,
        *diagnostics,
        *read_diagnostics,
        *_missing_references(model.path, path),
    )


def write_models(
    model: ModelFile,
    trees: Sequence[Tree],
    folder: Path,
    *,
    fixed: FixedLinkShare = "lump",
    note: Sequence[str] = (),
) -> tuple[Diagnostic, ...]:
    """Write one copy of a model file for each tree, and `robots.npz` with all trees.

    The archive contains MuJoCo's fields for the named bodies and joints (`bodies`, `joints`):
    body_mass, body_ipos, body_inertia and body_iquat, (N, bodies, ...), dof_frictionloss,
    dof_damping and dof_armature, (N, joints). The first copy is read again and checked before the
    new folder replaces an old folder.

    Args:
        model: Model file, and the options it was read with.
        trees: Trees with the joints of the file and other numbers; at least one.
        folder: Folder for the copies NAME_0000 and so on.
        fixed: As for `write_model`.
        note: As for `write_model`.

    Returns:
        Diagnostics as of `write_model`, for the first copy.

    Raises:
        ModelError: The file cannot be edited.
        OSError: The folder cannot be written.
    """
    changes = model_edits(model, trees, fixed)
    extension, diagnostics = (
        EXTENSIONS[model_format(model.path)],
        list(changes[0].diagnostics),
    )
    with atomic_output(folder, folder=True) as new_folder:
        new_folder.mkdir()
        for k, (data, edit_diagnostics) in enumerate(
            _edited_copies(model, changes, note)
        ):
            if k == 0:
                diagnostics += [*edit_diagnostics, *_check_copy(model, data, trees[0])]
            (new_folder / f"{model.path.stem}_{k:04d}{extension}").write_bytes(data)
        np.savez(
            new_folder / ARCHIVE_NAME,
            allow_pickle=False,
            **mujoco_fields(changes, trees),
        )
    return (*diagnostics, *_missing_references(model.path, folder / ARCHIVE_NAME))


def model_edits(
    model: ModelFile, trees: Sequence[Tree], fixed: FixedLinkShare
) -> list[ModelEdit]:
    """Edits of a model file that give the numbers of several trees, in order.

    An edit contains the bodies and joint fields that differ from the file as read, and all repairs
    of inertias that were made on reading.

    Args:
        model: Model file, and the options it was read with.
        trees: Trees with the joints of the file and other numbers.
        fixed: As for `write_model`.
    """
    file = model.tree()
    source = model.read()
    repaired = source.repair.links
    links = [replace(x, inertia=repaired.get(x.name, x.inertia)) for x in source.links]
    edits = []
    for tree in trees:
        bodies = {
            k: new
            for k, (old, new) in enumerate(
                zip(file.inertias, tree.inertias, strict=True)
            )
            if not np.array_equal(old.pseudo, new.pseudo)
        }
        inertias, diagnostics = distribute_inertias(links, bodies, fixed)
        joints = {
            old.name: {
                k: getattr(new, k)
                for k in JOINT_FIELDS
                if getattr(new, k) != getattr(old, k)
            }
            for old, new in zip(file.joints, tree.joints, strict=True)
        }
        edits.append(
            ModelEdit({**repaired, **inertias}, joints, diagnostics=diagnostics)
        )
    return edits


def mujoco_fields(
    changes: Sequence[ModelEdit], trees: Sequence[Tree]
) -> dict[str, Array]:
    """Arrays of MuJoCo's mass, inertia and joint fields of all robots, by name.

    "bodies" and "joints" are names; body_mass, (N, bodies) [kg]; body_ipos, centre of mass,
    (N, bodies, 3) [m]; body_inertia, principal moments, (N, bodies, 3) [kg m^2]; body_iquat, the
    principal axes, (N, bodies, 4); dof_frictionloss, dof_damping, dof_armature, (N, joints).

    Args:
        changes: Edits of the model file, one a tree, all of the same links.
        trees: Trees of the robots.
    """
    bodies = list(changes[0].links)
    links = [[each.links[name] for name in bodies] for each in changes]
    central = np.array([[link.central for link in each] for each in links])
    moments, axes = np.linalg.eigh(central.reshape(len(links), len(bodies), 3, 3))
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    quaternions = matrix_to_quaternion(axes.reshape(-1, 3, 3))
    losses = np.array(
        [[[getattr(j, k) for k in JOINT_FIELDS] for j in tree.joints] for tree in trees]
    )
    fields = ("dof_frictionloss", "dof_damping", "dof_armature")
    return {
        "bodies": np.array(bodies),
        "joints": np.array(trees[0].names),
        "body_mass": np.array([[link.mass for link in each] for each in links]),
        "body_ipos": np.array([[link.com for link in each] for each in links]),
        "body_inertia": np.maximum(moments, 0.0),
        "body_iquat": quaternions.reshape(len(links), len(bodies), 4),
        **dict(zip(fields, np.moveaxis(losses, 2, 0), strict=True)),
    }


def _edited_copies(
    model: ModelFile, changes: Sequence[ModelEdit], note: Sequence[str]
) -> Iterator[tuple[bytes, tuple[Diagnostic, ...]]]:
    """Edited copies of a model file's bytes, with diagnostics of values that cannot be written.

    Args:
        model: Model file.
        changes: Edits of one copy each.
        note: Lines of a comment.
    """
    if model_format(model.path) == "mjcf":
        from testbed.bodies.edit_mjcf import edit_mjcf as edit
    else:
        from testbed.bodies.edit_urdf import edit_urdf as edit
    return edit(model.path, changes, [*note])


def check_copy_path(source: Path, path: Path, *, over_source: bool = False) -> None:
    """Check that a copy of a model file may be written to a path.

    Args:
        source: Model file.
        path: Path of the copy.
        over_source: True if the path may be that of the model file itself.

    Raises:
        ModelError: The path has the wrong extension or is that of the model file.
        OSError: The path is not writable.
    """
    extension = EXTENSIONS[model_format(source)]
    if path.suffix.lower() != extension:
        raise ModelError(
            f"'{path}': the model file '{source.name}' is copied with other numbers, so its name "
            f"ends in {extension}"
        )
    if path.exists() and path.samefile(source) and not over_source:
        raise ModelError(
            f"'{path}' is the model file itself; choose another name, or say --in-place"
        )
    check_writable(path)


def distribute_inertias(
    links: Sequence[ModelLink], bodies: Mapping[int, Inertia], fixed: FixedLinkShare
) -> tuple[dict[str, Inertia], tuple[Diagnostic, ...]]:
    """Distribute the inertias of bodies among the links of the model file.

    A body whose inertia in the file is nearly degenerate cannot be divided: its first link gets the
    whole inertia, with a diagnostic. Links without inertia that get none are omitted.

    Args:
        links: All links, parents before children.
        bodies: New inertias of bodies of the tree, by index.
        fixed: "lump" gives the sum of fixed links to their carrying link; "share" gives every link
            its proportion in the file.

    Returns:
        Inertias in the link frames, by link, and diagnostics of bodies that cannot be divided.
    """
    inertias: dict[str, Inertia] = {}
    diagnostics: list[Diagnostic] = []
    for body, whole in bodies.items():
        body_links = [link for link in links if link.body == body]
        groups: dict[str, list[ModelLink]] = {}  # by receiving link
        for link in body_links:
            groups.setdefault(
                link.name if fixed == "share" else link.fixed_carrier, []
            ).append(link)
        parts = _proportional_inertias(body_links, whole) if len(groups) > 1 else None
        if len(groups) > 1 and parts is None:
            diagnostics.append(make_diagnostic("model.shared", body_links[0].name))
            groups = {body_links[0].name: body_links}
        for group in groups.values():
            lump = (
                whole
                if parts is None
                else total_inertia(parts[link.name] for link in group)
            )
            inertias |= {link.name: ZERO_INERTIA for link in group}
            inertias[group[0].name] = lump.transformed(group[0].X_BL.inverse)
    massless = {link.name for link in links if not link.inertia.pseudo.any()}
    written = {
        k: inertia
        for k, inertia in inertias.items()
        if inertia.mass or k not in massless
    }
    return written, tuple(diagnostics)


def _proportional_inertias(
    links: Sequence[ModelLink], inertia: Inertia
) -> dict[str, Inertia] | None:
    """Inertias of a body's links in proportion to the file, in the body frame.

    One linear map L of the pseudo-inertias, J -> L J L', takes the body of the file to the new
    body, so that the parts stay physically possible. None where the smallest eigenvalue of the
    file's pseudo-inertia, scaled to unit diagonal, is below `MIN_EIGENVALUE`.

    Args:
        links: Links of the body.
        inertia: New inertia of the body, about and along its frame.
    """
    file_inertia = total_inertia(link.inertia_in_body for link in links).pseudo
    scale = np.sqrt(np.abs(np.diagonal(file_inertia)))
    if not (scale > 0).all():
        return None
    if np.linalg.eigvalsh(file_inertia / np.outer(scale, scale))[0] < MIN_EIGENVALUE:
        return None
    linear_map = upper_cholesky_factor(inertia.pseudo) @ np.linalg.inv(
        upper_cholesky_factor(file_inertia)
    )
    parts = {
        link.name: linear_map @ link.inertia_in_body.pseudo @ linear_map.T
        for link in links
    }
    return {name: Inertia.of_pseudo(part) for name, part in parts.items()}


def _check_copy(model: ModelFile, data: bytes, tree: Tree) -> tuple[Diagnostic, ...]:
    """Read a copy again and check its inertias; diagnose friction that reads differently.

    Args:
        model: Model file, and the options it was read with; referenced files are copied along.
        data: Bytes of the copy.
        tree: Tree that was written.

    Raises:
        ModelError: Inertias differ from those of the tree by over `RELATIVE_TOLERANCE` (1e-9).
    """
    with tempfile.TemporaryDirectory() as folder:
        copy = copy_model(model.path, Path(folder))
        copy.write_bytes(data)
        read = replace(model, path=copy, repair=None).tree()
    owners = [*(f"link '{joint.body}'" for joint in tree.joints), "the pedestal"]
    before, after = ((*each.inertias, each.pedestal) for each in (read, tree))
    for owner, old, new in zip(owners, before, after, strict=True):
        tolerance = RELATIVE_TOLERANCE * np.abs(new.tensor).max()
        is_equal = np.allclose(old.tensor, new.tensor, rtol=0, atol=tolerance)
        if not (
            is_equal and math.isclose(old.mass, new.mass, rel_tol=RELATIVE_TOLERANCE)
        ):
            raise ModelError(
                f"{model.path}: {owner} would not be read as it is written; nothing was written"
            )
    different_friction = [
        new.name
        for old, new in zip(read.joints, tree.joints, strict=True)
        if (old.coulomb, old.viscous) != (new.coulomb, new.viscous)
    ]
    return (
        (make_diagnostic("model.friction-unread", ", ".join(different_friction)),)
        if different_friction
        else ()
    )


def _missing_references(source: Path, path: Path) -> tuple[Diagnostic, ...]:
    """Diagnostic of relative file references that a copy in another folder breaks.

    No diagnostic if the folder is the same or all mesh names are addresses with "://".
    """
    if path.resolve().parent == source.resolve().parent or not referenced_files(source):
        return ()
    names = [mesh.get("filename", "") for mesh in read_xml(source).iter("mesh")]
    # addresses of packages, whatever the place
    if names and all("://" in name for name in names):
        return ()
    return (make_diagnostic("model.lost-files", str(source), folder=path.parent),)
