"""Figures as a person sees them: readable at every size, and of what they are said to be of."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import welch

import testbed as tb
from testbed.view.drawing import draw, svg
from testbed.view.figures import Panel, named_panels
from testbed.view.plot import MAX_PARAMETERS, ErrorDots, run_error_dots
from testbed.view.signals import MAX_SEGMENT_SAMPLES, rms_within, spectrum
from tests.helpers.pages import HOSTILE, run_named
from tests.helpers.strategies import few, rngs

SVG = "{http://www.w3.org/2000/svg}"
SIZES = st.floats(-9, 9).map(lambda power: float(10**power))


def texts(drawing: str) -> list[str]:
    return [each.text or "" for each in ET.fromstring(drawing).iter(f"{SVG}text")]


@pytest.mark.slow
@given(SIZES, rngs, st.sampled_from(["zero", "far", "positive", "still", "log", "nothing"]))
@few(20)
def test_axes_can_be_read(size: float, rng: np.random.Generator, kind: str) -> None:
    """Different labels at two ticks at least; names as they are; colours of the page."""
    x, noise = np.linspace(0.3, 512.0, 300), rng.normal(size=300)
    y = {"zero": size * noise, "far": size * (noise + 500), "positive": size * (1 + noise**2),
         "log": size / x**3}.get(kind, 0 * x)  # fmt: skip
    panel = Panel(HOSTILE, {"measured": (x, y)}, "time [s]", kind in ("log", "nothing"))
    assert {HOSTILE, "time [s]"} <= set(texts(svg(panel)))
    assert "#" not in re.sub(r"&#?\w+;|(url\(|href=\")#", "", svg(panel))
    (axis,) = draw(panel).axes
    for each in (axis.xaxis, axis.yaxis):
        low, high = sorted(each.get_view_interval())
        ticks = zip(each.get_majorticklocs(), each.get_ticklabels(), strict=True)
        labels = [label.get_text() for at, label in ticks if low <= at <= high]
        assert len(set(labels)) == len(labels) >= 2


def test_curves_that_agree_are_all_seen() -> None:
    """The same curve by every name: later ones lie on top, and leave some of the others."""
    x, names = np.linspace(1.0, 100.0, 600), ("measured", "wrench", "torque")
    panel = Panel("a [N]", dict.fromkeys(reversed(names), (x, np.sin(x / 9))), "time [s]")
    (axis,) = draw(panel).axes
    lines = sorted(axis.get_lines(), key=lambda line: line.get_zorder())
    assert [line.get_label() for line in lines] == list(names)
    widths = [line.get_linewidth() for line in lines]
    assert min(-np.diff(widths)) > 1.0  # points: half of it on either side


@given(st.integers(1, 80), rngs)
@few(5)
def test_values_by_name_are_all_drawn_on_one_scale(count: int, rng: np.random.Generator) -> None:
    names = tuple(f"K{k}yy" for k in range(count))
    external, internal = 10 ** rng.uniform(-9, 2, (2, count))
    values = {"wrench": external, "torque": internal}
    panels = named_panels("sigma", names, values, "part [%]", log=True)
    assert [name for panel in panels for name in panel.names] == list(names)
    (limits,) = {panel.limits for panel in panels}
    assert limits is not None
    for kind, wanted in values.items():
        drawn = np.concatenate([panel.curves[kind][0] for panel in panels])
        np.testing.assert_array_equal(drawn, wanted)
        assert limits[0] <= drawn.min() <= drawn.max() <= limits[1]
    dots, bars = ErrorDots(names, {"wrench": external}, {"wrench": internal}).dots_and_bars
    np.testing.assert_array_equal(dots["wrench"], external)
    np.testing.assert_array_equal(bars["wrench"], (np.full(count, limits[0]), internal))
    assert [name for panel in panels for name in texts(svg(panel)) if name in names] == list(names)


@pytest.mark.slow
def test_dots_are_errors_and_bars_are_sigmas() -> None:
    """In percent of the truth; where no truth is known dots are sigmas of the values."""
    run = run_named("ur5")
    dots, blind = run_error_dots(run), run_error_dots(replace(run, score=None))
    assert 0 < len(dots.names) <= MAX_PARAMETERS
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
    assert tb.plot(run.estimates["wrench"])._repr_png_().startswith(b"\x89PNG")


@given(
    rngs, st.sampled_from([300, MAX_SEGMENT_SAMPLES, 40 * MAX_SEGMENT_SAMPLES]), st.floats(50, 1000)
)
@few(10)
def test_power_is_neither_lost_nor_found(rng: np.random.Generator, count: int, rate: float) -> None:
    """Parseval's law; a tone stands at its frequency with its power; a mean counts nowhere."""
    noise = 3.0 * rng.normal(size=count)
    frequency, density = spectrum(noise + 50.0, rate)
    scipy = welch(noise, rate, nperseg=min(count, MAX_SEGMENT_SAMPLES))
    np.testing.assert_allclose([frequency, density**2], np.array(scipy)[:, 1:], atol=1e-12)
    total = rms_within(frequency, density, 0.0, np.inf)
    assert total == pytest.approx(noise.std(), rel=0.3 if count == 300 else 0.06)
    low, high = (rms_within(frequency, density, *band) for band in ((0, 7.0), (7.0, np.inf)))
    assert np.hypot(low, high) == pytest.approx(total, rel=1e-12)
    tone = rng.uniform(0.2, 0.3) * rate
    frequency, density = spectrum(4.0 * np.sin(2 * np.pi * tone * np.arange(9000) / rate), rate)
    assert frequency[density.argmax()] == pytest.approx(tone, abs=rate / MAX_SEGMENT_SAMPLES)
    assert rms_within(frequency, density, 0.9 * tone, 1.1 * tone) == pytest.approx(8**0.5, rel=0.01)
    assert rms_within(*spectrum(np.array([1.0, -1.0, 1.0]), 10.0), 0.0, np.inf) == 0.0
