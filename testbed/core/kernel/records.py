"""Constants and plain-array records of the kernel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import AnyArray, Array
from testbed.core.robot.friction import JOINT_LAWS
from testbed.core.robot.joint_law import JointLaw

# Entries of a row for one body: one entry per barycentric parameter.

ENTRY_PARAMETERS = (1, 2, 4, 5, 6, 8, 9, 3, 7, 0)
"""Barycentric parameter of each row entry, an index in the order mbar mbx mby mbz Kxx ... Kzz.

An eleventh entry is the effect of mbar on the carrying bodies.
"""

LEADING_ENTRIES = 7
"""Number of leading entries computed together; `rows.fill_extra_entries` computes the others."""

MASS_ENTRY = 9
"""Row entry of the mass of a body on the bedplate; the next is its mass acting on carriers."""

FORCE_ENTRIES = (0, 1, 7, MASS_ENTRY)
"""Row entries of a force, a screw without angular part: first moments and mass."""

# Indices of screws in the workspace.

REVOLUTE_SEED, PRISMATIC_SEED, SEED_COUNT = 6, 7, 8
"""Indices of the constant screws of a revolute and a prismatic joint; number of constant screws.

The first six constant screws are those of the measured wrench.
"""

# Sizes of blocks, the fastest by measurement (docs/identification.md).

NB = 64
"""Samples per block of the recursion: the data of a body stay in the L1 cache."""

MAX_BLOCK_ROWS = 320
"""Largest number of rows per block of the Gram matrices."""

FILTER_SAMPLES = 128
"""Number of samples that the filter processes at once."""

B, D = NB + 8, MAX_BLOCK_ROWS + 8
"""Strides between arrays of a sample block and of a row block.

Powers of two would map the arrays to few cache lines.
"""

MAX_BLOCK_BYTES = 1_800_000
"""Largest size of the arrays of a block of rows [bytes]."""

# Sine and cosine: reduction by a multiple of pi, then a polynomial in the squared argument.

ROUNDING_SHIFT = 6755399441055744.0
"""Number 1.5 2^52: adding and subtracting it rounds to an integer."""

PER_PI = 0.3183098861837907
"""Reciprocal of pi."""

PI_PARTS = (3.1415926534682512, 1.2154201012607932e-10, 4.044532497591901e-21)
"""Pi in three parts whose products with small integers are exact (Cody and Waite)."""

SINE_COEFFICIENTS = (
    2.7314447512062796e-15,
    -7.643970295533013e-13,
    1.605897731242445e-10,
    -2.505210761699557e-08,
    2.755731921916323e-06,
    -0.00019841269841254974,
    0.008333333333333316,
    -0.16666666666666666,
)
"""Polynomial for (sin r - r) / r^3 in r^2, |r| <= pi/2, highest power first.

The polynomial interpolates at the eight Chebyshev nodes of [0, (pi/2)^2]; its error is at most
1e-17 (tests/kernel).
"""

COSINE_COEFFICIENTS = (
    4.646435932869834e-14,
    -1.1466252257937559e-11,
    2.0876681558822446e-09,
    -2.7557318573365657e-07,
    2.4801587298913547e-05,
    -0.0013888888888884767,
    0.04166666666666666,
)
"""Polynomial for (cos r - 1 + r^2 / 2) / r^4 in r^2, from seven nodes; error at most 1.2e-17."""


Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def int_array(values: AnyArray | list[int]) -> Ints:
    """Array of 64-bit integers."""
    return np.array(values, dtype=np.int64)


class LinkArrays(NamedTuple):
    """Arrays of a robot's links, carriers first.

    Each row of `joint` holds cosine and sine of the twist angle about x, the offset, the constant
    angle about z, and its cosine and sine.
    """

    coordinate: Ints  # index of the joint, -1 for a resting frame
    place: Ints  # index of the link's motion in the workspace; indices are reused
    carrier: Ints  # index of the carrier's motion in the workspace
    prismatic: Bools  # True for resting frames, too
    square: Bools  # True if it leans by a right angle
    joint: Array
    ground: Array  # acceleration of the bedplate less gravity
    seeds: Array  # constant screws


class RowArrays(NamedTuple):
    """Arrays that pair screws with links and assign row entries to slots.

    A pair is the screw of a channel on one link. A slot is an array for one element of the
    channel's row, with one number per sample.
    """

    first: Ints  # first pair of each link
    source: Ints  # workspace index of the screw on the carrier, or of a constant screw
    target: (
        Ints  # workspace index of the screw on the link; equals source on the own link
    )
    force: Bools  # True if the screw has no angular part
    slot: Ints  # first slot of the pair
    direct: Bools  # True if the leading entries are written to the slots without a copy
    has_extra: Bools  # True if there are other than leading entries
    copies: Ints  # first copied entry of each pair
    copy_from: Ints  # entry of each copy
    copy_to: Ints  # slot of each copy
    term_slot: Ints  # slot of each joint term
    term_link: Ints  # link of each joint term
    term_law: Ints  # index of its law in LAWS
    start: Ints  # first slot of each channel
    width: Ints  # number of slots of each channel, with measurement and padding
    measured: Ints  # slot of each channel's measurement
    link: Ints  # link of each channel's joint
    group_size: Ints  # number of slots of each channel without padding
    group_gram: Ints  # first product of each channel
    slots: int  # number of all slots
    block: int  # largest number of rows of a block


REST_VARIANCE = 1000.0
"""Variance of the unknown friction at rest, per sample, relative to the noise variance."""

MAX_REST_VARIANCE = 10.0
"""Largest variance of a valid row due to friction at rest, relative to the noise variance.

