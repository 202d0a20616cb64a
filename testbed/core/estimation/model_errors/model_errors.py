"""Model errors of an estimate: what they are, what they do to it, and recordings without them.

Of families that are named the estimate is that of the recording without their likeliest part, and
a part of the correction is doubted; of others it stays, and its covariance counts what they may be.

Source    [KO01] for doubt about a model counted in the estimate
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
from testbed.core.base.stages import stage
from testbed.core.estimation.estimate import SIGNAL_OF
from testbed.core.estimation.model_errors.catalogue import model_error_families
from testbed.core.estimation.model_errors.error_rows import (
    PER_CUTOFF,
    ErrorRows,
    Indices,
    error_rows,
    linearizer_of,
)
from testbed.core.estimation.model_errors.estimates import (
    KNOWN,
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
    SURE,
    Selection,
    Selector,
)
from testbed.core.estimation.model_errors.sensor_family import SensorFamily
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import TINY, scaled_solve
from testbed.core.estimation.sensor.estimates import NuisanceEstimate
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import DerivedSource, Source
from testbed.core.robot.tree import Tree
from testbed.sensors.catalogue import estimable_errors

DOUBT = 0.3
"""Part of a correction that is doubted."""

FEWEST = 50
"""Rows of a channel; of fewer nothing is sought."""


@dataclass(frozen=True, eq=False)
class ModelErrors:
    """Families that the residuals of an estimate show, and what they do to it.

    Attributes:
        each: What each is, the clearest first.
        correction: What they make in the measurements.
        effect: On the unknowns.
        taken: Kinds that are taken out of the measurements.
        values: Of the unknowns, about which it is linear, (p,).
    """

    each: tuple[ModelErrorEstimate, ...]
    correction: ModelErrorCorrection
    effect: ModelErrorEffect
    taken: tuple[str, ...]
    values: Array

    @property
    def lasting(self) -> ModelErrorCorrection | None:
        """The part that is taken out, of other motions, too; None for nothing."""
        return self.correction.of(self.taken) if self.taken else None


def signal_of(
    correction: ModelErrorCorrection, at: Linearization
) -> tuple[Array, Array]:
    """What model errors make in the measurements, (m, C), and columns, (m, C, k) [N, N m].

    Args:
        correction: Their coefficients.
        at: Motion and forces with the sizes of the correction.
    """
    by_kind = {each.kind: each for each in model_error_families()}
    every = []
    for kind, kept in zip(correction.families, correction.columns, strict=True):
        every.append(by_kind[kind].some(at, kept))
    columns = np.concatenate(every, axis=2)
    return np.asarray(columns @ correction.coefficients), columns


class WithoutModelErrors(DerivedSource):
    """Recording without model errors, joints in the order of the tree.

    Attributes:
        doubt: Mean square of what the coefficients' spread makes in each channel, beside what it
            makes of the unknowns, (C,).
    """

    def __init__(
        self,
        problem: Problem,
        source: Source,
        values: Array,
        correction: ModelErrorCorrection,
    ) -> None:
        """Signals of the errors at instants, between which they are interpolated.

        Args:
            problem: Robot and method.
            source: The recording.
            values: Of the unknowns, (p,), about which the errors are linear.
            correction: Their coefficients.
        """
        super().__init__(source, source.samples, source.rate)
        self.names, self.segments = problem.tree.names, source.segments
        self._source, self._tree = source, problem.tree
        self._signal = SIGNAL_OF[problem.method]
        plan = problem.passes(1, source, whole=True, per_cutoff=PER_CUTOFF).plan
        linearizer = linearizer_of(problem, plan, values)
        times, signals, squares = list[Indices](), list[Array](), list[Array]()
        for window in plan.windows():
            part = source.part(window.first, window.last)
            states = linearizer.states(plan.signals(part, window), window.row)
            at = linearizer.linearization(states, correction.sizes)
            # instants before the first row of a window belong to the window before
            first = linearizer.filter.reach // linearizer.filter.stride * bool(times)
            begin = linearizer.first_sample(window.row)
            count = states.smooth.samples
            times.append(begin + linearizer.filter.stride * np.arange(first, count))
            signal, columns = signal_of(correction, at)
            signals.append(signal[first:])
            columns = columns - linearizer.unknowns(at.motion) @ correction.gain
            squares.append(((columns @ correction.spread) * columns).sum(axis=2))
        self.doubt = np.concatenate(squares).mean(axis=0)
        self._at, self._errors = _in_turn(times, signals)

    def part(self, first: int, last: int) -> Recording:
        """Samples `first` to `last` - 1, without the truth."""
        recording = self._source.part(first, last).ordered(self._tree)
        samples = np.clip(np.arange(first, last), self._at[0], self._at[-1])
        errors = CubicSpline(self._at, self._errors)(samples)
        changed: Any = {self._signal: recording.measured(self._signal) - errors}
        return replace(recording, **changed)


def _in_turn(
    times: Sequence[Indices], signals: Sequence[Array]
) -> tuple[Indices, Array]:
    """Instants in order, each once, and signals; of two windows the later one's."""
    at = np.concatenate(times[::-1])
    at, first = np.unique(at, return_index=True)
    return at, np.concatenate(signals[::-1])[first]


