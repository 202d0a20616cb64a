"""Barycentric and standard parameters, bodies before the data, and what is told of each.

If one fails, estimates are turned into masses and inertias that are not theirs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.bodies.prior import THINNEST, Prior, prior_of
from testbed.core.base.arrays import Array
from testbed.core.dynamics.drive_set import sampled_regressor
from testbed.core.parameters.elimination import dense_rows, static_entries
from testbed.core.parameters.identifiability import ALONE, COMBINED, NEVER, identifiability
from testbed.core.parameters.pseudo_inertia import matrices
from testbed.core.parameters.regroup import regroup
from testbed.core.parameters.symbols import on_standard, to_barycentric, to_standard
from testbed.core.robot.inertia import NOTHING, SMALL, Inertia
from tests.helpers.robots import Robot
from tests.helpers.strategies import rngs, robots, trees


@given(robots(), rngs)
def test_standard_parameters_are_pinocchios_and_one_to_one_with_barycentric_ones(
    robot: Robot, rng: np.random.Generator
) -> None:
    """In Pinocchio's order: else a mass that is printed is another one to every other program."""
    tree = robot.tree()
    rows, parameters = rng.normal(size=(3, 10 * tree.n)), rng.normal(size=(tree.n, 10))
    back = to_standard(tree, to_barycentric(tree, parameters))
    np.testing.assert_allclose(back, parameters, rtol=0, atol=1e-12)
    said = rows @ to_barycentric(tree, parameters).ravel()
    np.testing.assert_allclose(on_standard(tree, rows) @ parameters.ravel(), said, atol=1e-11)
    model = pin.buildModelFromXML(robot.urdf())
    for k, name in enumerate(tree.names):
        theirs = model.inertias[model.getJointId(name)].toDynamicParameters()
        np.testing.assert_allclose(tb.standard(tree)[k], theirs, rtol=0, atol=1e-12)


# the map


def beside_a_pedestal(tree: tb.Tree, tared: tb.MinimalSet) -> Array:
    """What is told with an unknown mass and two moments on the plate, (k, 3 + 10 n)."""
    bodies = regroup(tree, "reaction", tree.gravity)
    entries = static_entries(tree, tree.gravity) if tree.gravity.any() else []
    static = np.where(tared.known_zero.ravel(), 0.0, dense_rows(tree, bodies, entries))
    own = np.eye(3)[: len(static)]
    return np.block([[np.zeros((tared.count, 3)), tared.matrix], [own, static]])


def levels_by_orthonormal_rows(rows: Array) -> Array:
    basis = np.linalg.qr(rows.T)[0]
    inside = np.linalg.norm(basis, axis=1) > 1e-9
    outside = np.linalg.norm(np.eye(len(basis)) - basis @ basis.T, axis=0) > 1e-9
    return np.where(outside, np.where(inside, COMBINED, NEVER), ALONE)


@pytest.mark.slow
@given(st.one_of(trees((1, 7)), trees((1, 7), bare=True)), st.booleans())
def test_the_map_is_that_of_the_row_space(tree: tb.Tree, zeros: bool) -> None:
    """A unit parameter is outside of it, has a part in it, or is in it, told by a dense basis."""
    torques, plate = (tb.minimal_set(tree, m, zeros=zeros) for m in ("dynamic", "reaction"))
    tared = tb.minimal_set(tree, "reaction", zeros=zeros, tared=True)
    rows = [torques.matrix, plate.matrix, tared.matrix, beside_a_pedestal(tree, tared)]
    seen = identifiability(tree, None, zeros)
    for found, told in zip(seen, rows, strict=True):
        others = told.shape[1] - 10 * tree.n
        standard = np.hstack([told[:, :others], on_standard(tree, told[:, others:])])
        assert found.count == len(told)
        for table, own in ((found.standard, standard), (found.barycentric, told)):
            wanted = levels_by_orthonormal_rows(own)[others:]
            np.testing.assert_array_equal(table.ravel(), wanted)
    by_torques, by_plate, by_tared, _ = (each.standard for each in seen)
    assert (by_plate >= np.maximum(by_torques, by_tared)).all()  # it sees whatever others see
    if not zeros:
        size = np.abs(sampled_regressor(tree, "dynamic")).max(axis=0)
        never = seen[0].barycentric.ravel() == NEVER
        np.testing.assert_array_equal(size < 1e-9 * max(size.max(), 1e-9), never)


# bodies before the data


def central(prior: Prior, body: int) -> Array:
    """Second moments about the mass centre, (3, 3) [kg m^2]."""
    found = matrices(prior.standard[body])
    return np.asarray(found[:3, :3] - np.outer(found[:3, 3], found[:3, 3]) / found[3, 3])


def test_bodies_before_the_data_are_the_files_or_the_nearest_that_can_be(puma: tb.Tree) -> None:
    """Possible ones as they are; points get a size, no matter stays none, no mass a usual one."""
    spread = np.diag([0.02, 0.03, 0.04])
    thick = tuple(Inertia.about_centre(2.0 + 2 * k, [0.1, 0.2, 0.3], spread) for k in range(3))
    point = Inertia.about_centre(2.0, [0.0, 0.3, 0.4], np.zeros((3, 3)))
    here = Inertia.about_centre(3.0, np.zeros(3), np.zeros((3, 3)))
    odd = Inertia(0.0, np.array([0.1, 0.0, 0.0]), np.diag([0.1, 0.2, 0.25]))
    reach = max(SMALL, *(float(np.linalg.norm(joint.offset)) for joint in puma.joints))
    for bodies, masses, named in (
        (thick, [2.0, 4.0, 6.0], ()),
        ((thick[0], NOTHING, thick[2]), [2.0, 0.0, 6.0], (1,)),
        ((thick[0], odd, thick[2]), [2.0, 4.0, 6.0], (1,)),
        ((NOTHING,) * 3, [1.0, 1.0, 1.0], ()),
        ((point, here, thick[2]), [2.0, 3.0, 6.0], (0, 1)),
    ):
        tree = replace(puma, inertias=bodies)
        found = prior_of(tree)
        np.testing.assert_allclose(found.standard[:, 0], masses, rtol=1e-9)
        assert bool(found.diagnostics) == (bodies is not thick)
        assert all(
            any(puma.joints[k].body in each.text for each in found.diagnostics) for k in named
        )
        for k in found.massive:
            sizes = np.linalg.eigvalsh(central(found, k))
            assert sizes[0] >= 0.99 * THINNEST * sizes[-1] > 0
            if bodies[k] in thick:
                np.testing.assert_allclose(found.standard[k], tb.standard(tree)[k], atol=1e-12)
    for k, away in ((0, 0.5), (1, reach)):  # a tenth of its distance, or of the robot's lengths
        radius = np.sqrt(np.trace(central(found, k)) / found.standard[k, 0])
        assert radius == pytest.approx(SMALL * away, rel=1e-6)
    np.testing.assert_allclose(found.standard[0, :4], [2.0, 0.0, 0.6, 0.8], atol=1e-9)
