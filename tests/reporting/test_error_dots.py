"""Dots of errors: what is drawn is what the run says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.experiment.run import Run
from testbed.experiment.run_folder import write_recorded, write_result
from testbed.identification.estimate import METHODS
from testbed.identification.influence import by_influence
from testbed.reporting.error_dots import MOST, ErrorDots, dot_panels, dots_of_run, dots_section
from testbed.reporting.named_panels import COLUMNS, MOST_ROWS


@pytest.mark.slow
def test_dots_are_errors_and_bars_are_sigmas(puma_run: Run) -> None:
    dots = dots_of_run(puma_run)
    assert set(dots.errors) == set(dots.sigmas) == set(METHODS)
    for method in METHODS:
        estimate = puma_run.estimates[method]
        for k, name in enumerate(estimate.names):
            at = dots.names.index(name)
            error = abs(estimate.values[k] - puma_run.truths[name])
            ratio = dots.errors[method][at] / dots.sigmas[method][at]
            assert ratio == pytest.approx(error / estimate.sigma[k])
            if abs(puma_run.truths[name]) > 0.1 * abs(estimate.values).max():
                share = 100 * error / abs(puma_run.truths[name])
                assert dots.errors[method][at] == pytest.approx(share)
        absent = [name for name in dots.names if name not in estimate.names]
        assert np.isnan([dots.errors[method][dots.names.index(n)] for n in absent]).all()


@pytest.mark.slow
def test_without_the_truth_there_are_sigmas(puma_run: Run) -> None:
    blind = replace(puma_run, score=None)
    dots = dots_of_run(blind)
    assert not dots.sigmas
    external = puma_run.estimates["external"]
    shares = 100 * external.sigma / np.abs(external.values)
    drawn = [dots.errors["external"][dots.names.index(n)] for n in external.names]
    np.testing.assert_allclose(drawn, shares)
    section = dots_section(blind)
    assert section is not None
    assert "known" in section["title"]
    assert dots_section(replace(blind, estimates={})) is None


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, MOST_ROWS, MOST_ROWS + 1, 41, MOST])
def test_any_number_of_parameters_is_drawn_on_one_scale(count: int) -> None:
    rng = np.random.default_rng(count)
    errors = 10 ** rng.uniform(-9, 2, count)
    errors[0] = 0.0
    names = tuple(f"K{k}yy" for k in range(count))
    dots = ErrorDots(names, {"external": errors}, {"external": errors[::-1]})
    low, high = dots.range
    assert low < high
    assert high >= errors.max()
    panels = dot_panels(dots)
    assert len(panels) == (COLUMNS if count > MOST_ROWS else 1)
    drawn = "".join(panel["svg"] for panel in panels)
    for name in names:
        assert f">{name}<" in drawn


@pytest.mark.slow
def test_what_adds_most_to_the_forces_is_drawn_first(puma_run: Run) -> None:
    """However wrong the others are."""
    names = dots_of_run(puma_run).names
    assert names == tuple(by_influence(puma_run.estimates.values(), puma_run.truths))[:MOST]
    assert puma_run.score is not None
    errors = {
        m: replace(e, relative=np.linspace(1e3, 1e9, len(e.names)))
        for m, e in puma_run.score.errors.items()
    }
    assert (
        dots_of_run(replace(puma_run, score=replace(puma_run.score, errors=errors))).names == names
    )


@pytest.mark.slow
def test_python_has_what_the_commands_have(puma_run: Run, tmp_path: Path) -> None:
    figure = tb.plot(puma_run)
    figure.savefig(tmp_path / "errors.png")
    labels = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert labels == list(dots_of_run(puma_run).names)
    assert figure._repr_png_().startswith(b"\x89PNG")
    alone = tb.plot(puma_run.estimates["external"])
    assert len(alone.axes[0].get_yticklabels()) == len(puma_run.estimates["external"].names)
    page = tb.report(puma_run, tmp_path / "page.html")
    assert json.loads(page.with_suffix(".json").read_text())["title"] == puma_run.name
    assert tb.predict(puma_run).run is puma_run


@pytest.mark.slow
def test_a_folder_does_for_its_run(puma_run: Run, tmp_path: Path) -> None:
    assert puma_run.experiment is not None
    folder = tmp_path / "run"
    write_recorded(puma_run.experiment, puma_run.recording, folder)
    write_result(puma_run, folder)
    page = tb.report(str(folder), tmp_path / "page.html")
    assert puma_run.name in page.read_text()
    with pytest.raises(tb.TestbedError, match="no run"):
        tb.report(tmp_path, tmp_path / "none.html")
    assert not (tmp_path / "none.html").exists()
