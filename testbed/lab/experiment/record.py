"""Record an experiment: choose its motion, simulate its rig."""

from __future__ import annotations

from testbed.core.base.errors import ExperimentError
from testbed.core.base.stages import Progress, unreported
from testbed.core.recordings.recording import Recording
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.motions import FAST, motion_of, rules_of
from testbed.lab.experiment.rig import rig_of
from testbed.lab.experiment.simulate import simulate
from testbed.lab.simulation.effect import StepForces
from testbed.lab.simulation.rollout import Watch
from testbed.motion.fourier import Fourier
from testbed.motion.rest_to_rest import RestToRest, rest_to_rest

LEAST_PERIODS = 0.1
"""Least part of the fastest harmonic's period that is a motion."""


def record(
    experiment: Experiment,
    progress: Progress = unreported,
    watch: Watch = unreported,
    forces: StepForces | None = None,
    installed: int | None = None,
    motion: Fourier | None = None,
) -> Recording:
    """Simulate the robot of an experiment along its motion.

    Args:
        experiment: What to do.
        progress: Called with samples done and samples in all.
        watch: Called with what happens while it is simulated, a second or so at a time.
        forces: On the joints, besides those of the experiment, asked before every step.
        installed: Seed of signs and phases that sensors keep; default the experiment's.
        motion: In place of the experiment's.

    Raises:
        TestbedError: It cannot be carried out as written.
    """
    table = experiment.motion
    rig = rig_of(experiment)
    rig.steps(table.duration)  # refuses before any work
    experiment.sensed(rig.robot)
    _check_motion(experiment)
    motion = motion or motion_of(experiment, rig.true_robot)
    course: Fourier | RestToRest = motion
    if table.at_rest:
        rules = rules_of(experiment, rig.true_robot, designed=bool(table.file))
        course = rest_to_rest(motion, rules, table.duration)
    return simulate(
        rig,
        course,
        table.duration,
        experiment.seed,
        progress=progress,
        watch=watch,
        forces=forces,
        installed=installed,
    )


def _check_motion(experiment: Experiment) -> None:
    """Whether random motions fit rate and duration.

    Raises:
        ExperimentError: They do not.
    """
    motion, rate = experiment.motion, experiment.measurement.rate
    fastest = motion.fundamental * motion.harmonics
    if motion.file:
        return
    if FAST * fastest > rate:
        raise ExperimentError(
            f"a motion of up to {fastest:g} Hz (motion.fundamental times motion.harmonics) is too "
            f"fast for measurement.rate = {rate:g} Hz"
        )
    periods = fastest * motion.duration
    if periods < LEAST_PERIODS:
        raise ExperimentError(
            f"motion.duration = {motion.duration:g} s is {periods:.2g} of a period of the fastest "
            "harmonic (motion.fundamental times motion.harmonics): the robot would hardly move"
        )
