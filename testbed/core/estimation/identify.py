"""Identify the minimal parameters from a recording: the room's front door."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.diagnostics import Diagnostic, diagnose, of_instrument, of_recording, ordered
from testbed.core.base.errors import (
    RecordingError,
    SettingsError,
    TestbedError,
    UnseenParameters,
    few,
)
from testbed.core.base.stages import stage
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.estimation.diagnostics.diagnosis import diagnostics, quality
from testbed.core.estimation.diagnostics.residuals import zero_unknown
from testbed.core.estimation.estimate import Estimate, Method, channel_units, sensor_of
from testbed.core.estimation.noise.coloured_noise import GlsFit, generalized_least_squares
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import MASS
from testbed.core.estimation.regression.normal_equations import (
    NormalEquations,
    standard_deviations,
)
from testbed.core.estimation.regression.passes import Passes, Progress
from testbed.core.estimation.regression.solvers import (
    Fit,
    ScoreSquares,
    bin_size,
    hidden,
    noise_weights,
    sandwich,
    solve,
)
from testbed.core.estimation.regression.windows import Plan
from testbed.core.estimation.selection.held_out import TermChoice
from testbed.core.estimation.selection.position_filter import with_position_filter
from testbed.core.estimation.selection.term_choice import with_all_terms, with_fewer_terms
from testbed.core.estimation.sensor.correction import CalibrationCovariance
from testbed.core.estimation.sensor.sensor_model import LinearFit, SensorModel, gauss_newton
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.kernel.records import Question
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.source import RecordingLike, Source, segments_of
from testbed.core.recordings.views import is_imported, pedestal_said
from testbed.core.robot.friction import BACKWARD, FORWARD, LAWS, ROTOR
from testbed.core.robot.tree import Tree, require_tree


def identify(
    tree: Tree,
    recording: RecordingLike,
    method: Method | Signal = "wrench",
    *,
    terms: Sequence[str] = (),
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
    return estimate_of(problem, doubt)


def estimate_of(problem: Problem, doubt: CalibrationCovariance | None = None) -> Estimate:
    """The estimate of a recording that is made ready.

    Args:
        problem: Robot, recording and method.
        doubt: As for `identify`.

    Raises:
        RecordingError: As `identify`.
        UnseenParameters: As `identify`.
    """
    problem, choice = with_all_terms(problem)
    problem, filtered = with_position_filter(problem)
    try:
        estimate = _estimate_of(problem, choice, doubt)
    except UnseenParameters:
        fewer = problem if problem.drives is None else with_fewer_terms(problem)
        if fewer.names == problem.names:
            raise
        problem, estimate = fewer, _estimate_of(fewer, choice, doubt)
    said = [*(_rotors_first(each, problem) for each in estimate.diagnostics), *filtered]
    return replace(estimate, diagnostics=of_instrument(said, sensor_of(problem.tree)))


def _rotors_first(given: Diagnostic, problem: Problem) -> Diagnostic:
    """Torques that lead the motion: because of rotors, if they do so no longer beside those."""
    if given.code != "torque.delay" or ROTOR.kind not in given.causes:
        return given
    with suppress(TestbedError):
        beside = _estimate_of(
            problem.with_settings(terms=(*problem.settings.words, ROTOR.kind)), None, None
        )
        if all(each.code != given.code for each in beside.diagnostics):
            causes = dict.fromkeys((ROTOR.kind, *given.causes))
            remedy = f"add '{ROTOR.kind}' to identification.terms"
            return replace(given, causes=tuple(causes), remedy=remedy)
    return given


def _estimate_of(
    problem: Problem, choice: TermChoice | None, doubt: CalibrationCovariance | None
) -> Estimate:
    """The estimate with the terms of a problem's settings."""
    settings = problem.settings
    if not problem.minimal.names:
        raise SettingsError("identification.zeros leaves no parameter to estimate; name fewer")
    full = settings.joined and settings.covariance is None

    @stage("rows and their products")
    def weighted_solution(source: Source) -> LinearFit:
        passes = problem.passes(3 if settings.noise == "ar" else 2, source, whole=True)
        equations = problem.equations(passes)
        weights = noise_weights(equations, settings.covariance, full)
        return LinearFit(passes, equations, solve(equations, weights, passes.rows))

    with one_blas_thread():
        model = SensorModel.of(problem, doubt)
        sensor = gauss_newton(problem.source, weighted_solution, model)
        passes, equations, linear = sensor.solution
        if settings.noise == "ar":
            columns = model.columns(passes.plan, linear.values, sensor.values)
            fit = generalized_least_squares(linear, passes, problem.names, columns)
        else:
            fit = _refined(passes.plan, linear, passes)
        if not np.isfinite(fit.covariance).all():
            raise RecordingError("the recording holds numbers too large to compute with")
        estimate = _estimate(problem, equations, fit, model, sensor.values)
        of_data = diagnostics(estimate, problem.tree, passes.surveyor.survey(), problem.tare)
    if pedestal_said(problem.source):  # else a tare that is not its weight is odd
        of_data = tuple(each for each in of_data if each.code != "plate.tare")
    every = [*_of_problem(problem), *of_data, *model.diagnostics(sensor), *quality(estimate)]
    every += _rotors_within(problem)
    estimate = replace(estimate, choice=choice, diagnostics=ordered(every))
    zero = {*zero_unknown(estimate.noise), *model.with_unknown_zero}
    return estimate.without([n for n in estimate.names if n in zero])


