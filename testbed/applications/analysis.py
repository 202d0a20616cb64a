"""Analysis of a recording: estimates by every signal, the model file as prior, bodies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from numpy.typing import ArrayLike

from testbed.bodies.consistency.consistent import Consistent, consistent
from testbed.bodies.consistency.held_out import beside_consistent, with_likely_error
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.linear_prior import bodies_prior
from testbed.bodies.model_average import REFERENCE
from testbed.bodies.posterior import Posterior, posterior, rows_of
from testbed.bodies.prior import Prior, prior_of
from testbed.bodies.row_products import RowParts
from testbed.core.base.errors import RecordingError, TestbedError, UnseenParameters
from testbed.core.base.stages import Progress, unreported
from testbed.core.estimation.estimate import METHODS, Estimate, Method
from testbed.core.estimation.identify import estimate_of
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.sensor.correction import CalibrationCovariance
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.recordings.source import RecordingLike, open_source
from testbed.core.recordings.views import is_imported, with_gear
from testbed.core.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class Analysis:
    """What one recording says of a robot.

    Attributes:
        estimates: By method; only those that the data determine.
        failures: Why a method has no estimate.
        posterior: Estimates with the model file's bodies as prior, of an imported recording.
        bodies: Physically consistent bodies; None where they were not asked for, or failed.
        bodies_failure: Why they failed.
    """

    estimates: Mapping[Method, Estimate]
    failures: Mapping[Method, RecordingError | UnseenParameters]
    posterior: Mapping[Method, Posterior] = field(default_factory=dict)
    bodies: Consistent | None = None
    bodies_failure: TestbedError | None = None


def analyse(
    tree: Tree,
    recording: RecordingLike,
    settings: Settings = DEFAULTS,
    *,
    methods: Iterable[Method] = METHODS,
    gravity: ArrayLike | None = None,
    doubt: CalibrationCovariance | None = None,
    prior_error: float | None = None,
    bodies: tuple[Prior, ConsistencyOptions] | None = None,
    threads: int | None = None,
    progress: Progress = unreported,
) -> Analysis:
    """Identify by several signals of a recording, which is prepared once for each of them.

    Args:
        tree: The robot.
        recording: As for `identify`.
        settings: As for `identify`.
        methods: Which estimates to make; of a part beyond a force sensor none by torques.
        gravity: As for `identify`.
        doubt: About the plate by which the recording was corrected.
        prior_error: Of the model file's bodies, as for `posterior`.
        bodies: Prior and conditions of consistent bodies; None for none.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all, method by method.
    """
    estimates: dict[Method, Estimate] = {}
    failures: dict[Method, RecordingError | UnseenParameters] = {}
    rows: dict[Method, RowParts] = {}
    posteriors: dict[Method, Posterior] = {}
    for method in methods:
        if tree.is_part and method == "internal":
            continue
        try:
            problem = Problem.of(
                tree,
                recording,
                method,
                settings,
                gravity=gravity,
                threads=threads,
                progress=progress,
            )
            known = None
            if is_imported(problem.source):
                known = bodies_prior(problem, prior_of(problem.tree), REFERENCE)
            problem, estimates[method] = estimate_of(problem, doubt, known)
        except RecordingError as error:
            failures[method] = error
            continue
        except UnseenParameters as error:
            failures[method] = error
        if is_imported(problem.source):
            own = estimates.get(method)
            rows[method] = rows_of(problem, own)
            file = prior_of(problem.tree)
            posteriors[method] = posterior(
                rows[method], file, own, prior_error=prior_error
            )
    if bodies is None or not (estimates or posteriors):
        return Analysis(estimates, failures, posteriors)
    prior, options = bodies
    options = with_likely_error(options, posteriors.values())
    try:
        robot = with_gear(tree, open_source(recording))
        found = consistent(robot, list(estimates.values()), prior, options)
    except TestbedError as error:
        return Analysis(estimates, failures, posteriors, bodies_failure=error)
    beside = beside_consistent(posteriors, found, rows, prior, estimates, options)
    return Analysis(estimates, failures, beside, found)
