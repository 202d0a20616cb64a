"""One sweep over a window: rows, filtered or not, and their products."""

from __future__ import annotations

from testbed.core.kernel.compiler import WIDE, inline, outer, part, plain, summing
from testbed.core.kernel.records import (
    CHUNK,
    LARGEST_REST,
    LARGEST_VARIANCE,
    REST_VARIANCE,
    D,
)
from testbed.core.kernel.rows import dot, fill


@summing
def four(X, k):
    """A sample of four slots."""
    return X[k], X[D + k], X[2 * D + k], X[3 * D + k]


@summing
def plus(a, x, y):
    """Four sums, each with one more product."""
    return a[0] + x * y[0], a[1] + x * y[1], a[2] + x * y[2], a[3] + x * y[3]


@summing
def dots(E, X, n):
    """E . X for four slots X."""
    a = (0.0, 0.0, 0.0, 0.0)
    for k in range(n):
        a = plus(a, E[k], four(X, k))
    return a


@summing
def products(X, Y, n):
    """X_i . Y_j for four slots of each; of those that nobody reads, nothing is computed."""
    a = b = c = d = (0.0, 0.0, 0.0, 0.0)
    for k in range(n):
        x, y = four(X, k), four(Y, k)
        a, b, c, d = (
            plus(a, x[0], y),
            plus(b, x[1], y),
            plus(c, x[2], y),
            plus(d, x[3], y),
        )
    return a, b, c, d


@summing
def add_to(G, at, a):
    """Add four sums to consecutive numbers."""
    G[at] += a[0]
    G[at + 1] += a[1]
    G[at + 2] += a[2]
    G[at + 3] += a[3]


@inline
def tile(X, Y, n, G, at, ld):
    """G[at + i ld + j] += X_i . Y_j for four slots of each."""
    a, b, c, d = products(X, Y, n)
    add_to(G, at, a)
    add_to(G, at + ld, b)
    add_to(G, at + 2 * ld, c)
    add_to(G, at + 3 * ld, d)


@inline
def half_tile(X, Y, n, G, at, ld):
    """`tile` for two slots with four."""
    a, b, _, _ = products(X, Y, n)
    add_to(G, at, a)
    add_to(G, at + ld, b)


@inline
def two_halves(X, Y, n, G, at, ld):
    """`tile` for processors with only sixteen vector registers."""
    half_tile(X, Y, n, G, at, ld)
    half_tile(X[2 * D :], Y, n, G, at + 2 * ld, ld)


fitting_tile = tile if WIDE else two_halves


@inline
def diagonal_tile(X, n, G, at, ld):
    """`tile` for four slots with themselves: its lower triangle."""
    a, b, c, d = products(X, X, n)
    G[at] += a[0]
    at += ld
    G[at] += b[0]
    G[at + 1] += b[1]
    at += ld
    G[at] += c[0]
    G[at + 1] += c[1]
    G[at + 2] += c[2]
    add_to(G, at + ld, d)


