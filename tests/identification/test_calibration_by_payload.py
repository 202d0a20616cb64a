"""A plate calibrated by a payload, and by a centre of mass, in place of a mass and a gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import testbed as tb
from testbed.arrays import Array
from testbed.errors import SettingsError, TestbedError, UnknownName
from testbed.identification.calibration import calibrate
from testbed.identification.calibration_by_payload import calibrate_by_payload
from testbed.identification.known_payload import known_payload
from testbed.identification.settings import Settings
from testbed.identification.whole_robot import centre_of_mass, total_mass
from testbed.recordings.recording import Recording
from tests.helpers.measured import measured
from tests.helpers.robots import random_robot
from tests.helpers.runs import ROBOTS, robot
from tests.identification.test_calibration import MATRIX, mass_of, mixing, on_plate
from tests.identification.test_payload import LOAD, loaded

MASS = {"payload/mass": LOAD.mass}
ZERO = np.array([0.3, 0.2, -1.5, 0.05, 0.1, 0.02])
"""Of the plate, that has moved between the recordings."""


def two(name: str, seed: int, noise: float = 1.0) -> tuple[Recording, Recording, Array]:
    tree, matrix = robot(name), mixing(seed)
    without = on_plate(measured(tree, seed, noise=noise), matrix)
    other = on_plate(measured(loaded(tree), seed + 100, noise=noise), matrix)
    return without, replace(other, wrench=other.measured("wrench") + ZERO), matrix


def centre_by_links(tree: tb.Tree, q: Array) -> tuple[float, Array]:
    """Mass and centre of all moving bodies, link by link from the joints' definition."""
    poses: list[tuple[Array, Array]] = []
    moment = np.zeros(3)
    for joint, inertia, at in zip(tree.joints, tree.inertias, q, strict=True):
        carrier = poses[joint.parent] if joint.parent >= 0 else (np.eye(3), np.zeros(3))
        turned = carrier[0] @ joint.rotation
        place = carrier[1] + carrier[0] @ joint.offset
        if joint.revolute:
            turned = turned @ Rotation.from_rotvec(at * joint.axis).as_matrix()
        else:
            place = place + turned @ joint.axis * at
        poses.append((turned, place))
        moment += inertia.mass * place + turned @ inertia.first_moment
    return mass_of(tree), moment / mass_of(tree)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5", "gantry"])
def test_a_payload_tells_the_scale(name: str) -> None:
    """Next to no noise, a plate far from first order, no mass and no gain known."""
    without, other, matrix = two(name, 1, noise=1e-3)
    found = calibrate_by_payload(robot(name), without, other, MASS, settings=MATRIX)
    np.testing.assert_allclose(np.diag(found.matrix), np.diag(matrix), atol=2e-5)
    assert found.estimate is not None
    assert not [w for w in found.estimate.warnings if "do not differ" in w]


@pytest.mark.slow
def test_sigma_holds() -> None:
    """Of the matrix and of the robot, on recordings with the usual noise."""
    scores = []
    known = {**MASS, **{f"payload/{a}": float(c) for a, c in zip("xyz", LOAD.com, strict=True)}}
    for seed in range(3):
        without, other, matrix = two("puma", seed)
        found = calibrate_by_payload(robot("puma"), without, other, known, settings=MATRIX)
        scores.append(((found.matrix - matrix) / found.matrix_sigma).ravel())
    assert 0.7 < np.sqrt(np.mean(np.concatenate(scores) ** 2)) < 1.4


@pytest.mark.slow
def test_doubt_about_the_payload_comes_back() -> None:
    """A payload that weighs so much more makes the gains so much smaller: seen by moving it."""
    without, other, _ = two("puma", 2, noise=0.01)
    exact, moved, doubted = (
        calibrate_by_payload(robot("puma"), without, other, {"payload/mass": m}, settings=MATRIX)
        for m in (LOAD.mass, 1.002 * LOAD.mass, (LOAD.mass, 0.002 * LOAD.mass))
    )
    step = np.diag(moved.matrix - exact.matrix)
    np.testing.assert_allclose(step, -0.002, rtol=0.05)
    wanted = np.hypot(np.diag(exact.matrix_sigma), step)
    np.testing.assert_allclose(np.diag(doubted.matrix_sigma), wanted, rtol=0.05)


@pytest.mark.slow
def test_another_payload_is_noticed() -> None:
    without, other, _ = two("puma", 2)
    known = {**MASS, "payload/x": 0.3, "payload/y": 0.0, "payload/z": 0.0}
    found = calibrate_by_payload(robot("puma"), without, other, known, settings=MATRIX)
    assert found.estimate is not None
    assert [w for w in found.estimate.warnings if "do not differ by this payload" in w]


