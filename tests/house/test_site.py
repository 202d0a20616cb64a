"""The documentation's site builds strictly, opens from disk, and fetches nothing.

tests/nightly/test_pages_in_a_browser.py looks at it; .ci/run runs both.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs import gallery
from docs.marks import written
from tests.helpers.paths import ROOT
from tests.helpers.site import built, navigation

LOADS = (
    r"<(?:script|img|iframe|source)\b[^>]* src(?:set)?=[\"']?(?:https?:)?//"
    r"|<link\b(?![^>]*rel=[\"']?(?:canonical|prev|next))[^>]* href=[\"']?(?:https?:)?//"
)
"""Addresses elsewhere that a browser follows by itself."""


def test_the_navigation_leads_to_every_page_once() -> None:
    found = list(navigation())
    assert len(found) == len(set(found))
    assert {path.name for path in (ROOT / "docs").glob("*.md")} <= set(found)


def test_the_gallery_is_up_to_date() -> None:
    text = gallery.DOCUMENT.read_text()
    assert written(text, gallery.MODULE, gallery.as_markdown) == text, "python -m docs.gallery"


@pytest.mark.slow
def test_every_page_is_built_with_all_that_it_leads_to_and_loads_nothing(tmp_path: Path) -> None:
    site = built(tmp_path)
    listed = (site / "llms.txt").read_text()
    assert [p for p in navigation() if Path(p).with_suffix(".html").name not in listed] == []
    assert [p for p in navigation() if not (site / p).with_suffix(".html").exists()] == []
    for page in (page for page in site.rglob("*.html") if page.name != "404.html"):
        text = page.read_text()
        for address in re.findall(r'(?:href|src)="([^"#?]+)', text):
            assert re.match(r"\w+:", address) or (page.parent / address).exists(), (page, address)
        assert re.findall(LOADS, text) == [], page
    for file in (file for kind in ("css", "svg") for file in site.rglob(f"*.{kind}")):
        fetched = r"(?:url\(|@import|href=|src=)\s*[\"']?(?:https?:)?//"
        assert not re.search(fetched, file.read_text()), file
    for name in ("api", "minimal-sets", "uncertainty"):
        text = re.sub(
            r"(?s)<(code|script|style)\b.*?</\1>", "", (site / f"{name}.html").read_text()
        )
        assert "<math" in text, name
        assert "$" not in re.sub(r"<[^>]*>", "", text), name
