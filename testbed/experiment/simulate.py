"""What an experiment records: excite, simulate, measure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.errors import ExperimentError
from testbed.excitation.rest_to_rest import rest_to_rest
from testbed.experiment.evaluate import effects_of, model_of, robot_of
from testbed.experiment.experiment import Experiment
from testbed.experiment.motions import FAST, motion_of, rules_of
from testbed.experiment.versions import versions
from testbed.files import fingerprint
from testbed.identification.passes import Progress
from testbed.instruments.chain import measure
from testbed.instruments.stage import stream
from testbed.recordings.checks import COUNTED
from testbed.recordings.geometry import geometry
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree
from testbed.simulation.build import build_plant
from testbed.simulation.controller import Reference
from testbed.simulation.drive_model import believed
from testbed.simulation.effect import StepForces
from testbed.simulation.rollout import Rollout, Sampling, Watch, simulate_motion

MOST_SAMPLES = 2e6
"""Most samples of one run: they are held in memory."""

LEAST_PERIODS = 0.02
"""Least part of a period that is a motion."""

MOST_STEPS = 10_000
"""Most simulation steps a sample: a thousand samples are held in full."""


def simulate(
    experiment: Experiment,
    progress: Progress = lambda done, total: None,
    watch: Watch = lambda time, truth: None,
    forces: StepForces | None = None,
    installed: int | None = None,
) -> Recording:
    """Simulate an experiment's robot on its bedplate and measure it.

    Args:
        experiment: What to do.
        progress: Called with samples done and samples in all.
        watch: Called with what happens while it is simulated, a second or so at a time.
        forces: On the joints, besides motors and the model's friction, asked before every step.
        installed: Seed of what chance decides once of the instrument; default the experiment's.
    """
    tree, sampling = robot_of(experiment), _sampling(experiment)
    instrument, simulation = experiment.measurement, experiment.simulation
    instrument.stages(tree.names)  # refuses what speaks of other joints before work is done
    course = _course(experiment, tree)
    plant = build_plant(
        model_of(experiment),
        tree,
        simulation.step,
        changed=experiment.robot.joint,
        friction=simulation.friction,
        effects=effects_of(experiment, tree),
    )
    run = simulate_motion(
        plant,
        _drives_model(experiment, tree),
        course.reference,
        course.end,
        simulation.bandwidth,
        sampling,
        progress,
        watch,
        _forces(experiment, tree, forces),
        course.begin,
    )
    facts, seed = _facts(experiment, tree, run) | course.facts, experiment.seed
    return measure(instrument, tree.names, run.time, run.truth, plant.tare, facts, seed, installed)


@dataclass(frozen=True, eq=False)
class _Course:
    """What is run and recorded.

    Attributes:
        reference: What the drive follows.
        begin: Of the recording [s].
        end: Of the recording [s].
        facts: What the recording says of it.
    """

    reference: Reference
    begin: float
    end: float
    facts: dict[str, Any]


def _course(experiment: Experiment, tree: Tree) -> _Course:
    """A periodic motion that is under way, or the same from rest to rest."""
    table = experiment.motion
    motion = motion_of(experiment, tree)
    if not table.at_rest:
        return _Course(motion, 0.0, table.duration, {})
    rules = rules_of(experiment, tree, designed=bool(table.file))
    whole = rest_to_rest(motion, rules, table.duration)
    lead = whole.start.duration
    return _Course(whole, -lead, whole.end + lead, {COUNTED: [0.0, whole.end]})


def _forces(experiment: Experiment, tree: Tree, more: StepForces | None) -> StepForces | None:
    """What effects and a caller push the joints with; None for nothing."""
    step = experiment.simulation.step
    asked = [effect.forces(tree, step) for effect in effects_of(experiment, tree)]
    pushes = [push for push in (*asked, more) if push is not None]
    if not pushes:
        return None

    def push(time: float, q: Array, qd: Array, motor: Array) -> Array:
        return np.asarray(sum(each(time, q, qd, motor) for each in pushes))

    return push


def _drives_model(experiment: Experiment, tree: Tree) -> Tree:
    """The robot as its controller believes it to be."""
    simulation = experiment.simulation
    own = tree if simulation.friction else tree.without_friction()
    if not simulation.drive_model_error:
        return own
    rng = stream("drive_model_error", experiment.seed)
    return believed(own, simulation.drive_model_error, rng)


def _sampling(experiment: Experiment) -> Sampling:
    """How the run is cut into samples.

    Raises:
        ExperimentError: The step does not divide the sample, or there are too many.
    """
    simulation, table, motion = experiment.simulation, experiment.measurement, experiment.motion
    _check_rates(experiment)
    steps = round(1 / (table.rate * simulation.step))
    if steps < 1 or abs(steps * table.rate * simulation.step - 1) > 1e-9:
        raise ExperimentError(
            f"simulation.step = {simulation.step:g} s does not divide the sampling time "
            f"1 / measurement.rate = {1 / table.rate:g} s"
        )
    samples = table.rate * (motion.duration + simulation.warm_up)
    if steps > MOST_STEPS:
        raise ExperimentError(
            f"simulation.step = {simulation.step:g} s makes {steps} steps a sample, more than "
            f"{MOST_STEPS}; choose a larger step"
        )
    if table.rate * motion.duration < 2:
        raise ExperimentError(f"motion.duration = {motion.duration:g} s holds no two samples")
    if samples > MOST_SAMPLES:
        raise ExperimentError(
            f"motion.duration and measurement.rate make {samples:.1e} samples, more than the "
            f"{MOST_SAMPLES:.0e} that one run holds in memory; make several runs"
        )
    return Sampling(table.rate, steps, table.averaged, simulation.warm_up)


def _check_rates(experiment: Experiment) -> None:
    """Whether controller and motion fit the rate and each other.

    Raises:
        ExperimentError: They do not.
    """
    motion, rate = experiment.motion, experiment.measurement.rate
    if experiment.simulation.bandwidth > rate / 2:
        raise ExperimentError(
            f"simulation.bandwidth = {experiment.simulation.bandwidth:g} rad/s is too fast for a "
            f"controller at measurement.rate = {rate:g} Hz; lower it to {rate / 2:g} or less"
        )
    if not motion.file and FAST * motion.fundamental * motion.harmonics > rate:
        raise ExperimentError(
            f"a motion of up to {motion.fundamental * motion.harmonics:g} Hz (motion.fundamental "
            f"times motion.harmonics) is too fast for measurement.rate = {rate:g} Hz"
        )
    periods = motion.fundamental * motion.duration
    if not motion.file and periods < LEAST_PERIODS:
        raise ExperimentError(
            f"motion.duration = {motion.duration:g} s is {periods:.2g} of a period of "
            "motion.fundamental: the robot would hardly move"
        )


def _facts(experiment: Experiment, tree: Tree, run: Rollout) -> dict[str, Any]:
    """What a recording keeps about how it was made."""
    saturated = [
        f"the motor of joint '{name}' was at its limit in {share:.1%} of the samples"
        for name, share in zip(tree.names, run.saturated, strict=True)
        if share
    ]
    return {
        "robot": tree.name,
        "geometry": geometry(tree),
        "gravity": tree.gravity.tolist(),
        "model_sha256": fingerprint(Path(experiment.model)),
        "seed": experiment.seed,
        "versions": versions(),
        "tracking_rms": dict(zip(tree.names, run.tracking.tolist(), strict=True)),
        "warnings": saturated,
    }
