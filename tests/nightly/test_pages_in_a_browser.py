"""Pages and the site in Chromium, recordings in Rerun's viewer; skipped where there is none."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest

from testbed.core.recordings.recording import Truth
from testbed.view.viewer.live import LiveViewer
from tests.helpers.browser import axe, browser, complaints
from tests.helpers.pages import OTHERS, RUNS, page
from tests.helpers.site import built, navigation
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


KINDS = ("index", "tour", "api", "commands", "warnings", "gallery", "uncertainty", "experiments")
"""Pages of every kind."""
ODD = """
const article = document.querySelector('article'), found = [];
for (const e of article.querySelectorAll('pre > code, .md-typeset__scrollwrap, .formula')) {
  const more = e.scrollWidth > e.clientWidth + 1;
  if (more && !getComputedStyle(e).backgroundAttachment.includes('local'))
    found.push('no hint: ' + e.textContent.slice(0, 40));
}
for (const e of document.querySelectorAll('*')) {
  const style = getComputedStyle(e), box = e.getBoundingClientRect();
  if (['fixed', 'sticky'].includes(style.position) && box.width && style.visibility == 'visible'
      && +style.opacity
      && !e.closest('.md-header, .md-tabs, .md-sidebar') && box.top < innerHeight && box.bottom > 0
      && box.left < innerWidth && box.right > 0)
    found.push('floats: ' + e.className);
}
return found"""
"""Of what is wider than its place, that of which nobody is told; and what floats over the text."""
SHOWN = (
    "return [...document.querySelectorAll('*')].filter(e => e.shadowRoot)"
    ".map(e => e.shadowRoot.textContent).join(' ')"
)


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


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("site"))


@pytest.mark.parametrize("width", [1440, 390])
def test_no_page_scrolls_sideways_complains_or_hides_what_is_wider(
    site: Path, tmp_path: Path, width: int
) -> None:
    with browser(tmp_path, width) as seen:
        for page in navigation():
            seen.open((site / page).with_suffix(".html"))
            assert seen.run("return document.documentElement.scrollWidth") <= width, page
            seen.run("window.scrollTo(0, 600)")
            seen.run("window.scrollTo(0, 500)")
            assert width > 1000 or seen.run(ODD) == [], page
            assert seen.complaints() == [], page


def test_the_search_finds_from_disk(site: Path, tmp_path: Path) -> None:
    """Opened as a file: no server is there."""
    with browser(tmp_path, 1200) as seen:
        seen.open(site / "tour.html")
        time.sleep(1)
        seen.run("document.querySelector('.md-search__button').click()")
        time.sleep(1)
        seen.command("Input.insertText", {"text": "crosstalk"})
        found = ""
        for _ in range(50):
            if re.search(r"[1-9]\d* results", found := seen.run(SHOWN)):
                break
            time.sleep(0.2)
        assert re.search(r"[1-9]\d* results", found)
        assert "crosstalk" in found


@pytest.mark.parametrize(("width", "dark"), [(1200, False), (1200, True), (390, False)])
def test_pages_are_accessible(site: Path, width: int, dark: bool, tmp_path: Path) -> None:
    """Contrast, names of regions, and all else that axe finds grave."""
    source = axe()
    pages = [*map(page, (*RUNS, *OTHERS)), *(site / f"{name}.html" for name in KINDS)]
    with browser(tmp_path, width, dark) as seen:
        for path in pages:
            seen.open(path)
            time.sleep(0.5)
            assert [f"{path.name}: {each}" for each in complaints(seen, source)] == []


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
            live = LiveViewer(run.name, scene(name).appearance, port)
            for part in (slice(0, 1000), slice(1000, 2000)):
                whole = {k: v for k, v in vars(run.recording.truth).items() if v is not None}
                piece = {k: values[part] for k, values in whole.items()}
                live(run.recording.time[part], Truth(**piece))
            assert [view.reports for view in settled(viewer) if view.reports] == []
