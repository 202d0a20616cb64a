"""A table with cells from light to dark: sizes that span powers of ten, at a glance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from testbed.errors import round_significant

DARKEST = 48
"""Part of the colour in the darkest cell, on which text can still be read [%]."""


def heat_table(
    caption: str,
    rows: Sequence[str],
    columns: Sequence[str],
    values: Sequence[Sequence[float]],
    least: float,
    most: float,
) -> dict[str, Any]:
    """Values as percents, dark where they are large.

    Args:
        caption: What is shown.
        rows: Their names.
        columns: Theirs.
        values: By row and column; not a number where there is none.
        least: Value of the lightest cell, above zero.
        most: Of the darkest one.
    """
    span = math.log(most / least) or 1.0

    def cell(value: float) -> dict[str, Any]:
        if not value > 0:
            return {"text": "", "share": 0}
        part = min(max(math.log(value / least) / span, 0.0), 1.0)
        return {"text": f"{round_significant(100 * value, 2):g}", "share": round(DARKEST * part)}

    shown = [(name, [cell(x) for x in line]) for name, line in zip(rows, values, strict=True)]
    return {"caption": caption, "names": list(columns), "rows": shown}
