"""What the kernel works on: links, rows and columns as plain arrays, laid out once a robot.

A channel is a measured quantity with a row of the regressor: a joint's torque, or one of
the bedplate wrench's six components. Its slots are its columns body by body, its joint's
own terms, the measurement, and zeros up to a multiple of four. A column is one parameter
of one body about canonical axes; `Layout.basis` leads from there to the unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.kernel.channels import Canonical, Draft, Shelf, bools, canonical, ints
from testbed.kernel.records import ORDER, SEEDS, SLIDING, TURNING, Ints, Robot, Rows
from testbed.parameters.minimal_set import MinimalSet
from testbed.parameters.row_space import beyond
from testbed.parameters.rules import Model
from testbed.robot.friction import LAWS, JointTerm
from testbed.robot.locks import shares
from testbed.robot.tree import Tree

TINY = 1e-13
"""Coefficients that are zero but for rounding."""

UNKNOWN = -1
"""Number of a law that is not in LAWS: the NumPy engine alone makes its columns."""


@dataclass(frozen=True, eq=False)
class Layout:
    """A robot's rows for one method.

    Attributes:
        tree: The robot; only its geometry matters.
        gravity: (3,) [m/s^2], bedplate frame.
        model: "dynamic" for a channel a joint, "reaction" for the bedplate's six.
        terms: The joints' own columns.
        robot: For the kernel.
        rows: For the kernel.
        theta: Barycentric parameters of every body column, (n, 10, P').
        basis: (P, unknowns): columns @ basis is the regressor of the minimal parameters,
            then of the terms.
        channels: Columns of every channel, in the order of its slots.
    """

    tree: Tree
    gravity: Array
    model: Model
    terms: tuple[JointTerm, ...]
    robot: Robot
    rows: Rows
    theta: Array
    basis: Array
    channels: tuple[Ints, ...]

    @property
    def width(self) -> int:
        """Number of measured channels."""
        return len(self.channels)

    def combined(self, rows: Array, lead: Array) -> Array:
        """Combinations of the columns, (C, k, q).

        Args:
            rows: All slots, (slots, k).
            lead: How the columns are combined, (P, q).
        """
        found = np.empty((self.width, rows.shape[1], lead.shape[1]))
        for c, own in enumerate(self.channels):
            at = self.rows.start[c]
            found[c] = rows[at : at + len(own)].T @ lead[own]
        return found

    @property
    def compiles(self) -> bool:
        """Whether the compiled kernel knows all columns: those of laws in LAWS, at joints."""
        return all(term.law in LAWS and term.joint < self.tree.n for term in self.terms)


def layout(
    tree: Tree, minimal: MinimalSet, terms: Sequence[JointTerm] = (), joined: bool = False
) -> Layout:
    """Lay out the rows of a minimal set.

    Args:
        tree: The robot; only its geometry matters.
        minimal: delta_d or delta_r.
        terms: The joints' own columns, for a dynamic set.
        joined: Whether products across channels are wanted.
    """
    frames = canonical(tree)
    turns = frames.to_canonical()
    picked, lead = _columns(turns, minimal, whole=tree.floating)
    own = len(terms)
    basis = np.zeros((len(picked) + own, minimal.count + own))
    basis[: len(picked), : minimal.count] = lead
    basis[len(picked) :, minimal.count :] = np.eye(own)
    places: list[list[tuple[int, int]]] = [[] for _ in frames.links]
    for column, parameter in enumerate(picked):
        entry = ORDER.index(parameter % 10)
        places[frames.place[parameter // 10]].append((entry, column))
    draft = Draft(frames, [sorted(each) for each in places])
    turn = shares(tree)
    if minimal.model == "dynamic":
        for j, link in enumerate(frames.place):
            extra = [
                (LAWS.index(term.law) if term.law in LAWS else UNKNOWN, len(picked) + k)
                for k, term in enumerate(terms)
                if turn[term.joint, j]
            ]
            draft.channel(link, frames.links[link].slides, extra)
    else:
        for axis in range(6):
            draft.channel(-1, axis < 3, [])
    return Layout(
        tree=tree,
        gravity=minimal.gravity,
        model=minimal.model,
        terms=tuple(terms),
        robot=_robot(frames, minimal.gravity),
        rows=draft.rows(joined),
        theta=_theta(turns, picked),
        basis=basis,
        channels=tuple(draft.columns),
    )


def _theta(turns: Array, picked: list[int]) -> Array:
    """Barycentric parameters, about the bodies' own axes, of canonical units, (n, 10, P)."""
    back = np.linalg.inv(turns)
    theta = np.zeros((*back.shape[:2], len(picked)))
    for column, parameter in enumerate(picked):
        theta[parameter // 10, :, column] = back[parameter // 10, :, parameter % 10]
    return theta


def _robot(frames: Canonical, gravity: Array) -> Robot:
    links = frames.links
    places = [0]  # the bedplate's
    shelf = Shelf(links, 1)
    for k in range(len(links)):
        places.append(shelf.put(0, k))
    seeds = np.zeros((SEEDS, 6))
    seeds[:3, 3:] = seeds[3:6, :3] = frames.bedplate  # row k: the bedplate's axis k
    seeds[TURNING, 2] = seeds[SLIDING, 5] = 1.0
    return Robot(
        coordinate=np.array([link.joint for link in links]),
        place=ints(places[1:]),
        carrier=ints([places[link.parent + 1] for link in links]),
        slides=np.array([link.slides for link in links]),
        square=bools([abs(link.lean[0]) < TINY and link.lean[1] > 0 for link in links]),
        joint=np.array(
            [
                (*link.lean, *link.offset, link.turn, np.cos(link.turn), np.sin(link.turn))
                for link in links
            ]
        ),
        ground=-frames.bedplate.T @ gravity,
        seeds=seeds,
    )


def _columns(turn: Array, minimal: MinimalSet, *, whole: bool) -> tuple[list[int], Array]:
    """Canonical parameters to take as columns, and how they make up the minimal ones.

    As many as there are minimal parameters where their span allows it, else all that the
    lift needs; with `whole` always these, since the masses of a free base's coordinates are one.
    Returns indices among the 10 n, and (P, N).
    """
    lift = np.einsum("jab,jbn->jan", turn, minimal.lift.reshape(len(turn), 10, -1))
    lift = lift.reshape(10 * len(turn), -1)
    needed = np.flatnonzero(np.abs(lift).max(axis=1, initial=0.0) > TINY)
    if len(needed) > minimal.count and not whole:
        back = np.linalg.inv(turn)
        allowed = ~(np.abs(back) * minimal.known_zero[:, :, None] > TINY).any(axis=1).ravel()
        seen = np.einsum("njb,jbc->njc", minimal.matrix.reshape(-1, len(turn), 10), back)
        seen = seen.reshape(minimal.count, -1) * allowed
        order = [10 * j + c for c in ORDER for j in range(len(turn))]
        picked = sorted(independent_columns(seen, order))
        if len(picked) == minimal.count:
            return picked, np.linalg.inv(seen[:, picked])
    return needed.tolist(), lift[needed]


def independent_columns(matrix: Array, order: Sequence[int]) -> list[int]:
    """Columns that span all others, earlier ones preferred unless nearly dependent."""
    picked: list[int] = []
    basis = np.zeros((0, len(matrix)))
    for threshold in (0.3, 0.03, 1e-3, 1e-6):
        for k in order if len(picked) < len(matrix) else ():
            rest = beyond(matrix[:, k], basis)
            left = np.linalg.norm(rest)
            if left > threshold:
                picked.append(k)
                basis = np.vstack([basis, rest / left])
    return picked
