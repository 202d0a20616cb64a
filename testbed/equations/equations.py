"""The equations of a robot: which, in which parameters, in which form.

full       literal, in all barycentric parameters, multiplied out: the listing of [FRS96]
reduced    literal, in the minimal parameters
recursive  in the minimal parameters, with an auxiliary variable for every intermediate

The recursions are those of `dynamics`, run on symbols.

Names     w3x, W3xy, F3x of body 3; of many columns F3x_7
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import AnyArray, Array
from testbed.core.base.errors import UnknownName, plural
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.dynamics.newton_euler import kinematics, transmitted
from testbed.core.parameters.minimal_set import MinimalSet, known_zeros, minimal_set
from testbed.core.parameters.rules import Model
from testbed.core.parameters.symbols import UNITS, Label, Term, parameter_symbols
from testbed.core.robot.tree import Tree
from testbed.equations.expression import (
    MAX_TERMS,
    Budget,
    Expression,
    Factor,
    Nature,
    expression,
    of,
)
from testbed.equations.polynomial import Ring
from testbed.equations.program import Program, literal, recursive
from testbed.equations.robot import (
    Parameter,
    SymbolicRobot,
    barycentric,
    barycentric_definitions,
    distinct,
    draw,
    parameters,
)
from testbed.equations.simplify import natural_angles, simplify

Form = Literal["full", "reduced", "recursive"]
FORMS: tuple[Form, ...] = ("full", "reduced", "recursive")
SHORTER = "--form recursive (form='recursive') is far shorter, "
ROUNDING = 1e-14
"""Numbers of the geometry are of the order of one; this is their rounding."""
WRENCH: tuple[str, ...] = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
Content: TypeAlias = Iterator[tuple[Factor, tuple[tuple[int, ...], Any]]]
"""Name, place in the result, and value of each equation."""


def named_components(budget: Budget, mark: str, name: str, value: AnyArray) -> AnyArray:
    """Auxiliary variables for all components that take an operation to compute.

    Args:
        budget: Counts their terms.
        mark: Put behind their names.
        name: w3 gives w3x, W3 of a matrix W3xy, F3 of many columns F3x_7.
        value: (3,), (3, 3) or (3, p).
    """
    kept = np.empty(value.shape, dtype=object)
    for place in np.ndindex(value.shape):
        one = value.item(place)
        component = name + "xyz"[place[0]]
        if name.startswith("W"):
            component += "xyz"[place[1]]
        elif value.size > 3:
            component += f"_{place[1] + 1}"
        kept[place] = auxiliary(component + mark, one)
        if isinstance(one, Expression):
            budget.write(len(one.terms))
    return kept


def auxiliary(name: str, value: Any) -> Any:
    """`value` under a name, unless it is a number, a single factor, or the same for all samples.

    Products of parameters and lengths without a name can cancel.
    """
    if not isinstance(value, Expression) or not value:
        return value
    if len(value.terms) == 1:
        ((factors, size),) = value.terms
        fixed = all(f.nature in (Nature.PARAMETER, Nature.CONSTANT) for f in factors)
        if fixed or (len(factors) == 1 and abs(size) == 1):
            return value
    return of(Factor.of(Nature.AUXILIARY, name, value))


@dataclass(frozen=True, eq=False)
class Recursion:
    """The recursions of `dynamics` on the symbols of a robot.

    Attributes:
        robot: The robot on paper.
        theta: What each barycentric parameter is, (n, 10, p).
        columns: Names of the p columns, where there are several.
        budget: Counts terms.
    """

    robot: SymbolicRobot
    theta: AnyArray
    columns: tuple[str, ...]
    budget: Budget

    def run(
        self, qd: AnyArray, qdd: AnyArray, mark: str = ""
    ) -> tuple[AnyArray, AnyArray]:
        """Joint forces (n, p) and base wrench (6, p).

        Args:
            qd: Velocities, (n,); likewise accelerations qdd.
            qdd: See there.
            mark: Put behind the names of auxiliary variables.
        """
        keep = partial(named_components, self.budget, mark)
        motion = kinematics(self.robot, self.robot.q, qd, qdd, self.robot.gravity, keep)
        return transmitted(self.robot, motion, self.theta, keep)


def _mass_matrix(recursion: Recursion) -> Content:
    """Column by column: the joint forces of unit accelerations, on the chain to the base."""
    n = recursion.robot.n
    still = np.zeros(n, dtype=object)
    weightless = replace(recursion.robot, gravity=np.zeros(3, dtype=object))
    split = "_" if n > 9 else ""
    for j, unit in enumerate(np.eye(n, dtype=int).astype(object)):
        forces, _ = replace(recursion, robot=weightless).run(still, unit, f"_{j + 1}")
        for i in range(j + 1):
            name = _name(f"M{i + 1}{split}{j + 1}")
            yield name, ((i, j), forces[i, 0])
            if i < j:
                yield _name(f"M{j + 1}{split}{i + 1}"), ((j, i), of(name))


def _name(name: str) -> Factor:
    return Factor.of(Nature.AUXILIARY, name)


@dataclass(frozen=True)
class EquationKind:
    """One kind of equations.

    Attributes:
        name: As asked for.
        title: In a listing.
        model: Whose minimal parameters they are in.
        takes: Coordinates they depend on.
        results: What they are called, as a regular expression.
        says: What they are, with units and shape.
        letter: Of names of joint forces; M for the mass matrix.
        is_regressor: Whether there is a column a parameter, and no parameter in them.
    """

    name: str
    title: str
    model: Model
    takes: tuple[str, ...]
    results: str
    says: str
    letter: str = "Q"
    is_regressor: bool = False

    def content(self, recursion: Recursion) -> Content:
        """Name, place and value of each equation."""
        if self.letter == "M":
            yield from _mass_matrix(recursion)
            return
        robot, still = recursion.robot, np.zeros(recursion.robot.n, dtype=object)
        moves = "qp" in self.takes
        forces, wrench = recursion.run(
            *((robot.qd, robot.qdd) if moves else (still, still))
        )
        values, names = wrench, WRENCH
        if self.model == "dynamic":
            values, names = (
                forces,
                tuple(f"{self.letter}{j + 1}" for j in range(robot.n)),
            )
        if not self.is_regressor:
            for i, name in enumerate(names):
                yield _name(name), ((i,), values[i, 0])
            return
        # columns of the first bodies first: what they need is soon done with
        for k, column in reversed(list(enumerate(distinct(recursion.columns)))):
            for i, name in enumerate(names):
                yield _name(f"phi_{name}_{column}"), ((i, k), values[i, k])


_MOTION = ("q", "qp", "qpp")
KINDS = {
    kind.name: kind
    for kind in (
        EquationKind(
            "joint-forces",
            "Equations",
            "dynamic",
            _MOTION,
            r"Q\d+",
            "What the motors deliver at the joints, friction excluded [N m or N].",
        ),
        EquationKind(
            "base-wrench",
            "Reaction",
            "reaction",
            _MOTION,
            r"[FM][xyz]",
            "Wrench of the bedplate on the robot about the bedplate's origin, force first "
            "[N, N m].",
        ),
        EquationKind(
            "dynamic-regressor",
            "Regressor of the joint forces",
            "dynamic",
            _MOTION,
            r"phi_Q\d+_\w+",
            "phi_d: joint forces for a unit of each parameter.",
            is_regressor=True,
        ),
        EquationKind(
            "reaction-regressor",
            "Regressor of the reaction",
            "reaction",
            _MOTION,
            r"phi_[FM][xyz]_\w+",
            "phi_r: the bedplate's wrench for a unit of each parameter.",
            is_regressor=True,
        ),
        EquationKind(
            "mass-matrix",
            "Mass matrix",
            "dynamic",
            ("q",),
            r"M\d+(_\d+)?",
            "M(q): joint forces for unit accelerations.",
            "M",
        ),
        EquationKind(
            "gravity-forces",
            "Gravity",
            "dynamic",
            ("q",),
            r"G\d+",
            "What holds the robot still [N m or N].",
            "G",
        ),
    )
}


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

    kind: EquationKind
    shape: tuple[int, ...]
    places: dict[Factor, tuple[int, ...]]
    vector: str
    parameters: tuple[Parameter, ...]
    program: Program


@dataclass(frozen=True, eq=False, repr=False)
class Listing(Summarized):
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

    @property
    def summary(self) -> SummaryTable:
        """Kinds of equations, their shapes and numbers of lines."""
        rows = [
            (each.kind.name, str(each.shape), plural(len(each.program.lines), "line"))
            for each in self.equations
        ]
        return SummaryTable(f"{self.form} equations of {self.tree.name}", tuple(rows))


def equations(
    tree: Tree,
    what: str | Sequence[str] = ("joint-forces",),
    form: Form = "full",
    gravity: ArrayLike | None = None,
    zeros: bool | Sequence[str] = False,
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
    budget = Budget(max_terms, "" if form == "recursive" else SHORTER)
    weight, known_zero = tree.gravity_or(gravity), known_zeros(tree, zeros)
    robot = draw(tree, weight)
    kinds = [KINDS[name] for name in dict.fromkeys(what)]
    models = dict.fromkeys(kind.model for kind in kinds if form != "full")
    minimal = {model: minimal_set(tree, model, weight, zeros) for model in models}
    listing = Listing(tree, form, weight, robot.values, minimal, known_zero, (), ())
    builder = _Builder(listing, robot, budget, expander(robot, budget))
    results = tuple(map(builder.build, kinds))
    meanings = (
        barycentric_definitions(tree, robot, known_zero, budget)
        if form == "full"
        else ()
    )
    return replace(listing, definitions=tuple(meanings), equations=results)


@dataclass(frozen=True, eq=False)
class _Builder:
    """Derives the equations of one robot."""

    listing: Listing
    robot: SymbolicRobot
    budget: Budget
    expand: Callable[[Any], Expression]

    def build(self, kind: EquationKind) -> Equations:
        """The equations of one kind."""
        vector, own, theta = self._parameters(kind)
        recursion = Recursion(
            self.robot, theta, tuple(p.name for p in own), self.budget
        )
        values = dict(kind.content(recursion))
        places = {name: place for name, (place, _) in values.items()}
        if self.listing.form == "recursive":
            program = recursive(
                {name: expression(value) for name, (_, value) in values.items()}
            )
        else:
            results = {name: self.expand(value) for name, (_, value) in values.items()}
            if kind.name == "joint-forces":
                results = self._by_reference(results)
            program = literal(results)
        rows = 6 if kind.model == "reaction" else self.robot.n
        shape: tuple[int, ...] = (rows,)
        if kind.is_regressor or kind.name == "mass-matrix":
            shape = (rows, len(own) if kind.is_regressor else rows)
        return Equations(kind, shape, places, vector, own, program)

    def _parameters(
        self, kind: EquationKind
    ) -> tuple[str, tuple[Parameter, ...], AnyArray]:
        """Name and entries of the vector, and what each barycentric parameter is, (n, 10, p)."""
        minimal = self.listing.minimal.get(kind.model)
        if minimal is not None:
            vector, lift = f"delta_{kind.model[0]}", minimal.lift
            own = parameters(minimal.labels, minimal.units, minimal.bodies, lift)
        else:
            vector, lift = "theta", np.diag(1.0 - self.listing.known_zero.ravel())
            symbols = parameter_symbols(self.listing.tree)
            labels = [Label((Term(symbol),)) for symbol in symbols]
            bodies = [symbol.bodies[0] - 1 for symbol in symbols]
            own = parameters(labels, UNITS * self.robot.n, bodies, lift)
        return vector, own, barycentric(own, lift, by_column=kind.is_regressor)

    def _by_reference(
        self, results: dict[Factor, Expression]
    ) -> dict[Factor, Expression]:
        """Joint forces, tips first; Q2 = Q3 + ... where that is shorter."""
        shorter = {}
        names = list(results)
        for j in reversed(range(self.robot.n)):
            value = results[names[j]]
            for child, sign in self.robot.continued[j]:
                rest = self.expand(value - results[names[child]] * sign)
                if len(rest.terms) + 1 < len(value.terms):
                    value = rest + of(names[child]) * sign
            shorter[names[j]] = value
        return shorter


def expander(robot: SymbolicRobot, budget: Budget) -> Callable[[Any], Expression]:
    """What multiplies expressions of a robot out, and writes them as one would.

    Args:
        robot: Its parallel joints are those whose angles stand together.
        budget: Counts terms.
    """
    ring = Ring([symbols for symbols, _ in robot.parallel], ROUNDING, budget)
    natural = natural_angles(ring, [a for _, chain in robot.parallel for a in chain])

    def expand(value: Any) -> Expression:
        polynomial = ring.expand(value)
        budget.write(polynomial.size)
        return simplify(ring, polynomial, natural)

    return expand
