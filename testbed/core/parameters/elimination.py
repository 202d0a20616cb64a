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
            migrates, (10,); None for the bedplate's.
        axial: Whether it is the inertia that the body's own joint moves: K_ee, or mbar.
    """

    label: Label
    unit: str
    body: int
    form: Array
    alone: Array | None
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
            Term(Symbol(head, (body + 1,), tail, carries and head != "mbar"), ((factor, None),))
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
        entries.append(_static(Symbol("mb", (0,), letter, star=True), np.pad(direction, (1, 6))))
    return entries


def _static(symbol: Symbol, form: Array) -> Entry:
    return Entry(Label((Term(symbol),)), UNIT_OF[symbol.head], BEDPLATE, form, None, False)


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
    same = [True] * tree.n  # whether all that a body carries is regrouped alike
    for j in reversed(range(tree.n)):
        alike = same[j] and np.array_equal(bodies[j].passing, torques[j].passing)
        if tree.parents[j] >= 0 and not alike:
            same[tree.parents[j]] = False
    place = {
        kept_label(tree, j, kept): (k, kept.form)
        for j in range(tree.n)
        for k, kept in enumerate(torques[j].row.kept)
        if same[j]
    }
    rank = {"kg m^2": 0, "kg m": 1, "kg": 2}

    def key(entry: Entry) -> tuple[int, int, int]:
        k, form = place.get(entry.label, (0, None))
        if entry.body >= 0 and form is not None and np.array_equal(form, entry.form):
            return (0, -entry.body, k)
        return (1, -entry.body, rank[entry.unit])

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
    rows = np.zeros((len(entries), 10 * tree.n))
    for k, entry in enumerate(entries):
        rows[k] = entry.form @ redefined[entry.body]
    return rows


INDEPENDENT = 1e-9
"""What unit parameters must change of an entry, or of a carrier, for it to count."""

ROUNDING = 1e-13
"""Part of a direction's largest parameter that is rounding of zero."""

COMPARABLE = 0.1
"""Of directions that change an entry, the first with this share of the greatest change is
taken: the body's own come first."""

Parts = dict[int, Array]  # body -> ten numbers


@dataclass(frozen=True, eq=False)
class Elimination:
    """What came of it.

    Attributes:
        kept: Indices of the independent entries, ascending.
        directions: For each of these, barycentric parameters by body for which it is 1
            and all others kept are 0.
        dependent: By index, the other entries as combinations of kept ones; empty for
            entries that vanish.
    """

    kept: tuple[int, ...]
    directions: tuple[Parts, ...]
    dependent: dict[int, dict[int, float]]


@dataclass(frozen=True, eq=False)
class Direction:
    """Parameters of a body and of those it carries, and the body's redefined ten, (10,)."""

    value: Array
    parts: Parts

    @property
    def size(self) -> float:
        """Largest magnitude of its parameters."""
        return max(float(np.abs(numbers).max()) for numbers in self.parts.values())

    def plus(self, factor: float, other: Direction) -> Direction:
        """Sum with a multiple of another."""
        if factor == 0.0:
            return self
        parts = dict(self.parts)
        for body, numbers in other.parts.items():
            parts[body] = parts.get(body, 0.0) + factor * numbers
        return Direction(self.value + factor * other.value, parts)

    def times(self, factor: float) -> Direction:
        """Multiple."""
        parts = {body: factor * numbers for body, numbers in self.parts.items()}
        return Direction(factor * self.value, parts)


_Bound = dict[int, Direction]  # entry -> its direction


