"""The plain arrays that the kernel works on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import AnyArray, Array
from testbed.core.robot.friction import LAWS
from testbed.core.robot.joint_law import JointLaw

# Entries of a row on one body.

ORDER = (1, 2, 4, 5, 6, 8, 9, 3, 7, 0)
"""The kernel's entries, as indices of PARTS; an eleventh is mbar as carriers feel it."""

USUAL = 7
"""How many entries the kernel makes at once; `screws.rest` makes the others."""

MBAR = 9
"""The entry of a body's mass where it stands on the bedplate; the next is as carriers feel it."""

PUSHED = (0, 1, 7, MBAR)
"""Entries that a force has: first moments and mass."""

# Places of screws in the workspace.

TURNING, SLIDING, SEEDS = 6, 7, 8
"""Screws that never change, after the bedplate's six: a joint's on its own body; their number."""

# Blocks; the sizes are the fastest that were measured (docs/identification.md).

NB = 64
"""Samples of a block of the recursion: a body's slots stay in the first cache."""

KS = 320
"""Most rows of a block of the Gram matrices."""

CHUNK = 128
"""Samples taken at once by the filter."""

B, D = NB + 8, KS + 8
"""Distances of slots; powers of two would make all slots share a few cache lines."""

CACHE = 1_800_000
"""Bytes of slots that a block of rows may take."""

# Sine and cosine: the argument less a multiple of pi, then a polynomial in its square.

ROUND = 6755399441055744.0
"""1.5 2^52: adding and subtracting it rounds to an integer."""

PER_PI = 0.3183098861837907
"""1 / pi."""

PI = (3.1415926534682512, 1.2154201012607932e-10, 4.044532497591901e-21)
"""Pi in three parts whose products with small integers are exact, after Cody and Waite."""

SINE = (
    2.7314447512062796e-15,
    -7.643970295533013e-13,
    1.605897731242445e-10,
    -2.505210761699557e-08,
    2.755731921916323e-06,
    -0.00019841269841254974,
    0.008333333333333316,
    -0.16666666666666666,
)
"""(sin r - r) / r^3 for |r| <= pi/2 as a polynomial in r^2, highest power first: interpolated at
Chebyshev's eight nodes of [0, (pi/2)^2]; off by at most 1e-17 (tests/kernel)."""

COSINE = (
    4.646435932869834e-14,
    -1.1466252257937559e-11,
    2.0876681558822446e-09,
    -2.7557318573365657e-07,
    2.4801587298913547e-05,
    -0.0013888888888884767,
    0.04166666666666666,
)
"""(cos r - 1 + r^2 / 2) / r^4, likewise, at seven nodes; off by at most 1.2e-17."""


Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def ints(values: AnyArray | list[int]) -> Ints:
    """The kernel's integers."""
    return np.array(values, dtype=np.int64)


class Robot(NamedTuple):
    """Links outward; `joint` holds cos and sin of the lean, offset, turn, its cos and sin."""

    coordinate: Ints
    place: Ints  # of the link's motion in the workspace; places are used again
    carrier: Ints  # of its carrier's
    slides: Bools
    square: Bools  # leans by a right angle
    joint: Array
    ground: Array  # the bedplate's acceleration less gravity
    seeds: Array  # screws that never change


class Rows(NamedTuple):
    """Which screws meet which links, and where their entries go."""

    first: Ints  # of a link's pairs with screws
    source: Ints  # place of the screw on the carrier, or a seed's
    target: Ints  # place of the screw here; the source's if it starts here
    force: Bools
    slot: Ints
    direct: Bools  # its first entries can be written where they belong
    rest: Bools  # it has entries that few bodies have
    copies: Ints  # first of a pair's entries that are to be copied
    copy_from: Ints  # entry of the kernel
    copy_to: Ints  # slot
    term_slot: Ints
    term_link: Ints
    term_law: Ints  # numbers of laws in LAWS
    start: Ints  # of a channel's slots
    width: Ints  # of a channel, measurement and padding included
    measured: Ints  # slot of a channel's measurement
    link: Ints  # of a channel's joint
    group_size: Ints  # slots of a channel without the padding
    group_gram: Ints  # where their products go
    slots: int
    block: int  # rows taken at once


