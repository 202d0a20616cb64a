"""Draft of a mapping file from column names, for the recorded joints of a robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from testbed.core.robot.locks import JointTravel
from testbed.core.robot.model_file import ModelFile, readable_model
from testbed.core.robot.tree import Tree
from testbed.importing.arms import joint_sets
from testbed.importing.check.remedies import joints_without_free_base
from testbed.importing.guess import guess_mapping
from testbed.importing.import_report import MappingDraft, toml_value
from testbed.importing.mapping import empty_keys

ASSUMED_NOTE = "ASSUMED"
"""Note beside a value that neither column names nor data determine."""

NOTE_PREFIXES = (ASSUMED_NOTE, "solved", "by the data")
"""Beginnings of the notes beside values that no column name states."""


def draft_mapping(
    paths: Sequence[Path], folder: Path, file: ModelFile
) -> tuple[MappingDraft, ModelFile, Tree]:
    """Draft a mapping file from column names, and reduce the robot to recorded joints.

    A floating root is welded unless the model file states otherwise. Joints without a column are
    locked at their rest position; no joints are locked if the columns belong to joints that the
    robot does not have.

    Args:
        paths: Files of other programs.
        folder: Folder of the mapping file.
        file: Model file; coupled joints that do not move are locked.

    Returns:
        Draft of the mapping, model file with locked joints, and robot.

    Raises:
        RecordingError: A file cannot be read, or contains no columns.
        ModelError: The model file cannot be read.
    """
    file, tree, followed = readable_model(file)
    names = [tree.names[k] for k in joints_without_free_base(tree)]
    draft = guess_mapping(paths, folder, names, joint_sets(tree, names, followed))
    logged = draft.tables[""]["joints"]
    if not set(logged) <= set(names):
        return draft, file, tree
    missing_joints = [
        joint for joint in tree.joints if joint.name in {*names} - {*logged}
    ]
    positions = {
        joint.name: JointTravel(*joint.position_range).rest_position
        for joint in missing_joints
    }
    for name, position in (
        {k: q for k, q in file.lock.items() if q is not None} | positions
    ).items():
        draft = draft.with_key(
            "lock",
            name,
            float(position),
            "held: no column of it, or by --lock [rad or m]",
        )
    file = replace(file, lock={**file.lock, **positions})
    return draft, file, file.tree() if missing_joints else tree


def missing_keys(draft: MappingDraft) -> list[str]:
    """Names of empty keys in a mapping file, which the user must fill in.

    They include clocks without a `rate`, and `position` if this table is missing.

    Args:
        draft: Draft of a mapping.
    """
    content = draft.content
    clocks = {"": content} | {
        f"sources.{k}.": each for k, each in content["sources"].items()
    }
    rateless = (
        f"{name}rate" for name, each in clocks.items() if not each.get("rate", 1.0)
    )
    none = ["position"] * ("position" not in content)
    return [*dict.fromkeys((*empty_keys(content), *rateless, *none))]


def note_rows(draft: MappingDraft) -> list[tuple[str, str, str]]:
    """Rows of key, value and comment for all values that were assumed or solved.

    Args:
        draft: Draft of a mapping.
    """
    return [
        (f"{table}.{key}".removeprefix("."), toml_value(draft.tables[table][key]), note)
        for (table, key), note in draft.key_comments.items()
        if note.startswith(NOTE_PREFIXES) and key != "# place"
    ]
