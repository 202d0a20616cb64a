"""The robot on its bedplate with the reaction on it, as SVG that needs nothing else."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from html import escape
from io import BytesIO

import numpy as np
from matplotlib.image import imsave
from numpy.typing import NDArray

from testbed.bodies.shapes.appearance import Appearance
from testbed.bodies.shapes.shapes import triangles
from testbed.core.base.arrays import Array
from testbed.core.base.errors import round_significant
from testbed.core.dynamics.newton_euler import poses

FINER = 2
"""Pixels are this many times finer while drawing, then averaged."""

Picture = NDArray[np.uint8]
Numbers = NDArray[np.intp]

SIZE = 640
"""Pixels of the picture's longer side."""
BORDER = 24
"""Free on every side [pixels]."""
LETTER = 11
"""Width of a letter, more than less [pixels]."""
HEIGHT = 24
"""Of a line of text [pixels]."""
EYE = np.array([0.9, -1.6, 0.65])
"""Where the picture is taken from; parallel rays."""
LIGHT = np.array([0.5, -0.2, 0.85])
"""Where the light comes from."""
EDGE = 1.5
"""Of the page's colour around arrows, which a robot may have the colour of [pixels]."""
ARROW = 0.4
"""Length of the force's and the moment's arrow, as part of the robot's reach."""


def portrait(
    look: Appearance,
    motion: Array,
    wrench: Array | None,
    name: str,
    place: Array | None = None,
) -> str:
    """The robot at the first of its postures, the paths of its ends, and the reaction on it.

    Args:
        look: What it looks like.
        motion: Joint positions, (M, n) [rad or m].
        wrench: Of the bedplate on the robot at the first posture, (6,) [N, N m]; None for none.
        name: What the picture shows, for those who cannot see it.
        place: Where the wrench is drawn, (3,) [m]; default beside the plate.
    """
    camera = view(EYE)
    placed = poses(look.tree, motion)
    solid, colours = _surfaces(look, placed)
    paths = [placed[j][1] + placed[j][0] @ point for j, point in look.tips.items()]
    place = look.corner if place is None else place
    arrows = [] if wrench is None else _arrows(look, wrench, place)
    frame = 0.25 * look.reach * np.eye(3)
    every = np.concatenate([solid.reshape(-1, 3), *paths, *(ends for ends, *_ in arrows), frame])
    flat = every @ camera.T
    low, high = flat[:, :2].min(axis=0), flat[:, :2].max(axis=0)
    scale = SIZE / float((high - low).max())
    width, height = np.ceil((high - low) * scale).astype(int).tolist()

    def projected(points: Array) -> Array:
        """Pixels to the right and down, and depth."""
        seen = points @ camera.T
        return np.stack(
            [(seen[..., 0] - low[0]) * scale, (high[1] - seen[..., 1]) * scale, seen[..., 2]],
            axis=-1,
        )

    picture = base64.b64encode(png(paint(projected(solid), colours, width, height))).decode()
    parts = [f'<image width="{width}" height="{height}" href="data:image/png;base64,{picture}"/>']
    for path in paths:
        line = " ".join(f"{x:.0f},{y:.0f}" for x, y, _ in projected(path))
        parts.append(
            f'<polyline points="{line}" fill="none" stroke="var(--truth)" stroke-width="1.5" '
            'opacity=".6"/>'
        )
    marks = [
        (np.stack([0 * axis, axis]), "var(--ink)", 1.5, letter)
        for axis, letter in zip(frame, "xyz", strict=True)
    ] + [(ends, colour, 4.0, label) for ends, colour, label in arrows]
    labels: list[Label] = []
    for ends, colour, thickness, label in marks:
        pixels = projected(ends)
        parts.append(_arrow(pixels, colour, thickness))
        labels.append(_label(pixels, label, labels))
    parts += [each.svg() for each in labels]  # no arrow over any
    left, top = np.min([[0.0, 0.0], *([each.left, each.top] for each in labels)], axis=0)
    right, bottom = np.max(
        [[width, height], *([each.left + each.width, each.top + HEIGHT] for each in labels)], axis=0
    )
    box = (
        f"{left - BORDER:.0f} {top - BORDER:.0f} "
        f"{right - left + 2 * BORDER:.0f} {bottom - top + 2 * BORDER:.0f}"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" role="img" '
        f'aria-label="{escape(name)}" font-family="sans-serif" font-size="20">'
        f"{''.join(parts)}</svg>"
    )


