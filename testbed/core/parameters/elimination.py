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
"""Parameter of a direction, which has some near one, that is rounding of zero."""


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


def eliminate(
    tree: Tree,
    bodies: Sequence[Body],
    entries: Sequence[Entry],
    known_zero: NDArray[np.bool_],
) -> Elimination:
    """Decide which entries are independent, by Gauss and Jordan on directions that are free.

    Of dependent entries of one body, those given first are kept; of several bodies, those
    nearest the tips.

    Args:
        tree: The robot.
        bodies: Its bodies after regrouping.
        entries: Candidates.
        known_zero: Barycentric parameters known to be zero, (n, 10).
    """
    forms, rows = dense_rows(tree, bodies, entries), _free(tree.n, entries, known_zero)
    changed = np.full(len(rows), FREE)  # the only entry that each direction changes
    dependent: dict[int, dict[int, float]] = {}
    for body in range(tree.n - 1, BEDPLATE - 1, -1):
        own = [k for k, entry in enumerate(entries) if entry.body == body]
        touched = np.flatnonzero((rows @ forms[own].T).any(axis=1))
        part, bound = rows[touched], changed[touched]
        for k in own:
            dependent |= _settle(k, forms[k], part, bound)
        rows[touched] = np.where(np.abs(part) > ROUNDING, part, 0.0)
        changed[touched] = bound
    kept = np.argsort(changed)[np.count_nonzero(changed == FREE) :]
    return Elimination(tuple(changed[kept].tolist()), rows[kept].T, dependent)


def _settle(
    k: int, form: Array, rows: Array, changed: NDArray[np.int_]
) -> dict[int, dict[int, float]]:
    """Take a free direction for an entry, which no other then changes.

    Args:
        k: Number of the entry.
        form: The entry, (N,).
        rows: Directions, (m, N), which are changed.
        changed: Number of the only entry that each changes, (m,), FREE for none; likewise.

    Returns:
        By its number, the entry as a combination of others; nothing where a direction is taken.
    """
    change, free = rows @ form, changed == FREE
    weights = np.where(free, np.abs(change), 0.0)
    great = weights.max(initial=0.0)
    if great <= INDEPENDENT:
        shares = np.flatnonzero(~free & (np.abs(change) > INDEPENDENT))
        return {k: {int(changed[i]): float(change[i]) for i in shares}}
    # the first with this share of the greatest change: the body's own come first
    first = int(np.argmax(weights >= 0.1 * great))
    pivot = rows[first] * (1.0 / change[first])
    rows -= np.outer(change, pivot)
    rows[first], changed[first] = pivot, k
    return {}


def _free(n: int, entries: Sequence[Entry], known_zero: NDArray[np.bool_]) -> Array:
    """Directions of barycentric parameters, of bodies' entries and single ones, (k, 10 n)."""
    rows = [np.zeros((0, 10 * n))]
    for body, zero in enumerate(known_zero):
        own = (entry.alone for entry in entries if entry.body == body)
        alone = [each for each in own if not each[zero].any()]
        values = np.array([*alone, *np.eye(10)[~zero]]).reshape(-1, 10)
        rows.append(np.pad(values, ((0, 0), (10 * body, 10 * (n - 1 - body)))))
    return np.concatenate(rows)


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
