"""Traces that faults of the instrument leave in the residuals, tested against noise.

A fault shows, to first order, as more columns of the equations. If the model is right they
explain no more of the residuals than chance: an F test for every kind of fault. The noise is
found beside all of them together, so that none can hide in it, and the statistics are held
against those of made noise: found noise is whiter than it is, and the tests would see faults
that are not there.

Constants and trends are always beside the parameters: slow noise looks like a drift.

Source    [ET93] for the bootstrap
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import linalg, special

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.base.stages import stage
from testbed.core.estimation.noise.fits import Fits, NoiseFit, whitened_fits
from testbed.core.estimation.noise.lagged_products import (
    Autoregression,
    LaggedProducts,
    LaggedSums,
    NoiseMaker,
    Whitened,
)
from testbed.core.estimation.regression.normal_equations import TINY

REPLICAS = 12
"""Replicas of the noise: with all parameters pooled, sigma is found to a few percent."""

SEED = 1996
"""Of the replicas: the same recording gives the same sigma."""


class Replicas:
    """Products of rows with replicas of their noise.

    Of columns with columns they are known from the residuals' own products.
    """

    def __init__(self, noise: Autoregression, known: LaggedProducts, seed: int = SEED) -> None:
        """Nothing yet.

        Args:
            noise: What is to be made.
            known: Products of the rows' columns, residuals and ones.
            seed: Of the replicas.
        """
        self._order = noise.order
        columns = known.unknowns
        self._known = known.up_to(noise.order)
        self._maker = NoiseMaker(noise, REPLICAS, np.random.default_rng(seed))
        self._noise = LaggedSums(noise.order)
        lags, channels = self._known.products.shape[:2]
        self._across = np.zeros((lags, channels, columns + 1, REPLICAS))
        self._before: tuple[Array, Array] | None = None

    def add(self, columns: Array, ones: Array) -> None:
        """Go on with consecutive rows.

        Args:
            columns: Of the unknowns, (C, rows, m).
            ones: Where a row counts, (C, rows).
        """
        noise = self._maker.rows(columns.shape[1]) * ones[..., None]
        self._noise.add(noise)
        now = np.concatenate([columns, ones[..., None]], axis=2), noise
        lags, rows = len(self._across) - 1, columns.shape[1]
        before = self._before or tuple(np.zeros((len(ones), lags, z.shape[2])) for z in now)
        columns, noise = (np.concatenate(each, axis=1) for each in zip(before, now, strict=True))
        around = np.zeros((*noise.shape[:2], lags + 1, REPLICAS))
        for lag in range(lags + 1):  # as a lag's products and their transpose come together only
            late, early = slice(lags, lags + rows), slice(lags - lag, lags - lag + rows)
            around[:, late, lag] += noise[:, early] / 2
            around[:, early, lag] += noise[:, late] / 2
        found = columns.swapaxes(1, 2) @ around.reshape(*noise.shape[:2], -1)
        self._across += np.moveaxis(found.reshape(*found.shape[:2], lags + 1, -1), 2, 0)
        self._before = columns[:, rows:], noise[:, rows:]

    def pause(self) -> None:
        """What comes next does not follow what came last."""
        self._noise.pause()
        self._before = None

    @property
    def products(self) -> LaggedProducts:
        """Products with the replicas in the residuals' place, symmetric those of a lag, too."""
        made, known = self._noise.finish(), self._known
        m = known.unknowns
        own, size = slice(m, m + REPLICAS), m + REPLICAS + 1
        rest = [*range(m), size - 1]  # columns and ones
        products = np.empty((*known.products.shape[:2], size, size))
        for lag, channel in np.ndindex(products.shape[:2]):  # one by one: they fit into a cache
            each, across = products[lag, channel], self._across[lag, channel]
            before = np.delete(np.delete(known.products[lag, channel], m, 0), m, 1)
            each[np.ix_(rest, rest)] = _alike(before)
            each[rest, own], each[own, rest] = across, across.T
            each[own, own] = _alike(made.products[lag, channel])
        first, last = (
            np.concatenate([old[..., :m], new, old[..., -1:]], axis=3)
            for old, new in ((known.first, made.first), (known.last, made.last))
        )
        return LaggedProducts(made.rows, products, first, last, REPLICAS, alike=True)

    @stage("sigma from replicas of noise")
    def factor(self, fits: Fits, lead: Array) -> float:
        """By how much sigma has to be multiplied: at least one.

        Args:
            fits: What found the noise.
            lead: How the rows' unknowns make up the parameters, (p, m).
        """
        return max(1.0, float(np.sqrt(np.mean(self.squares(fits, lead)))))

    def squares(self, fits: Fits, lead: Array) -> Array:
        """Squares of what the replicas make of parameters that are zero, over sigma's, (R, p).

        Args:
            fits: What found the noise.
            lead: How the rows' unknowns make up the parameters, (p, m).
        """
        return np.array([_squares(found, lead) for found in fits(self.products, self._order)])


