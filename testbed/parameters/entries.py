"""From regrouped bodies to the entries of a minimal set, the bedplate's own included.

Everything here is about single bodies, so the cost grows linearly with their number; rows
on all 10 n parameters are made by `dense_rows`, when somebody asks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.parameters.regroup import Body, redefined_parameters
from testbed.parameters.row_space import beyond
from testbed.parameters.rules import Kept, Model, across
from testbed.robot.tree import Tree

INDEPENDENT = 1e-9
"""Part of a unit row that must be left after projection for it to count as a new one."""

Parts = tuple[tuple[int, Array], ...]  # (body, ten numbers)

_UNITS = {"mbar": "kg", "mb": "kg m"}


@dataclass(frozen=True, eq=False)
class Entry:
    """One minimal parameter.

    Attributes:
        name: As printed.
        unit: Of its value.
        body: The body it belongs to; -1 for the bedplate.
        form: On that body's ten redefined parameters, (10,).
        parts: The same on the redefined parameters of bodies that move.
        direction: Barycentric parameters, by body, for which it is 1 and all others 0.
        axial: Whether it is the inertia that the body's own joint moves: K_ee, or mbar.
    """

    name: str
    unit: str
    body: int
    form: Array
    parts: Parts
    direction: Parts
    axial: bool = False


def list_entries(
    tree: Tree, bodies: Sequence[Body], model: Model, gravity: Array, tared: bool
) -> list[Entry]:
    """Everything kept, tips to base, and for the reaction what the bedplate adds.

    Args:
        tree: The robot.
        bodies: Its bodies after regrouping.
        model: "dynamic" or "reaction".
        gravity: (3,) [m/s^2], bedplate frame.
        tared: The bedplate's static wrench in one posture has been taken off.
    """
    entries: list[Entry] = []
    for j in reversed(range(tree.n)):
        for kept in bodies[j].row.kept:
            unit = _UNITS.get(kept.head, "kg m^2")
            name = kept_name(tree, j, kept)
            parts, direction = ((j, kept.form),), ((j, kept.direction),)
            entries.append(Entry(name, unit, j, kept.form, parts, direction, kept.axial))
    if model == "reaction" and gravity.any() and not tared:
        return _with_static(tree, entries, static_entries(tree, bodies, gravity))
    return entries


def kept_name(tree: Tree, body: int, kept: Kept) -> str:
    """Name of a kept parameter, such as mb*2z, 2*K3d, K*1zz, mbar1."""
    if kept.head == "mbar":
        return f"mbar{body + 1}"
    label = f"{'*' if tree.children(body) else ''}{body + 1}"
    return f"{kept.head}{label}{kept.tail.replace('mb_', 'mb' + label)}"


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
        kept_name(tree, j, kept): (j, k, kept.form)
        for j in range(tree.n)
        for k, kept in enumerate(torques[j].row.kept)
    }
    rank = {"kg m^2": 0, "kg m": 1, "kg": 2}

    def key(entry: Entry) -> tuple[int, int, int]:
        j, k, form = place.get(entry.name, (-1, 0, entry.form))
        if j >= 0 and entry.body == j and same[j] and np.array_equal(form, entry.form):
            return (0, -j, k)
        return (1, -entry.body, rank[entry.unit])

    return sorted(entries, key=key)


def dense_rows(tree: Tree, bodies: Sequence[Body], entries: Sequence[Entry]) -> Array:
    """The entries on the 10 n barycentric parameters, (entries, 10 n)."""
    redefined = redefined_parameters(tree, bodies)
    rows = np.zeros((len(entries), 10 * tree.n))
    for k, entry in enumerate(entries):
        for body, form in entry.parts:
            rows[k] += form @ redefined[body]
    return rows


def dense_directions(tree: Tree, entries: Sequence[Entry]) -> Array:
    """The entries' directions, (10 n, entries)."""
    directions = np.zeros((10 * tree.n, len(entries)))
    for k, entry in enumerate(entries):
        for body, direction in entry.direction:
            directions[10 * body : 10 * body + 10, k] += direction
    return directions


