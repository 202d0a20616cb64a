"""Delays of torques or wrench relative to the encoders, by least squares.

The rows of the regression are at the times t of the positions, and the signal is evaluated at
t + s + k (t - middle), with delay s and drift k. The residual with minimal parameters, friction and
zeros is minimised by Gauss-Newton steps. Significant delays and drifts are corrected in the
mapping.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import RecordingError
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.dynamics.regressor import regressor
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import standard_deviations
from testbed.core.estimation.regression.windows import motion_taps, row_weights
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.recordings.geometry import check_robot, with_recorded_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.tree import Tree
from testbed.importing.check.instants import (
    MIN_VALUES_PER_COLUMN,
    decimate,
    estimated_delay,
    low_passed_motion,
    middle_part,
    orthonormal_basis,
)
from testbed.importing.check.remedies import signal_tables
from testbed.importing.import_report import ImportReport, MappingLine
from testbed.sensors.shifted_signals import edge_samples, shifted_signal

ROW_CUTOFF, POSITION_CUTOFF = 5.0, 40.0
"""Cutoffs of the low-pass filters on rows and on positions [Hz], as in estimates; less for slow
recordings."""

ROW_RATE, KEPT_ROW_RATE = 100.0, 12.5
"""Rate at which rows are computed, and rate after their filter [Hz]."""

MAX_INSTANTS = 6000
"""Largest number of instants for rows, from the recording's middle."""

DEADBAND, MAX_REST_SHARE = 0.02, 0.02
"""Speed below which a joint is at rest [rad/s or m/s]; largest share of a row's filter at rest."""

CORRELATION_LAGS = 12
"""Number of rows over which residuals are correlated."""

RANK_TOLERANCE = 1e-9
"""Singular value of unit columns, relative to the largest, below which columns are linearly
dependent."""

MAX_SKEW = 5e-4
"""Largest plausible relative difference of clock rates: a larger value is a model error."""

Z_THRESHOLD = 5.0
"""Normalised value from which a delay or a drift is significant."""


@dataclass(frozen=True)
class TimeOffset:
    """Estimated delay and drift of a signal relative to the encoders.

    Attributes:
        signal: Name of the signal: "torque" or "wrench".
        delay: Delay in the middle of the recording [s].
        sigma: Standard deviation of the delay [s].
        skew: Rate of change of the delay.
        skew_sigma: Standard deviation of the skew.
        middle: Time of the middle of the recording [s].
        before: Unexplained fraction of the signal's variation, rms.
        after: Unexplained fraction with delay and skew corrected, rms.
    """

    signal: str
    delay: float
    sigma: float
    skew: float
    skew_sigma: float
    middle: float
    before: float
    after: float

    @property
    def is_late(self) -> bool:
        """True if the delay is significant (beyond 5 standard deviations)."""
        return abs(self.delay) > Z_THRESHOLD * self.sigma

    @property
    def is_drifting(self) -> bool:
        """True if the difference of clock rates is significant (beyond 5 standard deviations)."""
        return abs(self.skew) > Z_THRESHOLD * self.skew_sigma

    @property
    def is_significant(self) -> bool:
        """True if the delay or the drift is significant."""
        return self.is_late or self.is_drifting

    def diagnostic(self, remedy: str = "") -> Diagnostic:
        """Diagnostic of the delay, for reports.

        Args:
            remedy: Description of the correction.
        """
        return make_diagnostic(
            "recording.delay",
            self.signal,
            self.delay,
            sigma=self.sigma,
            delay=1e3 * self.delay,
            deviation=1e3 * self.sigma,
            drift=1e6 * self.skew * self.is_drifting,
            before=self.before,
            after=self.after,
            lines=remedy,
        )


MIN_DURATION = 2.0
"""Least duration of a recording for the estimate of delays [s]."""


