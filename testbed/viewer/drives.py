"""What the plate shows of the drives and of itself, as the viewer takes it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.experiment.run import MatrixErrors, Run
from testbed.identification.drives.friction_curves import DriveEstimate, FrictionCurve
from testbed.identification.drives.friction_map import FrictionMap
from testbed.recordings.columns import AXES
from testbed.reporting.drives import BAND, TITLE, drive_table
from testbed.reporting.section import Table
from testbed.viewer.colours import COLOURS, Colour

CELL = 40
"""Size of a cell in the picture [pixels]."""

LIGHTEST = (245.0, 246.0, 248.0)
"""Of a cell of zero; the largest has the colour itself."""

TITLES = {
    "before": "before: error of the matrix, % of what the channel (row) reaches",
    "after": "after: its standard deviation, % of what the channel reaches",
}
"""Of the pictures, by the name of each."""


def log_matrix(stream: rr.RecordingStream, found: MatrixErrors, at: str) -> None:
    """Cells from light to dark on one scale for both pictures, each with its number.

    Args:
        stream: Where to.
        found: The matrix.
        at: The pictures' place among the entities.
    """
    for name, values in zip(TITLES, (found.error, found.sigma), strict=True):
        path = f"{at}/{name}"
        stream.log(path, rr.Image(picture(values, found.most)), static=True)
        middles = np.array(
            [[CELL * (k + 0.5), CELL * (i + 0.5)] for i in range(6) for k in range(6)]
        )
        numbers = [f"{value:.2g}" for value in values.ravel().tolist()]
        _log_words(stream, f"{path}/numbers", middles, numbers, (20, 24, 32, 255))
        along = CELL * (np.arange(6) + 0.5)
        beside = np.full(6, -0.5 * CELL)
        places = np.vstack([np.column_stack([beside, along]), np.column_stack([along, beside])])
        _log_words(stream, f"{path}/names", places, [*AXES, *AXES], COLOURS["axis"])


def picture(values: Array, most: float) -> NDArray[np.uint8]:
    """Pixels of cells from light to dark, (6 CELL, 6 CELL, 3).

    Args:
        values: (6, 6).
        most: Of the darkest cell.
    """
    return np.asarray(_shades(values, most).repeat(CELL, axis=0).repeat(CELL, axis=1))


def _shades(values: Array, most: float) -> NDArray[np.uint8]:
    """Colours from light to dark by size, (..., 3)."""
    share = np.abs(values)[..., None] / (most or 1.0)
    colour = np.array(COLOURS["external"][:3])
    found: NDArray[np.uint8] = np.rint(LIGHTEST + share * (colour - np.array(LIGHTEST))).astype(
        np.uint8
    )
    return found


def _log_words(
    stream: rr.RecordingStream, path: str, places: Array, said: list[str], colour: Colour
) -> None:
    words = rr.Points2D(places, colors=[colour], radii=[0.1], labels=said, show_labels=True)
    stream.log(path, words, static=True)


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


def log_map(
    stream: rr.RecordingStream, path: str, cells: FrictionMap, axes: tuple[float, float]
) -> None:
    """Means of a joint's map over velocity, the darker the larger the load, with what they are.

    Args:
        stream: Where to.
        path: The plot's place among the entities.
        cells: The joint's.
        axes: Largest speed and torque, where the axes end.
    """
    if not len(cells.rows):
        return
    colours = _shades(cells.load, float(np.abs(cells.load).max()))
    places = np.column_stack([cells.speed / axes[0], -cells.friction / axes[1]])
    said = [f"load {load:.3g} {cells.unit}" for load in cells.load.tolist()]
    dots = rr.Points2D(places, colors=colours, radii=[0.012], labels=said)
    stream.log(f"{path}/map", dots, static=True)


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


CAP = 0.08
"""Half width of a bar's ends, in distances from joint to joint."""

TALL = 2.0
"""Height of the picture for the largest of what constants are off, in such distances."""


BELOW = 0.08
"""Distance of words from their bar."""


def log_constants(stream: rr.RecordingStream, drives: Sequence[DriveEstimate], at: str) -> None:
    """What each constant is off, with bars and the line at which data sheets are right.

    Args:
        stream: Where to.
        drives: One a joint.
        at: The picture's place among the entities.
    """
    scale = TALL / largest(drives)
    line = [[-0.5, 0.0], [len(drives) - 0.5, 0.0]]
    axis = rr.LineStrips2D([line], colors=[COLOURS["axis"]], radii=[0.006])
    stream.log(f"{at}/right", axis, static=True)
    heights = np.array([-scale * (each.constant - 1) for each in drives])  # y points down
    reach = np.array([scale * BAND * each.sigma for each in drives])
    strips = []
    for place, (height, half) in enumerate(zip(heights, reach, strict=True)):
        low, high = height - half, height + half
        strips.append([[place, low], [place, high]])
        strips += [[[place - CAP, end], [place + CAP, end]] for end in (low, high)]
    bars = rr.LineStrips2D(strips, colors=[COLOURS["external"]], radii=[0.008])
    stream.log(f"{at}/bars", bars, static=True)
    places = np.column_stack([np.arange(len(drives)), heights])
    points = rr.Points2D(places, colors=[COLOURS["external"]], radii=[0.03])
    stream.log(f"{at}/points", points, static=True)
    below = places + np.column_stack([np.zeros(len(drives)), reach + BELOW])
    said = [f"{d.joint} {d.constant:.5g} ± {BAND * d.sigma:.2g}" for d in drives]
    words = rr.Points2D(
        [*below, [len(drives) - 0.5, 0.0]],
        colors=[COLOURS["axis"]],
        radii=[0.001],
        labels=[*said, "1"],
        show_labels=True,
    )
    stream.log(f"{at}/words", words, static=True)


def largest(drives: Sequence[DriveEstimate]) -> float:
    """What constants are off at most, bars included.

    Args:
        drives: One a joint.
    """
    return max([1e-12, *(abs(d.constant - 1) + BAND * d.sigma for d in drives)])
