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
    message_table,
    ordered_diagnostics,
    worded_for_sensor,
)
from testbed.core.base.errors import (
    RecordingError,
    SettingsError,
    UnidentifiableParameters,
)
from testbed.core.base.gaussian import Gaussian
from testbed.core.base.stages import Progress, timed_stage
from testbed.core.estimation.diagnostics.diagnosis import (
    accuracy_diagnostics,
    diagnostics,
)
from testbed.core.estimation.diagnostics.model_errors import (
    model_error_diagnostics,
    repetition_diagnostics,
)
from testbed.core.estimation.diagnostics.residuals import (
    has_residual_noise,
    unidentifiable_beside_bias,
)
from testbed.core.estimation.diagnostics.setup import (
    regrouped_rotor_diagnostics,
    setup_diagnostics,
)
from testbed.core.estimation.estimate import Estimate, channel_units, robot_sensor_label
from testbed.core.estimation.model_errors.model_errors import (
    ModelErrorFreeSource,
    ModelErrors,
    find_model_errors,
)
from testbed.core.estimation.model_errors.repetition import repeatable_error
from testbed.core.estimation.noise.coloured_noise import (
    GlsFit,
    bootstrap_calibrated_fit,
    generalized_least_squares,
)
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.solvers import noise_weights, solve
from testbed.core.estimation.selection.held_out import TermChoice
from testbed.core.estimation.selection.position_filter import with_position_filter
from testbed.core.estimation.selection.term_choice import (
    with_chosen_terms,
    with_distinguishable_terms,
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
    method: Signal | Signal = "wrench",
    *,
    terms: str | Sequence[str] = (),
    zeros: bool | Sequence[str] | None = None,
    gravity: ArrayLike | None = None,
    settings: Settings = DEFAULTS,
    doubt: CalibrationCovariance | None = None,
    threads: int | None = None,
    progress: Progress = lambda done, total: None,
) -> Estimate:
    """Identify minimal parameters from encoder positions and a measured wrench or joint torques.

    Generalised least squares takes a few passes over the samples and constant memory. The result is
    bitwise identical for any number of threads and any kind of source.

    Args:
        tree: Robot; its inertias are not used, except for `zeros`.
        recording: Recording in memory, path of a Parquet file, or parts in chronological order.
            Columns are matched by joint name; the simulated truth is not read.
        method: "wrench" for the force plate, with six rows per sample, or "torque" for joint
            torques, with one row per joint and sample.
        terms: Unknowns in addition to the bodies' parameters: errors of the plate, named as in a
            rig, such as "plate_bias" or "plate_pose"; or laws of the joint torques, such as
            "coulomb" or "viscous" (docs/identification.md). Default: terms of `settings`.
        zeros: Replacement of `settings.zeros`.
        gravity: Gravity in the bedplate frame, (3,) [m/s^2]; default: gravity of the recording if
            stated, else of the model file.
        settings: Filters, terms and known values.
        doubt: Covariance of the plate calibration that corrected the recording; sigma includes it.
        threads: Number of threads; default one per processor.
        progress: Callback with the number of samples done and the total.

    Raises:
        RecordingError: The recording is of another robot, too short, lacks what the method needs,
            or contains invalid values.
        UnidentifiableParameters: The data cannot distinguish some parameters; lists their names.
    """
    require_tree(tree, "identify(robot, data)")
    if zeros is not None:
        settings = replace(settings, zeros=zeros)
    settings = settings.with_unknowns(terms)
    problem = Problem.from_recording(
        tree,
        recording,
        method,
        settings,
        gravity=gravity,
        threads=threads,
        progress=progress,
    )
    return identify_problem(problem, doubt)[1]


def identify_problem(
    problem: Problem,
    calibration: CalibrationCovariance | None = None,
    prior: Gaussian | None = None,
) -> tuple[Problem, Estimate]:
    """Solve an estimation problem, choosing terms and filter from the data where requested.

    Model errors are subtracted, and the repeatable part of the residuals is determined. Where the
    data cannot distinguish the dry friction of a joint from its offset, their sum is estimated.

    Args:
        problem: Robot, recording and method.
        calibration: Covariance of the plate calibration, as in `identify`.
        prior: Prior of the bodies' parameters in the search for model errors; None for no prior.

    Returns:
        Problem with the chosen terms and filter and corrected measurements, and its estimate.

    Raises:
        RecordingError: As in `identify`.
        UnidentifiableParameters: As in `identify`.
    """
    problem, choice, filter_diagnostics = choose_terms_and_filter(problem)
    try:
        estimate = _generalized_estimate(problem, calibration)
    except UnidentifiableParameters:
        reduced = with_distinguishable_terms(problem)
        if reduced.names == problem.names:
            raise
        problem, estimate = reduced, _generalized_estimate(reduced, calibration)
    problem, estimate = _corrected_for_model_errors(
        problem, estimate, calibration, prior
    )
    estimate = _with_repeatable_error(problem, estimate)
    diagnostics = worded_for_sensor(
        [*estimate.diagnostics, *filter_diagnostics], robot_sensor_label(problem.tree)
    )
    return problem, replace(estimate, choice=choice, diagnostics=diagnostics)


