"""Tests of single torque channels: clipped, dead, stuck, coarse, with outliers or steps.

Torques are tested only while their joint moves, because a torque may be constant at rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.recordings.columns import MIN_MOTION_RANGE
from testbed.core.recordings.repeats import runs_of_equal_rows

EQUALITY_TOLERANCE, LIMIT_MARGIN, CONSTANT_TOLERANCE = 1e-6, 0.05, 1e-9
"""Largest difference of values that are considered equal after interpolation, and largest distance
of values at a limit from the limit, both as shares of the channel's range; largest relative change
of a constant channel."""

SPEED_HALF_WINDOW, REST_SPEED, MIN_MOVING_SHARE = 0.025, 0.1, 0.2
"""Half-width of the window for speeds [s]; largest speed of a joint at rest, as a share of its rms
speed; smallest share of moving samples for tests of a joint's channels."""

STUCK_FACTOR, JUMP_FACTOR, MIN_REGULAR_SHARE = 20, 5.0, 0.9
"""Smallest length of a stuck run, as a multiple of the usual length of runs of equal values;
smallest jump, as a multiple of the usual change; smallest share of runs whose length is a multiple
of the period of a slow device."""

EXACT_STOP, NOISY_STOP = (0.01, 6.0), (0.06, 4.0)
"""Smallest share of samples at a stop (level of clipping), and smallest ratio of samples at the
stop to samples just below, which is 2.4 at a smooth crest; for values, and for means of noisy
values."""

PLATEAU_SIGMAS, KINK_FACTOR = 3.0, 12.5
"""Half-width of a noisy plateau, in standard deviations of means; smallest drop of the torque
outside the plateau, at a distance of a quarter of its length, in half-widths: larger than beside a
flat crest."""

MIN_ROUNDING_NOISE, MAX_LEVELS = 0.05, 120
"""Smallest standard deviation of the rounding errors of coarse steps, relative to that of the
channel; largest number of distinct values."""

REVERSAL_MARGIN = 0.15
"""Smallest time from a reversal of motion to a jump that (delayed) friction cannot cause [s]."""

OUTLIER_FACTOR, MIN_OUTLIER_SIZE, MAX_OUTLIER_SHARE = 10.0, 0.02, 0.01
"""Smallest outlier, as a multiple of the 95th percentile of deviations from the mean of the two
neighbours, and as a share of the range; largest share of outliers among the samples."""

MIN_TOUCHES, MAX_RISE_RATIO = 3, 3.0
"""Smallest number of zeros of a channel of magnitudes; largest ratio of its rise over two windows
to its rise over one window, which is 4 at a smooth minimum."""

Spans = NDArray[np.int64]
"""Ranges of samples: index of the first sample, and index after the last one, (k, 2)."""

Flags = NDArray[np.bool_]


Finding = tuple[str, Flags | bool, Mapping[str, Any]]
"""Kind of a fault, flags of its samples, and values for its message, keyed by field."""


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Motion of a channel's joint.

    Attributes:
        rate: Sampling rate [Hz].
        speed: Velocity of the joint, (M,) [rad/s or m/s].
        moving: True for samples at which the joint moves, (M,).
    """

    rate: float
    speed: Array
    moving: Flags

    @staticmethod
    def from_position(position: Array, rate: float) -> JointMotion:
        """Estimate the motion of a joint from encoder positions, (M,), by differences.

        The speed is averaged over `SPEED_HALF_WINDOW` before and after each sample. The joint moves
        at samples where the speed exceeds `REST_SPEED` times its rms value. It does not move at all
        if the range of positions is at most `MIN_MOTION_RANGE`, or at most `STUCK_FACTOR` standard
        deviations of the noise.

        Args:
            position: Encoder positions, (M,) [rad or m].
            rate: Sampling rate [Hz].
        """
        half_window = max(1, round(SPEED_HALF_WINDOW * rate))
        padded = np.pad(position, half_window, "reflect", reflect_type="odd")
        speed = (
            (padded[2 * half_window :] - padded[: -2 * half_window])
            * rate
            / (2 * half_window)
        )
        is_moving = np.ptp(position) > max(
            MIN_MOTION_RANGE, STUCK_FACTOR * white_noise_sigma(position)
        )
        rms = np.sqrt(np.mean(speed**2)) if is_moving else np.inf
        return JointMotion(rate, speed, np.abs(speed) > REST_SPEED * rms)

    @property
    def is_moving(self) -> bool:
        """True if the joint moves in more than `MIN_MOVING_SHARE` of the samples."""
        return bool(self.moving.mean() > MIN_MOVING_SHARE)

    def explains_plateau(self, values: Array, plateau: Flags, tolerance: float) -> bool:
        """Test whether inertia and friction of the joint explain a plateau of torque.

        They do if a least-squares fit of friction and inertia predicts a nearly constant torque on
        the plateau.

        Args:
            values: Torque, (M,).
            plateau: True for samples of the plateau, (M,).
            tolerance: Half the largest standard deviation of the prediction.
        """
        columns = np.vander(self.speed, 2), np.sign(self.speed), np.gradient(self.speed)
        regressor, moving_samples = np.column_stack(columns), self.moving
        expected = (
            regressor
            @ np.linalg.lstsq(regressor[moving_samples], values[moving_samples])[0]
        )
        return bool(expected[plateau & moving_samples].std() < 2 * tolerance)


def white_noise_sigma(values: Array) -> float:
    """Standard deviation of white noise in a signal, from the median of fourth differences.

    The median of the magnitudes is divided by 0.6745, the ratio of median to standard deviation for
    a normal distribution.
    """
    return float(np.median(np.abs(np.diff(values, 4))) / (0.6745 * np.sqrt(70)))


def equal_runs(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the first samples of runs of equal values, and lengths of the runs.

    The values, (M,), are equal if they agree after rounding to `EQUALITY_TOLERANCE` times their
    range.
    """
    return runs_of_equal_rows(
        np.round(values[:, None] / (EQUALITY_TOLERANCE * np.ptp(values) or 1.0))
    )


