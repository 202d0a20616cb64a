"""The minimal set: which combinations of the barycentric parameters a measurement can tell.

Source    [FRS96] eqs. (9)-(12), the base rule and known zeros in docs/minimal-sets.md
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array, readonly
from testbed.parameters.barycentric import barycentric
from testbed.parameters.formulas import Namer
from testbed.parameters.regroup import Body, regroup
from testbed.parameters.rules import Model
from testbed.tree.tree import Tree

INDEPENDENT = 1e-9
"""Part of a unit row that must be left after projection for it to count as a new one."""

NO_MATTER = 1e-12
"""A parameter this much smaller than its body's others of the same unit is zero in the file."""


@dataclass(frozen=True, eq=False)
class MinimalSet:
    """The minimal parameters delta = S theta of one model of one robot.

    Attributes:
        model: "dynamic" (joint torques, delta_d) or "reaction" (bedplate wrench, delta_r).
        names: One a parameter: mb*2z, K3yy, 2*K3d, ...; stars mark redefined bodies.
        formulas: How each is regrouped from the body's own and its children's parameters.
        auxiliary: Formulas of the starred parameters which those refer to.
        units: One a parameter.
        bodies: Index of the body each belongs to; -1 for the base rule.
        matrix: S, (N, 10 n), on the barycentric parameters in the order of `barycentric`.
        lift: (10 n, N), a theta that has given minimal parameters, eliminated ones zero:
            S lift = 1, and the model does not change by theta -> lift S theta.
        gravity: The gravity assumed, (3,) [m/s^2], bedplate frame.
    """

    model: Model
    names: tuple[str, ...]
    formulas: tuple[str, ...]
    auxiliary: tuple[str, ...]
    units: tuple[str, ...]
    bodies: tuple[int, ...]
    matrix: Array
    lift: Array
    gravity: Array

    @property
    def count(self) -> int:
        """Number N of minimal parameters."""
        return len(self.names)

    def values(self, theta: ArrayLike) -> Array:
        """Delta = S theta, (N,), of barycentric parameters theta, (n, 10)."""
        delta: Array = self.matrix @ np.ravel(np.asarray(theta, dtype=np.float64))
        return delta


@dataclass(frozen=True, eq=False)
class _Entry:
    name: str
    formula: str
    unit: str
    body: int
    row: Array  # on theta, (10 n,)
    direction: Array  # of theta, (10 n,)


def minimal_set(
    tree: Tree,
    model: Model,
    gravity: ArrayLike | None = None,
    zeros: bool = False,
) -> MinimalSet:
    """The minimal parameters by the recursive rules, [FRS96] Tables 2-5.

    Order: body by body from the tips to the base, as in the paper; a reaction set starts
    with the parameters it shares with the dynamic one.

    Args:
        tree: The robot; its inertias matter only for `zeros`.
        model: "dynamic" for joint torques, "reaction" for the bedplate's wrench.
        gravity: Gravity acceleration, (3,) [m/s^2], bedplate frame; default the model file's.
        zeros: Take barycentric parameters that are zero in the model file as known.
    """
    g = tree.gravity_or(gravity)
    known_zero = zero_parameters(tree) if zeros else np.zeros(10 * tree.n, dtype=bool)
    entries, namer = _entries(tree, model, g, known_zero)
    if model == "reaction":
        entries = _dynamic_first(entries, _entries(tree, "dynamic", g, known_zero)[0])
    rows = np.array([entry.row for entry in entries])
    rows[:, known_zero] = 0.0
    keep = independent_rows(rows)
    directions = np.array([entry.direction for entry in entries])
    lift = (_coordinates(rows, keep) @ directions).T
    kept = [entries[k] for k in keep]
    return MinimalSet(
        model=model,
        names=tuple(entry.name for entry in kept),
        formulas=tuple(entry.formula for entry in kept),
        auxiliary=_auxiliary(kept, namer, tree),
        units=tuple(entry.unit for entry in kept),
        bodies=tuple(entry.body for entry in kept),
        matrix=readonly(rows[keep], (len(keep), 10 * tree.n), "matrix"),
        lift=readonly(lift, (10 * tree.n, len(keep)), "lift"),
        gravity=g,
    )


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


def zero_parameters(tree: Tree) -> Array:
    """Which of the 10 n barycentric parameters are zero in the model file, (10 n,) booleans."""
    theta = np.abs(barycentric(tree))
    zero = np.zeros(theta.shape, dtype=bool)
    for columns in (slice(0, 1), slice(1, 4), slice(4, 10)):
        scale = theta[:, columns].max(axis=1, keepdims=True)
        zero[:, columns] = theta[:, columns] <= NO_MATTER * scale
    return np.asarray(zero.ravel())


def independent_rows(rows: Array) -> list[int]:
    """Indices of the rows that are not combinations of earlier ones."""
    keep: list[int] = []
    basis = np.zeros((0, rows.shape[1]))
    for k, row in enumerate(rows):
        size = np.linalg.norm(row)
        if size == 0:
            continue
        rest = row / size
        for _ in range(2):  # twice is enough against rounding
            rest = rest - basis.T @ (basis @ rest)
        if np.linalg.norm(rest) > INDEPENDENT:
            keep.append(k)
            basis = np.vstack([basis, rest / np.linalg.norm(rest)])
    return keep


