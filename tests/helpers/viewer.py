"""Rerun's files read back, and its real viewer without a screen."""

from __future__ import annotations

import os
import re
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

LAVAPIPE = Path("/usr/share/vulkan/icd.d/lvp_icd.x86_64.json")
"""Mesa's software Vulkan driver."""


def columns(path: Path, entity: str, column: str, *, static: bool = False) -> np.ndarray[Any, Any]:
    """All samples of one entity's column, in the file's order."""
    found = [
        np.array(each.flatten().to_pylist(), dtype=float)
        for each in _chunks(path, entity, column, static)
    ]
    return np.concatenate(found)


def tensor(path: Path, entity: str, column: str) -> np.ndarray[Any, Any]:
    """A static column of one tensor, flat."""
    (found,) = _chunks(path, entity, column, True)
    (held,) = found.flatten().to_pylist()
    return np.array(held["buffer"], dtype=float)


def words(path: Path, entity: str, column: str) -> list[str]:
    """What a static column of text says."""
    return [
        word for each in _chunks(path, entity, column, True) for word in each.flatten().to_pylist()
    ]


def entities(path: Path) -> set[str]:
    """All that a file speaks of."""
    reader = RrdReader(str(path))
    store = reader.store(store=reader.recordings()[0])
    return {str(chunk.entity_path) for chunk in store.stream()}


def _chunks(path: Path, entity: str, column: str, static: bool) -> Iterator[Any]:
    reader = RrdReader(str(path))
    store = reader.store(store=reader.recordings()[0])
    for chunk in store.stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if chunk.is_static is static and column in batch.schema.names:
            yield batch.column(column)


def free_port() -> int:
    """A port of this machine that nobody listens at."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@contextmanager
def headless_viewer(folder: Path, size: str = "1920x1080") -> Iterator[tuple[Any, int]]:
    """The real viewer, drawing without a screen of that size, and its port.

    A test is skipped where there is no driver that draws.
    """
    if not LAVAPIPE.exists():
        pytest.skip("no software Vulkan driver on this machine")
    experimental = pytest.importorskip("rerun.experimental")
    wanted = {
        "VK_ICD_FILENAMES": str(LAVAPIPE),
        "WGPU_BACKEND": "vulkan",
        "XDG_RUNTIME_DIR": str(folder),
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
    }
    program = folder / "rerun-of-a-size"
    program.write_text(f'#!/bin/sh\nexec rerun "$@" --window-size {size}\n')
    program.chmod(0o700)
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    port = free_port()
    spawn = experimental.ViewerClient.spawn
    try:
        with spawn(
            headless=True, port=port, hide_welcome_screen=True, executable_path=str(program)
        ) as viewer:
            yield viewer, port
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def settled(viewer: Any) -> list[Any]:
    """The viewer's views, once they are there."""
    for _ in range(60):
        time.sleep(0.5)
        views: list[Any] = list(viewer.get_state().views)
        if len(views) > 3:
            return views
    raise AssertionError("the viewer shows no views")


def content(path: Path) -> str:
    """What a file holds, recording and blueprint: of every column of every entity a line.

    Texts whole; of numbers how many, the first few, the last, and their size. Parts of a
    blueprint, whose names are drawn by chance, are called as the viewer shows them.
    """
    reader = RrdReader(str(path))
    found: dict[str, list[Any]] = {}
    for entry in (*reader.recordings(), *reader.blueprints()):
        for chunk in reader.store(store=entry).stream():
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if name not in ("rerun.controls.RowId", "log_time", "log_tick", _ROOT):
                    place = f"{chunk.entity_path} {'static ' * chunk.is_static}{name}"
                    found.setdefault(place, []).extend(_leaves(_plain(batch.column(name))))
    shown = {
        drawn[0]: str(values[0])
        for place, values in found.items()
        if place.endswith(":display_name") and (drawn := _DRAWN.search(place))
    }
    lines = (f"{place}: {_brief(values)}" for place, values in found.items())
    named = (_DRAWN.sub(lambda one: shown.get(one[0], "unnamed"), line) for line in lines)
    return "\n".join(sorted(named)) + "\n"


_ROOT = "ViewportBlueprint:root_container"
"""A name that is drawn by chance, as bytes."""

_DRAWN = re.compile(r"[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}")


def _plain(column: Any) -> Any:
    """Moments as whole nanoseconds: Python's have fewer digits."""
    return (column.cast("int64") if "[ns]" in str(column.type) else column).to_pylist()


def _leaves(values: Any) -> Iterator[Any]:
    if isinstance(values, dict):
        values = list(values.values())
    if not isinstance(values, list):
        yield values
        return
    for each in values:
        yield from _leaves(each)


def _brief(values: list[Any]) -> str:
    if not values or not all(type(each) in (int, float) for each in values):
        return f"{values}"[:2000]
    numbers = np.array(values, dtype=float)
    first = " ".join(f"{each:.5g}" for each in numbers[:8])
    size = float(np.sqrt(np.nansum(numbers**2)))
    return f"{len(numbers)} numbers {first} to {numbers[-1]:.5g}, size {size:.5g}"
