"""From an experiment's recording to its run: no simulation needed."""

from __future__ import annotations

from pathlib import Path

from testbed.errors import ExperimentError
from testbed.experiment.experiment import Experiment, RecordingTables
from testbed.experiment.experiment_tables import RobotTable
from testbed.experiment.run import Run, assemble_run
from testbed.identification.passes import Progress
from testbed.recordings.recording import Recording
from testbed.robot.load import load_tree, mimic_joints
from testbed.robot.tree import Tree


def evaluate(
    experiment: Experiment,
    recording: Recording,
    progress: Progress = lambda done, total: None,
) -> Run:
    """Identify from an experiment's recording and compare with the truth.

    Args:
        experiment: What was carried out.
        recording: What the instrument measured.
        progress: Called with samples done and samples in all, method by method.
    """
    return assemble_run(
        robot_of(experiment),
        recording,
        name=experiment.name,
        settings=experiment.identification.settings,
        zeros=experiment.identification.zeros,
        experiment=experiment,
        model=Path(experiment.model),
        weld_root=experiment.weld_root,
        lock=held_joints(Path(experiment.model), experiment.robot),
        progress=progress,
    )


def evaluate_recording(
    path: Path,
    model: Path,
    tables: RecordingTables | None = None,
    *,
    zeros: bool = False,
    weld_root: bool = False,
    accept_inertia: bool = False,
) -> Run:
    """Identify from a recording that no experiment made, by every method that it allows.

    Args:
        path: The recording.
        model: The robot's model file.
        tables: How the model file is read and the estimates are made; default as usual.
        zeros: Take parameters that are zero in the model file as known, whatever the tables say.
        weld_root: Weld a floating root to the bedplate.
        accept_inertia: Take impossible inertias with a warning.
    """
    tables = tables or RecordingTables()
    return assemble_run(
        load_robot(model, tables.robot, weld_root=weld_root, accept_inertia=accept_inertia),
        Recording.load(path),
        name=path.stem,
        settings=tables.identification.settings,
        zeros=zeros or tables.identification.zeros,
        model=model,
        weld_root=weld_root,
        lock=held_joints(model, tables.robot),
    )


def robot_of(experiment: Experiment) -> Tree:
    """The robot of an experiment, under its gravity.

    Args:
        experiment: Names the model file.

    Raises:
        ExperimentError: A table names a joint that the robot has not.
    """
    model = Path(experiment.model)
    tree = load_robot(model, experiment.robot, weld_root=experiment.weld_root)
    for table, entries in experiment.joint_tables.items():
        for name in entries:
            if name not in tree.names:
                raise ExperimentError(
                    f"{table} speaks of joint '{name}', the model has {', '.join(tree.names)}"
                )
    return tree.with_gravity(experiment.gravity)


def load_robot(
    model: Path, table: RobotTable, *, weld_root: bool = False, accept_inertia: bool = False
) -> Tree:
    """A model file's robot, with what a table says of it.

    Args:
        model: The model file.
        table: Joints that are held, and what the file does not say of others.
        weld_root: Weld a floating root to the bedplate.
        accept_inertia: Take impossible inertias with a warning.
    """
    lock = held_joints(model, table)
    tree = load_tree(model, weld_root=weld_root, accept_inertia=accept_inertia, lock=lock)
    known = {name: t.model_dump(exclude_none=True) for name, t in table.joint.items()}
    return tree.with_joints(known)


def held_joints(model: Path, table: RobotTable) -> dict[str, float | None]:
    """The joints that a table holds, and where; None: where the joint rests.

    Args:
        model: The model file.
        table: Says which.
    """
    mimic = mimic_joints(model) if table.lock_mimic else ()
    return dict.fromkeys(mimic) | table.lock
