"""Which equations there are, and how the recursions of `dynamics` give them on symbols."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from testbed.arrays import AnyArray
from testbed.dynamics.kinematics import kinematics
from testbed.dynamics.newton_euler import transmitted
from testbed.parameters.rules import Model
from testbed.symbolic.budget import Budget
from testbed.symbolic.expression import Factor, Nature, of
from testbed.symbolic.parameters import distinct
from testbed.symbolic.robot import Robot
from testbed.symbolic.symbol_algebra import Symbols

WRENCH = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


@dataclass(frozen=True)
class Kind:
    """One kind of equations.

    Attributes:
        name: As asked for.
        model: Whose minimal parameters they are in.
        takes: Coordinates they depend on.
        results: What they are called, as a regular expression.
        says: What they are, with units and shape.
        is_regressor: Whether there is a column a parameter, and no parameter in them.
    """

    name: str
    model: Model
    takes: tuple[str, ...]
    results: str
    says: str
    is_regressor: bool = False


_MOTION = ("q", "qp", "qpp")
KINDS = {
    kind.name: kind
    for kind in (
        Kind(
            "joint-forces", "dynamic", _MOTION, r"Q\d+",
            "What the motors deliver at the joints, friction excluded [N m or N].",
        ),
        Kind(
            "base-wrench", "reaction", _MOTION, r"[FM][xyz]",
            "Wrench of the bedplate on the robot about the bedplate's origin, force first "
            "[N, N m].",
        ),
        Kind(
            "dynamic-regressor", "dynamic", _MOTION, r"phi_Q\d+_\w+",
            "phi_d: joint forces for a unit of each parameter.", is_regressor=True,
        ),
        Kind(
            "reaction-regressor", "reaction", _MOTION, r"phi_[FM][xyz]_\w+",
            "phi_r: the bedplate's wrench for a unit of each parameter.", is_regressor=True,
        ),
        Kind(
            "mass-matrix", "dynamic", ("q",), r"M\d+(_\d+)?",
            "M(q): joint forces for unit accelerations.",
        ),
        Kind(
            "gravity-forces", "dynamic", ("q",), r"G\d+",
            "What holds the robot still [N m or N].",
        ),
    )
}  # fmt: skip


Content: TypeAlias = Iterator[tuple[Factor, tuple[tuple[int, ...], Any]]]


@dataclass(frozen=True, eq=False)
class Draft:
    """What equations are made of.

    Attributes:
        robot: The robot on paper.
        theta: What each barycentric parameter is, (n, 10, p).
        names: Of the p columns, where there are several.
        budget: Counts terms.
    """

    robot: Robot
    theta: AnyArray
    names: tuple[str, ...]
    budget: Budget

    def moved(self, qd: AnyArray, qdd: AnyArray, mark: str = "") -> tuple[AnyArray, AnyArray]:
        """The recursions of `dynamics` on symbols: joint forces (n, p), base wrench (6, p)."""
        algebra = Symbols(self.budget, mark)
        moving = kinematics(self.robot, self.robot.q, qd, qdd, self.robot.gravity, algebra)
        return transmitted(self.robot, moving, self.theta, algebra)


def _forces(draft: Draft) -> Content:
    forces, _ = draft.moved(draft.robot.qd, draft.robot.qdd)
    for j in range(draft.robot.n):
        yield _name(f"Q{j + 1}"), ((j,), forces[j, 0])


def _wrench(draft: Draft) -> Content:
    _, wrench = draft.moved(draft.robot.qd, draft.robot.qdd)
    for k, name in enumerate(WRENCH):
        yield _name(name), ((k,), wrench[k, 0])


def _dynamic_regressor(draft: Draft) -> Content:
    forces, _ = draft.moved(draft.robot.qd, draft.robot.qdd)
    return _columns(forces, [f"Q{j + 1}" for j in range(draft.robot.n)], draft.names)


def _reaction_regressor(draft: Draft) -> Content:
    _, wrench = draft.moved(draft.robot.qd, draft.robot.qdd)
    return _columns(wrench, WRENCH, draft.names)


def _mass_matrix(draft: Draft) -> Content:
    """Column by column: the joint forces of unit accelerations, on the chain to the base."""
    n = draft.robot.n
    weightless = replace(draft, robot=draft.robot.weightless)
    split = "_" if n > 9 else ""
    still = np.zeros(n, dtype=object)
    for j in range(n):
        unit = np.zeros(n, dtype=object)
        unit[j] = 1
        forces, _ = weightless.moved(still, unit, f"_{j + 1}")
        for i in range(j + 1):
            name = _name(f"M{i + 1}{split}{j + 1}")
            yield name, ((i, j), forces[i, 0])
            if i < j:
                yield _name(f"M{j + 1}{split}{i + 1}"), ((j, i), of(name))


def _gravity_forces(draft: Draft) -> Content:
    still = np.zeros(draft.robot.n, dtype=object)
    forces, _ = draft.moved(still, still)
    for j in range(draft.robot.n):
        yield _name(f"G{j + 1}"), ((j,), forces[j, 0])


CONTENT: dict[str, Callable[[Draft], Content]] = {
    "joint-forces": _forces,
    "base-wrench": _wrench,
    "dynamic-regressor": _dynamic_regressor,
    "reaction-regressor": _reaction_regressor,
    "mass-matrix": _mass_matrix,
    "gravity-forces": _gravity_forces,
}


def _columns(values: AnyArray, rows: Sequence[str], names: Sequence[str]) -> Content:
    """Column by column, those of the first bodies first: what they need is soon done with."""
    for k, name in reversed(list(enumerate(distinct(names)))):
        for i, row in enumerate(rows):
            yield _name(f"phi_{row}_{name}"), ((i, k), values[i, k])


def _name(name: str) -> Factor:
    return Factor(Nature.AUXILIARY, name)
