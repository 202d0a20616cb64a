"""The minimal set: which combinations of the barycentric parameters a measurement can tell.

Source    [FRS96] eqs. (9)-(12); base rule and known zeros in docs/minimal-sets.md
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.arrays import Array, readonly
from testbed.errors import UnknownName
from testbed.parameters.barycentric import barycentric, parameter_names, standard_to_barycentric
from testbed.parameters.entries import (
    Entry,
    dense_directions,
    dense_rows,
    dynamic_first,
    independent_rows,
    list_entries,
    present_parameters,
)
from testbed.parameters.formulas import Lengths, Namer
from testbed.parameters.regroup import Body, regroup
from testbed.parameters.rules import Model, across
from testbed.robot.tree import Tree

NO_MATTER = 1e-12
"""A parameter this much smaller than its body's others of the same unit is zero in the file."""


@dataclass(frozen=True, eq=False)
class MinimalSet:
    """The minimal parameters delta = S theta of one model of one robot.

    Attributes:
        model: "dynamic" (joint torques, delta_d) or "reaction" (bedplate wrench, delta_r).
        gravity: The gravity assumed, (3,) [m/s^2], bedplate frame.
        tared: Whether only changes of the bedplate's static wrench count.
    """

    model: Model
    gravity: Array
    tared: bool
    _tree: Tree
    _bodies: tuple[Body, ...]
    _known_zero: NDArray[np.bool_]
    _candidates: tuple[Entry, ...]
    _keep: tuple[int, ...]

    @cached_property
    def _entries(self) -> tuple[Entry, ...]:
        return tuple(self._candidates[k] for k in self._keep)

    @property
    def names(self) -> tuple[str, ...]:
        """One a parameter: mb*2z, K3yy, 2*K3d, ...; stars mark redefined bodies."""
        return tuple(entry.name for entry in self._entries)

    @property
    def units(self) -> tuple[str, ...]:
        """One a parameter: kg, kg m or kg m^2."""
        return tuple(entry.unit for entry in self._entries)

    @property
    def bodies(self) -> tuple[int, ...]:
        """Index of the body each parameter belongs to; -1 for the bedplate."""
        return tuple(entry.body for entry in self._entries)

    @property
    def axial(self) -> tuple[int, ...]:
        """Index of the body whose inertia along or about its own joint each is; else -1."""
        return tuple(entry.body if entry.axial else -1 for entry in self._entries)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Table and row of the rule that keeps each parameter; `rules.REASONS` says it."""
        return tuple("base" if b < 0 else self._bodies[b].row.number for b in self.bodies)

    @property
    def known_zero(self) -> NDArray[np.bool_]:
        """Barycentric parameters taken to be zero, (n, 10)."""
        return self._known_zero

    @property
    def never(self) -> tuple[str, ...]:
        """Barycentric parameters that are in no combination at all."""
        unseen = ~self.matrix.any(axis=0) & ~self._known_zero.ravel()
        return tuple(np.array(parameter_names(self._tree))[unseen].tolist())

    @cached_property
    def matrix(self) -> Array:
        """S, (N, 10 n), on the barycentric parameters in the order of `barycentric`."""
        rows = _rows(self._tree, self._bodies, self._entries, self._known_zero)
        return readonly(rows, rows.shape, "matrix")

    @cached_property
    def lift(self) -> Array:
        """(10 n, N): a theta that has given minimal parameters, eliminated ones zero.

        S lift = 1, and the model does not change by theta -> lift S theta.
        """
        lift = dense_directions(self._tree, self._candidates)
        if self._known_zero.any():
            rows = _rows(self._tree, self._bodies, self._candidates, self._known_zero)
            lift = lift @ _coordinates(rows, list(self._keep)).T
        return readonly(lift, lift.shape, "lift")

    @cached_property
    def standard_matrix(self) -> Array:
        """K: delta on the standard parameters in the order of `standard`, (N, 10 n).

        m mx my mz Ixx Ixy Iyy Ixz Iyz Izz a body, about and along its frame.
        """
        rows = self.matrix @ standard_to_barycentric(self._tree)
        return readonly(rows, self.matrix.shape, "standard_matrix")

    @property
    def count(self) -> int:
        """Number N of minimal parameters."""
        return len(self._keep)

    @cached_property
    def formulas(self) -> tuple[str, ...]:
        """How each is regrouped from the body's own and its children's parameters."""
        return self.formulas_with("symbols")

    @cached_property
    def auxiliary(self) -> tuple[str, ...]:
        """Formulas of the starred parameters which those refer to, tips first."""
        return self.auxiliary_with("symbols")

    def formulas_with(self, lengths: Lengths) -> tuple[str, ...]:
        """The formulas, with the model's lengths as symbols or as numbers.

        Args:
            lengths: "symbols" prints l12z, "numbers" its value.
        """
        namer = self._namer(lengths)
        return tuple(namer.formula(e.name, e.body, e.form) for e in self._entries)

    def auxiliary_with(self, lengths: Lengths) -> tuple[str, ...]:
        """The auxiliary formulas, with the model's lengths as symbols or as numbers.

        Args:
            lengths: "symbols" prints l12z, "numbers" its value.
        """
        namer = self._namer(lengths)
        wanted = _words(self.formulas_with(lengths)) - set(self.names)
        found: list[str] = []
        for body in range(len(namer.bodies)):
            for component in range(1, 10):
                name = namer.component(body, component)
                if "*" in name and name in wanted:
                    found.insert(0, namer.formula(name, body, np.eye(10)[component]))
                    wanted |= _words(found[:1]) - set(self.names)
        return tuple(found)

    @property
    def triads(self) -> dict[int, Array]:
        """For bodies whose parameters are named along u, v, w: these, as rows, (3, 3).

        By body index, in the body's frame; w is the joint axis or the only axis of rotation.
        """
        found: dict[int, Array] = {}
        for body in {e.body for e in self._entries if e.body >= 0 and set(e.name) & set("uvw")}:
            kept = {k.tail: k.form[1:4] for k in self._bodies[body].row.kept if k.head == "mb"}
            u, v, _ = across(self._tree.joints[body].axis)
            u, v = kept.get("u", u), kept.get("v", v)
            found[body] = readonly([u, v, np.cross(u, v)], (3, 3), "triad")
        return dict(sorted(found.items()))

    def _namer(self, lengths: Lengths) -> Namer:
        present = present_parameters(self._tree, self._bodies, self._known_zero)
        return Namer(self._tree, self._bodies, self._known_zero, present, lengths)

    def values(self, theta: ArrayLike) -> Array:
        """Delta = S theta, (N,), of barycentric parameters theta, (n, 10)."""
        delta: Array = self.matrix @ np.ravel(np.asarray(theta, dtype=np.float64))
        return delta


def minimal_set(
    tree: Tree,
    model: Model,
    gravity: ArrayLike | None = None,
    zeros: bool | Sequence[str] = False,
    tared: bool = False,
) -> MinimalSet:
    """The minimal parameters by the recursive rules, [FRS96] Tables 2-5.

    Order: body by body from the tips to the base, as in the paper; a reaction set starts
    with the parameters it shares with the dynamic one.

    Args:
        tree: The robot; its inertias matter only for `zeros`.
        model: "dynamic" for joint torques, "reaction" for the bedplate's wrench.
        gravity: Gravity acceleration, (3,) [m/s^2], bedplate frame; default the model file's.
        zeros: Barycentric parameters known to be zero: True for those that are zero in
            the model file, or a list of names such as "mb1x", "K2xy".
        tared: The bedplate's static wrench in one posture has been taken off, so that
            only changes of it count.
    """
    if model not in ("dynamic", "reaction"):
        raise UnknownName("model", model, ("dynamic", "reaction"))
    g = tree.gravity_or(gravity)
    known_zero = known_zeros(tree, zeros)
    bodies = regroup(tree, model, g)
    entries = list_entries(tree, bodies, model, g, tared)
    if model == "reaction":
        entries = dynamic_first(tree, entries, bodies, regroup(tree, "dynamic", g))
    keep = list(range(len(entries)))
    if known_zero.any():
        keep = independent_rows(_rows(tree, bodies, entries, known_zero))
    return MinimalSet(model, g, tared, tree, bodies, known_zero, tuple(entries), tuple(keep))


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
    known = np.zeros(10 * tree.n, dtype=bool)
    if isinstance(zeros, bool):
        return _zeros_of_the_file(tree) if zeros else known.reshape(tree.n, 10)
    names = parameter_names(tree)
    for name in [zeros] if isinstance(zeros, str) else zeros:
        if name not in names:
            raise UnknownName("barycentric parameter", name, names)
        known[names.index(name)] = True
    return known.reshape(tree.n, 10)


def _zeros_of_the_file(tree: Tree) -> NDArray[np.bool_]:
    theta = np.abs(barycentric(tree))
    zero = np.zeros(theta.shape, dtype=bool)
    for columns in (slice(0, 1), slice(1, 4), slice(4, 10)):
        scale = theta[:, columns].max(axis=1, keepdims=True)
        zero[:, columns] = theta[:, columns] <= NO_MATTER * scale
    return zero


def _rows(
    tree: Tree, bodies: Sequence[Body], entries: Sequence[Entry], known_zero: NDArray[np.bool_]
) -> Array:
    """Entries on the barycentric parameters, those known to be zero struck out."""
    rows = dense_rows(tree, bodies, entries)
    rows[:, known_zero.ravel()] = 0.0
    return rows


def _coordinates(rows: Array, keep: list[int]) -> Array:
    """How much of each kept row every row holds, (kept, all): the identity on those kept."""
    coordinates = np.zeros((len(keep), len(rows)))
    coordinates[range(len(keep)), keep] = 1.0
    dropped = [k for k in range(len(rows)) if k not in keep and rows[k].any()]
    if dropped:
        coordinates[:, dropped] = np.linalg.lstsq(rows[keep].T, rows[dropped].T, rcond=None)[0]
    return coordinates


def _words(formulas: Sequence[str]) -> set[str]:
    """Every name on the right-hand sides, factors and halves taken off."""
    words: set[str] = set()
    for formula in formulas:
        for term in formula.split(" = ", 1)[1].replace("(", "").replace(")", "").split():
            bare = term.split("/")[0].lstrip("-")
            pieces = bare.split("*")
            words |= {"*".join(pieces[k:]) for k in range(len(pieces))}
    return words
