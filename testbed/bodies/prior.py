"""Prior bodies and rotors of a model file, corrected to be physically possible."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, make_diagnostic
from testbed.core.base.errors import quoted_list
from testbed.core.base.summary_table import Value
from testbed.core.parameters.pseudo_inertia import (
    parameters,
    pseudo_inertias,
    standard_from_coordinates,
)
from testbed.core.parameters.symbols import standard
from testbed.core.robot.inertia import Inertia, upper_cholesky_factor
from testbed.core.robot.placeholders import (
    NO_PLACEHOLDERS,
    Placeholders,
    find_placeholders,
)
from testbed.core.robot.rigid_matter import (
    POINT_MASS_RADIUS_RATIO,
    POINT_MASS_TOLERANCE,
    nearest_consistent_inertia,
)
from testbed.core.robot.tree import Tree

MIN_PRIOR_MOMENT_RATIO = 1e-2
"""Smallest ratio of a body's principal second moments to the greatest."""


@dataclass(frozen=True, eq=False)
class PriorBodies(Diagnosed, Value):
    """Bodies and rotor inertias of a model file, as a prior before any data.

    Attributes:
        standard: Standard parameters m mx my mz Ixx Ixy Iyy Ixz Iyz Izz of possible bodies, about
            and along the body frames, (n, 10) [kg, kg m, kg m^2]; zero for bodies without matter,
            which stay massless whatever the data.
        rotors: Inertias of the drives at their joints, (n,) [kg m^2 or kg]; 0 where not known.
        placeholders: Bodies and friction with placeholder numbers instead of measured ones.
        diagnostics: Corrections of the model file's numbers.
    """

    standard: Array
    rotors: Array
    placeholders: Placeholders = NO_PLACEHOLDERS
    diagnostics: tuple[Diagnostic, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.rotors)
        freeze_arrays(self, standard=(n, 10), rotors=(n,))

    @property
    def massive_bodies(self) -> tuple[int, ...]:
        """Indices of the bodies that have matter."""
        return tuple(int(k) for k in np.flatnonzero(self.standard[:, 0]))

    @property
    def standard_from_coordinates(self) -> Array:
        """Matrix from coordinates of every Y to standard parameters, J = U Y U', (10 n, 10 n).

        J is a body's pseudo-inertia, U U' that of the model file, Y a symmetric (4, 4) matrix with
        ten coordinates in an orthonormal basis; zero for bodies without matter.
        """
        n, massive = len(self.rotors), list(self.massive_bodies)
        roots = np.array(
            [
                upper_cholesky_factor(each)
                for each in pseudo_inertias(self.standard[massive])
            ]
        )
        matrix = np.zeros((n, 10, n, 10))
        matrix[massive, :, massive] = standard_from_coordinates(roots.reshape(-1, 4, 4))
        return matrix.reshape(10 * n, 10 * n)


def prior_of(tree: Tree) -> PriorBodies:
    """Prior bodies of a model file, with impossible inertias replaced by near possible inertias.

    Principal second moments are raised to `MIN_PRIOR_MOMENT_RATIO` (0.01) of the body's greatest. A
    point mass becomes a ball; a body with inertia but without positive mass gets the median mass; a
    body of zeros stays massless. In a file without any mass all bodies are point masses of 1 kg,
    made possible in the same way.

    Args:
        tree: Robot with the bodies of the file.
    """
    bodies = np.array(standard(tree))
    reach = max(
        POINT_MASS_RADIUS_RATIO,
        *(float(np.linalg.norm(joint.offset)) for joint in tree.joints),
    )
    without_masses = not (bodies[:, 0] > 0).any()
    if without_masses:
        bodies[:] = np.eye(1, 10)
    median_mass = float(np.median(bodies[bodies[:, 0] > 0, 0]))
    impossible, massless = [], []
    for body, joint in enumerate(tree.joints):
        pseudo_inertia = pseudo_inertias(bodies[body])
        if not pseudo_inertia.any():
            massless.append(joint.body)
            continue
        if _is_impossible(pseudo_inertia):
            impossible.append(joint.body)
        bodies[body] = parameters(
            nearest_consistent_inertia(
                Inertia.of_pseudo(pseudo_inertia),
                MIN_PRIOR_MOMENT_RATIO,
                median_mass,
                reach,
            ).pseudo
        )
    rotors = np.array([joint.rotor_inertia for joint in tree.joints])
    return PriorBodies(
        bodies,
        rotors,
        find_placeholders(tree),
        tuple(_diagnostics(without_masses, impossible, massless)),
    )


def _is_impossible(body: Array) -> bool:
    """True for the pseudo-inertia, (4, 4), of an impossible body or of a point mass.

    Impossible: no positive mass, or a negative principal second moment beyond rounding.
    """
    mass = body[3, 3]
    if mass <= 0:
        return True
    size = np.linalg.eigvalsh(body[:3, :3] - np.outer(body[:3, 3], body[:3, 3]) / mass)
    tolerance = POINT_MASS_TOLERANCE * float(np.abs(body[:3, :3]).max())
    return bool(size[0] < -tolerance or size[-1] <= tolerance)


def _diagnostics(
    without_masses: bool, impossible: list[str], massless: list[str]
) -> Iterator[Diagnostic]:
    """Diagnostics of a file without masses, else of replaced bodies; and of massless bodies."""
    if without_masses:
        yield make_diagnostic("bodies.no-masses")
    elif impossible:
        yield make_diagnostic("bodies.inertia", quoted_list(impossible))
    if massless:
        yield make_diagnostic("bodies.massless", quoted_list(massless))
