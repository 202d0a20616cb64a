"""The documentation's site: it builds strictly, opens from disk, and fetches nothing."""

from __future__ import annotations

import re
import time
import tomllib
from collections.abc import Iterator
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from docs import api, commands, constants, gallery, keys
from docs.marks import written
from tests.helpers.axe import axe, complaints
from tests.helpers.browser import browser
from tests.helpers.paths import ROOT

KINDS = (
    "index", "tour", "api", "commands", "keys", "warnings", "gallery", "why-a-plate", "glossary",
    "minimal-sets-explained", "your-plate", "robotran", "experiments",
)  # fmt: skip
"""Pages of every kind."""
LOADS = {"link": "href", "script": "src", "img": "src", "iframe": "src", "source": "srcset"}
"""Elements whose addresses a browser follows by itself, and where these stand."""
LISTS = ("claims.md", "limits.md", "dependencies.md")
"""Pages that are one table each: a picture would tell nothing more."""
NO_FETCH = ("canonical", "prev", "next")
"""Links that only say something."""


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a site that was built strictly."""
    for library in ("zensical", "latex2mathml"):
        if find_spec(library) is None:
            pytest.skip(f"no {library}: pip install '.[docs]'")
    from docs.site import main

    return main(tmp_path_factory.mktemp("site")).parent


def nav() -> Iterator[str]:
    """Pages that the navigation leads to."""

    def inside(entry: Any) -> Iterator[str]:
        if isinstance(entry, str):
            yield entry
        else:
            for each in entry.values() if isinstance(entry, dict) else entry:
                yield from inside(each)

    return inside(tomllib.loads((ROOT / "zensical.toml").read_text())["project"]["nav"])


def test_the_navigation_leads_to_every_page_once() -> None:
    found = list(nav())
    assert len(found) == len(set(found))
    assert {path.name for path in (ROOT / "docs").glob("*.md")} <= set(found)


def test_every_page_has_a_picture_an_example_or_a_formula() -> None:
    for path in (ROOT / "docs").glob("*.md"):
        if path.name not in LISTS:
            assert re.search(r"^!\[|^```|\$", path.read_text(), re.MULTILINE), path.name


WRITTEN = (api, commands, constants, gallery, keys)


@pytest.mark.parametrize("module", WRITTEN, ids=lambda module: module.__name__)
def test_what_is_written_from_the_code_is_up_to_date(module: Any) -> None:
    text = module.DOCUMENT.read_text()
    assert written(text, module.MODULE, module.as_markdown) == text, f"python -m {module.MODULE}"


def test_every_experiment_and_robot_of_the_gallery_has_its_picture() -> None:
    for name in [*(r.name for r in gallery.ROBOTS), *(p.stem for p in gallery.experiments())]:
        assert (gallery.PLACE / f"{name}.svg").exists(), f"python -m docs.pictures.gallery {name}"


@pytest.mark.slow
def test_every_page_is_built(site: Path) -> None:
    for page in nav():
        assert (site / page).with_suffix(".html").exists(), page


class Loads(HTMLParser):
    """Addresses that a page loads, and the words of its text."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.words: list[str] = []
        self._code = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        own = dict(attrs)
        if own.get("rel") not in NO_FETCH:
            self.found.append(own.get(LOADS.get(tag, ""), "") or "")
        self._code += tag in ("code", "script", "style")

    def handle_endtag(self, tag: str) -> None:
        self._code -= tag in ("code", "script", "style")

    def handle_data(self, data: str) -> None:
        if not self._code:
            self.words.append(data)