def _alike(products: Array) -> Array:
    """Half of what a lag's products are and of their transpose."""
    return (products + products.T) / 2


def _squares(found: NoiseFit, lead: Array) -> Array:
    m = lead.shape[1]  # a fit may have unknowns of its own after these
    variance = ((lead @ found.covariance[:m, :m]) * lead).sum(axis=1)
    return np.asarray((lead @ found.values[:m]) ** 2 / np.maximum(variance, TINY))


IMITATED = 1e-9
"""Share of a column's square that others leave of it if they imitate it."""

FREE = 2
"""Times as many rows, of all channels, as columns that the tests need."""

UNCLEAR = 1e-3
"""Chance by the F test above which it is not held against made noise, which raises it only."""

PRIOR = 24.0
"""Weight of the mean over all kinds in each one's calibration, in degrees of freedom."""


class Alone(NamedTuple):
    """One number of a fault, the others as they should be.

    Attributes:
        square: Of the residuals' squares it explains so much, in units of the noise's variance.
        place: Among the fault's numbers.
        size: In its own unit.
        sigma: Of the size.
    """

    square: float
    place: int
    size: float
    sigma: float


@dataclass(frozen=True, eq=False)
class Trace:
    """What the residuals hold of one kind of fault.

    Attributes:
        square: Of the residuals' squares it explains so much, in units of the noise's variance.
        count: Independent columns k.
        free: Degrees of freedom of the noise.
        size: The fault's numbers, (k',) in their own units.
        shift: By how much the unknowns would change if they were estimated, (m,).
        alone: The same of the one number that explains most, and how much that is.
    """

    square: float
    count: int
    free: int
    size: Array
    shift: Array
    alone: Alone

    def chance(self, scale: float) -> float:
        """Probability of a trace as clear as this in noise.

        Args:
            scale: Mean of square / count in noise.
        """
        if not self.count:
            return 1.0
        return float(special.fdtrc(self.count, self.free, self.square / self.count / scale))


@dataclass(frozen=True, eq=False)
class Question:
    """Which columns of the products are what.

    Attributes:
        base: Number of columns that come first: unknowns and trends.
        kinds: Numbers of the columns of each kind of fault, which follow.
    """

    base: int
    kinds: tuple[int, ...]

    @property
    def columns(self) -> int:
        """How many in all, constants aside."""
        return self.base + sum(self.kinds)

    def answerable(self, given: LaggedProducts) -> bool:
        """Whether anything is asked, and there are rows enough."""
        channels = given.products.shape[1]
        least = FREE * (self.columns + channels)
        return bool(self.kinds) and bool(given.rows * channels > least)


def traces(
    given: LaggedProducts,
    independent: Array,
    question: Question,
    order: int | None = None,
    *,
    quick: bool = False,
) -> list[tuple[list[Trace], Autoregression]]:
    """What each response holds of each kind of fault, and the noise beside all of them.

    Args:
        given: Products of the question's columns, a constant of every channel, residuals and ones.
        independent: Independent combinations of columns and constants, (q, r).
        question: Which columns are what.
        order: Of the noise; None for the best.
        quick: As for `whitened_fits`.
    """
    channels = given.products.shape[1]
    lead = linalg.block_diag(independent, np.eye(given.responses + 1))
    noises = [fit.noise for fit in whitened_fits(given, order, quick=quick, lead=lead)]
    white = Whitened(given, np.stack([noise.coefficients for noise in noises]))
    squares = white.sums(np.stack([noise.sigma for noise in noises]) ** -2.0)
    rows = given.after(noises[0].order) - noises[0].order
    free = max(rows * channels - independent.shape[1], 1)
    answers = []
    for response, (each, noise) in enumerate(zip(squares, noises, strict=True)):
        which = [*np.roll(np.arange(given.unknowns), channels), given.unknowns + response]
        part = each[which][:, which]  # constants first
        answers.append((_tests(part, question, question.base + channels, free), noise))
    return answers


def independent_columns(given: LaggedProducts, question: Question) -> Array:
    """Combinations of columns and constants that none of the others make up, orthonormal, (q, r).

    Args:
        given: Products of the question's columns, a constant of every channel, residuals and ones.
        question: Which columns are what.
    """
    q, channels = given.unknowns, given.products.shape[1]
    base = channels + question.base  # constants come first
    squares = np.roll(given.products[0, :, :q, :q].sum(axis=0), channels, axis=(0, 1))
    scale = _scales(squares)
    first, across, left = _beside(squares * np.outer(scale, scale), base)
    rest = _orthonormal(left)
    found = np.zeros((q, first.shape[1] + rest.shape[1]))
    found[:base, : first.shape[1]] = first
    found[base:, first.shape[1] :] = rest
    found[:base, first.shape[1] :] = -first @ across @ rest
    return np.roll(scale[:, None] * found, -channels, axis=0)


