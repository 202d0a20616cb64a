"""Copies of model files with the bodies, friction and rotor inertias of trees.

Only these numbers change. The copy is read again and checked before it replaces a file.

A body of the tree consists of a link, the links fixed to it, and the links on locked joints. The
inertia of a body is written to the carrying link, or to all its links in proportion to the file.
Links on locked joints always keep their proportion, because these joints move in the file.
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
        fixed: Part of a body's inertia that is written to links fixed to other links: none
            ("lump"), or a part in proportion to their inertia in the file ("share").
        note: Lines of a comment on the source of the numbers.
        over_source: True if `path` may be the model file itself.
        gears: Ratios of true torque to the torque that the drive reports, keyed by joint: factors
            on the gears of MJCF motors, which are added where missing.
        delay: Delay from a command to its torque for these motors [s].

    Returns:
        Diagnostics of values that the format cannot express or that readers change.

    Raises:
        ModelError: The file cannot be edited or must not be overwritten, or `path` has the wrong
            extension for its format, or the copy does not have the tree's inertias when it is read
            again.
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

    The archive contains MuJoCo's fields of the N robots for the named bodies and joints (`bodies`,
    `joints`): body_mass, body_ipos, body_inertia and body_iquat, (N, bodies, ...),
    dof_frictionloss, dof_damping and dof_armature, (N, joints). The first copy is read again and
    checked before the new folder replaces an existing folder.

    Args:
        model: Model file, and the options it was read with.
        trees: Trees with the joints of the file and other numbers; at least one.
        folder: Folder for the copies NAME_0000 and so on.
        fixed: As for `write_model`.
        note: As for `write_model`.

    Returns:
        Diagnostics of the first copy, as returned by `write_model`.

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
    """Edits of a model file for the numbers of several trees, one per tree.

    An edit contains the bodies and joint fields that differ from the file as read, and all repairs
    of inertias that were made when the file was read.

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
    """Arrays of MuJoCo's mass, inertia and joint fields of N robots, keyed by name.

    "bodies" and "joints" contain names. The other arrays are body_mass, (N, bodies) [kg];
    body_ipos, centres of mass, (N, bodies, 3) [m]; body_inertia, principal moments, (N, bodies, 3)
    [kg m^2]; body_iquat, quaternions of the principal axes, (N, bodies, 4); dof_frictionloss,
    dof_damping and dof_armature, (N, joints).

    Args:
        changes: Edits of the model file, one per tree, all with the same links.
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
        changes: Edits, one for each copy.
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

    A body whose inertia in the file is nearly degenerate cannot be divided: its first link receives
    the whole inertia, and a diagnostic is returned. Links that have no inertia and receive none are
    omitted.

    Args:
        links: All links, parents before children.
        bodies: New inertias of bodies of the tree, keyed by index.
        fixed: "lump" to write the sum of fixed links to the carrying link, "share" to keep the
            proportions of all links in the file.

    Returns:
        Inertias in the link frames, keyed by link, and diagnostics of bodies that cannot be
        divided.
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

    A linear map L transforms the pseudo-inertias J of all links to L J L', so that their sum is the
    new inertia and every part stays physically possible. The result is None if the smallest
    eigenvalue of the body's pseudo-inertia in the file, scaled to unit diagonal, is below
    `MIN_EIGENVALUE`.

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
    """Read a copy again, check its inertias, and diagnose differences in friction.

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

    There is no diagnostic if the folder is the same or all mesh names are addresses with "://".
    """
    if path.resolve().parent == source.resolve().parent or not referenced_files(source):
        return ()
    names = [mesh.get("filename", "") for mesh in read_xml(source).iter("mesh")]
    # addresses of packages, whatever the place
    if names and all("://" in name for name in names):
        return ()
    return (make_diagnostic("model.lost-files", str(source), folder=path.parent),)