def _corrected_for_model_errors(
    problem: Problem,
    estimate: Estimate,
    doubt: CalibrationCovariance | None,
    prior: Gaussian | None,
) -> tuple[Problem, Estimate]:
    """Subtract significant model errors from the measurements and estimate again.

    Returns the problem with corrected measurements, and its estimate, whose covariance includes the
    effect of all model errors. Both are returned unchanged where no model error is found, the data
    have gross faults, residuals are negligible or the sampling times are not reliable.
    """
    settings = problem.settings
    if not settings.model_errors or settings.row_low_pass is None:
        return problem, estimate
    if (
        _has_gross_faults(estimate)
        or not has_residual_noise(estimate)
        or not problem.sampling_times.is_free_of_errors
    ):
        return problem, estimate
    # diagnostics of the signals as measured
    earlier_faults = [
        d for d in estimate.diagnostics if d.code.startswith(SIGNAL_CODE_PREFIXES)
    ]
    source = corrected(problem.source, problem.tree, estimate.sensor_errors)
    has_bias = estimate.noise is not None and estimate.noise.bias_weight > 0.5
    estimated_terms = (*settings.nuisances, *[PlateBias.term] * has_bias)
    search = partial(
        find_model_errors, problem, source, estimated_terms=estimated_terms, prior=prior
    )
    with one_blas_thread():
        errors, measured, original = search(estimate.values), None, problem
        if errors is None:
            return problem, estimate
        if errors.applied_correction is not None:
            measured = estimate.normal_equations
            # estimate the model errors again about the corrected estimate
            for _ in range(MAX_RELINEARIZATIONS):
                problem = _without_model_errors(original, errors)
                estimate = _generalized_estimate(problem, doubt)
                kinds = [each.family for each in errors.estimates]
                updated = search(estimate.values, kinds=kinds)
                if updated is None or updated.corrected_kinds != errors.corrected_kinds:
                    break
                errors = updated
            problem = _without_model_errors(original, errors)
            estimate = _generalized_estimate(problem, doubt)
        root = errors.effect.root(estimate.covariance)
        gain = errors.effect.gain(estimate.covariance)
    estimate = replace(
        estimate,
        covariance=estimate.covariance + root @ root.T,
        measured_equations=measured,
        model_errors=errors.estimates,
        model_error_effect=errors.effect,
        correction=errors.applied_correction
        and replace(errors.correction, gain=gain).for_families(errors.corrected_kinds),
    )
    known_codes = {d.code for d in estimate.diagnostics}
    signal_faults = [d for d in earlier_faults if d.code not in known_codes]
    all_diagnostics = [
        *model_error_diagnostics(estimate),
        *signal_faults,
        *estimate.diagnostics,
    ]
    return problem, replace(estimate, diagnostics=ordered_diagnostics(all_diagnostics))


def _with_repeatable_error(problem: Problem, estimate: Estimate) -> Estimate:
    """Add to an estimate the part of the residuals that repeats with the motion.

    The estimate is returned unchanged if its residuals are negligible or the sampling times are not
    reliable.
    """
    settings = problem.settings
    if not settings.model_errors or settings.row_low_pass is None:
        return estimate
    if not has_residual_noise(estimate) or not problem.sampling_times.is_free_of_errors:
        return estimate
    with one_blas_thread():
        repeatable = repeatable_error(problem, estimate.values)
    estimate = replace(estimate, repeatable=repeatable)
    all_diagnostics = [*estimate.diagnostics, *repetition_diagnostics(estimate)]
    return replace(estimate, diagnostics=ordered_diagnostics(all_diagnostics))


def _has_gross_faults(estimate: Estimate) -> bool:
    """True if gross faults of the data make a search for model errors meaningless.

    Gross faults are diagnostics of level "error" that describe a cause rather than a symptom,
    except HARMLESS_CODES. Positions outside a joint's range are a gross fault only if a relative
    residual exceeds MAX_RELATIVE_RESIDUAL.
    """
    errors = {d.code for d in estimate.diagnostics if d.level == "error"}
    causes = {code for code in errors if not message_table()[code].symptom}
    residual = estimate.relative_residual[list(estimate.matters)].max(initial=0.0)
    return bool(causes - HARMLESS_CODES) or (
        "encoder.range" in causes and residual > MAX_RELATIVE_RESIDUAL
    )


def _without_model_errors(problem: Problem, errors: ModelErrors) -> Problem:
    """Problem with the correctable model errors subtracted from its measurements."""
    assert errors.applied_correction is not None
    source = ModelErrorFreeSource(
        problem, problem.source, errors.values, errors.applied_correction
    )
    return replace(problem, source=source)


