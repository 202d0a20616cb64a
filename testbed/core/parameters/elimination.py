"""Tips to base: entries of the regrouped bodies, and which of them stay independent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.parameters.regroup import Body, redefined_parameters
from testbed.core.parameters.rules import Kept, Model, across
from testbed.core.parameters.symbols import UNIT_OF, Label, Symbol, Term
from testbed.core.robot.tree import Tree

BEDPLATE = -1
"""Index of the body that carries the first ones."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A linear form of one body's ten redefined parameters.

    Attributes:
        label: Its name.
        unit: Of its value.
        body: The body it belongs to, or BEDPLATE.
        form: On that body's ten redefined parameters, (10,).
        alone: The body's own ten for which it is 1, the body's others 0, and nothing
            migrates, (10,); the bedplate has none.
        axial: Whether it is the inertia that the body's own joint moves: K_ee, or mbar.
    """

    label: Label
    unit: str
    body: int
    form: Array
    alone: Array
    axial: bool

    @property
    def joint(self) -> int:
        """The joint that itself moves the inertia it is; -1 if it is none."""
        return self.body if self.axial else -1


def list_entries(
    tree: Tree, bodies: Sequence[Body], model: Model, gravity: Array, tared: bool
) -> list[Entry]:
    """Everything kept, tips to base, and for the reaction the bedplate's static wrench.

    Args:
        tree: The robot.
        bodies: Its bodies after regrouping.
        model: "dynamic" or "reaction".
        gravity: (3,) [m/s^2], bedplate frame.
        tared: The bedplate's static wrench in one posture has been taken off.
    """
    entries = [
        Entry(
            kept_label(tree, j, kept),
            UNIT_OF[kept.terms[0][1]],
            j,
            kept.form,
            kept.direction,
            kept.axial,
        )
        for j in reversed(range(tree.n))
        for kept in bodies[j].row.kept
    ]
    if model == "reaction" and gravity.any() and not tared and not tree.lead:
        entries += static_entries(tree, gravity)
    return entries


def kept_label(tree: Tree, body: int, kept: Kept) -> Label:
    """Name of a kept parameter, such as mb*2z, 2*K3d, K*1zz, mbar1."""
    carries = bool(tree.children(body))
    return Label(
        tuple(
            Term(
                Symbol(head, (body + 1,), tail, carries and head != "mbar"),
                ((factor, None),),
            )
            for factor, head, tail in kept.terms
        )
    )


def static_entries(tree: Tree, gravity: Array) -> list[Entry]:
    """The base rule: F_0 = -M g, L_0 = -s x g; the mass M and s normal to g.

    M is the sum of the first bodies' mbar, s their first moments and what has migrated
    into the bedplate.

    Args:
        tree: The robot.
        gravity: Not zero, (3,) [m/s^2], bedplate frame.
    """
    trunks = tree.children(BEDPLATE)
    lone = trunks[0] + 1 if len(trunks) == 1 else 0
    entries = [_static(Symbol("mbar", (lone,), ""), np.eye(10)[0])]
    triad = across(gravity / np.linalg.norm(gravity))
    for direction, letter in zip(triad.axes[:2], triad.letters[:2], strict=True):
        entries.append(
            _static(Symbol("mb", (0,), letter, star=True), np.pad(direction, (1, 6)))
        )
    return entries


def _static(symbol: Symbol, form: Array) -> Entry:
    return Entry(
        Label((Term(symbol),)),
        UNIT_OF[symbol.head],
        BEDPLATE,
        form,
        np.zeros(10),
        False,
    )


def dynamic_first(
    tree: Tree, entries: list[Entry], bodies: Sequence[Body], torques: Sequence[Body]
) -> list[Entry]:
    """The parameters shared with the dynamic set first, in its order; then K, mb, mbar.

    Args:
        tree: The robot.
        entries: The reaction's.
        bodies: Regrouped for the reaction.
        torques: Regrouped for the joint torques.
    """
    differing = set()  # bodies that carry something which is regrouped in another way
    for j in reversed(range(tree.n)):
        if j in differing or not np.array_equal(bodies[j].passing, torques[j].passing):
            differing.add(tree.parents[j])
    shared = {
        (kept_label(tree, j, kept), *kept.form): k
        for j in range(tree.n)
        for k, kept in enumerate(torques[j].row.kept)
        if j not in differing
    }
    units = ("kg m^2", "kg m", "kg")

    def key(entry: Entry) -> tuple[bool, int, int]:
        k = shared.get((entry.label, *entry.form)) if entry.body >= 0 else None
        return (k is None, -entry.body, units.index(entry.unit) if k is None else k)

    return sorted(entries, key=key)


def passed_on(tree: Tree, bodies: Sequence[Body], body: int) -> Array:
    """What a body's ten redefined parameters add to its carrier's, (10, 10).

    A carrier holds the masses it carries already; to the bedplate they are passed on.
    """
    if tree.parents[body] >= 0:
        return bodies[body].gain
    gain = bodies[body].gain.copy()
    gain[0, 0] += 1.0
    gain[1:4, 0] += tree.joints[body].offset
    return gain


def dense_rows(tree: Tree, bodies: Sequence[Body], entries: Sequence[Entry]) -> Array:
    """The entries on the 10 n barycentric parameters, (entries, 10 n)."""
    redefined = redefined_parameters(tree, bodies)
    if any(entry.body == BEDPLATE for entry in entries):
        trunks = tree.children(BEDPLATE)
        bedplate = sum(passed_on(tree, bodies, j) @ redefined[j] for j in trunks)
        redefined = np.concatenate([redefined, bedplate[None]])
    rows = [entry.form @ redefined[entry.body] for entry in entries]
    return np.reshape(rows, (-1, 10 * tree.n))


INDEPENDENT = 1e-9
"""What unit parameters must change of an entry, or of a carrier, for it to count."""

ROUNDING = 1e-13
"""Part of a direction's largest parameter that is rounding of zero."""


