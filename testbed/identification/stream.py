"""Passes over the samples: window by window, on several threads, in constant memory.

Windows and the order in which their answers come are the same whatever the source and the
number of threads, and so is, to the bit, all that is computed from them.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from testbed.arrays import Array
from testbed.dynamics.kernel import reference
from testbed.dynamics.kernel.shapes import Question, Signals, Sums
from testbed.identification.plan import Plan, Window
from testbed.measurement.recording import check_part

Progress = Callable[[int, int], None]
"""Called with samples done and samples in all."""

Answer = TypeVar("Answer")

SMALL = 2.0
"""Seconds that NumPy may take; longer jobs are worth loading the compiled kernel for."""

KEPT = 64e6
"""Bytes of rows that are kept from the first pass to the next, in small jobs."""


def is_small(plan: Plan) -> bool:
    """Whether NumPy does the job in the time in which the compiled kernel is loaded."""
    seconds = 12e-6 + 0.06e-6 * plan.layout.theta.size / 10  # a sample, measured
    return plan.source.samples * seconds < SMALL


class Sweeper:
    """Answers questions about all rows of a plan, pass by pass."""

    def __init__(self, plan: Plan, threads: int | None, progress: Progress) -> None:
        """Ready for the first pass.

        Args:
            plan: The rows.
            threads: How many to use; default one a processor.
            progress: Called with samples done and samples in all, of two passes.
        """
        self.plan = plan
        self.compiled = not is_small(plan)
        self.threads = max(1, threads or os.cpu_count() or 1) if self.compiled else 1
        self.progress = progress
        self.checked = False
        self.done = 0
        self._rooms: SimpleQueue[Any] = SimpleQueue()
        self._kept: dict[int, list[reference.Block]] = {}
        self._keeps = plan.rows * plan.layout.rows.slots * 8 < KEPT

    def sums(self, question: Question) -> Iterator[Sums]:
        """The answers of all windows, in order."""
        return self._pass(lambda signals, window: self._sums(signals, window, question))

    def rows(self) -> Iterator[Array]:
        """All rows, a block at a time, (slots, rows)."""
        for blocks in self._pass(self._rows):
            yield from blocks

    def _pass(self, ask: Callable[[Signals, Window], Answer]) -> Iterator[Answer]:
        plan, source = self.plan, self.plan.source

        def answer(part: Any, window: Window) -> Answer:
            if check:
                check_part(part, "the recording", 1 / source.rate, window.first)
            return ask(plan.signals(part, window), window)

        check, self.checked = not self.checked, True
        pending: deque[tuple[Future[Answer], Window]] = deque()
        with threadpool_limits(1, "blas"), ThreadPoolExecutor(self.threads) as pool:
            try:
                for window in plan.windows():
                    part = source.part(window.first, window.last)
                    pending.append((pool.submit(answer, part, window), window))
                    if len(pending) > self.threads:
                        yield self._next(pending)
                while pending:
                    yield self._next(pending)
            finally:
                for future, _ in pending:
                    future.cancel()

    def _next(self, pending: deque[tuple[Future[Answer], Window]]) -> Answer:
        future, window = pending.popleft()
        found = future.result()
        self.done += window.rows * self.plan.step
        self.progress(self.done, 2 * self.plan.rows * self.plan.step)
        return found

    def _sums(self, signals: Signals, window: Window, question: Question) -> Sums:
        layout = self.plan.layout
        if not self.compiled:
            return reference.answer(layout, signals, self._blocks(signals, window), question)
        from testbed.dynamics.kernel import compiled

        work = self._room(signals)
        try:
            return compiled.sweep(layout, signals, question, work)
        finally:
            self._rooms.put(work)

    def _rows(self, signals: Signals, window: Window) -> list[Array]:
        if not self.compiled:
            return [block.rows for block in self._blocks(signals, window)]
        from testbed.dynamics.kernel import compiled

        work = self._room(signals)
        try:
            return compiled.rows(self.plan.layout, signals, work)
        finally:
            self._rooms.put(work)

    def _blocks(self, signals: Signals, window: Window) -> list[reference.Block]:
        if window.row in self._kept:
            return self._kept[window.row]
        found = reference.blocks(self.plan.layout, signals)
        if self._keeps:
            self._kept[window.row] = found
        return found

    def _room(self, signals: Signals) -> Any:
        """A workspace that no other thread is using."""
        from testbed.dynamics.kernel import compiled

        try:
            return self._rooms.get_nowait()
        except Empty:
            return compiled.workspace(self.plan.layout, signals)