def _coordinates(rows: Array, keep: list[int]) -> Array:
    """How much of each kept row every row holds, (kept, all): the identity on those kept."""
    coordinates = np.zeros((len(keep), len(rows)))
    coordinates[range(len(keep)), keep] = 1.0
    dropped = [k for k in range(len(rows)) if k not in keep and rows[k].any()]
    if dropped:
        coordinates[:, dropped] = np.linalg.lstsq(rows[keep].T, rows[dropped].T, rcond=None)[0]
    return coordinates


def _entries(
    tree: Tree, model: Model, gravity: Array, known_zero: Array
) -> tuple[list[_Entry], Namer]:
    """Everything kept, tips to base, and for the reaction what the bedplate adds."""
    bodies, bedplate = regroup(tree, model, gravity)
    namer = Namer(tree, bodies, known_zero)
    entries: list[_Entry] = []
    for j in reversed(range(tree.n)):
        for kept in bodies[j].row.kept:
            name = namer.kept(j, kept)
            direction = np.zeros((tree.n, 10))
            direction[j] = kept.direction
            unit = {"mbar": "kg", "mb": "kg m"}.get(kept.head, "kg m^2")
            formula = namer.formula(name, j, kept.form)
            row = kept.form @ bodies[j].redefined
            entries.append(_Entry(name, formula, unit, j, row, direction.ravel()))
    if model == "reaction" and gravity.any():
        entries = _with_base(entries, _base_rows(tree, bodies, bedplate, gravity))
    return entries, namer


def _base_rows(tree: Tree, bodies: Sequence[Body], bedplate: Array, gravity: Array) -> list[_Entry]:
    """The static wrench of what stands on the bedplate: its mass, and two first moments.

    The base rule: F_0 = -M_0 g, L_0 = -s_0 x g, with M_0 the sum of the first bodies' mbar
    and s_0 their first moments plus what has migrated into the bedplate.
    """
    trunks = tree.children(-1)
    mass = np.zeros(10 * tree.n)
    moment = bedplate[1:4].copy()
    for j in trunks:
        mass[10 * j] = 1.0
        moment[:, 10 * j] += tree.joints[j].offset
    nothing = np.zeros(10 * tree.n)
    total = " + ".join(f"mbar{j + 1}" for j in trunks)
    name = total if len(trunks) == 1 else "mbar0"
    rows = [_Entry(name, f"{name} = {total}", "kg", -1, mass, nothing)]
    along = gravity / np.linalg.norm(gravity)
    drop = int(np.argmax(np.abs(along)))
    for x in (x for x in range(3) if x != drop):
        # normal to gravity: the component along the unit vector left of x after projection
        normal = np.eye(3)[x] - along[x] * along
        if np.count_nonzero(np.abs(along) > 1e-12) == 1:
            name, normal = f"mb*0{'xyz'[x]}", np.eye(3)[x]
        else:
            name = f"mb*0n{'xyz'[x]}"
        static = f"{name} = static moment of all bodies along {np.round(normal, 6).tolist()}"
        rows.append(_Entry(name, static, "kg m", -1, normal @ moment, nothing))
    return rows


def _with_base(entries: list[_Entry], base: list[_Entry]) -> list[_Entry]:
    """Add the base entries that are new, with directions that leave the others unchanged."""
    rows = np.array([entry.row for entry in entries + base])
    new = [k - len(entries) for k in independent_rows(rows) if k >= len(entries)]
    if not new:
        return entries
    s, d = rows[: len(entries)], np.array([entry.direction for entry in entries]).T
    r = np.array([base[k].row for k in new])
    blind = r - (r @ d) @ s  # r (1 - d s): what the rules' entries do not hold
    push = blind.T - d @ (s @ blind.T)
    push = push @ np.linalg.inv(r @ push)
    d = d - push @ (r @ d)
    moved = [replace(entry, direction=d[:, k]) for k, entry in enumerate(entries)]
    return moved + [replace(base[k], direction=push[:, m]) for m, k in enumerate(new)]


def _dynamic_first(entries: list[_Entry], dynamic: list[_Entry]) -> list[_Entry]:
    """The parameters shared with the dynamic set first, in its order; then K, mb, mbar."""
    rank = {"kg m^2": 0, "kg m": 1, "kg": 2}
    place: dict[str, int] = {entry.name: k for k, entry in enumerate(dynamic)}

    def key(entry: _Entry) -> tuple[int, int, int]:
        shared = entry.name in place and np.allclose(
            dynamic[place[entry.name]].row, entry.row, rtol=0, atol=1e-12
        )
        return (0, place[entry.name], 0) if shared else (1, -entry.body, rank[entry.unit])

    return sorted(entries, key=key)


def _auxiliary(kept: Sequence[_Entry], namer: Namer, tree: Tree) -> tuple[str, ...]:
    """Formulas of the starred parameters that the kept ones refer to, tips first."""
    known = {entry.name for entry in kept}
    wanted = " ".join(entry.formula.split("=", 1)[1] for entry in kept)
    found: list[str] = []
    for body in range(tree.n):
        for component in range(1, 10):
            name = namer.component(body, component)
            if "*" in name and name not in known and _mentions(wanted, name):
                formula = namer.formula(name, body, np.eye(10)[component])
                wanted += " " + formula.split("=", 1)[1]
                found.insert(0, formula)
    return tuple(found)


def _mentions(text: str, name: str) -> bool:
    return any(word.endswith(name) for word in text.replace("/", " ").split())