@one_blas_thread()
def time_offsets(
    tree: Tree,
    source: Source,
    kinds: Sequence[str] = ("torque", "wrench"),
    bodies: Estimate | None = None,
) -> list[TimeOffset]:
    """Delays of the measured torques and wrench, if determined by the data.

    Args:
        tree: Robot; its inertias are not used.
        source: Recording.
        kinds: Names of the signals: "torque", "wrench", or both.
        bodies: Estimate from a force plate, whose parameters predict the torques; None for free
            parameters.

    Returns:
        Offset of each signal, significant or not. Constant signals, and signals with too few rows
        for the number of unknowns, are omitted. The list is empty for recordings shorter than 2 s.

    Raises:
        RecordingError: The recording belongs to another robot.
    """
    check_robot(source, tree)
    tree = with_recorded_gravity(tree, source)
    if source.samples < MIN_DURATION * source.rate:
        return []
    most = int(MAX_INSTANTS * max(1, source.rate / ROW_RATE))
    part = middle_part(source, most).ordered(tree)
    offsets = (
        _time_offset(kind, tree, part, source.rate, bodies)
        for kind in kinds
        if kind in part.signals and np.ptp(part.measured(kind), axis=0).any()
    )
    return [each for each in offsets if each is not None]


def with_drive_delay(
    tree: Tree, source: Source, bodies: Estimate
) -> tuple[Recording, TimeOffset]:
    """Recording of commanded torques, shifted by the delay of the drives.

    Args:
        tree: Robot; its inertias are not used.
        source: Recording of commanded torques.
        bodies: Estimate from a force plate.

    Returns:
        Recording without its ends, and the (negative) delay of the commands.

    Raises:
        RecordingError: The recording belongs to another robot, or its torques are not ahead of the
            motion.
    """
    offset = next(iter(time_offsets(tree, source, ("torque",), bodies)), None)
    if offset is None or offset.delay >= 0:
        state = "nothing" if offset is None else f"{offset.delay:.2g} s late"
        raise RecordingError(
            f"torques that are commands are ahead of the motion, and these are {state}: they are "
            "what drives report, or the robot hardly moves"
        )
    whole, margin = (
        source.part(0, source.samples),
        edge_samples(offset.delay, source.rate),
    )
    torque = shifted_signal(whole.measured("torque"), offset.delay * source.rate)
    return replace(whole, torque=torque).part(margin, source.samples - margin), offset


def alignment_lines(
    offset: TimeOffset, mapping: Mapping[str, Any], report: Mapping[str, Any]
) -> Iterator[MappingLine]:
    """Yield lines of a mapping that correct a significant offset.

    The lines are `delay`, for all plates, and `skew` for a source whose clock differs from the
    clock of the positions.

    Args:
        offset: Estimated delay and drift of a signal.
        mapping: Content of the mapping file, as stored in a recording.
        report: Report of the import.
    """
    if not offset.is_significant:
        return
    clocks = ImportReport.from_dict(report).clocks if report else {}
    for name, table in signal_tables(mapping, offset.signal).items():
        source, delay = (
            str(table.get("source")),
            float(table.get("delay", 0.0)) + offset.delay,
        )
        if offset.is_drifting and source != mapping["position"]["source"]:
            lead, old_skew = (
                clocks[source].lead,
                mapping["sources"][source].get("skew", 0.0),
            )
            delay = (lead + delay - offset.skew * offset.middle) / (
                1 + offset.skew
            ) - lead
            yield (
                f"sources.{source}",
                "skew",
                round((1 + old_skew) / (1 + offset.skew) - 1, 10),
            )
        yield name, "delay", round(delay, 8)


class _Regression(NamedTuple):
    """Linear model of a signal and the signal itself (T rows, C channels, N unknowns).

    Attributes:
        rows: Regressor of all unknowns, (T, C, N).
        valid: 1 for valid rows, 0 for joints near a reversal, where the sign of dry friction is
            undetermined, (T, C).
        time: Time, (T,) [s].
        measured: Function that maps times, (T,), to the signal, (T, C).
    """

    rows: Array
    valid: Array
    time: Array
    measured: Callable[[Array], Array]


