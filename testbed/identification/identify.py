"""Identify the minimal parameters from a recording: the room's front door.

The external method reads encoders and plate, the internal one encoders and motor torques.
Neither sees the truth: the tree loses its masses and the recording its true columns here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import pedestal_wrench
from testbed.errors import RecordingError, SettingsError, UnknownName, UnseenParameters
from testbed.identification.covariance import ScoreSquares, bin_size, sandwich
from testbed.identification.normal_equations import Products, gather
from testbed.identification.passes import Passes, Progress, one_blas_thread
from testbed.identification.settings import Settings
from testbed.identification.solve import SQUARED, Fit, noise_weights, orthogonal, solved
from testbed.identification.windows import Plan, make_plan
from testbed.kernel.layout import layout
from testbed.kernel.records import Question, products_wanted
from testbed.parameters.minimal_set import MinimalSet, minimal_set
from testbed.parameters.rules import Model
from testbed.recordings.columns import AXES
from testbed.recordings.geometry import check_robot
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source, open_source
from testbed.robot.tree import Tree

Method = Literal["external", "internal"]

METHODS: tuple[Method, ...] = ("external", "internal")
"""By the bedplate's reaction, and by joint torques."""

MODEL_OF: dict[Method, Model] = {"external": "reaction", "internal": "dynamic"}
"""Which parameters a method sees."""

SIGNAL_OF: dict[Method, str] = {"external": "wrench", "internal": "torque"}
"""What a method needs of a recording besides positions."""

SIGNIFICANT = 0.3
"""Relative sigma above which a parameter is reported as poorly determined."""

ILL_CONDITIONED = 1e3
"""Condition of the scaled equations above which the estimate is reported as doubtful."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What one method found.

    Attributes:
        method: "external" (bedplate) or "internal" (joint torques).
        names: Minimal parameters, delta_r or delta_d; then, for the internal method,
            `coulomb/JOINT`, `viscous/JOINT` and what other terms the settings has.
        units: One each.
        values: (p,).
        sigma: Standard deviations, (p,), correlation of residuals counted.
        covariance: (p, p).
        count: How many of the names are minimal parameters; they come first.
        matrix: Those on the 10 n barycentric parameters, (count, 10 n).
        channels: The measured channels.
        residual: Rms of their residuals, (channels,) [N, N m].
        relative_residual: ||y - phi delta|| / ||y|| of each, (channels,).
        samples: Rows used of each, (channels,).
        condition: Of the equations with unit columns and weights.
        products: Of all rows: other weights and subsets of channels need no other pass.
        warnings: What a careful reader should know, one line each.
    """

    method: Method
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    sigma: Array
    covariance: Array
    count: int
    matrix: Array
    channels: tuple[str, ...]
    residual: Array
    relative_residual: Array
    samples: tuple[int, ...]
    condition: float
    products: Products
    warnings: tuple[str, ...]


def identify(
    tree: Tree,
    recording: Recording | Source | str | Path | Iterable[Recording],
    method: Method = "external",
    *,
    zeros: bool | Sequence[str] = False,
    gravity: ArrayLike | None = None,
    settings: Settings | None = None,
    threads: int | None = None,
    progress: Progress = lambda done, total: None,
) -> Estimate:
    """Minimal parameters from encoder positions and one kind of force measurement.

    Two passes over the samples, in constant memory; the same to the bit for any number of
    threads and wherever the samples come from.

    Args:
        tree: The robot; its inertias are not used, except for `zeros`.
        recording: In memory, or a Parquet file's path, or parts in the order of time.
            Columns are matched by joint name; its truth is not read.
        method: "external": six reaction rows a sample, no friction columns. "internal":
            a row a joint, with columns for the settings's terms.
        zeros: Take barycentric parameters that are zero in the model file, or are named
            here, as known.
        gravity: (3,) [m/s^2], bedplate frame; default the recording's, if it says, else
            the model file's.
        settings: How the signals are treated; default `Settings()`.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all.

    Raises:
        RecordingError: The recording is of another robot, too short, or holds what is no
            measurement.
        UnseenParameters: The data cannot tell some parameters apart; names them.
    """
    if method not in METHODS:
        raise UnknownName("method", method, METHODS)
    source, settings = open_source(recording), settings or Settings()
    if source.samples < 2:
        raise RecordingError(f"the recording: {source.samples} samples are no recording")
    check_robot(source, tree)
    _check_signal(source, method)
    gravity = source.facts.get("gravity") if gravity is None else gravity
    minimal = minimal_set(tree, MODEL_OF[method], gravity, zeros)
    geometry = tree.without_inertias()
    terms = settings.terms if method == "internal" else ()
    rows = layout(geometry, minimal, terms, settings.joined)
    if settings.covariance is not None and len(settings.covariance) != rows.width:
        raise SettingsError(
            f"weights is a covariance of {len(settings.covariance)} channels, the {method} method "
            f"has {rows.width}"
        )
    tare, warnings = _tare(source, geometry, gravity, method)
    if method == "internal" and "rotor" not in terms:
        warnings += _rotors(tree)
    plan = make_plan(source, rows, tare, settings)
    names = (*minimal.names, *(f"{term}/{joint}" for term in terms for joint in tree.names))
    channels = AXES if method == "external" else tree.names
    passes = Passes(plan, threads, progress)
    with one_blas_thread():
        products = gather(rows, names, channels, passes.sums(products_wanted(rows.width)))
        found = _refined(plan, _solution(plan, products, settings, passes), passes)
    if not np.isfinite(found.covariance).all():
        raise RecordingError("the recording holds numbers too large to compute with")
    units = (*minimal.units, *_units(tree, terms))
    return _estimate(method, units, minimal, products, found, tuple(warnings))


