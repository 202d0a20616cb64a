"""Independent parameters of a minimal set, by elimination from the end bodies to the base.

An entry is a candidate parameter: a linear form on the redefined parameters of a body that the
regrouping rules keep. If some parameters are known to be zero, entries can be linearly dependent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.parameters.regroup import RegroupedBody, redefined_parameter_rows
from testbed.core.parameters.rules import KeptParameter, Signal, triad_about
from testbed.core.parameters.symbols import UNIT_BY_KIND, Label, Symbol, Term
from testbed.core.robot.tree import Tree

BEDPLATE = -1
"""Body index of the bedplate, which carries the first bodies."""


@dataclass(frozen=True, eq=False)
class CandidateParameter:
    """Candidate parameter: a linear form on the ten redefined parameters of a body.

    Redefined parameters are a body's barycentric parameters mbar, mb, K (mass, first moments,
    inertia tensor) plus the parameters regrouped into them from the bodies that it carries.

    Attributes:
        label: Symbolic name.
        unit: Unit of the value.
        body: Index of the body, or BEDPLATE.
        form: Coefficients on the body's ten redefined parameters, (10,).
        unit_direction: Ten parameters of the body for which this form is 1, the body's other forms
            are 0, and no parameter migrates to the carrier, (10,); zero for the bedplate.
        is_axial_inertia: True for the inertia that the body's joint accelerates: K_ee about a
            revolute joint's axis e, or mbar of a prismatic joint.
    """

    label: Label
    unit: str
    body: int
    form: Array
    unit_direction: Array
    is_axial_inertia: bool

    @property
    def axial_joint(self) -> int:
        """Index of the joint for an axial inertia (K_ee or mbar); -1 for other parameters."""
        return self.body if self.is_axial_inertia else -1


def candidate_parameters(
    tree: Tree,
    bodies: Sequence[RegroupedBody],
    model: Signal,
    gravity: Array,
    tared: bool,
) -> list[CandidateParameter]:
    """Candidate parameters of all bodies, end bodies first, then of the static wrench.

    Parameters of the static wrench are added for the bedplate's wrench under gravity, unless the
    wrench is tared or the base moves.

    Args:
        tree: The robot.
        bodies: Regrouped bodies.
        model: "torque" or "wrench".
        gravity: Gravity, (3,) [m/s^2], bedplate frame.
        tared: True if the bedplate's static wrench in one posture has been subtracted.
    """
    entries = [
        CandidateParameter(
            parameter_label(tree, j, parameter),
            UNIT_BY_KIND[parameter.terms[0][1]],
            j,
            parameter.form,
            parameter.direction,
            parameter.axial,
        )
        for j in reversed(range(tree.n))
        for parameter in bodies[j].row.parameters
    ]
    if model == "wrench" and gravity.any() and not tared and not tree.lead:
        entries += static_wrench_parameters(tree, gravity)
    return entries


def parameter_label(tree: Tree, body: int, parameter: KeptParameter) -> Label:
    """Label of a kept parameter, such as mb*2z, 2*K3d, K*1zz, mbar1."""
    has_children = bool(tree.children(body))
    return Label(
        tuple(
            Term(
                Symbol(head, (body + 1,), tail, has_children and head != "mbar"),
                ((factor, None),),
            )
            for factor, head, tail in parameter.terms
        )
    )


def static_wrench_parameters(tree: Tree, gravity: Array) -> list[CandidateParameter]:
    """Candidate parameters of the static wrench: total mass, first moment normal to gravity.

    The wrench of the bedplate about its origin is F_0 = -M g, L_0 = -s x g. M is the sum of the
    first bodies' mbar, s the sum of their first moments and of the parameters that migrate into the
    bedplate; the two components of s are along the triad of `triad_about` gravity.

    Args:
        tree: The robot.
        gravity: Gravity g, not zero, (3,) [m/s^2], bedplate frame.
    """
    first_bodies = tree.children(BEDPLATE)
    number = first_bodies[0] + 1 if len(first_bodies) == 1 else 0
    entries = [_static_entry(Symbol("mbar", (number,), ""), np.eye(10)[0])]
    triad = triad_about(gravity / np.linalg.norm(gravity))
    for direction, letter in zip(triad.axes[:2], triad.letters[:2], strict=True):
        entries.append(
            _static_entry(
                Symbol("mb", (0,), letter, is_redefined=True), np.pad(direction, (1, 6))
            )
        )
    return entries


def _static_entry(symbol: Symbol, form: Array) -> CandidateParameter:
    """Candidate parameter of the bedplate with the given symbol and form, (10,)."""
    return CandidateParameter(
        Label((Term(symbol),)),
        UNIT_BY_KIND[symbol.head],
        BEDPLATE,
        form,
        np.zeros(10),
        False,
    )


def shared_parameters_first(
    tree: Tree,
    entries: list[CandidateParameter],
    bodies: Sequence[RegroupedBody],
    torque_bodies: Sequence[RegroupedBody],
) -> list[CandidateParameter]:
    """Sort the entries of the wrench set, beginning with parameters shared with the torque set.

    Shared parameters have the same label and coefficients in both sets, and the bodies beyond are
    regrouped in the same way. They are in the order of the torque set. The other parameters follow
    body by body, end bodies first, in the order K, mb, mbar.

    Args:
        tree: The robot.
        entries: Candidate parameters of the wrench set.
        bodies: Bodies regrouped for the wrench.
        torque_bodies: Bodies regrouped for the joint torques.
    """
    differing = set()  # bodies that carry a body with another regrouping
    for j in reversed(range(tree.n)):
        if j in differing or not np.array_equal(
            bodies[j].gain_by_offset, torque_bodies[j].gain_by_offset
        ):
            differing.add(tree.parents[j])
    shared = {
        (parameter_label(tree, j, parameter), *parameter.form): k
        for j in range(tree.n)
        for k, parameter in enumerate(torque_bodies[j].row.parameters)
        if j not in differing
    }
    units = ("kg m^2", "kg m", "kg")

    def key(entry: CandidateParameter) -> tuple[bool, int, int]:
        k = shared.get((entry.label, *entry.form)) if entry.body >= 0 else None
        return (k is None, -entry.body, units.index(entry.unit) if k is None else k)

    return sorted(entries, key=key)


def carrier_gain(tree: Tree, bodies: Sequence[RegroupedBody], body: int) -> Array:
    """Gain matrix from a body's ten redefined parameters to its carrier's, (10, 10).

    The barycentric parameters of a carrying body already contain the carried masses. The gain
    matrix therefore adds mass and first moment to the bedplate only.
    """
    if tree.parents[body] >= 0:
        return bodies[body].gain
    gain = bodies[body].gain.copy()
    gain[0, 0] += 1.0
    gain[1:4, 0] += tree.joints[body].offset
    return gain


def barycentric_rows(
    tree: Tree, bodies: Sequence[RegroupedBody], entries: Sequence[CandidateParameter]
) -> Array:
    """Coefficients of candidate parameters on the barycentric parameters, (entries, 10 n)."""
    redefined = redefined_parameter_rows(tree, bodies)
    if any(entry.body == BEDPLATE for entry in entries):
        first_bodies = tree.children(BEDPLATE)
        bedplate = sum(
            carrier_gain(tree, bodies, j) @ redefined[j] for j in first_bodies
        )
        redefined = np.concatenate([redefined, bedplate[None]])
    rows = [entry.form @ redefined[entry.body] for entry in entries]
    return np.reshape(rows, (-1, 10 * tree.n))


PIVOT_TOLERANCE = 1e-9
"""Smallest change of an entry or of a carrier by unit parameters that is not a rounding error."""

ROUNDING_TOLERANCE = 1e-13
"""Share of a direction's largest parameter below which a value is a rounding error of zero."""


