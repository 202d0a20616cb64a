"""Friction over velocity and load: a map of each joint, and sections through it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

import numpy as np

from testbed.applications.drives.friction_map import LOADS, SPEEDS, FrictionMap
from testbed.core.base.arrays import Array
from testbed.core.base.summary_table import number_with_sigma
from testbed.view.drives import BAND
from testbed.view.figures import (
    BOTTOM,
    FONT,
    GRID,
    HEIGHT,
    LEFT,
    MIDDLE,
    NUMBERS,
    RIGHT,
    STILL,
    TOP,
    WIDTH,
    X_LABEL,
    Panel,
    colour,
    text,
    tick_label,
)
from testbed.view.section import Drawing, Section, Table


def map_section(maps: Sequence[FrictionMap]) -> Section:
    """Maps of all joints with sections through them.

    Args:
        maps: One a joint.
    """
    panels: list[Panel | Drawing] = []
    for each in maps:
        panels += [_heat(each), _section(each)]
    return Section(
        id="friction-map",
        title="Friction over velocity and load",
        says=(
            "The load is the torque that moves the link, by the force plate's estimate; friction "
            "is what the motor's torque has more. Where velocity and load have one sign the gear "
            "drives the link, else the link drives it back. No friction model is assumed."
        ),
        legend={"external": "forward", "internal": "backward"},
        panels=panels,
        shown=4,
        caption=(
            "Maps: against the motion, the larger the stronger; cells without data are empty. "
            f"Sections: at the speeds with most data, with {BAND:g} standard deviations."
        ),
        table=Table(
            ["joint", "velocity", "load", "friction", "rows"],
            [line for each in maps for line in _lines(each)],
        ),
    )


def _lines(cells: FrictionMap) -> Iterator[list[str]]:
    columns = cells.speed, cells.load, cells.friction, cells.sigma, cells.rows
    for speed, load, *value, rows in zip(*(c.tolist() for c in columns), strict=True):
        place = [f"{speed:.3g}", f"{load:.3g}"]
        said = number_with_sigma(value[0], value[1], short=True)
        yield [cells.joint, *place, f"{said} {cells.unit}", f"{rows:g}"]


def resisting(cells: FrictionMap) -> Array:
    """Friction against the motion, (k,) [N m or N].

    Args:
        cells: The map.
    """
    return np.asarray(cells.friction * np.sign(cells.speed))


FAINT = 0.15
"""Opacity of the least friction; the largest has one."""


def _heat(cells: FrictionMap) -> Drawing:
    """Cells of one size between their edges; a gap is a cell without data."""
    size = np.abs(resisting(cells))
    least, most = float(size.min()), float(size.max())
    shade = FAINT + (1 - FAINT) * (size - least) / max(most - least, 1e-300)
    across = _edges(cells.speeds, np.array([*-np.array(SPEEDS[::-1]), *SPEEDS[1:]]))
    step = cells.loads[0, 1] - cells.loads[0, 0]
    up = _edges(cells.loads, step * np.arange(-LOADS, LOADS + 1))
    wide = (WIDTH - LEFT - RIGHT) / len(across)
    tall = (HEIGHT - TOP - BOTTOM) / len(up)
    x = LEFT + wide * np.searchsorted(across, cells.speeds[:, 0] - STILL)
    y = HEIGHT - BOTTOM - tall * (1 + np.searchsorted(up, cells.loads[:, 0] - STILL * step))
    title = f"{cells.joint}: friction, {least:.3g} to {most:.3g} {cells.unit}"
    parts = [text(title, LEFT, TOP - 3.5, "start")]
    for k, opacity in enumerate(shade.tolist()):
        said = f"{cells.friction[k]:.3g} ± {cells.sigma[k]:.2g} {cells.unit}"
        parts.append(
            f'<rect x="{x[k]:.1f}" y="{y[k]:.1f}" width="{wide:.1f}" height="{tall:.1f}" '
            f'fill="{colour("external")}" opacity="{opacity:.2f}">'
            f"<title>{escape(said)}</title></rect>"
        )
    parts.append(
        f'<rect x="{LEFT:g}" y="{TOP:g}" width="{WIDTH - LEFT - RIGHT:g}" '
        f'height="{HEIGHT - TOP - BOTTOM:g}" fill="none" stroke="currentColor"{GRID}/>'
    )
    for number, edge in enumerate(across.tolist()):
        if number % (1 + len(across) // 8) == 0 and np.isfinite(edge):
            place = LEFT + wide * number
            parts.append(text(tick_label(edge), place, HEIGHT - BOTTOM + NUMBERS, "middle", "x"))
    for number, edge in enumerate(up.tolist()):
        if number and number % (1 + len(up) // 5) == 0:  # the first is beside the other axis' first
            place = HEIGHT - BOTTOM - tall * number + MIDDLE
            parts.append(text(tick_label(edge), LEFT - 3.5, place, "end", "y"))
    speed = "velocity [rad/s]" if cells.unit == "N m" else "velocity [m/s]"
    middle = (LEFT + WIDTH - RIGHT) / 2
    label = f"{speed}; upwards load [{cells.unit}]"
    parts.append(text(label, middle, HEIGHT - BOTTOM + X_LABEL, "middle"))
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
        f'aria-label="{escape(title)}" font-size="{FONT:g}" '
        f"font-family=\"'DejaVu Sans',sans-serif\">{''.join(parts)}</svg>"
    )
    return Drawing(title, svg)


def _edges(cells: Array, every: Array) -> Array:
    """Lower edges of all cells from the first with data to the last, those between as well."""
    every = np.array([-np.inf, *every])
    return np.asarray(every[(every >= cells.min() - STILL) & (every < cells[:, 0].max() + STILL)])


def _section(cells: FrictionMap) -> Panel:
    """Friction over load, at the speed of either direction with the most data."""
    curves: dict[str, tuple[Array, Array]] = {}
    bands = {}
    for kind, way in (("external", 1.0), ("internal", -1.0)):
        own = np.sign(cells.speed) == way
        if not own.any():
            continue
        columns, place = np.unique(cells.speeds[own, 0], return_inverse=True)
        most = columns[np.argmax(np.bincount(place, cells.rows[own]))]
        own &= cells.speeds[:, 0] == most
        curves[kind] = cells.load[own], resisting(cells)[own]
        bands[kind] = BAND * cells.sigma[own]
    title = f"{cells.joint}: against the motion [{cells.unit}]"
    alone = tuple(kind for kind, (load, _) in curves.items() if len(load) == 1)
    return Panel(title, curves, f"load [{cells.unit}]", points=alone, bands=bands)
