"""A tree's bodies, friction and rotors written into a copy of its model file.

Nothing but those numbers changes. What was written is read again before it takes its place.

A tree's body is all that moves together: a link, what is fixed to it, and what hangs on joints
that are held. Its matter goes to the link that carries the others, or to all in proportion; links
on held joints keep their proportion, because in the file they move.
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
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import ModelError
from testbed.core.base.files import check_writable, replacing
from testbed.core.base.whole_files import write_whole
from testbed.core.robot.inertia import NOTHING, Inertia, upper_root
from testbed.core.robot.model_file import (
    ModelFile,
    copy_model,
    model_format,
    references,
)
from testbed.core.robot.parsing import read_xml
from testbed.core.robot.repair import Edit, FileLink, total
from testbed.core.robot.rotations import to_quaternion
from testbed.core.robot.tree import Tree

Fixed = Literal["lump", "share"]

THIN = 1e-9
"""Least part of a body's matter in any direction that can be shared out."""

EXACT = 1e-9
"""Part of a body by which what is read again may differ from what was written."""

LOSSES = ("coulomb", "viscous", "rotor_inertia")
"""What of a joint is written."""

ARCHIVE = "robots.npz"
"""Of many robots as MuJoCo's fields."""

ENDINGS = {"mjcf": ".xml", "urdf": ".urdf"}


def write_model(
    model: ModelFile,
    tree: Tree,
    path: Path,
    *,
    fixed: Fixed = "lump",
    note: Sequence[str] = (),
    over_source: bool = False,
    gears: Mapping[str, float] | None = None,
    delay: float = 0.0,
) -> tuple[Diagnostic, ...]:
    """Write a model file with a tree's masses, friction and rotors, all else byte for byte.

    Args:
        model: The file, and how it was read.
        tree: Of the file's joints, with other numbers.
        path: Where to.
        fixed: What of a body goes to links that are fixed to others: nothing ("lump"), or what
            is in proportion to what they had ("share").
        note: Lines of a comment: where the numbers come from.
        over_source: Whether `path` may be the model file itself.
        gears: By joint, true torque over what its drive reports: into MJCF's motors, one more
            where a joint has none.
        delay: From a command to its torque, of those motors [s].

    Returns:
        What the format has no place for, what readers will make otherwise.

    Raises:
        ModelError: The file cannot be edited, or is not to be overwritten, or `path` has not the
            ending of its format.
    """
    check_place(model.path, path, over_source=over_source)
    (change,) = changes_of(model, [tree], fixed)
    change = replace(change, gears=gears or {}, delay=delay)
    ((data, said),) = _edited(model, [change], note)
    unread = _check(model, data, tree)
    write_whole(path, data)
    return (*change.diagnostics, *said, *unread, *_lost_files(model.path, path))


def write_models(
    model: ModelFile,
    trees: Sequence[Tree],
    folder: Path,
    *,
    fixed: Fixed = "lump",
    note: Sequence[str] = (),
) -> tuple[Diagnostic, ...]:
    """Write a copy of a model file for each of many trees, and `robots.npz` with all of them.

    The archive holds MuJoCo's fields for the bodies and joints that it names (`bodies`, `joints`):
    body_mass, body_ipos, body_inertia and body_iquat, (N, bodies, ...), dof_frictionloss,
    dof_damping and dof_armature, (N, joints). The first file is read again before the folder takes
    its place.

    Args:
        model: The file, and how it was read.
        trees: Of the file's joints, with other numbers; at least one.
        folder: Where to: NAME_0000 and so on.
        fixed: As for `write_model`.
        note: As for `write_model`.

    Returns:
        As `write_model`, of the first.

    Raises:
        ModelError: The file cannot be edited.
        OSError: The folder cannot be written.
    """
    changes = changes_of(model, trees, fixed)
    ending, said = ENDINGS[model_format(model.path)], list(changes[0].diagnostics)
    with replacing(folder, folder=True) as fresh:
        fresh.mkdir()
        for k, (data, more) in enumerate(_edited(model, changes, note)):
            if k == 0:
                said += [*more, *_check(model, data, trees[0])]
            (fresh / f"{model.path.stem}_{k:04d}{ending}").write_bytes(data)
        np.savez(fresh / ARCHIVE, allow_pickle=False, **mujoco_fields(changes, trees))
    return (*said, *_lost_files(model.path, folder / ARCHIVE))


def changes_of(model: ModelFile, trees: Sequence[Tree], fixed: Fixed) -> list[Edit]:
    """What makes trees of a model file.

    Args:
        model: The file, and how it was read.
        trees: Of the file's joints, with other numbers.
        fixed: As for `write_model`.
    """
    file = model.tree()
    source = model.read()
    repair = source.repair.links
    links = [replace(x, inertia=repair.get(x.name, x.inertia)) for x in source.links]
    found = []
    for tree in trees:
        bodies = {
            k: new
            for k, (old, new) in enumerate(
                zip(file.inertias, tree.inertias, strict=True)
            )
            if not np.array_equal(old.pseudo, new.pseudo)
        }
        inertias, said = share_out(links, bodies, fixed)
        joints = {
            old.name: {
                k: getattr(new, k) for k in LOSSES if getattr(new, k) != getattr(old, k)
            }
            for old, new in zip(file.joints, tree.joints, strict=True)
        }
        found.append(Edit({**repair, **inertias}, joints, diagnostics=said))
    return found


