"""How late torques or wrench are beside the encoders: where the residuals are smallest.

Rows follow the positions' clock; the measurement is read later by s + k (t - middle), and what no
minimal parameters, friction or zero explain of it is made least by Gauss's and Newton's steps. What
is clear is taken back by the mapping's own words.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import RecordingError
from testbed.core.dynamics.newton_euler import Motion, regressor
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import standard_deviations
from testbed.core.estimation.regression.windows import motion_taps, row_weights
from testbed.core.estimation.sensor.plate import reach, shifted
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.recordings.geometry import check_robot, in_its_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.tree import Tree
from testbed.importing.check.instants import ENOUGH, LATE, decimate, delay, directions
from testbed.importing.check.remedies import wrench_tables
from testbed.importing.import_report import ImportReport, Line

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

SEGMENT, DEEP, MINIMA = 2.56, 1.0, 3
"""Length of a spectrum's segments [s]; depth of minima that are a moving average's, logarithm, and
how many are looked at."""

Remainder = Callable[[Array], Array]
"""What of a signal, (T, C), no unknowns of the rows explain, weighed."""


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
    first = max(0, (source.samples - most) // 2)
    part = source.part(first, min(source.samples, first + most)).ordered(tree)
    offsets = (
        _offset(kind, tree, part.position, part.measured(kind), part.time, source.rate, bodies)
        for kind in kinds
        if kind in part.signals and np.ptp(part.measured(kind), axis=0).any()
    )
    return [each for each in offsets if each is not None]


def delivered(tree: Tree, source: Source, bodies: Estimate) -> tuple[Recording, TimeOffset]:
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
    offset: TimeOffset, mapping: Mapping[str, Any], facts: Mapping[str, Any]
) -> Iterator[Line]:
    """Lines by which a mapping takes an offset back.

    `delay`, of all plates, and `skew` of a source that has not the positions' clock.

    Args:
        offset: How late a signal is.
        mapping: What the mapping file says, as a recording keeps it.
        facts: Of the recording that it made.
    """
    clocks = ImportReport.from_dict(facts["import"]).clocks if "import" in facts else {}
    own = {offset.signal: mapping.get(offset.signal, {})}
    tables = wrench_tables(mapping) if offset.signal == "wrench" else own
    for name, table in tables.items():
        source, delay = str(table.get("source")), float(table.get("delay", 0.0)) + offset.delay
        if offset.drifts and source != mapping["position"]["source"]:
            lead, own = clocks[source].lead, mapping["sources"][source].get("skew", 0.0)
            delay = (lead + delay - offset.skew * offset.middle) / (1 + offset.skew) - lead
            yield f"sources.{source}", "skew", round((1 + own) / (1 + offset.skew) - 1, 10)
        yield name, "delay", round(delay, 8)


def moving_average(signal: Array, rate: float) -> float:
    """The window of a moving average through which a recorder passed a signal [s]; 0 for none.

    All its channels' spectra have minima at the multiples of its inverse, two at least.

    Args:
        signal: (M, C).
        rate: Samples a second [Hz].
    """
    from scipy.signal import welch

    frequency, power = welch(signal, rate, nperseg=min(int(SEGMENT * rate), len(signal)), axis=0)
    frequency, level = frequency[1:], np.log(power[1:] + 1e-300).mean(axis=1)
    step = frequency[0]
    for first in frequency[(frequency > 4 * step) & (frequency < rate / 5)]:  # longest first
        depths = []
        for centre in np.arange(first, rate / 2 - first / 2, first)[:MINIMA]:
            away = np.abs(frequency - centre)
            beside = level[(away < first / 2) & (away > first / 4)].mean()
            depths.append(beside - level[away <= max(first / 20, step)].min())
        if len(depths) > 1 and min(depths) > DEEP:
            return float(1 / first)
    return 0.0


def _offset(
    kind: str,
    tree: Tree,
    position: Array,
    measured: Array,
    time: Array,
    rate: float,
    bodies: Estimate | None,
) -> TimeOffset | None:
    """The delay of one signal, with a drift only if it is one that clocks have.

    None where the robot hardly moves, or so shortly that rows explain whatever is measured.
    """
    rows, counted, smooth = _rows(kind, tree, position, rate, bodies)
    if counted.sum() < ENOUGH * rows.shape[2]:
        return None
    signal = _Signal(measured, time, smooth)
    start = _start(rows, counted, signal)
    read = signal.time + start
    counted = counted * ((read >= signal.time[0]) & (read <= signal.time[-1]))[:, None]
    offset = _fit(kind, rows, counted, signal, start, drifting=True)
    if offset.drifts and abs(offset.skew) < MOST_SKEW:
        return offset
    return _fit(kind, rows, counted, signal, start, drifting=False)


class _Signal:
    """A measured signal that can be read late, filtered as rows are."""

    def __init__(self, measured: Array, time: Array, smooth: Callable[[Array], Array]) -> None:
        from scipy.interpolate import make_interp_spline

        spline = make_interp_spline(time, measured, k=min(5, len(time) - 1))
        self._all, self._smooth, self._splines = time, smooth, (spline, spline.derivative())
        self.time = smooth(time[:, None])[:, 0]

    def at(self, late: Array, derivative: int = 0) -> Array:
        """The signal so much later, or its derivative there, (T, C)."""
        shift = np.interp(self._all, self.time, late)
        at = np.clip(self._all + shift, self._all[0], self._all[-1])
        return self._smooth(self._splines[derivative](at))


def _rows(
    kind: str, tree: Tree, position: Array, rate: float, bodies: Estimate | None
) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Rows of all unknowns (T, C, N), which count (T, C), and how a signal is treated as they are.

    Those of a joint that is near a reversal do not: its dry friction has no sign there.
    """
    slow = min(1.0, rate / (6 * POSITION_CUTOFF))
    taps = motion_taps(rate, slow * POSITION_CUTOFF)
    weights = row_weights(rate, slow * POSITION_CUTOFF)
    lost, step = max(taps.shape[1], len(weights)) // 2, max(1, int(rate / FINE))
    q, qd, qdd = (decimate(position, tap[::-1], lost, slice(None, None, step)) for tap in taps)
    motion = Motion(np.arange(len(q)) * step / rate, q, qd, qdd)
    minimal = minimal_set(tree, "dynamic" if kind == "torque" else "reaction")
    columns = [regressor(tree, motion, minimal)]
    n = columns[0].shape[1]
    if bodies is not None and kind == "torque":
        theta = bodies.minimal.lift @ bodies.values[: bodies.minimal.count]
        columns = [(columns[0] @ (minimal.matrix @ theta))[:, :, None] * np.eye(n)]
    own = (np.ones_like(q), np.sign(qd), qd, qdd) if kind == "torque" else (np.ones((len(q), n)),)
    columns += [signal[:, :, None] * np.eye(n) for signal in own]
    row_filter = row_weights(rate / step, slow * ROW_CUTOFF)
    every = max(1, int(rate / step / ROWS_A_SECOND))

    def coarse(signal: Array) -> Array:
        flat = decimate(
            signal.reshape(len(signal), -1),
            row_filter,
            len(row_filter) // 2,
            slice(None, None, every),
        )
        return flat.reshape(-1, *signal.shape[1:])

    def smooth(signal: Array) -> Array:
        return coarse(decimate(signal, weights, lost, slice(None, None, step)))

    rows = coarse(np.concatenate(columns, axis=2))
    counted = np.ones(rows.shape[:2])
    if kind == "torque":
        moving = coarse((np.abs(qd) > DEADBAND).astype(np.float64))
        counted = (np.abs(moving - 1) < NEARLY).astype(np.float64)
    size = np.sqrt((rows**2).sum(axis=(0, 1)))
    return rows[:, :, size > 1e-9 * size.max()], counted, smooth


