"""From an experiment to the most informative motion: designed, proven, predicted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.blas import one_blas_thread
from testbed.codec import encode
from testbed.diagnostics.diagnostic import Diagnosed, Diagnostic, diagnose
from testbed.errors import ExperimentError, TestbedError, few
from testbed.excitation.design import Design, Watch, Wish, design
from testbed.excitation.fourier import Fourier
from testbed.excitation.information import Pipeline, Prediction, information_of, models_of, predict
from testbed.excitation.proof import Rules
from testbed.excitation.samples import SampledRows
from testbed.experiment.evaluate import robot_of
from testbed.experiment.experiment import Experiment
from testbed.experiment.motions import motion_of, plate_noise_of, rules_of
from testbed.identification.regression.filters import motion_taps, reversal_samples, row_weights
from testbed.parameters.minimal_set import minimal_set
from testbed.parameters.rules import Model
from testbed.robot.tree import Tree

QUIET_TORQUE = 0.5
"""Noise assumed of joint torques that have none [N m or N]."""

FEWEST = 3
"""Harmonics of a motion worth searching."""


@dataclass(frozen=True, eq=False)
class Excitation(Diagnosed):
    """A designed motion beside a random one.

    Attributes:
        experiment: What it was made for.
        tree: The robot.
        rules: What it respects.
        design: The motion and its proof.
        predicted: What it promises.
        random: The motion that the experiment would run otherwise; None where there is none.
        random_predicted: What that promises.
    """

    experiment: Experiment
    tree: Tree
    rules: Rules
    design: Design
    predicted: Prediction
    random: Fourier | None
    random_predicted: Prediction | None

    def document(self) -> dict[str, Any]:
        """For programs: what was designed, what it promises, what a random motion would."""
        motion, random = self.design.motion, self.random_predicted
        return {
            "fundamental": motion.fundamental,
            "harmonics": motion.harmonics,
            "criterion": self.experiment.excitation.criterion,
            "value": self.design.value,
            "complete": self.design.complete,
            "searches": [encode(search) for search in self.design.searches],
            "predicted": encode(self.predicted),
            "random": None if random is None else encode(random),
            "gain": self.gain,
            "diagnostics": [encode(each) for each in self.diagnostics],
            "proof": encode(self.design.proof),
        }

    @property
    def gain(self) -> float | None:
        """How many times smaller the rms of relative sigmas is than the random motion's.

        None where there is no random motion, or one that does not identify all parameters.
        """
        if self.random_predicted is None or not np.isfinite(self.random_predicted.rms):
            return None
        return self.random_predicted.rms / self.predicted.rms

    @property
    def beside_random(self) -> str:
        """The gain in words."""
        origin = f"the best of {self.experiment.motion.candidates} random motions"
        if self.random_predicted is None:
            return "no random motion within the limits was found for comparison"
        if self.gain is None:
            return f"{origin} does not identify all parameters"
        theirs = self.random_predicted.rms
        return f"{self.gain:.2f} times smaller than that of {origin} ({theirs:.2%})"

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Parameters that the motion hardly excites."""
        poor = [
            name
            for name, relative in zip(self.predicted.names, self.predicted.relative, strict=True)
            if relative > 1
        ]
        return (diagnose("motion.uncertain", few(poor)),) if poor else ()


