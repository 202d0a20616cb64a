"""Figures as a person sees them: readable at every size, and of what they are said to be of.

If one fails, people read another number than was found.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.font_manager import FontProperties
from matplotlib.image import imread
from matplotlib.textpath import TextPath
from scipy.signal import welch

import testbed as tb
from testbed.bodies.shapes.appearance import Appearance, load_appearance
from testbed.view.figures import Panel, named_panels, power_of_ten, tick_label
from testbed.view.plot import MOST, ErrorDots, dot_panels, dots_of_run
from testbed.view.portrait import HEIGHT, LETTER, paint, png, portrait
from testbed.view.signals import SEGMENT, rms_within, spectrum
from tests.helpers.pages import HOSTILE, run_named
from tests.helpers.shapes import ball
from tests.helpers.strategies import few, rngs, seeds, trees

SVG = "{http://www.w3.org/2000/svg}"
SIZES = st.floats(-9, 9).map(lambda power: float(10**power))


def texts(svg: str) -> list[str]:
    return [each.text or "" for each in ET.fromstring(svg).iter(f"{SVG}text")]


@pytest.mark.slow
@given(SIZES, rngs, st.sampled_from(["zero", "far", "positive", "still", "log", "nothing"]))
def test_axes_can_be_read(size: float, rng: np.random.Generator, kind: str) -> None:
    """Different labels at two ticks at least, with room for their signs; names as they are."""
    x, noise = np.linspace(0.3, 512.0, 300), rng.normal(size=300)
    y = {"zero": size * noise, "far": size * (noise + 500), "positive": size * (1 + noise**2),
         "log": size / x**3}.get(kind, 0 * x)  # fmt: skip
    svg = Panel(HOSTILE, {"measured": (x, y)}, "time [s]", kind in ("log", "nothing")).svg
    assert HOSTILE in texts(svg)
    assert not [text for text in texts(svg) if "math" in text]
    root = ET.fromstring(svg)
    font = FontProperties(family="DejaVu Sans", size=9)
    for axis in "xy":
        ticks = [each for each in root.iter(f"{SVG}text") if each.get("class") == axis]
        labels = [each.text or "" for each in ticks]
        assert len(set(labels)) == len(labels) >= 2
    edges = [float(each.attrib["x"]) for each in ticks]  # of the vertical axis: where they end
    wide = [TextPath((0, 0), text, prop=font).get_extents().width for text in labels]
    assert min(edge - width for edge, width in zip(edges, wide, strict=True)) > 0


@given(st.integers(-12, 12), st.floats(-1e8, 1e8))
def test_ticks_are_read_as_they_are_written(power: int, value: float) -> None:
    signs = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")
    said = power_of_ten(10.0**power).translate(signs)
    assert len(said) <= 5
    read = float(said) if abs(power) <= 3 else 10.0 ** int(said.removeprefix("10"))
    assert read == pytest.approx(10.0**power)
    number, _, ten = tick_label(value).translate(signs).partition("·10")
    assert float(number) * 10.0 ** int(ten or 0) == pytest.approx(value, rel=1e-5)


def test_curves_that_agree_are_all_seen() -> None:
    """The same curve by every name: of none, the others leave nothing; in colours of the page."""
    x, names = np.linspace(1.0, 100.0, 600), ("measured", "external", "internal")
    panel = Panel("a [N]", dict.fromkeys(reversed(names), (x, np.sin(x / 9))), "time [s]")
    lines = [each.attrib for each in ET.fromstring(panel.svg).iter(f"{SVG}path")][-len(names) :]
    assert [line["stroke"] for line in lines] == [f"var(--{name})" for name in names]
    assert len({line["d"] for line in lines}) == 1
    widths = [float(line["stroke-width"]) for line in lines]
    assert min(-np.diff(widths)) > 1.0  # points: half of it on either side


@given(st.integers(1, 80), rngs)
@few(5)
def test_values_by_name_are_all_drawn_on_one_scale(count: int, rng: np.random.Generator) -> None:
    names = tuple(f"K{k}yy" for k in range(count))
    external, internal = 10 ** rng.uniform(-9, 2, (2, count))
    values = {"external": external, "internal": internal}
    panels = named_panels("sigma", names, values, "part [%]", log=True)
    assert [name for panel in panels for name in panel.names] == list(names)
    (limits,) = {panel.limits for panel in panels}
    assert limits is not None
    for kind, wanted in values.items():
        drawn = np.concatenate([panel.curves[kind][0] for panel in panels])
        np.testing.assert_array_equal(drawn, wanted)
        assert limits[0] <= drawn.min() <= drawn.max() <= limits[1]
    dots = ErrorDots(names, {"external": external}, {"external": internal})
    assert dots.range == limits
    drawings = "".join(panel.svg for panel in dot_panels(dots))
    assert [name for name in names if f">{name}<" not in drawings] == []


@pytest.mark.slow
def test_dots_are_errors_and_bars_are_sigmas() -> None:
    """In percent of the truth; where no truth is known dots are sigmas of the values."""
    run = run_named("ur5")
    dots, blind = dots_of_run(run), dots_of_run(replace(run, score=None))
    assert 0 < len(dots.names) <= MOST
    assert not blind.sigmas
    for method, estimate in run.estimates.items():
        for k, name in enumerate(estimate.names):
            at, error = dots.names.index(name), abs(estimate.values[k] - run.truths[name])
            ratio = dots.errors[method][at] / dots.sigmas[method][at]
            assert ratio == pytest.approx(error / estimate.sigma[k])
            if abs(run.truths[name]) > 0.1 * np.abs(estimate.values).max():
                assert dots.errors[method][at] == pytest.approx(100 * error / abs(run.truths[name]))
            known = blind.errors[method][blind.names.index(name)]
            assert known == pytest.approx(100 * estimate.sigma[k] / abs(estimate.values[k]))
    labels = [text.get_text() for text in tb.plot(run).axes[0].get_yticklabels()]
    assert labels == list(dots.names)
    assert tb.plot(run.estimates["external"])._repr_png_().startswith(b"\x89PNG")


@given(rngs, st.sampled_from([300, SEGMENT, 40 * SEGMENT]), st.floats(50, 1000))
@few(10)
def test_power_is_neither_lost_nor_found(rng: np.random.Generator, count: int, rate: float) -> None:
    """Parseval's law; a tone stands at its frequency with its power; a mean counts nowhere."""
    noise = 3.0 * rng.normal(size=count)
    frequency, density = spectrum(noise + 50.0, rate)
    scipy = welch(noise, rate, nperseg=min(count, SEGMENT))
    np.testing.assert_allclose([frequency, density**2], np.array(scipy)[:, 1:], atol=1e-12)
    total = rms_within(frequency, density, 0.0, np.inf)
    assert total == pytest.approx(noise.std(), rel=0.3 if count == 300 else 0.06)
    low, high = (rms_within(frequency, density, *band) for band in ((0, 7.0), (7.0, np.inf)))
    assert np.hypot(low, high) == pytest.approx(total, rel=1e-12)
    tone = rng.uniform(0.2, 0.3) * rate
    frequency, density = spectrum(4.0 * np.sin(2 * np.pi * tone * np.arange(9000) / rate), rate)
    assert frequency[density.argmax()] == pytest.approx(tone, abs=rate / SEGMENT)
    assert rms_within(frequency, density, 0.9 * tone, 1.1 * tone) == pytest.approx(8**0.5, rel=0.01)
    assert rms_within(*spectrum(np.array([1.0, -1.0, 1.0]), 10.0), 0.0, np.inf) == 0.0