@stage("model errors")
def find_model_errors(
    problem: Problem,
    source: Source,
    values: Array,
    estimated: Collection[str] = (),
    prior: Gaussian | None = None,
    among: Collection[str] | None = None,
) -> ModelErrors | None:
    """Model errors that the residuals of an estimate show; None for none.

    Args:
        problem: Its terms and filters are chosen; rows are filtered.
        source: The recording, errors of the sensors taken back.
        values: Of the unknowns, by the estimate, (p,).
        estimated: Terms of sensors' errors that are estimated.
        prior: Of the first unknowns, before the data; None for none.
        among: Kinds that are sought; default all.
    """
    known = _prior_rows(prior, len(values))
    rows = error_rows(problem, source, values, known)
    if rows.used.sum(axis=1).max() < FEWEST:
        return None
    families = [
        family
        for family in model_error_families()
        if problem.method in family.methods
        and family.kind not in estimated
        and (among is None or family.kind in among)
        and family.applies(rows.linearizations[0])
    ]
    beside = [SensorFamily(e) for e in estimable_errors() if e.term in estimated]
    own = [each for each in beside if problem.method in each.methods]
    given, kept = _beside(rows, families, own, known)
    selection = Selector(given, families, rows.encoder_share).select()
    if not selection.variances:
        return None
    return _model_errors(rows, families, selection, kept)


def _beside(
    rows: ErrorRows,
    families: Sequence[ModelErrorFamily],
    own: Sequence[ModelErrorFamily],
    known: Array,
) -> tuple[RegressionRows, dict[str, Indices]]:
    """White rows of unknowns, among them those of sensors, and families; alternatives kept.

    Args:
        rows: Of the robot's unknowns.
        families: That are sought.
        own: Sensors' errors that are estimated.
        known: Of the robot's unknowns before the data, (r, p + 1).
    """
    columns, kept = rows.families([*families, *own])
    others = [columns.pop(each.kind) for each in own]
    unknowns = np.concatenate([rows.whitened(rows.columns), *others], axis=2)
    more = unknowns.shape[2] + 1 - known.shape[1]
    known = np.insert(known, [-1] * more, 0.0, axis=1)
    measured = rows.whitened(rows.measured[..., None])[..., 0]
    used = np.asarray(unknowns.any(axis=2))
    return RegressionRows(unknowns, measured, used, columns, known), kept


def _prior_rows(prior: Gaussian | None, count: int) -> Array:
    """Rows of unit noise, (r, p + 1), that know as much as a prior of the first unknowns."""
    if prior is None:
        return np.zeros((0, count + 1))
    scale = np.sqrt(np.maximum(np.diagonal(prior.covariance), TINY))
    sizes, axes = eigh(prior.covariance / np.outer(scale, scale))
    seen = sizes > KNOWN
    root = (axes[:, seen] / np.sqrt(sizes[seen])).T / scale
    rows = np.zeros((len(root), count + 1))
    rows[:, : len(scale)], rows[:, -1] = root, root @ prior.values
    return rows


