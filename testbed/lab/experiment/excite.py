"""Excitation design of an experiment: problem, filters and frequencies from its tables."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import ExperimentError, TestbedError
from testbed.core.base.stages import ignore_progress
from testbed.core.estimation.regression.windows import (
    motion_taps,
    reversal_samples,
    row_weights,
)
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.parameters.rules import Signal
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.motions import experiment_motion, plate_noise_of, rules_of
from testbed.lab.experiment.rig import robot_of
from testbed.motion.design import DesignProblem, SearchCallback
from testbed.motion.excite import Excitation
from testbed.motion.excite import excite as excite_robot
from testbed.motion.fourier import Fourier
from testbed.motion.information import (
    SignalProcessing,
    information_of,
    signals_of_instrument,
)
from testbed.motion.proof import MotionConstraints
from testbed.motion.samples import SampledRows

DEFAULT_TORQUE_NOISE = 0.5
"""Noise assumed of joint torques that are simulated without noise [N m or N]."""

MIN_PERIODS = 2
"""Smallest number of periods of a motion in a recording.

The part of the residuals that repeats in every period is a model error.
"""

MIN_HARMONICS = 3
"""Smallest number of harmonics of a motion worth searching."""


def excite(
    experiment: Experiment,
    watch: SearchCallback = ignore_progress,
    prior: Array | None = None,
    interrupted: Callable[[], bool] = lambda: False,
) -> Excitation:
    """Design an experiment's excitation trajectory, and compare it with a random motion.

    The random motion is the one that the experiment uses without a design.

    Args:
        experiment: Criterion and limits in `excitation`, duration in `motion`, sensors in
            `measurement`, filters in `identification`.
        watch: Called after every search step, with the best relative standard deviation so far.
        prior: Covariance of the minimal parameters from an earlier estimate, (N, N).
        interrupted: Called after every step; if it returns True, the search ends and the best
            motion so far is returned.

    Raises:
        InfeasibleMotion: No motion inside the limits was found.
        ExperimentError: No motion fits the frequency band.
    """
    problem = design_problem(experiment, prior)
    random = _random_motion(experiment, problem.rules)
    return excite_robot(
        problem, random, experiment.motion.candidates, watch, interrupted
    )


def _random_motion(experiment: Experiment, rules: MotionConstraints) -> Fourier | None:
    """Best random motion of the experiment; None if no random motion respects the limits."""
    try:
        return experiment_motion(
            experiment.with_(motion={"file": ""}), rules.tree, rules
        )
    except TestbedError:
        return None


def design_problem(experiment: Experiment, prior: Array | None = None) -> DesignProblem:
    """Design problem of an experiment: limits, information, filters and frequencies.

    Args:
        experiment: Criterion and limits in `excitation`, and the other tables.
        prior: Covariance of the minimal parameters from an earlier estimate, (N, N).

    Raises:
        ExperimentError: No motion fits the frequency band, or `excitation.instrument` is not the
            plate while `robot.sensor` names a force sensor.
    """
    tree, table, sensor = (
        robot_of(experiment),
        experiment.excitation,
        experiment.robot.sensor,
    )
    if sensor and table.instrument != "plate":
        raise ExperimentError(
            f"robot.sensor = {sensor!r} is designed for by its own rows alone: leave "
            'excitation.instrument "plate", or drop robot.sensor'
        )
    rules = rules_of(experiment, tree, designed=True)
    rows, filters = _sampled_rows(experiment, rules), pipeline_of(experiment)
    information = information_of(
        rows,
        table.instrument,
        plate_noise_of(experiment),
        np.full(tree.n, experiment.measurement.torque_noise or DEFAULT_TORQUE_NOISE),
        table.criterion,
        None if prior is None else filters.samples * prior,  # as much as of one sample
    )
    frequencies = frequencies_of(experiment)
    return DesignProblem(
        rules, information, rows, filters, frequencies, table.starts, experiment.seed
    )


def pipeline_of(experiment: Experiment) -> SignalProcessing:
    """Filters applied in an experiment's identification, with the filtered recording length."""
    instrument, seconds = experiment.measurement, experiment.motion.duration
    return pipeline(
        instrument.rate,
        seconds,
        experiment.identification,
        sensed=instrument.senses_kinematics,
    )


