"""Bodies before the data: as the file has them where they can be, else the nearest that can."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.parameters.prior import THINNEST, Prior, prior_of
from testbed.parameters.pseudo_inertia import matrices
from testbed.robot.inertia import SMALL, Inertia
from tests.helpers.robots import random_robot


def tree_with(seed: int, **bodies: Inertia) -> tb.Tree:
    """A random tree of three joints, some of whose bodies are given: b0, b1, b2."""
    tree = random_robot(np.random.default_rng(seed), 3).tree()
    own = tuple(bodies.get(f"b{k}", inertia) for k, inertia in enumerate(tree.inertias))
    return replace(tree, inertias=own)


def central(prior: Prior, body: int) -> Array:
    """Second moments about the mass centre, (3, 3) [kg m^2]."""
    found = matrices(prior.standard[body])
    return np.asarray(found[:3, :3] - np.outer(found[:3, 3], found[:3, 3]) / found[3, 3])


def possible(prior: Prior) -> bool:
    """Whether each body that has matter is as thick as the thinnest that is allowed."""
    for k in prior.massive:
        sizes = np.linalg.eigvalsh(central(prior, k))
        if not (prior.standard[k, 0] > 0 and sizes[0] >= 0.99 * THINNEST * sizes[-1] > 0):
            return False
    return True


def diagonal(mass: float, com: tuple[float, ...], *numbers: float) -> Inertia:
    """About and along the body's frame, from central principal moments."""
    place = np.array(com)
    about: Array = np.diag(numbers) + mass * (place @ place * np.eye(3) - np.outer(place, place))
    return Inertia(mass, mass * place, about)


@pytest.mark.parametrize("seed", range(5))
def test_bodies_that_can_be_stay_as_they_are(seed: int) -> None:
    thick = {f"b{k}": diagonal(2.0 + k, (0.1, 0.2, 0.3), 0.02, 0.03, 0.04) for k in range(3)}
    tree = tree_with(seed, **thick)
    found = prior_of(tree)
    assert possible(found)
    assert found.warnings == ()
    assert found.massive == (0, 1, 2)
    for k, inertia in enumerate(tree.inertias):
        np.testing.assert_allclose(found.standard[k, 0], inertia.mass, rtol=1e-12)
        np.testing.assert_allclose(found.standard[k, 1:4], inertia.first_moment, atol=1e-12)


def test_a_point_gets_a_small_size() -> None:
    """A tenth of its distance, or of the robot's lengths where it has none."""
    away = diagonal(2.0, (0.0, 0.3, 0.4), 0.0, 0.0, 0.0)
    here = diagonal(3.0, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    tree = tree_with(1, b0=away, b1=here)
    found = prior_of(tree)
    assert possible(found)
    reach = max(SMALL, *(float(np.linalg.norm(joint.offset)) for joint in tree.joints))
    for k, distance in ((0, 0.5), (1, reach)):
        radius = np.sqrt(np.trace(central(found, k)) / found.standard[k, 0])
        assert radius == pytest.approx(SMALL * distance, rel=1e-6)
    np.testing.assert_allclose(found.standard[0, :4], [2.0, 0.0, 0.6, 0.8], atol=1e-9)
    (line,) = found.warnings
    assert all(tree.joints[k].body in line for k in (0, 1))
    assert tree.joints[2].body not in line


def test_bodies_without_matter_stay_without() -> None:
    tree = tree_with(2, b1=diagonal(0.0, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0))
    found = prior_of(tree)
    assert found.massive == (0, 2)
    assert not found.standard[1].any()
    assert any(tree.joints[1].body in line for line in found.warnings)


def test_a_file_without_masses_gets_unit_ones() -> None:
    none = diagonal(0.0, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    found = prior_of(tree_with(3, b0=none, b1=none, b2=none))
    np.testing.assert_allclose(found.standard[:, 0], 1.0)
    assert possible(found)
    assert len(found.warnings) >= 1


def test_a_body_with_inertia_and_no_mass_gets_a_usual_one() -> None:
    """The middle one of the others'; where its first moment says anything, that is left out."""
    odd = Inertia(0.0, np.array([0.1, 0.0, 0.0]), np.diag([0.1, 0.2, 0.25]))
    tree = tree_with(
        4,
        b0=diagonal(2.0, (0.1, 0, 0), 0.02, 0.03, 0.04),
        b1=odd,
        b2=diagonal(4.0, (0.1, 0, 0), 0.02, 0.03, 0.04),
    )
    found = prior_of(tree)
    assert possible(found)
    np.testing.assert_allclose(found.standard[1, :4], [3.0, 0.0, 0.0, 0.0], atol=1e-9)
    assert any(tree.joints[1].body in line for line in found.warnings)