@plain
def apply_filter(rows, signals, work, centre, count, at, n):
    """Add what a chunk of samples gives to the filtered rows that it reaches.

    centre: sample of the block's first row; count: its rows; at, n: the chunk's samples.
    """
    weights, step, Y, H, Z = signals.weights, signals.step, work.Y, work.H, work.Z
    half = len(weights) // 2
    lo = max(0, -((centre + half - at) // step)) // 4 * 4
    hi = min(count, (at + n - 1 + half - centre) // step + 1)
    for r in range(lo, lo + -((lo - hi) // 4) * 4):
        behind = at - centre - r * step + half
        row = H[(r - lo) * D : (r - lo) * D + CHUNK]
        for k in range(CHUNK):
            inside = 0 <= behind + k < len(weights) and k < n and r < count
            row[k] = weights[behind + k] if inside else 0.0
    for s in range(0, rows.slots, 4):
        for r in range(lo, hi, 4):
            y, h = Y[s * D : (s + 4) * D], H[(r - lo) * D : (r - lo + 4) * D]
            fitting_tile(y, h, CHUNK, Z, s * D + r, D)
    if signals.deadband > 0.0:
        count_rests(rows, signals, work, centre, lo, hi, at, n)


@part
def count_rests(rows, signals, work, centre, lo, hi, at, n):
    """Mark rows near a chunk's samples at which their joint rests, or add what they share there."""
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


@part
def whiten_rests(X, G, U, size, count):
    """Of what rows of a channel share at rests the root of their covariance, by which X is divided.

    G: a band, diagonal first; it becomes the root. U: becomes which rows count. X: all slots.
    """
    for r in range(count):
        rest = G[r] / size
        for j in range(max(0, r - len(G) // D + 1), r + 1):
            covariance = REST_VARIANCE / size * G[(r - j) * D + r]
            for i in range(max(0, r - len(G) // D + 1), j):
                covariance -= G[(r - i) * D + r] * G[(j - i) * D + j]
            G[(r - j) * D + r] = (
                covariance / G[j] if j < r else (1.0 + covariance) ** 0.5
            )
        U[r] = 1.0 if rest < LARGEST_REST and G[r] ** 2 < 1 + LARGEST_VARIANCE else 0.0
    for s in range(0, len(X), D):
        for r in range(count):
            for d in range(1, min(len(G) // D, r + 1)):
                X[s + r] -= G[d * D + r] * X[s + r - d]
            X[s + r] /= G[r]


@plain
def rest_joints(rows, signals, work, count, sums):
    """Whiten rows of what friction adds where their joint rests; zero those that do not count."""
    Z, channels, weights = work.Z, len(rows.measured), signals.weights
    for c in range(channels):
        U = Z[(rows.slots + c) * D : (rows.slots + c) * D + count]
        X = Z[rows.start[c] * D : (rows.start[c] + rows.width[c]) * D]
        G = work.G[c * len(work.G) // channels : (c + 1) * len(work.G) // channels]
        for k in range(count):
            U[k] = 1.0 - U[k]  # from whether it rests to whether it moves
        if signals.rest_reach == 0 and len(weights) > 1 and dot(G, G, count) > 0.0:
            whiten_rests(X, G, U, dot(weights, weights, len(weights)), count)
        moving = dot(U, U, count)
        sums.used[c] += moving
        if moving < count:
            for s in range(rows.width[c]):
                for k in range(count):
                    X[s * D + k] *= U[k]


@plain
def gram(rows, work, count, sums):
    """Add the products of all pairs of slots, channel by channel; lower triangles."""
    n, G = -(-count // 8) * 8, sums.products
    for g in range(len(rows.start)):
        p, ld, slot = rows.group_size[g], rows.width[g], rows.start[g]
        X = work.Z[slot * D : (slot + ld) * D]
        for a in range(0, p, 4):
            at = rows.group_gram[g] + a * ld
            for b in range(0, a, 4):
                here, there = X[a * D : (a + 4) * D], X[b * D : (b + 4) * D]
                if p - a == 1:
                    added = dots(here, there, n)
                    for i in range(4):
                        G[at + b + i] += added[i]
                elif p - a == 2:
                    half_tile(here, there, n, G, at + b, ld)
                else:
                    fitting_tile(here, there, n, G, at + b, ld)
            diagonal_tile(X[a * D : (a + 4) * D], n, G, at + a, ld)


@outer
def sweep(robot, rows, signals, work, sums):
    """All rows, block by block, and their products, if the sums have room for these.

    The last block stays in work.Z.
    """
    half = len(signals.weights) // 2
    filtered = half > 0
    for first in range(0, signals.number, rows.block):
        count = min(rows.block, signals.number - first)
        centre = signals.start + first * signals.step
        begin, end = centre - half, centre + (count - 1) * signals.step + half + 1
        if filtered:
            work.Z[:] = 0.0
            work.G[:] = 0.0
        for at in range(begin, end, CHUNK if filtered else rows.block):
            n = min(CHUNK, end - at) if filtered else count
            fill(robot, rows, signals, at, n, work, work.Y if filtered else work.Z)
            if filtered:
                apply_filter(rows, signals, work, centre, count, at, n)
        if signals.deadband > 0.0:
            rest_joints(rows, signals, work, count, sums)
        else:
            for c in range(len(sums.used)):
                sums.used[c] += count
        if len(sums.products):
            gram(rows, work, count, sums)
