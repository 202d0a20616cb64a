"""A signal held against the derivative of another: its unit, its sign, its order.

What is said to be a velocity is integrated over short times and compared with how far the joints
came meanwhile, which needs no derivative of noisy positions.
"""

from __future__ import annotations

from collections.abc import Mapping as Columns
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import UNITS, Kind, plain
from testbed.importing.import_report import Line, SignalReport, in_mapping
from testbed.importing.mapping import Mapping, SignalTable

PARTS = (200, 60, 20)
"""Of a recording, over each of which is integrated: long ones hear less noise, short ones more of
a fast motion."""

SURE = 0.9
"""Part of the variance from which on a signal is explained."""

BETTER = 5.0
"""So many times less than its own leaves another joint's signal unexplained, if that is the right
one: joints of some motions go nearly alike, and each then explains the other."""

NEAR = 0.1
"""Relative error of a slope that no unit explains."""

BETWEEN = 0.03
"""Relative error of a slope by which a unit is recognised."""

MOVED = 0.02
"""Integral of a velocity from which a joint has moved [rad or m]."""


class DerivativeError(RecordingError):
    """Mismatch of units, signs or order between a signal and a derivative.

    Attributes:
        lines: Lines of the mapping that correct it; none where a matrix is in the way.
    """

    def __init__(self, message: str, lines: Sequence[Line]) -> None:
        super().__init__(message)
        self.lines = tuple(lines)


@dataclass(frozen=True, eq=False)
class Slopes:
    """How signals follow from integrals of others.

    Attributes:
        slope: (n, n): of i's increments on j's integrals.
        fit: (n, n): the part of i's variance that it explains; 0 where nothing moves.
    """

    slope: Array
    fit: Array

    @property
    def likely(self) -> NDArray[np.intp]:
        """(n,): whose integral each signal is: its own, unless another's explains it far better."""
        joints = np.arange(len(self.fit))
        best, own = np.argmax(self.fit, axis=1), np.diagonal(self.fit)
        most = self.fit[joints, best]
        other = (most > SURE) & (1 - own > BETTER * (1 - most))
        found = np.where(other, best, joints)
        return found if len(set(found.tolist())) == len(joints) else joints