def _start(rows: Array, counted: Array, signal: _Signal) -> float:
    """Where to begin: at the whole number of rows that leaves far less than none [s]."""
    values = signal.at(np.zeros(len(rows)))
    weights = 1 / np.maximum(values.std(axis=0), 1e-12)
    values = (values - values.mean(axis=0)) * weights
    spacing = float(np.diff(signal.time).mean())
    late, times = delay(rows * (counted * weights)[..., None], values, spacing)
    return late if times < LATE else 0.0


def _fit(
    kind: str, rows: Array, counted: Array, signal: _Signal, start: float, *, drifting: bool
) -> TimeOffset:
    """Delay and drift, channels weighed by what is left in them."""
    middle = float(signal.time.mean())
    powers = np.stack([np.ones_like(signal.time), signal.time - middle][: 1 + drifting], axis=1)
    unknowns, weights = start * np.eye(1 + drifting)[0], counted
    for _ in range(2):  # the second time by what is left in each channel
        rest = _remainder(rows, weights)
        best = _search(signal, rest, powers, unknowns)
        unknowns, residual = best.x, best.fun.reshape(counted.shape)
        size = residual / np.maximum(weights, 1e-30)
        size = np.sqrt((counted * size**2).sum(axis=0) / counted.sum(axis=0).clip(1))
        weights = counted / np.maximum(size, 1e-12)
    values = signal.at(powers @ unknowns)
    alone = float(np.linalg.norm(weights * (values - values.mean(axis=0))))
    before = float(np.linalg.norm(rest(signal.at(0 * signal.time)))) / alone
    after = float(np.linalg.norm(residual)) / alone
    sigma = _sigma(residual, best.jac.reshape(*residual.shape, -1))
    late, skew = np.append(unknowns, 0.0)[:2].tolist()
    late_sigma, skew_sigma = np.append(sigma, np.inf)[:2].tolist()
    return TimeOffset(kind, late, late_sigma, skew, skew_sigma, middle, before, after)


def _remainder(rows: Array, weights: Array) -> Remainder:
    """What of a signal, weighed, no unknowns of the rows explain, (T, C) of (T, C)."""
    basis = directions((rows * weights[..., None]).reshape(-1, rows.shape[2]), DEPENDENT)

    def rest(signal: Array) -> Array:
        flat = (signal * weights).reshape(-1)
        return (flat - basis @ (basis.T @ flat)).reshape(signal.shape)

    return rest


def _search(signal: _Signal, rest: Remainder, powers: Array, start: Array) -> Any:
    """Delay and drift that leave the least; SciPy's result."""
    from scipy.optimize import least_squares

    def residuals(unknowns: Array) -> Array:
        return rest(signal.at(powers @ unknowns)).ravel()

    def slopes(unknowns: Array) -> Array:
        rates = signal.at(powers @ unknowns, 1)
        return np.stack([rest(rates * power[:, None]).ravel() for power in powers.T], axis=1)

    return least_squares(residuals, start, slopes, method="lm")


def _sigma(residual: Array, columns: Array) -> Array:
    """Sigmas of delay and drift, residuals correlated over some rows [NW87]."""
    normal = np.einsum("tci,tcj->ij", columns, columns)
    scores = np.einsum("tci,tc->ti", columns, residual)
    spread = scores.T @ scores
    for lag in range(1, min(LAGS, len(scores) - 1)):
        product = scores[lag:].T @ scores[:-lag]
        spread = spread + (1 - lag / LAGS) * (product + product.T)
    inverse = np.linalg.inv(normal)
    sigma: Array = standard_deviations(inverse @ spread @ inverse)
    return sigma
