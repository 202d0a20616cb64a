"""Triangles as a picture, without a graphics card: every pixel of each, the nearest stays."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array

FINER = 2
"""Pixels are this many times finer while drawing, then averaged."""

Picture = NDArray[np.uint8]
Numbers = NDArray[np.intp]


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
    height, width, _ = picture.shape
    rows = np.concatenate([np.zeros((height, 1), np.uint8), picture.reshape(height, -1)], axis=1)
    head = struct.pack(">2I5B", width, height, 8, 6, 0, 0, 0)
    body = _chunk(b"IHDR", head) + _chunk(b"IDAT", zlib.compress(rows.tobytes(), 9))
    return b"\x89PNG\r\n\x1a\n" + body + _chunk(b"IEND", b"")


def _chunk(kind: bytes, content: bytes) -> bytes:
    check = zlib.crc32(kind + content)
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)
