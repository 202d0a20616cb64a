"""Steps of encoders from one sample to the next: whole turns are taken back, others named."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.importing.foreign_table import ANGLES, factor, plain
from testbed.importing.mapping import SignalTable

OUTLYING = 10.0
"""Times all but the fastest of a joint's other changes that a step is at least."""

LEAST = 5e-3
"""Least size of a step [rad or m]."""

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
        steps = {
            i: size
            for i, size in _steps(time, found[:, k])
            if abs(size) * scale > LEAST
        }
        if 0 < len(steps) <= MOST:
            times = ", ".join(f"{time[i + 1] - time[0]:.6g}" for i in steps)
            said.append(
                diagnose(
                    "position.step",
                    name,
                    scale * max(steps.values(), key=abs),
                    at=times,
                )
            )
    if wrapped:
        names_of = ", ".join(f"{name} {count} times" for name, count in wrapped.items())
        said.append(diagnose("position.unwrapped", names_of, sum(wrapped.values())))
    return found, tuple(said)


def _steps(time: Array, values: Array) -> Iterator[tuple[int, float]]:
    """Samples and sizes of steps across which a column's velocity is continuous."""
    speed = np.diff(values) / np.diff(time)
    if len(speed) < 5:
        return
    before, after = speed[:-2], speed[2:]
    change = speed[1:-1] - (before + after) / 2
    usual = OUTLYING * float(np.quantile(np.abs(change), 0.99))
    alone = np.abs(before - after) < np.abs(change) / 4
    for i in 1 + np.flatnonzero((np.abs(change) > usual) & alone):
        yield int(i), float(change[i - 1] * (time[i + 1] - time[i]))
