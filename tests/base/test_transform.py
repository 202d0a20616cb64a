"""Rigid transforms are Pinocchio's."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from hypothesis import given
from scipy.spatial.transform import Rotation

from testbed.core.base.arrays import multiply_vectors
from testbed.core.base.transform import Transform
from tests.helpers.strategies import rngs


@given(rng=rngs)
def test_points_wrenches_and_twists_are_those_of_pinocchio(rng: np.random.Generator) -> None:
    """Also many at once; and a wrench and a twist have one power in every frame."""
    R, t = Rotation.random(6, rng).as_matrix().reshape(2, 3, 3, 3), rng.normal(size=(2, 3, 3))
    X_AB, X_BC = map(Transform, R, t)
    X_AC, p, F, V = X_AB @ X_BC, *(rng.normal(size=(3, k)) for k in (3, 6, 6))
    for k in range(3):
        M_AC = pin.SE3(R[0, k], t[0, k]) * pin.SE3(R[1, k], t[1, k])
        np.testing.assert_allclose(X_AC.point(p)[k], M_AC.act(p[k]), atol=1e-12)
        np.testing.assert_allclose(X_AC.wrench(F)[k], M_AC.act(pin.Force(F[k])).vector, atol=1e-12)
        np.testing.assert_allclose(X_AC.inverse.point(p)[k], M_AC.actInv(p[k]), atol=1e-12)
        V_C = X_AC.wrench_matrix[k].T @ V[k]
        np.testing.assert_allclose(V_C, M_AC.actInv(pin.Motion(V[k])).vector, atol=1e-12)
    np.testing.assert_allclose(multiply_vectors(X_AC.wrench_matrix, F), X_AC.wrench(F), atol=1e-12)
