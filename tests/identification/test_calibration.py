"""A plate calibrated by the robot on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import ExperimentError, SettingsError, UnknownName
from testbed.experiment.plate_file import read_plate, write_plate
from testbed.identification.calibration import Calibration, calibrate, corrected
from testbed.identification.nuisances.estimates import NuisanceEstimate
from testbed.recordings.recording import Recording
from tests.helpers.measured import measured
from tests.helpers.runs import ROBOTS, robot

AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
BIAS = np.array([2.0, -1.0, 1.0, 0.3, 0.2, -0.1])
SCALE = np.array([500.0, 500.0, 1000.0, 200.0, 200.0, 100.0])

FURTHER = {"random": ("crosstalk/Mz/Fy", "crosstalk/Mz/Fz")}
"""What of the plate no motion of this robot tells from its parameters."""


def mixing(seed: int) -> Array:
    """1 % of full scale from channel to channel, gains off by 0.5 %."""
    rng = np.random.default_rng(seed)
    own = np.diag(1 + rng.uniform(-0.005, 0.005, 6))
    others = rng.uniform(-0.01, 0.01, (6, 6)) * (1 - np.eye(6))
    return np.asarray(own + others * SCALE[:, None] / SCALE)


def on_plate(recording: Recording, matrix: Array) -> Recording:
    return replace(recording, wrench=recording.measured("wrench") @ matrix.T + BIAS)


def mass_of(tree: tb.Tree) -> float:
    return sum(inertia.mass for inertia in tree.inertias)


def known_of(tree: tb.Tree, name: str, matrix: Array) -> dict[str, float]:
    known = {"mass": mass_of(tree), "gain/Fz": float(matrix[2, 2])}
    for each in FURTHER.get(name, ()):
        _, shown, felt = each.split("/")
        known[each] = float(matrix[AXES.index(shown), AXES.index(felt)])
    return known


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_matrix_zero_and_robot_are_found_at_once(name: str) -> None:
    """Next to no noise, a plate far from first order."""
    tree = robot(name)
    matrix = mixing(3)
    recording = on_plate(measured(tree, noise=1e-4, rate=500.0), matrix)
    found = calibrate(tree, recording, known_of(tree, name, matrix))
    assert found.estimate is not None
    gap = np.abs(found.matrix - matrix) / SCALE[:, None] * SCALE
    assert gap.max() < 2e-4
    truth = found.estimate.minimal.values(tb.barycentric(tree))
    bent = " ".join(w for w in found.estimate.warnings if w.startswith("no motion tells bias"))
    told = [k for k, each in enumerate(found.estimate.names) if each not in bent]
    np.testing.assert_allclose(
        found.estimate.values[told], truth[told], atol=2e-4 * np.abs(truth).max()
    )
    assert len(told) >= len(truth) - 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "ur5", "gantry"])
def test_sigma_holds(name: str) -> None:
    """Of the matrix and of the robot, on four recordings with the usual noise."""
    tree, scores = robot(name), []
    for seed in range(4):
        matrix = mixing(seed)
        recording = on_plate(measured(tree, seed, rate=500.0, duration=30.0), matrix)
        found = calibrate(tree, recording, known_of(tree, name, matrix))
        assert found.estimate is not None
        truth = found.estimate.minimal.values(tb.barycentric(tree))
        for gap, sigma in (
            (found.matrix - matrix, found.matrix_sigma),
            (found.estimate.values - truth, found.estimate.sigma),
        ):
            scores.append((gap[sigma > 0] / sigma[sigma > 0]).ravel())
    spread = np.sqrt(np.mean(np.concatenate(scores) ** 2))
    assert 0.6 < spread < 1.5


@pytest.mark.parametrize("known", [{}, {"mass": 20.0}])
@pytest.mark.parametrize("name", ["puma", "ur5"])
def test_what_does_not_suffice_is_said_before_the_data_are_read(
    name: str, known: dict[str, float]
) -> None:
    tree = robot(name)
    recording = measured(tree, duration=4.0)
    spoilt = replace(recording, wrench=np.zeros_like(recording.measured("wrench")))
    with pytest.raises(SettingsError, match=r"no motion tells gain/Mz from .*gain/Fz=1"):
        calibrate(tree, spoilt, known)


def test_a_calibrated_plate_makes_other_recordings_right() -> None:
    tree = robot("puma")
    matrix = mixing(1)
    right = measured(tree, 5, noise=1e-3)
    numbers = tuple(
        NuisanceEstimate("matrix", name, "", float(value), 0.0)
        for name, value in zip(names_of_the_matrix(), matrix.ravel(), strict=True)
    )
    plate = Calibration("puma", {}, (*numbers, NuisanceEstimate("bias", "bias/Fx", "N", 9.0, 1.0)))
    back = corrected(on_plate(right, matrix), tree, plate)
    whole = back.part(0, back.samples)
    zero = BIAS @ np.linalg.inv(matrix).T  # of this recording, and it stays
    np.testing.assert_allclose(whole.measured("wrench"), right.measured("wrench") + zero)


MATRIX = tb.Settings(nuisances=("matrix", "bias"))


def names_of_the_matrix() -> list[str]:
    return [f"gain/{a}" if a == b else f"crosstalk/{a}/{b}" for a in AXES for b in AXES]


def test_a_plate_that_is_written_is_read_again(tmp_path: Path) -> None:
    tree = robot("puma")
    numbers = (
        NuisanceEstimate("skew", "skew", "s", 1.25e-5, 1e-6),
        NuisanceEstimate("matrix", "gain/Fx", "", 1.0023, 1e-4),
        NuisanceEstimate("matrix", "crosstalk/Fx/Mz", "1/m", -0.1 / 3, 1e-4),
    )
    plate = Calibration('a "robot"', {"mass": (20.0, 0.01)}, numbers)
    write_plate(plate, tmp_path / "plate.toml")
    again = read_plate(tmp_path / "plate.toml", tree)
    assert (again.robot, again.numbers) == (plate.robot, plate.numbers)
    assert dict(again.known) == dict(plate.known)
    assert again.matrix[0, 5] == -0.1 / 3
    assert again.matrix[1, 1] == 1.0


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        ("numbers = 3", ExperimentError, "numbers"),
        ("[numbers]\n'gain/Fx' = {value = 'x'}", ExperimentError, "value"),
        ("[numbers]\n'gain/Fx' = {value = inf}", ExperimentError, "value"),
        ("[numbers]\n'gain/Fq' = {value = 1.0}", UnknownName, "gain/Fx"),
        ("nothing", ExperimentError, "TOML"),
    ],
)
def test_files_that_are_no_plates(tmp_path: Path, text: str, error: type, said: str) -> None:
    path, tree = tmp_path / "plate.toml", robot("puma")
    path.write_text(text)
    with pytest.raises(error, match=said):
        corrected(measured(tree, duration=2.0), tree, read_plate(path, tree))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "ur5"])
def test_doubt_about_the_plate_counts_as_sampling_says(name: str) -> None:
    """Plates drawn from what calibration leaves open: estimates scatter as sigma grows."""
    tree, rng = robot(name), np.random.default_rng(4)
    matrix = mixing(2)
    first = on_plate(measured(tree, 1, duration=20.0), matrix)
    plate = calibrate(tree, first, known_of(tree, name, matrix), settings=MATRIX)
    second = on_plate(measured(tree, 2, duration=20.0), matrix)
    plain = tb.identify(tree, corrected(second, tree, plate))
    counted = tb.identify(tree, corrected(second, tree, plate), doubt=plate.doubt)
    np.testing.assert_allclose(counted.values, plain.values, rtol=1e-6, atol=1e-9)
    assert (counted.sigma >= plain.sigma * (1 - 1e-6)).all()
    assert counted.nuisances == ()
    drawn = []
    for _ in range(30):
        off = plate.doubt.root @ rng.normal(size=plate.doubt.root.shape[1])
        moved = dict(zip(plate.doubt.names, off, strict=True))
        numbers = tuple(
            replace(each, value=each.value + moved.get(each.name, 0.0)) for each in plate.numbers
        )
        other = replace(plate, numbers=numbers)
        drawn.append(tb.identify(tree, corrected(second, tree, other)).values)
    scatter = np.std(drawn, axis=0, ddof=1)
    told = np.isfinite(plain.sigma) & np.isfinite(counted.sigma)
    variances = (np.where(told, each.sigma, 1.0) ** 2 for each in (counted, plain))
    added = np.sqrt(np.maximum(np.subtract(*variances), 0.0))
    matters = told & (scatter > 0.3 * plain.sigma)
    assert matters.any()
    assert 0.7 < np.sqrt(np.mean((added[matters] / scatter[matters]) ** 2)) < 1.4