@given(rngs)
@few(8)
def test_what_is_painted_is_the_nearest_triangle(rng: np.random.Generator) -> None:
    """Every pixel inside and none outside, whatever is beside the picture or without area."""
    corners = rng.uniform(-40, 140, (4, 3, 3))
    flat = np.tile(rng.uniform(0, 100, (1, 1, 3)), (1, 3, 1))
    colours = np.eye(5)[:, :3] * [[1, 1, 1]]
    colours[3:] = [[1, 1, 0], [0, 1, 1]]
    picture = paint(np.concatenate([corners, flat]), colours, 100, 90)
    assert picture.shape == (90, 100, 4)
    at = np.stack(np.meshgrid(np.arange(100) + 0.5, np.arange(90) + 0.5), axis=-1)
    depth, sure = np.full((4, 90, 100), 1e9), np.ones((90, 100), dtype=bool)
    steepest = 0.0
    for k, triangle in enumerate(corners):
        edges = np.vstack([triangle[:, :2].T, np.ones(3)])
        share = np.linalg.solve(edges, np.dstack([at, np.ones((90, 100))]).reshape(-1, 3).T)
        slopes = np.linalg.inv(edges)[:, :2]  # a pixel is of finer ones, whose depths differ
        steepest = max(steepest, np.abs(triangle[:, 2] @ slopes).sum())
        reach = np.linalg.norm(slopes, axis=1)[:, None]
        away = (share / reach).min(axis=0).reshape(90, 100)  # pixels from the edge, inwards
        depth[k][away > 0] = (triangle[:, 2] @ share).reshape(90, 100)[away > 0]
        sure &= np.abs(away) > 0.8
    order = np.sort(depth, axis=0)
    inside = sure & (order[0] < 1e9) & (order[1] - order[0] > steepest)
    assert not picture[sure & (order[0] == 1e9)].any()
    wanted = 255 * colours[depth.argmin(axis=0)]
    np.testing.assert_array_equal(picture[inside][:, :3], wanted[inside])
    assert (picture[inside][:, 3] == 255).all()


