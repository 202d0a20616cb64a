"""A few hundred instants of a recording: all signals through one low-pass, and their slopes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.regression.windows import motion_taps
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source

CUTOFF, SLOW = 8.0, 2.0
"""Of the low-pass [Hz], a sixth of the rate where the recording is slower; of another one, for
signals that are noise above it."""

MOST, A_SECOND = 320, 16.0
"""Instants that are kept, in all and a second: no more than the low-pass lets be independent."""

LEAST = 20
"""Instants below which a recording is of no use."""

LATEST, SPARE = 4.0, 0.25
"""Delays that are looked for at most [s], and in parts of a recording."""

LATE = 0.2
"""Times as much as without that may be left where a signal is read later, for it to be late."""

SPREAD = 20_000
"""Samples, at least, that show the noise of a plate."""

ENOUGH = 4
"""Values for each column from which delays are looked for."""

DEPENDENT = 1e-7
"""Share of the largest singular value below which a direction of the rows is none."""


@dataclass(frozen=True, eq=False)
class Instants:
    """Signals at T instants of a recording.

    Attributes:
        motion: Of the joints.
        wrench: (T, 6) [N, N m]; (T, 0) where it was not measured.
        wrench_rate: Its derivative, (T, 6) [N/s, N m/s], or (T, 0).
        wrench_noise: Variance of the noise left in the wrench, by the octave above, (6,) or (0,).
        spacing: From one instant to the next [s].
    """

    motion: Motion
    wrench: Array
    wrench_rate: Array
    wrench_noise: Array
    spacing: float


def sample(
    recording: Recording, late: float = 0.0, cutoff: float = CUTOFF
) -> Instants | None:
    """Signals of a recording at a few hundred instants; None where it is too short.

    Args:
        recording: Of M samples.
        late: How late the wrench is [s].
        cutoff: Of the low-pass [Hz].
    """
    rate = recording.rate
    passed = min(cutoff, rate / 6)
    taps = motion_taps(rate, passed)
    inside = recording.samples - taps.shape[1] + 1
    count = min(MOST, int(inside / rate * A_SECOND * cutoff / CUTOFF))
    if count < LEAST:
        return None
    later = round(late * rate)
    last = inside - 1 - abs(later)
    at = np.linspace(0, last, count).astype(int) + max(0, -later)
    spacing = last / rate / (count - 1)
    none = np.zeros((recording.samples, 0))
    wrench = none if recording.wrench is None else recording.wrench
    return Instants(
        motion_at(recording, taps, at, spacing),
        wrench=decimate(wrench, taps[0], at + later),
        wrench_rate=decimate(wrench, taps[1], at + later),
        wrench_noise=_noise_above(wrench, taps[0], motion_taps(rate, 2 * passed)[0]),
        spacing=spacing,
    )


def middle(source: Source, samples: int) -> Recording:
    """The middle of a recording.

    Args:
        source: The recording.
        samples: Most that are taken.
    """
    first = max(0, (source.samples - samples) // 2)
    return source.part(first, min(source.samples, first + samples))


def motion_at(
    recording: Recording, taps: Array, at: slice | NDArray[np.intp], spacing: float
) -> Motion:
    """Positions at some instants by a low-pass, with their derivatives.

    Args:
        recording: Of M samples.
        taps: Weights of the low-pass and of its derivatives, (3, 2 L + 1).
        at: As of `decimate`.
        spacing: From one instant to the next [s].
    """
    signals = [decimate(recording.position, each, at) for each in taps]
    return Motion(spacing * np.arange(float(len(signals[0]))), *signals)


def decimate(signal: Array, weights: Array, at: slice | NDArray[np.intp]) -> Array:
    """Filter and downsample a signal; samples that the filter reaches beyond the ends are lost.

    Args:
        signal: (M, k).
        weights: Of the filter, in the order of time, (2 L + 1,).
        at: Which of the M - 2 L others are kept.
    """
    windows = sliding_window_view(signal, len(weights), axis=0)[at]
    filtered: Array = np.einsum("mkl,l->mk", windows, weights)
    return filtered


def orthonormal_basis(columns: Array, dependent: float = DEPENDENT) -> Array:
    """Orthonormal basis of the space that columns, (k, N), span.

    A column that others imitate, as a first rotor's, has no direction of its own: rounding would
    make one.

    Args:
        columns: Of any sizes.
        dependent: Share of the largest singular value, of columns of unit length, of none.
    """
    from scipy.linalg import orth

    size = np.linalg.norm(columns, axis=0)
    basis: Array = orth(
        columns / np.maximum(size, dependent * size.max() + 1e-300), dependent
    )
    return basis


def delay(columns: Array, signal: Array, spacing: float) -> tuple[float, float]:
    """How late a signal is beside columns, to a row [s], and times less that they leave of it then.

    For all delays at once: what orthonormal columns explain are their correlations. Rows of zeros
    do not count. A signal of which columns leave more than a share (`LATE`) is not late.

    Args:
        columns: Of the signal, (T, C, N).
        signal: (T, C).
        spacing: From one row to the next [s].
    """
    most = int(min(LATEST / spacing, SPARE * len(signal)))
    rows = columns[most : len(columns) - most]
    basis = orthonormal_basis(rows.reshape(-1, rows.shape[2]))
    if not 0 < ENOUGH * basis.shape[1] < len(basis):
        return 0.0, 1.0  # nothing moves, or columns explain whatever is measured
    basis = basis.reshape(*rows.shape[:2], -1)
    windows = sliding_window_view(signal, len(rows), axis=0)  # (delays, C, rows)
    explained = np.einsum("dct,tcn->dn", windows, basis, optimize=True)
    whole = np.einsum("dct,tc->d", windows**2, np.any(rows, axis=2))
    share = (explained**2).sum(axis=1) / np.maximum(whole, 1e-300)
    best = int(np.argmax(share))
    times = float((1 - share[best]) / max(1 - share[most], 1e-300))
    # no delay is best, the farther the better
    if best in (0, 2 * most) or times > LATE:
        return 0.0, 1.0
    return spacing * (best - most), times


def _noise_above(signal: Array, low_pass: Array, wider: Array) -> Array:
    """Variance in the octave above a low-pass, where no smooth motion is, (C,).

    Args:
        signal: (M, C).
        low_pass: Weights of the filter, (2 L + 1,).
        wider: Of that of twice the cutoff; not longer.
    """
    band = -low_pass
    spare = (len(low_pass) - len(wider)) // 2
    band[spare : spare + len(wider)] += wider
    every = slice(None, None, max(1, len(signal) // SPREAD))
    return np.asarray(decimate(signal, band, every).var(axis=0))
