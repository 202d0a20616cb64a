"""A payload by the difference of two recordings, in motion and at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import RecordingError, SettingsError, UnknownName
from testbed.identification.payload import PayloadEstimate, payload, seen_of_payload
from testbed.identification.rest import poses_at_rest, weigh, weigh_payload
from testbed.parameters.barycentric import standard
from testbed.recordings.recording import Recording
from testbed.robot.inertia import Inertia
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.measured import measured
from tests.helpers.robots import random_robot
from tests.helpers.runs import ROBOTS, robot

LOAD = Inertia.about_centre(1.2, [0.03, -0.05, 0.2], np.diag([2e-3, 3e-3, 4e-3]))


def loaded(tree: tb.Tree, link: int = -1) -> tb.Tree:
    bodies = list(tree.inertias)
    bodies[link] = bodies[link] + LOAD
    return replace(tree, inertias=tuple(bodies))


def ten(load: Inertia) -> Array:
    tree = robot("puma")
    only = replace(tree, inertias=(load, *tree.inertias[1:]))
    return np.array(standard(only)[0])


def score(found: PayloadEstimate) -> Array:
    told = np.array(found.told)
    return np.asarray((found.values - ten(LOAD))[told] / found.sigma[told])


@pytest.mark.parametrize("name", ROBOTS)
def test_exact_data_give_what_is_told(name: str) -> None:
    tree = robot(name)
    pair = [tb.identify(t, ideal(t, seed=k), settings=EXACT) for k, t in
            enumerate((tree, loaded(tree)))]  # fmt: skip
    found = payload(tree, pair[0], pair[1])
    told = np.array(found.told)
    assert told[0]
    np.testing.assert_allclose(found.values[told], ten(LOAD)[told], atol=1e-8)
    assert np.isinf(found.sigma[~told]).all()


@pytest.mark.parametrize("seed", range(6))
def test_what_is_told_is_what_the_minimal_set_holds(seed: int) -> None:
    """Two loads that differ in what is not told make the same minimal parameters."""
    tree = random_robot(np.random.default_rng(seed), 4).tree()
    link = seed % tree.n
    minimal = tb.minimal_set(tree, "reaction")
    adds = seen_of_payload(tree, minimal, tree.names[link])
    more = minimal.values(tb.barycentric(loaded(tree, link)))
    np.testing.assert_allclose(
        adds @ ten(LOAD), more - minimal.values(tb.barycentric(tree)), atol=1e-12
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_payloads_are_within_their_sigmas(name: str) -> None:
    tree, scores = robot(name), []
    for seed in range(2):
        first, second = measured(tree, 70 + seed), measured(loaded(tree), 80 + seed)
        found = payload(tree, tb.identify(tree, first), tb.identify(tree, second))
        scores += score(found).tolist()
        assert found.chance > 1e-4
        assert found.warnings == ()
    assert np.abs(scores).max() < 4.5


@pytest.mark.slow
def test_what_is_no_payload_is_noticed() -> None:
    """Two loads on two links are no load on one; a plate that shows too much is none either."""
    tree = robot("ur5")
    other = loaded(loaded(tree), 1)
    pair = [tb.identify(t, measured(t, k)) for k, t in enumerate((tree, other))]
    found = payload(tree, pair[0], pair[1])
    assert found.chance < 1e-6
    assert "something else changed" in found.warnings[0]
    swapped = payload(tree, pair[1], pair[0])
    assert any("changed places" in line for line in swapped.warnings)


def test_what_does_not_belong_together_is_refused() -> None:
    tree = robot("puma")
    recording = ideal(tree)
    one = tb.identify(tree, recording, settings=EXACT)
    symmetric = tb.identify(tree, recording, settings=replace(EXACT, zeros=True))
    inner = tb.identify(tree, recording, "internal", settings=EXACT)
    with pytest.raises(SettingsError, match="same robot"):
        payload(tree, one, symmetric)
    with pytest.raises(SettingsError, match="symmetry"):
        payload(tree, symmetric, symmetric)
    with pytest.raises(SettingsError, match="by the plate"):
        payload(tree, inner, inner)
    with pytest.raises(UnknownName, match="wrist"):
        payload(tree, one, one, "wrist")


def resting(tree: tb.Tree, seed: int, poses: int = 8, noise: float = 0.1) -> Recording:
    """Some seconds in each of a few poses, with a plate's noise, at 100 Hz."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.8, 0.8, (poses, tree.n)).repeat(200, axis=0)
    time = np.arange(len(q)) / 100.0
    still = np.zeros_like(q)
    wrench = tb.base_wrench(tree, tb.Motion(time, q, still, still)) + tb.pedestal_wrench(tree)
    noisy = wrench + noise * rng.normal(size=wrench.shape)
    seen = q + 1e-5 * rng.normal(size=q.shape)
    return Recording(tree.names, time, seen, wrench=noisy, tare=tb.pedestal_wrench(tree))


@pytest.mark.parametrize("name", ROBOTS)
def test_poses_at_rest_weigh(name: str) -> None:
    tree = robot(name)
    alone = poses_at_rest(tree, resting(tree, 1))
    carrying = poses_at_rest(tree, resting(loaded(tree), 2))
    assert len(alone) == len(carrying) == 8
    total = sum(body.mass for body in tree.inertias)
    robots = weigh(tree, alone)
    assert abs(robots.mass - total) < 4.5 * robots.sigma < 0.1
    found = weigh_payload(tree, alone, carrying)
    assert abs(found.mass - LOAD.mass) < 4.5 * found.sigma < 0.1
    for place, sigma, true in zip(found.centre, found.centre_sigma, LOAD.com, strict=True):
        assert np.isnan(place) or abs(place - true) < 5 * sigma


def test_a_robot_that_moves_is_not_weighed() -> None:
    tree = robot("puma")
    with pytest.raises(RecordingError, match="0 poses at rest"):
        poses_at_rest(tree, ideal(tree))
    with pytest.raises(RecordingError, match="is of another robot"):
        poses_at_rest(robot("ur5"), resting(tree, 1))
    with pytest.raises(RecordingError, match="no wrench"):
        poses_at_rest(
            tree, replace(resting(tree, 1), wrench=None, torque=resting(tree, 1).position)
        )


def test_without_gravity_nothing_is_weighed() -> None:
    tree = robot("puma")
    alone = poses_at_rest(tree, resting(tree, 1))
    afloat = tree.with_gravity(np.zeros(3))
    with pytest.raises(RecordingError, match="the poses do not tell the mass of what moves"):
        weigh(afloat, alone)
    with pytest.raises(RecordingError, match="do not tell the payload's mass from the robot's"):
        weigh_payload(afloat, alone, alone)
