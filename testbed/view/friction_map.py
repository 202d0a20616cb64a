"""Friction over velocity and load: a map of each joint, and sections through it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from testbed.applications.drives.friction_map import FrictionMap
from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import number_with_sigma
from testbed.view.drives import BAND
from testbed.view.figures import Panel
from testbed.view.section import HeatTable, Section, Table


def map_section(maps: Sequence[FrictionMap]) -> Section:
    """Maps of all joints with sections through them.

    Args:
        maps: One a joint.
    """
    parts = [part for cells in maps for part in cells.by_temperature()]
    return Section(
        id="friction-map",
        title="Friction over velocity and load",
        says=(
            "The load is the torque that moves the link, by the force plate's estimate; friction "
            "is what the motor's torque has more. Where velocity and load have one sign the gear "
            "drives the link, else the link drives it back. No friction model is assumed."
        ),
        legend={"external": "forward", "internal": "backward"},
        panels=[_section(each) for each in parts],
        heats=[_heat(each) for each in parts],
        shown=4,
        caption=(
            f"At the speeds with most data, with {BAND:g} standard deviations. Maps: cells without "
            "data are empty."
        ),
        table=Table(
            ["joint", "velocity", "load", "temperature", "friction", "rows"],
            [line for each in maps for line in _lines(each)],
        ),
    )


def _lines(cells: FrictionMap) -> Iterator[list[str]]:
    columns = cells.speed, cells.load, cells.temperature, cells.friction, cells.sigma, cells.rows
    for speed, load, warm, *value, rows in zip(*(c.tolist() for c in columns), strict=True):
        place = [f"{speed:.3g}", f"{load:.3g}", f"{warm:.1f}" if np.isfinite(warm) else "-"]
        said = number_with_sigma(value[0], value[1], short=True)
        yield [cells.joint, *place, f"{said} {cells.unit}", f"{rows:g}"]


def _name(cells: FrictionMap) -> str:
    """The joint, and the mean temperature where there are maps of several."""
    warm = np.isfinite(cells.temperatures).any()
    mean = np.average(cells.temperature, weights=cells.rows)
    return f"{cells.joint} at {mean:.0f} °C" if warm else cells.joint


def resisting(cells: FrictionMap) -> Array:
    """Friction against the motion, (k,) [N m or N].

    Args:
        cells: The map.
    """
    return np.asarray(cells.friction * np.sign(cells.speed))


def _heat(cells: FrictionMap) -> HeatTable:
    """Friction against the motion, a row a load and a column a velocity."""
    loads, rows = np.unique(cells.loads[:, 0], return_inverse=True)
    speeds, columns = np.unique(cells.speeds[:, 0], return_inverse=True)
    values = np.full((len(loads), len(speeds)), np.nan)
    values[rows, columns] = resisting(cells)
    return HeatTable.of_shares(
        f"{_name(cells)}: against the motion [{cells.unit}], rows: load, columns: velocity",
        _means(cells.load, rows),
        _means(cells.speed, columns),
        values,
        np.abs(values) / np.nanmax(np.abs(values)),
    )


def _means(values: Array, groups: NDArray[np.intp]) -> list[str]:
    """Mean value of each group of cells."""
    return [f"{mean:.2g}" for mean in np.bincount(groups, values) / np.bincount(groups)]


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
    title = f"{_name(cells)}: against the motion [{cells.unit}]"
    alone = tuple(kind for kind, (load, _) in curves.items() if len(load) == 1)
    return Panel(title, curves, f"load [{cells.unit}]", points=alone, bands=bands)
