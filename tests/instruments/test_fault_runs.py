"""All faults at once through the command line, and latched positions against the plant's own."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.instruments.catalogue import catalogue
from testbed.instruments.faults import KINDS
from tests.helpers.command import command_line
from tests.helpers.paths import GOLDEN, ROOT

SHORT = (
    "motion.duration=4",
    "motion.fundamental=0.25",
    "motion.candidates=1",
    "simulation.step=5e-4",
    "simulation.warm_up=0.5",
)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["ur5", "gantry_ppp_rrr"])
def test_all_faults_at_once_make_a_run_that_can_be_repeated(robot: str, tmp_path: Path) -> None:
    path = tmp_path / "faulty.toml"
    path.write_text(f'name = "faulty"\nmodel = "{GOLDEN / "robots" / robot}.urdf"\n')
    every = ", ".join(entry.example for entry in catalogue())
    settings = (*SHORT, "simulation.drive_model_error=0.1", f"measurement.fault=[{every}]")
    words = [word for setting in settings for word in ("--set", setting)]
    done = command_line("run", str(path), *words, "--out", "run", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert min(each for each in result["external"]["sigma"] if each is not None) > 0
    kept = tb.Experiment.load(tmp_path / "run/experiment.toml")
    assert [fault.kind for fault in kept.measurement.fault] == list(KINDS)
    recording = tb.Recording.load(tmp_path / "run/recording.parquet")
    again = tb.simulate(kept)
    assert recording.truth is not None
    for signal in ("position", "torque", "wrench"):
        shown = recording.measured(signal)
        np.testing.assert_array_equal(shown, again.measured(signal))
        assert (shown != getattr(recording.truth, signal)).any(axis=0).all()
    report = command_line("report", "run", cwd=tmp_path)
    assert report.returncode == 0, report.stderr
    assert "plate_crosstalk" in (tmp_path / "run.html").read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    "model",
    [ROOT / "models/puma562.xml", GOLDEN / "robots/gantry_ppp_rrr.urdf"],
    ids=lambda path: path.stem,
)
def test_latched_positions_are_those_of_a_plant_that_is_sampled_at_instants(model: Path) -> None:
    settings = [*SHORT, "simulation.step=2.5e-4", f"model={model}"]
    shown = {}
    for averaged in ("true", "false"):
        kind = '[{kind="encoder_instant_sampling"}]' if averaged == "true" else "[]"
        more = [
            f"measurement.averaged={averaged}",
            f"measurement.fault={kind}",
            "measurement.encoder_noise=0.0",
            "measurement.encoder_resolution=0.0",
            "measurement.torque_constant_error={}",
        ]
        experiment = tb.Experiment.load(ROOT / "experiments/table6.toml", [*settings, *more])
        shown[averaged] = tb.simulate(experiment)
    latched, instants = (shown[key].position for key in ("true", "false"))
    means = shown["true"].truth.position  # type: ignore[union-attr]
    assert np.abs(means - instants).max() > 1e-4
    assert np.abs(latched - instants).max() < 2e-6