def _beside(squares: Array, base: int) -> tuple[Array, Array, Array]:
    """Orthonormal combinations of the base; what the others share with them; and what they do not.

    Args:
        squares: Products of columns of length one, (q, q).
        base: How many come first.
    """
    first = _orthonormal(squares[:base, :base])
    across = first.T @ squares[:base, base:]
    return first, across, squares[base:, base:] - across.T @ across


def _scales(squares: Array) -> Array:
    """What makes columns of length one; zero columns stay."""
    length = np.sqrt(np.maximum(np.diagonal(squares), 0.0))
    return 1 / np.where(length > 0, length, 1.0)


def _orthonormal(squares: Array) -> Array:
    """T with T' squares T = 1, of the directions that are no combinations of others."""
    spread, axes = eigh((squares + squares.T) / 2)
    identifiable = spread > IMITATED
    return axes[:, identifiable] / np.sqrt(spread[identifiable])


def _tests(squares: Array, question: Question, base: int, free: int) -> list[Trace]:
    """All kinds', from products of the base's columns, the kinds' and the residuals."""
    scale = _scales(squares)
    scale[-1] = 1.0
    first, across, left = _beside(squares * np.outer(scale, scale), base)
    every = _orthonormal(left[:-1, :-1])
    variance = (left[-1, -1] - float(np.sum((every.T @ left[:-1, -1]) ** 2))) / free
    variance = max(variance, TINY)
    found, end = [], 0
    for kind in question.kinds:
        own = slice(end, end := end + kind)
        mine = _orthonormal(left[own, own])
        part = mine.T @ left[own, -1]
        size = mine @ part
        shift = -first @ (across[:, own] @ size)
        found.append(
            Trace(
                square=float(part @ part) / variance,
                count=mine.shape[1],
                free=free,
                size=size * scale[base:][own],
                shift=(shift * scale[:base])[base - question.base :],
                alone=_alone(left[own, own], left[own, -1], scale[base:][own], variance),
            )
        )
    return found


def _alone(squares: Array, across: Array, scale: Array, variance: float) -> Alone:
    """Of products of a kind's columns, (k, k), and with the residuals, (k,), beside the base."""
    length = np.diagonal(squares)
    known = length > IMITATED
    explained = np.divide(across**2, length, out=np.zeros(len(length)), where=known)
    k = int(explained.argmax())
    if not known[k]:
        return Alone(0.0, k, 0.0, np.inf)
    size, sigma = np.array([across[k], np.sqrt(variance * length[k])]) * scale[k] / length[k]
    return Alone(float(explained[k]) / variance, k, float(size), float(sigma))


def calibrated(found: Sequence[Trace], made: Sequence[Sequence[Trace]]) -> tuple[float, ...]:
    """Chances of traces, held against those in made noise.

    Args:
        found: In the residuals.
        made: In replicas of their noise.
    """
    squares = np.array([[trace.square for trace in replica] for replica in made])
    counts = np.array([[trace.count for trace in replica] for replica in made], dtype=float)
    pooled = squares.sum() / max(counts.sum(), 1.0)
    scales = (squares.sum(axis=0) + PRIOR * pooled) / (counts.sum(axis=0) + PRIOR)
    return tuple(t.chance(max(1.0, s)) for t, s in zip(found, scales, strict=True))


class ScoreTests:
    """Traces in the residuals beside those in replicas of their noise."""

    def __init__(self, given: LaggedProducts, question: Question) -> None:
        """Look at the residuals, if they can answer.

        Args:
            given: Products of the question's columns, residuals and ones.
            question: Which columns are what.
        """
        self._question, self._replicas, self._traces = question, None, list[Trace]()
        if question.answerable(given):
            self._constants = np.eye(given.products.shape[1])
            whole = given.with_constants(self._constants)
            self._independent = independent_columns(whole, question)
            ((self._traces, noise),) = traces(whole, self._independent, question)
            self._order = noise.order
            if any(trace.chance(1.0) < UNCLEAR for trace in self._traces):
                self._replicas = Replicas(noise, given)

    def add(self, columns: Array, ones: Array, looked_at: bool = True) -> None:
        """Go on with consecutive rows.

        Args:
            columns: Of the question, (C, rows, q).
            ones: Where a row counts, (C, rows).
            looked_at: Whether the rows are.
        """
        if self._replicas is None:
            return
        if looked_at:
            self._replicas.add(columns, ones)
        else:
            self._replicas.pause()

    @stage("tests for faults")
    def found(self, lead: Array) -> tuple[tuple[Trace, float], ...]:
        """Traces of each kind, shifts as those of the parameters, and their chances in noise.

        Args:
            lead: How the unknowns that come first make up the parameters, (p, p).
        """
        moved = [replace(t, shift=lead @ t.shift[: lead.shape[1]]) for t in self._traces]
        if self._replicas is None:
            return tuple((trace, trace.chance(1.0)) for trace in moved)
        given = self._replicas.products.with_constants(self._constants)
        asked = given, self._independent, self._question, self._order
        made = [each for each, _ in traces(*asked, quick=True)]
        return tuple(zip(moved, calibrated(self._traces, made), strict=True))
