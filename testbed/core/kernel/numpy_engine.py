"""The same sweep by NumPy and the recursion of `dynamics`: for small jobs, and as a witness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion, linear
from testbed.core.kernel.layout import Layout
from testbed.core.kernel.records import (
    LARGEST_REST,
    LARGEST_VARIANCE,
    REST_VARIANCE,
    Block,
    Rows,
    Signals,
    Sums,
    blocks,
    sums_for,
)
from testbed.core.robot.friction import BY_LOAD, JointTerm
from testbed.core.robot.shafts import shares

SAMPLES = 256
"""Samples taken at once: what a few bodies make of them fits into a cache."""


def workspace(layout: Layout, signals: Signals) -> None:
    """Room of this engine: none."""


def rows(layout: Layout, signals: Signals, work: None = None) -> list[Block]:
    """A window's rows.

    Args:
        layout: The rows.
        signals: The window.
        work: Room of this engine: none.
    """
    parts = blocks(signals, layout.rows.block)
    return [_block(layout, part, first) for first, part in parts]


def sweep(layout: Layout, signals: Signals, given: list[Block]) -> Sums:
    """Products of a window's rows.

    Args:
        layout: The rows.
        signals: The window.
        given: Its `rows`, of whichever engine.
    """
    sums = sums_for(layout.rows)
    for values in (
        signals.position,
        signals.velocity,
        signals.acceleration,
        signals.measured,
    ):
        sums.squares[...] += np.vdot(values, values)
    for block in given:
        sums.used[...] += block.used
        _products(layout.rows, block.rows, sums)
    return sums


def _block(layout: Layout, signals: Signals, number: int) -> Block:
    half = len(signals.weights) // 2
    begin, span = (
        signals.start - half,
        (signals.number - 1) * signals.step + 2 * half + 1,
    )
    z = np.zeros((layout.rows.slots, signals.number))
    rests = np.zeros(
        (layout.width, signals.number, signals.number) if signals.deadband > 0 else 0
    )
    for at in range(0, span, SAMPLES):
        some = min(SAMPLES, span - at)
        motion = motion_of(signals, begin + at, some)
        y = _unfiltered(layout, signals, begin + at, motion)
        first, last = (
            (at - 2 * half - 1) // signals.step + 1,
            (at + some - 1) // signals.step + 1,
        )
        reached = slice(max(first, 0), min(last, signals.number))
        offset = (
            at
            + np.arange(some)
            - np.arange(signals.number)[reached, None] * signals.step
        )
        inside = (offset >= 0) & (offset < len(signals.weights))
        weights = np.where(inside, signals.weights[np.where(inside, offset, 0)], 0.0)
        z[:, reached] += y @ weights.T
        if signals.rest_reach:
            weights = (np.abs(offset - half) <= signals.rest_reach).astype(np.float64)
        for own, speed in zip(rests, np.abs(motion.qd.T), strict=False):
            at_rest = weights[:, speed <= signals.deadband]
            own[reached, reached] += at_rest @ at_rest.T
    used = np.full(layout.width, signals.number, dtype=np.float64)
    for c, own in enumerate(rests):
        near, first = np.flatnonzero(own.diagonal()), layout.rows.start[c]
        slots = slice(first, first + layout.rows.width[c])
        counts = np.zeros(len(near), dtype=np.bool_)
        if not signals.rest_reach:
            share = own[np.ix_(near, near)] / (signals.weights @ signals.weights)
            z[slots, near], counts = _whitened(z[slots, near], share)
        z[slots, near[~counts]] = 0.0
        used[c] -= np.sum(~counts)
    return Block(number, z, used)


def _whitened(z: Array, rests: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Rows, (slots, k), whitened of what friction at rest adds to their noise, and which count.

    Args:
        z: The rows.
        rests: What each shares with each at rests of its joint, of its square, (k, k).
    """
    root = np.linalg.cholesky(np.eye(len(rests)) + REST_VARIANCE * rests)
    counts = np.diagonal(root) ** 2 < 1 + LARGEST_VARIANCE
    counts &= np.diagonal(rests) < LARGEST_REST
    return solve_triangular(root, z.T, lower=True).T, counts


