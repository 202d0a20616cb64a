"""Rerun's real viewer, without a screen: it has nothing to complain about."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from testbed.errors import ViewerError
from testbed.recordings.recording import Truth
from testbed.viewer.live import Live
from testbed.viewer.scene import Scene
from tests.helpers.viewer import free_port, headless_viewer, settled


@pytest.mark.slow
def test_the_viewer_has_nothing_to_complain_about(rrd: Path, tmp_path: Path) -> None:
    with headless_viewer(tmp_path) as (viewer, _):
        viewer.open(str(rrd))
        settled(viewer)
        viewer.set_time("time", duration=4.0, play_state="paused")
        time.sleep(2)
        viewer.save_screenshot(str(tmp_path / "shot.png"))
        assert [view.reports for view in settled(viewer) if view.reports] == []
        assert (tmp_path / "shot.png").stat().st_size > 50_000


@pytest.mark.slow
def test_a_run_is_shown_while_it_happens(scene: Scene, tmp_path: Path) -> None:
    with headless_viewer(tmp_path) as (viewer, port):
        live = Live(scene.run.name, scene.appearance, port)
        recording = scene.run.recording
        assert recording.truth is not None
        for first in (0, 1000):
            part = slice(first, first + 1000)
            piece = Truth(**{k: values[part] for k, values in vars(recording.truth).items()})
            live(recording.time[part], piece)
        assert [view.reports for view in settled(viewer) if view.reports] == []


@pytest.mark.slow
def test_a_live_view_needs_a_viewer(scene: Scene) -> None:
    port = free_port()
    with pytest.raises(ViewerError, match=f"no viewer listens at 127.0.0.1:{port}; open one"):
        Live(scene.run.name, scene.appearance, port)
