"""Design of an experiment's motion: its tables turned into the values that a design takes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import ExperimentError, TestbedError
from testbed.core.base.stages import unreported
from testbed.core.estimation.regression.windows import (
    motion_taps,
    reversal_samples,
    row_weights,
)
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.parameters.rules import Model
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.motions import motion_of, plate_noise_of, rules_of
from testbed.lab.experiment.rig import robot_of
from testbed.motion.design import DesignProblem, Watch
from testbed.motion.excite import Excitation
from testbed.motion.excite import excite as excite_robot
from testbed.motion.fourier import Fourier
from testbed.motion.information import Pipeline, information_of, models_of
from testbed.motion.proof import Rules
from testbed.motion.samples import SampledRows

QUIET_TORQUE = 0.5
"""Noise assumed of joint torques that have none [N m or N]."""

PERIODS = 2
"""Periods of a motion, at least: what repeats of the residuals is an error of the model."""

FEWEST = 3
"""Harmonics of a motion worth searching."""


def excite(
    experiment: Experiment,
    watch: Watch = unreported,
    prior: Array | None = None,
    interrupted: Callable[[], bool] = lambda: False,
) -> Excitation:
    """Design the motion of an experiment, beside the random one that it would run otherwise.

    Args:
        experiment: Says in `excitation` what is wanted, in `motion`, `measurement` and
            `identification` for which instrument.
        watch: Called after every step of a search, with the relative sigma of the best.
        prior: Covariance of the minimal parameters from an earlier estimate, (N, N).
        interrupted: Asked after every step whether to go on with what there is.

    Raises:
        InfeasibleMotion: No motion inside the limits was found.
        ExperimentError: The band holds no motion.
    """
    problem = design_problem(experiment, prior)
    random = _random(experiment, problem.rules)
    return excite_robot(
        problem, random, experiment.motion.candidates, watch, interrupted
    )


def _random(experiment: Experiment, rules: Rules) -> Fourier | None:
    """What the experiment would run without a design."""
    try:
        return motion_of(experiment.with_(motion={"file": ""}), rules.tree, rules)
    except TestbedError:
        return None


def design_problem(experiment: Experiment, prior: Array | None = None) -> DesignProblem:
    """The design that an experiment asks for, as plain values.

    Args:
        experiment: Says so in `excitation` and other tables.
        prior: Covariance of the minimal parameters from an earlier estimate, (N, N).

    Raises:
        ExperimentError: The band holds no motion, or the instruments do not show what is wanted.
    """
    tree, table, about = (
        robot_of(experiment),
        experiment.excitation,
        experiment.robot.sensor,
    )
    if about and table.instrument != "plate":
        raise ExperimentError(
            f"robot.sensor = {about!r} is designed for by its own rows alone: leave "
            'excitation.instrument "plate", or drop robot.sensor'
        )
    rules = rules_of(experiment, tree, designed=True)
    rows, filters = _rows(experiment, rules), pipeline_of(experiment)
    information = information_of(
        rows,
        table.instrument,
        plate_noise_of(experiment),
        np.full(tree.n, experiment.measurement.torque_noise or QUIET_TORQUE),
        table.criterion,
        None if prior is None else filters.samples * prior,  # as much as of one sample
    )
    frequencies = frequencies_of(experiment)
    return DesignProblem(
        rules, information, rows, filters, frequencies, table.starts, experiment.seed
    )


def pipeline_of(experiment: Experiment) -> Pipeline:
    """What the experiment's estimates make of its recording."""
    how, seconds = experiment.measurement, experiment.motion.duration
    return pipeline(
        how.rate, seconds, experiment.identification, sensed=how.senses_kinematics
    )


def pipeline(
    rate: float, seconds: float, settings: Settings = DEFAULTS, *, sensed: bool = False
) -> Pipeline:
    """Filters of an estimate, and how much of a recording they leave.

    Args:
        rate: Samples a second [Hz].
        seconds: Length of the recording [s].
        settings: How the estimate is made.
        sensed: Whether velocities and accelerations are measured.
    """
    settings = settings.fitted(rate)
    taps = 1 if sensed else motion_taps(rate, settings.position_low_pass).shape[1]
    weights = row_weights(rate, settings.row_low_pass)
    lost = 2 * (taps // 2 + len(weights) // 2)
    return Pipeline(
        rate=rate,
        span=max(seconds - lost / rate, 1 / rate),
        band=settings.row_low_pass or np.inf,
        resting=settings.deadband,
        reach=reversal_samples(weights, settings.reversal_reach, rate) / rate,
    )


def frequencies_of(experiment: Experiment) -> tuple[tuple[float, int], ...]:
    """Fundamentals and numbers of harmonics that are allowed.

    Args:
        experiment: Says the band in `excitation`, the duration in `motion`.

    Raises:
        ExperimentError: There are none.
    """
    table, duration = experiment.excitation, experiment.motion.duration
    lowest = max(table.lowest_frequency, PERIODS / duration)
    found = []
    # faster ones are more informative, slower ones are richer
    for multiple in (
        2,
        1,
        4,
    ):
        fundamental = multiple * lowest
        harmonics = min(
            table.harmonics, int(table.highest_frequency / fundamental * (1 + 1e-9))
        )
        if harmonics >= min(FEWEST, table.harmonics):
            found.append((fundamental, harmonics))
    if not found:
        raise ExperimentError(
            f"no motion of {FEWEST} harmonics repeats at {lowest:g} Hz or more, {PERIODS} times in "
            f"motion.duration = {duration:g} s, and stays below excitation.highest_frequency = "
            f"{table.highest_frequency:g} Hz; raise that, or the duration"
        )
    return tuple(found)


def _rows(experiment: Experiment, rules: Rules) -> dict[Model, SampledRows]:
    """Rows that the criterion and the limits look at."""
    tree, zeros = rules.tree, experiment.identification.zeros
    wanted: list[Model] = ["reaction", *models_of(experiment.excitation.instrument)]
    if np.isfinite(rules.limits.effort).any():
        wanted.append("dynamic")
    found = {
        m: SampledRows(tree, minimal_set(tree, m, zeros=zeros))
        for m in dict.fromkeys(wanted)
    }
    if experiment.robot.sensor:
        seen = experiment.sensed(tree)
        joints = [tree.index(name) for name in seen.names]
        found["reaction"] = SampledRows(seen, minimal_set(seen, "reaction"), joints)
    return found