The variance is conditional on earlier rows.
"""

MAX_REST_SHARE = 0.5
"""Largest share of the squared filter weights of a valid row at samples at rest."""


NO_LAW = -1
"""Index of a law without a compiled column: only the NumPy engine computes it."""


def law_number(law: JointLaw) -> int:
    """Index of a law in JOINT_LAWS; `NO_LAW` if its column is not compiled.

    Args:
        law: Law of a joint's torque.
    """
    numbers = (
        k
        for k, known in enumerate(JOINT_LAWS)
        if known.column is law.column and not law.by
    )
    return next(numbers, NO_LAW)


EMPTY_MATRIX, EMPTY_VECTOR = np.zeros((0, 0)), np.zeros(0)
"""Default values of absent arrays."""


class SignalWindow(NamedTuple):
    """Window of a recording, with its filters and the samples at which rows are computed."""

    position: Array
    velocity: Array  # empty if computed from the positions
    acceleration: Array
    measured: Array  # measured channels, (M, C)
    taps: Array  # convolution kernels of position, velocity, acceleration
    weights: Array  # filter of the rows; one weight for none
    deadband: float  # speed up to which a joint is at rest
    rest_reach: int  # rows within so many samples of a rest do not count; 0: whitened
    start: int  # sample of the first row
    step: int  # samples from row to row
    row_count: int  # number of rows
    # time and temperatures, (M, 1 + n), for laws that depend on them
    covariates: Array = EMPTY_MATRIX
    # values of the body columns' parameters, (P',), for laws that depend on the load
    load: Array = EMPTY_VECTOR
    # 1 for samples that count, 0 for others, by channel, (M, C)
    sample_mask: Array = EMPTY_MATRIX


def signals_of_motion(q: Array, qd: Array, qdd: Array, channels: int) -> SignalWindow:
    """Signals of a motion with known derivatives: one row per sample, no measurements.

    Args:
        q: Joint positions, (M, n) [rad or m].
        qd: Joint velocities, (M, n).
        qdd: Joint accelerations, (M, n).
        channels: Number of measured channels, filled with zeros.
    """
    measured, taps = np.zeros((len(q), channels)), np.array([[1.0], [0.0], [0.0]])
    return SignalWindow(q, qd, qdd, measured, taps, np.ones(1), 0.0, 0, 0, 1, len(q))


def signal_blocks(
    signals: SignalWindow, size: int
) -> Iterator[tuple[int, SignalWindow]]:
    """Index of the first row, and part of a window with at most `size` rows."""
    for first in range(0, signals.row_count, size):
        number = min(size, signals.row_count - first)
        start = signals.start + first * signals.step
        yield first, signals._replace(start=start, row_count=number)


class Block(NamedTuple):
    """Consecutive rows of a window.

    Attributes:
        first: Index of the first row.
        rows: Values of all row elements (slots), (slots, rows).
        counted: Number of valid rows of each channel, (channels,).
    """

    first: int
    rows: Array
    counted: Array


class Workspace(NamedTuple):
    """Workspace of one thread of the kernel: flat arrays."""

    U: Array  # coordinate of each link and its two derivatives
    N: Array  # positions of one encoder around a block, for the convolution
    X: Array  # motions of bodies
    V: Array  # screws
    T: Array  # entries of one pair, before they are copied to slots
    Y: Array  # rows before filtering
    H: Array  # weights of the filter
    G: Array  # band of shared weights at rests, of each row with itself and earlier rows
    Z: Array  # filtered rows
    squares: Array  # sum of the squares of all samples that were read, (1,) or (0,)


class Sums(NamedTuple):
    """Sums over the rows of a window.

    Attributes:
        row_counts: Number of valid rows of each channel, (channels,).
        products: Gram matrix of the columns of each channel, lower triangle, channel by channel;
            may be empty.
        squares: Sum of the squares of all samples that were read, (1,); finite only if all these
            samples are finite.
    """

    row_counts: Array
    products: Array
    squares: Array


def zero_sums(rows: RowArrays) -> Sums:
    """Sums of a window, initially zero."""
    products = int((rows.width**2).sum())
    return Sums(np.zeros(len(rows.measured)), np.zeros(products), np.zeros(1))
