"""Computation of filtered regressor rows and their products over a window of samples.

Columns are the regressor columns and the measurement of each channel (also called slots). They are
stored one after the other, D numbers apart, with one number per sample or row. X, Y are arrays of
columns, n is the number of samples or rows, G the array of products, ld the distance between
consecutive rows of G.
"""

from __future__ import annotations

from testbed.core.kernel.compiler import (
    HAS_WIDE_VECTORS,
    compiled_entry,
    compiled_function,
    inline_sum,
    llvm_inline,
    numba_inline,
)
from testbed.core.kernel.records import (
    FILTER_SAMPLES,
    MAX_REST_SHARE,
    MAX_REST_VARIANCE,
    REST_VARIANCE,
    D,
)
from testbed.core.kernel.rows import dot, fill_rows


@inline_sum
def slot_values(X, k):
    """Values of four consecutive columns at sample k."""
    return X[k], X[D + k], X[2 * D + k], X[3 * D + k]


@inline_sum
def add_products_of_four(a, x, y):
    """Four updated sums `a + x * y`, for four values y."""
    return a[0] + x * y[0], a[1] + x * y[1], a[2] + x * y[2], a[3] + x * y[3]


@inline_sum
def products_with_one(E, X, n):
    """Inner products of one column E with four columns X over n samples."""
    a = (0.0, 0.0, 0.0, 0.0)
    for k in range(n):
        a = add_products_of_four(a, E[k], slot_values(X, k))
    return a


@inline_sum
def products_of_four(X, Y, n):
    """Inner products X_i . Y_j of four columns X and four columns Y over n samples.

    Once the function is inlined, the compiler drops unused results.
    """
    a = b = c = d = (0.0, 0.0, 0.0, 0.0)
    for k in range(n):
        x, y = slot_values(X, k), slot_values(Y, k)
        a, b, c, d = (
            add_products_of_four(a, x[0], y),
            add_products_of_four(b, x[1], y),
            add_products_of_four(c, x[2], y),
            add_products_of_four(d, x[3], y),
        )
    return a, b, c, d


@inline_sum
def add_four(G, at, a):
    """Add four sums a to four consecutive elements of G, starting at index `at`."""
    G[at] += a[0]
    G[at + 1] += a[1]
    G[at + 2] += a[2]
    G[at + 3] += a[3]


@llvm_inline
def tile(X, Y, n, G, at, ld):
    """Add the inner products of four by four columns: `G[at + i ld + j] += X_i . Y_j`."""
    a, b, c, d = products_of_four(X, Y, n)
    add_four(G, at, a)
    add_four(G, at + ld, b)
    add_four(G, at + 2 * ld, c)
    add_four(G, at + 3 * ld, d)


@llvm_inline
def half_tile(X, Y, n, G, at, ld):
    """Add the inner products of two columns X and four columns Y to G."""
    a, b, _, _ = products_of_four(X, Y, n)
    add_four(G, at, a)
    add_four(G, at + ld, b)


@llvm_inline
def split_tile(X, Y, n, G, at, ld):
    """Add the inner products of four by four columns, using at most sixteen vector registers."""
    half_tile(X, Y, n, G, at, ld)
    half_tile(X[2 * D :], Y, n, G, at + 2 * ld, ld)


fitting_tile = tile if HAS_WIDE_VECTORS else split_tile
"""Function for products of four by four columns that suits the processor."""


@llvm_inline
def diagonal_tile(X, n, G, at, ld):
    """Add the lower triangle of the inner products of four columns with each other."""
    a, b, c, d = products_of_four(X, X, n)
    G[at] += a[0]
    at += ld
    G[at] += b[0]
    G[at + 1] += b[1]
    at += ld
    G[at] += c[0]
    G[at + 1] += c[1]
    G[at + 2] += c[2]
    add_four(G, at + ld, d)