def _time_offset(
    kind: str, tree: Tree, recording: Recording, rate: float, bodies: Estimate | None
) -> TimeOffset | None:
    """Delay of one signal, with a drift only if the drift is plausible for clocks.

    A drift is plausible if it is significant and its skew is below 5e-4. The result is None if the
    robot hardly moves, or if the recording has too few rows for the number of unknowns.
    """
    rows, valid, time, measured = _regression_rows(kind, tree, recording, rate, bodies)
    if valid.sum() < MIN_VALUES_PER_COLUMN * rows.shape[2]:
        return None
    values = measured(time)
    weights = 1 / np.maximum(values.std(axis=0), 1e-12)
    columns = rows * (valid * weights)[..., None]
    spacing = float(np.diff(time).mean())
    start, _ = estimated_delay(
        columns, (values - values.mean(axis=0)) * weights, spacing
    )
    valid = valid * ((time >= time[0] - start) & (time <= time[-1] - start))[:, None]
    regression = _Regression(rows, valid, time, measured)
    offset = _fit_offset(kind, regression, [start, 0.0])
    if offset.is_drifting and abs(offset.skew) < MAX_SKEW:
        return offset
    return _fit_offset(kind, regression, [start])


def _regression_rows(
    kind: str, tree: Tree, recording: Recording, rate: float, bodies: Estimate | None
) -> _Regression:
    """Filtered regressor rows of torques or wrench, and the signal with the same filter.

    There are at most 12.5 rows per second. Rows of joints near a reversal are invalid; columns of
    zeros are omitted.
    """
    cutoff_factor = min(1.0, rate / (6 * POSITION_CUTOFF))
    step = max(1, int(rate / ROW_RATE))
    row_selection = slice(None, None, step)
    taps = motion_taps(rate, cutoff_factor * POSITION_CUTOFF)
    weights = row_weights(rate / step, cutoff_factor * ROW_CUTOFF)
    kept_selection = slice(None, None, max(1, int(rate / step / KEPT_ROW_RATE)))
    time, measured = _filtered_signal(recording, kind, row_selection, taps[0], weights)
    motion = low_passed_motion(recording, taps, row_selection, step / rate)
    columns = _columns(kind, tree, motion, bodies)
    rows = decimate(columns.reshape(len(columns), -1), weights, kept_selection)
    rows = rows.reshape(len(rows), *columns.shape[1:])
    valid = np.ones(rows.shape[:2])
    if kind == "torque":
        moving = decimate(
            (np.abs(motion.qd) > DEADBAND).astype(np.float64), weights, kept_selection
        )
        valid = (np.abs(moving - 1) < MAX_REST_SHARE).astype(np.float64)
    size = np.sqrt((rows**2).sum(axis=(0, 1)))
    return _Regression(
        rows[:, :, size > 1e-9 * size.max()], valid, time[kept_selection], measured
    )


def _columns(kind: str, tree: Tree, motion: Motion, bodies: Estimate | None) -> Array:
    """Regressor columns of bodies, constants and friction before the row filter, (M, C, N).

    Args:
        kind: Name of the signal: "torque" or "wrench".
        tree: Robot.
        motion: Motion at M instants.
        bodies: Estimate from a force plate, whose parameters replace the unknown parameters; None
            for free parameters.
    """
    minimal = minimal_set(tree, "torque" if kind == "torque" else "wrench")
    columns = regressor(tree, motion, minimal)
    channels, channel_signals = np.eye(columns.shape[1]), [np.ones(columns.shape[:2])]
    if kind == "torque":
        channel_signals += [np.sign(motion.qd), motion.qd, motion.qdd]
    if bodies is not None:
        theta = bodies.minimal.lift @ bodies.values[: bodies.minimal.count]
        columns = (columns @ (minimal.matrix @ theta))[:, :, None] * channels
    return np.concatenate(
        [columns, *(each[..., None] * channels for each in channel_signals)], axis=2
    )


