"""The site as people see it, in a browser and by axe-core; skipped where there is none."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest

from tests.helpers.browser import axe, browser, complaints
from tests.helpers.site import built, navigation

pytestmark = pytest.mark.nightly

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


@pytest.mark.parametrize(("width", "dark"), [(1440, False), (1440, True), (390, False)])
def test_pages_are_accessible(site: Path, tmp_path: Path, width: int, dark: bool) -> None:
    source = axe()
    with browser(tmp_path, width, dark) as seen:
        for name in KINDS:
            seen.open(site / f"{name}.html")
            time.sleep(0.5)
            assert [f"{name}: {each}" for each in complaints(seen, source)] == []