def eliminate(
    tree: Tree, bodies: Sequence[Body], entries: Sequence[Entry], known_zero: NDArray[np.bool_]
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
    entries_of: dict[int, dict[int, Entry]] = {body: {} for body in range(BEDPLATE, tree.n)}
    for k, entry in enumerate(entries):
        entries_of[entry.body][k] = entry
    free: dict[int, list[Direction]] = {body: [] for body in entries_of}
    bound: dict[int, _Bound] = {body: {} for body in entries_of}
    done: dict[int, Parts] = {}
    dependent: dict[int, dict[int, float]] = {}
    for body in reversed(range(tree.n)):
        carrier, own = tree.parents[body], entries_of[body]
        if whole[body] and carrier != BEDPLATE and whole[carrier]:
            done |= _undisturbed(body, own, bound[body])
            continue
        spare = [*_of_the_body(body, own, known_zero[body]), *free[body]]
        left, taken, combined = _chosen(own, spare, bound[body])
        dependent |= combined
        gain = passed_on(tree, bodies, body)
        leading = echelon([Direction(gain @ each.value, each.parts) for each in left])
        free[carrier] += list(leading.values())
        for k, each in taken.items():
            passed = _settled(Direction(gain @ each.value, each.parts), leading)
            if np.abs(passed.value).max() <= ROUNDING * passed.size:
                done[k] = passed.parts
            else:
                bound[carrier][k] = passed
    _, taken, combined = _chosen(entries_of[BEDPLATE], free[BEDPLATE], bound[BEDPLATE])
    done |= {k: each.parts for k, each in taken.items()}
    kept = tuple(sorted(done))
    return Elimination(kept, tuple(_clean(done[k]) for k in kept), dependent | combined)


def _undisturbed(body: int, own: dict[int, Entry], bound: _Bound) -> dict[int, Parts]:
    """Where nothing is known of a body and its carrier: all entries, nothing passed on."""
    found: dict[int, Parts] = {k: {body: each.parts[body]} for k, each in _alone(body, own).items()}
    for k, each in bound.items():  # the body's own parameters make up for what it was passed
        found[k] = each.parts | {body: -each.value}
    return found


def _of_the_body(
    body: int, own: dict[int, Entry], known_zero: NDArray[np.bool_]
) -> list[Direction]:
    """Directions of a body's own parameters: its entries' alone, and single parameters."""
    alone = [each for each in _alone(body, own).values() if not each.value[known_zero].any()]
    units = (np.eye(10)[c] for c in np.flatnonzero(~known_zero))
    return alone + [Direction(unit, {body: unit}) for unit in units]


def _alone(body: int, own: dict[int, Entry]) -> _Bound:
    return {
        k: Direction(entry.alone, {body: entry.alone})
        for k, entry in own.items()
        if entry.alone is not None
    }


def _chosen(
    own: dict[int, Entry], spare: list[Direction], bound: _Bound
) -> tuple[list[Direction], _Bound, dict[int, dict[int, float]]]:
    """Directions for a body's entries, out of spare ones.

    Returns:
        What is left free; directions of this body's entries and of those before, each
        without effect on the others; and the entries that are combinations of others.
    """
    taken, combined = dict(bound), {}
    for k, entry in own.items():
        weights = np.array([entry.form @ each.value / each.size for each in spare])
        great = np.abs(weights).max(initial=0.0)
        if great <= INDEPENDENT:
            shares = {i: float(entry.form @ each.value) for i, each in taken.items()}
            combined[k] = {i: share for i, share in shares.items() if abs(share) > INDEPENDENT}
            continue
        first = int(np.argmax(np.abs(weights) >= COMPARABLE * great))
        pivot = spare.pop(first)
        pivot = pivot.times(1.0 / float(entry.form @ pivot.value))
        spare = [rest for each in spare if (rest := _without(entry, each, pivot)) is not None]
        taken = {i: each.plus(-float(entry.form @ each.value), pivot) for i, each in taken.items()}
        taken[k] = pivot
    return spare, taken, combined


def _without(entry: Entry, direction: Direction, pivot: Direction) -> Direction | None:
    """What is left of a direction that no longer changes an entry; None if nothing is."""
    rest = direction.plus(-float(entry.form @ direction.value), pivot)
    return rest if rest.size > ROUNDING * direction.size else None


def echelon(directions: list[Direction]) -> dict[int, Direction]:
    """Independent directions for the same space: each alone has 1 at its own place.

    Returns:
        By place among a body's ten redefined parameters.
    """
    found: dict[int, Direction] = {}
    for each in directions:
        rest = _settled(each, found)
        place = int(np.argmax(np.abs(rest.value)))
        if abs(rest.value[place]) <= INDEPENDENT * each.size:
            continue
        rest = rest.times(1.0 / float(rest.value[place]))
        found = {
            at: other.plus(-float(other.value[place]), rest) for at, other in found.items()
        } | {place: rest}
    return found


def _settled(direction: Direction, echelon: dict[int, Direction]) -> Direction:
    """The direction with zeros at the places of an echelon."""
    for place, each in echelon.items():
        direction = direction.plus(-float(direction.value[place]), each)
    return direction


def _clean(parts: Parts) -> Parts:
    """Without the rounding of zero."""
    least = ROUNDING * max(np.abs(numbers).max() for numbers in parts.values())
    tidy = {body: np.where(np.abs(n) > least, n, 0.0) for body, n in parts.items()}
    return {body: numbers for body, numbers in sorted(tidy.items()) if numbers.any()}
