"""Derivation of a robot's symbolic equations, of several kinds and in three forms.

full       literal, in all barycentric parameters, multiplied out: the listing of [FRS96]
reduced    literal, in the minimal parameters
recursive  in the minimal parameters, with an auxiliary variable for every intermediate

The Newton-Euler recursions of `core.dynamics` are run on symbols.

Names     w3x, W3xy, F3x of body 3; F3x_7 for column 7 of a regressor
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import AnyArray, Array
from testbed.core.base.errors import UnknownName, count_with_noun
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.dynamics.newton_euler import backward_recursion, forward_recursion
from testbed.core.parameters.minimal_set import MinimalSet, known_zero_mask, minimal_set
from testbed.core.parameters.rules import Signal
from testbed.core.parameters.symbols import (
    PARAMETER_UNITS,
    Label,
    Term,
    parameter_symbols,
)
from testbed.core.robot.tree import Tree
from testbed.equations.expression import (
    MAX_TERMS,
    Budget,
    Expression,
    Factor,
    FactorKind,
    expression,
    factor_expression,
)
from testbed.equations.polynomial import PolynomialRing
from testbed.equations.program import Program, literal_program, recursive_program
from testbed.equations.robot import (
    Parameter,
    SymbolicRobot,
    barycentric,
    barycentric_definitions,
    parameters,
    symbolic_robot,
    unique_identifiers,
)
from testbed.equations.simplify import body_angles, simplify

Form = Literal["full", "reduced", "recursive"]
FORMS: tuple[Form, ...] = ("full", "reduced", "recursive")
RECURSIVE_FORM_HINT = "--form recursive (form='recursive') is far shorter, "
ROUNDING_TOLERANCE = 1e-14
"""Coefficients below this are rounding errors of zero; lengths are of the order of one."""
WRENCH_NAMES: tuple[str, ...] = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
IndexedEquations: TypeAlias = Iterator[tuple[Factor, tuple[tuple[int, ...], Any]]]
"""Name, indices in the result, and value of each equation."""


def named_components(
    budget: Budget, suffix: str, name: str, value: AnyArray
) -> AnyArray:
    """Replace components that require operations with auxiliary variables.

    Args:
        budget: Counter of terms.
        suffix: Suffix of the variables' names.
        name: Stem of the names: w3 gives w3x; the matrix W3 gives W3xy; F3 with p columns gives
            F3x_7.
        value: Components, (3,), (3, 3) or (3, p).
    """
    variables = np.empty(value.shape, dtype=object)
    for index in np.ndindex(value.shape):
        component_value = value.item(index)
        component_name = name + "xyz"[index[0]]
        if name.startswith("W"):
            component_name += "xyz"[index[1]]
        elif value.size > 3:
            component_name += f"_{index[1] + 1}"
        variables[index] = auxiliary_variable(component_name + suffix, component_value)
        if isinstance(component_value, Expression):
            budget.write(len(component_value.terms))
    return variables


def auxiliary_variable(name: str, value: Any) -> Any:
    """Auxiliary variable for an expression; simple values are returned unchanged.

    Simple values are numbers, single factors, and products of parameters and constants, which can
    cancel if they are not given names.
    """
    if not isinstance(value, Expression) or not value:
        return value
    if len(value.terms) == 1:
        ((factors, coefficient),) = value.terms
        is_constant = all(
            f.kind in (FactorKind.PARAMETER, FactorKind.CONSTANT) for f in factors
        )
        if is_constant or (len(factors) == 1 and abs(coefficient) == 1):
            return value
    return factor_expression(Factor.interned(FactorKind.AUXILIARY, name, value))


@dataclass(frozen=True, eq=False)
class Recursion:
    """Newton-Euler recursions on the symbols of a robot.

    Attributes:
        robot: Symbolic robot.
        theta: Barycentric parameters, (n, 10, p): symbols, or numbers in p regressor columns.
        columns: Names of the parameters of the p columns.
        budget: Counter of terms.
    """

    robot: SymbolicRobot
    theta: AnyArray
    columns: tuple[str, ...]
    budget: Budget

    def run(
        self, qd: AnyArray, qdd: AnyArray, suffix: str = ""
    ) -> tuple[AnyArray, AnyArray]:
        """Joint forces, (n, p), and wrench of the bedplate on the robot, (6, p), for a motion.

        The wrench is about the bedplate's origin, force first.

        Args:
            qd: Joint velocities, (n,).
            qdd: Joint accelerations, (n,).
            suffix: Suffix of the names of auxiliary variables.
        """
        name_variables = partial(named_components, self.budget, suffix)
        motion = forward_recursion(
            self.robot, self.robot.q, qd, qdd, self.robot.gravity, name_variables
        )
        return backward_recursion(self.robot, motion, self.theta, name_variables)


def _mass_matrix(recursion: Recursion) -> IndexedEquations:
    """Yield the entries of the mass matrix, column by column.

    Column j contains the joint forces for a unit acceleration of joint j, without velocity and
    gravity. Entries below the diagonal refer to the entries above the diagonal.
    """
    n = recursion.robot.n
    zero_velocity = np.zeros(n, dtype=object)
    weightless = replace(recursion.robot, gravity=np.zeros(3, dtype=object))
    separator = "_" if n > 9 else ""
    for j, unit in enumerate(np.eye(n, dtype=int).astype(object)):
        forces, _ = replace(recursion, robot=weightless).run(
            zero_velocity, unit, f"_{j + 1}"
        )
        for i in range(j + 1):
            name = _result_symbol(f"M{i + 1}{separator}{j + 1}")
            yield name, ((i, j), forces[i, 0])
            if i < j:
                yield (
                    _result_symbol(f"M{j + 1}{separator}{i + 1}"),
                    ((j, i), factor_expression(name)),
                )


def _result_symbol(name: str) -> Factor:
    """Symbol of a result with a given name."""
    return Factor.interned(FactorKind.AUXILIARY, name)


@dataclass(frozen=True)
class EquationKind:
    """Description of a kind of equations, such as joint forces or the wrench regressor.

    Attributes:
        name: Name of the kind, as in `equations(tree, what=...)`.
        title: Heading in a listing.
        model: Signal whose minimal parameters are used, "torque" or "wrench".
        takes: Arguments of the equations, a selection of q, qp and qpp.
        results: Regular expression of the names of the results.
        description: Description with units, for comments.
        letter: First letter of the results' names: Q, G, or M for the mass matrix.
        is_regressor: True if the result has one column per parameter and contains no parameters.
    """

    name: str
    title: str
    model: Signal
    takes: tuple[str, ...]
    results: str
    description: str
    letter: str = "Q"
    is_regressor: bool = False

    def content(self, recursion: Recursion) -> IndexedEquations:
        """Yield name, indices and value of each equation of this kind."""
        if self.letter == "M":
            yield from _mass_matrix(recursion)
            return
        robot, no_motion = recursion.robot, np.zeros(recursion.robot.n, dtype=object)
        has_motion = "qp" in self.takes
        forces, wrench = recursion.run(
            *((robot.qd, robot.qdd) if has_motion else (no_motion, no_motion))
        )
        values, names = wrench, WRENCH_NAMES
        if self.model == "torque":
            values, names = (
                forces,
                tuple(f"{self.letter}{j + 1}" for j in range(robot.n)),
            )
        if not self.is_regressor:
            for i, name in enumerate(names):
                yield _result_symbol(name), ((i,), values[i, 0])
            return
        # columns of the last bodies first: their intermediates are soon no longer needed
        for k, column in reversed(
            list(enumerate(unique_identifiers(recursion.columns)))
        ):
            for i, name in enumerate(names):
                yield _result_symbol(f"phi_{name}_{column}"), ((i, k), values[i, k])


_MOTION = ("q", "qp", "qpp")
KINDS = {
    kind.name: kind
    for kind in (
        EquationKind(
            "joint-forces",
            "Equations",
            "torque",
            _MOTION,
            r"Q\d+",
            "What the motors deliver at the joints, friction excluded [N m or N].",
        ),
        EquationKind(
            "base-wrench",
            "Reaction",
            "wrench",
            _MOTION,
            r"[FM][xyz]",
            "Wrench of the bedplate on the robot about the bedplate's origin, force first "
            "[N, N m].",
        ),
        EquationKind(
            "torque-regressor",
            "Regressor of the joint forces",
            "torque",
            _MOTION,
            r"phi_Q\d+_\w+",
            "phi_d: joint forces for a unit of each parameter.",
            is_regressor=True,
        ),
        EquationKind(
            "wrench-regressor",
            "Regressor of the reaction",
            "wrench",
            _MOTION,
            r"phi_[FM][xyz]_\w+",
            "phi_r: the bedplate's wrench for a unit of each parameter.",
            is_regressor=True,
        ),
        EquationKind(
            "mass-matrix",
            "Mass matrix",
            "torque",
            ("q",),
            r"M\d+(_\d+)?",
            "M(q): joint forces for unit accelerations.",
            "M",
        ),
        EquationKind(
            "gravity-forces",
            "Gravity",
            "torque",
            ("q",),
            r"G\d+",
            "What holds the robot still [N m or N].",
            "G",
        ),
    )
}


@dataclass(frozen=True, eq=False)
class Equations:
    """Equations of one kind, as a program with its parameters.

    Attributes:
        kind: Kind of the equations.
        shape: Shape of the result for one sample.
        result_indices: Indices in the result array, keyed by name of the program's results.
        parameter_vector_name: Name of the vector of parameters: theta, delta_d or delta_r.
        parameters: Entries of the vector of parameters.
        program: Assignments that compute the result.
    """

    kind: EquationKind
    shape: tuple[int, ...]
    result_indices: dict[Factor, tuple[int, ...]]
    parameter_vector_name: str
    parameters: tuple[Parameter, ...]
    program: Program


@dataclass(frozen=True, eq=False, repr=False)
class Listing(Summarized):
    """Symbolic equations of one robot, with its constants and parameter sets.

    Attributes:
        tree: The robot.
        form: "full", "reduced" or "recursive".
        gravity: Gravity in the bedplate frame, (3,) [m/s^2].
        constants: Values of the symbols of lengths [m] and of gravity [m/s^2].
        minimal: Minimal sets of the parameters in use, keyed by signal; empty for the full form.
        known_zero: Mask of the barycentric parameters that are known to be zero, (n, 10).
        definitions: Names and definitions of the barycentric parameters, in the full form.
        equations: Equations of each requested kind.
    """

    tree: Tree
    form: Form
    gravity: Array
    constants: dict[Factor, float]
    minimal: dict[Signal, MinimalSet]
    known_zero: AnyArray
    definitions: tuple[tuple[str, Expression], ...]
    equations: tuple[Equations, ...]

    @property
    def summary(self) -> SummaryTable:
        """Table with kind, shape and number of lines of the equations."""
        rows = [
            (
                each.kind.name,
                str(each.shape),
                count_with_noun(len(each.program.lines), "line"),
            )
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
    """Derive the symbolic equations of a robot.

    Args:
        tree: The robot; its inertias matter only for `zeros`.
        what: Kinds of equations, keys of `KINDS`.
        form: "full" in all barycentric parameters; "reduced" in the minimal parameters;
            "recursive" in the minimal parameters with auxiliary variables.
        gravity: Gravity in the bedplate frame, (3,) [m/s^2]; None for the gravity of the model
            file.
        zeros: Barycentric parameters known to be zero: True for all that are zero in the
            model file, or a list of names.
        max_terms: Largest number of terms, including terms of intermediate expressions.

    Raises:
        UnknownName: The kind or form does not exist.
        ExpressionError: There are more terms than `max_terms`, or numbers that are too large.
    """
    what = [what] if isinstance(what, str) else what
    for name in what:
        if name not in KINDS:
            raise UnknownName("kind of equations", name, tuple(KINDS))
    if form not in FORMS:
        raise UnknownName("form", form, FORMS)
    budget = Budget(max_terms, "" if form == "recursive" else RECURSIVE_FORM_HINT)
    weight, known_zero = tree.gravity_or(gravity), known_zero_mask(tree, zeros)
    robot = symbolic_robot(tree, weight)
    kinds = [KINDS[name] for name in dict.fromkeys(what)]
    models = dict.fromkeys(kind.model for kind in kinds if form != "full")
    minimal = {model: minimal_set(tree, model, weight, zeros) for model in models}
    listing = Listing(tree, form, weight, robot.values, minimal, known_zero, (), ())
    builder = _Builder(listing, robot, budget, make_expander(robot, budget))
    results = tuple(map(builder.build, kinds))
    meanings = (
        barycentric_definitions(tree, robot, known_zero, budget)
        if form == "full"
        else ()
    )
    return replace(listing, definitions=tuple(meanings), equations=results)


@dataclass(frozen=True, eq=False)
class _Builder:
    """Derivation of the equations of one robot, kind by kind.

    Attributes:
        listing: Listing without equations: the robot, the form and the parameter sets.
        robot: Symbolic robot.
        budget: Counter of terms.
        expand: Function that expands an expression into simplified terms (`make_expander`).
    """

    listing: Listing
    robot: SymbolicRobot
    budget: Budget
    expand: Callable[[Any], Expression]

    def build(self, kind: EquationKind) -> Equations:
        """Derive the equations of one kind."""
        vector, entries, theta = self._parameter_vector(kind)
        recursion = Recursion(
            self.robot, theta, tuple(p.name for p in entries), self.budget
        )
        values = dict(kind.content(recursion))
        indices = {name: index for name, (index, _) in values.items()}
        if self.listing.form == "recursive":
            program = recursive_program(
                {name: expression(value) for name, (_, value) in values.items()}
            )
        else:
            results = {name: self.expand(value) for name, (_, value) in values.items()}
            if kind.name == "joint-forces":
                results = self._with_references(results)
            program = literal_program(results)
        rows = 6 if kind.model == "wrench" else self.robot.n
        shape: tuple[int, ...] = (rows,)
        if kind.is_regressor or kind.name == "mass-matrix":
            shape = (rows, len(entries) if kind.is_regressor else rows)
        return Equations(kind, shape, indices, vector, entries, program)

    def _parameter_vector(
        self, kind: EquationKind
    ) -> tuple[str, tuple[Parameter, ...], AnyArray]:
        """Name and entries of a kind's parameter vector, and the barycentric parameters.

        The barycentric parameters are symbols, (n, 10, 1), or for a regressor numbers, (n, 10, p),
        with one column for each of the p entries of the vector.
        """
        minimal = self.listing.minimal.get(kind.model)
        if minimal is not None:
            vector, lift = f"delta_{kind.model[0]}", minimal.lift
            entries = parameters(minimal.labels, minimal.units, minimal.bodies, lift)
        else:
            vector, lift = "theta", np.diag(1.0 - self.listing.known_zero.ravel())
            symbols = parameter_symbols(self.listing.tree)
            labels = [Label((Term(symbol),)) for symbol in symbols]
            bodies = [symbol.bodies[0] - 1 for symbol in symbols]
            entries = parameters(labels, PARAMETER_UNITS * self.robot.n, bodies, lift)
        return vector, entries, barycentric(entries, lift, by_column=kind.is_regressor)

    def _with_references(
        self, results: dict[Factor, Expression]
    ) -> dict[Factor, Expression]:
        """Express joint forces in terms of child joints' forces if that is shorter: Q2 = Q3 + ...

        The joints of the last bodies are processed first.
        """
        shortened = {}
        names = list(results)
        for j in reversed(range(self.robot.n)):
            value = results[names[j]]
            for child, sign in self.robot.parallel_children[j]:
                rest = self.expand(value - results[names[child]] * sign)
                if len(rest.terms) + 1 < len(value.terms):
                    value = rest + factor_expression(names[child]) * sign
            shortened[names[j]] = value
        return shortened


def make_expander(robot: SymbolicRobot, budget: Budget) -> Callable[[Any], Expression]:
    """Function that expands and simplifies expressions of a robot.

    Args:
        robot: Symbolic robot; its groups of parallel joints define the sums of angles.
        budget: Counter of terms.
    """
    ring = PolynomialRing(
        [symbols for symbols, _ in robot.parallel_groups], ROUNDING_TOLERANCE, budget
    )
    angles = body_angles(ring, [a for _, chain in robot.parallel_groups for a in chain])

    def expand(value: Any) -> Expression:
        polynomial = ring.expand(value)
        budget.write(polynomial.size)
        return simplify(ring, polynomial, angles)

    return expand
