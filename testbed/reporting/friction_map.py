"""Friction over velocity and load: a map of each joint, and sections through it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

import numpy as np

from testbed.arrays import Array
from testbed.identification.drives.friction_map import FrictionMap
from testbed.identification.estimate import number_with_sigma
from testbed.reporting.drives import BAND
from testbed.reporting.figures import (
    BOTTOM,
    FONT,
    HEIGHT,
    LEFT,
    NUMBERS,
    RIGHT,
    TOP,
    WIDTH,
    X_LABEL,
    Panel,
    colour,
    text,
    tick_label,
)
from testbed.reporting.section import Drawing, Section, Table


def map_section(maps: Sequence[FrictionMap]) -> Section:
    """Maps of all joints with sections through them.

    Args:
        maps: One a joint.
    """
    panels: list[Panel | Drawing] = []
    for each in maps:
        if len(each.rows):
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
            "Maps: against the motion, the darker the larger; cells without data are empty. "
            f"Sections: at the speeds with most data, with {BAND:g} standard deviations."
        ),
        table=Table(
            ["joint", "velocity", "load", "friction", "rows"],
            [line for each in maps for line in _lines(each)],
        ),
    )


def _lines(cells: FrictionMap) -> Iterator[list[str]]:
    columns = cells.speed, cells.load, cells.friction, cells.sigma, cells.rows
    for speed, load, friction, sigma, rows in zip(*(c.tolist() for c in columns), strict=True):
        said = number_with_sigma(friction, sigma, short=True)
        yield [cells.joint, f"{speed:.3g}", f"{load:.3g}", f"{said} {cells.unit}", f"{rows:g}"]


def resisting(cells: FrictionMap) -> Array:
    """Friction against the motion, (k,) [N m or N].

    Args:
        cells: The map.
    """
    return np.asarray(cells.friction * np.sign(cells.speed))


def _heat(cells: FrictionMap) -> Drawing:
    """Cells of one size, with what their edges are."""
    size, most = resisting(cells), max(float(np.abs(cells.friction).max()), 1e-300)
    across, up = np.unique(cells.speeds[:, 0]), np.unique(cells.loads[:, 0])[::-1]
    wide = (WIDTH - LEFT - RIGHT) / len(across)
    tall = (HEIGHT - TOP - BOTTOM) / len(up)
    title = f"{cells.joint}: friction, up to {most:.3g} {cells.unit}"
    parts = [text(title, LEFT, TOP - 3.5, "start")]
    for k, friction in enumerate(size.tolist()):
        x = LEFT + wide * int(np.flatnonzero(across == cells.speeds[k, 0])[0])
        y = TOP + tall * int(np.flatnonzero(up == cells.loads[k, 0])[0])
        said = f"{cells.friction[k]:.3g} ± {cells.sigma[k]:.2g} {cells.unit}"
        parts.append(
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{wide:.1f}" height="{tall:.1f}" '
            f'fill="{colour("external")}" opacity="{abs(friction) / most:.2f}">'
            f"<title>{escape(said)}</title></rect>"
        )
    for number, edge in enumerate(across.tolist()):
        if number % (1 + len(across) // 8) == 0 and np.isfinite(edge):
            x = LEFT + wide * number
            parts.append(text(tick_label(edge), x, HEIGHT - BOTTOM + NUMBERS, "middle", "x"))
    for number, edge in enumerate(up.tolist()):
        if number % (1 + len(up) // 5) == 0:
            y = TOP + tall * (number + 1)
            parts.append(text(tick_label(edge), LEFT - 3.5, y, "end", "y"))
    speed = "velocity [rad/s]" if cells.unit == "N m" else "velocity [m/s]"
    label = f"least {speed} of the cells; upwards least load [{cells.unit}]"
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(text(label, middle, HEIGHT - BOTTOM + X_LABEL, "middle"))
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
        f'aria-label="{escape(title)}" font-size="{FONT:g}" '
        f"font-family=\"'DejaVu Sans',sans-serif\">{''.join(parts)}</svg>"
    )
    return Drawing(title, svg)


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
    return Panel(title, curves, f"load [{cells.unit}]", bands=bands)
