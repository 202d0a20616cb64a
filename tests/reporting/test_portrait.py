"""The robot in the report."""

from __future__ import annotations

import base64
import re
import struct
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.reporting.portrait import HEIGHT, _arrow, _label, portrait
from testbed.robot.model_file import ModelFile
from testbed.robot.visuals.appearance import Appearance, load_appearance
from tests.helpers.paths import GOLDEN, ROOT

ROBOTS = [ROOT / "models/puma562.xml", *sorted((GOLDEN / "robots").glob("*.urdf"))[::4]]
WRENCH = np.array([30.0, -40.0, 300.0, 3.0, -4.0, 12.0])


def parsed(svg: str) -> ET.Element:
    return ET.fromstring(svg)


def texts(svg: str) -> list[str]:
    return [each.text or "" for each in parsed(svg).iter("{http://www.w3.org/2000/svg}text")]


def box(svg: str) -> list[float]:
    return [float(word) for word in parsed(svg).attrib["viewBox"].split()]


@pytest.mark.parametrize("path", ROBOTS, ids=lambda p: p.stem)
def test_every_robot_has_a_portrait_that_fits_its_frame(path: Path) -> None:
    tree = tb.load_tree(path)
    rng = np.random.default_rng(0)
    motion = rng.uniform(-0.5, 0.5, (40, tree.n))
    svg = portrait(load_appearance(tree, ModelFile(path)), motion, WRENCH, tree.name)
    left, top, width, height = box(svg)
    root = parsed(svg)
    numbers = []
    for line in root.iter("{http://www.w3.org/2000/svg}polyline"):
        numbers += [tuple(map(float, word.split(","))) for word in line.attrib["points"].split()]
    for line in root.iter("{http://www.w3.org/2000/svg}line"):
        numbers += [
            tuple(float(line.attrib[k]) for k in pair) for pair in (("x1", "y1"), ("x2", "y2"))
        ]
    x, y = np.array(numbers).T
    assert left <= x.min()
    assert x.max() <= left + width
    assert top <= y.min()
    assert y.max() <= top + height
    (image,) = root.iter("{http://www.w3.org/2000/svg}image")
    data = base64.b64decode(image.attrib["href"].removeprefix("data:image/png;base64,"))
    size = struct.unpack(">2I", data[16:24])
    assert size == (int(image.attrib["width"]), int(image.attrib["height"]))
    assert max(size) == 640
    assert root.attrib["aria-label"] == tree.name


def test_force_and_moment_say_how_large_they_are(puma: tb.Tree) -> None:
    svg = portrait(load_appearance(puma), np.zeros((1, 3)), WRENCH, "puma")
    assert texts(svg)[-2:] == ["304 N", "13 N m"]
    assert "var(--force)" in svg
    assert "var(--moment)" in svg


def test_without_a_plate_there_are_no_arrows(puma: tb.Tree) -> None:
    svg = portrait(load_appearance(puma), np.zeros((1, 3)), None, "puma")
    assert texts(svg) == ["x", "y", "z"]
    still = portrait(load_appearance(puma), np.zeros((1, 3)), np.zeros(6), "puma")
    assert texts(still) == ["x", "y", "z"]


def test_labels_of_arrows_are_within_the_picture(puma: tb.Tree) -> None:
    for sign in (-1, 1):
        svg = portrait(load_appearance(puma), np.zeros((1, 3)), sign * 1e5 * WRENCH, "puma")
        left, _, width, _ = box(svg)
        for text in parsed(svg).iter("{http://www.w3.org/2000/svg}text"):
            size = 11.0 * len(text.text or "")
            start = {"start": 0.0, "middle": -size / 2, "end": -size}[text.attrib["text-anchor"]]
            x = float(text.attrib["x"]) + start
            assert left <= x
            assert x + size <= left + width


def test_the_same_bits_every_time(puma: tb.Tree) -> None:
    motion = np.linspace(0, 1, 30).reshape(10, 3)
    first, second = (portrait(load_appearance(puma), motion, WRENCH, "puma") for _ in range(2))
    assert first == second


