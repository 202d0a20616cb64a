"""Which program is started, with what, and when it is not."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from testbed.errors import ViewerError
from testbed.viewer.show import open_viewer, serve

Started = list[tuple[str, list[str]]]


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Started:
    """What would have been started; `rerun` lies beside Python, and another on the path."""
    calls: Started = []
    monkeypatch.setattr(os, "execv", lambda program, command: calls.append((program, command)))
    for folder in ("beside", "path"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "rerun").touch(mode=0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "beside/python"))
    monkeypatch.setenv("PATH", str(tmp_path / "path"))
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return calls


def test_the_viewer_shows_the_file_and_is_not_seen_from_outside(
    started: Started, tmp_path: Path
) -> None:
    open_viewer(Path("run.rrd"))
    assert started == [
        (str(tmp_path / "beside/rerun"), ["rerun", "run.rrd", "--bind", "127.0.0.1"])
    ]


def test_a_page_is_served_to_this_machine_alone(started: Started, tmp_path: Path) -> None:
    serve(Path("run.rrd"), 9123)
    (call,) = started
    program, command = call
    assert program == str(tmp_path / "beside/rerun")
    assert command[:3] == ["rerun", "run.rrd", "--serve-web"]
    assert command[command.index("--web-viewer-port") + 1] == "9123"
    assert command[command.index("--bind") + 1] == "127.0.0.1"


@pytest.mark.parametrize(
    ("platform", "screens", "opens"),
    [
        ("linux", {}, False),
        ("linux", {"DISPLAY": ":0"}, True),
        ("linux", {"WAYLAND_DISPLAY": "wayland-0"}, True),
        ("darwin", {}, True),
        ("win32", {}, True),
    ],
)
def test_on_linux_a_screen_must_be_there(
    started: Started,
    monkeypatch: pytest.MonkeyPatch,
    platform: str,
    screens: dict[str, str],
    opens: bool,
) -> None:
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.delenv("DISPLAY")
    for name, value in screens.items():
        monkeypatch.setenv(name, value)
    if opens:
        open_viewer(Path("run.rrd"))
        assert len(started) == 1
    else:
        with pytest.raises(ViewerError, match=r"no screen .* all in 'run.rrd'"):
            open_viewer(Path("run.rrd"))
        assert started == []
        serve(Path("run.rrd"), 9090)  # which needs none
        assert len(started) == 1


@pytest.mark.parametrize("start", [open_viewer, lambda path: serve(path, 9090)])
def test_without_rerun_beside_python_the_one_on_the_path_is_taken(
    started: Started, tmp_path: Path, start: Callable[[Path], Any]
) -> None:
    (tmp_path / "beside/rerun").unlink()
    start(Path("run.rrd"))
    assert started[0][0] == str(tmp_path / "path/rerun")
    (tmp_path / "path/rerun").unlink()
    with pytest.raises(ViewerError, match="pip install rerun-sdk"):
        start(Path("run.rrd"))
    assert len(started) == 1
