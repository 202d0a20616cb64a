"""Identify the minimal parameters from a recording: the room's front door.

The external method reads encoders and plate, the internal one encoders and motor torques.
Neither sees the truth: the tree loses its masses and the recording its true columns here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array
from testbed.blas import one_blas_thread
from testbed.diagnostics.diagnostic import Diagnostic, diagnose, of_recording, ordered
from testbed.dynamics.drive_set import drive_set
from testbed.dynamics.inverse_dynamics import pedestal_wrench
from testbed.errors import RecordingError, SettingsError, UnknownName, plural
from testbed.identification.coloured import Refined, under_coloured_noise
from testbed.identification.covariance import ScoreSquares, bin_size, hidden, sandwich
from testbed.identification.diagnosis import diagnostics, quality
from testbed.identification.estimate import (
    METHODS,
    MODEL_OF,
    SIGNAL_OF,
    Estimate,
    Method,
    channel_units,
    channels_of,
)
from testbed.identification.instrument import (
    Side,
    Start,
    nuisance_covariance,
    nuisance_diagnostics,
    nuisance_estimates,
    settled,
    side,
    trace_tests,
)
from testbed.identification.normal_equations import NormalEquations, gather
from testbed.identification.open_counted import open_counted
from testbed.identification.passes import Passes, Progress
from testbed.identification.plate_doubt import PlateDoubt
from testbed.identification.residual_diagnostics import zero_unknown
from testbed.identification.ridge import drawn
from testbed.identification.settings import Settings
from testbed.identification.solvers import solve
from testbed.identification.solvers.least_squares import Fit
from testbed.identification.term_choice import with_all_terms
from testbed.identification.weights import noise_weights
from testbed.identification.windows import Plan, make_plan
from testbed.kernel.layout import Layout, layout
from testbed.kernel.records import Question, products_wanted
from testbed.parameters.joint_terms import DriveSet
from testbed.parameters.minimal_set import MinimalSet, minimal_set
from testbed.recordings.coupled_gear import with_gear
from testbed.recordings.geometry import check_robot
from testbed.recordings.measured_base import on_its_base
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source, segments_of
from testbed.robot.friction import LAWS
from testbed.robot.tree import Tree
from testbed.stages import stage


def identify(
    tree: Tree,
    recording: Recording | Source | str | Path | Iterable[Recording],
    method: Method = "external",
    *,
    zeros: bool | Sequence[str] | None = None,
    gravity: ArrayLike | None = None,
    settings: Settings | None = None,
    doubt: PlateDoubt | None = None,
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
        method: "external": six reaction rows a sample, no columns of the joints' own.
            "internal": a row a joint, with columns for `settings.terms`.
        zeros: In place of `settings.zeros`.
        gravity: (3,) [m/s^2], bedplate frame; default the recording's, if it says, else
            the model file's.
        settings: How the signals are treated; default `Settings()`.
        doubt: About the plate by which the recording was corrected: sigma counts it.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all.

    Raises:
        RecordingError: The recording is of another robot, too short, lacks what the method
            needs, or holds what is no measurement.
        UnseenParameters: The data cannot tell some parameters apart; names them.
    """
    if method not in METHODS:
        raise UnknownName("method", method, METHODS)
    source = on_its_base(open_counted(recording, settings or Settings()), tree)
    check_source(source, tree, method)
    settings = _fitting(settings or Settings(), source, method, zeros)
    tree = with_gear(in_its_gravity(tree, source, gravity), source)
    minimal = set_of(tree, method, settings)
    drives, choice = None, None
    if method == "internal":
        settings, choice = with_all_terms(tree, source, minimal, settings, threads, progress)
        drives = drive_set(tree, minimal, settings.words)
    rows, said = _layout(tree, source, settings, minimal, drives)
    names = minimal.names if drives is None else drives.names
    if not minimal.names:
        raise SettingsError("identification.zeros leaves no parameter to estimate; name fewer")
    channels, tare = channels_of(tree, method), tare_of(tree, source)

    @stage("rows and their products")
    def begin(source: Source) -> Start:
        plan = make_plan(source, rows, tare, settings)
        passes = Passes(plan, threads, progress, 3 if settings.noise == "ar" else 2)
        sums = passes.sums(products_wanted(len(channels)))
        equations = gather(rows, names, channels, sums)
        full = settings.joined and settings.covariance is None
        weights = noise_weights(equations, settings.covariance, full)
        return Start(passes, equations, solve(equations, weights, passes.rows))

    with one_blas_thread():
        beside = side(rows, minimal, names, settings, tare, doubt)
        taken_back = settled(source, begin, beside)
        passes, equations, fit = taken_back.start
        if settings.noise == "ar":
            columns = beside.beside(passes.plan, fit.values, taken_back.values)
            found = under_coloured_noise(fit, passes, names, columns)
        else:
            found = _refined(passes.plan, fit, passes)
        if not np.isfinite(found.covariance).all():
            raise RecordingError("the recording holds numbers too large to compute with")
        plain = _estimate(method, tree, equations, found, minimal, drives)
        told = _with_instrument(plain, rows, beside, taken_back.values, found)
        estimate = replace(told, choice=choice)
        wrong = diagnostics(estimate, tree, passes.surveyor.survey(), tare)
    said += [*wrong, *nuisance_diagnostics(beside, taken_back), *quality(estimate)]
    made = drawn(replace(estimate, diagnostics=ordered(said)), settings.ridge)
    open_zero = {*zero_unknown(made.noise), *beside.beside_zero}
    return made.without([name for name in made.names if name in open_zero])