def test_a_name_cannot_become_markup(puma: tb.Tree) -> None:
    svg = portrait(load_appearance(puma), np.zeros((1, 3)), None, '"><script>')
    assert "<script" not in svg
    assert parsed(svg).attrib["aria-label"] == '"><script>'


def test_the_picture_shows_the_robot_where_it_stands() -> None:
    """A box to the right, seen from the front: its pixels are right of the frame's origin."""
    from testbed.robot.visuals.shapes import Shape

    tree = tb.load_tree(ROOT / "models/puma562.xml")
    grey = np.array([0.5, 0.5, 0.5, 1.0])
    made = Shape(-1, "box", np.full(3, 0.1), np.array([2.0, 0, 0]), np.eye(3), grey)
    svg = portrait(Appearance(tree, (made,)), np.zeros((1, 3)), None, "box")
    (x,) = re.findall(r'<line x1="([\d.-]+)"', svg)[:1]
    assert float(x) < 200  # the origin is to the left of a picture 640 wide


@pytest.mark.parametrize("angle", np.linspace(0, 2 * np.pi, 9)[:-1])
def test_an_arrow_has_a_head_as_wide_as_it_is_thick_and_its_label_ahead(angle: float) -> None:
    """The head is a triangle on the line, alike to both sides."""
    along = np.array([np.cos(angle), np.sin(angle)])
    ends = np.zeros((2, 3))
    ends[0, :2], ends[1, :2] = (200.0, 150.0), np.array([200.0, 150.0]) + 90 * along
    edge, line, head = parsed(f"<svg>{_arrow(ends, 'red', 4.0)}</svg>")
    label = parsed(_label(ends, "3 < 4 N", []).svg())
    assert {k: edge.attrib[k] for k in ("x1", "y1", "x2", "y2")} == {
        k: line.attrib[k] for k in ("x1", "y1", "x2", "y2")
    }
    assert float(edge.attrib["stroke-width"]) > float(line.attrib["stroke-width"])
    corners = np.array([word.split(",") for word in head.attrib["points"].split()], dtype=float)
    np.testing.assert_allclose(corners[0], ends[1, :2], atol=0.06)
    size = 3 * 4.0 + 2
    across = corners[1] - corners[2]
    assert np.linalg.norm(across) == pytest.approx(size, abs=0.2)
    assert abs(across @ along) < 0.2
    base = (corners[1] + corners[2]) / 2
    np.testing.assert_allclose(base, ends[1, :2] - 1.6 * size * along, atol=0.2)
    begins = [float(line.attrib[k]) for k in ("x1", "y1")]
    np.testing.assert_allclose(begins, ends[0, :2], atol=0.06)
    np.testing.assert_allclose([float(line.attrib[k]) for k in ("x2", "y2")], base, atol=0.2)
    place = np.array([float(label.attrib[k]) for k in "xy"])
    assert label.text == "3 < 4 N"
    assert (place - ends[1, :2]) @ along > 0.0


@pytest.mark.parametrize("turn", range(8))
def test_no_label_lies_over_another(turn: int, puma: tb.Tree) -> None:
    """Force along an axis of the frame, or between two."""
    angle = turn * np.pi / 4
    force = 300 * np.array([np.cos(angle), 0.0, np.sin(angle)])
    svg = portrait(load_appearance(puma), np.zeros((1, 3)), np.tile(force, 2), "puma")
    labels = parsed(svg).findall("{http://www.w3.org/2000/svg}text")
    boxes = [(float(t.attrib["x"]), float(t.attrib["y"]), 11 * len(t.text or "")) for t in labels]
    for i, (x, y, width) in enumerate(boxes):
        for other_x, other_y, other_width in boxes[:i]:
            beside = abs(x - other_x) >= (width + other_width) / 2 - 0.2
            assert beside or abs(y - other_y) >= HEIGHT - 0.2
