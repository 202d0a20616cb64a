"""Motor shafts that turn with several joints, as a recording's mapping says of its gear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from testbed.recordings.source import Source
from testbed.robot.locks import Shafts, with_shafts
from testbed.robot.tree import Tree

LONGEST = 1000
"""Joints of a mapping."""


def is_imported(source: Source) -> bool:
    """Whether a recording was made by a mapping file: real drives have offsets and couplings.

    Args:
        source: The recording.
    """
    return "mapping" in source.facts


def with_gear(tree: Tree, source: Source) -> Tree:
    """The robot with the shafts that a recording's gear couples, unless it has some already.

    Args:
        tree: The robot.
        source: The recording.
    """
    found = {} if tree.shafts else coupled_shafts(source.facts)
    known = all(joint in tree.names for turns in found.values() for joint in turns)
    return with_shafts(tree, found) if found and known else tree


def coupled_shafts(facts: Mapping[str, Any]) -> Shafts:
    """Shafts of the gear's rows with several joints, called JOINT.motor; {} where there are none.

    The shaft's own joint counts as one, or else the joint with which it turns most.

    Args:
        facts: Of a recording; nothing in it is trusted.
    """
    mapping = facts.get("mapping")
    gear = mapping.get("gear") if isinstance(mapping, Mapping) else None
    joints = mapping.get("joints") if isinstance(mapping, Mapping) else None
    rows = _rows(gear.get("matrix")) if isinstance(gear, Mapping) else None
    named = isinstance(joints, Sequence) and all(isinstance(joint, str) for joint in joints)
    if rows is None or not named or rows.shape != (len(joints or ()),) * 2:
        return {}
    found = {}
    for k, (name, row) in enumerate(zip(joints or (), rows, strict=True)):
        if np.count_nonzero(row) > 1:
            turns = row / (row[k] or row[np.argmax(np.abs(row))])
            found[f"{name}.motor"] = {
                joint: float(turn) for joint, turn in zip(joints or (), turns, strict=True) if turn
            }
    return found


def _rows(matrix: object) -> Any:
    try:
        rows = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    square = rows.ndim == 2 and rows.shape[0] == rows.shape[1] <= LONGEST
    return rows if square and np.isfinite(rows).all() else None