def _find_constant(values: Array, joint: JointMotion) -> Finding | None:
    """Find a constant channel: range at most `CONSTANT_TOLERANCE` times its first value."""
    constant = np.ptp(values) <= CONSTANT_TOLERANCE * np.abs(values[0])
    return ("dead", True, {"size": values[0]}) if constant else None


def find_slow_updates(values: Array, joint: JointMotion) -> Finding | None:
    """Find a channel that is updated only at every k-th sample, k > 1.

    k is the median length of runs of equal values in motion. More than 60 % of the runs have length
    k, and more than `MIN_REGULAR_SHARE` a multiple of k, or a multiple plus one sample.
    """
    starts, lengths = equal_runs(values)
    moving_lengths = lengths[joint.moving[starts]]
    period = int(np.median(moving_lengths)) if len(moving_lengths) > STUCK_FACTOR else 1
    is_regular = (
        np.mean(moving_lengths == period) > 0.6
        and np.mean(moving_lengths % period < 2) > MIN_REGULAR_SHARE
    )
    is_repeated = ~np.isin(np.arange(len(values)), starts)
    return (
        ("slow", is_repeated, {"period": period}) if period > 1 and is_regular else None
    )


def _find_stuck_runs(values: Array, joint: JointMotion) -> Finding | None:
    """Find constant runs during motion: longer than usual, or zero between jumps.

    A run is longer than usual if it exceeds `STUCK_FACTOR` times the 95th percentile of run
    lengths. Runs at the largest or smallest value are excluded, unless it is a single run that
    begins and ends with jumps. A jump exceeds `JUMP_FACTOR` times the 90th percentile of changes.
    The kind of fault is "stuck", or "dead" for runs at zero.
    """
    starts, lengths = equal_runs(values)
    level, change = values[starts], np.abs(np.diff(values))
    jump = change[(values[1:] != 0) & (values[:-1] != 0) & (change > 0)]
    jump = JUMP_FACTOR * np.quantile(jump, 0.9) if len(jump) else np.inf
    jumps = np.concatenate([[True], change > jump, [True]])
    starts_at_jump, ends_at_jump = jumps[starts], jumps[starts + lengths]
    is_long = lengths > STUCK_FACTOR * np.quantile(lengths, 0.95)
    distance_to_limit = np.minimum(values.max() - level, level - values.min())
    # plateaus at a limit, which may begin or end at a jump of friction, are no stuck runs
    at_limit = (
        is_long & (distance_to_limit < LIMIT_MARGIN * np.ptp(values)) & (level != 0)
    )
    at_limit &= ~(starts_at_jump & ends_at_jump) | (at_limit.sum() > 1)
    is_lost = is_long & ~at_limit | (level == 0) & starts_at_jump & ends_at_jump
    is_clear = is_lost & (np.add.reduceat(joint.moving, starts) > lengths / 2)
    if lengths[is_clear].sum() < 3:
        return None
    longest = np.argmax(is_clear * lengths)
    facts = {"size": level[longest]}
    return "stuck" if level[longest] else "dead", np.repeat(is_lost, lengths), facts


def _find_clipping(values: Array, joint: JointMotion) -> Finding | None:
    """Find plateaus at extreme values that the joint's motion does not explain.

    Plateaus are sought at both extremes, first in the values, then in moving means over 0.05 s.
    """
    samples, levels = np.zeros(len(values), bool), []
    window = max(3, round(0.05 * joint.rate))
    for sign in (1.0, -1.0):
        plateau = _plateau(sign * values, joint, 1) or _plateau(
            sign * values, joint, window
        )
        if plateau is not None and not joint.explains_plateau(
            values, plateau[0], plateau[2]
        ):
            samples |= plateau[0]
            levels.append(sign * plateau[1])
    levels_text = " and ".join(f"{level:.4g}" for level in sorted(levels))
    return ("clipped", samples, {"size": levels_text}) if levels else None