@given(rngs)
@few(5)
def test_a_png_holds_its_picture(rng: np.random.Generator) -> None:
    picture = rng.integers(0, 256, (7, 5, 4)).astype(np.uint8)
    read = imread(BytesIO(png(picture)), format="png")  # Pillow checks the sums of all chunks
    np.testing.assert_array_equal(np.round(255 * read), picture)


@pytest.mark.slow
@given(trees((1, 6)), seeds, st.floats(-3, 6))
@few(4)
def test_a_portrait_has_everything_within_its_frame(tree: tb.Tree, seed: int, power: float) -> None:
    """Robot, paths, arrows as long as forces are said to be, and no label over another."""
    rng = np.random.default_rng(seed)
    wrench = 10**power * rng.normal(size=6)
    motion = rng.uniform(-0.5, 0.5, (30, tree.n))
    svg = portrait(load_appearance(tree), motion, wrench, HOSTILE)
    root = ET.fromstring(svg)
    assert root.attrib["aria-label"] == HOSTILE
    left, top, width, height = map(float, root.attrib["viewBox"].split())
    numbers = [[float(x) for x in pair.split(",")] for line in root.iter()
               for pair in line.attrib.get("points", "").split()]  # fmt: skip
    for line in root.iter(f"{SVG}line"):
        numbers += [[float(line.attrib[f"{c}{k}"]) for c in "xy"] for k in (1, 2)]
    boxes = [(float(t.attrib["x"]), float(t.attrib["y"]), LETTER * len(t.text or ""))
             for t in root.iter(f"{SVG}text")]  # fmt: skip
    numbers += [[x + side * w / 2, y] for x, y, w in boxes for side in (-1, 1)]
    low, high = np.min(numbers, axis=0), np.max(numbers, axis=0)
    assert (low >= [left, top]).all()
    assert (high <= [left + width, top + height]).all()
    for k, (x, y, w) in enumerate(boxes):
        for other in boxes[:k]:
            beside = abs(x - other[0]) >= (w + other[2]) / 2 - 0.2
            assert beside or abs(y - other[1]) >= HEIGHT - 0.2
    said = [float(text.split()[0]) for text in texts(svg)[-2:]]
    assert said == pytest.approx([np.linalg.norm(wrench[:3]), np.linalg.norm(wrench[3:])], rel=6e-3)


def test_the_portrait_shows_the_robot_where_it_stands(puma: tb.Tree) -> None:
    """A ball to the right, from the front and above: right of the origin; pixels count down."""
    look = Appearance(puma, (ball(-1, 0.1, np.array([2.0, 0, 0])),))
    svg = portrait(look, np.zeros((1, 3)), None, "ball")
    ends = re.findall(r'<line x1="(\S+)" y1="(\S+)" x2="(\S+)" y2="(\S+)"', svg)
    assert float(ends[0][0]) < 200
    for axis in ends[2:]:  # z is up, and so is y, which leads away
        assert float(axis[3]) < float(axis[1])