@pytest.mark.parametrize(
    ("known", "error", "said"),
    [
        ({"payload/x": 0.1}, SettingsError, "mass has to be known"),
        ({"payload/mass": -1.0}, SettingsError, "mass has to be known"),
        ({"payload/weight": 1.0}, UnknownName, "payload/mass"),
    ],
)
def test_payloads_that_tell_nothing(
    known: dict[str, float], error: type[TestbedError], said: str
) -> None:
    with pytest.raises(error, match=said):
        known_payload(robot("puma"), None, {name: (value, 0.0) for name, value in known.items()})


def test_one_recording_with_a_payload_tells_nothing() -> None:
    tree = robot("puma")
    with pytest.raises(SettingsError, match="part of its link.*--loaded"):
        calibrate(tree, measured(tree, duration=4.0), MASS)


def test_what_no_payload_tells_is_said_before_the_data_are_read() -> None:
    """A robot that only turns about the vertical never loads the plate in new ways."""
    tree = robot("random")
    empty = measured(tree, duration=4.0)
    spoilt = replace(empty, wrench=np.zeros_like(empty.measured("wrench")))
    with pytest.raises(SettingsError, match="no motion tells crosstalk/Mz"):
        calibrate_by_payload(tree, spoilt, spoilt, MASS)


@pytest.mark.parametrize("seed", range(6))
def test_the_centre_of_mass_is_the_mean_of_the_links(seed: int) -> None:
    """Of random trees, in any posture, along the axes that a plate sees."""
    rng = np.random.default_rng(seed)
    drawn = random_robot(rng, 4)
    tree, q = drawn.tree(), rng.uniform(-1, 1, 4)
    minimal = tb.minimal_set(tree, "reaction")
    values = minimal.values(tb.barycentric(tree))
    where = ",".join(f"{name}={x!r}" for name, x in zip(tree.names, q.tolist(), strict=True))
    mass, centre = centre_by_links(tree, q)
    assert total_mass(tree, minimal) @ values == pytest.approx(mass)
    for axis, place in zip("xyz", centre, strict=True):
        try:
            row = centre_of_mass(tree, minimal, f"centre/{axis}@{where}", place)
        except SettingsError:  # a height that never changes
            continue
        assert row @ values == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "ur5"])
def test_a_centre_of_mass_does_for_the_mass(name: str) -> None:
    """With a gain; and the zero of Fz, which no mass of the robot's would be told beside, too."""
    tree, matrix = robot(name), mixing(3)
    recording = on_plate(measured(tree, 3, noise=1e-3), matrix)
    _, centre = centre_by_links(tree, np.zeros(tree.n))
    known = {"gain/Fz": float(matrix[2, 2]), "centre/y": float(centre[1])}
    found = calibrate(tree, recording, known, settings=MATRIX)
    assert found.estimate is not None
    numbers = {each.name: each.value for each in found.numbers}
    assert numbers["bias/Fz"] == pytest.approx(1.0, abs=0.05)
    assert found.estimate.values[found.estimate.names.index("mbar1")] == pytest.approx(
        mass_of(tree), rel=2e-4
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_a_centre_of_mass_alone_has_no_scale(name: str) -> None:
    tree = robot(name)
    with pytest.raises(SettingsError, match="no motion tells"):
        calibrate(tree, measured(tree, duration=4.0), {"centre/x": 0.1}, settings=MATRIX)


@pytest.mark.slow
def test_doubt_about_a_centre_grows_with_the_mass() -> None:
    """As far as the estimate moves with it: seen by moving it. So far off there are constants."""
    tree = robot("ur5")
    recording = measured(tree)
    off = float(centre_by_links(tree, np.zeros(tree.n))[1][0]) + 0.02
    exact, moved, doubted = (
        tb.identify(tree, recording, settings=Settings(known={"centre/x": given}))
        for given in (off, off + 1e-5, (off, 2e-3))
    )
    slope = (moved.values - exact.values) / 1e-5
    wanted = np.sqrt(np.diagonal(exact.covariance) + (2e-3 * slope) ** 2)
    np.testing.assert_allclose(doubted.sigma, wanted, rtol=0.03)


@pytest.mark.parametrize("name", ["centre/w", "centre/x@hip=1", "centre/x@elbow=far"])
def test_centres_of_nothing(name: str) -> None:
    tree = robot("puma")
    with pytest.raises(TestbedError):
        tb.identify(tree, measured(tree, duration=4.0), settings=Settings(known={name: 0.1}))


def test_a_height_that_no_motion_shows_is_no_fact() -> None:
    tree = robot("puma")
    with pytest.raises(SettingsError, match="'centre/z' is not among"):
        tb.identify(tree, measured(tree, duration=4.0), settings=Settings(known={"centre/z": 0.5}))
