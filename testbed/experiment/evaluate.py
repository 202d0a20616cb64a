"""From an experiment's recording to its run, and the error that a coarse step leaves."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from testbed.diagnostics.diagnostic import Diagnostic
from testbed.errors import ExperimentError, TestbedError
from testbed.experiment.consistent_run import with_consistent
from testbed.experiment.experiment import Experiment
from testbed.experiment.experiment_tables import BodyTable, SimulationTable
from testbed.experiment.run import Run, assemble_run
from testbed.experiment.score import root_mean_square, shared_errors
from testbed.identification.estimate import METHODS, Method
from testbed.identification.identify import identify
from testbed.identification.regression.passes import Progress
from testbed.instruments.chain import Instrument, measured_again
from testbed.recordings.recording import Recording
from testbed.robot.model_file import ModelFile, mimic_joints, nearest_bodies
from testbed.robot.transmission import with_rotor_spin
from testbed.robot.tree import Tree
from testbed.simulation.effect import Effect

FINE = SimulationTable().step
"""Step up to which the floor is not looked for [s]: it is below what instruments leave."""


def with_floor(run: Run) -> Run:
    """A run with the metric `external_floor`, where its step is coarse.

    Args:
        run: Of an experiment.
    """
    experiment = run.experiment
    if experiment is None or run.score is None or "external" not in run.estimates:
        return run
    if experiment.simulation.step <= FINE * (1 + 1e-9):
        return run
    asked = experiment.measurement
    perfect = Instrument(rate=asked.rate, averaged=asked.averaged)
    seen = replace(measured_again(run.recording, perfect, experiment.seed).blind(), tare=None)
    plain = replace(run.settings, noise="white", nuisances=(), known={}, weights="channels")
    try:
        estimate = identify(run.tree, seen, "external", settings=plain, threads=1)
    except TestbedError:
        return run
    floor = root_mean_square(shared_errors(run.tree, estimate.base.values, plain.zeros))
    if floor is None:
        return run
    metrics = {**run.score.metrics, "external_floor": floor}
    return replace(run, score=replace(run.score, metrics=metrics))


def evaluate(
    experiment: Experiment,
    recording: Recording,
    progress: Progress = lambda done, total: None,
    methods: Iterable[Method] = METHODS,
    threads: int | None = None,
) -> Run:
    """Identify from an experiment's recording and compare with the truth.

    With consistent bodies, where the experiment asks for them.

    Args:
        experiment: What was carried out.
        recording: What the instrument measured.
        progress: Called with samples done and samples in all, method by method.
        methods: Which estimates to make.
        threads: How many to use; default one a processor.
    """
    run = assemble_run(
        with_rotor_spin(robot_of(experiment), experiment.robot.spins),
        recording,
        name=experiment.name,
        settings=experiment.identification,
        experiment=experiment,
        model=model_of(experiment),
        methods=methods,
        threads=threads,
        progress=progress,
    )
    return with_floor(with_consistent(run))


def robot_of(experiment: Experiment) -> Tree:
    """The robot of an experiment, under its gravity.

    Args:
        experiment: Names the model file.

    Raises:
        ExperimentError: A table names a joint that the robot has not.
    """
    tree = model_of(experiment).tree()
    for table, entries in experiment.joint_tables.items():
        for name in entries:
            if name not in tree.names:
                raise ExperimentError(
                    f"{table} names joint '{name}', the model has {', '.join(tree.names)}"
                )
    if experiment.robot.base == "measured":
        raise ExperimentError(
            'robot.base = "measured" is for recordings: experiments have a bedplate'
        )
    tree = experiment.robot.on(tree).with_gravity(experiment.gravity)
    for effect in effects_of(experiment, tree):
        tree = effect.robot(tree)
    return tree


def effects_of(experiment: Experiment, tree: Tree) -> list[Effect]:
    """What else is in the plant, on the robot.

    Args:
        experiment: Says so in `simulation.effect`.
        tree: The robot.
    """
    return [effect.on(tree.names) for effect in experiment.simulation.effect]


def model_of(experiment: Experiment) -> ModelFile:
    """The model file of an experiment, and how it is read.

    Args:
        experiment: Says so in `model`, `weld_root` and its table `robot`.
    """
    mimic = mimic_joints(experiment.model) if experiment.robot.lock_mimic else ()
    held = dict.fromkeys(mimic) | experiment.robot.lock
    welded, bodies = experiment.weld_root, experiment.robot.bodies
    return ModelFile(Path(experiment.model), weld_root=welded, repair=bodies, lock=held)


def with_nearest_bodies(experiment: Experiment) -> tuple[Experiment, tuple[Diagnostic, ...]]:
    """The same with the nearest bodies in place of those that cannot be, and what to say of it.

    Args:
        experiment: Of a model file and nothing else.
    """
    model = model_of(experiment)
    found = nearest_bodies(model.path, weld_root=model.weld_root, lock=model.lock)
    tables = {name: BodyTable.of(body) for name, body in found.bodies.items()}
    robot = experiment.robot.model_copy(update={"repair": tables | experiment.robot.repair})
    return experiment.model_copy(update={"robot": robot}), found.diagnostics