def view(eye: Array) -> Array:
    """Rows: to the right, up, and away from the eye, (3, 3).

    Args:
        eye: Where the picture is taken from, not straight above; parallel rays, (3,).
    """
    away = -eye / np.linalg.norm(eye)
    right = np.cross(away, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, away), away])


def _surfaces(look: Appearance, placed: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """All triangles at the first posture, (T, 3, 3) [m], and their shaded colours, (T, 3)."""
    found, colours = [], []
    for shape in look.shapes:
        corners = triangles(shape)
        if shape.body >= 0:
            rotation, position = placed[shape.body]
            corners = corners @ rotation[0].T + position[0]
        found.append(corners)
        colours.append(np.tile(np.clip(shape.colour[:3], 0, 1), (len(corners), 1)))
    solid = np.concatenate(found)
    normals = np.cross(solid[:, 1] - solid[:, 0], solid[:, 2] - solid[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    normals *= np.where(normals @ EYE < 0, -1.0, 1.0)[:, None]  # files wind as they like
    light = np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    return solid, np.concatenate(colours) * (0.5 + 0.5 * light)[:, None]


def _arrows(look: Appearance, wrench: Array, place: Array) -> list[tuple[Array, str, str]]:
    """Ends (2, 3) [m], colour and label of the force and the moment."""
    found = []
    for vector, colour, unit in (
        (wrench[:3], "var(--force)", "N"),
        (wrench[3:], "var(--moment)", "N m"),
    ):
        size = float(np.linalg.norm(vector))
        if size > 0:
            tip = place + vector / size * ARROW * look.reach
            found.append((np.stack([place, tip]), colour, f"{round_significant(size, 3):g} {unit}"))
    return found


def _arrow(ends: Array, colour: str, thickness: float) -> str:
    """A line with a head; (2, 3) pixels."""
    (x0, y0, _), (x1, y1, _) = ends.tolist()
    along = _direction(ends)
    across = np.array([-along[1], along[0]])
    tip, size = np.array([x1, y1]), 3.0 * thickness + 2.0
    base = tip - along * min(size * 1.6, float(np.hypot(x1 - x0, y1 - y0)))
    head = " ".join(
        f"{x:.1f},{y:.1f}" for x, y in (tip, base + across * size / 2, base - across * size / 2)
    )
    line = f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{base[0]:.1f}" y2="{base[1]:.1f}" '
    return (
        f'{line}stroke="var(--paper)" stroke-width="{thickness + 2 * EDGE}"/>'
        f'{line}stroke="{colour}" stroke-width="{thickness}"/>'
        f'<polygon points="{head}" fill="{colour}" stroke="var(--paper)" stroke-width="{EDGE}" '
        'paint-order="stroke"/>'
    )


def _direction(ends: Array) -> Array:
    """From the first to the second of two pixels, (2,), of length 1; 0 for the same."""
    along: Array = (ends[1] - ends[0])[:2]
    return along / max(float(np.linalg.norm(along)), 1e-9)


@dataclass(frozen=True)
class Label:
    """A line of text and the corner of its box [pixels]."""

    text: str
    left: float
    top: float

    @property
    def width(self) -> float:
        """More than less [pixels]."""
        return float(LETTER * len(self.text))

    def covers(self, other: Label) -> bool:
        """Whether the two boxes overlap."""
        return (
            self.left < other.left + other.width
            and other.left < self.left + self.width
            and abs(self.top - other.top) < HEIGHT
        )

    def svg(self) -> str:
        """Edged in the page's colour, for a robot may have the ink's."""
        return (
            f'<text x="{self.left + self.width / 2:.1f}" y="{self.top + 0.75 * HEIGHT:.1f}" '
            'fill="var(--ink)" text-anchor="middle" stroke="var(--paper)" stroke-width="5" '
            f'stroke-linejoin="round" paint-order="stroke">{escape(self.text)}</text>'
        )


def _label(ends: Array, text: str, others: list[Label]) -> Label:
    """Beyond an arrow's tip, (2, 3) pixels, as far out as it takes to be clear of the others."""
    along, middle = _direction(ends), ends[1, :2]
    size = np.array([LETTER * len(text), HEIGHT])
    out = along if np.any(along) else np.array([0.0, -1.0])
    gap = 6.0 + float(np.abs(out) @ size) / 2
    while True:
        left, top = (middle + gap * out - size / 2).tolist()
        placed = Label(text, left, top)
        if not any(placed.covers(each) for each in others):
            return placed
        gap += 4.0


def paint(corners: Array, colours: Array, width: int, height: int) -> Picture:
    """Red, green, blue and opacity of a picture, (height, width, 4).

    Args:
        corners: (T, 3 corners, 3): x to the right and y down in pixels, z away from the eye.
        colours: One a triangle, 0 ... 1, (T, 3).
        width: Of the picture [pixels].
        height: Of the picture [pixels].
    """
    tall, wide = FINER * height, FINER * width
    fine = corners * [FINER, FINER, 1.0]
    owner, x, y = _covered(fine, wide, tall)
    z = _depth(fine, owner, np.column_stack([x, y]).astype(np.float64) + 0.5)
    order = np.argsort(-z, kind="stable")  # what is assigned last stays: the nearest
    seen = np.zeros((tall, wide, 4))
    place = y[order], x[order]
    seen[place] = np.concatenate([colours, np.ones((len(colours), 1))], axis=1)[owner[order]]
    blocks = seen.reshape(height, FINER, width, FINER, 4).sum(axis=(1, 3))
    share = blocks[..., 3:] / FINER**2
    colour = blocks[..., :3] / np.maximum(blocks[..., 3:], 1.0)
    return np.round(255 * np.concatenate([colour, share], axis=-1)).astype(np.uint8)


def _covered(corners: Array, wide: int, tall: int) -> tuple[Numbers, Numbers, Numbers]:
    """Every pixel whose centre a triangle covers: which triangle, column and row."""
    y = corners[..., 1]
    triangle, row = _spans(np.clip(y.min(axis=1), 0, tall), np.clip(y.max(axis=1), 0, tall))
    centre = row + 0.5
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for k in range(3):
        ends = corners[:, [k, (k + 1) % 3], :2]
        upward = ends[:, 0, 1] > ends[:, 1, 1]
        ends[upward] = ends[upward, ::-1]  # neighbours share an edge to the last bit
        (x0, y0), (x1, y1) = (ends[triangle, j].T for j in range(2))
        crossed = (y0 <= centre) != (y1 <= centre)
        rise = np.where(crossed, y1 - y0, 1.0)
        cut = x0 + (centre - y0) / rise * (x1 - x0)
        left = np.where(crossed, np.minimum(left, cut), left)
        right = np.where(crossed, np.maximum(right, cut), right)
    there = left <= right
    span, column = _spans(np.clip(left[there], 0, wide), np.clip(right[there], 0, wide))
    return triangle[there][span], column, row[there][span]


def _spans(first: Array, last: Array) -> tuple[Numbers, Numbers]:
    """Pixels with centres from `first` to `last`, and to which interval each belongs."""
    start = np.ceil(first - 0.5).astype(np.intp)
    counts = np.maximum(np.ceil(last - 0.5).astype(np.intp) - start, 0)
    owner = np.repeat(np.arange(len(counts)), counts)
    before = np.cumsum(counts) - counts
    return owner, np.arange(len(owner)) - before[owner] + start[owner]


def _depth(corners: Array, owner: Numbers, points: Array) -> Array:
    """Depth of points, (P, 2), on the planes of their triangles."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    steep = np.where(normal[:, 2] == 0, 1.0, normal[:, 2])  # seen edge on: covers no pixel
    slope = -normal[:, :2] / steep[:, None]
    start = corners[:, 0]
    rise = np.sum(slope[owner] * (points - start[owner, :2]), axis=1)
    return np.asarray(start[owner, 2] + rise)


def png(picture: Picture) -> bytes:
    """A picture as a PNG file.

    Args:
        picture: Red, green, blue and opacity, (height, width, 4).
    """
    file = BytesIO()
    imsave(file, picture, format="png")
    return file.getvalue()
