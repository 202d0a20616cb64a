"""Which motion an experiment runs, and what any motion of its robot must respect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from testbed.bodies.shapes.appearance import load_shapes
from testbed.bodies.shapes.shapes import Shape, bounds, poses_at_zero
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import ExperimentError, InfeasibleMotion
from testbed.core.base.toml_text import Finite, Positive, checked, read_toml
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.robot.force_sensor import beyond_sensor
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_robot import model_of, robot_of, with_nearest_bodies
from testbed.lab.experiment.robot_tables import PLATE, Table
from testbed.motion.clearance import Watched, watched
from testbed.motion.collision_model import Obstacle, collision_model
from testbed.motion.fourier import Fourier
from testbed.motion.limits import (
    EffortTerm,
    Limits,
    PlateRange,
    PlateTerm,
    SmoothTerm,
    limits_of,
)
from testbed.motion.proof import Proof, Rules, prove, seems_to_hold
from testbed.motion.random_motion import best_motion
from testbed.motion.sensor_range import SensorTerm


class _Joint(Table):
    offset: Finite
    sine: Annotated[list[Finite], Field(max_length=1000)]
    cosine: Annotated[list[Finite], Field(max_length=1000)]


class _Limit(Table):
    position: tuple[Finite, Finite]
    velocity: Positive
    acceleration: Positive
    effort: Positive | None = None


class _Proven(Table):
    limit: str
    left: Finite
    unit: str
    instant: Finite


class _File(Table):
    model: str
    model_sha256: str = ""
    fundamental: Positive
    joint: dict[str, _Joint]
    limits: dict[str, _Limit] = Field(default_factory=dict)
    predicted: dict[str, Finite] = Field(default_factory=dict)
    proof: list[_Proven] = Field(default_factory=list)


@dataclass(frozen=True, eq=False)
class MotionFile:
    """What a motion file says.

    Attributes:
        path: The file.
        model: The model file it was made for.
        motion: Columns in the order of `names`.
        names: Of the joints.
    """

    path: Path
    model: Path
    motion: Fourier
    names: tuple[str, ...]

    def motion_for(self, tree: Tree) -> Fourier:
        """The motion in the order of a robot's joints.

        Args:
            tree: The robot.

        Raises:
            ExperimentError: It has other joints.
        """
        if set(self.names) != set(tree.names):
            hint = ""
            if set(self.names) < set(tree.names):
                hint = (
                    "; hold those which the motion leaves out, by --set robot.lock.JOINT=POSITION"
                )
            raise ExperimentError(
                f"{self.path} moves {', '.join(self.names)}; the robot has "
                f"{', '.join(tree.names)}{hint}"
            )
        order = [self.names.index(name) for name in tree.names]
        return Fourier.of(self.motion.fundamental, self.motion.coefficients[order])


def read_motion(path: Path) -> MotionFile:
    """Read a motion.

    Args:
        path: A file that `write_motion` wrote, or one of the same form: model, fundamental and
            a table for each joint do.

    Raises:
        ExperimentError: It is no such file.
    """
    found = checked(_File, read_toml(path, "motion"), str(path))
    counts = {len(part) for joint in found.joint.values() for part in (joint.sine, joint.cosine)}
    if len(counts) != 1 or 0 in counts:
        raise ExperimentError(
            f"{path}: all joints need sines and cosines, equally many, found {sorted(counts)}"
        )
    if "\0" in found.model:
        raise ExperimentError(f"{path}: model is not a file name")
    rows = [[joint.offset, *joint.sine, *joint.cosine] for joint in found.joint.values()]
    return MotionFile(
        path=path,
        model=(path.parent / found.model).resolve(),
        motion=Fourier.of(found.fundamental, np.array(rows)),
        names=tuple(found.joint),
    )


QUIET_PLATE = np.repeat([0.5, 0.1], 3)
"""Noise assumed for choosing a motion when the plate has none [N, N m]."""


FAST = 10
"""Samples of the fastest harmonic that a controller needs."""

NEARLY_AS_FAST = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
"""Of the speed of a motion, tried one after the other for another one."""

OTHERS = 20
"""Motions tried at each of them."""

HANGS = 0.1
"""Part of a robot's reach by which its joints may lie below its floor."""


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
    table = experiment.motion
    if table.file:
        return _of_file(experiment, tree, like)
    rules = rules_of(experiment, tree, designed=False, like=like)
    zeros = experiment.identification.zeros
    motion, _ = best_motion(
        rules,
        minimal_set(tree, "reaction", zeros=zeros),
        plate_noise_of(experiment),
        table.fundamental,
        table.harmonics,
        table.candidates,
        np.random.default_rng(experiment.seed),
    )
    return motion


def another_motion(experiment: Experiment, tree: Tree) -> Fourier:
    """A motion about as fast as the one that an experiment runs, and as safe.

    The same amplitudes with other phases: over a period rms velocities and accelerations of every
    joint are those of that one, or a share of them, at least a half, where limits ask for it.

    Args:
        experiment: Names a motion file, or how random motions are drawn.
        tree: Its robot.

    Raises:
        InfeasibleMotion: None that is half as fast respects all limits.
    """
    rules = rules_of(experiment, tree, designed=bool(experiment.motion.file))
    first = motion_of(experiment, tree, rules)
    rng = np.random.default_rng(experiment.seed)
    for share, _ in product(NEARLY_AS_FAST, range(OTHERS)):
        motion = first.rephased(rng).scaled(share, first.offset)
        if seems_to_hold(motion, rules) and prove(motion, rules).holds:
            return motion
    raise InfeasibleMotion("no other motion that is half as fast as it respects all limits")


