"""The compiled kernel on a window of samples."""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.kernel.layout import Layout
from testbed.dynamics.kernel.recursion import BODY, SCREW
from testbed.dynamics.kernel.shapes import Question, Signals, Sums, Work, sums_for
from testbed.dynamics.kernel.sweep import sweep as compiled
from testbed.dynamics.kernel.target import CHUNK, B, D


def workspace(layout: Layout, signals: Signals) -> Work:
    """Room for one thread; serves every window of these filters."""
    rows, links = layout.rows, len(layout.robot.parent)
    slots = rows.slots + layout.width + 1
    filtered = len(signals.weights) > 1
    reach = (CHUNK + len(signals.weights)) // signals.step + 12
    return Work(
        U=np.zeros(3 * links * B),
        N=np.zeros(B + signals.taps.shape[1]),
        X=np.zeros((links + 1) * BODY),
        V=np.zeros((int(rows.target.max(initial=5)) + 1) * SCREW),
        T=np.zeros(11 * D),
        Y=np.zeros(slots * D if filtered else 0),
        H=np.zeros(reach * D if filtered else 0),
        Z=np.zeros(slots * D),
        R=np.zeros((layout.width + 1) * D),
    )


def sweep(layout: Layout, signals: Signals, question: Question, work: Work) -> Sums:
    """Products or residuals of a window's rows.

    Args:
        layout: The rows.
        signals: The window.
        question: What to find.
        work: Room to work in.
    """
    sums = sums_for(layout.rows, signals, question, len(layout.basis))
    compiled(layout.robot, layout.rows, _fixed(signals), work, *_arguments(sums, question))
    return sums


def rows(layout: Layout, signals: Signals, work: Work) -> Array:
    """A window's rows, at most a block of them: (slots, rows)."""
    assert signals.count <= layout.rows.block
    nothing = Question(np.empty(0), np.zeros((layout.width, layout.width)), 1)
    sums = sums_for(layout.rows, signals, nothing, len(layout.basis))
    sums = sums._replace(products=np.empty(0))
    compiled(layout.robot, layout.rows, _fixed(signals), work, *_arguments(sums, nothing))
    found: Array = work.Z.reshape(-1, D)[: layout.rows.slots, : signals.count].copy()
    return found


def _arguments(sums: Sums, question: Question) -> tuple[object, ...]:
    return (sums.used, sums.products, *question, sums.moments, sums.scores)


def _fixed(signals: Signals) -> Signals:
    """The same arrays, contiguous and read-only: one type, compiled once."""
    fixed = {}
    for name in ("position", "velocity", "acceleration", "measured", "taps", "weights"):
        array = np.ascontiguousarray(getattr(signals, name), dtype=np.float64).view()
        array.flags.writeable = False
        fixed[name] = array
    return signals._replace(**fixed)
