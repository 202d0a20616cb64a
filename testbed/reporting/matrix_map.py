"""The plate's matrix as a picture: what calibration found of it, and what it leaves open."""

from __future__ import annotations

from typing import Any

from testbed.arrays import Array
from testbed.experiment.matrix_errors import SAID, matrix_errors
from testbed.experiment.run import Run
from testbed.recordings.columns import AXES
from testbed.reporting.heat_table import DARKEST


def matrix_maps(run: Run) -> list[dict[str, Any]]:
    """Tables with cells from light to dark: the matrix's errors, and sigma of each; [] without one.

    Args:
        run: The run.
    """
    found = matrix_errors(run)
    if found is None:
        return []
    return [
        _table(f"Before: error of the matrix, {SAID}", found.error, found.most),
        _table(f"After: what its sigma leaves, {SAID}", found.sigma, found.most),
    ]


def _table(caption: str, values: Array, most: float) -> dict[str, Any]:
    scale = DARKEST / most if most else 0.0

    def cell(value: float) -> dict[str, Any]:
        return {"text": f"{value:.2g}", "share": round(scale * abs(value))}

    rows = [
        (name, [cell(v) for v in line]) for name, line in zip(AXES, values.tolist(), strict=True)
    ]
    return {"caption": caption, "names": AXES, "rows": rows}
