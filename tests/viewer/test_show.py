"""What stands where at first sight, and which program is started, with what, and when it is not."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.core.base.errors import ViewerError
from testbed.view.viewer import live
from testbed.view.viewer.blueprint import blueprint
from testbed.view.viewer.live import Live, open_viewer, serve
from tests.helpers.pages import run_named
from tests.helpers.refusals import refuses
from tests.helpers.viewer import free_port, tree
from tests.viewer.test_recording import rrd, scene

SIDES = ("start", "end")


def views(part: Any) -> Iterator[Any]:
    """All views of a blueprint's part."""
    inner = getattr(part, "contents", None)
    if isinstance(inner, list | tuple):
        for each in inner:
            yield from views(each)
    else:
        yield part


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5", "plate", "half"])
def test_every_view_looks_at_something_and_has_its_unit(name: str) -> None:
    """All are opened on the same seconds."""
    shown, there = scene(name), tree(rrd(name))
    page = blueprint([shown])
    for view in views(page.root_container):
        assert any(f"{at}/".startswith(f"{view.origin}/") for at in there), view.origin
        if view.origin.startswith(("/wrench", "/torque", "/residual")):
            assert "[" in view.name
    start, end = shown.window
    assert start == shown.run.recording.time[0]
    assert 0 < end - start <= 10.0
    for view in views(page.root_container):
        if view.origin.startswith(("/wrench", "/torque")):
            (seen,) = view.properties["TimeAxis"].view_range.pa_array.to_pylist()
            ends = [float(x["value"] if isinstance(x, dict) else x) for x in map(seen.get, SIDES)]
            np.testing.assert_allclose(ends, [1e9 * start, 1e9 * end], atol=1e3)


@pytest.mark.parametrize("screen", ["DISPLAY", "WAYLAND_DISPLAY", ""])
def test_the_viewer_is_started_for_this_machine_alone_where_there_is_a_screen(
    screen: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rerun beside Python, else that of the path; a page for a browser needs no screen."""
    started: list[tuple[str, list[str]]] = []
    environments: list[dict[str, str]] = []

    def started_as(program: str, command: list[str], environment: dict[str, str]) -> None:
        started.append((program, command))
        environments.append(environment)

    monkeypatch.setattr(os, "execve", started_as)
    for folder in ("beside", "path"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "rerun").touch(mode=0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "beside/python"))
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("PATH", str(tmp_path / "path"))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if screen:
        monkeypatch.setenv(screen, "0")
        open_viewer(Path("run.rrd"))
    else:
        with refuses(ViewerError, "run.rrd"):
            open_viewer(Path("run.rrd"))
    serve(Path("run.rrd"), 9123)
    (tmp_path / "beside/rerun").unlink()
    serve(Path("run.rrd"), 9123)
    (tmp_path / "path/rerun").unlink()
    with refuses(ViewerError, "rerun"):
        serve(Path("run.rrd"), 9123)
    programs = [str(tmp_path / at / "rerun") for at in ("beside", "path")]
    assert [program for program, _ in started] == [programs[0]] * bool(screen) + programs
    assert all(each["CI"] and "FORCE_RERUN_ANALYTICS" not in each for each in environments)
    for _, command in started:
        assert command[:2] == ["rerun", "run.rrd"]
        assert command[command.index("--bind") + 1] == "127.0.0.1"
    assert started[-1][1][command.index("--web-viewer-port") + 1] == "9123"


@pytest.mark.slow
def test_from_python_a_file_is_written_or_the_viewer_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[list[str]] = []
    monkeypatch.setattr(live, "has_screen", lambda: True)
    monkeypatch.setattr(live, "viewer_program", lambda: "rerun")
    monkeypatch.setattr(subprocess, "Popen", lambda command, **_: started.append(command))
    run = run_named("silent")
    assert tb.view(run, path=tmp_path / "run.rrd").read_bytes()[:4] == b"RRF2"
    assert started == []
    path = tb.view([run, run])
    assert started == [["rerun", str(path), "--bind", "127.0.0.1"]]
    monkeypatch.setattr(live, "has_screen", lambda: False)
    with refuses(tb.TestbedError, ".rrd"):
        tb.view(run)
    port = free_port()
    with refuses(ViewerError, str(port)):
        Live("run", scene("silent").appearance, port)