def independent_rows(rows: Array) -> list[int]:
    """Indices of the rows that are not combinations of earlier ones."""
    keep: list[int] = []
    basis = np.zeros(rows.shape)
    for k, row in enumerate(rows):
        size = np.linalg.norm(row)
        if size == 0:
            continue
        rest = beyond(row / size, basis[: len(keep)])
        left = np.linalg.norm(rest)
        if left > INDEPENDENT:
            basis[len(keep)] = rest / left
            keep.append(k)
    return keep


def static_entries(tree: Tree, bodies: Sequence[Body], gravity: Array) -> list[Entry]:
    """The base rule: F_0 = -M g, L_0 = -s x g; the mass M and s normal to g.

    M is the sum of the first bodies' mbar, s their first moments and what has migrated
    into the bedplate. Directions are left empty.

    Args:
        tree: The robot.
        bodies: Regrouped for the reaction.
        gravity: Not zero, (3,) [m/s^2], bedplate frame.
    """
    trunks = tree.children(-1)
    u, v, letters = across(gravity / np.linalg.norm(gravity))
    mass = f"mbar{trunks[0] + 1}" if len(trunks) == 1 else "mbar0"
    wanted = [(mass, "kg", np.eye(10)[0])]
    for direction, letter in zip((u, v), letters, strict=True):
        wanted.append((f"mb*0{letter}", "kg m", np.pad(direction, (1, 6))))
    entries = []
    for name, unit, form in wanted:
        parts = []
        for j in trunks:
            own = form @ bodies[j].gain
            own[0] += form[0] + form[1:4] @ tree.joints[j].offset
            parts.append((j, own))
        entries.append(Entry(name, unit, -1, form, tuple(parts), ()))
    return entries


def _with_static(tree: Tree, entries: list[Entry], static: list[Entry]) -> list[Entry]:
    """Add what is new of the static entries, with directions that leave the others alone.

    Static entries are forms of the first bodies' parameters, and so decided among these.
    """
    trunks = tree.children(-1)
    ours = [k for k, entry in enumerate(entries) if entry.body in trunks]
    s = _flat([entries[k].parts for k in ours], trunks)
    d = _flat([entries[k].direction for k in ours], trunks).T
    r = _flat([entry.parts for entry in static], trunks)
    blind = r - (r @ d) @ s  # r (1 - d s): what the rules' entries do not hold
    # rows of masses and lengths; rescaled, the rounding of an almost vertical axis would count
    blind[np.abs(blind).max(axis=1) <= INDEPENDENT] = 0.0
    new = independent_rows(blind)
    if not new:
        return entries
    r, blind = r[new], blind[new]
    push = blind.T
    for _ in range(3):  # repeated against rounding: an axis may be only slightly inclined
        push = push - d @ (s @ push)
        push = push @ np.linalg.inv(r @ push)
    d = d - push @ (r @ d)
    result = list(entries)
    for column, k in enumerate(ours):
        result[k] = replace(entries[k], direction=_by_body(d[:, column], trunks))
    for column, k in enumerate(new):
        result.append(replace(static[k], direction=_by_body(push[:, column], trunks)))
    return result


def _flat(parts: Sequence[Parts], trunks: tuple[int, ...]) -> Array:
    """Parts on the first bodies as rows, (entries, 10 trunks)."""
    rows = np.zeros((len(parts), 10 * len(trunks)))
    for k, part in enumerate(parts):
        for body, numbers in part:
            at = 10 * trunks.index(body)
            rows[k, at : at + 10] += numbers
    return rows


def _by_body(column: Array, trunks: tuple[int, ...]) -> Parts:
    pieces = zip(trunks, column.reshape(-1, 10), strict=True)
    return tuple((body, piece) for body, piece in pieces if piece.any())


def present_parameters(
    tree: Tree, bodies: Sequence[Body], known_zero: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which redefined parameters of which bodies are not known to be zero, (n, 10)."""
    present = ~known_zero
    for j in reversed(range(tree.n)):
        if tree.parents[j] >= 0:
            present[tree.parents[j]] |= (bodies[j].gain[:, present[j]] != 0).any(axis=1)
    return present
