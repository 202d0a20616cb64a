"""Check of measured derivatives: unit, sign and joint order of velocities and accelerations.

Velocities are integrated over short windows, and the increments of the positions are regressed on
these integrals, so noisy positions are never differentiated. Accelerations are compared with
velocities in the same way.
"""

from __future__ import annotations

from collections.abc import Mapping as Columns
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import (
    UNITS_BY_QUANTITY,
    JointQuantity,
    canonical_unit,
)
from testbed.importing.import_report import MappingLine, SignalReport, mapping_advice
from testbed.importing.mapping import Mapping, SignalTable

WINDOWS_PER_RECORDING = (200, 60, 20)
"""Numbers of integration windows in a recording: few long windows average noise out, many short
windows resolve fast motion."""

MIN_EXPLAINED_VARIANCE = 0.9
"""Share of the variance from which on a regression explains a signal."""

MIN_RESIDUAL_RATIO = 5.0
"""Ratio of unexplained variances, own integral over another joint's, from which on the other joint
is taken. Two joints may move nearly alike, and each integral then explains both."""

MAX_SLOPE_ERROR = 0.1
"""Relative error of a slope from which on unit or sign are wrong."""

UNIT_TOLERANCE = 0.03
"""Relative error of a slope within which a unit is recognised."""

MIN_MOTION = 0.02
"""Range of a velocity's integral from which on a joint has moved [rad or m]."""


class DerivativeError(RecordingError):
    """Mismatch of units, signs or joint order between a signal and its derivative.

    Attributes:
        lines: Lines of the mapping file that correct the mismatch; empty if a matrix mixes the
            columns or no known unit fits.
    """

    def __init__(self, message: str, lines: Sequence[MappingLine]) -> None:
        super().__init__(message)
        self.lines = tuple(lines)


@dataclass(frozen=True, eq=False)
class DerivativeRegression:
    """Separate regressions of each signal's increments on the integral of each derivative.

    Attributes:
        slope: Slope of signal i's increments as a function of integral j, (n, n).
        explained_variance: Squared correlation of signal i with integral j, (n, n); 0 where a
            signal or integral is constant.
    """

    slope: Array
    explained_variance: Array

    @property
    def column_order(self) -> NDArray[np.intp]:
        """Index of the integral that fits each signal, (n,).

        It is the signal's own index unless another integral explains more than 0.9 of the variance
        and leaves less than a fifth of the residual variance that the signal's own integral leaves.
        If the result is not a permutation, every signal keeps its own index.
        """
        joints = np.arange(len(self.explained_variance))
        best, own = (
            np.argmax(self.explained_variance, axis=1),
            np.diagonal(self.explained_variance),
        )
        best_fit = self.explained_variance[joints, best]
        better_fit = (best_fit > MIN_EXPLAINED_VARIANCE) & (
            1 - own > MIN_RESIDUAL_RATIO * (1 - best_fit)
        )
        order = np.where(better_fit, best, joints)
        return order if len(set(order.tolist())) == len(joints) else joints


