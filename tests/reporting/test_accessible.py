"""Pages of runs are read by all: axe-core finds nothing serious, in the light and in the dark."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.browser import axe, browser, complaints

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1200, 390])
def test_a_report_has_no_serious_findings(
    page: Path, width: int, dark: bool, tmp_path: Path
) -> None:
    script = axe()
    with browser(tmp_path, width, dark) as seen:
        seen.open(page)
        assert complaints(seen, script) == []