MAX_RELINEARIZATIONS = 1
"""Largest number of new estimates of the model errors about the corrected estimate."""

MAX_RELATIVE_RESIDUAL = 0.5
"""Relative residual above which positions outside the joints' range are a gross fault."""

HARMLESS_CODES = {"plate.tare", "encoder.range"}
"""Codes of faults that need not change the forces of a motion."""


SIGNAL_CODE_PREFIXES = ("channel.", "encoder.", "torque.effort")
"""Prefixes of the codes of diagnostics of single measured signals."""


class PreparedProblem(NamedTuple):
    """Problem with the terms and the low-pass on positions chosen from data.

    Attributes:
        problem: Problem with complete settings.
        choice: Evidence for the chosen terms; None for stated terms.
        diagnostics: Diagnostics of the low-pass on positions.
    """

    problem: Problem
    choice: TermChoice | None
    diagnostics: tuple[Diagnostic, ...]


def choose_terms_and_filter(problem: Problem) -> PreparedProblem:
    """Choose joint laws and the low-pass on positions by cross-validation, where not stated.

    Args:
        problem: Robot, recording and method.
    """
    problem, choice = with_chosen_terms(problem)
    problem, filter_diagnostics = with_position_filter(problem)
    return PreparedProblem(problem, choice, filter_diagnostics)


@timed_stage("rows and their products")
def weighted_least_squares(problem: Problem, source: Source) -> LinearFit:
    """Weighted least-squares solution for white noise with a separate variance per channel.

    Args:
        problem: Problem with chosen terms and filters.
        source: Recording with its sensor errors corrected.
    """
    passes = problem.passes(3, source, whole=True)
    equations = problem.equations(passes)
    return LinearFit(
        passes, equations, solve(equations, noise_weights(equations), passes.rows)
    )


def _generalized_estimate(
    problem: Problem, doubt: CalibrationCovariance | None
) -> Estimate:
    """Estimate by generalised least squares, with an autoregressive noise model for each channel.

    Sensor errors are estimated first, by Gauss-Newton; a bootstrap calibrates the covariance.

    Args:
        problem: Problem with chosen terms and filters.
        doubt: Covariance of the plate calibration; None without a calibration.

    Raises:
        SettingsError: All minimal parameters are known zeros.
        RecordingError: The covariance is not finite.
    """
    if not problem.minimal.names:
        raise SettingsError(
            "identification.zeros leaves no parameter to estimate; name fewer"
        )
    with one_blas_thread():
        model = SensorModel.from_problem(problem, doubt)
        sensors = gauss_newton(
            problem.source, partial(weighted_least_squares, problem), model
        )
        start = sensors.solution
        columns = model.columns(start.passes.plan, start.fit.values, sensors.values)
        solution = generalized_least_squares(start.fit, start.passes, columns)
        fit = bootstrap_calibrated_fit(solution, problem.names)
        if not np.isfinite(fit.covariance).all():
            raise RecordingError(
                "the recording holds numbers too large to compute with"
            )
        estimate = _estimate_from_fit(problem, start, fit, model, sensors.values)
        tests = diagnostics(estimate, problem, start.passes.surveyor.survey())
    all_diagnostics = [
        *setup_diagnostics(problem),
        *tests,
        *model.diagnostics(sensors),
        *accuracy_diagnostics(estimate),
    ]
    all_diagnostics += regrouped_rotor_diagnostics(problem)
    beside_bias = {*unidentifiable_beside_bias(fit.noise), *model.collinear_with_bias}
    unidentifiable = tuple(name for name in estimate.names if name in beside_bias)
    return replace(
        estimate,
        diagnostics=ordered_diagnostics(all_diagnostics),
        unidentifiable=unidentifiable,
    )


def _estimate_from_fit(
    problem: Problem,
    start: LinearFit,
    fit: GlsFit,
    model: SensorModel,
    nuisance_values: Array,
) -> Estimate:
    """Assemble an estimate, without diagnostics, from a generalised least-squares fit.

    Args:
        problem: Problem with chosen terms and filters.
        start: Weighted least-squares solution of the corrected recording.
        fit: Generalised least-squares fit.
        model: Model of the sensor errors.
        nuisance_values: Sensor-error coefficients used to correct the recording, (s,).
    """
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
        residual=np.sqrt(fit.residual_squares / np.maximum(equations.used, 1.0)),
        relative_residual=np.sqrt(
            fit.residual_squares / np.where(signal > 0, signal, 1.0)
        ),
        samples=tuple(int(n) for n in equations.used),
        condition=start.fit.condition,
        normal_equations=equations,
        diagnostics=(),
        minimal=problem.minimal,
        drives=problem.drives,
        joints=problem.tree.names,
        noise=fit.noise,
        nuisances=model.estimates(nuisance_values, fit),
        nuisance_covariance=model.covariance(fit),
        settings=problem.settings,
    )