REST_VARIANCE = 1000.0
"""Of friction at rest, at every sample, over that of the noise: it is not known there."""

LARGEST_VARIANCE = 10.0
"""Of the same in a row, beside rows before, up to which the row counts."""

LARGEST_REST = 0.5
"""Part of the square of a row's weights that may be at rest, too."""


UNKNOWN = -1
"""Number of a law with no column of LAWS: the NumPy engine alone makes it."""


def law_number(law: JointLaw) -> int:
    """Number of a law's column among those of LAWS.

    Args:
        law: Of a joint's torque.
    """
    same = (
        k for k, known in enumerate(LAWS) if known.column is law.column and not law.by
    )
    return next(same, UNKNOWN)


NONE, NO_LOAD = np.zeros((0, 0)), np.zeros(0)


class Signals(NamedTuple):
    """A window of a recording, and which of its samples become rows."""

    position: Array
    velocity: Array  # empty where it is to be had from the positions
    acceleration: Array
    measured: Array
    taps: Array  # convolution kernels of position, velocity, acceleration
    weights: Array  # of the filter on rows; a single one for none
    deadband: float  # joints that are slower rest
    rest_reach: int  # rows of a joint that rests within so many samples do not count; 0: whitened
    start: int  # sample of the first row
    step: int  # samples from row to row
    number: int  # of rows
    varying: Array = (
        NONE  # time and temperatures, (M, 1 + n), where a law is multiplied by them
    )
    load: Array = (
        NO_LOAD  # of the body columns, their values, (P',), where a law is of the load
    )
    counts: Array = (
        NONE  # of samples, 1 or 0 where one is left out of a channel, (M, C)
    )


def sensed(q: Array, qd: Array, qdd: Array, channels: int) -> Signals:
    """A motion with its derivatives, every sample a row, without measurements.

    Args:
        q: Positions, (M, n) [rad or m].
        qd: Velocities, (M, n).
        qdd: Accelerations, (M, n).
        channels: How many are measured otherwise.
    """
    none, taps = np.zeros((len(q), channels)), np.array([[1.0], [0.0], [0.0]])
    return Signals(q, qd, qdd, none, taps, np.ones(1), 0.0, 0, 0, 1, len(q))


def blocks(signals: Signals, size: int) -> Iterator[tuple[int, Signals]]:
    """A window cut into blocks of at most `size` rows, and the number of each one's first."""
    for first in range(0, signals.number, size):
        number = min(size, signals.number - first)
        start = signals.start + first * signals.step
        yield first, signals._replace(start=start, number=number)


class Block(NamedTuple):
    """Consecutive rows of a window.

    Attributes:
        first: Number of the first.
        rows: (slots, rows).
        used: How many of each channel count, (channels,).
    """

    first: int
    rows: Array
    used: Array


class Work(NamedTuple):
    """What one thread of the kernel writes to."""

    U: Array  # coordinates
    N: Array  # one encoder's neighbourhood
    X: Array  # bodies
    V: Array  # screws
    T: Array  # entries of one body, before some are picked
    Y: Array  # rows
    H: Array  # weights of the filter
    G: Array  # what each row shares, at rests of its joint, with itself and rows before
    Z: Array  # filtered rows
    squares: Array  # sum of the squares of all that was read, one number or none


class Sums(NamedTuple):
    """What a sweep of a window finds.

    Attributes:
        used: Rows of each channel that count.
        products: Of all pairs of a channel's slots, lower triangles, channel by channel; or empty.
        squares: Sum of the squares of all that was read, (1,): small only if all are numbers.
    """

    used: Array
    products: Array
    squares: Array


def sums_for(rows: Rows) -> Sums:
    """Room for the sums of a window, zero."""
    products = int((rows.width**2).sum())
    return Sums(np.zeros(len(rows.measured)), np.zeros(products), np.zeros(1))