def plate_noise_of(experiment: Experiment) -> Array:
    """Standard deviation of the wrench, (6,) [N, N m]; of a quiet plate if it has none."""
    own = experiment.sensor_instruments.get(experiment.robot.sensor, experiment.measurement)
    return own.plate_noise if own.plate_noise.all() else QUIET_PLATE


def _of_file(experiment: Experiment, tree: Tree, like: Rules | None) -> Fourier:
    """A file's motion, proven again: robot and limits may be others than it was made for."""
    path = Path(experiment.motion.file)
    motion = read_motion(path).motion_for(tree)
    fastest, rate = motion.fundamental * motion.harmonics, experiment.measurement.rate
    if FAST * fastest > rate:
        raise ExperimentError(
            f"{path}: a motion of up to {fastest:g} Hz is too fast for measurement.rate = {rate:g} "
            "Hz"
        )
    proof = prove(motion, rules_of(experiment, tree, designed=True, like=like))
    if not proof.holds:
        raise InfeasibleMotion(f"{path} does not suit this experiment: {proof.worst.words}")
    return motion


def rules_of(
    experiment: Experiment, tree: Tree, *, designed: bool, like: Rules | None = None
) -> Rules:
    """What a motion of an experiment's robot must respect.

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
    terms: list[SmoothTerm] = []
    about = experiment.robot.sensor
    on_plate = designed and about in ("", PLATE)  # else its range matters only where it is said
    reach = table.plate_range or (experiment.measurement.full_scale if on_plate else None)
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
        links = model_of(experiment).links()
        for name, sensor in experiment.force_sensors.items():
            reach = experiment.sensor_instruments[name].full_scale
            beyond = beyond_sensor(tree, links, sensor)
            terms.append(SensorTerm(tree, beyond, PlateRange(np.array(reach)), margin, name))
    if np.isfinite(limits.effort).any():
        terms.append(EffortTerm(tree, limits, margin))
    if like is not None:
        return replace(like, margin=margin, terms=tuple(terms))
    if isinstance(table.clearance, str):
        return Rules(tree, limits, margin, tuple(terms), None, np.zeros(0))
    seen, said = _surroundings(experiment, tree, limits, table.clearance)
    if seen is None:
        return Rules(tree, limits, margin, tuple(terms), None, np.zeros(0), said)
    return Rules(tree, limits, margin, tuple(terms), seen.collision, seen.clearance, said)


def _surroundings(
    experiment: Experiment, tree: Tree, limits: Limits, clearance: float
) -> tuple[Watched | None, tuple[Diagnostic, ...]]:
    """The robot's shapes and what stands around them; what cannot be watched."""
    table, model = experiment.excitation, model_of(experiment)
    shapes_of_model = load_shapes(model.path, tree, weld_root=model.weld_root, lock=model.lock)
    if not any(shape.body >= 0 for shape in shapes_of_model.shapes):
        if table.obstacle:
            raise ExperimentError(
                f"{model.path} has no shapes: the distance to excitation.obstacle is unknown; "
                "give the file collision or visual geometry"
            )
        return None, (*shapes_of_model.diagnostics, diagnose("motion.no-shapes"))
    floor = None if isinstance(table.floor, str) else table.floor
    said = shapes_of_model.diagnostics
    if table.floor is None:
        floor = _floor(tree, shapes_of_model.shapes)
        if floor is None:
            said += (diagnose("motion.no-floor"),)
    every = collision_model(tree, shapes_of_model.shapes, obstacles_of(experiment), floor)
    every = every.without(table.exclude)
    found = watched(every, limits, clearance, np.random.default_rng(0))
    return found, (*said, *found.diagnostics)


def _floor(tree: Tree, shapes: tuple[Shape, ...]) -> float | None:
    """The lowest point of what stands on the plate, or the plate's plane [m].

    None for a robot that hangs below it in the posture of zeros: that plane is no floor.
    """
    standing = (float(bounds(shape)[0][2]) for shape in shapes if shape.body < 0)
    floor = min(standing, default=0.0)
    origins = np.array([place for _, place in poses_at_zero(tree)])
    reach = float(np.linalg.norm(origins, axis=1).max())
    return None if origins[:, 2].min() < floor - HANGS * reach else floor


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
    experiment, _ = with_nearest_bodies(Experiment.of_model(said.model, settings))
    tree = robot_of(experiment)
    motion, rules = said.motion_for(tree), rules_of(experiment, tree, designed=True)
    return CheckedMotion(experiment, motion, rules, prove(motion, rules))


def obstacles_of(experiment: Experiment) -> tuple[Obstacle, ...]:
    """The boxes around an experiment's robot."""
    boxes = experiment.excitation.obstacle
    return tuple(Obstacle(np.array(box.centre), np.array(box.size) / 2) for box in boxes)