def _plateau(
    values: Array, joint: JointMotion, count: int
) -> tuple[Flags, float, float] | None:
    """Plateau at the largest values: samples, level and resolution; None if there is no plateau.

    A moving mean over `count` samples reduces noise that was added after a saturation. The test
    allows for splines, which overshoot a saturation slightly. The flat crest of a smooth signal is
    not a plateau (`_is_steep`).

    Args:
        values: Torque, (M,), with reversed sign to find the smallest values.
        joint: Motion of the joint.
        count: Number of samples in a mean; the limits are `EXACT_STOP` if it is 1, otherwise
            `NOISY_STOP`.
    """
    means = np.convolve(values, np.ones(count) / count, "same")
    sorted_means, (share, ratio) = np.sort(means[joint.moving]), EXACT_STOP
    span = float(sorted_means[-1] - sorted_means[0])
    resolution = max(EQUALITY_TOLERANCE * span, np.diff(np.unique(values)).min())
    if count > 1:
        noise = white_noise_sigma(values) / np.sqrt(count)
        (share, ratio), resolution = (
            NOISY_STOP,
            max(resolution, 2e-3 * span, PLATEAU_SIGMAS * noise),
        )
    level = _stop_value(sorted_means, resolution, share, ratio)
    if level is None or resolution > 0.04 * span:
        return None
    samples = means > level - 1.5 * resolution
    return (
        (samples, level, resolution)
        if _is_steep(means, samples, level, resolution, count)
        else None
    )


def _stop_value(
    values: Array, resolution: float, share: float, ratio: float
) -> float | None:
    """Level of a stop (clipping) in the upper fifth of the range, or None.

    Args:
        values: Sorted values, (M,).
        resolution: Half-width of the stop.
        share: Smallest share of values at the stop.
        ratio: Smallest ratio of the number of values at the stop to that just below, and above.
    """
    levels = values[values >= values[-1] - 0.2 * (values[-1] - values[0])]
    counts = [np.searchsorted(values, levels + k * resolution) for k in (-3, -1, 1)]
    below, at_stop = np.diff(counts, axis=0)
    at_stop[at_stop < ratio * (len(values) - counts[2])] = 0
    k = int(np.argmax(at_stop))
    minimum = max(7, share * len(values), ratio * below[k])
    return float(levels[k]) if at_stop[k] > minimum else None


