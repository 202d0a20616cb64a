"""What a run is expected to cost, before anything has run: for planning, roughly."""

from __future__ import annotations

from testbed.experiment.experiment import Experiment

FIXED = 0.3
"""Seconds of reading the robot, choosing a motion, building the plant."""

PER_SAMPLE, PER_STEP, PER_CANDIDATE = 30e-6, 12e-6, 0.004
"""Seconds of a sample, an integration step (three joints), a random motion that is drawn."""

ROW_BYTES = 1500
"""Of a run in the table."""

SAMPLE_BYTES = 250
"""Of a sample in a recording of three joints that is kept."""


def seconds_of(experiment: Experiment) -> float:
    """CPU time of a run [s], simulation and identification."""
    motion, measurement = experiment.motion, experiment.measurement
    time = motion.duration + experiment.simulation.warm_up
    steps = time / experiment.simulation.step
    drawn = 0 if motion.file else motion.candidates
    work = PER_SAMPLE * time * measurement.rate + PER_STEP * steps
    return FIXED + work + PER_CANDIDATE * drawn


def bytes_of(experiment: Experiment, *, keeps: bool) -> float:
    """Place on disk that a run takes.

    Args:
        experiment: Of the run.
        keeps: Whether its recording is kept.
    """
    samples = experiment.motion.duration * experiment.measurement.rate
    return ROW_BYTES + (SAMPLE_BYTES * samples if keeps else 0.0)