def slopes(values: Array, rates: Array, time: Array) -> Slopes:
    """Increments of signals regressed on integrals of others.

    Args:
        values: (M, n), as positions.
        rates: (M, n), as velocities.
        time: (M,).
    """
    whole_rows = np.isfinite(values).all(axis=1) & np.isfinite(rates).all(axis=1)
    values, rates, time = values[whole_rows], rates[whole_rows], time[whole_rows]
    if len(time) < 2:  # of several devices
        return Slopes(*np.zeros((2, values.shape[1], rates.shape[1])))
    areas = 0.5 * np.diff(time)[:, None] * (rates[1:] + rates[:-1])
    whole = np.vstack([np.zeros(rates.shape[1]), np.cumsum(areas, axis=0)])
    reaches = {max(1, len(time) // parts) for parts in PARTS}
    found = [_over(reach, values, whole) for reach in sorted(reaches)]
    return max(found, key=lambda each: float(each.fit.max(axis=1).sum()))


def _over(reach: int, values: Array, whole: Array) -> Slopes:
    """Increments over so many samples."""
    increments = (each[reach:] - each[:-reach] for each in (values, whole))
    moved, came = (each - each.mean(axis=0) for each in increments)
    between, squares = moved.T @ came, (came * came).sum(axis=0)
    total = (moved * moved).sum(axis=0)[:, None] * squares
    with np.errstate(divide="ignore", invalid="ignore"):
        slope, fit = between / squares, between**2 / total
    return Slopes(
        np.nan_to_num(slope, posinf=0, neginf=0), np.nan_to_num(fit, posinf=0, neginf=0)
    )


def unit_of(kind: str, size: float) -> str | None:
    """The unit of what is measured whose factor is of a size; None if none is.

    Args:
        kind: A key of `UNITS`.
        size: What one of it is in SI.
    """
    near = {
        unit: abs(factor / size - 1) for unit, factor in UNITS[kind].items() if size > 0
    }
    best = min(near, key=near.__getitem__, default=None)
    return best if best is not None and near[best] < BETWEEN else None


def derivatives(
    mapping: Mapping, columns: Columns[str, Array], reports: Columns[str, SignalReport]
) -> dict[str, SignalReport]:
    """Reports of velocities and accelerations, held against what they are derivatives of.

    Args:
        mapping: What it says of them.
        columns: Of the recording, (M,) each.
        reports: Of all signals.

    Raises:
        RecordingError: They are derivatives in another unit, sense or order.
    """
    found: dict[str, SignalReport] = {}
    pairs: tuple[tuple[Kind, Kind], ...] = (
        ("position", "velocity"),
        ("velocity", "acceleration"),
    )
    for below, kind in pairs:
        if below not in mapping.signals or kind not in mapping.signals:
            continue
        values, rates = (
            np.stack([columns[f"{each}/{joint}"] for joint in mapping.joints], axis=1)
            for each in (below, kind)
        )
        _check_moves(kind, below, mapping.joints, values, rates, columns["time"])
        said = _diagnostics(
            *(kind, mapping.signals[kind], below, mapping.signals[below]),
            mapping.joints,
            slopes(values, rates, columns["time"]),
            np.sqrt([np.mean(each**2, axis=0) for each in (values, rates)]),
        )
        found[kind] = replace(reports[kind], diagnostics=said)
    return found


def _check_moves(
    kind: Kind,
    of: Kind,
    joints: Sequence[str],
    values: Array,
    rates: Array,
    time: Array,
) -> None:
    """Whether what has a derivative changes at all."""
    varied = np.cumsum(
        (rates - rates.mean(axis=0))[1:] * np.diff(time)[:, None], axis=0
    )
    dead = (np.ptp(values, axis=0) == 0) & (np.ptp(varied, axis=0) > MOVED)
    names = np.array(joints)[dead].tolist()
    if names:
        raise RecordingError(
            f"the {of} of {_listed(names, len(joints))} is the same throughout, and by the {kind} "
            f"it moves: a dead encoder, or another column in [{of}] columns; or leave [{kind}] out"
        )


def _diagnostics(
    kind: Kind,
    table: SignalTable,
    of: Kind,
    below: SignalTable,
    joints: Sequence[str],
    found: Slopes,
    sizes: Array,
) -> tuple[Diagnostic, ...]:
    """What to doubt of a signal that should be the derivative of another, both of sizes (2, n).

    Raises:
        RecordingError: It is of another unit, sign or order; says which mapping line corrects
            it.
    """
    n, order = len(joints), found.likely
    own = np.arange(n)
    slope, fit = found.slope[own, order], found.fit[own, order]
    sure = fit > SURE
    wrong = sure & (np.abs(slope - 1) > NEAR)
    if (order != own).any() or wrong.any():
        read = np.stack([sizes[0], sizes[1][order]])
        lines = _lines(kind, table, of, below, order, np.where(sure, slope, 1.0), read)
        names = [joints[k] for k in range(n) if wrong[k] or order[k] != k]
        said = (
            f"it is {_times(slope[wrong])}"
            if wrong.any()
            else "it is that of other joints"
        )
        advice = (
            in_mapping(lines)
            if lines
            else f"in the mapping: check [{kind}] unit, side, sign and matrix"
        )
        raise DerivativeError(
            f"the {kind} of {_listed(names, n)} is not the derivative of the {of}: {said}; "
            f"{advice}; or leave [{kind}] out",
            lines,
        )
    moving = (found.fit.max(axis=1) > 0) & ~sure
    if not moving.any():
        return ()
    names = np.array(joints)[moving].tolist()
    least = float(fit[moving].min())
    return (diagnose("import.derivative", _listed(names, n), least, kind=kind, of=of),)


def _listed(names: Sequence[str], count: int) -> str:
    if len(names) == count > 1:
        return "all joints"
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"joint{'s' * (len(names) > 1)} {', '.join(names[:3])}{more}"


def _times(slope: Array) -> str:
    """Which part of the derivative a signal is."""
    said = sorted({f"{1 / each:.3g}" for each in slope}, key=float)
    return f"{' or '.join(said[:3])} times that"


def _lines(
    kind: Kind,
    table: SignalTable,
    of: Kind,
    below: SignalTable,
    order: NDArray[np.intp],
    slope: Array,
    read: Array,
) -> list[Line]:
    """Lines of the mapping without the mistake.

    Of two signals whose units may be wrong that one is whose sizes are less usual.
    """
    if table.matrix is not None or below.matrix is not None:
        return []
    lines: list[Line] = []
    joints = np.arange(len(order))
    if (order != joints).any():
        lines.append((kind, "columns", [table.columns[k] for k in order]))
    if (slope < 0).any():
        before = table.sign or [1] * len(slope)
        signs = [int(np.sign(s)) * before[k] for k, s in zip(order, slope, strict=True)]
        lines.append((kind, "sign", signs))
    sizes = np.abs(slope)
    if (np.abs(sizes - 1) > NEAR).any():
        own = _units(kind, table, order, sizes)
        other = _units(of, below, joints, 1 / sizes)
        if own is None and other is None:
            return []
        of_below = own is None or (other is not None and _odd(read, sizes) > 0)
        lines.append((of, "unit", other) if of_below else (kind, "unit", own))
    return lines


def _odd(read: Array, sizes: Array) -> float:
    """By how much less usual it is that the derivative's unit is wrong than the signal's own.

    Joints turn, or slide, by about one, and as fast: logarithms of sizes are small.
    """
    wrong = np.abs(sizes - 1) > NEAR
    values, rates = np.maximum(read[:, wrong], 1e-12)
    found = np.abs(np.log([values, rates * sizes[wrong]])) - np.abs(
        np.log([values / sizes[wrong], rates])
    )
    return float(found.sum(axis=0).mean())


def _units(
    kind: Kind, table: SignalTable, order: NDArray[np.intp], sizes: Array
) -> str | list[str] | None:
    """Units that make a signal so many times larger, one if all are the same; None if none do."""
    now = [plain(table.units[k]) for k in order]
    found = []
    for unit, size in zip(now, sizes, strict=True):
        factor = UNITS[kind].get(unit, 0.0)
        found.append(unit if abs(size - 1) <= NEAR else unit_of(kind, factor * size))
    if None in found:
        return None
    units = [str(each) for each in found]
    return units[0] if len(set(units)) == 1 else units
