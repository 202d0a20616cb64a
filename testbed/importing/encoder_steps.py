"""Steps of encoders from one sample to the next: whole turns are taken back, others named."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.recordings.channels import steps
from testbed.importing.foreign_table import ANGLES, factor, plain
from testbed.importing.mapping import SignalTable

LEAST = 5e-3
"""Least size of a step [rad or m]."""

LOST = 20
"""Samples of one value before a step that lost samples leave, and no re-homing does."""

MOST = 3
"""Steps of a joint above which they are noise, or lost samples."""


def without_turns(
    table: SignalTable, names: Sequence[str], time: Array, values: Array
) -> tuple[Array, tuple[Diagnostic, ...]]:
    """Unwrapped positions (M, k), and the steps removed or left.

    Args:
        table: Of the positions.
        names: Of the joints; of the columns where a matrix mixes them.
        time: (M,), increasing [s].
        values: As the file holds them, (M, k).
    """
    found, said = values.copy(), []
    wrapped: dict[str, int] = {}
    for k, (name, unit) in enumerate(zip(names, table.units, strict=True)):
        scale = factor("position", unit)
        if table.matrix is not None:
            scale *= float(np.abs(np.array(table.matrix)[:, k]).max())
        if plain(unit) in ANGLES:
            turn = 2 * np.pi / scale
            turns = np.round(np.diff(found[:, k]) / turn)
            found[1:, k] -= turn * np.cumsum(turns)
            if turns.any():
                wrapped[name] = int(np.count_nonzero(turns))
        sizes = {
            i: size
            for i, size in steps(time, found[:, k])
            if abs(size) * scale > LEAST and not _thaws(found[:, k], i)
        }
        if 0 < len(sizes) <= MOST:
            times = ", ".join(f"{time[i + 1] - time[0]:.6g}" for i in sizes)
            said.append(
                diagnose(
                    "position.step",
                    name,
                    scale * max(sizes.values(), key=abs),
                    at=times,
                )
            )
    if wrapped:
        names_of = ", ".join(f"{name} {count} times" for name, count in wrapped.items())
        said.append(diagnose("position.unwrapped", names_of, sum(wrapped.values())))
    return found, tuple(said)


def _thaws(values: Array, i: int) -> bool:
    """Whether a column that stood still moves from a sample on: values were lost, no zero moved."""
    still = i >= LOST and not np.ptp(values[i - LOST : i + 1])
    return still and bool(values[i + 1] != values[i + 2])
