"""Pages in Chromium, by axe-core, and recordings in Rerun's viewer; skipped where there is none."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from testbed.core.recordings.recording import Truth
from testbed.view.viewer.live import Live
from tests.helpers.browser import axe, browser, complaints
from tests.helpers.pages import OTHERS, RUNS, page
from tests.helpers.viewer import headless_viewer, settled
from tests.viewer.test_recording import rrd, scene

pytestmark = pytest.mark.nightly

WIDER = """
return [...document.querySelectorAll('main *')].filter(e => !e.closest('svg')
  && e.offsetParent && !e.closest('[role=region]')
  && e.getBoundingClientRect().right > innerWidth + 1).map(e => e.outerHTML.slice(0, 60))"""
"""Elements that end outside of the window and do not scroll."""
OVERLAPS = """
const box = e => e.getBoundingClientRect(), found = [];
const apart = (a, b) => a.right <= b.left || b.right <= a.left || a.bottom <= b.top
  || b.bottom <= a.top;
for (const svg of document.querySelectorAll('.panels svg')) {
  const texts = [...svg.querySelectorAll('text')].map(t => [t.textContent, box(t)]);
  texts.forEach(([one, a], i) => texts.slice(0, i).forEach(([other, b]) => {
    if (!apart(a, b)) found.push([one, other]); }));
}
return found"""
"""Texts of drawings that lie over each other."""


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1200])
def test_pages_can_be_read_in_a_browser(width: int, dark: bool, tmp_path: Path) -> None:
    """On a phone and at a desk: nothing sideways, nothing over another, nothing on the console."""
    with browser(tmp_path, width, dark) as seen:
        for name in (*RUNS, *OTHERS):
            seen.open(page(name))
            assert seen.run(OVERLAPS) == [], name
            seen.run("document.querySelectorAll('details').forEach(d => d.open = true)")
            assert seen.run("return document.documentElement.scrollWidth") <= width, name
            assert seen.run(WIDER) == [], name
            assert seen.complaints() == [], name


@pytest.mark.parametrize("dark", [False, True])
def test_pages_are_accessible(dark: bool, tmp_path: Path) -> None:
    """Contrast, names of regions, and all else that axe finds grave."""
    source = axe()
    with browser(tmp_path, 1200, dark) as seen:
        for name in (*RUNS, *OTHERS):
            seen.open(page(name))
            assert [f"{name}: {each}" for each in complaints(seen, source)] == []


@pytest.mark.parametrize("name", ["ur5", "plate", "half"])
def test_the_viewer_has_nothing_to_complain_about(name: str, tmp_path: Path) -> None:
    with headless_viewer(tmp_path) as (viewer, port):
        viewer.open(str(rrd(name)))
        settled(viewer)
        viewer.set_time("time", duration=4.0, play_state="paused")
        time.sleep(2)
        viewer.save_screenshot(str(tmp_path / "shot.png"))
        assert [view.reports for view in settled(viewer) if view.reports] == []
        assert (tmp_path / "shot.png").stat().st_size > 50_000
        run = scene(name).run
        if run.recording.truth is not None:  # and while it happens
            live = Live(run.name, scene(name).appearance, port)
            for part in (slice(0, 1000), slice(1000, 2000)):
                whole = {k: v for k, v in vars(run.recording.truth).items() if v is not None}
                piece = {k: values[part] for k, values in whole.items()}
                live(run.recording.time[part], Truth(**piece))
            assert [view.reports for view in settled(viewer) if view.reports] == []
