"""The plate's matrix as pictures, before calibration and after it."""

from __future__ import annotations

import numpy as np
import rerun as rr

from testbed.arrays import Array
from testbed.experiment.run import MatrixErrors
from testbed.recordings.columns import AXES
from testbed.viewer.colours import COLOURS, Colour

CELL = 40
"""Size of a cell in the picture [pixels]."""

LIGHTEST = (245.0, 246.0, 248.0)
"""Of a cell of zero; the largest has the colour itself."""

TITLES = {
    "before": "before: error of the matrix, % of what the channel (row) reaches",
    "after": "after: what sigma leaves of it, %",
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


def picture(values: Array, most: float) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Pixels of cells from light to dark, (6 CELL, 6 CELL, 3).

    Args:
        values: (6, 6).
        most: Of the darkest cell.
    """
    share = np.abs(values)[..., None] / (most or 1.0)
    colour = np.array(COLOURS["external"][:3])
    cells = np.rint(LIGHTEST + share * (colour - np.array(LIGHTEST))).astype(np.uint8)
    return np.asarray(cells.repeat(CELL, axis=0).repeat(CELL, axis=1))


def _log_words(
    stream: rr.RecordingStream, path: str, places: Array, said: list[str], colour: Colour
) -> None:
    words = rr.Points2D(places, colors=[colour], radii=[0.1], labels=said, show_labels=True)
    stream.log(path, words, static=True)
