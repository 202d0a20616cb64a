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

import numpy as np
from scipy import linalg, special

from testbed.arrays import Array
from testbed.blas import eigh
from testbed.identification.noise.autoregression import Autoregression
from testbed.identification.noise.fits import whitened_fits
from testbed.identification.noise.lagged_products import LaggedProducts, Whitened
from testbed.identification.noise.replicas import Replicas
from testbed.stages import stage

IMITATED = 1e-9
"""Share of a column's square that others leave of it if they imitate it."""

FREE = 2
"""Times as many rows, of all channels, as columns that the tests need."""

PRIOR = 24.0
"""Weight of the mean over all kinds in each one's calibration, in degrees of freedom."""


@dataclass(frozen=True, eq=False)
class Trace:
    """What the residuals hold of one kind of fault.

    Attributes:
        square: Of the residuals' squares it explains so much, in units of the noise's variance.
        count: Independent columns k.
        free: Degrees of freedom of the noise.
        size: The fault's numbers, (k',) in their own units.
        shift: By how much the unknowns would change if they were estimated, (m,).
    """

    square: float
    count: int
    free: int
    size: Array
    shift: Array

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
    channels, rest = given.products.shape[1], np.eye(given.responses + 1)
    fits = whitened_fits(given.combined(linalg.block_diag(independent, rest)), order, quick=quick)
    noises = [fit.noise for fit in fits]
    white = Whitened(given, np.stack([noise.coefficients for noise in noises]))
    squares = white.sums(np.stack([noise.sigma for noise in noises]) ** -2.0)
    after = given.after(noises[0].order) - noises[0].order
    free = max(after * channels - independent.shape[1], 1)
    constants_first = np.roll(np.arange(given.unknowns), channels)
    answers = []
    for response, (each, noise) in enumerate(zip(squares, noises, strict=True)):
        which = [*constants_first, given.unknowns + response]
        tests = _tests(each[which][:, which], question, question.base + channels, free)
        answers.append((tests, noise))
    return answers


def independent_columns(given: LaggedProducts, question: Question) -> Array:
    """Combinations of columns and constants that none of the others make up, (q, r).

    Args:
        given: Products of the question's columns, a constant of every channel, residuals and ones.
        question: Which columns are what.
    """
    q, channels = given.unknowns, given.products.shape[1]
    squares = np.roll(given.products[0, :, :q, :q].sum(axis=0), channels, axis=(0, 1))
    return np.roll(_independent(squares, channels + question.base), -channels, axis=0)


def _beside(squares: Array, base: int) -> tuple[Array, Array, Array]:
    """Orthonormal combinations of the base; what the others share with them; and what they do not.

    Args:
        squares: Products of columns of length one, (q, q).
        base: How many come first.
    """
    first = _orthonormal(squares[:base, :base])
    across = first.T @ squares[:base, base:]
    return first, across, squares[base:, base:] - across.T @ across


def _independent(squares: Array, base: int) -> Array:
    """Combinations of columns that are orthonormal; those after the base beside it, (q, r)."""
    scale = _scales(squares)
    first, across, left = _beside(squares * np.outer(scale, scale), base)
    rest = _orthonormal(left)
    found = np.zeros((len(scale), first.shape[1] + rest.shape[1]))
    found[:base, : first.shape[1]] = first
    found[base:, first.shape[1] :] = rest
    found[:base, first.shape[1] :] = -first @ across @ rest
    return np.asarray(scale[:, None] * found)


def _scales(squares: Array) -> Array:
    """What makes columns of length one; zero columns stay."""
    length = np.sqrt(np.maximum(np.diagonal(squares), 0.0))
    return np.asarray(1 / np.where(length > 0, length, 1.0))


def _orthonormal(squares: Array) -> Array:
    """T with T' squares T = 1, of the directions that are no combinations of others."""
    spread, axes = eigh((squares + squares.T) / 2)
    identifiable = spread > IMITATED
    return np.asarray(axes[:, identifiable] / np.sqrt(spread[identifiable]))


def _tests(squares: Array, question: Question, base: int, free: int) -> list[Trace]:
    """All kinds', from products of the base's columns, the kinds' and the residuals."""
    scale = _scales(squares)
    scale[-1] = 1.0
    first, across, left = _beside(squares * np.outer(scale, scale), base)
    every = _orthonormal(left[:-1, :-1])
    variance = (left[-1, -1] - float(np.sum((every.T @ left[:-1, -1]) ** 2))) / free
    variance = max(variance, float(np.finfo(float).tiny))
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
            )
        )
    return found


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
        self._question, self._replicas = question, None
        if question.answerable(given):
            self._constants = np.eye(given.products.shape[1])
            whole = given.with_constants(self._constants)
            self._independent = independent_columns(whole, question)
            ((self._traces, noise),) = traces(whole, self._independent, question)
            self._order = noise.order
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
        if self._replicas is None:
            return ()
        given = self._replicas.products.with_constants(self._constants)
        asked = given, self._independent, self._question, self._order
        made = [each for each, _ in traces(*asked, quick=True)]
        moved = [replace(t, shift=lead @ t.shift[: lead.shape[1]]) for t in self._traces]
        return tuple(zip(moved, calibrated(self._traces, made), strict=True))
