"""Somebody's listing against the robot's own equations, term by term."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from numpy.typing import ArrayLike

from testbed.errors import ExpressionError, UnknownName
from testbed.robot.tree import Tree
from testbed.symbolic.budget import MAX_TERMS, Budget
from testbed.symbolic.equations import FORMS, Form, Listing, equations, writer
from testbed.symbolic.expression import Expression, of, replaced
from testbed.symbolic.kinds import KINDS
from testbed.symbolic.parse import defined_names, read_listing
from testbed.symbolic.robot import Robot, draw


def compare_equations(
    tree: Tree,
    text: str,
    form: Form = "full",
    gravity: ArrayLike | None = None,
    zeros: bool | Sequence[str] = False,
    max_terms: int = MAX_TERMS,
) -> dict[str, Expression]:
    """What a listing says too much or too little, equation by equation.

    Args:
        tree: The robot.
        text: The listing, in the notation of [FRS96]; see `parse.read_listing`. Names on the
            left that are none of the robot's equations are definitions for those below.
        form: Whose parameters it is in: "full" or "reduced" ("recursive" is the same).
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
        zeros: Barycentric parameters known to be zero, as in `equations`.
        max_terms: How many terms the robot's own equations, the listing, and their
            difference may have, each.

    Returns:
        The listing's equation less the robot's own, by name; zero where they are equal,
        whatever way they are written.

    Raises:
        ExpressionError: The listing cannot be read, or there are more terms.
        UnknownName: It holds a name that stands for nothing, or an equation that is none of
            the robot's and no definition for others.
    """
    if form not in FORMS:
        raise UnknownName("form", form, FORMS)
    literal: Form = "full" if form == "full" else "reduced"
    kinds = _kinds(defined_names(text, max_terms))
    listing = equations(tree, kinds, literal, gravity, zeros, max_terms=max_terms)
    robot = draw(tree, tree.gravity_or(gravity))
    steps = [step for each in listing.equations for step in each.program.steps]
    meanings = dict(steps)
    ours = {}
    for name, value in steps:
        meanings[name] = ours[name.name] = replaced(value, meanings.get)
    for label, value in listing.definitions:
        ours[label] = ours[label.replace("mbar", "mm")] = value
    names = _names(listing, robot)
    read = read_listing(text, names, max_terms)
    if not read:
        raise ExpressionError("the listing holds no equation")
    _check_definitions(text, [name for name in read if name not in ours], names, ours)
    found = [name for name in read if name in ours]
    literally = writer(robot, Budget(max_terms))
    return {name: literally(read[name] - ours[name]) for name in found}


def _kinds(names: Iterable[str]) -> list[str]:
    """The kinds of equations that a listing's names belong to."""
    names = list(names)
    comparable = [kind for kind in KINDS.values() if not kind.is_regressor]
    found = [
        kind.name
        for kind in comparable
        if any(re.fullmatch(kind.results, name, re.ASCII) for name in names)
    ]
    return found or [kind.name for kind in comparable]


def _check_definitions(
    text: str, others: Sequence[str], names: Mapping[str, Expression], ours: Iterable[str]
) -> None:
    """What is none of the robot's equations must be new, and of use below."""
    times = Counter(re.findall(r"\w+", text, re.ASCII))
    for name in others:
        if name in names:
            raise ExpressionError(f"'{name}' is the robot's own and not for a listing to define")
        if times[name] < 2:
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
