"""Read a recording of a robot from a file of any logger."""

from __future__ import annotations

from pathlib import Path

from testbed.core.base.errors import RecordingError, shortened_list
from testbed.core.base.file_kinds import kind_of
from testbed.core.base.toml_text import validate_tables
from testbed.core.recordings.recording import Recording
from testbed.core.robot.model_file import model_file_of
from testbed.core.robot.tree import Tree, require_tree
from testbed.importing.check.draft_mapping import draft_mapping, missing_keys
from testbed.importing.check.mapping_solution import solve_mapping
from testbed.importing.convert import import_recording, import_recordings
from testbed.importing.mapping import Mapping

MAPPING_NAME = "mapping.toml"
"""File name of the mapping, which is not written to a file."""


def read(path: str | Path, robot: Tree) -> Recording:
    """Read a recording of a robot from a file of any logger.

    Columns, units, signs and clocks are guessed from column names and solved from the data, as in
    `testbed new ROBOT --recording LOG`; `metadata` of the recording lists the results.

    Args:
        path: Recording of testbed (Parquet), mapping file (TOML), or log: CSV, MATLAB, HDF5, ROS,
            and others.
        robot: Robot, as returned by `load_tree`.

    Raises:
        RecordingError: The file cannot be read, or the data contradict the robot.
    """
    require_tree(robot, "read(path, robot)")
    path = Path(path)
    if path.suffix == ".toml":
        return import_recording(path).ordered(robot)
    if kind_of(path) == "recording":
        return Recording.load(path).ordered(robot)
    return _solved_recording(path, robot)


def _solved_recording(path: Path, robot: Tree) -> Recording:
    """Longest recording of a log, with its mapping solved from column names and data.

    Raises:
        RecordingError: Columns or a clock are not found, or the data contradict the robot.
    """
    mapping_path = path.parent / MAPPING_NAME
    draft, _, tree = draft_mapping([path], path.parent, model_file_of(robot))
    solution = solve_mapping(draft, mapping_path, tree)
    if solution.error is not None:
        raise solution.error
    if empty_keys := missing_keys(solution.draft):
        raise RecordingError(
            f"'{path}': not found: {shortened_list(empty_keys)}; write them into a mapping file "
            "(testbed new ROBOT --recording LOG)"
        )
    recordings, _ = import_recordings(
        mapping_path, validate_tables(Mapping, solution.draft.content, str(path))
    )
    return max(recordings, key=lambda each: each.samples).ordered(tree)