@dataclass(frozen=True, eq=False)
class Elimination:
    """Independent candidate parameters (entries), and dependencies of the others on these.

    Attributes:
        independent_indices: Indices of the independent entries, ascending.
        right_inverse: Barycentric parameters for which one independent entry is 1 and the others
            are 0, one column per independent entry, (10 n, independent).
        dependencies: Coefficients of each dependent entry on the independent entries, keyed by
            their indices; empty for entries that are zero.
    """

    independent_indices: tuple[int, ...]
    right_inverse: Array
    dependencies: dict[int, dict[int, float]]


NO_ENTRY = -1
"""Entry index of a direction that changes no entry."""


@dataclass(frozen=True, eq=False)
class _Directions:
    """Directions of change of the parameters of a body and its carried bodies.

    Attributes:
        rows: Changes of the body's ten redefined parameters, followed by the changes of all
            barycentric parameters that cause these, (k, 10 + 10 n).
        entries: Index of the only entry that each direction changes (by 1), or NO_ENTRY, (k,).
    """

    rows: Array
    entries: NDArray[np.int_]

    @property
    def sizes(self) -> Array:
        """Largest magnitude of the barycentric parameters in each direction, (k,)."""
        return np.asarray(np.abs(self.rows[:, 10:]).max(axis=1))

    def subset(self, selection: NDArray[np.bool_ | np.intp]) -> _Directions:
        """Subset of the directions, given by a mask or by indices."""
        return _Directions(self.rows[selection], self.entries[selection])

    def union(self, other: _Directions) -> _Directions:
        """Directions of this set, followed by the directions of another set."""
        entries = np.concatenate([self.entries, other.entries])
        return _Directions(np.vstack([self.rows, other.rows]), entries)


