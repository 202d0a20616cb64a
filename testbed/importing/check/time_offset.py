"""How late torques or wrench are beside the encoders: where the residuals are smallest.

Rows follow the positions' clock; the measurement is read later by s + k (t - middle), and what no
minimal parameters, friction or zero explain of it is made least by Gauss's and Newton's steps. What
is clear is taken back by the mapping's own words.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import RecordingError
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.dynamics.regressor import regressor
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import standard_deviations
from testbed.core.estimation.regression.windows import motion_taps, row_weights
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.recordings.geometry import check_robot, in_its_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.tree import Tree
from testbed.importing.check.instants import (
    ENOUGH,
    decimate,
    delay,
    middle,
    motion_at,
    orthonormal_basis,
)
from testbed.importing.check.remedies import tables_of
from testbed.importing.import_report import ImportReport, Line
from testbed.sensors.shifted_signals import reach, shifted

ROW_CUTOFF, POSITION_CUTOFF = 5.0, 40.0
"""Of the low-pass on rows and on positions [Hz], as estimates have them; less where the
recording is slower."""

FINE, ROWS_A_SECOND = 100.0, 12.5
"""Instants a second at which rows are made, and rows kept after their filter."""

MOST_INSTANTS = 6000
"""At which rows are made; of a longer recording the middle is taken."""

DEADBAND, NEARLY = 0.02, 0.02
"""Speed below which a joint rests [rad/s or m/s]; part of a row's filter that may be at rest."""

LAGS = 12
"""Rows over which residuals are taken as correlated."""

DEPENDENT = 1e-9
"""Share of the largest singular value below which columns of unit length depend on others."""

MOST_SKEW = 5e-4
"""By which clocks differ at most: more is a model that is wrong."""

CLEAR = 5.0
"""Sigmas from which a delay or a drift of clocks is no noise."""


