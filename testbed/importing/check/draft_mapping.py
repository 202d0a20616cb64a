"""Mapping by the names of columns alone, for the joints of a robot that a log has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from testbed.core.robot.locks import Travel
from testbed.core.robot.model_file import ModelFile, expressible
from testbed.core.robot.tree import Tree
from testbed.importing.arms import joint_sets
from testbed.importing.check.remedies import own_joints
from testbed.importing.guess import guessed
from testbed.importing.import_report import MappingDraft, in_toml
from testbed.importing.mapping import empty_keys

ASSUMED = "ASSUMED"
"""Mark of what neither names nor data determine."""

KNOWN = (ASSUMED, "solved", "by the data")
"""Beginnings of what is said beside a value that no name states."""


def draft_mapping(
    paths: Sequence[Path], folder: Path, file: ModelFile
) -> tuple[MappingDraft, ModelFile, Tree]:
    """Mapping by the columns' names, and a robot without the joints that the log lacks.

    A root that floats is welded, unless the file already says how.

    Args:
        paths: Files of other programs.
        folder: Where the mapping is to stand.
        file: The model file; of joints that follow others those are held that do not move.

    Raises:
        RecordingError: A file cannot be read, or holds no columns.
        ModelError: The model file cannot be read.
    """
    file, tree, followed = expressible(file)
    names = [tree.names[k] for k in own_joints(tree)]
    draft = guessed(paths, folder, names, joint_sets(tree, names, followed))
    logged = draft.tables[""]["joints"]
    if not set(logged) <= set(names):
        return draft, file, tree
    lacking = [joint for joint in tree.joints if joint.name in {*names} - {*logged}]
    places = {joint.name: Travel(*joint.position_range).rest for joint in lacking}
    for name, place in (
        {k: q for k, q in file.lock.items() if q is not None} | places
    ).items():
        draft = draft.saying(
            "lock", name, float(place), "held: no column of it, or by --lock [rad or m]"
        )
    file = replace(file, lock={**file.lock, **places})
    return draft, file, file.tree() if lacking else tree


def missing(draft: MappingDraft) -> list[str]:
    """Keys that a person must fill in.

    Args:
        draft: A mapping.
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


def table_of(draft: MappingDraft) -> list[tuple[str, str, str]]:
    """What was assumed or solved: key, value, and what it is known by.

    Args:
        draft: Of a solution.
    """
    return [
        (f"{table}.{key}".removeprefix("."), in_toml(draft.tables[table][key]), note)
        for (table, key), note in draft.notes.items()
        if note.startswith(KNOWN) and key != "# place"
    ]
