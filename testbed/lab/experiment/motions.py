"""Motion that an experiment runs, and the limits of any motion of its robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.bodies.shapes.shapes import Shape
from testbed.core.base.arrays import Array
from testbed.core.base.errors import ExperimentError, InfeasibleMotion
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.robot.force_sensor import beyond_sensor
from testbed.core.robot.model_file import file_of
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.rig import robot_of
from testbed.lab.experiment.robot_tables import PLATE
from testbed.motion.fourier import Fourier
from testbed.motion.limits import limits_of
from testbed.motion.motion_file import read_motion
from testbed.motion.proof import Proof, Rules, prove
from testbed.motion.random_motion import as_fast, best_motion
from testbed.motion.surroundings import Surroundings, rules_within, surroundings
from testbed.motion.terms import (
    ForceTerm,
    PlateRange,
    PlateTerm,
    SensorTerm,
)

QUIET_PLATE = np.repeat([0.5, 0.1], 3)
"""Noise assumed for choosing a motion when the plate has none [N, N m]."""

FAST = 10
"""Samples of the fastest harmonic that a controller needs."""


def motion_of(experiment: Experiment, tree: Tree, like: Rules | None = None) -> Fourier:
    """The motion that an experiment runs, proven to respect its limits.

    Args:
        experiment: Names a motion file, or how random motions are drawn.
        tree: Its robot.
        like: Rules of the same experiment that have been made: their shapes are taken over.

    Raises:
        InfeasibleMotion: The file's motion exceeds a limit, or no random one respects all.
        ExperimentError: The file is none, of another robot, or too fast for the controller.
    """
    table, rate = experiment.motion, experiment.measurement.rate
    rules = rules_of(experiment, tree, designed=bool(table.file), like=like)
    if not table.file:
        minimal = minimal_set(tree, "reaction", zeros=experiment.identification.zeros)
        noise, rng = plate_noise_of(experiment), np.random.default_rng(experiment.seed)
        series = table.fundamental, table.harmonics
        return best_motion(rules, minimal, noise, *series, table.candidates, rng)[0]
    path = Path(table.file)
    motion = read_motion(path).motion_for(tree)
    fastest = motion.fundamental * motion.harmonics
    if FAST * fastest > rate:
        raise ExperimentError(
            f"{path}: a motion of up to {fastest:g} Hz is too fast for measurement.rate = {rate:g} "
            "Hz"
        )
    proof = prove(motion, rules)
    if not proof.holds:
        raise InfeasibleMotion(
            f"{path} does not suit this experiment: {proof.worst.words}"
        )
    return motion


def another_motion(experiment: Experiment, tree: Tree) -> Fourier:
    """A motion about as fast as the one that an experiment runs, and as safe.

    Args:
        experiment: Names a motion file, or how random motions are drawn.
        tree: Its robot.

    Raises:
        InfeasibleMotion: None that is half as fast respects all limits.
    """
    rules = rules_of(experiment, tree, designed=bool(experiment.motion.file))
    first = motion_of(experiment, tree, rules)
    return as_fast(first, rules, np.random.default_rng(experiment.seed))


def plate_noise_of(experiment: Experiment) -> Array:
    """Standard deviation of the wrench, (6,) [N, N m]; of a quiet plate if it has none."""
    own = experiment.sensor_instruments.get(
        experiment.robot.sensor, experiment.measurement
    )
    return own.plate_noise if own.plate_noise.all() else QUIET_PLATE


def rules_of(
    experiment: Experiment, tree: Tree, *, designed: bool, like: Rules | None = None
) -> Rules:
    """Limits of a motion of an experiment's robot.

    Args:
        experiment: Says so in `motion` and `excitation`.
        tree: Its robot.
        designed: Whether the motion is made for this plate; a random one may use all of the
            limits, and the plate's ranges only where they are said.
        like: Rules of the same experiment that have been made: their shapes are taken over.

    Raises:
        ExperimentError: Obstacles are given, and the model file has no shapes to keep clear.
    """
    table, motion = experiment.excitation, experiment.motion
    limits = limits_of(tree, motion.max_velocity, motion.max_acceleration)
    margin = table.margin if designed else 1.0
    terms = _terms(experiment, tree, margin, designed=designed)
    around: Surroundings | Rules = like or Surroundings()
    if like is None and not isinstance(table.clearance, str):
        others = obstacles_of(experiment), table.exclude, table.floor
        around = surroundings(tree, limits, table.clearance, *others)
    return rules_within(tree, limits, margin, terms, around)


def _terms(
    experiment: Experiment, tree: Tree, margin: float, *, designed: bool
) -> list[ForceTerm]:
    """Limits of plate and force sensors."""
    table, about = experiment.excitation, experiment.robot.sensor
    terms: list[ForceTerm] = []
    # else its range matters only where it is said
    on_plate = designed and about in (
        "",
        PLATE,
    )
    reach = table.plate_range or (
        experiment.measurement.full_scale if on_plate else None
    )
    if reach is not None or table.pressure_area is not None:
        wrench = np.full(6, np.inf) if reach is None else np.array(reach)
        area = None if table.pressure_area is None else np.array(table.pressure_area)
        plate = PlateRange(wrench, area)
        terms.append(
            SensorTerm(tree, tree, plate, margin)  # what is sampled is a sensor's
            if about
            else PlateTerm(plate, pedestal_wrench(tree), margin)
        )
    if designed and experiment.force_sensors:
        links = file_of(tree).links()
        for name, sensor in experiment.force_sensors.items():
            beyond = beyond_sensor(tree, links, sensor)
            own = PlateRange(np.array(experiment.sensor_instruments[name].full_scale))
            terms.append(SensorTerm(tree, beyond, own, margin, name))
    return terms


@dataclass(frozen=True, eq=False)
class CheckedMotion:
    """A file's motion, held against limits.

    Attributes:
        experiment: What it is held against.
        motion: Columns in the order of the robot's joints.
        rules: What it must respect.
        proof: What it leaves of that.
    """

    experiment: Experiment
    motion: Fourier
    rules: Rules
    proof: Proof


def checked_motion(path: Path, settings: Sequence[str] = ()) -> CheckedMotion:
    """Prove the motion of a file, made here or elsewhere; the file names its model.

    Args:
        path: The file.
        settings: Of the experiment, as "excitation.clearance=0.05".

    Raises:
        ExperimentError: It is no motion, or of another robot.
    """
    said = read_motion(path)
    experiment, _ = Experiment.of_model(said.model, settings).with_nearest_bodies()
    tree = robot_of(experiment)
    motion, rules = said.motion_for(tree), rules_of(experiment, tree, designed=True)
    return CheckedMotion(experiment, motion, rules, prove(motion, rules))


def obstacles_of(experiment: Experiment) -> tuple[Shape, ...]:
    """The boxes around an experiment's robot."""
    eye, black = np.eye(3), np.array([0.0, 0, 0, 1])
    return tuple(
        Shape(-1, "box", np.array(box.size) / 2, np.array(box.centre), eye, black)
        for box in experiment.excitation.obstacle
    )
