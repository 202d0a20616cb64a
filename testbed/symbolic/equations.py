"""The equations of a robot: which, in which parameters, in which form.

full       literal, in all barycentric parameters, multiplied out: the listing of [FRS96]
reduced    literal, in the minimal parameters
recursive  in the minimal parameters, with an auxiliary variable for every intermediate

The recursions are those of `dynamics`, run on symbols.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import AnyArray, Array
from testbed.errors import UnknownName
from testbed.parameters.barycentric import UNITS, parameter_symbols
from testbed.parameters.minimal_set import MinimalSet, known_zeros, minimal_set
from testbed.parameters.rules import Model
from testbed.parameters.symbols import Label, Term
from testbed.robot.tree import Tree
from testbed.symbolic.budget import MAX_TERMS, Budget
from testbed.symbolic.definitions import barycentric_definitions
from testbed.symbolic.expression import Expression, Factor, expression, of
from testbed.symbolic.kinds import CONTENT, KINDS, Draft, Kind
from testbed.symbolic.parameters import (
    Parameter,
    all_parameters,
    columns,
    described,
    lifted,
    minimal_parameters,
)
from testbed.symbolic.polynomial import Ring
from testbed.symbolic.program import Program, literal, recursive, with_numbers
from testbed.symbolic.robot import Robot, draw
from testbed.symbolic.tidy import natural_angles, present

Form = Literal["full", "reduced", "recursive"]
ROUNDING = 1e-14
"""Numbers of the geometry are of the order of one; this is their rounding."""

SHORTER = "--form recursive (form='recursive') is far shorter, "

FORMS: tuple[Form, ...] = ("full", "reduced", "recursive")


@dataclass(frozen=True, eq=False)
class Equations:
    """Equations of one kind.

    Attributes:
        kind: Which.
        shape: Of what they give, for one sample.
        places: Where in it each result of the program belongs, by name.
        vector: What the vector of parameters is called: theta, delta_d or delta_r.
        parameters: Its entries.
        program: The lines.
    """

    kind: Kind
    shape: tuple[int, ...]
    places: dict[Factor, tuple[int, ...]]
    vector: str
    parameters: tuple[Parameter, ...]
    program: Program


@dataclass(frozen=True, eq=False)
class Listing:
    """Equations of one robot, and what they are about.

    Attributes:
        tree: The robot.
        form: "full", "reduced" or "recursive".
        gravity: (3,) [m/s^2], bedplate frame.
        constants: Symbols of the geometry and their values [m, m/s^2].
        minimal: The minimal sets that occur, by model.
        known_zero: Barycentric parameters left out because they are known to be zero, (n, 10).
        definitions: In the full form, what the barycentric parameters stand for, by name.
        equations: One of a kind.
    """

    tree: Tree
    form: Form
    gravity: Array
    constants: dict[Factor, float]
    minimal: dict[Model, MinimalSet]
    known_zero: AnyArray
    definitions: tuple[tuple[str, Expression], ...]
    equations: tuple[Equations, ...]


def equations(
    tree: Tree,
    what: str | Sequence[str] = ("joint-forces",),
    form: Form = "full",
    gravity: ArrayLike | None = None,
    zeros: bool | Sequence[str] = False,
    numbers: bool = False,
    max_terms: int = MAX_TERMS,
) -> Listing:
    """Literal equations of a robot.

    Args:
        tree: The robot; its inertias matter only for `zeros`.
        what: Kinds of equations, of `KINDS`.
        form: "full" in all barycentric parameters; "reduced" in the minimal ones;
            "recursive" in the minimal ones with auxiliary variables.
        gravity: (3,) [m/s^2], bedplate frame; default the model file's.
        zeros: Barycentric parameters known to be zero: True for those that are zero in the
            model file, or a list of names.
        numbers: Whether lengths and gravity are written as numbers.
        max_terms: How many terms may be written, those on the way to the equations included.

    Raises:
        UnknownName: There is no such kind or form.
        ExpressionError: The equations have more terms, or numbers too large to calculate with.
    """
    what = [what] if isinstance(what, str) else what
    for name in what:
        if name not in KINDS:
            raise UnknownName("kind of equations", name, tuple(KINDS))
    if form not in FORMS:
        raise UnknownName("form", form, FORMS)
    literal_form = form != "recursive"
    budget = Budget(max_terms, SHORTER if literal_form else "")
    weight, known_zero = tree.gravity_or(gravity), known_zeros(tree, zeros)
    desk = _Desk(tree, form, weight, known_zero, zeros, numbers, budget)
    with _collector_at_rest():
        made = tuple(desk.write(KINDS[name]) for name in dict.fromkeys(what))
    shown = {} if numbers else desk.robot.values
    return Listing(
        tree=tree,
        form=form,
        gravity=desk.gravity,
        constants=shown,
        minimal=desk.minimal,
        known_zero=desk.known_zero,
        definitions=desk.definitions() if form == "full" else (),
        equations=made,
    )


def writer(robot: Robot, budget: Budget) -> Callable[[Any], Expression]:
    """What multiplies expressions of a robot out, and writes them as one would.

    Args:
        robot: Its parallel joints are those whose angles stand together.
        budget: Counts terms.
    """
    ring = Ring([symbols for symbols, _ in robot.parallel], ROUNDING, budget)
    natural = natural_angles(ring, [a for _, chain in robot.parallel for a in chain])

    def written(value: Any) -> Expression:
        multiplied = ring.expand(value)
        budget.write(multiplied.size)
        return present(ring, multiplied, natural)

    return written


@contextmanager
def _collector_at_rest() -> Iterator[None]:
    """No garbage collection: expressions have no cycles, and walking them costs a third."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