def motion_of(
    signals: Signals, first: int, count: int, stride: int = 1, rate: float = 1.0
) -> Motion:
    """Coordinates at every so many samples, by convolution of the positions where need be.

    Args:
        signals: The window's.
        first: Number of the first sample.
        count: How many instants.
        stride: Samples from one to the next.
        rate: Samples a second [Hz].
    """
    time, last = np.arange(count) * stride / rate, first + (count - 1) * stride + 1
    if len(signals.velocity):
        part = slice(first, last, stride)
        motion = (
            signals.position[part],
            signals.velocity[part],
            signals.acceleration[part],
        )
        return Motion(time, *motion)
    half = signals.taps.shape[1] // 2
    around = signals.position[first - half : last + half]
    windows = np.lib.stride_tricks.sliding_window_view(around, 2 * half + 1, axis=0)[
        ::stride
    ]
    return Motion(time, *(windows @ taps for taps in signals.taps))


def _unfiltered(layout: Layout, signals: Signals, first: int, motion: Motion) -> Array:
    """Rows at consecutive samples, (slots, samples)."""
    joints, base = linear(layout.tree, motion, layout.theta, layout.gravity)
    phi = joints if layout.model == "dynamic" else base  # (samples, channels, columns)
    turn = shares(layout.tree)
    turning = motion.qd, motion.qdd
    if layout.tree.shafts:
        turning = motion.qd @ turn.T, motion.qdd @ turn.T
    own = {term.law: term.law.columns(*turning) for term in layout.terms}
    by_load = len(signals.load) and any(term.law.by in BY_LOAD for term in layout.terms)
    load = phi @ signals.load if by_load else np.zeros(phi.shape[:2])
    smooth = _smoothed(layout, signals, first, motion.samples) if by_load else load
    y = np.zeros((layout.rows.slots, motion.samples))
    for c, columns in enumerate(layout.channels):
        at, bodies = layout.rows.start[c], columns[columns < phi.shape[2]]
        y[at : at + len(bodies)] = phi[:, c, bodies].T
        for k, column in enumerate(columns[len(bodies) :]):
            term = layout.terms[column - phi.shape[2]]
            y[at + len(bodies) + k] = turn[term.joint, c] * own[term.law][:, term.joint]
            if term.law.by:
                y[at + len(bodies) + k] *= _varying(
                    signals, term, first, load[:, c], smooth[:, c]
                )
        part = slice(first, first + motion.samples)
        y[layout.rows.measured[c]] = signals.measured[part, c]
        if len(signals.counts):
            y[at : at + layout.rows.width[c]] *= signals.counts[part, c]
    return y


def _smoothed(layout: Layout, signals: Signals, first: int, count: int) -> Array:
    """Means of the load around each sample, (M, n): as far as its noise hangs together."""
    half = signals.taps.shape[1] // 2
    reach = max(half, len(signals.weights) // 4) if len(signals.weights) > 1 else 0
    low = max(first - reach, half)
    high = min(first + count + reach, len(signals.position) - half)
    motion = motion_of(signals, low, high - low)
    load = linear(layout.tree, motion, layout.theta, layout.gravity)[0] @ signals.load
    window = np.hanning(2 * reach + 3)[1:-1]
    part = slice(reach + first - low, reach + first - low + count)
    weight = np.convolve(np.ones(len(load)), window)[part]
    return np.array([np.convolve(column, window)[part] / weight for column in load.T]).T


def _varying(
    signals: Signals, term: JointTerm, first: int, load: Array, smooth: Array
) -> Array | float:
    """What multiplies the column of a law that depends on more than the motion, (count,)."""
    if term.law.by in BY_LOAD:
        return BY_LOAD[term.law.by](load, smooth)
    if not len(signals.varying):
        return 0.0
    column = 0 if term.law.by == "time" else 1 + term.joint
    return signals.varying[first : first + len(load), column]


def _products(rows: Rows, z: Array, sums: Sums) -> None:
    for slot, width, at in zip(rows.start, rows.width, rows.group_gram, strict=True):
        group = z[slot : slot + width]
        sums.products[at : at + width**2] += (group @ group.T).ravel()
