"""How late torques or wrench are beside the encoders: where the residuals are smallest.

Rows follow the positions' clock; the measurement is read later by s + k (t - middle), and
what no minimal parameters, friction or zero explain of it is made least by Gauss's and
Newton's steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import regressor
from testbed.dynamics.motion import Motion
from testbed.identification.filters import motion_taps, row_weights
from testbed.parameters.minimal_set import minimal_set
from testbed.recordings.geometry import check_robot
from testbed.recordings.source import Source
from testbed.robot.tree import Tree
from testbed.sanity.instants import ENOUGH, LATE, delay, directions, thinned

ROW_CUTOFF, POSITION_CUTOFF = 5.0, 40.0
"""Of the low-pass on rows and on positions [Hz], as estimates have them; less where the
recording is slower."""

FINE, ROWS_A_SECOND = 100.0, 12.5
"""Instants a second at which rows are made, and rows kept after their filter."""

MOST_INSTANTS = 6000
"""At which rows are made; of a longer recording the middle is taken."""

STEPS = 8
"""Of Gauss and Newton."""

DEADBAND, NEARLY = 0.02, 0.02
"""Speed below which a joint rests [rad/s or m/s]; part of a row's filter that may be at rest."""

LAGS = 12
"""Rows over which residuals are taken as correlated."""

DEPENDENT = 1e-9
"""Share of the largest singular value below which columns of unit length depend on others."""

LARGEST_STEP, SMALLEST_STEP = (0.05, 0.01), 1e-8
"""Of delay [s] and drift; delay below which the search ends [s]."""

MOST_SKEW = 5e-4
"""By which clocks differ at most: more is a model that is wrong."""

CLEAR = 5.0
"""Sigmas from which a delay or a drift of clocks is no noise."""


@dataclass(frozen=True)
class ClockOffset:
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
    def text(self) -> str:
        """For a person."""
        drift = f", and clocks differ by {1e6 * self.skew:.0f} ppm" if self.drifts else ""
        return (
            f"clock: the {self.signal} is {1e3 * self.delay:.3f} +- {1e3 * self.sigma:.3f} ms late"
            f"{drift} (unexplained {self.before:.2%}, without it {self.after:.2%})"
        )


