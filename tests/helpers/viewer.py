"""Rerun's files read back, and its real viewer without a screen."""

from __future__ import annotations

import os
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
    found = _chunks(path, entity, column, static)
    return np.concatenate([np.array(each.flatten().to_pylist(), dtype=float) for each in found])


def tree(path: Path) -> dict[str, set[str]]:
    """The columns of all entities that a file speaks of; one on a timeline begins with '~'."""
    reader, found = RrdReader(str(path)), dict[str, set[str]]()
    for chunk in reader.store(store=reader.recordings()[0]).stream():
        names = {n for n in chunk.to_record_batch().schema.names if ":" in n}
        own = {name if chunk.is_static else f"~{name}" for name in names}
        found.setdefault(str(chunk.entity_path), set()).update(own)
    return found


def _chunks(path: Path, entity: str, column: str, static: bool) -> Iterator[Any]:
    reader = RrdReader(str(path))
    for chunk in reader.store(store=reader.recordings()[0]).stream().filter(content=entity):
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
    program = folder / "rerun-of-a-size"
    program.write_text(f'#!/bin/sh\nexec rerun "$@" --window-size {size}\n')
    program.chmod(0o700)
    port = free_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VK_ICD_FILENAMES", str(LAVAPIPE))
        patch.setenv("WGPU_BACKEND", "vulkan")
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        patch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
        with experimental.ViewerClient.spawn(
            headless=True, port=port, hide_welcome_screen=True, executable_path=str(program)
        ) as viewer:
            yield viewer, port


def settled(viewer: Any) -> list[Any]:
    """The viewer's views, once they are there."""
    for _ in range(60):
        time.sleep(0.5)
        views: list[Any] = list(viewer.get_state().views)
        if len(views) > 3:
            return views
    raise AssertionError("the viewer shows no views")
