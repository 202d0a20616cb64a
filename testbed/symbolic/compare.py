"""Somebody's listing against the robot's own equations, term by term."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from numpy.typing import ArrayLike

from testbed.errors import ExpressionError, UnknownName
from testbed.robot.tree import Tree
from testbed.symbolic.equations import FORMS, Form, Listing, equations, writer
from testbed.symbolic.expression import Expression, of, replaced
from testbed.symbolic.parse import read_listing
from testbed.symbolic.robot import Robot, draw

COMPARABLE = ("joint-forces", "base-wrench", "mass-matrix", "gravity-forces")


def compare_equations(
    tree: Tree,
    text: str,
    form: Form = "full",
    gravity: ArrayLike | None = None,
    zeros: bool | Sequence[str] = False,
) -> dict[str, Expression]:
    """What a listing says too much or too little, equation by equation.

    Args:
        tree: The robot.
        text: The listing, in the notation of [FRS96]; see `reading.read_listing`. Names on the
            left that are none of the robot's equations are definitions for those below.
        form: Whose parameters it is in: "full" or "reduced" ("recursive" is the same).
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
        zeros: Barycentric parameters known to be zero, as in `equations`.

    Returns:
        The listing's equation less the robot's own, by name; zero where they are equal,
        whatever way they are written.

    Raises:
        ExpressionError: The listing cannot be read.
        UnknownName: It holds a name that stands for nothing, or an equation that is none of
            the robot's and no definition for others.
    """
    if form not in FORMS:
        raise UnknownName("form", form, FORMS)
    literal: Form = "full" if form == "full" else "reduced"
    listing = equations(tree, COMPARABLE, literal, gravity, zeros)
    robot = draw(tree, tree.gravity_or(gravity))
    steps = [step for each in listing.equations for step in each.program.steps]
    meanings = dict(steps)
    ours = {}
    for name, value in steps:
        meanings[name] = ours[name.name] = replaced(value, meanings.get)
    for label, value in listing.definitions:
        ours[label] = ours[label.replace("mbar", "mm")] = value
    names = _names(listing, robot)
    read = read_listing(text, names)
    if not read:
        raise ExpressionError("the listing holds no equation")
    _check_definitions(text, [name for name in read if name not in ours], names, ours)
    found = [name for name in read if name in ours]
    literally = writer(robot)
    return {name: literally(read[name] - ours[name]) for name in found}


def _check_definitions(
    text: str, others: Sequence[str], names: Mapping[str, Expression], ours: Iterable[str]
) -> None:
    """What is none of the robot's equations must be new, and of use below."""
    for name in others:
        if name in names:
            raise ExpressionError(f"'{name}' is the robot's own and not for a listing to define")
        if len(re.findall(rf"\b{name}\b", text)) < 2:
            raise UnknownName("equation", name, ours)


def _names(listing: Listing, robot: Robot) -> dict[str, Expression]:
    """What the names of a listing may stand for."""
    symbols = [*robot.q, *robot.qd, *robot.qdd, *(of(constant) for constant in robot.values)]
    names = {repr(value): value for value in symbols}
    for each in listing.equations:
        for parameter in each.parameters:
            if parameter.symbol is not None:
                names[parameter.symbol.name] = of(parameter.symbol)
    for _, value in listing.definitions:
        names |= {factor.name: of(factor) for factors, _ in value.terms for factor in factors}
    names |= {name.replace("mbar", "mm"): value for name, value in names.items()}
    return names
