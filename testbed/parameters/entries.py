"""From regrouped bodies to the entries a minimal set is chosen from.

Everything here is about single bodies, so the cost grows linearly with their number; rows
on all 10 n parameters are made by `dense_rows`, when somebody asks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.parameters.barycentric import UNIT_OF
from testbed.parameters.regroup import Body, redefined_parameters
from testbed.parameters.rules import Kept, Model, across
from testbed.parameters.symbols import Label, Symbol, Term
from testbed.robot.tree import Tree

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
        Entry(kept_label(tree, j, kept), _unit(kept), j, kept.form, kept.direction, kept.axial)
        for j in reversed(range(tree.n))
        for kept in bodies[j].row.kept
    ]
    if model == "reaction" and gravity.any() and not tared and not tree.floating:
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


def _unit(kept: Kept) -> str:
    return UNIT_OF[kept.terms[0][1]]


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
