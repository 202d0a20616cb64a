"""From regrouped bodies to the entries of a minimal set, the bedplate's own included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.parameters.formulas import Namer
from testbed.parameters.regroup import Body, regroup
from testbed.parameters.rules import Model, across
from testbed.tree.tree import Tree

INDEPENDENT = 1e-9
"""Part of a unit row that must be left after projection for it to count as a new one."""

_UNITS = {"mbar": "kg", "mb": "kg m"}


@dataclass(frozen=True, eq=False)
class Entry:
    """One minimal parameter.

    Attributes:
        name: As printed.
        unit: Of its value.
        body: The body it belongs to; -1 for the bedplate.
        form: On that body's ten redefined parameters, (10,).
        row: On the 10 n barycentric parameters, (10 n,).
        direction: A theta for which it is 1 and every other entry 0, (10 n,).
    """

    name: str
    unit: str
    body: int
    form: Array
    row: Array
    direction: Array


def list_entries(
    tree: Tree, model: Model, gravity: Array, known_zero: NDArray[np.bool_], tared: bool
) -> tuple[list[Entry], Namer]:
    """Everything kept, tips to base, and for the reaction what the bedplate adds.

    Args:
        tree: The robot.
        model: "dynamic" or "reaction".
        gravity: (3,) [m/s^2], bedplate frame.
        known_zero: Which of the barycentric parameters are known to be zero, (n, 10).
        tared: The bedplate's static wrench in one posture has been taken off.
    """
    bodies, bedplate = regroup(tree, model, gravity)
    namer = Namer(tree, bodies, known_zero, _present(bodies, known_zero))
    entries: list[Entry] = []
    for j in reversed(range(tree.n)):
        for kept in bodies[j].row.kept:
            direction = np.zeros((tree.n, 10))
            direction[j] = kept.direction
            row = kept.form @ bodies[j].redefined
            unit = _UNITS.get(kept.head, "kg m^2")
            name = namer.kept(j, kept)
            entries.append(Entry(name, unit, j, kept.form, row, direction.ravel()))
    if model == "reaction" and gravity.any() and not tared:
        entries = _with_static(entries, static_entries(tree, bedplate, gravity))
    return entries, namer


def dynamic_first(entries: list[Entry], dynamic: list[Entry]) -> list[Entry]:
    """The parameters shared with the dynamic set first, in its order; then K, mb, mbar."""
    rank = {"kg m^2": 0, "kg m": 1, "kg": 2}
    place = {entry.name: k for k, entry in enumerate(dynamic)}

    def key(entry: Entry) -> tuple[int, int, int]:
        k = place.get(entry.name)
        if k is not None and np.abs(dynamic[k].row - entry.row).max() <= 1e-12:
            return (0, k, 0)
        return (1, -entry.body, rank[entry.unit])

    return sorted(entries, key=key)


def independent_rows(rows: Array) -> list[int]:
    """Indices of the rows that are not combinations of earlier ones."""
    keep: list[int] = []
    basis = np.zeros(rows.shape)
    for k, row in enumerate(rows):
        size = np.linalg.norm(row)
        if size == 0:
            continue
        rest, found = row / size, basis[: len(keep)]
        for _ in range(2):  # twice is enough against rounding
            rest = rest - found.T @ (found @ rest)
        left = np.linalg.norm(rest)
        if left > INDEPENDENT:
            basis[len(keep)] = rest / left
            keep.append(k)
    return keep


def _present(bodies: Sequence[Body], known_zero: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which redefined parameters of which bodies are not zero, (n, 10)."""
    seen = ~known_zero.ravel()
    return np.array([(body.redefined[:, seen] != 0).any(axis=1) for body in bodies])


def static_entries(tree: Tree, bedplate: Array, gravity: Array) -> list[Entry]:
    """The base rule: F_0 = -M g, L_0 = -s x g; the mass M and s normal to g.

    M is the sum of the first bodies' mbar, s their first moments and what has migrated
    into the bedplate.

    Args:
        tree: The robot.
        bedplate: What has migrated, on the barycentric parameters, (10, 10 n).
        gravity: Not zero, (3,) [m/s^2], bedplate frame.
    """
    trunks = tree.children(-1)
    whole = bedplate.copy()
    for j in trunks:
        whole[0, 10 * j] += 1.0
        whole[1:4, 10 * j] += tree.joints[j].offset
    u, v, letters = across(gravity / np.linalg.norm(gravity))
    mass = f"mbar{trunks[0] + 1}" if len(trunks) == 1 else "mbar0"
    wanted = [(mass, "kg", np.eye(10)[0])]
    for direction, letter in zip((u, v), letters, strict=True):
        wanted.append((f"mb*0{letter}", "kg m", np.pad(direction, (1, 6))))
    nothing = np.zeros(10 * tree.n)
    return [Entry(name, unit, -1, form, form @ whole, nothing) for name, unit, form in wanted]


def _with_static(entries: list[Entry], static: list[Entry]) -> list[Entry]:
    """Add what is new of the static entries, with directions that leave the others alone."""
    if not entries:
        return entries
    s = np.array([entry.row for entry in entries])
    d = np.array([entry.direction for entry in entries]).T
    r = np.array([entry.row for entry in static])
    blind = r - (r @ d) @ s  # r (1 - d s): what the rules' entries do not hold
    blind[np.abs(blind).max(axis=1) <= INDEPENDENT * np.abs(r).max(axis=1)] = 0.0
    new = independent_rows(blind)
    if not new:
        return entries
    r, blind = r[new], blind[new]
    push = blind.T - d @ (s @ blind.T)
    push = push @ np.linalg.inv(r @ push)
    d = d - push @ (r @ d)
    kept = [replace(entry, direction=d[:, k]) for k, entry in enumerate(entries)]
    return kept + [replace(static[k], direction=push[:, m]) for m, k in enumerate(new)]
