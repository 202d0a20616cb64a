"""What people see, held line by line against a copy that a person has looked at."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from difflib import unified_diff

import pytest

from tests.helpers.paths import ROOT

APPROVED = ROOT / "tests/approved"


def hold(name: str, lines: Iterable[str]) -> None:
    """Say in one line that something else is shown, and what to do.

    Args:
        name: Of the copy below tests/approved; `TESTBED_KEEP=1` writes it anew.
        lines: What is shown now.
    """
    place, now = APPROVED / name, list(lines)
    if "TESTBED_KEEP" in os.environ:
        place.write_text("\n".join(now) + "\n", encoding="utf-8")
    kept = place.read_text(encoding="utf-8").splitlines()
    changed = [x for x in unified_diff(kept, now, n=0, lineterm="") if x[0] in "+-"][2:]
    if changed:
        pytest.fail(
            f"{len(changed)} lines of tests/approved/{name} change, first {changed[0]!r}: if that "
            "is meant, TESTBED_KEEP=1 pytest tests/reporting tests/viewer writes it, and look at "
            "git diff",
            pytrace=False,
        )


def without_numbers(text: str) -> str:
    """Numbers and hashes blotted out, but for those in names."""
    text = re.sub(r"\b[0-9a-f]{16,}\b", "#", text)
    return re.sub(r"(?<![\w#])[-+−]?\d(?:e[-+]?\d|[\w.])*", "#", text)


def tags(html: str) -> Iterable[str]:
    """A page, a tag with its text a line, a row of a table too; drawings by what they are called.

    Of rows that are alike but for names and numbers the first.
    """
    html = re.sub(r"(?s)(<(style|svg)\b[^>]*>).*?</\2>", r"\1", html)
    rows = r"(?s)<tr\b.*?</tr>"
    html = re.sub(rows, lambda row: row[0].replace("\n", "").replace("<", "\0"), html)
    parts = re.sub(r"</[^>]*>", "\n", html).replace("<", "\n<").splitlines()
    form = ""
    for part in parts:
        line = without_numbers(re.sub(r"\0/[^>]*>", "", part).replace("\0", "<")).strip()
        cells = line.startswith("<tr") and re.sub(r">[^<]+|:#%", ">", line.replace(" absent", ""))
        if line and cells != form:
            yield line
        form = cells or form if line else form
