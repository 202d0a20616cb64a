"""What the plate shows of the drives and of itself, as the viewer takes it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr

from testbed.applications.drives.friction_curves import FrictionCurve
from testbed.lab.experiment.run import Run
from testbed.view.drives import BAND, TITLE, drive_table
from testbed.view.section import Table
from testbed.view.viewer.colours import COLOURS


def log_curve(
    stream: rr.RecordingStream, path: str, curve: FrictionCurve, axes: tuple[float, float]
) -> None:
    """A joint's friction curve and the edges of its band, a strip for each direction.

    Args:
        stream: Where to.
        path: The plot's place among the entities.
        curve: The joint's.
        axes: Largest speed and torque, where the axes end.
    """
    lines, widths = [], []
    for part in _directions(curve):
        speed, torque, sigma = curve.speed[part], curve.torque[part], curve.sigma[part]
        for away, width in ((0.0, 0.006), (-BAND, 0.002), (BAND, 0.002)):
            height = torque + away * sigma
            lines.append(np.column_stack([speed / axes[0], -height / axes[1]]))  # y points down
            widths.append(width)
    if lines:
        strips = rr.LineStrips2D(lines, colors=[COLOURS["external"]], radii=widths)
        stream.log(f"{path}/by_plate", strips, static=True)


def _directions(curve: FrictionCurve) -> Iterator[slice]:
    """Backwards and forwards, where there are at least two nodes."""
    split, count = int(np.searchsorted(curve.speed, 0.0)), len(curve.speed)
    for first, last in ((0, split), (split, count)):
        if last - first > 1:
            yield slice(first, last)


def notes_of_drives(run: Run) -> list[str]:
    """Torque constants and terms, joint by joint, as paragraphs of Markdown; [] without them.

    Args:
        run: The run.
    """
    if run.drives is None:
        return []
    return [f"## {TITLE}", drive_table(run.drives.estimates).markdown]


def notes_of_plate(run: Run) -> list[str]:
    """Numbers of the plate that were estimated, as paragraphs of Markdown; [] without them.

    Args:
        run: The run.
    """
    external = run.estimates.get("external")
    if external is None or not external.nuisances:
        return []
    rows = [[n.name, f"{n.value:.4g} +- {n.sigma:.2g}", n.unit] for n in external.nuisances]
    table = Table(["number", "value", "unit"], rows)
    name = run.instruments["external"]
    return [f"## The {name}, estimated with the parameters", table.markdown]