@pytest.mark.slow
def test_no_page_loads_anything_from_a_network(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 30
    for page in pages:
        seen = Loads()
        seen.feed(page.read_text())
        assert not [a for a in seen.found if re.match(r"(https?:)?//", a)], page
    for style in site.rglob("*.css"):
        assert not re.search(r"(url\(|@import)\s*[\"']?(https?:)?//", style.read_text()), style
    for drawing in site.rglob("*.svg"):
        assert not re.search(r'(href|src)="(https?:)?//', drawing.read_text()), drawing


def test_every_link_and_picture_of_a_page_is_there(site: Path) -> None:
    """The strict build looks at pages, not at pictures and files."""
    for page in site.rglob("*.html"):
        for address in re.findall(r'(?:href|src)="([^"#?]+)', page.read_text()):
            if page.name != "404.html" and not re.match(r"\w+:", address):
                assert (page.parent / address).exists(), f"{page.name}: {address}"


def test_formulas_are_formulas(site: Path) -> None:
    for name in ("api", "barycentric-parameters", "sigma"):
        text = (site / f"{name}.html").read_text()
        assert "<math" in text
        seen = Loads()
        seen.feed(text)
        assert "$" not in "".join(seen.words), name


@pytest.mark.slow
def test_the_search_finds_from_disk(site: Path, tmp_path: Path) -> None:
    """Opened as a file: no server is there."""
    with browser(tmp_path, 1200) as seen:
        seen.open(site / "tour.html")
        time.sleep(1)
        seen.run("document.querySelector('.md-search__button').click()")
        time.sleep(1)
        seen.command("Input.insertText", {"text": "crosstalk"})
        shown = (
            "return [...document.querySelectorAll('*')].filter(e => e.shadowRoot)"
            ".map(e => e.shadowRoot.textContent).join(' ')"
        )
        for _ in range(50):
            if re.search(r"[1-9]\d* results", found := seen.run(shown)):
                break
            time.sleep(0.2)
        assert re.search(r"[1-9]\d* results", found)
        assert "plate_crosstalk" in found or "crosstalk" in found
        assert seen.complaints() == []


@pytest.mark.slow
@pytest.mark.parametrize("width", [1440, 390])
def test_no_page_scrolls_sideways_or_complains(site: Path, tmp_path: Path, width: int) -> None:
    with browser(tmp_path, width) as seen:
        for page in nav():
            seen.open((site / page).with_suffix(".html"))
            assert seen.run("return document.documentElement.scrollWidth") <= width, page
            assert seen.complaints() == [], page


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


@pytest.mark.slow
def test_on_a_phone_what_is_wider_says_so_and_nothing_floats_over_it(
    site: Path, tmp_path: Path
) -> None:
    with browser(tmp_path, 390) as seen:
        for page in nav():
            seen.open((site / page).with_suffix(".html"))
            seen.run("window.scrollTo(0, 600)")
            seen.run("window.scrollTo(0, 500)")
            assert seen.run(ODD) == [], page
        seen.open(site / "index.html")
        wide = (
            "return [...document.querySelectorAll('.md-typeset__scrollwrap')]"
            ".map(e => [e.scrollWidth, e.clientWidth])"
        )
        assert all(inner <= outer for inner, outer in seen.run(wide))


def width_of(drawing: str) -> float:
    return float(re.findall(r'viewBox="0 0 ([\d.]+)', drawing)[0])


@pytest.mark.parametrize("name", ["map", "campaign"])
def test_words_of_a_drawing_can_be_read_on_a_phone(name: str) -> None:
    """No smaller than nine pixels where it is as wide as the page, which has 350."""
    drawing = (ROOT / f"docs/pictures/{name}.svg").read_text()
    assert "prefers-color-scheme: dark" in drawing
    assert 14 * min(1.0, 350 / width_of(drawing)) > 9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "dark"), [(1440, False), (1440, True), (390, False)], ids=["light", "dark", "phone"]
)
def test_pages_are_accessible(site: Path, tmp_path: Path, width: int, dark: bool) -> None:
    source = axe()
    with browser(tmp_path, width, dark) as seen:
        for name in KINDS:
            seen.open(site / f"{name}.html")
            time.sleep(0.5)
            assert [f"{name}: {each}" for each in complaints(seen, source)] == []