def _model_errors(
    rows: ErrorRows,
    families: Sequence[ModelErrorFamily],
    selection: Selection,
    kept: Mapping[str, Indices],
) -> ModelErrors:
    """Estimates of the selected families."""
    by_kind, tree = {each.kind: each for each in families}, rows.linearizer.problem.tree
    correction = _correction(rows, selection, kept)
    count = rows.columns.shape[2]
    effect = ModelErrorEffect(correction.spread, *_reduced(selection.products, count))
    return ModelErrors(
        tuple(_estimate_of(selection, by_kind[kind], tree) for kind in selection.gains),
        correction,
        effect,
        selection.taken,
        rows.linearizer.values,
    )


def _correction(
    rows: ErrorRows, selection: Selection, kept: Mapping[str, Indices]
) -> ModelErrorCorrection:
    """Coefficients of the selected families; zero of those that are not taken out."""
    products, solution, kinds = (
        selection.products,
        selection.solution,
        tuple(selection.variances),
    )
    p = products.p
    counts = [len(products.places[kind]) for kind in kinds]
    taken = np.repeat([kind in selection.taken for kind in kinds], counts)
    named = np.repeat([selection.gains[kind] >= SURE for kind in kinds], counts)
    coefficients = np.where(taken, solution.values[p:], 0.0)
    variance = np.repeat([*selection.variances.values()], counts)
    spread = np.diag(np.where(named, 0.0, variance))
    spread += np.outer(named, named) * solution.covariance[p:, p:]
    # of what is taken out a part is doubted, of what is named else all
    doubted = np.where(named, solution.values[p:], 0.0) * np.where(taken, DOUBT, 1.0)
    spread += np.outer(doubted, doubted)
    none = np.zeros(0, np.intp)
    return ModelErrorCorrection(
        families=kinds,
        counts=tuple(counts),
        columns=tuple(tuple(kept.get(kind, none).tolist()) for kind in kinds),
        coefficients=coefficients,
        spread=spread,
        gain=np.zeros((rows.columns.shape[2], len(coefficients))),
        sizes=rows.linearizations[0].sizes,
    )


def _reduced(products: ProjectedRows, count: int) -> tuple[Array, Array]:
    """Information of data on the robot's unknowns, (p, p), and products with families, (p, k).

    Args:
        products: Of all unknowns and families.
        count: p, of the robot's unknowns, which come first.
    """
    known = products.rows.prior[:, :-1]
    information, cross = products.information - known.T @ known, products.cross
    if products.p == count:
        return information, cross
    own, others = slice(count), slice(count, None)
    across = np.concatenate([information[others, own], cross[others]], axis=1)
    moved = information[own, others] @ scaled_solve(information[others, others], across)
    return information[own, own] - moved[:, own], cross[own] - moved[:, others]


def _estimate_of(
    selection: Selection, family: ModelErrorFamily, tree: Tree
) -> ModelErrorEstimate:
    """What a family is to a person, and its coefficients."""
    products, solution = selection.products, selection.solution
    place = products.places[family.kind]
    at = products.p + place
    values, covariance = solution.values[at], solution.covariance[np.ix_(at, at)]
    effect, share = _effect(selection, family.kind, values)
    pairs = zip(
        family.numbers(tree), values, np.sqrt(np.diagonal(covariance)), strict=False
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
        named=selection.gains[family.kind] >= SURE,
        corrected=family.kind in selection.taken,
        effect=effect,
        share=share,
        coefficients=tuple(coefficients),
    )


def _effect(selection: Selection, kind: str, part: Array) -> tuple[Array, Array]:
    """Rms of a family's part beside the parameters, and over that of the residual, (C,) each."""
    products = selection.products
    rows, total = products.rows, products.noise.total
    signals = np.stack([rows.families[kind] @ part, rows.measured], axis=2)
    scale = (rows.used / total[:, None])[..., None]
    unknowns, scaled = (
        (each * scale).reshape(-1, each.shape[2]) for each in (rows.columns, signals)
    )
    imitated = np.linalg.lstsq(unknowns, scaled, KNOWN)[0]
    left = (signals - rows.columns @ imitated) * rows.used[..., None]
    rms = np.sqrt((left**2).sum(axis=1) / rows.count[:, None])
    return rms[:, 0], rms[:, 0] / np.maximum(rms[:, 1], TINY)
