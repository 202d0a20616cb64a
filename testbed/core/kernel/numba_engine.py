"""The compiled kernel on a window of samples."""

from __future__ import annotations

import logging
import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.kernel.gram import sweep as compiled
from testbed.core.kernel.layout import Layout
from testbed.core.kernel.records import (
    CHUNK,
    SEEDS,
    B,
    Block,
    D,
    Signals,
    Sums,
    Work,
    blocks,
    sums_for,
)
from testbed.core.kernel.rows import BODY, SCREW, A

_compiling = Lock()
_log = logging.getLogger(__name__)
"""Python writes warnings to standard error unless a program says otherwise."""


def workspace(layout: Layout, signals: Signals) -> Work:
    """Room for one thread; serves every window of these filters."""
    rows, links = layout.rows, len(layout.robot.place)
    slots = rows.slots + layout.width + 1
    filtered = len(signals.weights) > 1
    reach = (CHUNK + len(signals.weights)) // signals.step + 12
    work = Work(
        U=_aligned(links, 3 * B),
        N=_aligned(B + signals.taps.shape[1]),
        X=_aligned(int(layout.robot.place.max(initial=0)) + 1, BODY),
        V=_aligned(max(SEEDS, int(rows.target.max(initial=0)) + 1), SCREW),
        T=_aligned(11 * D),
        Y=_aligned(slots * D if filtered else 0),
        H=_aligned(reach * D if filtered else 0),
        G=_aligned(layout.width * ((len(signals.weights) - 1) // signals.step + 1) * D),
        Z=_aligned(slots * D),
        squares=_aligned(1),
    )
    # what never changes: the bedplate's motion, and screws
    work.X[0, A : A + 3 * B] = np.repeat(layout.robot.ground, B)
    work.V[:SEEDS] = np.repeat(layout.robot.seeds, B, axis=1)
    return work


def sweep(layout: Layout, signals: Signals, work: Work) -> Sums:
    """Products of a window's rows.

    Args:
        layout: The rows.
        signals: The window.
        work: Room to work in.
    """
    sums = sums_for(layout.rows)
    work = work._replace(squares=sums.squares)
    _call(layout.robot, layout.rows, _fixed(signals), work, sums)
    return sums


def fill_only(layout: Layout, signals: Signals, work: Work) -> Array:
    """Rows alone, nothing made of them; the last block stays in the workspace.

    Args:
        layout: The rows.
        signals: The window.
        work: Room to work in.

    Returns:
        How many of each channel count, (channels,).
    """
    sums = sums_for(layout.rows)._replace(products=np.empty(0))
    _call(layout.robot, layout.rows, _fixed(signals), work, sums)
    return sums.used


def rows(layout: Layout, signals: Signals, work: Work) -> list[Block]:
    """A window's rows.

    Args:
        layout: The rows.
        signals: The window.
        work: Room to work in.
    """
    made = []
    for first, block in blocks(signals, layout.rows.block):
        used = fill_only(layout, block, work)
        z = work.Z.reshape(-1, D)[: layout.rows.slots, : block.number].copy()
        made.append(Block(first, z, used))
    return made


def _aligned(*shape: int) -> Array:
    """Zeros that begin where a cache line does: vectors then never straddle two."""
    size = math.prod(shape)
    room = np.zeros(size + 7)
    first = -(room.ctypes.data // 8) % 8
    return room[first : first + size].reshape(shape)


def _call(*arguments: object) -> None:
    """The first time in a thread of its own.

    Compiling means millions of Python calls; deep in a stack, where a chunk of frames happens
    to end, each of them may allocate and free one, which takes seconds in all.
    """
    if not compiled.overloads:
        with _compiling:  # threads ask at once
            if not compiled.overloads:
                if not any(
                    Path(compiled.stats.cache_path).glob(f"*.{compiled.__name__}-*.nbi")
                ):
                    _log.warning("compiling the kernel once, about 13 s")
                with ThreadPoolExecutor(1) as pool:
                    pool.submit(compiled, *arguments).result()
                return
    compiled(*arguments)


def _fixed(signals: Signals) -> Signals:
    """The same arrays, contiguous and read-only: one type, compiled once."""

    def fixed(value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            return value
        array = np.ascontiguousarray(value, dtype=np.float64).view()
        array.flags.writeable = False
        return array

    return Signals(*map(fixed, signals))
