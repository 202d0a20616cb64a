"""Pseudo-inertia matrices J = [[S, h], [h', m]] of bodies, and their coordinates.

S is the matrix of second moments, h the first moment, m the mass.
"""

from __future__ import annotations

import numpy as np

from testbed.core.base.arrays import Array, skew
from testbed.core.base.transform import Transform

UPPER_ENTRIES = tuple((a, b) for b in range(4) for a in range(b + 1))
"""Row and column of each matrix entry of the upper triangle, in the order of the coordinates."""

ROWS, COLUMNS = (list(each) for each in zip(*UPPER_ENTRIES[:6], strict=True))
"""Row and column indices of an inertia tensor's components, in the order xx xy yy xz yz zz."""


def _basis_matrices() -> Array:
    """Orthonormal basis of the symmetric (4, 4) matrices in the Frobenius product, (10, 4, 4).

    There is one matrix for each of `UPPER_ENTRIES`. Its nonzero elements are 1 on the diagonal, or
    sqrt(1/2) at two symmetric positions off the diagonal.
    """
    basis = np.zeros((10, 4, 4))
    for k, (a, b) in enumerate(UPPER_ENTRIES):
        basis[k, a, b] = basis[k, b, a] = 1.0 if a == b else np.sqrt(0.5)
    return basis


COORDINATE_BASIS = _basis_matrices()
"""Orthonormal basis of the symmetric matrices, (10, 4, 4)."""


def pseudo_inertias(standard: Array) -> Array:
    """Pseudo-inertia matrices J = [[S, h], [h', m]] of bodies, (..., 4, 4).

    m is the mass, h the first moment, and S = tr(I)/2 1 - I the matrix of second moments.

    Args:
        standard: Standard parameters m mx my mz Ixx Ixy Iyy Ixz Iyz Izz, about the frame's origin,
            (..., 10) [kg, kg m, kg m^2].
    """
    pseudo = np.empty((*standard.shape[:-1], 4, 4))
    pseudo[..., ROWS, COLUMNS] = pseudo[..., COLUMNS, ROWS] = standard[..., 4:]
    pseudo[..., :3, :3] = _trace_complement(pseudo[..., :3, :3], 0.5)
    pseudo[..., 3, :3] = pseudo[..., :3, 3] = standard[..., 1:4]
    pseudo[..., 3, 3] = standard[..., 0]
    return pseudo


def parameters(pseudo: Array) -> Array:
    """Standard parameters of bodies from pseudo-inertias, (..., 10) [kg, kg m, kg m^2].

    The order is m mx my mz Ixx Ixy Iyy Ixz Iyz Izz. This is the inverse of `pseudo_inertias`.

    Args:
        pseudo: Pseudo-inertia matrices J, (..., 4, 4), symmetric.
    """
    tensor = _trace_complement(pseudo[..., :3, :3], 1.0)
    parts = pseudo[..., 3, 3:], pseudo[..., 3, :3], tensor[..., ROWS, COLUMNS]
    return np.concatenate(parts, axis=-1)


def standard_parameter_transform(X_AB: Transform) -> Array:
    """Matrix that transforms standard parameters from frame B to frame A, (..., 10, 10).

    The parameters m mx my mz Ixx Ixy Iyy Ixz Iyz Izz are about the origin and along the axes of the
    frame.

    Args:
        X_AB: Pose of frame B in A.
    """
    X = X_AB.matrix[..., None, :, :]
    return np.swapaxes(parameters(X @ STANDARD_BASIS @ np.swapaxes(X, -1, -2)), -1, -2)


def standard_parameter_rate(twist: Array) -> Array:
    """Matrix from a moving body's standard parameters to their time derivatives, (10, 10).

    The parameters m mx my mz Ixx Ixy Iyy Ixz Iyz Izz are about the origin and along the axes of a
    fixed frame.

    Args:
        twist: Twist of the body at the origin of the fixed frame, along its axes, linear part
            first, (6,).
    """
    S = np.zeros((4, 4))
    S[:3, :3], S[:3, 3] = skew(twist[3:]), twist[:3]
    return parameters(S @ STANDARD_BASIS + STANDARD_BASIS @ S.T).T


def _trace_complement(tensors: Array, share: float) -> Array:
    """Tensors `share * trace(T) * 1 - T`, (..., 3, 3).

    A share of 1/2 converts inertia tensors T to second moments; a share of 1 converts them back.
    """
    trace = np.trace(tensors, axis1=-2, axis2=-1)
    return np.asarray(share * trace[..., None, None] * np.eye(3) - tensors)


STANDARD_BASIS = pseudo_inertias(np.eye(10))
"""Pseudo-inertia matrix for a unit value of each standard parameter, (10, 4, 4)."""


def pseudo_inertia_coordinates(matrices: Array) -> Array:
    """Coordinates of symmetric matrices in the orthonormal basis `COORDINATE_BASIS`, (..., 10).

    The Euclidean norm of the coordinates is the Frobenius norm of the matrix.

    Args:
        matrices: Symmetric matrices, (..., 4, 4).
    """
    return np.asarray(np.einsum("...ab,kab->...k", matrices, COORDINATE_BASIS))


def matrices_from_coordinates(coordinates: Array) -> Array:
    """Symmetric matrices from coordinates in the basis `COORDINATE_BASIS`, (..., 4, 4).

    Args:
        coordinates: Coordinates, (..., 10).
    """
    return np.tensordot(coordinates, COORDINATE_BASIS, 1)


def standard_from_coordinates(roots: Array) -> Array:
    """Matrix from coordinates of Y to the standard parameters of a body, (..., 10, 10).

    The pseudo-inertia matrix of a body is J = U Y U'. Columns are in the order of
    `COORDINATE_BASIS`, rows in the order m mx my mz Ixx Ixy Iyy Ixz Iyz Izz.

    Args:
        roots: Factors U, (..., 4, 4), that scale Y to entries near 1.
    """
    bodies = np.einsum("...ab,kbc,...dc->...kad", roots, COORDINATE_BASIS, roots)
    return np.swapaxes(parameters(bodies), -1, -2)
