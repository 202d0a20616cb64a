"""The minimal set: which combinations of the barycentric parameters a measurement can identify.

Source    [FRS96] eqs. (9)-(12); base rule and known zeros in docs/minimal-sets.md
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.core.base.arrays import Array, readonly
from testbed.core.base.codec import named
from testbed.core.base.errors import UnknownName
from testbed.core.base.summary_table import SummaryTable, Value
from testbed.core.parameters.elimination import (
    BEDPLATE,
    Elimination,
    Entry,
    dense_rows,
    dynamic_first,
    eliminate,
    list_entries,
)
from testbed.core.parameters.regroup import Body, Lengths, Namer, regroup
from testbed.core.parameters.rules import MODEL_OF, Model, Signal, Triad, across
from testbed.core.parameters.symbols import (
    Formula,
    Label,
    barycentric,
    on_standard,
    parameter_names,
)
from testbed.core.robot.free_base import FREE
from testbed.core.robot.tree import Tree, require_tree


@dataclass(frozen=True, eq=False, repr=False)
class MinimalSet(Value):
    """The minimal parameters delta = S theta of one model of one robot.

    Attributes:
        model: "dynamic" (joint torques, delta_d) or "reaction" (bedplate wrench, delta_r).
        gravity: The gravity assumed, (3,) [m/s^2], bedplate frame.
        tared: Whether only changes of the bedplate's static wrench count.
        known_zero: Barycentric parameters taken to be zero, (n, 10).
    """

    model: Model
    gravity: Array
    tared: bool
    known_zero: NDArray[np.bool_]
    _tree: Tree
    _bodies: tuple[Body, ...]
    _candidates: tuple[Entry, ...]
    _elimination: Elimination

    __get_pydantic_core_schema__ = named(lambda found: found.model)

    def __repr__(self) -> str:
        return f"<MinimalSet of the {self.model} model, {self.count}: {', '.join(self.names)}>"

    def __str__(self) -> str:
        """All parameters with their formulas."""
        return self.summary.text()

    @property
    def summary(self) -> SummaryTable:
        """Name, unit and formula of each parameter."""
        rows = zip(
            self.names, self.units, (each.said for each in self.formulas), strict=True
        )
        head = f"{self.count} minimal parameters of the {self.model} model of {self.robot.name}"
        return SummaryTable(head, tuple(rows))

    @property
    def robot(self) -> Tree:
        """The robot."""
        return self._tree

    @property
    def of_sensor(self) -> bool:
        """Whether a force sensor in the robot measures the wrench, not the bedplate."""
        return self.model == "reaction" and self._tree.sensor is not None

    @property
    def lead(self) -> int:
        """How many joints move the base of what a force sensor feels; 0 for the bedplate."""
        return self._tree.lead

    @property
    def cuts(self) -> int:
        """How many force sensors' wrenches are taken off the one that it is of."""
        return len(self._tree.cuts)

    @cached_property
    def _entries(self) -> tuple[Entry, ...]:
        return tuple(self._candidates[k] for k in self._elimination.kept)

    @property
    def count(self) -> int:
        """Number N of minimal parameters."""
        return len(self._entries)

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """Names as values: what each is the sum or multiple of."""
        return tuple(entry.label for entry in self._entries)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """One a parameter: mb*2z, K3yy, 2*K3d, ...; stars mark redefined bodies."""
        return tuple(label.text for label in self.labels)

    @property
    def units(self) -> tuple[str, ...]:
        """One a parameter: kg, kg m or kg m^2."""
        return tuple(entry.unit for entry in self._entries)

    @property
    def bodies(self) -> tuple[int, ...]:
        """Index of the body each parameter belongs to; -1 for the bedplate."""
        return tuple(entry.body for entry in self._entries)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Table and row of the rule that keeps each parameter; `rules.REASONS` says it."""
        return tuple(
            "base" if b < 0 else self._bodies[b].row.number for b in self.bodies
        )

    @cached_property
    def never(self) -> tuple[str, ...]:
        """Barycentric parameters that are in no combination at all."""
        unseen = ~self.matrix.any(axis=0) & ~self.known_zero.ravel()
        return tuple(np.array(parameter_names(self._tree))[unseen].tolist())

    @property
    def axial(self) -> tuple[int, ...]:
        """The joint that itself moves the inertia each parameter is, K_ee or mbar; else -1."""
        return tuple(entry.joint for entry in self._entries)

    @property
    def dependent(self) -> tuple[tuple[int, dict[int, float]], ...]:
        """What known zeros make a combination of the minimal parameters.

        Pairs of the joint that itself moves the inertia it is, or -1, and the shares of
        minimal parameters by index.
        """
        place = {candidate: k for k, candidate in enumerate(self._elimination.kept)}
        return tuple(
            (
                self._candidates[c].joint,
                {place[k]: share for k, share in shares.items()},
            )
            for c, shares in self._elimination.dependent.items()
        )

    @cached_property
    def matrix(self) -> Array:
        """S, (N, 10 n), on the barycentric parameters in the order of `barycentric`.

        Columns of parameters known to be zero are zero.
        """
        rows = dense_rows(self._tree, self._bodies, self._entries)
        rows[:, self.known_zero.ravel()] = 0.0
        return readonly(rows, rows.shape, "matrix")

    @cached_property
    def lift(self) -> Array:
        """(10 n, N): a theta that has given minimal parameters, most of it zero.

        S lift = 1, what is known to be zero is zero, and the model does not change by
        theta -> lift S theta.
        """
        lift = self._elimination.lift
        return readonly(self.carried(lift), lift.shape, "lift")

    def carried(self, theta: Array) -> Array:
        """Parameters with what carries a free base's coordinates as heavy as what it carries.

        Args:
            theta: Barycentric parameters, (10 n, ...), those bodies' rows not identified by them.
        """
        found = np.array(theta)
        if self._tree.floating and self._tree.sensor is None:
            found[: 10 * (FREE - 1) : 10] = found[10 * (FREE - 1)]
        return found

    @cached_property
    def standard_matrix(self) -> Array:
        """K: delta on the standard parameters in the order of `standard`, (N, 10 n).

        m mx my mz Ixx Ixy Iyy Ixz Iyz Izz a body, about and along its frame.
        """
        rows = on_standard(self._tree, self.matrix)
        return readonly(rows, self.matrix.shape, "standard_matrix")

    @cached_property
    def formulas(self) -> tuple[Formula, ...]:
        """How each is regrouped from the body's own and its children's parameters."""
        return self.formulas_with("symbols")

    @cached_property
    def auxiliary(self) -> tuple[Formula, ...]:
        """Formulas of the starred parameters which those refer to, tips first."""
        return self.auxiliary_with("symbols")

    def formulas_with(self, lengths: Lengths) -> tuple[Formula, ...]:
        """The formulas, with the model's lengths as symbols or as numbers.

        Args:
            lengths: "symbols" prints l12z, "numbers" its value.
        """
        namer = Namer(self._tree, self._bodies, self.known_zero, lengths)
        return tuple(namer.formula(e.label, e.body, e.form) for e in self._entries)

    def auxiliary_with(self, lengths: Lengths) -> tuple[Formula, ...]:
        """The auxiliary formulas, with the model's lengths as symbols or as numbers.

        Args:
            lengths: "symbols" prints l12z, "numbers" its value.
        """
        namer = Namer(self._tree, self._bodies, self.known_zero, lengths)
        wanted = {
            t.symbol for formula in self.formulas_with(lengths) for t in formula.right
        }
        found: list[Formula] = []
        for body in range(self._tree.n):
            for component in range(1, 10):
                symbol = namer.component(body, component)
                if symbol.star and symbol in wanted:  # what migrates is never kept
                    found.insert(0, namer.redefinition(body, component))
                    wanted |= {term.symbol for term in found[0].right}
        return tuple(found)

    @property
    def triads(self) -> dict[int, Triad]:
        """For bodies whose parameters are named along u, v, w: these, in the body's frame.

        By body index, -1 for the bedplate; w is the joint axis, the only axis of rotation,
        or the direction of gravity.
        """
        found = {
            b: self._bodies[b].row.triad for b in sorted(set(self.bodies)) if b >= 0
        }
        if BEDPLATE in self.bodies:
            found[BEDPLATE] = across(self.gravity / np.linalg.norm(self.gravity))
        return {body: triad for body, triad in found.items() if triad.inclined}

    def values(self, theta: ArrayLike) -> Array:
        """Delta = S theta, (N,), of barycentric parameters theta, (n, 10)."""
        return self.matrix @ np.ravel(np.asarray(theta, dtype=np.float64))


def minimal_set(
    tree: Tree,
    model: Model | Signal,
    gravity: ArrayLike | None = None,
    zeros: bool | Sequence[str] = False,
    tared: bool = False,
) -> MinimalSet:
    """The minimal parameters by the recursive rules, [FRS96] Tables 2-5.

    Order: body by body from the tips to the base, as in the paper; a reaction set starts
    with the parameters it shares with the dynamic one.

    Args:
        tree: The robot; its inertias matter only for `zeros`.
        model: "torque" for joint torques, "wrench" for the bedplate's wrench.
        gravity: Gravity acceleration, (3,) [m/s^2], bedplate frame; default the model file's.
        zeros: Barycentric parameters known to be zero: True for those that are zero in
            the model file, or a list of names such as "mb1x", "K2xy".
        tared: The bedplate's static wrench in one posture has been taken off, so that
            only changes of it count.
    """
    require_tree(tree, "minimal_set(robot, signal)")
    found = MODEL_OF.get(model, model)
    if found not in ("dynamic", "reaction"):
        raise UnknownName("signal", model, MODEL_OF)
    model = found
    g = tree.gravity_or(gravity)
    known_zero = known_zeros(tree, zeros)
    bodies = regroup(tree, model, g, tared=tared)
    entries = list_entries(tree, bodies, model, g, tared)
    if model == "reaction" and not tree.lead:
        entries = dynamic_first(tree, entries, bodies, regroup(tree, "dynamic", g))
    chosen = eliminate(tree, bodies, entries, known_zero)
    return MinimalSet(model, g, tared, known_zero, tree, bodies, tuple(entries), chosen)


def selection(dynamic: MinimalSet, reaction: MinimalSet) -> Array:
    """S with delta_d = S delta_r, (N_d, N_r); [FRS96] eq. (11).

    Every joint torque is a component of a wrench that the bedplate's contains, so S
    exists for every tree; it need not be a selection of entries.

    Args:
        dynamic: delta_d.
        reaction: delta_r of the same robot, gravity and known zeros.

    Raises:
        ValueError: The two sets do not belong together.
    """
    s = dynamic.matrix @ reaction.lift
    s[np.abs(s) < 1e-13] = 0.0
    gap = np.abs(s @ reaction.matrix - dynamic.matrix).max(initial=0.0)
    if gap > 1e-9 * np.abs(dynamic.matrix).max(initial=1.0):
        raise ValueError(f"delta_d is not in the span of delta_r (off by {gap:.1e})")
    return readonly(s, (dynamic.count, reaction.count), "S")


def known_zeros(tree: Tree, zeros: bool | Sequence[str]) -> NDArray[np.bool_]:
    """Which of the barycentric parameters are known to be zero, (n, 10).

    Args:
        tree: The robot.
        zeros: True for those that are zero in the model file, or a list of names.

    Raises:
        UnknownName: The list names a parameter that there is not.
    """
    bare = np.zeros((tree.n, 10), dtype=bool)
    bare[list(tree.bare)] = True
    if isinstance(zeros, bool):
        return bare | _zeros_of_the_file(tree) if zeros else bare
    known = bare.ravel()
    names = parameter_names(tree)
    for name in [zeros] if isinstance(zeros, str) else zeros:
        if name not in names:
            raise UnknownName("barycentric parameter", name, names)
        known[names.index(name)] = True
    return known.reshape(tree.n, 10)


def _zeros_of_the_file(tree: Tree) -> NDArray[np.bool_]:
    theta = np.abs(barycentric(tree))
    mass, moments, tensors = theta[:, :1], theta[:, 1:4], theta[:, 4:]
    tensor = tensors.max(axis=1, keepdims=True)
    # moments may all be rounding: a mass at a distance of the size of the body shows
    moment = np.maximum(moments.max(axis=1, keepdims=True), np.sqrt(mass * tensor))
    scale = np.repeat(np.hstack([mass, moment, tensor]), (1, 3, 6), axis=1)
    # a parameter this much smaller than its body's others of the same unit is zero in the file
    return theta <= 1e-12 * scale
