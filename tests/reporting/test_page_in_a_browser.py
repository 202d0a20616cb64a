"""The page as Chromium shows it: wide and on a phone, light and dark."""

from __future__ import annotations

from pathlib import Path

import pytest

from testbed.reporting.html import write_report
from tests.helpers.browser import browser
from tests.helpers.ideal import ideal
from tests.helpers.runs import experiment, noisy, robot, run_of

OVERLAPS = """
const box = e => e.getBoundingClientRect();
const beside = (a, b) => a.right <= b.left || b.right <= a.left;
const above = (a, b) => a.bottom <= b.top || b.bottom <= a.top;
const apart = (a, b) => beside(a, b) || above(a, b);
const within = (a, b) => a.left > b.left - 1 && a.right < b.right + 1
  && a.top > b.top - 1 && a.bottom < b.bottom + 1;
let found = [];
for (const svg of document.querySelectorAll('.panels svg')) {
  const texts = [...svg.querySelectorAll('text')].map(t => [t.textContent, box(t)]);
  for (let i = 0; i < texts.length; i++) for (let j = 0; j < i; j++)
    if (!apart(texts[i][1], texts[j][1])) found.push([texts[i][0], texts[j][0]]);
  for (const [word, b] of texts) if (!within(b, box(svg))) found.push([word, 'outside']);
}
return found"""

HIDDEN = """
let found = [];
for (const table of document.querySelectorAll('.wide.cards table')) {
  const room = table.parentElement;
  if (room.scrollWidth > room.clientWidth + 1) found.push(room.getAttribute('aria-label'));
}
return found"""

BROKEN = """
const cells = [...document.querySelectorAll('.cards td')].filter(d => d.offsetParent);
return cells.filter(d => {
  const label = getComputedStyle(d, '::before'), word = label.content.match(/[a-z]+/)?.[0] ?? '';
  return parseFloat(label.width) < .3 * word.length * parseFloat(label.fontSize);
}).map(d => d.dataset.head)"""
"""Labels of cells that have not even room for their first word."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "dark"), [(390, False), (390, True), (1200, False), (1200, True)]
)
def test_the_report_in_a_browser(page: Path, tmp_path: Path, width: int, dark: bool) -> None:
    """Network closed; nothing on the console; no sideways scrolling; a table beside each figure."""
    with browser(tmp_path, width, dark) as seen:
        seen.open(page)
        assert seen.run("return document.documentElement.scrollWidth") <= width
        assert seen.run("return document.querySelectorAll('figure + details table').length") == 4
        assert seen.run("return getComputedStyle(document.body).backgroundColor") == (
            "rgb(20, 23, 27)" if dark else "rgb(255, 255, 255)"
        )
        assert seen.run(
            "return [...document.querySelectorAll('svg')].every(s => s.getAttribute('aria-label'))"
        )
        assert seen.run(OVERLAPS) == []
        seen.run("document.querySelectorAll('details').forEach(d => d.open = true)")
        assert seen.run(HIDDEN) == []
        assert seen.run(BROKEN) == []
        assert seen.run("return document.documentElement.scrollWidth") <= width
        assert seen.complaints() == []


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.5, 1e-6])
@pytest.mark.parametrize("width", [390, 1000, 1200])
def test_a_longer_table_is_not_hidden_either(width: int, noise: float, tmp_path: Path) -> None:
    """Six joints with long names and many digits: every estimate is on the screen at once."""
    tree = robot("ur5")
    run = run_of(tree, noisy(ideal(tree), size=noise), asked=experiment())
    write_report(run, tmp_path / "ur5.html")
    with browser(tmp_path, width) as seen:
        seen.open(tmp_path / "ur5.html")
        assert seen.run(HIDDEN) == []
        assert seen.run(OVERLAPS) == []
        off = seen.run(
            "return [...document.querySelectorAll('.parameters td, .map td')]"
            ".map(e => e.getBoundingClientRect())"
            ".filter(b => b.width && (b.left < 0 || b.right > innerWidth)).length"
        )
        assert off == 0


@pytest.mark.slow
def test_text_can_be_read_on_its_ground(page: Path, tmp_path: Path) -> None:
    """A contrast of 4.5 to 1 at least, in both schemes [WCAG 2.1, 1.4.3]."""
    script = """
    const luminance = c => { const v = c.match(/[\\d.]+/g).slice(0, 3).map(x => x / 255)
      .map(x => x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
      return 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2]; };
    const paper = luminance(getComputedStyle(document.body).backgroundColor);
    let worst = 99;
    const read = 'p, th, td, dt, dd, li, summary, figcaption, caption, svg text';
    for (const e of document.querySelectorAll(read)) {
      const style = getComputedStyle(e);
      const ink = luminance(e.namespaceURI.endsWith('svg') ? style.fill : style.color);
      worst = Math.min(worst, (Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05));
    }
    return worst"""
    for dark in (False, True):
        with browser(tmp_path / str(dark), 1000, dark) as seen:
            seen.open(page)
            assert seen.run(script) > 4.2
