"""Which equations there are, and how the recursions of `dynamics` give them on symbols."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from testbed.arrays import AnyArray
from testbed.dynamics.kinematics import kinematics
from testbed.dynamics.newton_euler import transmitted
from testbed.parameters.rules import Model
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
        says: What they are, with units and shape.
    """

    name: str
    model: Model
    takes: tuple[str, ...]
    says: str

    @property
    def is_regressor(self) -> bool:
        """Whether there is a column a parameter, and no parameter in them."""
        return self.name.endswith("regressor")


_MOTION = ("q", "qp", "qpp")
KINDS = {
    kind.name: kind
    for kind in (
        Kind(
            "joint-forces", "dynamic", _MOTION,
            "What the motors deliver at the joints, friction excluded [N m or N].",
        ),
        Kind(
            "base-wrench", "reaction", _MOTION,
            "Wrench of the bedplate on the robot about the bedplate's origin, force first "
            "[N, N m].",
        ),
        Kind(
            "dynamic-regressor", "dynamic", _MOTION,
            "phi_d: joint forces for a unit of each parameter.",
        ),
        Kind(
            "reaction-regressor", "reaction", _MOTION,
            "phi_r: the bedplate's wrench for a unit of each parameter.",
        ),
        Kind("mass-matrix", "dynamic", ("q",), "M(q): joint forces for unit accelerations."),
        Kind("gravity-forces", "dynamic", ("q",), "What holds the robot still [N m or N]."),
    )
}  # fmt: skip


Content: TypeAlias = Iterator[tuple[Factor, tuple[tuple[int, ...], Any]]]


def _forces(robot: Robot, theta: AnyArray, names: list[str]) -> Content:
    del names
    forces, _ = _moved(robot, theta, robot.qd, robot.qdd)
    for j in range(robot.n):
        yield _name(f"Q{j + 1}"), ((j,), forces[j, 0])


def _wrench(robot: Robot, theta: AnyArray, names: list[str]) -> Content:
    del names
    _, wrench = _moved(robot, theta, robot.qd, robot.qdd)
    for k, name in enumerate(WRENCH):
        yield _name(name), ((k,), wrench[k, 0])


def _dynamic_regressor(robot: Robot, theta: AnyArray, names: list[str]) -> Content:
    forces, _ = _moved(robot, theta, robot.qd, robot.qdd)
    return _columns(forces, [f"Q{j + 1}" for j in range(robot.n)], names)


def _reaction_regressor(robot: Robot, theta: AnyArray, names: list[str]) -> Content:
    _, wrench = _moved(robot, theta, robot.qd, robot.qdd)
    return _columns(wrench, list(WRENCH), names)


def _mass_matrix(robot: Robot, theta: AnyArray, names: list[str]) -> Content:
    """Column by column: the joint forces of unit accelerations, on the chain to the base."""
    del names
    n = robot.n
    weightless = robot.weightless
    split = "_" if n > 9 else ""
    still = np.zeros(n, dtype=object)
    for j in range(n):
        unit = np.zeros(n, dtype=object)
        unit[j] = 1
        forces, _ = _moved(weightless, theta, still, unit, f"_{j + 1}")
        for i in range(j + 1):
            name = _name(f"M{i + 1}{split}{j + 1}")
            yield name, ((i, j), forces[i, 0])
            if i < j:
                yield _name(f"M{j + 1}{split}{i + 1}"), ((j, i), of(name))


def _gravity_forces(robot: Robot, theta: AnyArray, names: list[str]) -> Content:
    del names
    still = np.zeros(robot.n, dtype=object)
    forces, _ = _moved(robot, theta, still, still)
    for j in range(robot.n):
        yield _name(f"G{j + 1}"), ((j,), forces[j, 0])


CONTENT: dict[str, Callable[[Robot, AnyArray, list[str]], Content]] = {
    "joint-forces": _forces,
    "base-wrench": _wrench,
    "dynamic-regressor": _dynamic_regressor,
    "reaction-regressor": _reaction_regressor,
    "mass-matrix": _mass_matrix,
    "gravity-forces": _gravity_forces,
}


def _moved(
    robot: Robot, theta: AnyArray, qd: AnyArray, qdd: AnyArray, mark: str = ""
) -> tuple[AnyArray, AnyArray]:
    """The recursions of `dynamics` on symbols: joint forces (n, p), base wrench (6, p)."""
    algebra = Symbols(mark)
    moving = kinematics(robot, robot.q, qd, qdd, robot.gravity, algebra)
    return transmitted(robot, moving, theta, algebra)


def _columns(values: AnyArray, rows: list[str], names: list[str]) -> Content:
    """Column by column, those of the first bodies first: what they need is soon done with."""
    for k, name in reversed(list(enumerate(distinct(names)))):
        for i, row in enumerate(rows):
            yield _name(f"phi_{row}_{name}"), ((i, k), values[i, k])


def _name(name: str) -> Factor:
    return Factor(Nature.AUXILIARY, name)
