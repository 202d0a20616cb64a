"""A campaign in the viewer: bars of scores, points of sigma predicted and obtained, a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from testbed.campaign.campaign_summary import Figure, ParameterErrors, Summary
from testbed.viewer.campaign_log import write_campaign_rrd
from tests.helpers.viewer import columns, entities, tensor, words

SCORES = np.array([-9.0, -3.9, 0.1, 0.1, 0.12, 3.99, 5.0, 4.0])


def errors(parameter: str, cell: int, sigma: float, spread: float) -> ParameterErrors:
    return ParameterErrors(cell, "external", parameter, 8, 1.0, 0, 0, spread, 0, sigma, 7, 0.1)


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    summary = Summary(
        about={"name": "noise", "claim": "sigma tells it"},
        factors=("plate noise",),
        cells={0: (0.5,), 1: (2.0,)},
        runs=16,
        failures=(),
        parameters=(
            errors("m1", 0, 1e-3, 1e-2),
            errors("K3d", 1, 10.0, 0.1),
            errors("exact", 1, 0.0, 0.1),
            errors("alone", 1, 1.0, float("nan")),
        ),
        figures=(Figure(1, "external_rms_relative_error", 8, 0.0123, 0.001),),
        z={"external": {"m1/a": SCORES}},
    )
    path = tmp_path_factory.mktemp("campaign") / "campaign.rrd"
    write_campaign_rrd(summary, path)
    return path


def test_bars_count_scores_those_far_out_in_the_outermost(shown: Path) -> None:
    (place,) = (each for each in entities(shown) if each.startswith("/scores"))
    assert place.startswith("/scores/external/m1")
    counts = tensor(shown, place, "BarChart:values")
    middles = tensor(shown, place, "BarChart:abscissa")
    np.testing.assert_allclose(middles, np.linspace(-3.875, 3.875, 32))
    wanted = np.zeros(32)
    for score in SCORES:
        wanted[min(31, max(0, int((score + 4) / 0.25)))] += 1
    np.testing.assert_array_equal(counts, wanted)


def test_a_point_is_the_power_of_ten_of_both_sigmas_larger_ones_higher(shown: Path) -> None:
    """The viewer's second axis points down; where there is no sigma there is no point."""
    points = columns(shown, "/sigma/external", "Points2D:positions", static=True).reshape(-1, 2)
    np.testing.assert_allclose(points, [[-3.0, 2.0], [1.0, 1.0]], atol=1e-6)
    labels = words(shown, "/sigma/external", "Points2D:labels")
    assert labels == ["m1, cell 0", "K3d, cell 1"]
    assert "/sigma/internal" not in entities(shown)


def test_means_stand_in_a_table(shown: Path) -> None:
    (text,) = words(shown, "/notes", "TextDocument:text")
    lines = text.splitlines()
    assert lines[:2] == ["# noise", "sigma tells it"]
    assert lines[-3:] == [
        "plate noise | figure | runs | mean",
        "--- | --- | --- | ---",
        "2.0 | external_rms_relative_error | 8 | 0.0123",
    ]