def pipeline(
    rate: float, seconds: float, settings: Settings = DEFAULTS, *, sensed: bool = False
) -> SignalProcessing:
    """Filters applied in an identification, with the filtered recording length.

    The length excludes the samples at either end that the position filter and the row filter
    remove. The guard time is the time around a velocity reversal in which filtered rows are
    affected by it.

    Args:
        rate: Sampling rate [Hz].
        seconds: Length of the recording [s].
        settings: Cutoff frequencies and deadband of the estimate.
        sensed: True if velocities and accelerations are measured.
    """
    settings = settings.fitted(rate)
    taps = 1 if sensed else motion_taps(rate, settings.position_low_pass).shape[1]
    weights = row_weights(rate, settings.row_low_pass)
    lost_samples = 2 * (taps // 2 + len(weights) // 2)
    return SignalProcessing(
        rate=rate,
        duration=max(seconds - lost_samples / rate, 1 / rate),
        band=settings.row_low_pass or np.inf,
        min_speed=settings.deadband,
        guard_time=reversal_samples(weights, settings.reversal_reach, rate) / rate,
    )


def frequencies_of(experiment: Experiment) -> tuple[tuple[float, int], ...]:
    """Fundamental frequencies [Hz] and numbers of harmonics that the design may use.

    The fundamental is twice, once or four times the lowest frequency at which the motion repeats
    `MIN_PERIODS` times. Each is combined with as many harmonics as the highest frequency allows,
    and dropped if there are fewer than `MIN_HARMONICS`.

    Args:
        experiment: Frequency band in `excitation`, duration in `motion`.

    Raises:
        ExperimentError: No motion fits the band and the duration.
    """
    table, duration = experiment.excitation, experiment.motion.duration
    lowest = max(table.lowest_frequency, MIN_PERIODS / duration)
    frequencies = []
    # faster motions are more informative, slower motions have more harmonics
    for multiple in (
        2,
        1,
        4,
    ):
        fundamental = multiple * lowest
        harmonics = min(
            table.harmonics, int(table.highest_frequency / fundamental * (1 + 1e-9))
        )
        if harmonics >= min(MIN_HARMONICS, table.harmonics):
            frequencies.append((fundamental, harmonics))
    if not frequencies:
        raise ExperimentError(
            f"no motion of {MIN_HARMONICS} harmonics repeats at {lowest:g} Hz or more, "
            f"{MIN_PERIODS} times in motion.duration = {duration:g} s, and stays below "
            f"excitation.highest_frequency = {table.highest_frequency:g} Hz; "
            "raise that, or the duration"
        )
    return tuple(frequencies)


def _sampled_rows(
    experiment: Experiment, rules: MotionConstraints
) -> dict[Signal, SampledRows]:
    """Sampled regressor rows for the design criterion and the limits, keyed by signal.

    The signals are the wrench, the signals of `excitation.instrument`, and the torques if efforts
    are limited. With `robot.sensor`, the wrench is that of the links beyond the force sensor.
    """
    tree, zeros = rules.tree, experiment.identification.zeros
    signals: list[Signal] = [
        "wrench",
        *signals_of_instrument(experiment.excitation.instrument),
    ]
    if np.isfinite(rules.limits.effort).any():
        signals.append("torque")
    rows = {
        m: SampledRows(tree, minimal_set(tree, m, zeros=zeros))
        for m in dict.fromkeys(signals)
    }
    if experiment.robot.sensor:
        part = experiment.sensed_part(tree)
        joints = [tree.index(name) for name in part.names]
        rows["wrench"] = SampledRows(part, minimal_set(part, "wrench"), joints)
    return rows