@dataclass(frozen=True)
class TimeOffset:
    """How late a signal is beside the encoders.

    Attributes:
        signal: torque or wrench.
        delay: In the recording's middle [s].
        sigma: Of it [s].
        skew: By how much it gets later, relative to time.
        skew_sigma: Of that.
        middle: The middle [s].
        before: Part of the signal's variation that is not explained, rms.
        after: The same with delay and skew taken back.
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
    def late(self) -> bool:
        """Whether the delay is no noise."""
        return abs(self.delay) > CLEAR * self.sigma

    @property
    def drifts(self) -> bool:
        """Whether the clocks run at different rates beyond noise."""
        return abs(self.skew) > CLEAR * self.skew_sigma

    @property
    def matters(self) -> bool:
        """Whether it is late or drifts."""
        return self.late or self.drifts

    def diagnostic(self, remedy: str = "") -> Diagnostic:
        """For a person.

        Args:
            remedy: What to do about it.
        """
        return diagnose(
            "recording.delay",
            self.signal,
            self.delay,
            sigma=self.sigma,
            delay=1e3 * self.delay,
            deviation=1e3 * self.sigma,
            drift=1e6 * self.skew * self.drifts,
            before=self.before,
            after=self.after,
            lines=remedy,
        )


SHORTEST = 2.0
"""Recordings below which no delay is looked for [s]."""


@one_blas_thread()
def time_offsets(
    tree: Tree,
    source: Source,
    kinds: Sequence[str] = ("torque", "wrench"),
    bodies: Estimate | None = None,
) -> list[TimeOffset]:
    """Of the torques and of the wrench, as far as they were measured, and determine it.

    Args:
        tree: The robot; its inertias are not used.
        source: The recording.
        kinds: Of which of the two.
        bodies: By the plate, where torques are held against those.

    Raises:
        RecordingError: It is of another robot.
    """
    check_robot(source, tree)
    tree = in_its_gravity(tree, source)
    if source.samples < SHORTEST * source.rate:
        return []
    most = int(MOST_INSTANTS * max(1, source.rate / FINE))
    part = middle(source, most).ordered(tree)
    offsets = (
        _offset(kind, tree, part, source.rate, bodies)
        for kind in kinds
        if kind in part.signals and np.ptp(part.measured(kind), axis=0).any()
    )
    return [each for each in offsets if each is not None]


def delivered(
    tree: Tree, source: Source, bodies: Estimate
) -> tuple[Recording, TimeOffset]:
    """A recording of commanded torques with the torques as drives deliver them: so much later.

    Args:
        tree: The robot; its inertias are not used.
        source: The recording.
        bodies: By the plate.

    Returns:
        The recording without its ends, and the delay of its commands, which is negative.

    Raises:
        RecordingError: It is of another robot, or its torques are not ahead of the motion.
    """
    offset = next(iter(time_offsets(tree, source, ("torque",), bodies)), None)
    if offset is None or offset.delay >= 0:
        found = "nothing" if offset is None else f"{offset.delay:.2g} s late"
        raise RecordingError(
            f"torques that are commands are ahead of the motion, and these are {found}: they are "
            "what drives report, or the robot hardly moves"
        )
    whole, lost = source.part(0, source.samples), reach(offset.delay, source.rate)
    torque = shifted(whole.measured("torque"), offset.delay * source.rate)
    return replace(whole, torque=torque).part(lost, source.samples - lost), offset


def alignment(
    offset: TimeOffset, mapping: Mapping[str, Any], report: Mapping[str, Any]
) -> Iterator[Line]:
    """Lines by which a mapping takes an offset back; none of one that is noise.

    `delay`, of all plates, and `skew` of a source that has not the positions' clock.

    Args:
        offset: How late a signal is.
        mapping: What the mapping file says, as a recording keeps it.
        report: Of the import.
    """
    if not offset.matters:
        return
    clocks = ImportReport.from_dict(report).clocks if report else {}
    for name, table in tables_of(mapping, offset.signal).items():
        source, delay = (
            str(table.get("source")),
            float(table.get("delay", 0.0)) + offset.delay,
        )
        if offset.drifts and source != mapping["position"]["source"]:
            lead, own = clocks[source].lead, mapping["sources"][source].get("skew", 0.0)
            delay = (lead + delay - offset.skew * offset.middle) / (
                1 + offset.skew
            ) - lead
            yield (
                f"sources.{source}",
                "skew",
                round((1 + own) / (1 + offset.skew) - 1, 10),
            )
        yield name, "delay", round(delay, 8)


class _Regression(NamedTuple):
    """Rows of a signal and the signal itself.

    Attributes:
        rows: On all unknowns, (T, C, N).
        counted: Which of them count, 1 or 0, (T, C): none of a joint near a reversal, where its
            dry friction has no sign.
        time: (T,) [s].
        measured: The signal at T times, (T, C).
    """

    rows: Array
    counted: Array
    time: Array
    measured: Callable[[Array], Array]


def _offset(
    kind: str, tree: Tree, recording: Recording, rate: float, bodies: Estimate | None
) -> TimeOffset | None:
    """The delay of one signal, with a drift only if it is one that clocks have.

    None where the robot hardly moves, or so shortly that rows explain whatever is measured.
    """
    rows, counted, time, measured = _regression(kind, tree, recording, rate, bodies)
    if counted.sum() < ENOUGH * rows.shape[2]:
        return None
    values = measured(time)
    weights = 1 / np.maximum(values.std(axis=0), 1e-12)
    columns = rows * (counted * weights)[..., None]
    spacing = float(np.diff(time).mean())
    start, _ = delay(columns, (values - values.mean(axis=0)) * weights, spacing)
    counted = (
        counted * ((time >= time[0] - start) & (time <= time[-1] - start))[:, None]
    )
    regression = _Regression(rows, counted, time, measured)
    offset = _fit(kind, regression, [start, 0.0])
    if offset.drifts and abs(offset.skew) < MOST_SKEW:
        return offset
    return _fit(kind, regression, [start])


def _regression(
    kind: str, tree: Tree, recording: Recording, rate: float, bodies: Estimate | None
) -> _Regression:
    """Rows of the torques or the wrench, filtered as the signal is."""
    slow = min(1.0, rate / (6 * POSITION_CUTOFF))
    step = max(1, int(rate / FINE))
    fine = slice(None, None, step)
    taps = motion_taps(rate, slow * POSITION_CUTOFF)
    weights = row_weights(rate / step, slow * ROW_CUTOFF)
    coarse = slice(None, None, max(1, int(rate / step / ROWS_A_SECOND)))
    time, measured = _filtered(recording, kind, fine, taps[0], weights)
    motion = motion_at(recording, taps, fine, step / rate)
    columns = _columns(kind, tree, motion, bodies)
    rows = decimate(columns.reshape(len(columns), -1), weights, coarse)
    rows = rows.reshape(len(rows), *columns.shape[1:])
    counted = np.ones(rows.shape[:2])
    if kind == "torque":
        moving = decimate(
            (np.abs(motion.qd) > DEADBAND).astype(np.float64), weights, coarse
        )
        counted = (np.abs(moving - 1) < NEARLY).astype(np.float64)
    size = np.sqrt((rows**2).sum(axis=(0, 1)))
    return _Regression(
        rows[:, :, size > 1e-9 * size.max()], counted, time[coarse], measured
    )


def _columns(kind: str, tree: Tree, motion: Motion, bodies: Estimate | None) -> Array:
    """Columns of bodies, constants and friction before the filter, (M, C, N)."""
    minimal = minimal_set(tree, "dynamic" if kind == "torque" else "reaction")
    columns = regressor(tree, motion, minimal)
    channels, own = np.eye(columns.shape[1]), [np.ones(columns.shape[:2])]
    if kind == "torque":
        own += [np.sign(motion.qd), motion.qd, motion.qdd]
    if bodies is not None:
        theta = bodies.minimal.lift @ bodies.values[: bodies.minimal.count]
        columns = (columns @ (minimal.matrix @ theta))[:, :, None] * channels
    return np.concatenate(
        [columns, *(each[..., None] * channels for each in own)], axis=2
    )


def _filtered(
    recording: Recording, kind: str, fine: slice, low_pass: Array, weights: Array
) -> tuple[Array, Callable[[Array], Array]]:
    """Times (M,) after two filters, and a signal by a spline, the nearest beyond its ends."""
    from scipy.interpolate import make_interp_spline

    signal = np.column_stack([recording.time, recording.measured(kind)])
    signal = decimate(decimate(signal, low_pass, fine), weights, slice(None))
    time = signal[:, 0]
    spline = make_interp_spline(time, signal[:, 1:], k=min(5, len(time) - 1))
    return time, lambda at: spline(np.clip(at, time[0], time[-1]))


def _fit(kind: str, regression: _Regression, start: Sequence[float]) -> TimeOffset:
    """Delay, and drift if `start` has two values, channels weighed by what is left in them."""
    from scipy.optimize import least_squares

    _, counted, time, measured = regression
    middle = float(time.mean())
    powers = np.vander(time - middle, len(start), increasing=True)
    unknowns, weights = np.array(start), counted
    for _ in range(2):  # the second time by what is left in each channel
        residuals = _residuals(regression, powers, weights)
        best = least_squares(residuals, unknowns, method="lm")
        unknowns, residual = best.x, best.fun.reshape(counted.shape)
        square = counted * (residual / np.maximum(weights, 1e-30)) ** 2
        size = np.sqrt(square.sum(axis=0) / counted.sum(axis=0).clip(1))
        weights = counted / np.maximum(size, 1e-12)
    values = measured(time + powers @ unknowns)
    alone = float(np.linalg.norm(weights * (values - values.mean(axis=0))))
    before = float(np.linalg.norm(residuals(0 * unknowns))) / alone
    after = float(np.linalg.norm(residual)) / alone
    sigma = _sigma(residual, best.jac.reshape(*residual.shape, -1))
    late, skew = np.append(unknowns, 0.0)[:2].tolist()
    late_sigma, skew_sigma = np.append(sigma, np.inf)[:2].tolist()
    return TimeOffset(kind, late, late_sigma, skew, skew_sigma, middle, before, after)


def _residuals(
    regression: _Regression, powers: Array, weights: Array
) -> Callable[[Array], Array]:
    """What of a signal that is so late, weighed, no unknowns explain, (T C,), by its delay."""
    rows, _, time, measured = regression
    columns = (rows * weights[..., None]).reshape(-1, rows.shape[2])
    basis = orthonormal_basis(columns, DEPENDENT)

    def residuals(late: Array) -> Array:
        flat = (measured(time + powers @ late) * weights).ravel()
        return flat - basis @ (basis.T @ flat)

    return residuals


def _sigma(residual: Array, columns: Array) -> Array:
    """Sigmas of delay and drift, residuals correlated over some rows [NW87]."""
    from scipy.linalg import toeplitz

    inverse = np.linalg.inv(np.einsum("tci,tcj->ij", columns, columns))
    scores = np.einsum("tci,tc->ti", columns, residual)
    window = toeplitz(np.maximum(0.0, 1 - np.arange(len(scores)) / LAGS))
    return standard_deviations(inverse @ scores.T @ window @ scores @ inverse)
