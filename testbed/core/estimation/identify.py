"""Identify the minimal parameters from a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.diagnostics import Diagnostic, diagnose, of_instrument, of_recording, ordered
from testbed.core.base.errors import RecordingError, SettingsError, UnseenParameters, few
from testbed.core.base.stages import stage
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.estimation.diagnostics.diagnosis import diagnostics, quality
from testbed.core.estimation.diagnostics.residuals import zero_unknown
from testbed.core.estimation.estimate import Estimate, Method, channel_units, sensor_of
from testbed.core.estimation.noise.coloured_noise import GlsFit, generalized_least_squares
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import MASS
from testbed.core.estimation.regression.normal_equations import NormalEquations
from testbed.core.estimation.regression.passes import Progress
from testbed.core.estimation.regression.solvers import (
    Fit,
    by_normal_equations,
    noise_weights,
    solve,
)
from testbed.core.estimation.selection.position_filter import with_position_filter
from testbed.core.estimation.selection.term_choice import with_all_terms, with_fewer_terms
from testbed.core.estimation.sensor.correction import CalibrationCovariance
from testbed.core.estimation.sensor.sensor_model import LinearFit, SensorModel, gauss_newton
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.source import RecordingLike, Source
from testbed.core.recordings.views import is_imported, pedestal_said
from testbed.core.robot.friction import BACKWARD, FORWARD, LAWS, ROTOR
from testbed.core.robot.tree import Tree, require_tree


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
    problem: Problem, doubt: CalibrationCovariance | None = None
) -> tuple[Problem, Estimate]:
    """Estimate of a problem, and the problem with the terms and the filter that data chose.

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
        estimate = _least_squares(problem, doubt)
    except UnseenParameters:
        fewer = with_fewer_terms(problem)
        if fewer.names == problem.names:
            raise
        problem, estimate = fewer, _least_squares(fewer, doubt)
    said = [_cause_of_lead(each, problem, estimate) for each in estimate.diagnostics]
    diagnostics = of_instrument([*said, *filtered], sensor_of(problem.tree))
    return problem, replace(estimate, choice=choice, diagnostics=diagnostics)


def _least_squares(problem: Problem, doubt: CalibrationCovariance | None) -> Estimate:
    """Y = X theta + e, e autoregressive channel by channel: generalised least squares."""
    if not problem.minimal.names:
        raise SettingsError("identification.zeros leaves no parameter to estimate; name fewer")

    @stage("rows and their products")
    def weighted_solution(source: Source) -> LinearFit:
        passes = problem.passes(3, source, whole=True)
        equations = problem.equations(passes)
        weights = noise_weights(equations)
        return LinearFit(passes, equations, solve(equations, weights, passes.rows))

    with one_blas_thread():
        model = SensorModel.of(problem, doubt)
        sensor = gauss_newton(problem.source, weighted_solution, model)
        passes, equations, linear = sensor.solution
        columns = model.columns(passes.plan, linear.values, sensor.values)
        fit = generalized_least_squares(linear, passes, problem.names, columns)
        if not np.isfinite(fit.covariance).all():
            raise RecordingError("the recording holds numbers too large to compute with")
        estimate = _estimate(problem, equations, linear, fit, model, sensor.values)
        of_data = diagnostics(estimate, problem.tree, passes.surveyor.survey(), problem.tare)
    if pedestal_said(problem.source):  # else a tare that is not its weight is odd
        of_data = tuple(each for each in of_data if each.code != "plate.tare")
    every = [*_of_problem(problem), *of_data, *model.diagnostics(sensor), *quality(estimate)]
    every += _rotors_within(problem)
    zero = {*zero_unknown(fit.noise), *model.with_unknown_zero}
    unidentifiable = tuple(name for name in estimate.names if name in zero)
    return replace(estimate, diagnostics=ordered(every), unidentifiable=unidentifiable)


def _cause_of_lead(given: Diagnostic, problem: Problem, estimate: Estimate) -> Diagnostic:
    """Torques that lead the motion, by rotors where those explain more of them than a delay."""
    if given.code != "torque.delay" or ROTOR.kind not in given.causes:
        return given
    with suppress(UnseenParameters):
        beside = problem.with_settings(terms=(*problem.settings.words, ROTOR.kind))
        equations = beside.equations(beside.passes(1, whole=True))
        weights = estimate.residual**-2.0
        found = by_normal_equations(equations, weights)
        left = float(weights @ equations.residual(found.values))
        if equations.rows - left > (given.significance or 0.0) ** 2:
            causes = dict.fromkeys((ROTOR.kind, *given.causes))
            remedy = f"add '{ROTOR.kind}' to identification.terms"
            return replace(given, causes=tuple(causes), remedy=remedy)
    return given


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
    if plate and passing and len(source.segments) > 1:
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


def _estimate(
    problem: Problem,
    equations: NormalEquations,
    linear: Fit,
    fit: GlsFit,
    model: SensorModel,
    numbers: Array,
) -> Estimate:
    """The fit as an estimate, with the instrument's numbers and what was tested of it."""
    signal = equations.squares
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
        condition=linear.condition,
        normal_equations=equations,
        diagnostics=(),
        minimal=problem.minimal,
        drives=problem.drives,
        joints=problem.tree.names,
        noise=fit.noise,
        nuisances=model.estimates(numbers, fit),
        nuisance_covariance=model.covariance(fit),
        trace_tests=model.tests(problem, fit),
        settings=problem.settings,
    )