def _of_problem(problem: Problem) -> Iterator[Diagnostic]:
    """What is to be known before any sample is used."""
    source, settings = problem.source, problem.settings
    plate = problem.method == "external"
    yield from of_recording(source.facts)
    if problem.repeated:
        yield diagnose("encoder.interpolated", "the poses", problem.repeated)
    if plate and MASS not in settings.facts and "bias" not in settings.nuisances:
        yield from _of_pedestal(problem)
    if problem.drives is not None:
        yield from _missing_terms(problem.tree, settings)
        for term in problem.drives.asked:
            if term.law in (FORWARD, BACKWARD):
                yield diagnose("drives.one-way", problem.tree.names[term.joint], method="internal")
    passing = [kind for kind in ("bias", "slope") if kind in settings.nuisances]
    if plate and passing and len(segments_of(source)) > 1:
        yield diagnose("plate.common-offset", " and ".join(passing), method="external")


BY_MODEL = 2e-3
"""Part of the model's pedestal by which a tare is not its weight."""


def _of_pedestal(problem: Problem) -> Iterator[Diagnostic]:
    """A pedestal whose weight nobody has measured: by the model file, or by a solved mapping."""
    weight = float(np.linalg.norm(pedestal_wrench(problem.tree)[:3]))
    by_model = abs(np.linalg.norm(problem.tare[:3]) - weight) <= BY_MODEL * weight
    stated = problem.source.tare is not None and not is_imported(problem.source)
    if weight and by_model and not stated:
        yield diagnose("plate.no-tare", "the tare", weight, method="external")


def _missing_terms(tree: Tree, settings: Settings) -> Iterator[Diagnostic]:
    """Terms of the joints' torque that the model file states and the settings leave out."""
    for law in LAWS:
        given = law.coefficients(tree)
        if given.any() and law not in settings.laws:
            names = ", ".join(name for name, value in zip(tree.names, given, strict=True) if value)
            yield diagnose("drives.term", names, method="internal", kind=law.kind)


def _rotors_within(problem: Problem) -> Iterator[Diagnostic]:
    """Rotors that the model file states and that torques identify only in sums with bodies."""
    stated = [f"+{ROTOR.kind}/{each.name}" for each in problem.tree.joints if each.rotor_inertia]
    sums = [name for name in problem.names if name.endswith(tuple(stated))]
    if sums:
        yield diagnose("drives.rotor", few(sums), method="internal")


def _refined(plan: Plan, fit: Fit, passes: Passes) -> GlsFit:
    """Residuals, their covariance, and what they correct."""
    rows, basis = plan.layout.rows, plan.layout.basis
    factors = np.zeros(rows.slots)
    columns = rows.unknown >= 0
    factors[columns] = -(basis @ fit.values)[rows.unknown[columns]]
    factors[rows.measured] = 1.0
    squares = np.zeros(len(rows.measured))
    scores = ScoreSquares(len(basis), plan.rate)
    for sums in passes.sums(Question(factors, fit.weights, bin_size(plan.rate))):
        squares += sums.moments
        scores.add(sums.scores)
    values = fit.values
    if fit.correctable:
        values = values + fit.inverse @ (basis.T @ scores.total)
    lost = len(values) / len(rows.measured)  # rows' worth of freedom, a channel
    factor = hidden(plan.weights, plan.step, plan.rate) / max(1 - lost / plan.rows, 0.1)
    covariance = factor * sandwich(fit.inverse, basis.T @ scores.finish() @ basis)
    return GlsFit(fit, values, covariance, squares)


def _estimate(
    problem: Problem,
    equations: NormalEquations,
    fit: GlsFit,
    model: SensorModel,
    numbers: Array,
) -> Estimate:
    """The fit as an estimate, with the instrument's numbers and what was tested of it."""
    square = equations.squares
    spread, across = model.covariance(fit)
    return Estimate(
        method=problem.method,
        names=equations.unknowns,
        units=problem.units,
        values=fit.values,
        sigma=standard_deviations(fit.covariance),  # but for rounding
        covariance=fit.covariance,
        gravity=problem.tree.gravity,
        channels=equations.channels,
        channel_units=channel_units(problem.tree, problem.method),
        residual=np.sqrt(fit.squares / np.maximum(equations.used, 1.0)),
        relative_residual=np.sqrt(fit.squares / np.where(square > 0, square, 1.0)),
        samples=tuple(int(n) for n in equations.used),
        condition=fit.fit.condition,
        normal_equations=equations,
        diagnostics=(),
        minimal=problem.minimal,
        drives=problem.drives,
        joints=problem.tree.names,
        noise=fit.noise,
        nuisances=model.estimates(numbers, fit),
        nuisance_covariance=spread,
        nuisance_cross=across,
        trace_tests=model.tests(problem, fit),
        settings=problem.settings,
    )
