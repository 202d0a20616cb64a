"""A payload by the difference of two recordings, in motion and at rest; centres of mass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.arrays import Array
from testbed.errors import RecordingError, SettingsError, UnknownName
from testbed.identification.payload import payload, seen_of_payload
from testbed.identification.rest import poses_at_rest, weigh, weigh_payload
from testbed.identification.whole_robot import centre_of_mass, total_mass
from testbed.parameters.barycentric import standard
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.measured import measured
from tests.helpers.plates import LOAD, loaded, mass_of, resting
from tests.helpers.refusals import refuses
from tests.helpers.runs import ROBOTS, robot
from tests.helpers.strategies import few, rngs, trees


def ten() -> Array:
    """Parameters of the load."""
    tree = robot("puma")
    return np.array(standard(replace(tree, inertias=(LOAD, *tree.inertias[1:])))[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_a_payload_is_what_was_added(name: str) -> None:
    """Exactly of exact data, within sigmas of noisy ones; what is not told has no sigma."""
    tree, heavy = robot(name), loaded(robot(name))
    both = enumerate((tree, heavy))
    one, other = (tb.identify(each, ideal(each, seed=k), settings=EXACT) for k, each in both)
    exact = payload(tree, one, other)
    told = np.array(exact.told)
    assert told[0]
    np.testing.assert_allclose(exact.values[told], ten()[told], atol=1e-8)
    assert np.isinf(exact.sigma[~told]).all()
    one, other = (tb.identify(tree, measured(each, k)) for k, each in ((70, tree), (80, heavy)))
    noisy = payload(tree, one, other)
    assert np.abs((noisy.values - ten())[told] / noisy.sigma[told]).max() < 4.5
    assert noisy.chance > 1e-4
    assert noisy.warnings == ()


@given(trees((2, 5)), st.integers(0, 4), rngs)
def test_what_a_load_adds_is_what_the_minimal_set_holds(
    tree: tb.Tree, link: int, rng: np.random.Generator
) -> None:
    """On any link; and total mass and centres of mass, against the wrench at rest in any pose."""
    link %= tree.n
    minimal = tb.minimal_set(tree, "reaction")
    values = minimal.values(tb.barycentric(tree))
    more = minimal.values(tb.barycentric(loaded(tree, link)))
    adds = seen_of_payload(tree, minimal, tree.names[link])
    np.testing.assert_allclose(adds @ ten(), more - values, atol=1e-12)
    if not tree.gravity.any():
        return  # nothing has a weight
    assert total_mass(tree, minimal) @ values == pytest.approx(mass_of(tree))
    q, still = rng.uniform(-1, 1, (1, tree.n)), np.zeros((1, tree.n))
    where = ",".join(f"{n}={x!r}" for n, x in zip(tree.names, q[0].tolist(), strict=True))
    along_z = tb.base_wrench(tree.with_gravity([0, 0, -1]), tb.Motion(np.zeros(1), q, still, still))
    along_x = tb.base_wrench(tree.with_gravity([-1, 0, 0]), tb.Motion(np.zeros(1), q, still, still))
    mass = mass_of(tree)
    centre = {"x": -along_z[0, 4] / mass, "y": along_z[0, 3] / mass, "z": along_x[0, 4] / mass}
    for axis, place in centre.items():
        try:
            row = centre_of_mass(tree, minimal, f"centre/{axis}@{where}", float(place))
        except SettingsError:  # one that the plate never sees
            continue
        assert row @ values == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
def test_what_is_no_payload_is_noticed() -> None:
    """Two loads on two links are no load on one; a load that was taken off is none either."""
    tree = robot("ur5")
    heavy = loaded(loaded(tree), 1)
    one, other = (tb.identify(t, measured(t, k)) for k, t in enumerate((tree, heavy)))
    found, swapped = payload(tree, one, other), payload(tree, other, one)
    assert found.chance < 1e-6
    assert len(swapped.warnings) > len(found.warnings) > 0


def test_what_tells_no_payload_is_refused() -> None:
    """Estimates of two kinds or by torques, links that are none; motion, torques, no gravity."""
    tree, still = robot("puma"), resting(robot("puma"), 1)
    one, symmetric = (
        tb.identify(tree, ideal(tree), settings=replace(EXACT, zeros=zeros))
        for zeros in (False, True)
    )
    inner = tb.identify(tree, ideal(tree), "internal", settings=EXACT)
    for pair in ((one, symmetric), (inner, inner)):
        with refuses(SettingsError):
            payload(tree, *pair)
    with refuses(UnknownName, "wrist"):
        payload(tree, one, one, "wrist")
    for recording in (ideal(tree), replace(still, wrench=None, torque=still.position)):
        with refuses(RecordingError):
            poses_at_rest(tree, recording)
    with refuses(RecordingError, "mass"):
        weigh(tree.with_gravity(np.zeros(3)), poses_at_rest(tree, still))


@few(8)
@given(st.sampled_from(ROBOTS), st.integers(0, 99))
def test_poses_at_rest_weigh(name: str, seed: int) -> None:
    """Robot and payload within sigmas of a tenth of a kilogram."""
    tree = robot(name)
    alone = poses_at_rest(tree, resting(tree, seed))
    carrying = poses_at_rest(tree, resting(loaded(tree), seed + 100))
    assert len(alone) == len(carrying) == 8
    robots, found = weigh(tree, alone), weigh_payload(tree, alone, carrying)
    assert abs(robots.mass - mass_of(tree)) < 4.5 * robots.sigma < 0.1
    assert abs(found.mass - LOAD.mass) < 4.5 * found.sigma < 0.1
    for place, sigma, true in zip(found.centre, found.centre_sigma, LOAD.com, strict=True):
        assert np.isnan(place) or abs(place - true) < 5 * sigma