@compiled_function
def apply_filter(rows, signals, work, centre, count, at, n):
    """Add the contributions of a chunk of samples to the filtered rows.

    Args:
        rows: Arrays of the rows.
        signals: The window.
        work: Workspace; Y holds the rows at the chunk's samples, Z the filtered rows.
        centre: Sample of the block's first row.
        count: Number of rows of the block.
        at: First sample of the chunk.
        n: Number of samples of the chunk.
    """
    weights, step, Y, H, Z = signals.weights, signals.step, work.Y, work.H, work.Z
    half = len(weights) // 2
    lo = max(0, -((centre + half - at) // step)) // 4 * 4
    hi = min(count, (at + n - 1 + half - centre) // step + 1)
    for r in range(lo, lo + -((lo - hi) // 4) * 4):
        lag = at - centre - r * step + half
        row = H[(r - lo) * D : (r - lo) * D + FILTER_SAMPLES]
        for k in range(FILTER_SAMPLES):
            inside = 0 <= lag + k < len(weights) and k < n and r < count
            row[k] = weights[lag + k] if inside else 0.0
    for s in range(0, rows.slots, 4):
        for r in range(lo, hi, 4):
            y, h = Y[s * D : (s + 4) * D], H[(r - lo) * D : (r - lo + 4) * D]
            fitting_tile(y, h, FILTER_SAMPLES, Z, s * D + r, D)
    if signals.deadband > 0.0:
        mark_rests(rows, signals, work, centre, lo, hi, at, n)


@numba_inline
def mark_rests(rows, signals, work, centre, lo, hi, at, n):
    """Mark rows near samples with the joint at rest, or sum filter weight products.

    If `signals.rest_reach` is positive, rows within this number of samples of a sample at rest are
    marked. Otherwise, the products of the filter weights of each row with those of itself and of
    earlier rows, at samples at rest, are added to G.

    Args:
        rows: Arrays of the rows.
        signals: The window.
        work: Workspace.
        centre: Sample of the block's first row.
        lo: First row to which the chunk contributes.
        hi: Row after the last row to which the chunk contributes.
        at: First sample of the chunk.
        n: Number of samples of the chunk.
    """
    Y, H, G, channels = work.Y, work.H, work.G, len(rows.measured)
    band, reach = len(G) // (channels * D), signals.rest_reach
    for c in range(channels):
        for k in range(n):
            if Y[(rows.slots + c) * D + k] == 0.0:
                continue
            for r in range(hi - lo):
                if reach > 0:
                    if abs(centre + (lo + r) * signals.step - at - k) <= reach:
                        work.Z[(rows.slots + c) * D + lo + r] = 1.0
                elif H[r * D + k] != 0.0:
                    for d in range(min(band, r + 1)):
                        G[(c * band + d) * D + lo + r] += (
                            H[r * D + k] * H[(r - d) * D + k]
                        )


@numba_inline
def whiten_rests(X, G, U, size, count):
    """Whiten the rows of a channel for friction at rest, using a banded Cholesky factor.

    The friction at rest is modelled as white noise of variance REST_VARIANCE per sample, relative
    to the measurement noise. A row is valid if less than MAX_REST_SHARE of its squared filter
    weights is at rest, and if its variance due to friction, conditional on earlier rows, is below
    MAX_REST_VARIANCE.

    Args:
        X: All columns of the channel; multiplied by the inverse of the factor in place.
        G: Products of filter weights at samples at rest, as a band matrix with the diagonal first;
            replaced by the Cholesky factor.
        U: Set to 1 for valid rows and to 0 for the others.
        size: Sum of the squared filter weights.
        count: Number of rows.
    """
    for r in range(count):
        rest_share = G[r] / size
        for j in range(max(0, r - len(G) // D + 1), r + 1):
            covariance = REST_VARIANCE / size * G[(r - j) * D + r]
            for i in range(max(0, r - len(G) // D + 1), j):
                covariance -= G[(r - i) * D + r] * G[(j - i) * D + j]
            G[(r - j) * D + r] = (
                covariance / G[j] if j < r else (1.0 + covariance) ** 0.5
            )
        U[r] = (
            1.0
            if rest_share < MAX_REST_SHARE and G[r] ** 2 < 1 + MAX_REST_VARIANCE
            else 0.0
        )
    for s in range(0, len(X), D):
        for r in range(count):
            for d in range(1, min(len(G) // D, r + 1)):
                X[s + r] -= G[d * D + r] * X[s + r - d]
            X[s + r] /= G[r]


@compiled_function
def weight_rests(rows, signals, work, count, sums):
    """Whiten rows that include friction at rest, and set invalid rows to zero.

    If `signals.rest_reach` is positive, the marked rows are invalid and no row is whitened.

    Args:
        rows: Arrays of the rows.
        signals: The window.
        work: Workspace.
        count: Number of rows of the block.
        sums: Sums of the window; the number of valid rows is added.
    """
    Z, channels, weights = work.Z, len(rows.measured), signals.weights
    for c in range(channels):
        U = Z[(rows.slots + c) * D : (rows.slots + c) * D + count]
        X = Z[rows.start[c] * D : (rows.start[c] + rows.width[c]) * D]
        G = work.G[c * len(work.G) // channels : (c + 1) * len(work.G) // channels]
        for k in range(count):
            U[k] = 1.0 - U[k]  # mask of rest to mask of motion
        if signals.rest_reach == 0 and len(weights) > 1 and dot(G, G, count) > 0.0:
            whiten_rests(X, G, U, dot(weights, weights, len(weights)), count)
        moving = dot(U, U, count)
        sums.row_counts[c] += moving
        if moving < count:
            for s in range(rows.width[c]):
                for k in range(count):
                    X[s * D + k] *= U[k]


@compiled_function
def add_gram(rows, work, count, sums):
    """Add the lower triangle of the Gram matrix of each channel's columns."""
    n, G = -(-count // 8) * 8, sums.products
    for g in range(len(rows.start)):
        p, ld, slot = rows.group_size[g], rows.width[g], rows.start[g]
        X = work.Z[slot * D : (slot + ld) * D]
        for a in range(0, p, 4):
            at = rows.group_gram[g] + a * ld
            for b in range(0, a, 4):
                slots_a, slots_b = X[a * D : (a + 4) * D], X[b * D : (b + 4) * D]
                if p - a == 1:
                    inner_products = products_with_one(slots_a, slots_b, n)
                    for i in range(4):
                        G[at + b + i] += inner_products[i]
                elif p - a == 2:
                    half_tile(slots_a, slots_b, n, G, at + b, ld)
                else:
                    fitting_tile(slots_a, slots_b, n, G, at + b, ld)
            diagonal_tile(X[a * D : (a + 4) * D], n, G, at + a, ld)


@compiled_entry
def sweep(robot, rows, signals, work, sums):
    """Compute all rows, block by block, and their products unless `sums.products` is empty.

    The rows of the last block remain in `work.Z`.
    """
    half = len(signals.weights) // 2
    is_filtered = half > 0
    for first in range(0, signals.row_count, rows.block):
        count = min(rows.block, signals.row_count - first)
        centre = signals.start + first * signals.step
        begin, end = centre - half, centre + (count - 1) * signals.step + half + 1
        if is_filtered:
            work.Z[:] = 0.0
            work.G[:] = 0.0
        for at in range(begin, end, FILTER_SAMPLES if is_filtered else rows.block):
            n = min(FILTER_SAMPLES, end - at) if is_filtered else count
            fill_rows(
                robot, rows, signals, at, n, work, work.Y if is_filtered else work.Z
            )
            if is_filtered:
                apply_filter(rows, signals, work, centre, count, at, n)
        if signals.deadband > 0.0:
            weight_rests(rows, signals, work, count, sums)
        else:
            for c in range(len(sums.row_counts)):
                sums.row_counts[c] += count
        if len(sums.products):
            add_gram(rows, work, count, sums)
