"""Low-pass filtered signals of a recording, and derivatives, at a few hundred instants."""

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

CUTOFF, SLOW_CUTOFF = 8.0, 2.0
"""Cutoff of the low-pass filter [Hz], at most a sixth of the sampling rate; and lower cutoff for
signals with much noise."""

MAX_INSTANTS, MAX_INSTANTS_PER_SECOND = 320, 16.0
"""Largest numbers of instants, in all and per second: as many as are independent after the low-pass
filter."""

MIN_INSTANTS = 20
"""Smallest number of instants of a usable recording."""

MAX_DELAY, MAX_DELAY_SHARE = 4.0, 0.25
"""Largest delays of the search: [s], and relative to the duration of the recording."""

MAX_RESIDUAL_RATIO = 0.2
"""Largest ratio of the residual sum of squares with a delay to that without, for a delay."""

NOISE_SAMPLES = 20_000
"""Approximate number of samples for the noise variance of a wrench."""

MIN_VALUES_PER_COLUMN = 4
"""Least number of values per column for the estimate of a delay."""

RANK_TOLERANCE = 1e-7
"""Singular value, relative to the largest, below which columns are linearly dependent."""


@dataclass(frozen=True, eq=False)
class Instants:
    """Signals at T instants of a recording.

    Attributes:
        motion: Low-pass filtered joint positions, velocities and accelerations.
        wrench: Low-pass filtered wrench on the robot in the bedplate frame, (T, 6) [N, N m]; (T, 0)
            without a force plate.
        wrench_rate: Time derivative of the wrench, (T, 6) [N/s, N m/s], or (T, 0).
        wrench_noise: Noise variance of the filtered wrench, from the octave above the cutoff, (6,)
            or (0,).
        spacing: Time between instants [s].
    """

    motion: Motion
    wrench: Array
    wrench_rate: Array
    wrench_noise: Array
    spacing: float


def low_passed_instants(
    recording: Recording, wrench_delay: float = 0.0, cutoff: float = CUTOFF
) -> Instants | None:
    """Low-pass filtered signals at a few hundred instants; None for too short a recording.

    The instants are equidistant, at most 320, and at most two per period of the cutoff frequency;
    fewer than 20 are too few.

    Args:
        recording: Recording of M samples.
        wrench_delay: Delay of the wrench, which is corrected [s].
        cutoff: Cutoff frequency of the low-pass filter [Hz].
    """
    rate = recording.rate
    limited_cutoff = min(cutoff, rate / 6)
    taps = motion_taps(rate, limited_cutoff)
    filtered_count = recording.samples - taps.shape[1] + 1
    count = min(
        MAX_INSTANTS,
        int(filtered_count / rate * MAX_INSTANTS_PER_SECOND * cutoff / CUTOFF),
    )
    if count < MIN_INSTANTS:
        return None
    shift = round(wrench_delay * rate)
    last = filtered_count - 1 - abs(shift)
    at = np.linspace(0, last, count).astype(int) + max(0, -shift)
    spacing = last / rate / (count - 1)
    no_wrench = np.zeros((recording.samples, 0))
    wrench = no_wrench if recording.wrench is None else recording.wrench
    return Instants(
        low_passed_motion(recording, taps, at, spacing),
        wrench=decimate(wrench, taps[0], at + shift),
        wrench_rate=decimate(wrench, taps[1], at + shift),
        wrench_noise=_noise_variance(
            wrench, taps[0], motion_taps(rate, 2 * limited_cutoff)[0]
        ),
        spacing=spacing,
    )


