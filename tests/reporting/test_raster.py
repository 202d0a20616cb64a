"""Pictures without a graphics card."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from testbed.reporting.raster import paint, png

RED, BLUE = [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]


def triangle(*corners: tuple[float, float, float]) -> np.ndarray:
    return np.array([corners], dtype=float)


@pytest.mark.parametrize("seed", range(6))
def test_what_is_covered_is_the_triangles_area(seed: int) -> None:
    corners = np.random.default_rng(seed).uniform(5, 95, (1, 3, 3))
    picture = paint(corners, np.array([RED]), 100, 100)
    (ax, ay), (bx, by) = corners[0, 1:, :2] - corners[0, 0, :2]
    edges = np.linalg.norm(corners[0] - corners[0, [1, 2, 0]], axis=1).sum()
    assert picture[..., 3].sum() / 255 == pytest.approx(abs(ax * by - ay * bx) / 2, abs=edges / 8)
    covered = picture[..., 3] > 0
    assert (picture[covered][:, :3] == [255, 0, 0]).all()


def test_every_pixel_inside_and_none_outside() -> None:
    """Edges through pixels are soft; the rest is known from half planes."""
    corners = triangle((10.0, 10.0, 0), (80.0, 25.0, 0), (30.0, 90.0, 0))
    alpha = paint(corners, np.array([RED]), 100, 100)[..., 3]
    x, y = np.meshgrid(np.arange(100) + 0.5, np.arange(100) + 0.5)
    distances = []
    for k in range(3):
        (x0, y0), (x1, y1) = corners[0, k, :2], corners[0, (k + 1) % 3, :2]
        across = (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
        distances.append(across / np.hypot(x1 - x0, y1 - y0))
    inside = np.min(distances, axis=0)
    assert (alpha[inside > 0.75] == 255).all()
    assert (alpha[inside < -0.75] == 0).all()


def test_two_triangles_of_a_square_leave_no_seam() -> None:
    a, b, c, d = (10.0, 10.0, 0.0), (60.0, 10.0, 0.0), (60.0, 60.0, 0.0), (10.0, 60.0, 0.0)
    both = np.concatenate([triangle(a, b, c), triangle(a, c, d)])
    alpha = paint(both, np.array([RED, RED]), 70, 70)[..., 3]
    assert (alpha[10:60, 10:60] == 255).all()
    assert alpha.sum() == 255 * 50 * 50


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_what_is_nearer_hides_what_is_behind(order: list[int]) -> None:
    """Two that cross: each in front on its own side, whichever comes first."""
    left_near = triangle((0.0, 0.0, 1.0), (100.0, 0.0, 9.0), (50.0, 100.0, 5.0))
    right_near = triangle((0.0, 0.0, 9.0), (100.0, 0.0, 1.0), (50.0, 100.0, 5.0))
    corners = np.concatenate([left_near, right_near])[order]
    picture = paint(corners, np.array([RED, BLUE])[order], 100, 100)
    assert picture[10, 20, :3].tolist() == [255, 0, 0]
    assert picture[10, 80, :3].tolist() == [0, 0, 255]


def test_what_is_outside_the_picture_does_no_harm() -> None:
    corners = triangle((-500.0, -500.0, 0), (1500.0, -400.0, 0), (20.0, 2000.0, 0))
    picture = paint(corners, np.array([BLUE]), 40, 30)
    assert picture.shape == (30, 40, 4)
    assert (picture == [0, 0, 255, 255]).all()
    away = paint(corners + np.array([5000.0, 0, 0]), np.array([BLUE]), 40, 30)
    assert not away.any()


def test_triangles_without_area_are_nothing() -> None:
    corners = np.concatenate(
        [triangle((5, 5, 0), (5, 5, 0), (5, 5, 0)), triangle((1, 1, 0), (9, 9, 1), (5, 5, 9))]
    )
    assert paint(corners, np.array([RED, RED]), 10, 10)[..., 3].sum() == 0


def test_png_holds_the_picture() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (7, 5, 4)).astype(np.uint8)
    data = png(picture)
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    chunks, place = {}, 8
    while place < len(data):
        (size,) = struct.unpack(">I", data[place : place + 4])
        kind, content = data[place + 4 : place + 8], data[place + 8 : place + 8 + size]
        (check,) = struct.unpack(">I", data[place + 8 + size : place + 12 + size])
        assert check == zlib.crc32(kind + content)
        chunks[kind] = content
        place += 12 + size
    assert struct.unpack(">2I5B", chunks[b"IHDR"]) == (5, 7, 8, 6, 0, 0, 0)
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), dtype=np.uint8).reshape(7, 21)
    assert not rows[:, 0].any()
    np.testing.assert_array_equal(rows[:, 1:].reshape(7, 5, 4), picture)
    assert b"IEND" in chunks
