"""Figures as a person sees them: plots that fill their panels, ticks that can be read."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

from testbed.arrays import Array
from testbed.reporting.figures import (
    COLOURS,
    HEIGHT,
    WIDTH,
    Panel,
    power_of_ten,
    thinned,
    tick_label,
)
from testbed.reporting.named_panels import named_panels

pytestmark = pytest.mark.slow

SVG = "{http://www.w3.org/2000/svg}"
TICK = 7.0  # a tick and the gap to its label [pt]
SIZES = [1e-9, 1e-5, 3e-3, 1.0, 47.0, 2e4, 6e8]


def panels(size: float) -> list[Panel]:
    """Plots of all kinds of curves of this size, or about it."""
    rng = np.random.default_rng(0)
    x = np.linspace(0.3, 512.0, 400)
    noise = rng.normal(size=400)
    curves: dict[str, Array] = {
        "about zero": size * noise,
        "far from zero": size * (noise + 500),
        "positive": size * (1 + noise**2),
        "still": np.zeros(400),
    }
    even = [Panel(name, {"measured": (x, y)}, "time [s]") for name, y in curves.items()]
    steep = {"external": (x, size / x**3), "internal": (x, size * (1 + noise**2))}
    return [*even, Panel("spectra", steep, "frequency [Hz]", log=True)]


def texts(svg: str) -> list[str]:
    return [each.text or "" for each in ET.fromstring(svg).iter(f"{SVG}text")]


@pytest.mark.parametrize("size", SIZES)
def test_no_text_is_the_source_of_a_formula(size: float) -> None:
    for panel in panels(size):
        assert not [text for text in texts(panel.svg) if "$" in text or "math" in text]


@pytest.mark.parametrize("size", SIZES)
def test_plots_fill_their_panels(size: float) -> None:
    for panel in panels(size):
        root = ET.fromstring(panel.svg)
        _, _, width, height = map(float, root.attrib["viewBox"].split())
        assert (width, height) == pytest.approx((72 * WIDTH, 72 * HEIGHT))
        (axes,) = (g for g in root.iter(f"{SVG}g") if g.get("class") == "axes_1")
        (patch,) = (g for g in axes if g.get("class") == "patch_2")
        numbers = np.array(re.findall(r"[-\d.]+", patch[0].attrib["d"]), dtype=float).reshape(-1, 2)
        share = np.ptp(numbers, axis=0) / [width, height]
        assert (share >= 0.6).all()


@pytest.mark.parametrize("size", [*SIZES, 7e-4, 2e-4, 12345.0])
def test_the_labels_of_ticks_have_room_with_their_signs(size: float) -> None:
    """Left of the axis, inside the panel: -0.0005 is never seen as 0.0005."""
    for panel in panels(size):
        root = ET.fromstring(panel.svg)
        (axes,) = (g for g in root.iter(f"{SVG}g") if g.get("class") == "axes_1")
        (patch,) = (g for g in axes if g.get("class") == "patch_2")
        start = min(map(float, re.findall(r"[ML] ([\d.]+)", patch[0].attrib["d"])))
        ticks = [g for g in root.iter(f"{SVG}g") if (g.get("class") or "").startswith("ytick")]
        labels = [text.text or "" for g in ticks for text in g.iter(f"{SVG}text")]
        font = FontProperties(family="DejaVu Sans", size=9)
        longest = max(TextPath((0, 0), text, prop=font).get_extents().width for text in labels)
        assert longest + TICK < start


@pytest.mark.parametrize("size", SIZES)
def test_every_axis_has_ticks_that_tell_its_scale(size: float) -> None:
    """Two different labels at least on each axis; never one label for two ticks."""
    for panel in panels(size):
        root = ET.fromstring(panel.svg)
        for axis in ("xtick", "ytick"):
            ticks = [g for g in root.iter(f"{SVG}g") if (g.get("class") or "").startswith(axis)]
            labels = [text.text for g in ticks for text in g.iter(f"{SVG}text")]
            assert len(set(labels)) == len(labels)
            assert len(labels) >= 2


@pytest.mark.parametrize("power", range(-12, 13))
def test_powers_of_ten_are_read_as_they_are_written(power: int) -> None:
    text = power_of_ten(10.0**power)
    digits = text.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    value = 10.0 ** int(digits[2:]) if digits != text else float(text)
    assert value == pytest.approx(10.0**power)
    assert len(text) <= 5


@pytest.mark.parametrize(
    ("value", "label"),
    [(0.0, "0"), (-150.0, "−150"), (0.02, "0.02"), (2e-5, "2·10⁻⁵"), (-5e7, "−5·10⁷")],
)
def test_ticks_of_even_axes(value: float, label: str) -> None:
    assert tick_label(value) == label


def test_dollars_in_names_are_dollars() -> None:
    x = np.linspace(0, 1, 10)
    svg = Panel("a$\\foo_{$ [N]", {"measured": (x, x)}, "time [s]").svg
    assert "a$\\foo_{$ [N]" in texts(svg)


def test_colours_are_the_pages_and_ids_are_not_doubled() -> None:
    x = np.linspace(0, 1, 10)
    svg = Panel("a", {"measured": (x, x), "external": (x, -x)}, "t").svg
    for variable in ("ink", "faint", "measured", "external"):
        assert f"var(--{variable})" in svg
    assert not re.search(r"#0102", svg)
    other = Panel("b", {"measured": (x, x)}, "t").svg
    ids = [set(re.findall(r' id="([^"]+)"', each)) for each in (svg, other)]
    assert not ids[0] & ids[1]


@pytest.mark.parametrize("kind", ["line", "noise", "spectrum"])
def test_curves_that_agree_are_all_seen(kind: str) -> None:
    """The same curve by every name: of none, the others leave nothing."""
    x = np.linspace(1.0, 100.0, 600)
    noise = np.random.default_rng(0).normal(size=600)
    y = {"line": np.sin(x / 9), "noise": noise, "spectrum": np.exp(noise / 4) / x}[kind]
    names = ("measured", "external", "internal")
    curves = dict.fromkeys(reversed(names), (x, y))
    figure = Panel("a [N]", curves, "time [s]", log=kind == "spectrum").drawn()
    for line in figure.axes[0].lines:
        line.set_antialiased(False)
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3].reshape(-1, 3)
    count = [np.sum((pixels == np.array(to_rgb(COLOURS[n])) * 255).all(axis=1)) for n in names]
    assert min(count) > 0.08 * sum(count)


def test_values_by_name_have_all_their_names_and_one_scale() -> None:
    names = [f"K{k}yy" for k in range(41)]
    values = {kind: 10 ** np.random.default_rng(k).uniform(-3, 1, 41) for k, kind in
              enumerate(("measured", "external"))}  # fmt: skip
    found = named_panels("sigma", names, values, "part of the value [%]", log=True)
    assert [name for panel in found for name in panel.names] == names
    assert len({panel.limits for panel in found}) == 1
    for panel in found:
        assert set(panel.names) <= set(texts(panel.svg))
        for at, _ in panel.curves.values():
            assert panel.limits is not None
            assert panel.limits[0] <= at.min() <= at.max() <= panel.limits[1]
    for kind, wanted in values.items():
        drawn = np.concatenate([panel.curves[kind][0] for panel in found])
        np.testing.assert_array_equal(drawn, wanted)


def test_plots_below_each_other_share_their_time_and_keep_their_units() -> None:
    x = np.linspace(0, 5, 50)
    below = {"velocity [rad/s]": {"external": (x, 2 * x)}}
    figure = Panel("a: position [rad]", {"external": (x, x)}, "time [s]", below=below).drawn()
    upper, lower = figure.axes
    assert upper.get_xlim() == lower.get_xlim()
    assert upper.get_position().x0 == lower.get_position().x0
    assert upper.get_position().y0 > lower.get_position().y1
    assert [axis.get_title(loc="left") for axis in (upper, lower)] == [
        "a: position [rad]", "velocity [rad/s]"
    ]  # fmt: skip
    assert (upper.get_xlabel(), lower.get_xlabel()) == ("", "time [s]")


def test_the_same_bits_every_time() -> None:
    for panel in panels(1.0):
        assert panel.svg == panel.svg


@pytest.mark.parametrize("samples", [1, 1500, 1501, 100_000])
def test_thinned_curves_keep_their_shape(samples: int) -> None:
    x = np.arange(samples, dtype=float)
    a, b = thinned(x, 2 * x)
    assert len(a) <= 1500
    assert a[0] == 0.0
    np.testing.assert_array_equal(b, 2 * a)
    assert np.ptp(np.diff(a)) == 0 if len(a) > 2 else True
    assert a[-1] >= samples - 1 - samples / len(a)


def test_a_spectrum_of_nothing_is_drawn_all_the_same() -> None:
    """Perfect predictions leave zeros, which have no logarithm."""
    x = np.linspace(0.3, 512.0, 40)
    found = Panel("spectra", {"external": (x, np.zeros(40))}, "frequency [Hz]", log=True).svg
    assert "spectra" in texts(found)
