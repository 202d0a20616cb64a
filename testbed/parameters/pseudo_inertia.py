"""Pseudo-inertia matrices: a body's ten standard parameters as one symmetric matrix.

J = [[S, h], [h', m]] with S the second moments, h the first, m the mass, all about the body
frame's origin. A body of rigid matter can have them if and only if J is positive semidefinite,
and then any J is that of some matter.

Source    [WKS18]
"""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.parameters.barycentric import STANDARD

UPPER = tuple((a, b) for b in range(4) for a in range(b + 1))
"""Entries of the upper triangle, column by column: the order of `coordinates`."""


def _of_standard() -> Array:
    """J of each standard parameter alone, (10, 4, 4)."""
    found = np.zeros((10, 4, 4))
    found[0, 3, 3] = 1.0
    for k in range(3):
        found[1 + k, k, 3] = found[1 + k, 3, k] = 1.0
    for k, name in enumerate(STANDARD[4:], start=4):
        a, b = ("xyz".index(letter) for letter in name[1:])
        if a == b:
            found[k, :3, :3] = np.eye(3) / 2
        found[k, a, b] = found[k, b, a] = -0.5 if a == b else -1.0
    return found


def _of_coordinates() -> Array:
    """The matrix of each coordinate alone, (10, 4, 4), all of norm one."""
    found = np.zeros((10, 4, 4))
    for k, (a, b) in enumerate(UPPER):
        found[k, a, b] = found[k, b, a] = 1.0 if a == b else np.sqrt(0.5)
    return found


OF_STANDARD, OF_COORDINATES = _of_standard(), _of_coordinates()


def matrices(standard: Array) -> Array:
    """J of bodies, (..., 4, 4).

    Args:
        standard: Their standard parameters, (..., 10) [kg, kg m, kg m^2].
    """
    return np.asarray(np.tensordot(standard, OF_STANDARD, 1))


def parameters(matrices: Array) -> Array:
    """Standard parameters of bodies, (..., 10) [kg, kg m, kg m^2].

    Args:
        matrices: Their J, (..., 4, 4), symmetric.
    """
    second = matrices[..., :3, :3]
    spread = np.einsum("...kk->...", second)
    found = [matrices[..., 3, 3], *(matrices[..., k, 3] for k in range(3))]
    for name in STANDARD[4:]:
        a, b = ("xyz".index(letter) for letter in name[1:])
        found.append(spread - second[..., a, a] if a == b else -second[..., a, b])
    return np.stack(found, axis=-1)


def coordinates(matrices: Array) -> Array:
    """The ten coordinates of symmetric matrices, (..., 10): sums of squares are kept.

    Args:
        matrices: (..., 4, 4).
    """
    return np.asarray(np.einsum("...ab,kab->...k", matrices, OF_COORDINATES))


def of_coordinates(coordinates: Array) -> Array:
    """Symmetric matrices of their coordinates, (..., 4, 4).

    Args:
        coordinates: (..., 10).
    """
    return np.asarray(np.tensordot(coordinates, OF_COORDINATES, 1))


def standard_of_coordinates(roots: Array) -> Array:
    """By body, its standard parameters as forms of the coordinates of Y, J = U Y U', (..., 10, 10).

    Args:
        roots: U, (..., 4, 4): makes Y a matrix of numbers near one.
    """
    bodies = np.einsum("...ab,kbc,...dc->...kad", roots, OF_COORDINATES, roots)
    return np.asarray(np.swapaxes(parameters(bodies), -1, -2))
