"""Motion of an experiment, and limits of any motion of its robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.bodies.shapes.shapes import Shape
from testbed.core.base.arrays import Array
from testbed.core.base.errors import ExperimentError, NoFeasibleMotion
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.robot.force_sensor import tree_beyond_sensor
from testbed.core.robot.model_file import model_file_of
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.rig import robot_of
from testbed.lab.experiment.robot_tables import PLATE
from testbed.motion.fourier import Fourier
from testbed.motion.limits import joint_limits
from testbed.motion.motion_file import read_motion
from testbed.motion.proof import MotionConstraints, Proof, prove
from testbed.motion.random_motion import best_random_motion, equally_fast_motion
from testbed.motion.surroundings import (
    WatchedPairs,
    find_watched_pairs,
    motion_constraints,
)
from testbed.motion.terms import ForceTerm, PlateRange, PlateTerm, SensorTerm

DEFAULT_PLATE_NOISE = np.repeat([0.5, 0.1], 3)
"""Noise assumed of a plate that is simulated without noise, for choosing a motion [N, N m]."""

MIN_SAMPLES_PER_PERIOD = 10
"""Smallest number of samples in a period of the fastest harmonic, for the controller."""


def experiment_motion(
    experiment: Experiment, tree: Tree, previous_rules: MotionConstraints | None = None
) -> Fourier:
    """Motion of an experiment, from its file or random, proven to respect the limits.

    Args:
        experiment: Motion file, or number and harmonics of random motions, in `motion`. The random
            motion with the smallest predicted standard deviations is returned.
        tree: Robot of the experiment.
        previous_rules: Limits of the same experiment, whose collision shapes are reused.

    Raises:
        InfeasibleMotion: The file's motion exceeds a limit, or no random motion respects all
            limits.
        ExperimentError: The file contains no motion or that of another robot, or the motion is too
            fast for the controller.
    """
    table, rate = experiment.motion, experiment.measurement.rate
    rules = rules_of(
        experiment, tree, designed=bool(table.file), previous_rules=previous_rules
    )
    if not table.file:
        minimal = minimal_set(tree, "wrench", zeros=experiment.identification.zeros)
        noise, rng = plate_noise_of(experiment), np.random.default_rng(experiment.seed)
        series = table.fundamental, table.harmonics
        return best_random_motion(
            rules, minimal, noise, *series, table.candidates, rng
        )[0]
    path = Path(table.file)
    motion = read_motion(path).motion_for(tree)
    fastest = motion.fundamental * motion.harmonics
    if MIN_SAMPLES_PER_PERIOD * fastest > rate:
        raise ExperimentError(
            f"{path}: a motion of up to {fastest:g} Hz is too fast for measurement.rate = {rate:g} "
            "Hz"
        )
    proof = prove(motion, rules)
    if not proof.is_valid:
        raise NoFeasibleMotion(
            f"{path} does not suit this experiment: {proof.smallest_margin.words}"
        )
    return motion


def validation_motion(experiment: Experiment, tree: Tree) -> Fourier:
    """Random motion about as fast as an experiment's motion, within the same limits.

    Args:
        experiment: Motion file, or number and harmonics of random motions, in `motion`.
        tree: Robot of the experiment.

    Raises:
        InfeasibleMotion: No random motion at least half as fast respects all limits.
    """
    rules = rules_of(experiment, tree, designed=bool(experiment.motion.file))
    motion = experiment_motion(experiment, tree, rules)
    return equally_fast_motion(motion, rules, np.random.default_rng(experiment.seed))


def plate_noise_of(experiment: Experiment) -> Array:
    """Noise standard deviations of `robot.sensor` or of the plate, (6,) [N, N m].

    The default `DEFAULT_PLATE_NOISE` is used if a component is simulated without noise.
    """
    instrument = experiment.sensor_instruments.get(
        experiment.robot.sensor, experiment.measurement
    )
    return (
        instrument.plate_noise if instrument.plate_noise.all() else DEFAULT_PLATE_NOISE
    )


def rules_of(
    experiment: Experiment,
    tree: Tree,
    *,
    designed: bool,
    previous_rules: MotionConstraints | None = None,
) -> MotionConstraints:
    """Limits on the motions of an experiment's robot: joints, forces, distances between bodies.

    Args:
        experiment: Limits in `motion` and `excitation`.
        tree: Robot of the experiment.
        designed: True for a motion designed for this plate, which respects the limits with their
            margin and the ranges of the sensors. False for a random motion, which may use the full
            limits and respects the plate's range only if `excitation.plate_range` is set.
        previous_rules: Limits of the same experiment, whose collision shapes are reused.

    Raises:
        ExperimentError: There are obstacles, but the model file has no collision shapes.
    """
    table, motion = experiment.excitation, experiment.motion
    limits = joint_limits(tree, motion.max_velocity, motion.max_acceleration)
    margin = table.margin if designed else 1.0
    terms = _force_limits(experiment, tree, margin, designed=designed)
    environment: WatchedPairs | MotionConstraints = previous_rules or WatchedPairs()
    if previous_rules is None and not isinstance(table.clearance, str):
        scene = obstacle_shapes(experiment), table.exclude, table.floor
        environment = find_watched_pairs(tree, limits, table.clearance, *scene)
    return motion_constraints(tree, limits, margin, terms, environment)


def _force_limits(
    experiment: Experiment, tree: Tree, margin: float, *, designed: bool
) -> list[ForceTerm]:
    """Limits of the force plate and of the force sensors in the robot.

    The plate's limit is `excitation.plate_range`, or its full scale for a motion designed for the
    plate; an area for the centre of pressure is a further limit. The full scales of the force
    sensors are limits for a designed motion only.

    Args:
        experiment: Limits in `excitation`, ranges in `measurement` and `sensors`.
        tree: Robot of the experiment.
        margin: Fraction of a limit that a motion may use.
        designed: True for a motion that is designed for this plate.
    """
    table, sensor_name = experiment.excitation, experiment.robot.sensor
    terms: list[ForceTerm] = []
    # otherwise only an explicit plate_range is a limit
    on_plate = designed and sensor_name in (
        "",
        PLATE,
    )
    wrench_range = table.plate_range or (
        experiment.measurement.full_scale if on_plate else None
    )
    if wrench_range is not None or table.pressure_area is not None:
        largest = np.full(6, np.inf) if wrench_range is None else np.array(wrench_range)
        area = None if table.pressure_area is None else np.array(table.pressure_area)
        plate = PlateRange(largest, area)
        terms.append(
            SensorTerm(
                tree, tree, plate, margin
            )  # sampled rows are those of a force sensor
            if sensor_name
            else PlateTerm(plate, pedestal_wrench(tree), margin)
        )
    if designed and experiment.force_sensors:
        links = model_file_of(tree).links()
        for name, sensor in experiment.force_sensors.items():
            part = tree_beyond_sensor(tree, links, sensor)
            sensor_range = PlateRange(
                np.array(experiment.sensor_instruments[name].full_scale)
            )
            terms.append(SensorTerm(tree, part, sensor_range, margin, name))
    return terms


@dataclass(frozen=True, eq=False)
class CheckedMotion:
    """Motion of a file, with the proof that it respects the limits.

    Attributes:
        experiment: Experiment with the limits.
        motion: Fourier series, with columns in the robot's joint order.
        rules: Limits of the motion.
        proof: Remaining margin to every limit.
    """

    experiment: Experiment
    motion: Fourier
    rules: MotionConstraints
    proof: Proof


def prove_motion_file(path: Path, settings: Sequence[str] = ()) -> CheckedMotion:
    """Read a motion file, and prove that the motion respects the robot's limits.

    The file contains the path of its model. It may have been written by another program.

    Args:
        path: Motion file.
        settings: Overrides of the experiment, such as "excitation.clearance=0.05".

    Raises:
        ExperimentError: The file contains no motion, or the motion of another robot.
    """
    motion_file = read_motion(path)
    experiment, _ = Experiment.of_model(
        motion_file.model, settings
    ).with_nearest_bodies()
    tree = robot_of(experiment)
    motion, rules = (
        motion_file.motion_for(tree),
        rules_of(experiment, tree, designed=True),
    )
    return CheckedMotion(experiment, motion, rules, prove(motion, rules))


def obstacle_shapes(experiment: Experiment) -> tuple[Shape, ...]:
    """Collision shapes of an experiment's obstacle boxes, in the bedplate frame."""
    rotation, colour = np.eye(3), np.array([0.0, 0, 0, 1])
    return tuple(
        Shape(-1, "box", np.array(box.size) / 2, np.array(box.centre), rotation, colour)
        for box in experiment.excitation.obstacle
    )