def excite(
    experiment: Experiment,
    watch: Watch = lambda done, total, best: None,
    prior: Array | None = None,
    interrupted: Callable[[], bool] = lambda: False,
) -> Excitation:
    """Design the motion of an experiment.

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
    tree = robot_of(experiment)
    wish = wish_of(experiment, tree, prior)
    pipeline = pipeline_of(experiment)
    one_sample = np.sqrt(pipeline.rate * pipeline.span)

    def relative(done: int, total: int, best: float) -> None:
        watch(done, total, float(np.exp(best / 2) / one_sample))

    with one_blas_thread():
        found = design(wish, relative, interrupted)
        forecast = _forecaster(experiment, wish)
        random = _random(experiment, tree, wish.rules)
        return Excitation(
            experiment=experiment,
            tree=tree,
            rules=wish.rules,
            design=found,
            predicted=forecast(found.motion),
            random=random,
            random_predicted=None if random is None else forecast(random),
        )


def pipeline_of(experiment: Experiment) -> Pipeline:
    """What the experiment's estimates make of its recording."""
    rate = experiment.measurement.rate
    settings = experiment.identification.fitted(rate)
    sensed = experiment.measurement.senses_kinematics
    taps = 1 if sensed else motion_taps(rate, settings.position_low_pass).shape[1]
    weights = row_weights(rate, settings.row_low_pass)
    reach = taps // 2 + len(weights) // 2
    return Pipeline(
        rate=rate,
        span=max(experiment.motion.duration - 2 * reach / rate, 1 / rate),
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
    lowest = max(table.lowest_frequency, 1 / duration)
    found = []
    for multiple in (2, 1, 4):  # faster ones are more informative, slower ones are richer
        fundamental = multiple * lowest
        harmonics = min(table.harmonics, int(table.highest_frequency / fundamental * (1 + 1e-9)))
        if harmonics >= min(FEWEST, table.harmonics):
            found.append((fundamental, harmonics))
    if not found:
        raise ExperimentError(
            f"no motion of {FEWEST} harmonics repeats at {lowest:g} Hz or more, at least once in "
            f"motion.duration = {duration:g} s, and stays below excitation.highest_frequency = "
            f"{table.highest_frequency:g} Hz; raise that, or the duration"
        )
    return tuple(found)


def wish_of(experiment: Experiment, tree: Tree, prior: Array | None = None) -> Wish:
    """What an experiment asks of a design.

    Args:
        experiment: Says so in `excitation` and other tables.
        tree: Its robot.
        prior: Covariance of the minimal parameters from an earlier estimate, (N, N).

    Raises:
        ExperimentError: The band holds no motion.
    """
    rules = rules_of(experiment, tree, designed=True)
    rows = _rows(experiment, tree, rules)
    table, pipeline = experiment.excitation, pipeline_of(experiment)
    torque = experiment.measurement.torque_noise or QUIET_TORQUE
    information = information_of(
        tree,
        rows,
        table.instrument,
        plate_noise_of(experiment),
        np.full(tree.n, torque),
        table.criterion,
        prior,
    )
    share = 1 / (pipeline.rate * pipeline.span)  # of one sample
    information = replace(information, prior=information.prior * share)
    seconds = np.inf if table.seconds is None else table.seconds
    frequencies = frequencies_of(experiment)
    return Wish(rules, information, rows, frequencies, table.starts, seconds, experiment.seed)


def _rows(experiment: Experiment, tree: Tree, rules: Rules) -> dict[Model, SampledRows]:
    """Rows that the criterion and the limits look at."""
    wanted: set[Model] = {"reaction", *models_of(experiment.excitation.instrument)}
    if np.isfinite(rules.limits.effort).any():
        wanted.add("dynamic")
    zeros = experiment.identification.zeros
    order: tuple[Model, ...] = ("reaction", "dynamic")
    return {m: SampledRows(tree, minimal_set(tree, m, zeros=zeros)) for m in order if m in wanted}


def _forecaster(experiment: Experiment, wish: Wish) -> Callable[[Fourier], Prediction]:
    joints = experiment.excitation.instrument == "joints"
    names = wish.rows["dynamic" if joints else "reaction"].minimal.names
    pipeline = pipeline_of(experiment)

    def forecast(motion: Fourier) -> Prediction:
        return predict(wish.information, wish.rows, motion, pipeline, names)

    return forecast


def _random(experiment: Experiment, tree: Tree, rules: Rules) -> Fourier | None:
    """What the experiment would run without a design."""
    motion = experiment.motion.model_copy(update={"file": ""})
    try:
        return motion_of(experiment.model_copy(update={"motion": motion}), tree, rules)
    except TestbedError:
        return None
