"""Traces that faults of the instrument leave in the residuals, told from noise.

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
from scipy import special

from testbed.arrays import Array
from testbed.blas import eigh
from testbed.identification.noise.autoregression import Autoregression
from testbed.identification.noise.fits import whitened_fit
from testbed.identification.noise.lagged_products import LaggedProducts
from testbed.identification.noise.replicas import Replicas

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


def maps_of(given: LaggedProducts, question: Question) -> tuple[Array, Array]:
    """How columns and ones make up those of the tests, and independent ones of the same space.

    Args:
        given: Products of the question's columns, residuals and ones.
        question: Which columns are what.

    Returns:
        A constant of every channel, then the columns, (C, q + 1, C + q); independent
        combinations of these, (C, q + 1, r).
    """
    channels, q = given.products.shape[1], question.columns
    whole = np.zeros((channels, q + 1, channels + q))
    whole[:, :q, channels:] = np.eye(q)
    whole[np.arange(channels), q, np.arange(channels)] = 1.0
    squares = given.at_once.carrying(whole).products[0, :, :-2, :-2].sum(axis=0)
    return whole, whole @ _independent(squares, channels + question.base)


def traces(
    whole: LaggedProducts, independent: LaggedProducts, question: Question, order: int | None = None
) -> tuple[list[Trace], Autoregression]:
    """What the residuals hold of each kind of fault, and the noise beside all of them.

    Args:
        whole: Products of constants and the question's columns, residuals and ones.
        independent: Of independent combinations of these columns, residuals and ones.
        question: Which columns are what.
        order: Of the noise; None for the best.
    """
    channels = whole.products.shape[1]
    found = whitened_fit(independent, order)
    white = whole.whitened(found.noise.coefficients)
    squares = np.tensordot(1 / found.noise.sigma**2, white, 1)[:-1, :-1]
    columns = independent.products.shape[2] - 2
    order = found.noise.order
    free = max((whole.after(order) - order) * channels - columns, 1)
    return _tests(squares, question, question.base + channels, free), found.noise


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
    told = spread > IMITATED
    return np.asarray(axes[:, told] / np.sqrt(spread[told]))


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


class Clues:
    """Traces in the residuals beside those in replicas of their noise."""

    def __init__(self, given: LaggedProducts, question: Question) -> None:
        """Look at the residuals, if they can answer.

        Args:
            given: Products of the question's columns, residuals and ones.
            question: Which columns are what.
        """
        self._question, self._replicas = question, None
        if question.answerable(given):
            self._whole, self._independent = maps_of(given, question)
            whole, independent = given.carrying(self._whole), given.carrying(self._independent)
            self._traces, noise = traces(whole, independent, question)
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

    def found(self, lead: Array) -> tuple[tuple[Trace, float], ...]:
        """Traces of each kind, shifts as those of the parameters, and their chances in noise.

        Args:
            lead: How the unknowns that come first make up the parameters, (p, p).
        """
        if self._replicas is None:
            return ()
        both = zip(*map(self._replicas.each, (self._whole, self._independent)), strict=True)
        made = [traces(all_of, own, self._question, self._order)[0] for all_of, own in both]
        moved = [replace(t, shift=lead @ t.shift[: lead.shape[1]]) for t in self._traces]
        return tuple(zip(moved, calibrated(self._traces, made), strict=True))
