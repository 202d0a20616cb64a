"""What a model file says of a robot's bodies and rotors, before any data.

Files hold bodies that cannot be: without inertia, or with principal moments that break the
triangle inequality. As a prior every body is the nearest one that can be. A body without any
matter in a file that gives others their masses is a frame between two joints: it stays so.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array, readonly
from testbed.parameters.barycentric import standard
from testbed.parameters.pseudo_inertia import matrices, nearest_definite, parameters
from testbed.robot.tree import Tree

THINNEST = 1e-2
"""Share of a body's greatest principal second moment that its others have at least."""

ROUNDING = 1e-9
"""Share below zero that is rounding in a file: of a rod or a plate."""

SMALL = 0.1
"""Radius of gyration of a point mass, in parts of its distance or of the robot's lengths."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Bodies and rotors as a model file has them.

    Attributes:
        standard: Standard parameters, (n, 10) [kg, kg m, kg m^2]; of bodies that can be, or zero
            for those without matter, which have none whatever the data say.
        rotors: Inertias of the drives at their joints, (n,) [kg m^2 or kg]; 0 where not known.
        extent: Least and greatest coordinates of every body's shapes in its own frame,
            (n, 2, 3) [m]; infinite where it has none.
        warnings: What was put right, a line each.
    """

    standard: Array
    rotors: Array
    extent: Array
    warnings: tuple[str, ...] = ()

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
    warnings: list[str] = []
    reach = max(SMALL, *(float(np.linalg.norm(joint.offset)) for joint in tree.joints))
    if not (found[:, 0] > 0).any():
        found[:] = 0.0
        found[:, 0] = 1.0
        warnings.append(
            "the model file gives no body a mass: what the data do not tell is of bodies of 1 kg"
        )
    whole = matrices(found)
    for body, joint in enumerate(tree.joints):
        if not found[body].any():
            continue
        put_right = _possible(whole[body], reach, float(np.median(found[found[:, 0] > 0, 0])))
        size = float(np.abs(np.linalg.eigvalsh(whole[body])).max())
        if np.linalg.eigvalsh(whole[body])[0] < -ROUNDING * size and not warnings:
            warnings.append(
                f"the model file's '{joint.body}' is no possible body; the nearest one is taken"
            )
        found[body] = parameters(put_right)
    nothing = [joint.body for joint, own in zip(tree.joints, found, strict=True) if not own.any()]
    warnings += _without_matter(nothing)
    everywhere = np.tile([[-np.inf] * 3, [np.inf] * 3], (tree.n, 1, 1))
    rotors = np.array([joint.rotor_inertia for joint in tree.joints])
    return Prior(found, rotors, everywhere if extent is None else extent, tuple(warnings))


def _possible(body: Array, reach: float, mass: float) -> Array:
    """J of the nearest body that can be, (4, 4)."""
    if body[3, 3] <= 0:
        body = np.array(body)
        body[3, 3], body[:3, 3], body[3, :3] = mass, 0.0, 0.0
    centre = body[:3, 3] / body[3, 3]
    central = body[:3, :3] - body[3, 3] * np.outer(centre, centre)
    if np.linalg.eigvalsh(central)[-1] <= ROUNDING * np.abs(body[:3, :3]).max():
        radius = SMALL * (float(np.linalg.norm(centre)) or reach)
        body = np.array(body)
        body[:3, :3] += body[3, 3] * radius**2 * np.eye(3) / 3 - central
    return nearest_definite(body, THINNEST)


def _without_matter(names: list[str]) -> Iterable[str]:
    """What to know of bodies without matter."""
    if names:
        listed = ", ".join(f"'{name}'" for name in names[:6]) + ", ..." * (len(names) > 6)
        yield f"{listed} has no matter in the model file, and none is looked for"