@dataclass(frozen=True, eq=False)
class Elimination:
    """Independent entries, and how the others depend on them.

    Attributes:
        kept: Indices of the independent entries, ascending.
        lift: By column for each of these, barycentric parameters for which it is 1 and all
            others kept are 0, (10 n, kept).
        dependent: By index, the other entries as combinations of kept ones; empty for
            entries that vanish.
    """

    kept: tuple[int, ...]
    lift: Array
    dependent: dict[int, dict[int, float]]


FREE = -1
"""Index of the entry of a direction that changes none."""


@dataclass(frozen=True, eq=False)
class _Directions:
    """Directions in which a body and those that it carries can change.

    Attributes:
        rows: The body's ten redefined parameters, then the barycentric parameters of all bodies
            that have these, (k, 10 + 10 n).
        entries: Index of the only entry that each changes, by one, or FREE, (k,).
    """

    rows: Array
    entries: NDArray[np.int_]

    @property
    def sizes(self) -> Array:
        """Largest magnitudes of the barycentric parameters, (k,)."""
        return np.asarray(np.abs(self.rows[:, 10:]).max(axis=1))

    def of(self, which: NDArray[np.bool_ | np.intp]) -> _Directions:
        """Some of them, by mask or index."""
        return _Directions(self.rows[which], self.entries[which])

    def beside(self, other: _Directions) -> _Directions:
        """These, then others."""
        entries = np.concatenate([self.entries, other.entries])
        return _Directions(np.vstack([self.rows, other.rows]), entries)


def eliminate(
    tree: Tree,
    bodies: Sequence[Body],
    entries: Sequence[Entry],
    known_zero: NDArray[np.bool_],
) -> Elimination:
    """Decide which entries are independent.

    Of dependent entries of one body, those given first are kept; of several bodies, those
    nearest the tips.

    Args:
        tree: The robot.
        bodies: Its bodies after regrouping.
        entries: Candidates.
        known_zero: Barycentric parameters known to be zero, (n, 10).
    """
    whole = [not row.any() for row in known_zero]
    members: dict[int, dict[int, Entry]] = {
        body: {} for body in range(BEDPLATE, tree.n)
    }
    for k, entry in enumerate(entries):
        members[entry.body][k] = entry
    settled = _of_a_body(tree.n, 0, [], FREE)
    carried = dict.fromkeys(members, settled)
    dependent: dict[int, dict[int, float]] = {}
    for body in reversed(range(tree.n)):
        carrier, directions = tree.parents[body], carried[body]
        if carrier != BEDPLATE and whole[body] and whole[carrier]:
            done = _undisturbed(tree.n, body, members[body], directions)
        else:
            directions = _free(tree.n, body, members[body], known_zero[body]).beside(
                directions
            )
            directions, combined = _chosen(members[body], directions)
            dependent |= combined
            done, passed = _passed(directions, passed_on(tree, bodies, body))
            carried[carrier] = carried[carrier].beside(passed)
        settled = settled.beside(done)
    directions, combined = _chosen(members[BEDPLATE], carried[BEDPLATE])
    settled = settled.beside(directions.of(directions.entries != FREE))
    settled = settled.of(np.argsort(settled.entries))
    lift = np.where(
        np.abs(settled.rows) > ROUNDING * settled.sizes[:, None], settled.rows, 0.0
    )
    return Elimination(
        tuple(settled.entries.tolist()), lift[:, 10:].T, dependent | combined
    )