def _filtered_signal(
    recording: Recording, kind: str, fine: slice, low_pass: Array, weights: Array
) -> tuple[Array, Callable[[Array], Array]]:
    """Times after both filters, (M,), and spline of the filtered signal, constant outside.

    Args:
        recording: Recording.
        kind: Name of the signal.
        fine: Selection of samples at the rate of the rows.
        low_pass: Weights of the filter on positions.
        weights: Weights of the filter on rows.
    """
    from scipy.interpolate import make_interp_spline

    signal = np.column_stack([recording.time, recording.measured(kind)])
    signal = decimate(decimate(signal, low_pass, fine), weights, slice(None))
    time = signal[:, 0]
    spline = make_interp_spline(time, signal[:, 1:], k=min(5, len(time) - 1))
    return time, lambda at: spline(np.clip(at, time[0], time[-1]))


def _fit_offset(
    kind: str, regression: _Regression, start: Sequence[float]
) -> TimeOffset:
    """Fit delay and drift by nonlinear least squares, with channels weighted by their residuals.

    Args:
        kind: Name of the signal.
        regression: Linear model of the signal.
        start: Start values: delay [s], and skew if a drift is fitted.
    """
    from scipy.optimize import least_squares

    _, valid, time, measured = regression
    middle = float(time.mean())
    powers = np.vander(time - middle, len(start), increasing=True)
    unknowns, weights = np.array(start), valid
    for _ in range(2):  # the second time weighted by the residuals of each channel
        residuals = _residual_function(regression, powers, weights)
        best = least_squares(residuals, unknowns, method="lm")
        unknowns, residual = best.x, best.fun.reshape(valid.shape)
        square = valid * (residual / np.maximum(weights, 1e-30)) ** 2
        size = np.sqrt(square.sum(axis=0) / valid.sum(axis=0).clip(1))
        weights = valid / np.maximum(size, 1e-12)
    values = measured(time + powers @ unknowns)
    signal_norm = float(np.linalg.norm(weights * (values - values.mean(axis=0))))
    before = float(np.linalg.norm(residuals(0 * unknowns))) / signal_norm
    after = float(np.linalg.norm(residual)) / signal_norm
    sigma = _offset_sigma(residual, best.jac.reshape(*residual.shape, -1))
    delay_estimate, skew = np.append(unknowns, 0.0)[:2].tolist()
    delay_sigma, skew_sigma = np.append(sigma, np.inf)[:2].tolist()
    return TimeOffset(
        kind, delay_estimate, delay_sigma, skew, skew_sigma, middle, before, after
    )


def _residual_function(
    regression: _Regression, powers: Array, weights: Array
) -> Callable[[Array], Array]:
    """Function that maps delay and drift to the weighted residuals of the linear model, (T C,).

    Args:
        regression: Linear model of the signal, whose unknowns are eliminated.
        powers: Ones and, for a drift, times relative to the middle [s], (T, 1) or (T, 2).
        weights: Weights of the residuals, (T, C).
    """
    rows, _, time, measured = regression
    columns = (rows * weights[..., None]).reshape(-1, rows.shape[2])
    basis = orthonormal_basis(columns, RANK_TOLERANCE)

    def residuals(parameters: Array) -> Array:
        flat = (measured(time + powers @ parameters) * weights).ravel()
        return flat - basis @ (basis.T @ flat)

    return residuals


def _offset_sigma(residual: Array, columns: Array) -> Array:
    """Standard deviations of delay and drift, for residuals correlated over some rows [NW87].

    Args:
        residual: Weighted residuals of C channels in T rows, (T, C).
        columns: Derivatives of the residuals with respect to delay and drift, (T, C, 1) or (T, C,
            2).
    """
    from scipy.linalg import toeplitz

    inverse = np.linalg.inv(np.einsum("tci,tcj->ij", columns, columns))
    scores = np.einsum("tci,tc->ti", columns, residual)
    window = toeplitz(np.maximum(0.0, 1 - np.arange(len(scores)) / CORRELATION_LAGS))
    return standard_deviations(inverse @ scores.T @ window @ scores @ inverse)
