"""The model file of an experiment."""

from __future__ import annotations

from pathlib import Path

from testbed.core.base.diagnostics import Diagnostic
from testbed.core.robot.model_file import ModelFile, mimic_joints, nearest_bodies
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.robot_tables import BodyTable


def model_of(experiment: Experiment) -> ModelFile:
    """The model file of an experiment, and how it is read.

    Args:
        experiment: Says so in `model`, `weld_root` and its table `robot`.
    """
    mimic = mimic_joints(experiment.model) if experiment.robot.lock_mimic else ()
    held = dict.fromkeys(mimic) | experiment.robot.lock
    welded, bodies = experiment.weld_root, experiment.robot.bodies
    return ModelFile(Path(experiment.model), weld_root=welded, repair=bodies, lock=held)


def with_nearest_bodies(
    experiment: Experiment,
) -> tuple[Experiment, tuple[Diagnostic, ...]]:
    """The same with the nearest bodies in place of those that cannot be, and what to say of it.

    Args:
        experiment: Of a model file and nothing else.
    """
    model = model_of(experiment)
    found = nearest_bodies(model.path, weld_root=model.weld_root, lock=model.lock)
    tables = {name: BodyTable.of(body) for name, body in found.bodies.items()}
    robot = experiment.robot.model_copy(
        update={"repair": tables | experiment.robot.repair}
    )
    return experiment.model_copy(update={"robot": robot}), found.diagnostics