def mujoco_fields(changes: Sequence[Edit], trees: Sequence[Tree]) -> dict[str, Array]:
    """What `write_models` keeps in its archive.

    Args:
        changes: One a tree, all of the same links.
        trees: The robots.
    """
    bodies = list(changes[0].links)
    links = [[each.links[name] for name in bodies] for each in changes]
    central = np.array([[link.central for link in each] for each in links])
    moments, axes = np.linalg.eigh(central.reshape(len(links), len(bodies), 3, 3))
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    quaternions = to_quaternion(axes.reshape(-1, 3, 3))
    losses = np.array(
        [[[getattr(j, k) for k in LOSSES] for j in tree.joints] for tree in trees]
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


def _edited(
    model: ModelFile, changes: Sequence[Edit], note: Sequence[str]
) -> Iterator[tuple[bytes, tuple[Diagnostic, ...]]]:
    """The file's bytes with each of the changes, and what the format has no place for."""
    if model_format(model.path) == "mjcf":
        from testbed.bodies.edit_mjcf import edit_mjcf as edit
    else:
        from testbed.bodies.edit_urdf import edit_urdf as edit
    return edit(model.path, changes, [*note])


def check_place(source: Path, path: Path, *, over_source: bool = False) -> None:
    """Whether a file may be written there.

    Args:
        source: The model file.
        path: Where to.
        over_source: Whether that may be the model file itself.

    Raises:
        ModelError: It may not.
        OSError: There is something else, or the place may not be written to.
    """
    ending = ENDINGS[model_format(source)]
    if path.suffix.lower() != ending:
        raise ModelError(
            f"'{path}': the model file '{source.name}' is copied with other numbers, so its name "
            f"ends in {ending}"
        )
    if path.exists() and path.samefile(source) and not over_source:
        raise ModelError(
            f"'{path}' is the model file itself; choose another name, or say --in-place"
        )
    check_writable(path)


def share_out(
    links: Sequence[FileLink], bodies: Mapping[int, Inertia], fixed: Fixed
) -> tuple[dict[str, Inertia], tuple[Diagnostic, ...]]:
    """What each link gets.

    Args:
        links: All, carriers before what they carry.
        bodies: New inertias of some of the tree's bodies, by index.
        fixed: "lump" gives all of what is fixed together to the link that carries the rest;
            "share" gives to every link in proportion to what it had.

    Returns:
        Inertias by link, about and along its frame; and what could not be shared.
    """
    found: dict[str, Inertia] = {}
    said: list[Diagnostic] = []
    for body, whole in bodies.items():
        own = [link for link in links if link.body == body]
        groups: dict[str, list[FileLink]] = {}  # by the link that gets what is theirs
        for link in own:
            groups.setdefault(
                link.name if fixed == "share" else link.carrier, []
            ).append(link)
        parts = _in_proportion(own, whole) if len(groups) > 1 else None
        if len(groups) > 1 and parts is None:
            said.append(diagnose("model.shared", own[0].name))
            groups = {own[0].name: own}
        for group in groups.values():
            lump = whole if parts is None else total(parts[link.name] for link in group)
            found |= {link.name: NOTHING for link in group}
            found[group[0].name] = lump.moved(group[0].X_BL.inverse)
    bare = {link.name for link in links if not link.inertia.pseudo.any()}
    kept = {name: own for name, own in found.items() if own.mass or name not in bare}
    return kept, tuple(said)


def _in_proportion(
    own: Sequence[FileLink], whole: Inertia
) -> dict[str, Inertia] | None:
    """Parts that make up a body, by link, about the body's frame; None where there is no measure.

    One affine map and one factor take the file's matter to the new one: all parts go along, and
    each stays such as a body can have.
    """
    before = total(link.in_body for link in own).pseudo
    scale = np.sqrt(np.abs(np.diagonal(before)))
    if not (scale > 0).all():
        return None
    if np.linalg.eigvalsh(before / np.outer(scale, scale))[0] < THIN:
        return None
    change = upper_root(whole.pseudo) @ np.linalg.inv(upper_root(before))
    parts = {link.name: change @ link.in_body.pseudo @ change.T for link in own}
    return {name: Inertia.of_pseudo(part) for name, part in parts.items()}


def _check(model: ModelFile, data: bytes, tree: Tree) -> tuple[Diagnostic, ...]:
    """Whether what is to be written is read as it is meant; a diagnostic where losses are not."""
    with tempfile.TemporaryDirectory() as folder:
        copy = copy_model(model.path, Path(folder))
        copy.write_bytes(data)
        read = replace(model, path=copy, repair=None).tree()
    owners = [*(f"link '{joint.body}'" for joint in tree.joints), "the pedestal"]
    before, after = ((*each.inertias, each.pedestal) for each in (read, tree))
    for owner, old, new in zip(owners, before, after, strict=True):
        near = EXACT * np.abs(new.tensor).max()
        same = np.allclose(old.tensor, new.tensor, rtol=0, atol=near)
        if not (same and math.isclose(old.mass, new.mass, rel_tol=EXACT)):
            raise ModelError(
                f"{model.path}: {owner} would not be read as it is written; nothing was written"
            )
    unread = [
        new.name
        for old, new in zip(read.joints, tree.joints, strict=True)
        if (old.coulomb, old.viscous) != (new.coulomb, new.viscous)
    ]
    return (diagnose("model.friction-unread", ", ".join(unread)),) if unread else ()


def _lost_files(source: Path, path: Path) -> tuple[Diagnostic, ...]:
    """A diagnostic where what the file refers to is not found from its new place."""
    if path.resolve().parent == source.resolve().parent or not references(source):
        return ()
    names = [mesh.get("filename", "") for mesh in read_xml(source).iter("mesh")]
    # addresses of packages, whatever the place
    if names and all("://" in name for name in names):
        return ()
    return (diagnose("model.lost-files", str(source), folder=path.parent),)
