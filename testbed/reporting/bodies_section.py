"""Bodies that can exist, drawn as ellipsoids on the robot: model file, truth, estimate."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.kinematics import poses
from testbed.experiment.run import Run
from testbed.identification.consistency import Consistent, robot_of
from testbed.parameters.barycentric import with_standard
from testbed.reporting.consistent_table import consistent_lines
from testbed.reporting.portrait import view
from testbed.robot.tree import Tree
from testbed.robot.visuals.shapes import Shape, equivalent_ellipsoids

SIZE = 480
"""Pixels of a drawing's longer side."""

BORDER = 16
"""Free on every side [pixels]."""

STYLES = {"measured": "5 3", "truth": "1 3", "external": "none"}
"""Dashes of an outline, by colour."""

VIEWS = {
    "from the side": (0.9, -1.6, 0.65),
    "from above": (0.05, -0.1, 2.0),
}
"""Where drawings are taken from."""


@dataclass(frozen=True)
class Drawing:
    """A drawing, and what it shows.

    Attributes:
        title: In words.
        svg: As an element of a page.
    """

    title: str
    svg: str


def bodies_section(run: Run, found: Consistent) -> dict[str, Any]:
    """Ellipsoids, and mass, centre and what the data told of every link.

    Args:
        run: The run.
        found: Its consistent bodies.
    """
    robots = {"measured": with_standard(run.tree, found.prior)}
    if run.score is not None:
        robots["truth"] = run.tree
    robots["external"] = robot_of(found, run.tree)
    names = {"measured": "model file", "truth": "truth", "external": "estimate"}
    return {
        "id": "bodies",
        "title": "Bodies that can exist",
        "says": "Each link as the ellipsoid of even density that has its mass, centre and "
        "inertia. " + " ".join(consistent_lines(found)),
        "legend": {kind: names[kind] for kind in robots},
        "panels": [
            Drawing(title, _drawn(robots, run.recording.position[:1], np.array(eye), title))
            for title, eye in VIEWS.items()
        ],
        "caption": "The robot as the recording begins, on sticks between its joints. Told is the "
        "part of the prior's variance that the data took away, the mean over a link's ten "
        "parameters.",
        "heads": ["link", "mass, model file [kg]", "mass [kg]", "centre [m]", "told"],
        "rows": [_row(found, k) for k in range(len(found.links))],
    }


def _row(found: Consistent, k: int) -> list[str]:
    mass = found.standard[k, 0]
    centre = found.standard[k, 1:4] / mass if mass else np.zeros(3)
    return [
        found.links[k],
        f"{found.prior[k, 0]:.4g}",
        f"{mass:.4g} +- {found.sigma[k, 0]:.2g}",
        " ".join(f"{x:.4f}" for x in centre),
        f"{found.told[k].mean():.0%}",
    ]


def _drawn(robots: dict[str, Tree], posture: Array, eye: Array, title: str) -> str:
    """Outlines of all robots' ellipsoids, and sticks."""
    camera = view(eye)[:2]
    tree = next(iter(robots.values()))
    placed = [(rotation[0], position[0]) for rotation, position in poses(tree, posture)]
    outlines = [
        (kind, *_outline(shape, placed[shape.body], camera))
        for kind, robot in robots.items()
        for shape in equivalent_ellipsoids(robot, (0.0, 0.0, 0.0, 1.0))
    ]
    origins = [np.zeros(2), *(camera @ position for _, position in placed)]
    corners = [np.stack([c - reach, c + reach]) for _, c, reach, _, _ in outlines]
    every = np.concatenate([np.stack(origins), *corners])
    low, high = every.min(axis=0), every.max(axis=0)
    scale = SIZE / max(float((high - low).max()), 1e-9)
    width, height = (high - low) * scale

    def pixels(point: Array) -> tuple[float, float]:
        return float((point[0] - low[0]) * scale), float((high[1] - point[1]) * scale)

    parts = []
    for joint, own in zip(tree.joints, origins[1:], strict=True):
        (x1, y1), (x2, y2) = pixels(origins[joint.parent + 1]), pixels(own)
        parts.append(
            f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" '
            'stroke="var(--line)" stroke-width="6" stroke-linecap="round"/>'
        )
    for kind, centre, _, half, angle in outlines:
        x, y = pixels(centre)
        a, b = np.maximum(half * scale, 1.0)
        parts.append(
            f'<ellipse cx="{x:.1f}" cy="{y:.1f}" rx="{a:.1f}" ry="{b:.1f}" '
            f'transform="rotate({-angle:.1f} {x:.1f} {y:.1f})" fill="none" '
            f'stroke="var(--{kind})" stroke-width="2" stroke-dasharray="{STYLES[kind]}"/>'
        )
    box = f"{-BORDER} {-BORDER} {width + 2 * BORDER:.0f} {height + 2 * BORDER:.0f}"
    name = escape(f"Links as ellipsoids, {title}")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" role="img" aria-label="{name}" '
        f'style="max-height:24rem">{"".join(parts)}</svg>'
    )


def _outline(
    shape: Shape, pose: tuple[Array, Array], camera: Array
) -> tuple[Array, Array, Array, float]:
    """Of an ellipsoid in a picture: centre, reach, half axes, (2,) each [m], angle [degrees]."""
    rotation, position = pose
    axes = camera @ rotation @ shape.rotation * shape.size
    spread = axes @ axes.T
    size, turn = np.linalg.eigh(spread)
    angle = float(np.degrees(np.arctan2(turn[1, 1], turn[0, 1])))
    half = np.sqrt(np.maximum(size[::-1], 0.0))
    centre = camera @ (position + rotation @ shape.position)
    return centre, np.sqrt(np.diagonal(spread)), half, angle
