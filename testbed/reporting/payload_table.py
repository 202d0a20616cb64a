"""A payload as a table and sentences for the terminal, and for programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from testbed.errors import plural, printable
from testbed.identification.estimate_text import number_with_sigma

if TYPE_CHECKING:
    from testbed.identification.payload import PayloadEstimate
    from testbed.identification.rest import Weighed


def payload_table(found: PayloadEstimate) -> Table:
    """The ten parameters: value and sigma, or that a parameter is told in combination only.

    Args:
        found: The payload.
    """
    table = Table(
        title=f"payload on the link of {printable(found.joint)}, about and along its frame",
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD,
    )
    table.add_column("")
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("unit")
    for k, name in enumerate(found.names):
        value, sigma = float(found.values[k]), float(found.sigma[k])
        said = number_with_sigma(value, sigma, short=True) if found.told[k] else "not told alone"
        table.add_row(name, said, found.units[k])
    return table


def payload_lines(found: PayloadEstimate) -> list[str]:
    """How much is told, and the centre of mass, a sentence each.

    Args:
        found: The payload.
    """
    whole = all(found.told)
    lines = [
        "All ten are told."
        if whole
        else f"{sum(found.told)} are told alone, and {plural(found.rank, 'combination')} in all."
    ]
    centre = found.centre
    if centre is not None:
        lines.append(f"Centre of mass: {_place(*centre)}.")
    return lines


def weighed_lines(payload: Weighed, robot: Weighed) -> list[str]:
    """A payload and a robot by their weight, a sentence each.

    Args:
        payload: The payload.
        robot: The robot alone.
    """
    place = _place(np.array(payload.centre), np.array(payload.centre_sigma))
    return [
        f"Payload: {number_with_sigma(payload.mass, payload.sigma, short=False)} kg, centre of "
        f"mass {place}, by {payload.poses} poses.",
        f"What moves of the robot: {number_with_sigma(robot.mass, robot.sigma, short=False)} kg.",
    ]


def _place(centre: Any, sigma: Any) -> str:
    said = [
        f"{axis} {number_with_sigma(float(c), float(s), short=False)} m"
        if np.isfinite(c)
        else f"{axis} not told"
        for axis, c, s in zip("xyz", centre, sigma, strict=True)
    ]
    return ", ".join(said)


def payload_as_json(found: PayloadEstimate) -> dict[str, Any]:
    """For programs: null where a parameter is not told.

    Args:
        found: The payload.
    """
    centre = found.centre
    return {
        "joint": found.joint,
        "parameters": {
            name: {
                "value": float(found.values[k]) if found.told[k] else None,
                "sigma": float(found.sigma[k]) if found.told[k] else None,
                "unit": found.units[k],
            }
            for k, name in enumerate(found.names)
        },
        "centre": None if centre is None else [_numbers(each) for each in centre],
        "rank": found.rank,
        "chance": found.chance,
        "diagnostics": [each.as_dict() for each in found.diagnostics],
    }


def weighed_as_json(payload: Weighed, robot: Weighed) -> dict[str, Any]:
    """For programs.

    Args:
        payload: The payload.
        robot: The robot alone.
    """
    return {
        "mass": {"value": payload.mass, "sigma": payload.sigma, "unit": "kg"},
        "centre": [_numbers(payload.centre), _numbers(payload.centre_sigma)],
        "robot_mass": {"value": robot.mass, "sigma": robot.sigma, "unit": "kg"},
        "poses": payload.poses,
    }


def _numbers(values: Any) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]
