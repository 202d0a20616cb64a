"""Regressor rows and row products, computed by NumPy and the recursion of `dynamics`.

This engine is for small problems, for joint laws without a compiled column, and for checks of the
compiled kernel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion, linear_inverse_dynamics
from testbed.core.kernel.layout import Layout
from testbed.core.kernel.records import (
    MAX_REST_SHARE,
    MAX_REST_VARIANCE,
    REST_VARIANCE,
    Block,
    RowArrays,
    SignalWindow,
    Sums,
    signal_blocks,
    zero_sums,
)
from testbed.core.robot.friction import LOAD_MULTIPLIERS, JointTerm
from testbed.core.robot.shafts import transmission_matrix

BLOCK_SAMPLES = 256
"""Number of samples processed at once, so that the data of a few bodies fit into a cache."""


def workspace(layout: Layout, signals: SignalWindow) -> None:
    """Workspace of this engine, which needs none: None."""


def rows(layout: Layout, signals: SignalWindow, work: None = None) -> list[Block]:
    """Filtered regressor rows of a window, in blocks of at most `layout.rows.block` rows.

    Args:
        layout: Layout of the rows.
        signals: The window.
        work: Not used; part of the interface shared with the compiled engine.
    """
    parts = signal_blocks(signals, layout.rows.block)
    return [_filtered_block(layout, part, first) for first, part in parts]


def row_products(
    layout: Layout, signals: SignalWindow, row_blocks: list[Block]
) -> Sums:
    """Gram matrices of channel columns over the rows of a window, and valid row counts.

    Rows are valid unless they are excluded because the channel's joint is nearly at rest.

    Args:
        layout: Layout of the rows.
        signals: The window.
        row_blocks: Rows of the window, computed by either engine.
    """
    sums = zero_sums(layout.rows)
    for values in (
        signals.position,
        signals.velocity,
        signals.acceleration,
        signals.measured,
    ):
        sums.squares[...] += np.vdot(values, values)
    for block in row_blocks:
        sums.row_counts[...] += block.counted
        _add_products(layout.rows, block.rows, sums)
    return sums


def _filtered_block(layout: Layout, signals: SignalWindow, number: int) -> Block:
    """Filtered rows of one block; rows near rest are whitened or set to zero.

    Args:
        layout: Layout of the rows.
        signals: Part of the window with the rows of the block.
        number: Index of the first row in the window.
    """
    half = len(signals.weights) // 2
    begin, span = (
        signals.start - half,
        (signals.row_count - 1) * signals.step + 2 * half + 1,
    )
    z = np.zeros((layout.rows.slots, signals.row_count))
    rest_products_of_channels = np.zeros(
        (layout.channel_count, signals.row_count, signals.row_count)
        if signals.deadband > 0
        else 0
    )
    for at in range(0, span, BLOCK_SAMPLES):
        count = min(BLOCK_SAMPLES, span - at)
        motion = window_motion(signals, begin + at, count)
        y = _unfiltered_rows(layout, signals, begin + at, motion)
        first, last = (
            (at - 2 * half - 1) // signals.step + 1,
            (at + count - 1) // signals.step + 1,
        )
        row_range = slice(max(first, 0), min(last, signals.row_count))
        offset = (
            at
            + np.arange(count)
            - np.arange(signals.row_count)[row_range, None] * signals.step
        )
        inside = (offset >= 0) & (offset < len(signals.weights))
        weights = np.where(inside, signals.weights[np.where(inside, offset, 0)], 0.0)
        z[:, row_range] += y @ weights.T
        if signals.rest_reach:
            weights = (np.abs(offset - half) <= signals.rest_reach).astype(np.float64)
        for channel_rests, speed in zip(
            rest_products_of_channels, np.abs(motion.qd.T), strict=False
        ):
            at_rest = weights[:, speed <= signals.deadband]
            channel_rests[row_range, row_range] += at_rest @ at_rest.T
    used = np.full(layout.channel_count, signals.row_count, dtype=np.float64)
    for c, channel_rests in enumerate(rest_products_of_channels):
        affected, first = np.flatnonzero(channel_rests.diagonal()), layout.rows.start[c]
        slots = slice(first, first + layout.rows.width[c])
        counts = np.zeros(len(affected), dtype=np.bool_)
        if not signals.rest_reach:
            rest_products = channel_rests[np.ix_(affected, affected)] / (
                signals.weights @ signals.weights
            )
            z[slots, affected], counts = _whiten_rests(
                z[slots, affected], rest_products
            )
        z[slots, affected[~counts]] = 0.0
        used[c] -= np.sum(~counts)
    return Block(number, z, used)


def _whiten_rests(z: Array, rests: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Rows whitened for friction at rest, (s, k), and mask of the valid rows, (k,).

    A row is valid if less than MAX_REST_SHARE of its squared filter weights is at samples at rest,
    and if its variance due to friction, conditional on earlier rows, is below MAX_REST_VARIANCE.

    Args:
        z: k rows of s elements, (s, k).
        rests: Products of the filter weights of each pair of rows at samples at rest, relative to
            the sum of the squared weights of a row, (k, k).
    """
    root = np.linalg.cholesky(np.eye(len(rests)) + REST_VARIANCE * rests)
    counts = np.diagonal(root) ** 2 < 1 + MAX_REST_VARIANCE
    counts &= np.diagonal(rests) < MAX_REST_SHARE
    return solve_triangular(root, z.T, lower=True).T, counts


