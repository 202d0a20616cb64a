"""Read a recording of a robot from a file of any logger."""

from __future__ import annotations

from pathlib import Path

from testbed.core.base.errors import RecordingError, few
from testbed.core.base.file_kinds import kind_of
from testbed.core.base.toml_text import checked
from testbed.core.recordings.recording import Recording
from testbed.core.robot.model_file import file_of
from testbed.core.robot.tree import Tree, require_tree
from testbed.importing.check.draft_mapping import draft_mapping, missing
from testbed.importing.check.mapping_solution import solve_mapping
from testbed.importing.convert import import_recording, pieces
from testbed.importing.mapping import Mapping

MAPPING = "mapping.toml"
"""Name of a mapping file that is not written."""


def read(path: str | Path, robot: Tree) -> Recording:
    """Read a recording of a robot from a file of any logger.

    What columns are, their units, signs and clock are guessed by their names and solved from the
    data, as by `testbed new ROBOT --recording LOG`; `metadata` of the recording says how.

    Args:
        path: A recording of testbed (Parquet), a mapping file (TOML), or a log: CSV, MATLAB, HDF5,
            ROS, and others.
        robot: The robot, as `load_tree` reads it.

    Raises:
        RecordingError: The file cannot be read, or the data contradict the robot.
    """
    require_tree(robot, "read(path, robot)")
    path = Path(path)
    if path.suffix == ".toml":
        return import_recording(path).ordered(robot)
    if kind_of(path) == "recording":
        return Recording.load(path).ordered(robot)
    return _solved(path, robot)


def _solved(path: Path, robot: Tree) -> Recording:
    """The longest recording that a log holds, its mapping solved."""
    place = path.parent / MAPPING
    draft, _, tree = draft_mapping([path], path.parent, file_of(robot))
    found = solve_mapping(draft, place, tree)
    if found.refusal is not None:
        raise found.refusal
    if lacking := missing(found.draft):
        raise RecordingError(
            f"'{path}': not found: {few(lacking)}; write them into a mapping file "
            "(testbed new ROBOT --recording LOG)"
        )
    made, _ = pieces(place, checked(Mapping, found.draft.content, str(path)))
    return max(made, key=lambda each: each.samples).ordered(tree)