def _is_steep(
    values: Array, plateau: Flags, level: float, resolution: float, count: int
) -> bool:
    """Test whether values drop abruptly beside a plateau, unlike at a flat crest.

    The drop is abrupt if its mean, at a distance of a quarter of the plateau's length outside the
    plateau, exceeds `KINK_FACTOR` half-widths.

    Args:
        values: Moving means, (M,).
        plateau: True for samples of the plateau, (M,).
        level: Level of the plateau.
        resolution: Half-width of the plateau.
        count: Number of samples in a mean.
    """
    begins, ends = sample_ranges(plateau).T
    distance = np.maximum(count, (ends - begins) // 4)
    neighbours = values.take([begins - distance, ends + distance], mode="clip").mean(
        axis=0
    )
    return bool(
        np.average(level - neighbours, weights=ends - begins) > KINK_FACTOR * resolution
    )


def _find_coarse_steps(values: Array, joint: JointMotion) -> Finding | None:
    """Find quantisation steps that are large relative to the channel's variation.

    The values are multiples of a step, with fewer than about `MAX_LEVELS` different multiples. The
    rounding noise, step / sqrt(12), exceeds `MIN_ROUNDING_NOISE` times the standard deviation of
    the channel.
    """
    gaps = np.diff(np.unique(values))
    step = float(gaps.min())
    is_multiple = np.abs(gaps / step - np.round(gaps / step)) < 0.01
    noise = step / 12**0.5
    is_coarse = (
        len(gaps) < MAX_LEVELS
        and is_multiple.all()
        and noise > MIN_ROUNDING_NOISE * values.std()
    )
    return ("coarse", True, {"size": step, "noise": noise}) if is_coarse else None


def _find_magnitude(values: Array, joint: JointMotion) -> Finding | None:
    """Find a channel that contains magnitudes: values of one sign with sharp minima at zero.

    During motion there are at least `MIN_TOUCHES` minima at zero, on both sides of which the
    magnitude rises linearly, not quadratically, with time (`MAX_RISE_RATIO`).
    """
    from scipy.ndimage import minimum_filter1d  # scipy.signal takes half a second

    magnitude, reach = np.abs(values), max(2, round(0.03 * joint.rate))
    inner = magnitude[1:-1]
    local_minimum = minimum_filter1d(magnitude, 4 * reach + 1)[1:-1]
    is_minimum = (
        (inner == local_minimum) & (inner < magnitude[:-2]) & (inner < magnitude[2:])
    )
    minima = 1 + np.flatnonzero(is_minimum)
    minima = minima[
        joint.moving[minima] & (magnitude[minima] < np.median(np.abs(np.diff(values))))
    ]
    at_minimum, at_reach, at_double = (
        np.sum(magnitude.take([minima - k, minima + k], mode="clip"))
        for k in (0, reach, 2 * reach)
    )
    has_bounces = len(
        minima
    ) >= MIN_TOUCHES and at_double - at_minimum < MAX_RISE_RATIO * (
        at_reach - at_minimum
    )
    has_both_signs = values.min() < 0 < values.max()
    return (
        ("magnitude", True, {"count": len(minima)})
        if has_bounces and not has_both_signs
        else None
    )


def _find_outliers(values: Array, joint: JointMotion) -> Finding | None:
    """Find single samples that deviate from both neighbouring samples.

    The deviation from the mean of both neighbours exceeds 8 standard deviations of the noise,
    `OUTLIER_FACTOR` times the 95th percentile of deviations, `MIN_OUTLIER_SIZE` times the range,
    and twice the difference of the neighbours. If more than `MAX_OUTLIER_SHARE` of the samples
    deviate in this way, they are not considered outliers.
    """
    deviation = np.abs(values[1:-1] - (values[2:] + values[:-2]) / 2)
    threshold = OUTLIER_FACTOR * np.quantile(deviation, 0.95)
    is_isolated = deviation > max(
        8 * white_noise_sigma(values), threshold, MIN_OUTLIER_SIZE * np.ptp(values)
    )
    is_isolated &= np.abs(values[2:] - values[:-2]) < deviation / 2
    samples = np.pad(is_isolated, 1)
    is_rare = np.any(
        samples & joint.moving
    ) and samples.sum() <= MAX_OUTLIER_SHARE * len(values)
    return ("outliers", samples, {"count": int(samples.sum())}) if is_rare else None


def signal_steps(
    time: Array, values: Array, factor: float = OUTLIER_FACTOR
) -> Iterator[tuple[int, float]]:
    """Yield isolated steps of a signal whose rate of change is otherwise nearly continuous.

    The rates before and after a step differ by less than a quarter of the amount by which the rate
    across the step deviates from their mean. Each item is the index of the sample before the step,
    and the size of the step.

    Args:
        time: Increasing times, (M,) [s].
        values: Values of the signal, (M,).
        factor: Smallest deviation of the rate, as a multiple of its 99th percentile.
    """
    speed = np.diff(values) / np.diff(time)
    if len(speed) < 5:
        return
    before, after = speed[:-2], speed[2:]
    change = speed[1:-1] - (before + after) / 2
    threshold = factor * float(np.quantile(np.abs(change), 0.99))
    is_isolated = np.abs(before - after) < np.abs(change) / 4
    for i in 1 + np.flatnonzero((np.abs(change) > threshold) & is_isolated):
        yield int(i), float(change[i - 1] * (time[i + 1] - time[i]))


def _find_offset_steps(values: Array, joint: JointMotion) -> Finding | None:
    """Find one to three jumps of a torque that are far from motion reversals.

    Jumps are found by `signal_steps` with `JUMP_FACTOR`; they are at least `REVERSAL_MARGIN` away
    from the nearest reversal.
    """
    reach, indices = round(REVERSAL_MARGIN * joint.rate), np.arange(len(values))
    reversals = np.diff(np.sign(joint.speed)) != 0
    near_reversal = np.convolve(reversals, np.ones(2 * reach + 1), "same") > 0.5
    jumps = signal_steps(indices / joint.rate, values, JUMP_FACTOR)
    sizes = {i + 1: size for i, size in jumps if not near_reversal[i]}
    if not 0 < len(sizes) <= 3:
        return None
    size = max(sizes.values(), key=abs)
    return "offset-step", np.isin(indices, list(sizes)), {"size": size}


TORQUE_TESTS = (
    _find_constant,
    find_slow_updates,
    _find_stuck_runs,
    _find_clipping,
    _find_magnitude,
    _find_coarse_steps,
    _find_outliers,
    _find_offset_steps,
)
"""Tests of a torque channel, in order; the first fault found is reported."""


def sample_ranges(flags: Flags) -> Spans:
    """Index ranges of consecutive flags that are True, (k, 2)."""
    edges = np.diff(np.pad(flags, 1).astype(np.int64))
    return np.flatnonzero(edges).reshape(-1, 2)
