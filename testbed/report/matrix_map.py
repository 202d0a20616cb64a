"""The plate's matrix as a picture: what calibration found of it, and what it leaves open."""

from __future__ import annotations

from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.experiment.run import Run
from testbed.recordings.columns import AXES

DARKEST = 70
"""Part of the colour in the darkest cell [%]."""


def matrix_maps(run: Run) -> list[dict[str, Any]]:
    """Tables with cells from light to dark: the matrix's errors, and sigma of each; [] without one.

    Args:
        run: The run.
    """
    external = run.estimates.get("external")
    found = {n.name: n for n in external.nuisances} if external is not None else {}
    if not any(name.startswith("crosstalk/") for name in found) or run.recording.wrench is None:
        return []
    error, sigma = np.zeros((2, 6, 6))
    for i, shown in enumerate(AXES):
        for j, felt in enumerate(AXES):
            number = found.get(f"gain/{shown}" if i == j else f"crosstalk/{shown}/{felt}")
            if number is not None:
                error[i, j], sigma[i, j] = number.value - (i == j), number.sigma
    reach = np.abs(run.recording.wrench).max(axis=0)
    share = 100 * np.outer(1 / np.where(reach > 0, reach, 1.0), reach)
    said = "of what the channel (row) reaches, by what the component (column) reaches [%]"
    before, after = np.abs(error * share), sigma * share
    most = float(max(before.max(), after.max()))
    return [
        _table(f"Before: error of the matrix, {said}", error * share, before, most),
        _table(f"After: what its sigma leaves, {said}", after, after, most),
    ]


def _table(caption: str, values: Array, sizes: Array, most: float) -> dict[str, Any]:
    scale = DARKEST / most if most else 0.0

    def cell(value: float, size: float) -> dict[str, Any]:
        return {"text": f"{value:.2g}", "share": round(scale * size)}

    rows = [
        (name, [cell(*each) for each in zip(line.tolist(), strength.tolist(), strict=True)])
        for name, line, strength in zip(AXES, values, sizes, strict=True)
    ]
    return {"caption": caption, "names": AXES, "rows": rows}