def find_independent(
    tree: Tree,
    bodies: Sequence[RegroupedBody],
    entries: Sequence[CandidateParameter],
    known_zero: NDArray[np.bool_],
) -> Elimination:
    """Find the independent entries by elimination from the end bodies to the base.

    Among dependent entries of one body, the first ones are kept; among those of several bodies, the
    entries of the bodies farthest from the base.

    Args:
        tree: The robot.
        bodies: Regrouped bodies.
        entries: Candidate parameters.
        known_zero: True for barycentric parameters known to be zero, (n, 10).
    """
    unconstrained = [not row.any() for row in known_zero]
    body_entries: dict[int, dict[int, CandidateParameter]] = {
        body: {} for body in range(BEDPLATE, tree.n)
    }
    for k, entry in enumerate(entries):
        body_entries[entry.body][k] = entry
    finished = _own_directions(tree.n, 0, [], NO_ENTRY)
    carried_directions = dict.fromkeys(body_entries, finished)
    dependent: dict[int, dict[int, float]] = {}
    for body in reversed(range(tree.n)):
        carrier, directions = tree.parents[body], carried_directions[body]
        if carrier != BEDPLATE and unconstrained[body] and unconstrained[carrier]:
            new_finished = _unconstrained_directions(
                tree.n, body, body_entries[body], directions
            )
        else:
            directions = _free_directions(
                tree.n, body, body_entries[body], known_zero[body]
            ).union(directions)
            directions, combinations = _assign_entries(body_entries[body], directions)
            dependent |= combinations
            new_finished, passed_directions = _carrier_directions(
                directions, carrier_gain(tree, bodies, body)
            )
            carried_directions[carrier] = carried_directions[carrier].union(
                passed_directions
            )
        finished = finished.union(new_finished)
    directions, combinations = _assign_entries(
        body_entries[BEDPLATE], carried_directions[BEDPLATE]
    )
    finished = finished.union(directions.subset(directions.entries != NO_ENTRY))
    finished = finished.subset(np.argsort(finished.entries))
    lift = np.where(
        np.abs(finished.rows) > ROUNDING_TOLERANCE * finished.sizes[:, None],
        finished.rows,
        0.0,
    )
    return Elimination(
        tuple(finished.entries.tolist()), lift[:, 10:].T, dependent | combinations
    )


def _own_directions(
    n: int, body: int, values: Sequence[Array], entries: int | Sequence[int]
) -> _Directions:
    """Directions that change only the parameters of one body.

    Args:
        n: Number of bodies.
        body: Index of the body.
        values: Changes of the body's ten parameters, (10,) each.
        entries: Index of the entry that each direction changes, or NO_ENTRY.
    """
    rows = np.zeros((len(values), n + 1, 10))
    rows[:, 0] = rows[:, body + 1] = np.reshape(values, (-1, 10))
    return _Directions(
        rows.reshape(-1, 10 * n + 10), np.full(len(values), entries, dtype=int)
    )


def _unconstrained_directions(
    n: int, body: int, entries: dict[int, CandidateParameter], directions: _Directions
) -> _Directions:
    """Directions of change for all entries of a body without known zeros.

    The result contains the unit direction of each entry of the body, and the directions of the
    carried bodies' entries, compensated by the body's own parameters. The carrier, which must have
    no known zeros either, is therefore not changed.

    Args:
        n: Number of bodies.
        body: Index of the body.
        entries: Candidate parameters of the body, by index.
        directions: Directions passed on by the carried bodies.
    """
    assigned = directions.subset(directions.entries != NO_ENTRY)
    # the body's own parameters compensate for what was passed to the body
    rows = (
        assigned.rows
        - _own_directions(n, body, [*assigned.rows[:, :10]], NO_ENTRY).rows
    )
    unit_directions = _own_directions(
        n, body, [entry.unit_direction for entry in entries.values()], [*entries]
    )
    return unit_directions.union(_Directions(rows, assigned.entries))


