"""Model errors in the residuals of an estimate: search, effect and correction.

The most likely errors of the corrected families (types of model error) are subtracted from the
recording, and a part of this correction is counted as uncertainty. Errors of other families stay in
the measurements, and the covariance includes their possible effect.

Source    [KO01] for the uncertainty of a model counted in the estimate
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.base.gaussian import Gaussian
from testbed.core.base.stages import timed_stage
from testbed.core.estimation.model_errors.catalogue import model_error_families
from testbed.core.estimation.model_errors.error_rows import (
    ROWS_PER_CUTOFF,
    ErrorRows,
    Indices,
    error_rows,
    linearizer_of,
)
from testbed.core.estimation.model_errors.estimates import (
    MIN_RELATIVE_VARIANCE,
    ModelErrorCorrection,
    ModelErrorEffect,
    ModelErrorEstimate,
)
from testbed.core.estimation.model_errors.family import ModelErrorFamily
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.estimation.model_errors.restricted_likelihood import (
    ProjectedRows,
    RegressionRows,
)
from testbed.core.estimation.model_errors.selection import (
    MIN_NAMED_GAIN,
    Selection,
    Selector,
)
from testbed.core.estimation.model_errors.sensor_family import SensorFamily
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    solve_scaled,
)
from testbed.core.estimation.sensor.estimates import NuisanceEstimate
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import DerivedSource, Source
from testbed.core.robot.tree import Tree
from testbed.sensors.catalogue import estimable_errors

CORRECTION_DOUBT = 0.3
"""Part of a correction that counts as its standard deviation."""

MIN_ROWS = 50
"""Smallest number of rows in some channel for a search."""


@dataclass(frozen=True, eq=False)
class ModelErrors:
    """Families (types) of model errors found in the residuals of an estimate, and their effect.

    Attributes:
        estimates: Estimate of each family, in order of decreasing gain.
        correction: Coefficients of the families.
        effect: Effect on the unknowns.
        corrected_kinds: Kinds that are subtracted from the measurements.
        values: Unknowns about which the errors are linearised, (p,).
    """

    estimates: tuple[ModelErrorEstimate, ...]
    correction: ModelErrorCorrection
    effect: ModelErrorEffect
    corrected_kinds: tuple[str, ...]
    values: Array

    @property
    def applied_correction(self) -> ModelErrorCorrection | None:
        """Correction restricted to `corrected_kinds`; None if no family is corrected."""
        return (
            self.correction.for_families(self.corrected_kinds)
            if self.corrected_kinds
            else None
        )


def model_error_signal(
    correction: ModelErrorCorrection, point: Linearization
) -> tuple[Array, Array]:
    """Signal of model errors in the measurements, (m, C), and columns, (m, C, k) [N, N m].

    Args:
        correction: Coefficients of the errors.
        point: Motion and forces, with the signal magnitudes of the correction.
    """
    by_kind = {each.kind: each for each in model_error_families()}
    blocks = []
    for kind, indices in zip(correction.families, correction.columns, strict=True):
        blocks.append(by_kind[kind].selected_columns(point, indices))
    columns = np.concatenate(blocks, axis=2)
    return np.asarray(columns @ correction.coefficients), columns


class ModelErrorFreeSource(DerivedSource):
    """Recording with model errors subtracted and joints in the order of the tree.

    Attributes:
        doubt: Mean variance of the subtracted signal in each channel, without the part that the
            unknowns compensate (`ModelErrorCorrection.gain`), (C,) [N^2, (N m)^2].
    """

    def __init__(
        self,
        problem: Problem,
        source: Source,
        values: Array,
        correction: ModelErrorCorrection,
    ) -> None:
        """Compute the errors at the instants from which they are interpolated.

        Args:
            problem: Robot and method.
            source: Recording to be corrected.
            values: Unknowns about which the errors are linearised, (p,).
            correction: Coefficients of the errors.
        """
        super().__init__(source, source.samples, source.rate)
        self.names, self.segments = problem.tree.names, source.segments
        self._source, self._tree = source, problem.tree
        self._signal = problem.method
        plan = problem.passes(1, source, whole=True, per_cutoff=ROWS_PER_CUTOFF).plan
        linearizer = linearizer_of(problem, plan, values)
        times, signals, squares = list[Indices](), list[Array](), list[Array]()
        for window in plan.windows():
            part = source.part(window.first, window.last)
            states = linearizer.states(plan.signals(part, window), window.row)
            point = linearizer.linearization(states, correction.sizes)
            # instants before the first row of a window belong to the previous window
            first = (
                linearizer.filter.half_width // linearizer.filter.stride * bool(times)
            )
            begin = linearizer.first_sample(window.row)
            count = states.smooth.samples
            times.append(begin + linearizer.filter.stride * np.arange(first, count))
            signal, columns = model_error_signal(correction, point)
            signals.append(signal[first:])
            columns = (
                columns - linearizer.unknown_columns(point.motion) @ correction.gain
            )
            squares.append(((columns @ correction.spread) * columns).sum(axis=2))
        self.doubt = np.concatenate(squares).mean(axis=0)
        self._instants, self._errors = _merged_windows(times, signals)

    def part(self, first: int, last: int) -> Recording:
        """Corrected samples `first` to `last` - 1, without the truth.

        Errors are interpolated by a cubic spline and are constant before the first and after the
        last instant.
        """
        recording = self._source.part(first, last).ordered(self._tree)
        samples = np.clip(np.arange(first, last), self._instants[0], self._instants[-1])
        errors = CubicSpline(self._instants, self._errors)(samples)
        changes: Any = {self._signal: recording.measured(self._signal) - errors}
        return replace(recording, **changes)


def _merged_windows(
    times: Sequence[Indices], signals: Sequence[Array]
) -> tuple[Indices, Array]:
    """Sorted unique instants and their signals; later windows take precedence.

    Args:
        times: Sample indices of each window, (m,).
        signals: Signals of each window, (m, C).
    """
    instants = np.concatenate(times[::-1])
    instants, first = np.unique(instants, return_index=True)
    return instants, np.concatenate(signals[::-1])[first]


@timed_stage("model errors")
def find_model_errors(
    problem: Problem,
    source: Source,
    values: Array,
    estimated_terms: Collection[str] = (),
    prior: Gaussian | None = None,
    kinds: Collection[str] | None = None,
) -> ModelErrors | None:
    """Find the model errors in the residuals of an estimate; None if there are none.

    Families are selected by the restricted likelihood (`Selector`). The result is also None if
    every channel has fewer than MIN_ROWS rows.

    Args:
        problem: Problem with chosen terms and filters; rows are filtered.
        source: Recording corrected for sensor errors.
        values: Estimated unknowns, (p,).
        estimated_terms: Terms of the sensor errors that are estimated with the unknowns.
        prior: Prior of the first unknowns; None for no prior.
        kinds: Kinds of families to search; default all.
    """
    prior_rows = _prior_rows(prior, len(values))
    rows = error_rows(problem, source, values, prior_rows)
    if rows.row_mask.sum(axis=1).max() < MIN_ROWS:
        return None
    families = [
        family
        for family in model_error_families()
        if problem.method in family.methods
        and family.kind not in estimated_terms
        and (kinds is None or family.kind in kinds)
        and family.applies(rows.linearizations[0])
    ]
    sensor_families = [
        SensorFamily(e) for e in estimable_errors() if e.term in estimated_terms
    ]
    measured_errors = [
        each for each in sensor_families if problem.method in each.methods
    ]
    regression, alternatives = _regression_rows(
        rows, families, measured_errors, prior_rows
    )
    selection = Selector(regression, families, rows.encoder_share).select()
    if not selection.variances:
        return None
    return _model_errors(rows, families, selection, alternatives)


def _regression_rows(
    rows: ErrorRows,
    families: Sequence[ModelErrorFamily],
    sensor_errors: Sequence[ModelErrorFamily],
    prior_rows: Array,
) -> tuple[RegressionRows, dict[str, Indices]]:
    """Whitened rows of unknowns, sensor errors and families, and column indices of alternatives.

    Estimated sensor errors are unknowns that follow the robot unknowns and have no prior.

    Args:
        rows: Rows of the robot's unknowns.
        families: Families to search.
        sensor_errors: Families of the sensor errors that are estimated.
        prior_rows: Prior rows of the robot's unknowns, (r, p + 1).
    """
    columns, alternatives = rows.family_columns([*families, *sensor_errors])
    others = [columns.pop(each.kind) for each in sensor_errors]
    unknowns = np.concatenate([rows.whitened_rows(rows.columns), *others], axis=2)
    missing = unknowns.shape[2] + 1 - prior_rows.shape[1]
    prior_rows = np.insert(prior_rows, [-1] * missing, 0.0, axis=1)
    measured = rows.whitened_rows(rows.measured[..., None])[..., 0]
    row_mask = np.asarray(unknowns.any(axis=2))
    return RegressionRows(
        unknowns, measured, row_mask, columns, prior_rows
    ), alternatives


def _prior_rows(prior: Gaussian | None, count: int) -> Array:
    """Rows of unit noise equivalent to a prior of the first unknowns, (r, p + 1).

    The last column is the right-hand side. Directions with a relative variance below
    MIN_RELATIVE_VARIANCE have no row; r is zero without a prior.

    Args:
        prior: Prior of the first unknowns; None for no prior.
        count: Number of unknowns, p.
    """
    if prior is None:
        return np.zeros((0, count + 1))
    scale = np.sqrt(np.maximum(np.diagonal(prior.covariance), SMALLEST_POSITIVE))
    sizes, axes = eigh(prior.covariance / np.outer(scale, scale))
    uncertain = sizes > MIN_RELATIVE_VARIANCE
    root = (axes[:, uncertain] / np.sqrt(sizes[uncertain])).T / scale
    rows = np.zeros((len(root), count + 1))
    rows[:, : len(scale)], rows[:, -1] = root, root @ prior.values
    return rows


def _model_errors(
    rows: ErrorRows,
    families: Sequence[ModelErrorFamily],
    selection: Selection,
    alternatives: Mapping[str, Indices],
) -> ModelErrors:
    """Assemble estimates, correction and effect of the selected families.

    Args:
        rows: Rows of the robot's unknowns.
        families: Families that were searched.
        selection: Selected families.
        alternatives: Column indices of the best alternatives, keyed by kind.
    """
    by_kind, tree = {each.kind: each for each in families}, rows.linearizer.problem.tree
    correction = _correction(rows, selection, alternatives)
    count = rows.columns.shape[2]
    effect = ModelErrorEffect(
        correction.spread, *_marginal_information(selection.products, count)
    )
    return ModelErrors(
        tuple(_estimate_of(selection, by_kind[kind], tree) for kind in selection.gains),
        correction,
        effect,
        selection.taken,
        rows.linearizer.values,
    )


def _correction(
    rows: ErrorRows, selection: Selection, alternatives: Mapping[str, Indices]
) -> ModelErrorCorrection:
    """Coefficients of the selected families; zero for uncorrected families.

    For families with a gain below MIN_NAMED_GAIN, `spread` contains the prior variances of their
    coefficients. For other families, it contains the posterior covariance plus the outer product of
    a vector with itself; the vector holds the coefficients of uncorrected families, and
    CORRECTION_DOUBT times the coefficients of corrected families. `gain` is zero and is to be
    replaced by the caller.

    Args:
        rows: Rows of the robot's unknowns.
        selection: Selected families.
        alternatives: Column indices of the best alternatives, keyed by kind.
    """
    products, solution, kinds = (
        selection.products,
        selection.solution,
        tuple(selection.variances),
    )
    p = products.p
    counts = [len(products.indices[kind]) for kind in kinds]
    corrected = np.repeat([kind in selection.taken for kind in kinds], counts)
    named = np.repeat(
        [selection.gains[kind] >= MIN_NAMED_GAIN for kind in kinds], counts
    )
    coefficients = np.where(corrected, solution.values[p:], 0.0)
    variance = np.repeat([*selection.variances.values()], counts)
    spread = np.diag(np.where(named, 0.0, variance))
    spread += np.outer(named, named) * solution.covariance[p:, p:]
    # doubt of a part of the corrected coefficients, and of all other named coefficients
    doubt = np.where(named, solution.values[p:], 0.0) * np.where(
        corrected, CORRECTION_DOUBT, 1.0
    )
    spread += np.outer(doubt, doubt)
    none = np.zeros(0, np.intp)
    return ModelErrorCorrection(
        families=kinds,
        counts=tuple(counts),
        columns=tuple(tuple(alternatives.get(kind, none).tolist()) for kind in kinds),
        coefficients=coefficients,
        spread=spread,
        gain=np.zeros((rows.columns.shape[2], len(coefficients))),
        sizes=rows.linearizations[0].sizes,
    )


def _marginal_information(products: ProjectedRows, count: int) -> tuple[Array, Array]:
    """Information matrix of the robot unknowns, (p, p), and products with families, (p, k).

    Sensor unknowns are eliminated by the Schur complement, and the prior information is subtracted.

    Args:
        products: Projected rows of all unknowns and families.
        count: Number of the robot's unknowns, p, which come first.
    """
    prior = products.rows.prior[:, :-1]
    information, cross = products.information - prior.T @ prior, products.cross
    if products.p == count:
        return information, cross
    own, others = slice(count), slice(count, None)
    block = np.concatenate([information[others, own], cross[others]], axis=1)
    shift = information[own, others] @ solve_scaled(information[others, others], block)
    return information[own, own] - shift[:, own], cross[own] - shift[:, others]


def _estimate_of(
    selection: Selection, family: ModelErrorFamily, tree: Tree
) -> ModelErrorEstimate:
    """Estimate of one selected family: texts for reports, gain, effect, coefficients.

    Coefficients are sorted by decreasing ratio of magnitude to sigma.

    Args:
        selection: Selected families.
        family: Family of the estimate.
        tree: Kinematic tree of the robot.
    """
    products, solution = selection.products, selection.solution
    indices = products.indices[family.kind]
    positions = products.p + indices
    values, covariance = (
        solution.values[positions],
        solution.covariance[np.ix_(positions, positions)],
    )
    effect, share = _effect(selection, family.kind, values)
    pairs = zip(
        family.coefficient_scales(tree),
        values,
        np.sqrt(np.diagonal(covariance)),
        strict=False,
    )
    coefficients = [
        NuisanceEstimate(family.kind, name, unit, size * value, size * sigma)
        for (name, unit, size), value, sigma in pairs
    ]
    coefficients.sort(key=lambda each: -abs(each.value) / each.sigma)
    return ModelErrorEstimate(
        family=family.kind,
        label=family.label,
        meaning=family.meaning,
        remedy=family.remedy,
        gain=selection.gains[family.kind],
        physical=family.physical,
        named=selection.gains[family.kind] >= MIN_NAMED_GAIN,
        corrected=family.kind in selection.taken,
        effect=effect,
        share=share,
        coefficients=tuple(coefficients),
    )


def _effect(
    selection: Selection, kind: str, coefficients: Array
) -> tuple[Array, Array]:
    """RMS of a family's signal in each channel, absolute and relative, (C,) each.

    The signal's least-squares projection on the unknowns' columns is subtracted. The reference of
    the relative value is the residual of a fit of the unknowns alone.

    Args:
        selection: Selected families.
        kind: Kind of the family.
        coefficients: Coefficients of the family, (k,).
    """
    products = selection.products
    rows, total = products.rows, products.noise.total
    signals = np.stack([rows.families[kind] @ coefficients, rows.measured], axis=2)
    scale = (rows.row_mask / total[:, None])[..., None]
    unknowns, scaled = (
        (each * scale).reshape(-1, each.shape[2]) for each in (rows.columns, signals)
    )
    imitation = np.linalg.lstsq(unknowns, scaled, MIN_RELATIVE_VARIANCE)[0]
    residual = (signals - rows.columns @ imitation) * rows.row_mask[..., None]
    rms = np.sqrt((residual**2).sum(axis=1) / rows.count[:, None])
    return rms[:, 0], rms[:, 0] / np.maximum(rms[:, 1], SMALLEST_POSITIVE)
