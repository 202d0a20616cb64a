"""Compiled computation of rows and their products for windows of samples."""

from __future__ import annotations

import logging
import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.kernel.gram import sweep as compiled_sweep
from testbed.core.kernel.layout import Layout
from testbed.core.kernel.records import (
    FILTER_SAMPLES,
    SEED_COUNT,
    B,
    Block,
    D,
    SignalWindow,
    Sums,
    Workspace,
    signal_blocks,
    zero_sums,
)
from testbed.core.kernel.rows import BODY_SIZE, SCREW_SIZE, A

_compile_lock = Lock()
_log = logging.getLogger(__name__)
"""Logger; Python writes its warnings to standard error by default."""


def workspace(layout: Layout, signals: SignalWindow) -> Workspace:
    """Workspace of one thread, for all windows with the filters of `signals`.

    Args:
        layout: Layout of the rows.
        signals: A window.
    """
    rows, links = layout.rows, len(layout.robot.place)
    slots = rows.slots + layout.channel_count + 1
    filtered = len(signals.weights) > 1
    reach = (FILTER_SAMPLES + len(signals.weights)) // signals.step + 12
    work = Workspace(
        U=_aligned_zeros(links, 3 * B),
        N=_aligned_zeros(B + signals.taps.shape[1]),
        X=_aligned_zeros(int(layout.robot.place.max(initial=0)) + 1, BODY_SIZE),
        V=_aligned_zeros(
            max(SEED_COUNT, int(rows.target.max(initial=0)) + 1), SCREW_SIZE
        ),
        T=_aligned_zeros(11 * D),
        Y=_aligned_zeros(slots * D if filtered else 0),
        H=_aligned_zeros(reach * D if filtered else 0),
        G=_aligned_zeros(
            layout.channel_count * ((len(signals.weights) - 1) // signals.step + 1) * D
        ),
        Z=_aligned_zeros(slots * D),
        squares=_aligned_zeros(1),
    )
    # constants: motion of the bedplate, and screws
    work.X[0, A : A + 3 * B] = np.repeat(layout.robot.ground, B)
    work.V[:SEED_COUNT] = np.repeat(layout.robot.seeds, B, axis=1)
    return work


def row_products(layout: Layout, signals: SignalWindow, work: Workspace) -> Sums:
    """Gram matrices of channel columns over the rows of a window, and valid row counts.

    Rows are valid unless they are excluded because the channel's joint is nearly at rest.

    Args:
        layout: Layout of the rows.
        signals: The window.
        work: Workspace.
    """
    sums = zero_sums(layout.rows)
    work = work._replace(squares=sums.squares)
    _call_kernel(layout.robot, layout.rows, _readonly_signals(signals), work, sums)
    return sums


def fill_rows(layout: Layout, signals: SignalWindow, work: Workspace) -> Array:
    """Compute only the rows of a window; the last block remains in the workspace.

    Args:
        layout: Layout of the rows.
        signals: The window.
        work: Workspace.

    Returns:
        Number of valid rows of each channel, (channels,).
    """
    sums = zero_sums(layout.rows)._replace(products=np.empty(0))
    _call_kernel(layout.robot, layout.rows, _readonly_signals(signals), work, sums)
    return sums.row_counts


def rows(layout: Layout, signals: SignalWindow, work: Workspace) -> list[Block]:
    """Filtered regressor rows of a window, in blocks of at most `layout.rows.block` rows.

    Args:
        layout: Layout of the rows.
        signals: The window.
        work: Workspace.
    """
    row_blocks = []
    for first, block in signal_blocks(signals, layout.rows.block):
        used = fill_rows(layout, block, work)
        z = work.Z.reshape(-1, D)[: layout.rows.slots, : block.row_count].copy()
        row_blocks.append(Block(first, z, used))
    return row_blocks


def _aligned_zeros(*shape: int) -> Array:
    """Array of zeros whose memory starts at a cache line, for aligned vector access."""
    size = math.prod(shape)
    padded = np.zeros(size + 7)
    first = -(padded.ctypes.data // 8) % 8
    return padded[first : first + size].reshape(shape)


def _call_kernel(*arguments: object) -> None:
    """Call the compiled kernel; compile it in a new thread at the first call.

    Compilation makes millions of Python calls. On a deep stack, calls at the boundary between two
    chunks of stack memory allocate and free a chunk each time, which takes seconds in total. A new
    thread starts with an empty stack.
    """
    if not compiled_sweep.overloads:
        with _compile_lock:  # other threads may call at the same time
            if not compiled_sweep.overloads:
                if not any(
                    Path(compiled_sweep.stats.cache_path).glob(
                        f"*.{compiled_sweep.__name__}-*.nbi"
                    )
                ):
                    _log.warning("compiling the kernel once, about 13 s")
                with ThreadPoolExecutor(1) as pool:
                    pool.submit(compiled_sweep, *arguments).result()
                return
    compiled_sweep(*arguments)


def _readonly_signals(signals: SignalWindow) -> SignalWindow:
    """Window with contiguous, read-only arrays: one Numba type, compiled once."""

    def readonly_array(value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            return value
        array = np.ascontiguousarray(value, dtype=np.float64).view()
        array.flags.writeable = False
        return array

    return SignalWindow(*map(readonly_array, signals))