def middle_part(source: Source, samples: int) -> Recording:
    """Middle part of a recording.

    Args:
        source: Recording.
        samples: Largest number of samples.
    """
    first = max(0, (source.samples - samples) // 2)
    return source.part(first, min(source.samples, first + samples))


def low_passed_motion(
    recording: Recording, taps: Array, at: slice | NDArray[np.intp], spacing: float
) -> Motion:
    """Low-pass filtered positions with velocities and accelerations at selected samples.

    Args:
        recording: Recording of M samples.
        taps: Weights of the low-pass filter and its derivatives, (3, 2 L + 1).
        at: Selection of the M - 2 L filtered samples.
        spacing: Time between instants [s].
    """
    signals = [decimate(recording.position, each, at) for each in taps]
    return Motion(spacing * np.arange(float(len(signals[0]))), *signals)


def decimate(signal: Array, weights: Array, at: slice | NDArray[np.intp]) -> Array:
    """Filter and downsample a signal without padding.

    L samples at either end are lost, where L is the half-length of the filter.

    Args:
        signal: Signal, (M, k).
        weights: Filter weights in order of time, (2 L + 1,).
        at: Selection of the M - 2 L filtered samples.
    """
    windows = sliding_window_view(signal, len(weights), axis=0)[at]
    filtered: Array = np.einsum("mkl,l->mk", windows, weights)
    return filtered


def orthonormal_basis(columns: Array, tolerance: float = RANK_TOLERANCE) -> Array:
    """Orthonormal basis of the column space of a matrix, from singular values of unit columns.

    Columns that depend on others, such as that of a first rotor, add no direction, which would be
    rounding noise.

    Args:
        columns: Matrix, (k, N), with columns of any norm.
        tolerance: Singular value, relative to the largest, below which a direction is dropped.
    """
    from scipy.linalg import orth

    size = np.linalg.norm(columns, axis=0)
    basis: Array = orth(
        columns / np.maximum(size, tolerance * size.max() + 1e-300), tolerance
    )
    return basis


def estimated_delay(
    columns: Array, signal: Array, spacing: float
) -> tuple[float, float]:
    """Delay of a signal relative to a linear model by least squares; ratio of residuals.

    The residuals for all shifts by whole rows are computed at once, from correlations with an
    orthonormal basis of the columns. Rows of zeros are ignored.

    Args:
        columns: Columns of the linear model with T rows, C channels and N columns, (T, C, N).
        signal: Signal, (T, C).
        spacing: Time between rows [s].

    Returns:
        Delay [s], and ratio of the residual sums of squares with and without the delay. The result
        is (0, 1) if the ratio exceeds `MAX_RESIDUAL_RATIO` or the minimum is at the end of the
        search.
    """
    max_shift = int(min(MAX_DELAY / spacing, MAX_DELAY_SHARE * len(signal)))
    rows = columns[max_shift : len(columns) - max_shift]
    basis = orthonormal_basis(rows.reshape(-1, rows.shape[2]))
    if not 0 < MIN_VALUES_PER_COLUMN * basis.shape[1] < len(basis):
        return 0.0, 1.0  # no motion, or as many columns as values
    basis = basis.reshape(*rows.shape[:2], -1)
    windows = sliding_window_view(signal, len(rows), axis=0)  # (delays, C, rows)
    explained = np.einsum("dct,tcn->dn", windows, basis, optimize=True)
    total = np.einsum("dct,tc->d", windows**2, np.any(rows, axis=2))
    share = (explained**2).sum(axis=1) / np.maximum(total, 1e-300)
    best = int(np.argmax(share))
    ratio = float((1 - share[best]) / max(1 - share[max_shift], 1e-300))
    # no minimum within the range of delays
    if best in (0, 2 * max_shift) or ratio > MAX_RESIDUAL_RATIO:
        return 0.0, 1.0
    return spacing * (best - max_shift), ratio


def _noise_variance(signal: Array, low_pass: Array, wider: Array) -> Array:
    """Variance of a signal in the octave above the low-pass cutoff, taken as noise, (C,).

    Args:
        signal: Signal of C channels, (M, C).
        low_pass: Weights of the low-pass filter, (2 L + 1,).
        wider: Weights of the filter with twice the cutoff frequency, not longer than `low_pass`.
    """
    band = -low_pass
    margin = (len(low_pass) - len(wider)) // 2
    band[margin : margin + len(wider)] += wider
    selection = slice(None, None, max(1, len(signal) // NOISE_SAMPLES))
    return np.asarray(decimate(signal, band, selection).var(axis=0))
