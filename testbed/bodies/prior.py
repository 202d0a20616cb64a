"""Pseudo-inertia matrices, and what a model file says of bodies and rotors before any data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.core.base.errors import quoted
from testbed.core.parameters.symbols import standard
from testbed.core.robot.inertia import ROUNDING, SMALL, Inertia, nearest_body, upper_root
from testbed.core.robot.tree import Tree

UPPER = tuple((a, b) for b in range(4) for a in range(b + 1))
"""Entries of the upper triangle, column by column: the order of `coordinates`."""

ROWS, COLUMNS = (list(each) for each in zip(*UPPER[:6], strict=True))
"""Of an inertia tensor's entries, in the order of STANDARD."""


def _of_coordinates() -> Array:
    """The matrix of each coordinate alone, (10, 4, 4), all of norm one."""
    found = np.zeros((10, 4, 4))
    for k, (a, b) in enumerate(UPPER):
        found[k, a, b] = found[k, b, a] = 1.0 if a == b else np.sqrt(0.5)
    return found


OF_COORDINATES = _of_coordinates()


def matrices(standard: Array) -> Array:
    """J of bodies, (..., 4, 4).

    Args:
        standard: Their standard parameters, (..., 10) [kg, kg m, kg m^2].
    """
    found = np.empty((*standard.shape[:-1], 4, 4))
    found[..., ROWS, COLUMNS] = found[..., COLUMNS, ROWS] = standard[..., 4:]
    found[..., :3, :3] = _complement(found[..., :3, :3], 0.5)
    found[..., 3, :3] = found[..., :3, 3] = standard[..., 1:4]
    found[..., 3, 3] = standard[..., 0]
    return found


def parameters(matrices: Array) -> Array:
    """Standard parameters of bodies, (..., 10) [kg, kg m, kg m^2].

    Args:
        matrices: Their J, (..., 4, 4), symmetric.
    """
    tensor = _complement(matrices[..., :3, :3], 1.0)
    parts = matrices[..., 3, 3:], matrices[..., 3, :3], tensor[..., ROWS, COLUMNS]
    return np.concatenate(parts, axis=-1)


def _complement(tensors: Array, share: float) -> Array:
    """Share of the trace times one, less the tensors, (..., 3, 3): second moments, and back."""
    trace = np.trace(tensors, axis1=-2, axis2=-1)
    return np.asarray(share * trace[..., None, None] * np.eye(3) - tensors)


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
    return np.tensordot(coordinates, OF_COORDINATES, 1)


def standard_of_coordinates(roots: Array) -> Array:
    """By body, its standard parameters as forms of the coordinates of Y, J = U Y U', (..., 10, 10).

    Args:
        roots: U, (..., 4, 4): makes Y a matrix of numbers near one.
    """
    bodies = np.einsum("...ab,kbc,...dc->...kad", roots, OF_COORDINATES, roots)
    return np.swapaxes(parameters(bodies), -1, -2)


THINNEST = 1e-2
"""Share of a body's greatest principal second moment that its others have at least."""


@dataclass(frozen=True, eq=False)
class Prior(Diagnosed):
    """Bodies and rotors as a model file has them.

    Attributes:
        standard: Standard parameters, (n, 10) [kg, kg m, kg m^2]; of bodies that can be, or zero
            for those without matter, which have none whatever the data say.
        rotors: Inertias of the drives at their joints, (n,) [kg m^2 or kg]; 0 where not known.
        diagnostics: What was put right.
    """

    standard: Array
    rotors: Array
    diagnostics: tuple[Diagnostic, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.rotors)
        freeze(self, standard=(n, 10), rotors=(n,))

    @property
    def massive(self) -> tuple[int, ...]:
        """Bodies that have matter."""
        return tuple(int(k) for k in np.flatnonzero(self.standard[:, 0]))

    @property
    def root(self) -> Array:
        """Standard parameters as forms of the coordinates of every Y, J = U Y U', (10 n, 10 n).

        J = U U' is the file's; zero for bodies without matter.
        """
        n, massive = len(self.rotors), list(self.massive)
        roots = np.array([upper_root(each) for each in matrices(self.standard[massive])])
        found = np.zeros((n, 10, n, 10))
        found[massive, :, massive] = standard_of_coordinates(roots.reshape(-1, 4, 4))
        return found.reshape(10 * n, 10 * n)


def prior_of(tree: Tree) -> Prior:
    """What a model file says of the bodies, put right where no body can be so.

    Args:
        tree: The robot as the file has it.
    """
    found = np.array(standard(tree))
    reach = max(SMALL, *(float(np.linalg.norm(joint.offset)) for joint in tree.joints))
    without_masses = not (found[:, 0] > 0).any()
    if without_masses:
        found[:] = np.eye(1, 10)
    usual = float(np.median(found[found[:, 0] > 0, 0]))
    impossible, nothing = [], []
    for body, joint in enumerate(tree.joints):
        given = matrices(found[body])
        if not given.any():
            nothing.append(joint.body)
            continue
        if _is_none(given):
            impossible.append(joint.body)
        found[body] = parameters(
            nearest_body(Inertia.of_pseudo(given), THINNEST, usual, reach).pseudo
        )
    rotors = np.array([joint.rotor_inertia for joint in tree.joints])
    return Prior(
        found,
        rotors,
        tuple(_diagnostics(without_masses, impossible, nothing)),
    )


def _is_none(body: Array) -> bool:
    """Whether no body has such a J, (4, 4), or a point alone has."""
    mass = body[3, 3]
    if mass <= 0:
        return True
    size = np.linalg.eigvalsh(body[:3, :3] - np.outer(body[:3, 3], body[:3, 3]) / mass)
    least = ROUNDING * float(np.abs(body[:3, :3]).max())
    return bool(size[0] < -least or size[-1] <= least)


def _diagnostics(
    without_masses: bool, impossible: list[str], massless: list[str]
) -> Iterator[Diagnostic]:
    """What was put right."""
    if without_masses:
        yield diagnose("bodies.no-masses")
    elif impossible:
        yield diagnose("bodies.inertia", quoted(impossible))
    if massless:
        yield diagnose("bodies.massless", quoted(massless))