def window_motion(
    signals: SignalWindow, first: int, count: int, stride: int = 1, rate: float = 1.0
) -> Motion:
    """Motion at equidistant samples of a window, by convolution of positions if necessary.

    Args:
        signals: The window.
        first: Index of the first sample.
        count: Number of selected samples.
        stride: Number of recorded samples from one selected sample to the next.
        rate: Sampling rate [Hz].
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


def _unfiltered_rows(
    layout: Layout, signals: SignalWindow, first: int, motion: Motion
) -> Array:
    """Unfiltered rows at consecutive samples, (s, samples), with s elements per row.

    Args:
        layout: Layout of the rows.
        signals: The window.
        first: Index of the first sample.
        motion: Motion at the samples.
    """
    joints, base = linear_inverse_dynamics(
        layout.tree, motion, layout.theta, layout.gravity
    )
    phi = joints if layout.model == "torque" else base  # (samples, channels, columns)
    shaft_ratios = transmission_matrix(layout.tree)
    shaft_motion = motion.qd, motion.qdd
    if layout.tree.shafts:
        shaft_motion = motion.qd @ shaft_ratios.T, motion.qdd @ shaft_ratios.T
    law_columns = {term.law: term.law.columns(*shaft_motion) for term in layout.terms}
    by_load = len(signals.load) and any(
        term.law.by in LOAD_MULTIPLIERS for term in layout.terms
    )
    load = phi @ signals.load if by_load else np.zeros(phi.shape[:2])
    smooth = _smoothed_load(layout, signals, first, motion.samples) if by_load else load
    y = np.zeros((layout.rows.slots, motion.samples))
    for c, columns in enumerate(layout.channel_columns):
        at, bodies = layout.rows.start[c], columns[columns < phi.shape[2]]
        y[at : at + len(bodies)] = phi[:, c, bodies].T
        for k, column in enumerate(columns[len(bodies) :]):
            term = layout.terms[column - phi.shape[2]]
            y[at + len(bodies) + k] = (
                shaft_ratios[term.joint, c] * law_columns[term.law][:, term.joint]
            )
            if term.law.by:
                y[at + len(bodies) + k] *= _law_factor(
                    signals, term, first, load[:, c], smooth[:, c]
                )
        part = slice(first, first + motion.samples)
        y[layout.rows.measured[c]] = signals.measured[part, c]
        if len(signals.sample_mask):
            y[at : at + layout.rows.width[c]] *= signals.sample_mask[part, c]
    return y


def _smoothed_load(
    layout: Layout, signals: SignalWindow, first: int, count: int
) -> Array:
    """Load (torques of the bodies) averaged with a Hann window around each sample, (count, n).

    The length of the Hann window is the correlation length of the position noise.

    Args:
        layout: Layout of the rows.
        signals: The window.
        first: Index of the first sample.
        count: Number of samples.
    """
    half = signals.taps.shape[1] // 2
    reach = max(half, len(signals.weights) // 4) if len(signals.weights) > 1 else 0
    low = max(first - reach, half)
    high = min(first + count + reach, len(signals.position) - half)
    motion = window_motion(signals, low, high - low)
    load = (
        linear_inverse_dynamics(layout.tree, motion, layout.theta, layout.gravity)[0]
        @ signals.load
    )
    window = np.hanning(2 * reach + 3)[1:-1]
    part = slice(reach + first - low, reach + first - low + count)
    weight = np.convolve(np.ones(len(load)), window)[part]
    return np.array([np.convolve(column, window)[part] / weight for column in load.T]).T


def _law_factor(
    signals: SignalWindow, term: JointTerm, first: int, load: Array, smooth: Array
) -> Array | float:
    """Factor of the column of a law that depends on load, time or temperature, (count,).

    The factor is zero if the window has no times and temperatures.

    Args:
        signals: The window.
        term: Joint term with the law.
        first: Index of the first sample.
        load: Torque of the bodies at the term's channel, (count,) [N m or N].
        smooth: Load averaged over time, (count,).
    """
    if term.law.by in LOAD_MULTIPLIERS:
        return LOAD_MULTIPLIERS[term.law.by](load, smooth)
    if not len(signals.covariates):
        return 0.0
    column = 0 if term.law.by == "time" else 1 + term.joint
    return signals.covariates[first : first + len(load), column]


def _add_products(rows: RowArrays, z: Array, sums: Sums) -> None:
    """Add the Gram matrix of each channel's columns to the sums."""
    for slot, width, at in zip(rows.start, rows.width, rows.group_gram, strict=True):
        group = z[slot : slot + width]
        sums.products[at : at + width**2] += (group @ group.T).ravel()