def _check_signal(source: Source, method: Method) -> None:
    """Whether the recording has what the method needs.

    Raises:
        RecordingError: It has not.
    """
    if SIGNAL_OF[method] in source.signals:
        return
    others = [other for other in METHODS if SIGNAL_OF[other] in source.signals]
    advice = "".join(f"; its {SIGNAL_OF[other]} allows the {other} one" for other in others)
    raise RecordingError(
        f"the recording has no {SIGNAL_OF[method]}, which the {method} method needs{advice}"
    )


def _tare(
    source: Source, geometry: Tree, gravity: ArrayLike | None, method: Method
) -> tuple[Array, list[str]]:
    """What is taken off the wrench, and warnings so far."""
    warnings = list(source.facts.get("warnings", ()))
    if source.tare is not None:
        return source.tare, warnings
    tare = pedestal_wrench(geometry, gravity)
    if method == "external" and tare.any():
        warnings.append(
            "the recording does not say what of the wrench is the pedestal's; the model's "
            f"pedestal is taken off (Fz {tare[2]:.4g} N)"
        )
    return tare, warnings


def _solution(plan: Plan, products: Products, settings: Settings, passes: Passes) -> Fit:
    """By normal equations, or from orthonormal columns where products have lost too much."""
    full = settings.joined and settings.covariance is None
    weights = noise_weights(products, settings.covariance, full)
    try:
        found = solved(products, weights)
    except UnseenParameters:  # to the products' precision; the rows may know better
        return orthogonal(plan.layout, products, weights, passes.rows)
    if np.isnan(found.values).any() or found.condition > SQUARED:
        return orthogonal(plan.layout, products, weights, passes.rows)
    return found


@dataclass(frozen=True, eq=False)
class _Refined:
    """A solution after the pass that looks at the residuals themselves."""

    fit: Fit
    values: Array
    covariance: Array
    squares: Array  # of each channel's residuals


def _refined(plan: Plan, fit: Fit, passes: Passes) -> _Refined:
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
    if fit.condition <= SQUARED:  # else the solution is better than the residuals know
        values = values + fit.inverse @ (basis.T @ scores.total)
    covariance = sandwich(fit.inverse, basis.T @ scores.finish() @ basis)
    return _Refined(fit, values, covariance, squares)


def _units(tree: Tree, terms: Sequence[str]) -> list[str]:
    """Units of the terms' coefficients, kind by kind."""
    turning = {"coulomb": "N m", "viscous": "N m s/rad", "offset": "N m", "rotor": "kg m^2"}
    sliding = {"coulomb": "N", "viscous": "N s/m", "offset": "N", "rotor": "kg"}
    return [(turning if j.revolute else sliding)[term] for term in terms for j in tree.joints]


def _rotors(tree: Tree) -> list[str]:
    """Joints whose drive has inertia of its own, which joint torques contain."""
    return [
        f"joint '{joint.name}' has a rotor inertia of {joint.rotor_inertia:g} kg m^2 or kg at the "
        "joint, which the internal estimate takes for the robot's"
        for joint in tree.joints
        if joint.rotor_inertia
    ]


def _estimate(
    method: Method,
    units: tuple[str, ...],
    minimal: MinimalSet,
    products: Products,
    found: _Refined,
    warnings: tuple[str, ...],
) -> Estimate:
    square = np.diagonal(products.square) if products.joined else products.square
    used = np.maximum(products.used, 1.0)
    sigma = np.sqrt(np.diagonal(found.covariance))
    estimate = Estimate(
        method=method,
        names=products.unknowns,
        units=units,
        values=found.values,
        sigma=sigma,
        covariance=found.covariance,
        count=minimal.count,
        matrix=minimal.matrix,
        channels=products.channels,
        residual=np.sqrt(found.squares / used),
        relative_residual=np.sqrt(found.squares / np.where(square > 0, square, 1.0)),
        samples=tuple(int(n) for n in products.used),
        condition=found.fit.condition,
        products=products,
        warnings=warnings,
    )
    return replace(estimate, warnings=(*warnings, *_warnings(estimate)))


def _warnings(estimate: Estimate) -> list[str]:
    warnings = []
    if estimate.condition > ILL_CONDITIONED:
        warnings.append(
            f"the {estimate.method} equations are ill-conditioned ({estimate.condition:.1e}): "
            "errors of the instrument grow by up to that factor"
        )
    every = zip(estimate.names, estimate.values, estimate.sigma, strict=True)
    loose = [
        f"{name} ({value:.3g} +- {sigma:.2g})"
        for name, value, sigma in list(every)[: estimate.count]
        if sigma > SIGNIFICANT * abs(value)
    ]
    if loose:
        listed = ", ".join(loose)
        warnings.append(f"the {estimate.method} estimate leaves poorly determined: {listed}")
    return warnings
