"""Record an experiment: choose its motion, simulate its rig."""

from __future__ import annotations

from testbed.core.base.errors import ExperimentError
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.recordings.recording import Recording
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.motions import (
    MIN_SAMPLES_PER_PERIOD,
    experiment_motion,
    rules_of,
)
from testbed.lab.experiment.rig import rig_of
from testbed.lab.experiment.simulate import simulate
from testbed.lab.simulation.effect import ForceFunction
from testbed.lab.simulation.rollout import BlockCallback
from testbed.motion.fourier import Fourier
from testbed.motion.rest_to_rest import RestToRest, rest_to_rest

MIN_PERIODS = 0.1
"""Smallest number of periods of the fastest harmonic in a recording."""


def record(
    experiment: Experiment,
    progress: Progress = ignore_progress,
    watch: BlockCallback = ignore_progress,
    forces: ForceFunction | None = None,
    installed: int | None = None,
    motion: Fourier | None = None,
) -> Recording:
    """Simulate the robot of an experiment along its motion, and record its sensors.

    Args:
        experiment: Robot, motion, plant and sensors.
        progress: Called with the number of finished samples and of all samples.
        watch: Called with the simulated states about once a second of simulation.
        forces: Function for joint forces in addition to those of the experiment, called before
            every step.
        installed: Seed of the constant signs and phases of sensor errors; default the experiment's
            seed.
        motion: Motion that replaces the experiment's.

    Raises:
        TestbedError: The experiment cannot be carried out as specified.
    """
    table = experiment.motion
    rig = rig_of(experiment)
    rig.steps(table.duration)  # refuses before any work
    experiment.sensed_part(rig.robot)
    _check_motion(experiment)
    motion = motion or experiment_motion(experiment, rig.true_robot)
    reference: Fourier | RestToRest = motion
    if table.at_rest:
        rules = rules_of(experiment, rig.true_robot, designed=bool(table.file))
        reference = rest_to_rest(motion, rules, table.duration)
    return simulate(
        rig,
        reference,
        table.duration,
        experiment.seed,
        progress=progress,
        watch=watch,
        forces=forces,
        installed=installed,
    )


def _check_motion(experiment: Experiment) -> None:
    """Check that the random motions fit the sampling rate and the duration.

    The motion of a file is not checked.

    Raises:
        ExperimentError: The fastest harmonic is too fast for the rate or too slow for the duration.
    """
    motion, rate = experiment.motion, experiment.measurement.rate
    fastest = motion.fundamental * motion.harmonics
    if motion.file:
        return
    if MIN_SAMPLES_PER_PERIOD * fastest > rate:
        raise ExperimentError(
            f"a motion of up to {fastest:g} Hz (motion.fundamental times motion.harmonics) is too "
            f"fast for measurement.rate = {rate:g} Hz"
        )
    periods = fastest * motion.duration
    if periods < MIN_PERIODS:
        raise ExperimentError(
            f"motion.duration = {motion.duration:g} s is {periods:.2g} of a period of the fastest "
            "harmonic (motion.fundamental times motion.harmonics): the robot would hardly move"
        )
