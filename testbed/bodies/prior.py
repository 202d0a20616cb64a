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
        standard: Standard parameters m mx my mz Ixx Ixy Iyy Ixz Iyz Izz of physically possible
            bodies, in the body frames, (n, 10) [kg, kg m, kg m^2]; zero for massless bodies, which
            stay massless for any data.
        rotors: Inertias of the drives at their joints, (n,) [kg m^2 or kg]; 0 where not known.
        placeholders: Bodies and friction with placeholder numbers instead of measured values.
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
        """Indices of the bodies with mass."""
        return tuple(int(k) for k in np.flatnonzero(self.standard[:, 0]))

    @property
    def standard_from_coordinates(self) -> Array:
        """Matrix from the coordinates of every matrix Y to standard parameters, (10 n, 10 n).

        The pseudo-inertia of a body is J = U Y U', where U U' is the pseudo-inertia in the model
        file and Y is a symmetric (4, 4) matrix with ten coordinates in an orthonormal basis. The
        entries for massless bodies are zero.
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
    """Prior bodies of a model file, with impossible inertias replaced by nearby possible inertias.

    Principal second moments are raised to at least `MIN_PRIOR_MOMENT_RATIO` (0.01) times the
    largest of the body. A point mass becomes a ball; a body with inertia but without positive mass
    gets the median mass; a body whose parameters are all zero stays massless. If no body in the
    file has a mass, all bodies become point masses of 1 kg, which are then replaced by balls.

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
    """Test whether a pseudo-inertia, (4, 4), belongs to an impossible body or a point mass.

    A body is impossible if its mass is not positive or a principal second moment is negative beyond
    rounding.
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
    """Diagnostics of missing masses, replaced inertias and massless bodies.

    Replaced inertias are not reported for a file without masses.
    """
    if without_masses:
        yield make_diagnostic("bodies.no-masses")
    elif impossible:
        yield make_diagnostic("bodies.inertia", quoted_list(impossible))
    if massless:
        yield make_diagnostic("bodies.massless", quoted_list(massless))
