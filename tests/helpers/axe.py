"""What axe-core says of a page: https://github.com/dequelabs/axe-core, from npm, where it is."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.helpers.browser import Browser
from tests.helpers.paths import ROOT

GRAVE = ("serious", "critical")


@dataclass(frozen=True)
class Complaint:
    """One rule that elements of a page break."""

    rule: str
    impact: str
    elements: tuple[str, ...]

    def __str__(self) -> str:
        shown = "; ".join(self.elements[:3])
        return f"{self.impact} {self.rule}, {len(self.elements)} elements: {shown}"


def axe() -> str:
    """Its source; the test is skipped where it is not: `npm install --no-save axe-core`."""
    given = os.environ.get("AXE_CORE", str(ROOT / "node_modules/axe-core/axe.min.js"))
    if not Path(given).exists():
        pytest.skip("no axe-core: npm install --no-save axe-core, or AXE_CORE=.../axe.min.js")
    return Path(given).read_text()


def complaints(seen: Browser, source: str) -> list[Complaint]:
    """Rules that a browser's page breaks seriously or critically.

    Args:
        seen: With the page open.
        source: Axe's.
    """
    seen.command("Runtime.evaluate", {"expression": source})
    found = seen.command(
        "Runtime.evaluate",
        {
            "expression": "axe.run(document, {resultTypes: ['violations']}).then(r => r.violations"
            ".map(v => ({rule: v.id, impact: v.impact, elements: v.nodes.map("
            "n => n.target.join(' ') + ' ' + n.html.slice(0, 90))})))",
            "awaitPromise": True,
            "returnByValue": True,
        },
    )["result"]["value"]
    told = [Complaint(v["rule"], v["impact"], tuple(v["elements"])) for v in found]
    return [each for each in told if each.impact in GRAVE]
