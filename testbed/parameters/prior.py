"""What a model file says of a robot's bodies and rotors, before any data.

Files hold bodies that cannot be: without inertia, or with principal moments that break the
triangle inequality. As a prior every body is the nearest one that can be. A body without any
matter in a file that gives others their masses is a frame between two joints: it stays so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array, readonly
from testbed.diagnostics.diagnostic import Diagnosed, Diagnostic, diagnose
from testbed.errors import quoted
from testbed.parameters.barycentric import standard
from testbed.parameters.pseudo_inertia import matrices, parameters
from testbed.robot.inertia import ROUNDING, SMALL, Inertia, nearest_body
from testbed.robot.tree import Tree

THINNEST = 1e-2
"""Share of a body's greatest principal second moment that its others have at least."""


@dataclass(frozen=True, eq=False)
class Prior(Diagnosed):
    """Bodies and rotors as a model file has them.

    Attributes:
        standard: Standard parameters, (n, 10) [kg, kg m, kg m^2]; of bodies that can be, or zero
            for those without matter, which have none whatever the data say.
        rotors: Inertias of the drives at their joints, (n,) [kg m^2 or kg]; 0 where not known.
        extent: Least and greatest coordinates of every body's shapes in its own frame,
            (n, 2, 3) [m]; infinite where it has none.
        diagnostics: What was put right.
    """

    standard: Array
    rotors: Array
    extent: Array
    diagnostics: tuple[Diagnostic, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.rotors)
        shapes = {"standard": (n, 10), "rotors": (n,), "extent": (n, 2, 3)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))

    @property
    def massive(self) -> tuple[int, ...]:
        """Bodies that have matter."""
        return tuple(int(k) for k in np.flatnonzero(self.standard[:, 0]))


def prior_of(tree: Tree, extent: Array | None = None) -> Prior:
    """What a model file says of the bodies, put right where no body can be so.

    Args:
        tree: The robot as the file has it.
        extent: As in Prior; by default no body has shapes.
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
    everywhere = np.tile([[-np.inf] * 3, [np.inf] * 3], (tree.n, 1, 1))
    rotors = np.array([joint.rotor_inertia for joint in tree.joints])
    return Prior(
        found,
        rotors,
        everywhere if extent is None else extent,
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
