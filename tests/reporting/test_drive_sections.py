"""Drives in the report and in the viewer: constants, friction curves, the plate's matrix."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.experiment.predictions import predict
from testbed.experiment.results import result
from testbed.experiment.run import Run, assemble_run
from testbed.identification.nuisances.estimates import NuisanceEstimate
from testbed.reporting.contents import contents
from testbed.reporting.drive_sections import curve_lines
from testbed.reporting.heat_table import DARKEST
from testbed.reporting.matrix_map import matrix_maps
from testbed.reporting.sections import sections
from testbed.viewer.drive_notes import log_curve, notes_of_drives, notes_of_plate
from testbed.viewer.scene import scene_of
from tests.helpers.measured import measured
from tests.helpers.runs import robot


@pytest.fixture(scope="module", params=["puma", pytest.param("gantry", marks=pytest.mark.slow)])
def run(request: pytest.FixtureRequest) -> Run:
    tree = robot(request.param)
    settings = tb.Settings(drives="given")
    return assemble_run(tree, measured(tree), name="driven", settings=settings)


@pytest.mark.slow
def test_the_report_shows_constants_and_curves(run: Run) -> None:
    assert run.drives is not None
    figures = {each["id"]: each for each in contents(run)["figures"]}
    drives, friction = figures["drives"], figures["friction"]
    assert len(drives["panels"]) == 1 + run.tree.n
    assert "external" in friction["legend"]
    assert [row[0] for row in drives["rows"]] == list(run.tree.names)
    for row, drive in zip(drives["rows"], run.drives.estimates, strict=True):
        assert row[1] == f"{drive.constant:.6g}"


@pytest.mark.slow
def test_a_run_that_was_not_asked_has_no_drives(run: Run) -> None:
    plain = replace(run, drives=None)
    assert "drives" not in {each["id"] for each in contents(plain)["figures"]}
    assert notes_of_drives(plain) == []


def test_curves_have_a_gap_where_the_direction_changes(run: Run) -> None:
    assert run.drives is not None
    for curve in run.drives.curves:
        speed, torque, sigma = curve_lines(curve)
        gap = np.isnan(speed)
        assert gap.sum() == 1
        assert (speed[: gap.argmax()] <= 0).all()
        np.testing.assert_array_equal(np.isnan(torque), gap)
        np.testing.assert_array_equal(np.isnan(sigma), gap)
        np.testing.assert_allclose(curve.at(curve.speed), curve.torque, atol=1e-12)


def test_a_curve_is_thicker_than_the_edges_of_its_band(run: Run) -> None:
    assert run.drives is not None
    logged: dict[str, Any] = {}

    class Stream:
        """Keeps what is logged."""

        def log(self, entity: str, what: Any, *, static: bool) -> None:
            assert static
            logged[entity] = what

    log_curve(Stream(), "joint", run.drives.curves[0], (1.0, 1.0))  # type: ignore[arg-type]
    radii = np.abs(logged["joint/by_plate"].radii.as_arrow_array().to_pylist()).reshape(-1, 3)
    assert len(radii) == len(logged["joint/by_plate"].strips) / 3 > 0
    assert (radii[:, 0] > 2 * radii[:, 1]).all()
    assert (radii[:, 1] == radii[:, 2]).all()


def test_notes_hold_every_joint(run: Run) -> None:
    notes = scene_of(run).notes
    assert "Drives, held against the plate" in notes
    assert all(f"| {name} |" in notes for name in run.tree.names)


def with_matrix(run: Run) -> Run:
    """As if calibration had found 2 % of Fz in Mx, and 1 % too much of Fy."""
    external = run.estimates["external"]
    numbers = (
        NuisanceEstimate("matrix", "gain/Fy", "", 1.01, 1e-3),
        NuisanceEstimate("matrix", "crosstalk/Mx/Fz", "m", 0.02, 1e-4),
    )
    found = replace(external, nuisances=numbers)
    return replace(run, estimates={**run.estimates, "external": found})


def test_the_matrix_is_shown_before_and_after(run: Run) -> None:
    assert matrix_maps(run) == []
    known = with_matrix(run)
    before, after = matrix_maps(known)
    recorded = known.recording.wrench
    assert recorded is not None
    reach = np.abs(recorded).max(axis=0)
    cells = dict(before["rows"])
    assert float(cells["Mx"][2]["text"]) == pytest.approx(2 * reach[2] / reach[3], rel=0.06)
    assert float(cells["Fy"][1]["text"]) == pytest.approx(1.0, rel=0.06)
    assert cells["Fx"][0] == {"text": "0", "share": 0}
    shares = [cell["share"] for _, row in (*before["rows"], *after["rows"]) for cell in row]
    assert max(shares) == DARKEST
    assert "crosstalk/Mx/Fz" in "\n".join(notes_of_plate(known))


@pytest.mark.slow
def test_metrics_of_drives_are_judged(tmp_path: Path) -> None:
    """Short and without noise: constants, friction and curves come out."""
    words = [
        "motion.duration=10", "motion.candidates=2", "simulation.step=1e-3",
        'identification.drives="given"', "measurement.torque_constant_error.waist=0.1",
        "identification.zeros=true",
    ]  # fmt: skip
    path = Path(__file__).parents[2] / "experiments/noise_free.toml"
    run = tb.carry_out(tb.Experiment.load(path, words))
    assert run.drives is not None
    assert run.drives.estimates[0].constant == pytest.approx(1.1, rel=1e-3)
    assert run.metrics["torque_constant_max_error"] < 1e-3
    assert run.metrics["coulomb_max_relative_error"] < 1e-2
    assert run.metrics["friction_curve_rms"] < 0.1
    assert "rotor_max_relative_error" not in run.metrics
    kept = json.loads(json.dumps(result(run)))["drives"]["joints"]["waist"]["torque_constant"]
    assert kept["value"] == run.drives.estimates[0].constant


def test_every_line_of_a_legend_is_drawn_and_every_curve_is_in_one(run: Run) -> None:
    found = sections(predict(run, None), unseen=False)
    assert "drives" in {each["id"] for each in found}
    for section in found:
        drawn = set().union(*(panel.curves for panel in section["panels"]))
        assert drawn == set(section["legend"]), section["id"]
        assert {len(row) for row in section["rows"]} == {len(section["heads"])}, section["id"]