def _free_directions(
    n: int,
    body: int,
    entries: dict[int, CandidateParameter],
    known_zero: NDArray[np.bool_],
) -> _Directions:
    """Directions of change of a body's own parameters that keep known zeros at zero.

    Directions that change a single entry of the body come first, then single parameters. These
    directions are not yet assigned to entries.

    Args:
        n: Number of bodies.
        body: Index of the body.
        entries: Candidate parameters of the body, by index.
        known_zero: True for parameters of the body known to be zero, (10,).
    """
    unit_directions = (entry.unit_direction for entry in entries.values())
    values = [
        *(each for each in unit_directions if not each[known_zero].any()),
        *np.eye(10)[~known_zero],
    ]
    return _own_directions(n, body, values, NO_ENTRY)


def _assign_entries(
    body_entries: dict[int, CandidateParameter], directions: _Directions
) -> tuple[_Directions, dict[int, dict[int, float]]]:
    """Assign free directions of change to a body's entries by Gaussian elimination.

    The pivot of an entry is the first free direction with at least a tenth of the largest change,
    relative to the size of the direction. If no change exceeds PIVOT_TOLERANCE, the entry depends
    on the entries that already have a direction.

    Args:
        body_entries: Candidate parameters of the body, by index.
        directions: Free directions, and directions of carried bodies' entries.

    Returns:
        Directions that each change a single entry of this or of a carried body, with the remaining
        free directions; and coefficients of the dependent entries, keyed by index.
    """
    combinations = {}
    for k, entry in body_entries.items():
        rows, entries, sizes = directions.rows, directions.entries, directions.sizes
        change = rows[:, :10] @ entry.form
        weights = np.where(entries == NO_ENTRY, np.abs(change) / sizes, 0.0)
        largest = weights.max(initial=0.0)
        if largest <= PIVOT_TOLERANCE:
            shares = np.flatnonzero(
                (entries != NO_ENTRY) & (np.abs(change) > PIVOT_TOLERANCE)
            )
            combinations[k] = {int(entries[i]): float(change[i]) for i in shares}
            continue
        # the first direction with this share of the largest change: the body's own directions
        # come first
        first = int(np.argmax(weights >= 0.1 * largest))
        pivot = rows[first] * (1.0 / change[first])
        reduced = _Directions(rows - np.outer(change, pivot), entries.copy())
        reduced.rows[first], reduced.entries[first] = pivot, k
        directions = reduced.subset(
            (reduced.entries != NO_ENTRY) | (reduced.sizes > ROUNDING_TOLERANCE * sizes)
        )
    return directions, combinations


def _carrier_directions(
    directions: _Directions, gain: Array
) -> tuple[_Directions, _Directions]:
    """Convert directions of a body to changes of the carrier's parameters.

    Free directions are reduced to row echelon form. Their pivots are eliminated from the other
    directions.

    Args:
        directions: Directions of the body.
        gain: Gain matrix from the body's ten redefined parameters to the carrier's, (10, 10).

    Returns:
        Directions that change an entry but no parameter of the carrier; and the other directions.
    """
    rows = np.hstack([directions.rows[:, :10] @ gain.T, directions.rows[:, 10:]])
    is_free = directions.entries == NO_ENTRY
    pivots, basis = reduced_row_echelon(rows[is_free], 10)
    assigned = _Directions(rows - rows[:, pivots] @ basis, directions.entries).subset(
        ~is_free
    )
    has_no_effect = (
        np.abs(assigned.rows[:, :10]).max(axis=1) <= ROUNDING_TOLERANCE * assigned.sizes
    )
    free_directions = _Directions(basis, np.full(len(basis), NO_ENTRY))
    return assigned.subset(has_no_effect), free_directions.union(
        assigned.subset(~has_no_effect)
    )


def reduced_row_echelon(rows: Array, width: int) -> tuple[list[int], Array]:
    """Reduced row echelon form of directions: pivot columns, and independent rows.

    A row is left out if its largest remainder is at most PIVOT_TOLERANCE times its size.

    Args:
        rows: Directions, (k, N); the columns from index `width` on determine the size of a row.
        width: Number of leading columns that may contain pivots.

    Returns:
        Pivot columns; and rows with 1 in their own pivot column and 0 in the other pivot columns,
        (pivots, N).
    """
    pivots: list[int] = []
    basis = rows[:0]
    for row in rows:
        remainder = row - row[pivots] @ basis
        pivot = int(np.argmax(np.abs(remainder[:width])))
        if abs(remainder[pivot]) > PIVOT_TOLERANCE * np.abs(row[width:]).max():
            remainder = remainder * (1.0 / remainder[pivot])
            basis = np.vstack([basis - np.outer(basis[:, pivot], remainder), remainder])
            pivots.append(pivot)
    return pivots, basis