def regress_on_integrals(
    values: Array, rates: Array, time: Array
) -> DerivativeRegression:
    """Regress the increments of signals on the integrals of possible derivatives.

    Increments over 1/200, 1/60 and 1/20 of the samples are tried. The regression returned has the
    largest sum, over the signals, of the best explained variance. Rows with nan are omitted.

    Args:
        values: Signals, for example positions, (M, n).
        rates: Derivatives, for example velocities, (M, n).
        time: Sample times, (M,) [s].
    """
    whole_rows = np.isfinite(values).all(axis=1) & np.isfinite(rates).all(axis=1)
    values, rates, time = values[whole_rows], rates[whole_rows], time[whole_rows]
    if len(time) < 2:  # rows of several devices
        return DerivativeRegression(*np.zeros((2, values.shape[1], rates.shape[1])))
    areas = 0.5 * np.diff(time)[:, None] * (rates[1:] + rates[:-1])
    integrals = np.vstack([np.zeros(rates.shape[1]), np.cumsum(areas, axis=0)])
    spans = {max(1, len(time) // windows) for windows in WINDOWS_PER_RECORDING}
    regressions = [_regression(span, values, integrals) for span in sorted(spans)]
    return max(
        regressions, key=lambda each: float(each.explained_variance.max(axis=1).sum())
    )


def _regression(span: int, values: Array, integrals: Array) -> DerivativeRegression:
    """Regress increments of signals on increments of integrals over a given number of samples.

    Args:
        span: Number of samples over which increments are taken.
        values: Signals, (M, n).
        integrals: Integrals of the derivatives, (M, n).
    """
    increments = (each[span:] - each[:-span] for each in (values, integrals))
    value_increments, integral_increments = (
        each - each.mean(axis=0) for each in increments
    )
    products, squares = (
        value_increments.T @ integral_increments,
        (integral_increments * integral_increments).sum(axis=0),
    )
    total = (value_increments * value_increments).sum(axis=0)[:, None] * squares
    with np.errstate(divide="ignore", invalid="ignore"):
        slope, fit = products / squares, products**2 / total
    return DerivativeRegression(
        np.nan_to_num(slope, posinf=0, neginf=0), np.nan_to_num(fit, posinf=0, neginf=0)
    )


def unit_of_size(kind: str, size: float) -> str | None:
    """Unit of a quantity whose size is within 3 % of a given size.

    Args:
        kind: Quantity, a key of `UNITS_BY_QUANTITY`.
        size: Size of the unit in SI.

    Returns:
        Unit nearest in size; None if no unit is within 3 %.
    """
    errors = {
        unit: abs(factor / size - 1)
        for unit, factor in UNITS_BY_QUANTITY[kind].items()
        if size > 0
    }
    best = min(errors, key=errors.__getitem__, default=None)
    return best if best is not None and errors[best] < UNIT_TOLERANCE else None


def check_derivatives(
    mapping: Mapping, columns: Columns[str, Array], reports: Columns[str, SignalReport]
) -> dict[str, SignalReport]:
    """Compare velocities with positions, and accelerations with velocities, and report mismatches.

    A slope of `regress_on_integrals` that differs from one by more than 10 % is an error. Joints
    for which the integral explains at most 0.9 of the variance are reported in a diagnostic.

    Args:
        mapping: Content of the mapping file.
        columns: Columns of the recording, keyed by name, (M,) each.
        reports: Reports of all signals.

    Returns:
        Reports of velocity and acceleration, with the diagnostics of this comparison.

    Raises:
        RecordingError: A derivative has another unit, sign or joint order, or a position is
            constant although its velocity is not.
    """
    checked: dict[str, SignalReport] = {}
    pairs: tuple[tuple[JointQuantity, JointQuantity], ...] = (
        ("position", "velocity"),
        ("velocity", "acceleration"),
    )
    for below, kind in pairs:
        if (
            below not in mapping.joint_signal_tables
            or kind not in mapping.joint_signal_tables
        ):
            continue
        values, rates = (
            np.stack([columns[f"{each}/{joint}"] for joint in mapping.joints], axis=1)
            for each in (below, kind)
        )
        _check_positions_change(
            kind, below, mapping.joints, values, rates, columns["time"]
        )
        diagnostics = _derivative_diagnostics(
            *(
                kind,
                mapping.joint_signal_tables[kind],
                below,
                mapping.joint_signal_tables[below],
            ),
            mapping.joints,
            regress_on_integrals(values, rates, columns["time"]),
            np.sqrt([np.mean(each**2, axis=0) for each in (values, rates)]),
        )
        checked[kind] = replace(reports[kind], diagnostics=diagnostics)
    return checked


def _check_positions_change(
    kind: JointQuantity,
    of: JointQuantity,
    joints: Sequence[str],
    values: Array,
    rates: Array,
    time: Array,
) -> None:
    """Refuse a signal that is constant although its derivative shows motion.

    The derivative shows motion if its integral, after subtraction of its mean, spans more than
    `MIN_MOTION`.

    Args:
        kind: Kind of the derivative.
        of: Kind of the signal.
        joints: Joint names.
        values: Signal, (M, n).
        rates: Derivative, (M, n).
        time: Sample times, (M,) [s].

    Raises:
        RecordingError: The signal of such a joint is constant.
    """
    displacement = np.cumsum(
        (rates - rates.mean(axis=0))[1:] * np.diff(time)[:, None], axis=0
    )
    constant = (np.ptp(values, axis=0) == 0) & (
        np.ptp(displacement, axis=0) > MIN_MOTION
    )
    names = np.array(joints)[constant].tolist()
    if names:
        raise RecordingError(
            f"the {of} of {_joints(names, len(joints))} is the same throughout, and by the {kind} "
            f"it moves: a dead encoder, or another column in [{of}] columns; or leave [{kind}] out"
        )


def _derivative_diagnostics(
    kind: JointQuantity,
    table: SignalTable,
    of: JointQuantity,
    below: SignalTable,
    joints: Sequence[str],
    fits: DerivativeRegression,
    rms_of_pair: Array,
) -> tuple[Diagnostic, ...]:
    """Diagnostic of moving joints whose explained variance is at most 0.9, if any.

    Args:
        kind: Kind of the derivative.
        table: Table of the derivative in the mapping.
        of: Kind of the signal.
        below: Table of the signal in the mapping.
        joints: Joint names.
        fits: Regression of the signal on the integrals of the derivative.
        rms_of_pair: Root mean squares of signal and derivative, (2, n).

    Raises:
        DerivativeError: The derivative has another unit, sign or joint order.
    """
    n, order = len(joints), fits.column_order
    indices = np.arange(n)
    slope, fit = fits.slope[indices, order], fits.explained_variance[indices, order]
    explained = fit > MIN_EXPLAINED_VARIANCE
    wrong = explained & (np.abs(slope - 1) > MAX_SLOPE_ERROR)
    if (order != indices).any() or wrong.any():
        rms = np.stack([rms_of_pair[0], rms_of_pair[1][order]])
        lines = _correcting_lines(
            kind, table, of, below, order, np.where(explained, slope, 1.0), rms
        )
        names = [joints[k] for k in range(n) if wrong[k] or order[k] != k]
        mismatch = (
            f"it is {_ratio_text(slope[wrong])}"
            if wrong.any()
            else "it is that of other joints"
        )
        advice = (
            mapping_advice(lines)
            if lines
            else f"in the mapping: check [{kind}] unit, side, sign and matrix"
        )
        raise DerivativeError(
            f"the {kind} of {_joints(names, n)} is not the derivative of the {of}: {mismatch}; "
            f"{advice}; or leave [{kind}] out",
            lines,
        )
    moving = (fits.explained_variance.max(axis=1) > 0) & ~explained
    if not moving.any():
        return ()
    names = np.array(joints)[moving].tolist()
    lowest_fit = float(fit[moving].min())
    return (
        make_diagnostic(
            "import.derivative", _joints(names, n), lowest_fit, kind=kind, of=of
        ),
    )


def _joints(names: Sequence[str], count: int) -> str:
    """Names of joints as text: at most three, or "all joints".

    Args:
        names: Names of the joints.
        count: Number of joints of the robot.
    """
    if len(names) == count > 1:
        return "all joints"
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"joint{'s' * (len(names) > 1)} {', '.join(names[:3])}{more}"


def _ratio_text(slope: Array) -> str:
    """Ratios of a measured derivative to the true derivative, as text."""
    ratios = sorted({f"{1 / each:.3g}" for each in slope}, key=float)
    return f"{' or '.join(ratios[:3])} times that"


def _correcting_lines(
    kind: JointQuantity,
    table: SignalTable,
    of: JointQuantity,
    below: SignalTable,
    order: NDArray[np.intp],
    slope: Array,
    rms: Array,
) -> list[MappingLine]:
    """Lines of the mapping file that correct columns, signs or units.

    If the unit of either the signal or the derivative may be wrong, `_log_size_excess` decides: the
    correction that gives the more usual sizes of both is taken. The list is empty if no correction
    is found.

    Args:
        kind: Kind of the derivative.
        table: Table of the derivative in the mapping.
        of: Kind of the signal.
        below: Table of the signal in the mapping.
        order: Index of the derivative's column that belongs to each joint, (n,).
        slope: Slopes of the signal's increments as a function of the derivative's integrals, (n,).
        rms: Root mean squares of signal and derivative in the new order, (2, n).
    """
    if table.matrix is not None or below.matrix is not None:
        return []
    lines: list[MappingLine] = []
    joints = np.arange(len(order))
    if (order != joints).any():
        lines.append((kind, "columns", [table.columns[k] for k in order]))
    if (slope < 0).any():
        signs_before = table.sign or [1] * len(slope)
        signs = [
            int(np.sign(s)) * signs_before[k] for k, s in zip(order, slope, strict=True)
        ]
        lines.append((kind, "sign", signs))
    ratios = np.abs(slope)
    if (np.abs(ratios - 1) > MAX_SLOPE_ERROR).any():
        own_units = _corrected_units(kind, table, order, ratios)
        units_below = _corrected_units(of, below, joints, 1 / ratios)
        if own_units is None and units_below is None:
            return []
        of_below = own_units is None or (
            units_below is not None and _log_size_excess(rms, ratios) > 0
        )
        lines.append(
            (of, "unit", units_below) if of_below else (kind, "unit", own_units)
        )
    return lines


def _log_size_excess(rms: Array, ratios: Array) -> float:
    """Difference of a unit criterion: derivative's unit corrected minus signal's unit corrected.

    The criterion is the sum of |log(rms)| of signal and derivative after the correction. Joints
    typically move by about one radian or metre, and by about as much per second, so the criterion
    is small if the units are right. A positive difference indicates a wrong unit of the signal.

    Args:
        rms: Root mean squares of signal and derivative, (2, n).
        ratios: Absolute slopes, (n,), by which the derivative's unit would be corrected.
    """
    wrong = np.abs(ratios - 1) > MAX_SLOPE_ERROR
    values, rates = np.maximum(rms[:, wrong], 1e-12)
    log_sizes = np.abs(np.log([values, rates * ratios[wrong]])) - np.abs(
        np.log([values / ratios[wrong], rates])
    )
    return float(log_sizes.sum(axis=0).mean())


def _corrected_units(
    kind: JointQuantity, table: SignalTable, order: NDArray[np.intp], ratios: Array
) -> str | list[str] | None:
    """Units that scale a signal by given ratios; None if no known units do.

    Args:
        kind: Kind of the signal.
        table: Table of the signal in the mapping.
        order: Index of the column that belongs to each joint, (n,).
        ratios: Ratio of the right unit to the stated unit, (n,).
    """
    stated = [canonical_unit(table.units[k]) for k in order]
    corrected = []
    for unit, ratio in zip(stated, ratios, strict=True):
        factor = UNITS_BY_QUANTITY[kind].get(unit, 0.0)
        corrected.append(
            unit
            if abs(ratio - 1) <= MAX_SLOPE_ERROR
            else unit_of_size(kind, factor * ratio)
        )
    if None in corrected:
        return None
    units = [str(each) for each in corrected]
    return units[0] if len(set(units)) == 1 else units
