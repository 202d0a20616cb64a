"""The kernel's numbers: sizes of blocks, places, order of entries, polynomials."""

from __future__ import annotations

# Entries of a row on one body.

ORDER = (1, 2, 4, 5, 6, 8, 9, 3, 7, 0)
"""The kernel's entries, as indices of COMPONENTS; an eleventh is mbar as carriers feel it."""

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
