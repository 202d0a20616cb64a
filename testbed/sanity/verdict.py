"""The verdict on a recording, kept with it, so that nothing is held against a robot twice."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any

from testbed.parameters.barycentric import standard
from testbed.recordings.geometry import geometry
from testbed.recordings.source import Source
from testbed.robot.tree import Tree

FACT = "verdict"
"""Where a recording keeps it."""

METHOD = 2
"""Of the check; another number and what was kept counts no more."""

BLOCK = 100_000
"""Samples that are read at once."""


def digest(tree: Tree, source: Source) -> str:
    """Of all that a verdict depends on: the data, what the mapping says, the robot.

    Args:
        tree: The robot.
        source: The recording.
    """
    facts = [
        METHOD, source.names, source.rate, source.facts.get("mapping"),
        source.facts.get("gravity"), geometry(tree), standard(tree).tolist(),
        tree.gravity.tolist(), [joint.position_range.tolist() for joint in tree.joints],
        None if source.tare is None else source.tare.tolist(), tree.floating,
    ]  # fmt: skip
    found = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    for first in range(0, source.samples, BLOCK):
        part = source.part(first, min(source.samples, first + BLOCK))
        for values in (part.time, part.position, part.torque, part.wrench):
            found.update(b"" if values is None else values.tobytes())
    return found.hexdigest()


def verdict(of: str, warnings: Sequence[str]) -> dict[str, Any]:
    """What a recording that was accepted keeps.

    Args:
        of: The digest.
        warnings: What may be wrong, all the same.
    """
    return {FACT: {"of": of, "warnings": list(warnings)}}


def kept_warnings(of: str, source: Source) -> tuple[str, ...] | None:
    """What was said when the same was held against the same robot; None if it was not.

    Args:
        of: The digest.
        source: The recording.
    """
    known = source.facts.get(FACT) or {}
    return tuple(known["warnings"]) if known.get("of") == of else None
