"""Noise in the columns of the equations, taken back: what statistics calls regression dilution.

Least squares takes columns for exact. Noise in them adds to their squares and not to their
products with the measurement, and draws the unknowns to zero. The longer a recording, the
smaller is sigma, but not this error. Whitening makes it worse where slow noise of the plate
leaves the weight to fast motion, of which the encoders' accelerations have little.

With products of what the noise alone does to the columns, N of all and H of the noise,
(N - H) x = b is free of it to first order.

Source    [Ful87]
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.arrays import Array
from testbed.identification.noise.fits import NoiseFit
from testbed.identification.noise.lagged_products import LaggedProducts
from testbed.identification.noise.scaled import square_root

MOST = 0.5
"""Part of the square of a combination of columns that may be noise: more is not taken back."""


def undiluted(found: NoiseFit, made: LaggedProducts) -> tuple[NoiseFit, Array]:
    """Unknowns as they were without noise in the columns, and those that it drowns.

    Args:
        found: A fit of whitened rows.
        made: Products of noise in the same unknowns' columns, of what it leaves in the
            residuals, and of ones, as the rows' own.

    Returns:
        The fit, and combinations of the unknowns whose columns are noise for the most part,
        (m, k).
    """
    m = len(found.values)
    white = np.tensordot(found.noise.sigma**-2.0, made.whitened(found.noise.coefficients), 1)
    root = square_root(found.covariance)
    share, axes = np.linalg.eigh(root.T @ white[:m, :m] @ root)
    lead, kept = root @ axes, np.clip(share, 0.0, MOST)
    taken = white[:m, :m] @ found.values - white[:m, m]
    taken = lead.T @ taken * np.where(share > MOST, MOST / np.maximum(share, MOST), 1.0)
    spread = lead / (1 - kept)
    values = found.values + spread @ taken
    drowned = np.asarray(lead[:, share > MOST])
    return replace(found, values=values, covariance=spread @ spread.T), drowned