def _of_a_body(
    n: int, body: int, values: Sequence[Array], entries: int | Sequence[int]
) -> _Directions:
    """Directions of a body's own parameters, (k, 10)."""
    rows = np.zeros((len(values), n + 1, 10))
    rows[:, 0] = rows[:, body + 1] = np.reshape(values, (-1, 10))
    return _Directions(
        rows.reshape(-1, 10 * n + 10), np.full(len(values), entries, dtype=int)
    )


def _undisturbed(
    n: int, body: int, own: dict[int, Entry], directions: _Directions
) -> _Directions:
    """Where nothing is known of a body and its carrier: all entries, nothing passed on."""
    bound = directions.of(directions.entries != FREE)
    # the body's own parameters make up for what it was passed
    rows = bound.rows - _of_a_body(n, body, [*bound.rows[:, :10]], FREE).rows
    alone = _of_a_body(n, body, [entry.alone for entry in own.values()], [*own])
    return alone.beside(_Directions(rows, bound.entries))


def _free(
    n: int, body: int, own: dict[int, Entry], known_zero: NDArray[np.bool_]
) -> _Directions:
    """Directions of a body's own parameters: its entries' alone, and single parameters."""
    alone = (entry.alone for entry in own.values())
    values = [
        *(each for each in alone if not each[known_zero].any()),
        *np.eye(10)[~known_zero],
    ]
    return _of_a_body(n, body, values, FREE)


def _chosen(
    own: dict[int, Entry], directions: _Directions
) -> tuple[_Directions, dict[int, dict[int, float]]]:
    """Directions for a body's entries, out of free ones.

    Returns:
        Directions of this body's entries and of those before, each without effect on the
        others, and those left free; and the entries that are combinations of others.
    """
    combined = {}
    for k, entry in own.items():
        rows, entries, sizes = directions.rows, directions.entries, directions.sizes
        change = rows[:, :10] @ entry.form
        weights = np.where(entries == FREE, np.abs(change) / sizes, 0.0)
        great = weights.max(initial=0.0)
        if great <= INDEPENDENT:
            shares = np.flatnonzero((entries != FREE) & (np.abs(change) > INDEPENDENT))
            combined[k] = {int(entries[i]): float(change[i]) for i in shares}
            continue
        # of directions that change an entry, the first with this share of the greatest change is
        # taken: the body's own come first
        first = int(np.argmax(weights >= 0.1 * great))
        pivot = rows[first] * (1.0 / change[first])
        rest = _Directions(rows - np.outer(change, pivot), entries.copy())
        rest.rows[first], rest.entries[first] = pivot, k
        directions = rest.of((rest.entries != FREE) | (rest.sizes > ROUNDING * sizes))
    return directions, combined


def _passed(directions: _Directions, gain: Array) -> tuple[_Directions, _Directions]:
    """Directions as they change the carrier.

    Args:
        directions: Of a body.
        gain: What its ten redefined parameters add to its carrier's, (10, 10).

    Returns:
        Those that change an entry and nothing of the carrier; and the others.
    """
    rows = np.hstack([directions.rows[:, :10] @ gain.T, directions.rows[:, 10:]])
    free = directions.entries == FREE
    places, basis = echelon(rows[free], 10)
    bound = _Directions(rows - rows[:, places] @ basis, directions.entries).of(~free)
    done = np.abs(bound.rows[:, :10]).max(axis=1) <= ROUNDING * bound.sizes
    spare = _Directions(basis, np.full(len(basis), FREE))
    return bound.of(done), spare.beside(bound.of(~done))


def echelon(rows: Array, width: int) -> tuple[list[int], Array]:
    """Independent directions for the same space: each alone has 1 at its own place.

    Args:
        rows: (k, N); places are among the first `width` columns, the others give the size.
        width: See there.

    Returns:
        The places, and the directions, (places, N).
    """
    places: list[int] = []
    basis = rows[:0]
    for row in rows:
        rest = row - row[places] @ basis
        place = int(np.argmax(np.abs(rest[:width])))
        if abs(rest[place]) > INDEPENDENT * np.abs(row[width:]).max():
            rest = rest * (1.0 / rest[place])
            basis = np.vstack([basis - np.outer(basis[:, place], rest), rest])
            places.append(place)
    return places, basis
