"""Bodies and rotors of a model file, as a prior before any data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.core.base.errors import quoted
from testbed.core.base.summary_table import Value
from testbed.core.parameters.pseudo_inertia import (
    matrices,
    parameters,
    standard_of_coordinates,
)
from testbed.core.parameters.symbols import standard
from testbed.core.robot.inertia import Inertia, upper_root
from testbed.core.robot.placeholders import (
    NO_PLACEHOLDERS,
    Placeholders,
    placeholders,
)
from testbed.core.robot.rigid_matter import ROUNDING, SMALL, nearest_body
from testbed.core.robot.tree import Tree

THINNEST = 1e-2
"""Share of a body's greatest principal second moment that its others have at least."""


@dataclass(frozen=True, eq=False)
class Prior(Diagnosed, Value):
    """Bodies and rotors as a model file has them.

    Attributes:
        standard: Standard parameters, (n, 10) [kg, kg m, kg m^2]; of bodies that can be, or zero
            for those without matter, which have none whatever the data say.
        rotors: Inertias of the drives at their joints, (n,) [kg m^2 or kg]; 0 where not known.
        placeholders: Bodies and friction that nobody measured.
        diagnostics: What was put right.
    """

    standard: Array
    rotors: Array
    placeholders: Placeholders = NO_PLACEHOLDERS
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
        roots = np.array(
            [upper_root(each) for each in matrices(self.standard[massive])]
        )
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
        placeholders(tree),
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