@stage("minimal set")
def set_of(tree: Tree, method: Method, settings: Settings) -> MinimalSet:
    """The minimal set that a method sees: of an unknown tare, what the wrench's changes tell.

    Args:
        tree: The robot, under the gravity of the recording.
        method: By plate or by torques.
        settings: Which parameters are zero, and whether the tare is known.
    """
    tared = method == "external" and settings.tare == "unknown"
    return minimal_set(tree, MODEL_OF[method], zeros=settings.zeros, tared=tared)


def _fitting(
    settings: Settings, source: Source, method: Method, zeros: bool | Sequence[str] | None
) -> Settings:
    """Settings with filters that fit the recording, and a zero that nobody knows."""
    if zeros is not None:
        settings = replace(settings, zeros=zeros)
    if method == "external" and settings.tare == "unknown" and "bias" not in settings.nuisances:
        settings = replace(settings, nuisances=(*settings.nuisances, "bias"))
    return settings.fitted(source.rate)


def check_source(source: Source, tree: Tree, method: Method) -> None:
    """Whether a recording is one, of this robot, with what a method needs.

    Args:
        source: The recording.
        tree: The robot.
        method: Reads torques or the wrench.

    Raises:
        RecordingError: It is not.
    """
    if source.samples < 2:
        raise RecordingError(
            f"the recording: {plural(source.samples, 'sample')}, which is no recording"
        )
    if not source.rate > 0:
        raise RecordingError(
            "the recording: time does not increase from its first sample to its last"
        )
    check_robot(source, tree)
    if SIGNAL_OF[method] in source.signals:
        return
    others = [other for other in METHODS if SIGNAL_OF[other] in source.signals]
    advice = "".join(f"; its {SIGNAL_OF[other]} allows the {other} one" for other in others)
    raise RecordingError(
        f"the recording has no {SIGNAL_OF[method]}, which the {method} method needs{advice}"
    )


def in_its_gravity(tree: Tree, source: Source, gravity: ArrayLike | None = None) -> Tree:
    """The robot under the gravity that was given, or else the recording's, or the model file's.

    Args:
        tree: The robot.
        source: A recording; it may say its gravity.
        gravity: (3,) [m/s^2], bedplate frame, or None.
    """
    given = source.facts.get("gravity") if gravity is None else gravity
    return tree.with_gravity(given)


def tare_of(tree: Tree, source: Source) -> Array:
    """The static wrench to be taken off the plate's, (6,) [N, N m]: the pedestal's.

    Args:
        tree: The robot, under the gravity of the recording.
        source: A recording; it may say so.
    """
    return pedestal_wrench(tree) if source.tare is None else source.tare


def _layout(
    tree: Tree, source: Source, settings: Settings, minimal: MinimalSet, drives: DriveSet | None
) -> tuple[Layout, list[Diagnostic]]:
    """The robot's rows, and diagnostics so far."""
    terms = () if drives is None else drives.terms
    rows = layout(tree.without_inertias(), minimal, terms, settings.joined)
    if settings.covariance is not None and len(settings.covariance) != rows.width:
        method = "external" if drives is None else "internal"
        raise SettingsError(
            f"weights is a covariance of {len(settings.covariance)} channels, the {method} method "
            f"has {rows.width}"
        )
    tare, said = tare_of(tree, source), [*of_recording(source.facts)]
    if drives is None and source.tare is None and tare.any():
        said.append(diagnose("plate.no-tare", "the tare", tare[2], method="external"))
    if drives is not None:
        said += _missing_terms(tree, settings)
    passing = [kind for kind in ("bias", "slope") if kind in settings.nuisances]
    if drives is None and passing and len(segments_of(source)) > 1:
        said.append(diagnose("plate.common-offset", " and ".join(passing), method="external"))
    return rows, said


def _missing_terms(tree: Tree, settings: Settings) -> Iterator[Diagnostic]:
    """Terms of the joints' torque that the model file states and the settings leave out."""
    for law in LAWS:
        given = law.coefficients(tree)
        if given.any() and law not in settings.laws:
            names = ", ".join(name for name, value in zip(tree.names, given, strict=True) if value)
            yield diagnose("drives.term", names, method="internal", kind=law.kind)


def _refined(plan: Plan, fit: Fit, passes: Passes) -> Refined:
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
    return Refined(fit, values, covariance, squares)


def _estimate(
    method: Method,
    tree: Tree,
    equations: NormalEquations,
    found: Refined,
    minimal: MinimalSet,
    drives: DriveSet | None,
) -> Estimate:
    square = equations.squares
    return Estimate(
        method=method,
        names=equations.unknowns,
        units=minimal.units if drives is None else drives.units,
        values=found.values,
        sigma=np.sqrt(np.maximum(np.diagonal(found.covariance), 0.0)),  # but for rounding
        covariance=found.covariance,
        gravity=tree.gravity,
        channels=equations.channels,
        channel_units=channel_units(tree, method),
        residual=np.sqrt(found.squares / np.maximum(equations.used, 1.0)),
        relative_residual=np.sqrt(found.squares / np.where(square > 0, square, 1.0)),
        samples=tuple(int(n) for n in equations.used),
        condition=found.fit.condition,
        normal_equations=equations,
        diagnostics=(),
        minimal=minimal,
        drives=drives,
        joints=tree.names,
        noise=found.noise,
    )


def _with_instrument(
    estimate: Estimate, rows: Layout, beside: Side, numbers: Array, found: Refined
) -> Estimate:
    """With the instrument's unknowns, and what was tested of it."""
    spread, across = nuisance_covariance(beside, found)
    return replace(
        estimate,
        nuisances=nuisance_estimates(beside, numbers, found),
        nuisance_covariance=spread,
        nuisance_cross=across,
        trace_tests=trace_tests(rows, beside, estimate.names, found),
    )