@dataclass(eq=False)
class _Desk:
    """Where the equations of one robot are written."""

    tree: Tree
    form: Form
    gravity: Array
    known_zero: AnyArray
    zeros: bool | Sequence[str]
    numbers: bool
    budget: Budget

    def __post_init__(self) -> None:
        self.robot = draw(self.tree, self.gravity)
        self.minimal: dict[Model, MinimalSet] = {}

    @cached_property
    def literally(self) -> Callable[[Any], Expression]:
        """Multiplies out, and writes as one would."""
        return writer(self.robot, self.budget)

    def definitions(self) -> tuple[tuple[str, Expression], ...]:
        """What the barycentric parameters stand for."""
        return tuple(barycentric_definitions(self.tree, self.robot, self.known_zero, self.budget))

    def write(self, kind: Kind) -> Equations:
        """The equations of one kind."""
        vector, parameters, theta = self._parameters(kind)
        draft = Draft(self.robot, theta, tuple(p.name for p in parameters), self.budget)
        values = dict(CONTENT[kind.name](draft))
        rows = 6 if kind.model == "reaction" else self.tree.n
        shape: tuple[int, ...] = (rows,)
        if kind.is_regressor or kind.name == "mass-matrix":
            shape = (rows, len(parameters) if kind.is_regressor else rows)
        results = {name: self._formed(value) for name, (_, value) in values.items()}
        if self.form == "recursive":
            program = recursive(results)
        else:
            program = literal(self._by_reference(kind, results))
        if self.numbers:
            program = with_numbers(program, self.robot.values)
        places = {name: place for name, (place, _) in values.items()}
        return Equations(kind, shape, places, vector, parameters, program)

    def _parameters(self, kind: Kind) -> tuple[str, tuple[Parameter, ...], AnyArray]:
        """Name and entries of the vector, and what each barycentric parameter is, (n, 10, p)."""
        if self.form == "full":
            theta = all_parameters(self.tree, self.known_zero)
            labels = [Label((Term(symbol),)) for symbol in parameter_symbols(self.tree)]
            entries = described(labels, UNITS * self.tree.n, theta.ravel())
            return "theta", entries, columns(self.known_zero) if kind.is_regressor else theta
        minimal = self.minimal.get(kind.model)
        if minimal is None:
            minimal = minimal_set(self.tree, kind.model, self.gravity, self.zeros)
            self.minimal[kind.model] = minimal
        delta = minimal_parameters(minimal)
        entries = described(minimal.labels, minimal.units, delta)
        given = np.eye(len(delta), dtype=int).astype(object)
        theta = lifted(minimal, given if kind.is_regressor else delta[:, None], self.tree.n)
        return f"delta_{kind.model[0]}", entries, theta

    def _formed(self, value: Any) -> Expression:
        """Multiplied out, unless the form is recursive."""
        if self.form == "recursive":
            return expression(value)
        return self.literally(value)

    def _by_reference(
        self, kind: Kind, results: dict[Factor, Expression]
    ) -> dict[Factor, Expression]:
        """Joint forces, tips first; Q2 = Q3 + ... where that is shorter."""
        if kind.name != "joint-forces":
            return results
        shorter = {}
        names = list(results)
        for j in reversed(range(self.tree.n)):
            value = results[names[j]]
            for child, sign in self.robot.continued[j]:
                rest = self._formed(value - results[names[child]] * sign)
                if len(rest.terms) + 1 < len(value.terms):
                    value = rest + of(names[child]) * sign
            shorter[names[j]] = value
        return shorter
