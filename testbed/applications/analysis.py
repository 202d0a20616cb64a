"""Analysis of a recording: estimates by each signal, posterior with the model file, bodies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from numpy.typing import ArrayLike

from testbed.bodies.consistency.consistent import Consistent, consistent
from testbed.bodies.consistency.held_out import (
    with_consistent_predictions,
    with_estimated_prior_error,
)
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.linear_prior import bodies_prior
from testbed.bodies.model_average import REFERENCE_PRIOR_ERROR
from testbed.bodies.posterior import Posterior, compute_posterior, corrected_row_parts
from testbed.bodies.prior import PriorBodies, prior_of
from testbed.bodies.row_products import RowParts
from testbed.core.base.errors import (
    RecordingError,
    TestbedError,
    UnidentifiableParameters,
)
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.identify import identify_problem
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.sensor.correction import CalibrationCovariance
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.source import RecordingLike, open_source
from testbed.core.recordings.views import is_imported, with_gear_shafts
from testbed.core.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class Analysis:
    """Estimates of a robot's parameters made from one recording.

    Attributes:
        estimates: Least-squares estimates keyed by signal ("wrench", "torque"); only for signals
            that determine the parameters.
        failures: Errors keyed by signal, for requested signals without an estimate.
        posterior: Estimates with the model file's bodies as prior, keyed by signal. They exist for
            imported recordings only, and then also for signals whose data leave some parameters
            undetermined.
        bodies: Physically consistent bodies fitted to all estimates together; None if not
            requested, if there is no estimate, or if the fit failed.
        bodies_failure: Error of the fit of consistent bodies; None if the fit succeeded or was not
            attempted.
    """

    estimates: Mapping[Signal, Estimate]
    failures: Mapping[Signal, RecordingError | UnidentifiableParameters]
    posterior: Mapping[Signal, Posterior] = field(default_factory=dict)
    bodies: Consistent | None = None
    bodies_failure: TestbedError | None = None


def analyse(
    tree: Tree,
    recording: RecordingLike,
    settings: Settings = DEFAULTS,
    *,
    methods: Iterable[Signal] = SIGNALS,
    gravity: ArrayLike | None = None,
    doubt: CalibrationCovariance | None = None,
    prior_error: float | None = None,
    bodies: tuple[PriorBodies, ConsistencyOptions] | None = None,
    threads: int | None = None,
    progress: Progress = ignore_progress,
) -> Analysis:
    """Identify a robot from each requested signal, then fit posteriors and consistent bodies.

    A `RecordingError`, an `UnidentifiableParameters` error, or an error of the fit of bodies is
    stored in the result, not raised. Posteriors are computed for imported recordings only.

    Args:
        tree: The robot.
        recording: As for `identify`.
        settings: As for `identify`.
        methods: Signals from which estimates are made. "torque" is skipped if `tree` contains only
            the links beyond a force sensor.
        gravity: As for `identify`.
        doubt: Covariance of the plate's calibration with which the recording was corrected.
        prior_error: Relative error assumed for the model file's bodies, as for `posterior`.
        bodies: Prior and options of the fit of physically consistent bodies; None for no such fit.
        threads: Number of threads; default one per processor.
        progress: Called with the numbers of processed samples and of all samples, for each signal
            in turn.
    """
    estimates: dict[Signal, Estimate] = {}
    failures: dict[Signal, RecordingError | UnidentifiableParameters] = {}
    rows: dict[Signal, RowParts] = {}
    posteriors: dict[Signal, Posterior] = {}
    for method in methods:
        if tree.is_part and method == "torque":
            continue
        try:
            problem = Problem.from_recording(
                tree,
                recording,
                method,
                settings,
                gravity=gravity,
                threads=threads,
                progress=progress,
            )
            prior_bodies = None
            if is_imported(problem.source):
                prior_bodies = bodies_prior(
                    problem, prior_of(problem.tree), REFERENCE_PRIOR_ERROR
                )
            problem, estimates[method] = identify_problem(problem, doubt, prior_bodies)
        except RecordingError as error:
            failures[method] = error
            continue
        except UnidentifiableParameters as error:
            failures[method] = error
        if is_imported(problem.source):
            estimate = estimates.get(method)
            rows[method] = corrected_row_parts(problem, estimate)
            model_prior = prior_of(problem.tree)
            posteriors[method] = compute_posterior(
                rows[method], model_prior, estimate, prior_error=prior_error
            )
    if bodies is None or not (estimates or posteriors):
        return Analysis(estimates, failures, posteriors)
    prior, options = bodies
    options = with_estimated_prior_error(options, posteriors.values())
    try:
        robot = with_gear_shafts(tree, open_source(recording))
        consistent_bodies = consistent(robot, list(estimates.values()), prior, options)
    except TestbedError as error:
        return Analysis(estimates, failures, posteriors, bodies_failure=error)
    completed = with_consistent_predictions(
        posteriors, consistent_bodies, rows, prior, estimates, options
    )
    return Analysis(estimates, failures, completed, consistent_bodies)
