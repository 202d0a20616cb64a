"""The public interface: what independent data say adds, values survive every form, errors name."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag

import testbed as tb
from docs import interface
from testbed.core.estimation.information import combination_matrix
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses

Signals = tuple[tb.Tree, tb.Recording, tb.Estimate, tb.Estimate]


@pytest.fixture(scope="module")
def signals() -> Signals:
    """A robot, a recording of it, and what plate and joint torques say."""
    robot = tb.load_tree("puma562.xml")
    sensors = [tb.ForcePlate(noise=(0.5, 0.1)), tb.JointTorques(noise=0.5)]
    rig = tb.Rig(robot, sensors=sensors, step=1e-3)
    data = tb.simulate(rig, tb.random_motion(robot, seed=1), seconds=8, seed=3)
    torque = tb.identify(robot, data, "torque", terms=["coulomb", "viscous"])
    return robot, data, tb.identify(robot, data, "wrench"), torque


@pytest.mark.parametrize("count", [0, 2])
def test_independent_estimates_add_as_their_rows_stacked(count: int, signals: Signals) -> None:
    """A name is one parameter: least squares on both, each by its covariance; one may lack some."""
    _, _, plate, torque = signals
    shared = next(name for name in plate.names if name in torque.names)
    # the other tells only one of them
    plate = plate.with_(unidentifiable=("mbar1", shared)[:count])
    both, known = plate + torque, [np.isfinite(each.sigma) for each in (plate, torque)]
    told = list(zip((plate, torque), known, strict=True))
    minimal = max(plate.minimal, torque.minimal, key=lambda own: own.count)
    whole = [combination_matrix(each, minimal, both.names) for each in (plate, torque)]
    rows = np.vstack([every[own] for every, own in zip(whole, known, strict=True)])
    values = np.concatenate([each.values[own] for each, own in told])
    covariances = (each.covariance[np.ix_(own, own)] for each, own in told)
    root = np.linalg.cholesky(block_diag(*covariances))
    white, target = np.linalg.solve(root, rows), np.linalg.solve(root, values)
    stacked, *_ = np.linalg.lstsq(white, target, rcond=None)
    spread = np.linalg.norm(np.linalg.pinv(white), axis=1)
    some = np.isfinite(both.sigma)
    np.testing.assert_allclose(both.values[some], stacked[some], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(both.sigma[some], spread[some], rtol=1e-7)
    assert np.array(both.names)[~some].tolist() == ["mbar1"][:count]
    assert (both.sigma[: len(plate.sigma)] <= plate.sigma * (1 + 1e-9)).all()
    again = torque + plate
    assert set(again.names) == set(both.names) >= {*plate.names, "coulomb/waist"}


def test_data_and_model_file_make_a_robot_that_can_exist(signals: Signals, tmp_path: Path) -> None:
    robot, _, plate, torque = signals
    real = plate + torque + tb.prior(robot, error=0.3)
    assert (real.bodies.eigenvalues > 0).all()
    tb.write_model(real, tmp_path / "identified.xml")
    written = tb.load_tree(tmp_path / "identified.xml")
    np.testing.assert_allclose(tb.standard(written), tb.standard(real.robot), atol=1e-9)
    assert len(real.sample(30).values) == 30
    assert "link1" in repr(real)
    with refuses(tb.TestbedError, "identify"):
        tb.prior(robot) + tb.prior(robot)  # type: ignore[operator]


def test_a_rig_records_what_its_sensors_measure(signals: Signals) -> None:
    """And what is in the plant is part of the truth."""
    robot, _, _, _ = signals
    motion = tb.random_motion(robot, seed=2)
    loaded = tb.Rig(robot, [tb.Payload("elbow", mass=2.0)], [tb.ForcePlate()], step=1e-3)
    data = tb.simulate(loaded, motion, seconds=2)
    assert data.signals == ("time", "position", "wrench")
    assert data.truth is not None
    heavier = sum(body.mass for body in loaded.true_robot.inertias)
    assert heavier == pytest.approx(sum(body.mass for body in robot.inertias) + 2.0)
    gains = tb.Rig(robot, sensors=[tb.JointTorques(gains={"waist": 1.08})], step=1e-3)
    torque = tb.simulate(gains, motion, seconds=2)
    assert torque.truth is not None
    np.testing.assert_allclose(torque.measured("torque"), [1.08, 1, 1] * torque.truth.torque)
    samples = motion.at(np.linspace(0, 3, 301))
    own = tb.simulate(replace(gains, averaged=False), samples)
    assert own.samples == 3000
    wanted = motion.at(own.time).q
    assert np.abs(own.position - wanted)[500:].max() < 5e-3
    for sensors, culprit in (
        ([tb.ForcePlate(), tb.ForcePlate()], "more than one ForcePlate"),
        ([tb.JointTorques(gains={"wrist": 1.1})], "wrist"),
    ):
        with refuses(tb.TestbedError, culprit):
            tb.simulate(tb.Rig(robot, sensors=sensors), motion, seconds=2)


def test_a_recording_survives_frames_and_foreign_files(signals: Signals, tmp_path: Path) -> None:
    robot, data, plate, _ = signals
    columns = data.columns()
    arrays = {s: data.measured(s) for s in ("time", "position", "torque", "wrench")}
    for frame in (data.to_frame(), columns, arrays):
        again = tb.Recording.from_frame(frame, robot)
        for name, values in again.columns().items():
            np.testing.assert_array_equal(values, columns[name])
        assert again.columns().keys() == columns.keys()
    table, head = np.stack([*columns.values()], axis=1), ",".join(columns)
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=head, comments="")
    data.save(tmp_path / "own.parquet")
    for name in ("log.csv", "own.parquet"):
        found = tb.identify(robot, tb.read(tmp_path / name, robot), "wrench")
        np.testing.assert_allclose(found.values, plate.values, atol=6 * plate.sigma.max())


def test_what_is_exchanged_is_named(signals: Signals) -> None:
    robot, data, plate, _ = signals
    for call, culprit in (
        (lambda: tb.identify(data, robot), "Recording was given"),  # type: ignore[arg-type]
        (lambda: tb.identify("puma562.xml", data), "load_tree"),  # type: ignore[arg-type]
        (lambda: tb.minimal_set(data, "wrench"), "minimal_set"),  # type: ignore[arg-type]
        (lambda: tb.Rig("puma562.xml"), "load_tree"),  # type: ignore[arg-type]
        (lambda: tb.Rig(robot).with_(rat=500), "'rate'"),
        (lambda: tb.Rig(robot, friction=4.0), "with_joints"),  # type: ignore[arg-type]
        (lambda: tb.Rig(robot, sensors=[tb.ForcePlate(noise=0.5)]), "moment"),  # type: ignore[arg-type]
        (lambda: tb.validate(data, plate), "validate"),  # type: ignore[arg-type]
        (lambda: tb.Recording.from_frame(robot, robot), "dict of arrays"),
        (lambda: tb.minimal_set(robot, "wrist"), "wrench"),  # type: ignore[arg-type]
    ):
        with refuses(tb.TestbedError, culprit):
            call()


def test_public_values_print_on_a_screen(signals: Signals, tmp_path: Path) -> None:
    robot, data, plate, torque = signals
    found = tb.predict(data, plate, torque)
    assert len(found.time) == len(found.channels[0].measured) == found.to_frame()["time"].__len__()
    rig, experiment = tb.Rig(robot), tb.Experiment.from_toml(tb.shipped("table6"))
    plain = (robot, robot.joints[0], tb.minimal_set(robot, "wrench"), rig.sensors[0], tb.Tilt())
    results = (data, plate, plate + torque, found, tb.validate(plate, data), tb.equations(robot))
    for value in (*plain, *results, rig, experiment, tb.prior(robot), tb.Settings()):
        assert len(repr(value).splitlines()) < 45
        assert value._repr_html_().startswith("<table>")
    assert tb.plot(data, plate)._repr_png_().startswith(b"\x89PNG")
    assert tb.view(data, plate, path=tmp_path / "x.rrd").stat().st_size > 1000


def test_the_table_of_the_interface_has_the_names_of_the_list() -> None:
    page = interface.DOCUMENT.read_text()
    assert interface.lines().strip() in page, "python -m docs.interface writes it anew"
    assert page.count("\n") <= 160


@pytest.mark.slow
def test_half_a_page_passes_a_strict_check_of_types(tmp_path: Path) -> None:
    blocks = interface.DOCUMENT.read_text().split("```python\n")[1:]
    script = "\n".join(block.partition("```")[0] for block in blocks)
    (tmp_path / "half_a_page.py").write_text(script.replace("import pyarrow.csv\n", ""))
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent"]
    done = subprocess.run(
        [*command, "--ignore-missing-imports", str(tmp_path / "half_a_page.py")],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "half_a_page.py:" not in done.stdout.replace("pyarrow", ""), done.stdout
