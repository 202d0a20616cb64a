"""Identify the minimal parameters from a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.diagnostics import (
    Diagnostic,
    messages,
    of_instrument,
    ordered,
)
from testbed.core.base.errors import RecordingError, SettingsError, UnseenParameters
from testbed.core.base.gaussian import Gaussian
from testbed.core.base.stages import Progress, stage
from testbed.core.estimation.diagnostics.diagnosis import diagnostics, quality
from testbed.core.estimation.diagnostics.model_errors import (
    model_error_diagnostics,
    repetition,
)
from testbed.core.estimation.diagnostics.residuals import noisy, zero_unknown
from testbed.core.estimation.diagnostics.setup import (
    regrouped_rotors,
    setup_diagnostics,
)
from testbed.core.estimation.estimate import Estimate, Method, channel_units, sensor_of
from testbed.core.estimation.model_errors.model_errors import (
    ModelErrors,
    WithoutModelErrors,
    find_model_errors,
)
from testbed.core.estimation.model_errors.repetition import repeatable_error
from testbed.core.estimation.noise.coloured_noise import (
    GlsFit,
    bootstrap,
    generalized_least_squares,
)
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.solvers import noise_weights, solve
from testbed.core.estimation.selection.held_out import TermChoice
from testbed.core.estimation.selection.position_filter import with_position_filter
from testbed.core.estimation.selection.term_choice import (
    with_all_terms,
    with_fewer_terms,
)
from testbed.core.estimation.sensor.correction import CalibrationCovariance
from testbed.core.estimation.sensor.sensor_model import (
    LinearFit,
    SensorModel,
    gauss_newton,
)
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.source import RecordingLike, Source
from testbed.core.robot.tree import Tree, require_tree
from testbed.sensors.corrected import corrected
from testbed.sensors.errors.plate_bias import PlateBias


def identify(
    tree: Tree,
    recording: RecordingLike,
    method: Method | Signal = "wrench",
    *,
    terms: str | Sequence[str] = (),
    zeros: bool | Sequence[str] | None = None,
    gravity: ArrayLike | None = None,
    settings: Settings = DEFAULTS,
    doubt: CalibrationCovariance | None = None,
    threads: int | None = None,
    progress: Progress = lambda done, total: None,
) -> Estimate:
    """Minimal parameters from encoder positions and one kind of force measurement.

    A few passes over the samples, in constant memory; the same to the bit for any number of
    threads and wherever the samples come from.

    Args:
        tree: The robot; its inertias are not used, except for `zeros`.
        recording: In memory, or a Parquet file's path, or parts in the order of time.
            Columns are matched by joint name; its truth is not read.
        method: "wrench": the plate's, six rows a sample. "torque": the joints', a row a joint.
        terms: Unknowns besides the bodies' parameters: errors of the plate by the names that a rig
            has for them, as "plate_bias", "plate_pose"; or laws of the joints' torques, as
            "coulomb", "viscous" (docs/identification.md). Default those of `settings`.
        zeros: In place of `settings.zeros`.
        gravity: (3,) [m/s^2], bedplate frame; default the recording's, if it says, else
            the model file's.
        settings: How the signals are treated; default those of `Settings()`.
        doubt: About the plate by which the recording was corrected: sigma counts it.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all.

    Raises:
        RecordingError: The recording is of another robot, too short, lacks what the method
            needs, or holds what is no measurement.
        UnseenParameters: The data cannot distinguish some parameters; names them.
    """
    require_tree(tree, "identify(robot, data)")
    if zeros is not None:
        settings = replace(settings, zeros=zeros)
    settings = settings.with_unknowns(terms)
    problem = Problem.of(
        tree,
        recording,
        method,
        settings,
        gravity=gravity,
        threads=threads,
        progress=progress,
    )
    return estimate_of(problem, doubt)[1]


def estimate_of(
    problem: Problem,
    doubt: CalibrationCovariance | None = None,
    prior: Gaussian | None = None,
) -> tuple[Problem, Estimate]:
    """Estimate of a problem, and the problem with the terms and the filter that data chose.

    Args:
        problem: Robot, recording and method.
        doubt: As for `identify`.
        prior: Of the bodies' parameters, beside which model errors are sought; None for none.

    Raises:
        RecordingError: As `identify`.
        UnseenParameters: As `identify`.
    """
    problem, choice, chosen = prepare(problem)
    try:
        estimate = _estimate_of(problem, doubt)
    except UnseenParameters:
        fewer = with_fewer_terms(problem)
        if fewer.names == problem.names:
            raise
        problem, estimate = fewer, _estimate_of(fewer, doubt)
    problem, estimate = _beside_model_errors(problem, estimate, doubt, prior)
    estimate = _with_repetition(problem, estimate)
    diagnostics = of_instrument(
        [*estimate.diagnostics, *chosen], sensor_of(problem.tree)
    )
    return problem, replace(estimate, choice=choice, diagnostics=diagnostics)


def _beside_model_errors(
    problem: Problem,
    estimate: Estimate,
    doubt: CalibrationCovariance | None,
    prior: Gaussian | None,
) -> tuple[Problem, Estimate]:
    """Problem without the model errors that are named, and its estimate, which counts all."""
    settings = problem.settings
    if not settings.model_errors or settings.row_low_pass is None:
        return problem, estimate
    if _is_gross(estimate) or not noisy(estimate) or not problem.clock.sound:
        return problem, estimate
    # of signals as measured
    faults = [d for d in estimate.diagnostics if d.code.startswith(AS_MEASURED)]
    source = corrected(problem.source, problem.tree, estimate.sensor_errors)
    offset = estimate.noise is not None and estimate.noise.bias_weight > 0.5
    beside = (*settings.nuisances, *[PlateBias.term] * offset)
    find = partial(find_model_errors, problem, source, estimated=beside, prior=prior)
    with one_blas_thread():
        errors, measured, given = find(estimate.values), None, problem
        if errors is None:
            return problem, estimate
        if errors.lasting is not None:
            measured = estimate.normal_equations
            # again about what the first correction leaves
            for _ in range(LINEARIZATIONS):
                problem = _without(given, errors)
                estimate = _estimate_of(problem, doubt)
                kinds = [each.family for each in errors.each]
                again = find(estimate.values, among=kinds)
                if again is None or again.taken != errors.taken:
                    break
                errors = again
            problem = _without(given, errors)
            estimate = _estimate_of(problem, doubt)
        root = errors.effect.root(estimate.covariance)
        gain = errors.effect.gain(estimate.covariance)
    estimate = replace(
        estimate,
        covariance=estimate.covariance + root @ root.T,
        measured_equations=measured,
        model_errors=errors.each,
        model_error_effect=errors.effect,
        correction=errors.lasting
        and replace(errors.correction, gain=gain).of(errors.taken),
    )
    known = {d.code for d in estimate.diagnostics}
    more = [d for d in faults if d.code not in known]
    every = [*model_error_diagnostics(estimate), *more, *estimate.diagnostics]
    return problem, replace(estimate, diagnostics=ordered(every))


def _with_repetition(problem: Problem, estimate: Estimate) -> Estimate:
    """Estimate with what of its residuals repeats with the motion."""
    settings = problem.settings
    if not settings.model_errors or settings.row_low_pass is None:
        return estimate
    if not noisy(estimate) or not problem.clock.sound:
        return estimate
    with one_blas_thread():
        found = repeatable_error(problem, estimate.values)
    estimate = replace(estimate, repeatable=found)
    every = [*estimate.diagnostics, *repetition(estimate)]
    return replace(estimate, diagnostics=ordered(every))


def _is_gross(estimate: Estimate) -> bool:
    """Whether data contradict the model so that a search for its errors means nothing."""
    errors = {d.code for d in estimate.diagnostics if d.level == "error"}
    causes = {code for code in errors if not messages()[code].symptom}
    left = estimate.relative_residual[list(estimate.matters)].max(initial=0.0)
    return bool(causes - HARMLESS) or ("encoder.range" in causes and left > USELESS)


def _without(problem: Problem, errors: ModelErrors) -> Problem:
    """Problem whose recording has no model errors that are to be taken out."""
    assert errors.lasting is not None
    source = WithoutModelErrors(problem, problem.source, errors.values, errors.lasting)
    return replace(problem, source=source)


LINEARIZATIONS = 1
"""Times that model errors are estimated anew about the corrected estimate."""

USELESS = 0.5
"""Part of a channel's signal that is left where positions are none of the robot's."""

HARMLESS = {"plate.tare", "encoder.range"}
"""Codes of causes that need not change the forces of a motion."""


AS_MEASURED = ("channel.", "encoder.", "torque.effort")
"""Beginnings of codes of what single signals show."""


class PreparedProblem(NamedTuple):
    """Problem with the terms and the filter on positions that data chose.

    Attributes:
        problem: The problem.
        choice: Evidence for the terms; None where they were stated.
        diagnostics: Of the filter.
    """

    problem: Problem
    choice: TermChoice | None
    diagnostics: tuple[Diagnostic, ...]


def prepare(problem: Problem) -> PreparedProblem:
    """Choose terms and the filter on positions by held-out data, where nobody stated them.

    Args:
        problem: Robot, recording and method.
    """
    problem, choice = with_all_terms(problem)
    problem, chosen = with_position_filter(problem)
    return PreparedProblem(problem, choice, chosen)


@stage("rows and their products")
def weighted_least_squares(problem: Problem, source: Source) -> LinearFit:
    """Solution under white noise of each channel's own size.

    Args:
        problem: Its terms and filters are chosen.
        source: The recording, errors of the sensors taken back.
    """
    passes = problem.passes(3, source, whole=True)
    equations = problem.equations(passes)
    return LinearFit(
        passes, equations, solve(equations, noise_weights(equations), passes.rows)
    )


def _estimate_of(problem: Problem, doubt: CalibrationCovariance | None) -> Estimate:
    """Y = X theta + e, e autoregressive channel by channel: generalised least squares."""
    if not problem.minimal.names:
        raise SettingsError(
            "identification.zeros leaves no parameter to estimate; name fewer"
        )
    with one_blas_thread():
        model = SensorModel.of(problem, doubt)
        sensors = gauss_newton(
            problem.source, partial(weighted_least_squares, problem), model
        )
        start = sensors.solution
        columns = model.columns(start.passes.plan, start.fit.values, sensors.values)
        solution = generalized_least_squares(start.fit, start.passes, columns)
        fit = bootstrap(solution, problem.names)
        if not np.isfinite(fit.covariance).all():
            raise RecordingError(
                "the recording holds numbers too large to compute with"
            )
        estimate = _estimate(problem, start, fit, model, sensors.values)
        tests = diagnostics(estimate, problem, start.passes.surveyor.survey())
    every = [
        *setup_diagnostics(problem),
        *tests,
        *model.diagnostics(sensors),
        *quality(estimate),
    ]
    every += regrouped_rotors(problem)
    zero = {*zero_unknown(fit.noise), *model.with_unknown_zero}
    unidentifiable = tuple(name for name in estimate.names if name in zero)
    return replace(estimate, diagnostics=ordered(every), unidentifiable=unidentifiable)


def _estimate(
    problem: Problem, start: LinearFit, fit: GlsFit, model: SensorModel, numbers: Array
) -> Estimate:
    """The fit as an estimate, with the sensors' errors and score tests."""
    equations, signal = start.equations, start.equations.squares
    return Estimate(
        method=problem.method,
        names=equations.unknowns,
        units=problem.units,
        values=fit.values,
        covariance=fit.covariance,
        gravity=problem.tree.gravity,
        channels=equations.channels,
        channel_units=channel_units(problem.tree, problem.method),
        residual=np.sqrt(fit.squares / np.maximum(equations.used, 1.0)),
        relative_residual=np.sqrt(fit.squares / np.where(signal > 0, signal, 1.0)),
        samples=tuple(int(n) for n in equations.used),
        condition=start.fit.condition,
        normal_equations=equations,
        diagnostics=(),
        minimal=problem.minimal,
        drives=problem.drives,
        joints=problem.tree.names,
        noise=fit.noise,
        nuisances=model.estimates(numbers, fit),
        nuisance_covariance=model.covariance(fit),
        settings=problem.settings,
    )