def clock_offsets(tree: Tree, source: Source) -> list[ClockOffset]:
    """Of the torques and of the wrench, as far as they were measured, and tell.

    Args:
        tree: The robot; its inertias are not used.
        source: The recording.

    Raises:
        RecordingError: It is of another robot.
    """
    check_robot(source, tree)
    tree = tree.with_gravity(source.facts.get("gravity"))
    most = int(MOST_INSTANTS * max(1, source.rate / FINE))
    first = max(0, (source.samples - most) // 2)
    part = source.part(first, min(source.samples, first + most)).ordered(tree)
    kinds = ("torque", "wrench")
    found = (
        _offset(kind, tree, part.position, part.measured(kind), part.time, source.rate)
        for kind in kinds
        if kind in part.signals and np.ptp(part.measured(kind), axis=0).any()
    )
    return [each for each in found if each is not None]


def _offset(
    kind: str, tree: Tree, position: Array, measured: Array, time: Array, rate: float
) -> ClockOffset | None:
    """The delay of one signal, with a drift only if it is one that clocks have.

    None where the robot hardly moves, or so shortly that rows explain whatever is measured.
    """
    rows, counted, taken = _rows(kind, tree, position, rate)
    if counted.sum() < ENOUGH * rows.shape[2]:
        return None
    reading = _Reading(measured, time, taken)
    start = _start(rows, counted, reading)
    read = reading.time + start
    counted = counted * ((read >= reading.time[0]) & (read <= reading.time[-1]))[:, None]
    found = _fitted(kind, rows, counted, reading, start, drifting=True)
    if found.drifts and abs(found.skew) < MOST_SKEW:
        return found
    return _fitted(kind, rows, counted, reading, start, drifting=False)


def _start(rows: Array, counted: Array, reading: _Reading) -> float:
    """Where to begin: at the whole number of rows that leaves far less than none [s]."""
    signal = reading.at(np.zeros(len(rows)))
    weights = 1 / np.maximum(signal.std(axis=0), 1e-12)
    signal = (signal - signal.mean(axis=0)) * weights
    spacing = float(np.diff(reading.time).mean())
    late, times = delay(rows * (counted * weights)[..., None], signal, spacing)
    return late if times < LATE else 0.0


def _fitted(
    kind: str, rows: Array, counted: Array, reading: _Reading, start: float, *, drifting: bool
) -> ClockOffset:
    """Delay and drift, channels weighed by what is left in them."""
    place = reading.time - reading.time.mean()
    powers = np.stack([np.ones_like(place), place][: 1 + drifting], axis=1)  # (T, 1 or 2)
    unknowns, weights = start * np.eye(powers.shape[1])[0], counted
    for _ in range(2):  # the second time by what is left in each channel
        basis = directions((rows * weights[..., None]).reshape(-1, rows.shape[2]), DEPENDENT)

        def rest(signal: Array, by: Array = weights, base: Array = basis) -> Array:
            flat = (signal * by).reshape(-1)
            return (flat - base @ (base.T @ flat)).reshape(signal.shape)

        unknowns = _search(reading, rest, powers, unknowns)
        left = rest(reading.at(powers @ unknowns)) / np.maximum(weights, 1e-30)
        left = np.sqrt((counted * left**2).sum(axis=0) / counted.sum(axis=0).clip(1))
        weights = counted / np.maximum(left, 1e-12)
    late = powers @ unknowns
    values = reading.at(late)
    sigma = _sigma(rest(values), rest, reading.at(late, 1), powers)
    alone = float(np.linalg.norm(weights * (values - values.mean(axis=0))))
    shares = [float(np.linalg.norm(rest(reading.at(each)))) / alone for each in (0 * late, late)]
    delay, skew = np.append(unknowns, 0.0)[:2]
    wide, drift = np.append(sigma, np.inf)[:2]
    middle = float(reading.time.mean())
    return ClockOffset(kind, float(delay), float(wide), float(skew), float(drift), middle, *shares)


class _Reading:
    """A measured signal that can be read late, filtered as rows are."""

    def __init__(self, measured: Array, time: Array, taken: Callable[[Array], Array]) -> None:
        from scipy.interpolate import make_interp_spline

        spline = make_interp_spline(time, measured, k=min(5, len(time) - 1))
        self._all, self._taken, self._splines = time, taken, (spline, spline.derivative())
        self.time = taken(time[:, None])[:, 0]

    def at(self, late: Array, derivative: int = 0) -> Array:
        """The signal so much later, or its derivative there, (T, C)."""
        shift = np.interp(self._all, self.time, late)
        at = np.clip(self._all + shift, self._all[0], self._all[-1])
        return self._taken(self._splines[derivative](at))


def _rows(
    kind: str, tree: Tree, position: Array, rate: float
) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Rows of all unknowns (T, C, N), which count (T, C), and how a signal is treated as they are.

    Those of a joint that is near a reversal do not: its dry friction has no sign there.
    """
    slow = min(1.0, rate / (6 * POSITION_CUTOFF))
    taps = motion_taps(rate, slow * POSITION_CUTOFF)
    weights = row_weights(rate, slow * POSITION_CUTOFF)
    lost, step = max(taps.shape[1], len(weights)) // 2, max(1, int(rate / FINE))
    q, qd, qdd = (thinned(position, tap[::-1], lost, step) for tap in taps)
    motion = Motion(np.arange(len(q)) * step / rate, q, qd, qdd)
    minimal = minimal_set(tree, "dynamic" if kind == "torque" else "reaction")
    columns = [regressor(tree, motion, minimal)]
    n = columns[0].shape[1]
    own = (np.ones_like(q), np.sign(qd), qd, qdd) if kind == "torque" else (np.ones((len(q), n)),)
    columns += [signal[:, :, None] * np.eye(n) for signal in own]
    rows = np.concatenate(columns, axis=2)
    smooth = row_weights(rate / step, slow * ROW_CUTOFF)
    kept = max(1, int(rate / step / ROWS_A_SECOND))

    def coarse(signal: Array) -> Array:
        flat = thinned(signal.reshape(len(signal), -1), smooth, len(smooth) // 2, kept)
        return flat.reshape(-1, *signal.shape[1:])

    def taken(signal: Array) -> Array:
        return coarse(thinned(signal, weights, lost, step))

    found = coarse(rows)
    counted = np.ones(found.shape[:2])
    if kind == "torque":
        moving = coarse((np.abs(qd) > DEADBAND).astype(np.float64))
        counted = (np.abs(moving - 1) < NEARLY).astype(np.float64)
    size = np.sqrt((found**2).sum(axis=(0, 1)))
    return found[:, :, size > 1e-9 * size.max()], counted, taken


def _search(
    reading: _Reading, rest: Callable[[Array], Array], powers: Array, start: Array
) -> Array:
    """The best delay and drift near a start."""
    unknowns, most = start.copy(), np.array(LARGEST_STEP[: len(start)])
    for _ in range(STEPS):
        late = powers @ unknowns
        left, slopes = rest(reading.at(late)), reading.at(late, 1)
        columns = [rest(slopes * power[:, None]).ravel() for power in powers.T]
        step = np.linalg.lstsq(np.column_stack(columns), -left.ravel(), rcond=None)[0]
        unknowns = unknowns + np.clip(step, -most, most)
        if abs(step[0]) < SMALLEST_STEP:
            break
    return unknowns


def _sigma(left: Array, rest: Callable[[Array], Array], slopes: Array, powers: Array) -> Array:
    """Sigmas of delay and drift, residuals correlated over some rows [NW87]."""
    columns = np.stack([rest(slopes * power[:, None]) for power in powers.T], axis=-1)
    normal = np.einsum("tci,tcj->ij", columns, columns)
    scores = np.einsum("tci,tc->ti", columns, left)
    spread = scores.T @ scores
    for lag in range(1, min(LAGS, len(scores) - 1)):
        product = scores[lag:].T @ scores[:-lag]
        spread = spread + (1 - lag / LAGS) * (product + product.T)
    inverse = np.linalg.inv(normal)
    found: Array = np.sqrt(np.maximum(np.diagonal(inverse @ spread @ inverse), 0.0))
    return found
