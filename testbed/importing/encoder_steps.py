"""Steps in encoder readings: whole turns are removed, other steps are reported."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.recordings.channel_tests import signal_steps
from testbed.importing.foreign_table import ANGLE_UNITS, canonical_unit, unit_size
from testbed.importing.mapping import SignalTable

MIN_STEP = 5e-3
"""Smallest size of a reported step [rad or m]."""

MIN_STANDSTILL_SAMPLES = 20
"""Number of equal samples before a step from which on samples were lost; the zero did not move."""

MAX_STEPS = 3
"""Number of steps of a joint above which they are noise or lost samples, and not reported."""


def unwrapped_positions(
    table: SignalTable, names: Sequence[str], time: Array, values: Array
) -> tuple[Array, tuple[Diagnostic, ...]]:
    """Unwrapped positions, (M, k), and diagnostics of removed turns and of remaining steps.

    Differences of successive angles are reduced by the nearest number of whole turns. Steps found
    by `signal_steps` are then reported if they exceed 5e-3 rad or m, do not end a standstill, and
    number at most three in their column.

    Args:
        table: Table of the positions in the mapping.
        names: Joint names, or names of the columns if a matrix mixes them.
        time: Sample times, increasing, (M,) [s].
        values: Positions in the units of the file, (M, k).
    """
    unwrapped, diagnostics = values.copy(), []
    turn_counts: dict[str, int] = {}
    for k, (name, unit) in enumerate(zip(names, table.units, strict=True)):
        scale = unit_size("position", unit)
        if table.matrix is not None:
            scale *= float(np.abs(np.array(table.matrix)[:, k]).max())
        if canonical_unit(unit) in ANGLE_UNITS:
            turn = 2 * np.pi / scale
            turns = np.round(np.diff(unwrapped[:, k]) / turn)
            unwrapped[1:, k] -= turn * np.cumsum(turns)
            if turns.any():
                turn_counts[name] = int(np.count_nonzero(turns))
        jumps = {
            i: jump
            for i, jump in signal_steps(time, unwrapped[:, k])
            if abs(jump) * scale > MIN_STEP and not _ends_standstill(unwrapped[:, k], i)
        }
        if 0 < len(jumps) <= MAX_STEPS:
            times = ", ".join(f"{time[i + 1] - time[0]:.6g}" for i in jumps)
            diagnostics.append(
                make_diagnostic(
                    "position.step",
                    name,
                    scale * max(jumps.values(), key=abs),
                    at=times,
                )
            )
    if turn_counts:
        counts_text = ", ".join(
            f"{name} {count} times" for name, count in turn_counts.items()
        )
        diagnostics.append(
            make_diagnostic(
                "position.unwrapped", counts_text, sum(turn_counts.values())
            )
        )
    return unwrapped, tuple(diagnostics)


def _ends_standstill(values: Array, i: int) -> bool:
    """Test whether a column is constant over 20 samples before a step, and moves afterwards.

    At such a step samples were lost; the zero of the encoder did not move.
    """
    constant = i >= MIN_STANDSTILL_SAMPLES and not np.ptp(
        values[i - MIN_STANDSTILL_SAMPLES : i + 1]
    )
    return constant and bool(values[i + 1] != values[i + 2])
