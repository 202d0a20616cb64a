"""What the kernel works on: links, rows and columns as plain arrays, laid out once a robot.

A channel is a measured quantity with a row of the regressor: a joint's torque, or one of
the bedplate wrench's six components. Its slots are its columns body by body, its joint's
own terms, the measurement, and zeros up to a multiple of four. A column is one parameter
of one body about canonical axes; `Layout.basis` leads from there to the unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.transform import Transform
from testbed.core.kernel.independent_columns import independent_columns
from testbed.core.kernel.records import (
    CACHE,
    KS,
    MBAR,
    NB,
    ORDER,
    PUSHED,
    SEEDS,
    SLIDING,
    TURNING,
    UNKNOWN,
    USUAL,
    Ints,
    Robot,
    Rows,
    ints,
    law_number,
)
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.regroup import moved_inertia
from testbed.core.parameters.rules import Model, across
from testbed.core.robot.friction import JointTerm
from testbed.core.robot.shafts import shares
from testbed.core.robot.tree import Tree

STRAIGHT = 1e-14
"""Sine of a lean that is none."""


@dataclass(frozen=True, eq=False)
class KernelLink:
    """One step outward: an offset, a turn about x, then the joint along or about z.

    Attributes:
        joint: Index of the tree's joint; -1 for a resting frame.
        parent: Index of the link that carries it, -1 for the bedplate.
        slides: Whether the joint is prismatic, or the frame rests.
        offset: (3,) [m], in the carrying link's frame.
        lean: Cosine and sine of the turn about x.
        turn: Constant part of the turn about z [rad].
    """

    joint: int
    parent: int
    slides: bool
    offset: Array
    lean: tuple[float, float]
    turn: float


@dataclass(frozen=True, eq=False)
class Canonical:
    """A tree in canonical frames.

    Attributes:
        links: Parents first.
        place: Index of each joint's link, (n,).
        frames: Orientation of each body's canonical frame in its own, (n, 3, 3).
        bedplate: Orientation of the bedplate's canonical frame, (3, 3).
    """

    links: tuple[KernelLink, ...]
    place: tuple[int, ...]
    frames: Array
    bedplate: Array

    def to_canonical(self) -> Array:
        """Barycentric parameters about canonical axes from those about the bodies', (n, 10, 10)."""
        turned = np.stack([moved_inertia(Transform(R_BC.T)) for R_BC in self.frames])
        return np.where(np.abs(turned) < STRAIGHT, 0.0, turned)


def canonical(tree: Tree) -> Canonical:
    """The tree's canonical frames.

    Args:
        tree: The robot; only its geometry matters.
    """
    frames = [
        np.eye(3),
        *(across(joint.axis).R_BT for joint in tree.joints),
    ]  # bedplate first
    for i in range(-1, tree.n):
        leans = [_lean(_between(tree, frames, j)) for j in tree.children(i)]
        first = next((angle for angle in leans if angle is not None), None)
        if first:
            frames[i + 1] = frames[i + 1] @ _about_z(first)
    links: list[KernelLink] = []
    place: list[int] = []
    for j, joint in enumerate(tree.joints):
        parent = place[joint.parent] if joint.parent >= 0 else -1
        turn, offset = (
            _between(tree, frames, j),
            frames[joint.parent + 1].T @ joint.offset,
        )
        aside = _lean(turn)
        if aside:
            links.append(KernelLink(-1, parent, True, np.zeros(3), (1.0, 0.0), aside))
            back = _about_z(-aside)
            parent, turn, offset = len(links) - 1, back @ turn, back @ offset
        lean = (float(turn[2, 2]), float(-turn[1, 2]))
        rest = _about_x(*lean).T @ turn
        angle = float(np.arctan2(rest[1, 0], rest[0, 0]))
        place.append(len(links))
        links.append(KernelLink(j, parent, not joint.revolute, offset, lean, angle))
        if j == tree.sensor_body:  # what it feels rests on the cut
            links.append(KernelLink(-1, place[j], True, np.zeros(3), (1.0, 0.0), 0.0))
            place[j] += 1
    return Canonical(tuple(links), tuple(place), np.stack(frames[1:]), frames[0])


def _between(tree: Tree, frames: list[Array], j: int) -> Array:
    """From joint j's canonical frame at rest to its carrier's, (3, 3)."""
    joint = tree.joints[j]
    return frames[joint.parent + 1].T @ joint.rotation @ frames[j + 1]


def _lean(turn: Array) -> float | None:
    """The turn about z before which `turn` leans about x only; None if it does not lean."""
    if np.hypot(turn[0, 2], turn[1, 2]) < STRAIGHT:
        return None
    angle = float(np.arctan2(turn[0, 2], -turn[1, 2]))
    return 0.0 if abs(angle) < STRAIGHT else angle


def _about_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _about_x(c: float, s: float) -> Array:
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


class Pair(NamedTuple):
    """A screw on a link, before places are numbers."""

    channel: int
    own: bool
    force: bool
    slot: int
    direct: int  # entries written where they belong
    entries: list[int]


class Shelf:
    """Places in the workspace, used again once all links outward have been seen."""

    def __init__(self, links: Sequence[KernelLink], first: int) -> None:
        self.links, self.count = links, first
        self.carried = np.bincount(
            [link.parent + 1 for link in links], minlength=len(links) + 1
        )
        self.places: dict[tuple[int, int], int] = {}
        self.left: dict[tuple[int, int], int] = {}
        self.free: list[int] = []

    def put(self, channel: int, link: int) -> int:
        """A place for what a channel holds of a link."""
        if not self.free:
            self.free.append(self.count)
            self.count += 1
        place = self.free.pop()
        self.places[channel, link], self.left[channel, link] = (
            place,
            self.carried[link + 1],
        )
        for done in ((channel, link), (channel, self.links[link].parent)):
            if done in self.left:
                self.left[done] -= done[1] != link
                if self.left[done] == 0:
                    self.free.append(self.places[done])
        return place


class LayoutBuilder:
    """Builder of a layout: channels are added one by one, `rows` makes arrays of them."""

    def __init__(
        self, frames: Canonical, places: list[list[tuple[int, int]]], base: int = -1
    ) -> None:
        self.links, self.places, self.base = frames.links, places, base
        self.pairs: list[list[Pair]] = [[] for _ in self.links]
        self.terms: list[tuple[int, int, int]] = []  # slot, link, law
        self.starts: list[int] = []
        self.measured: list[int] = []
        self.owners: list[int] = []
        self.widths: list[int] = []
        self.columns: list[Ints] = []
        self.slots = 0

    def channel(self, link: int, force: bool, terms: list[tuple[int, int]]) -> None:
        """Add the row of a link's joint, or, for -1, of the measured wrench's next seed."""
        start, columns = self.slots, list[int]()
        pairs = []
        for k in range(len(self.links)):
            if self._carries(self.base if link < 0 else link, k):
                here = [p for p in self.places[k] if not force or p[0] in PUSHED]
                inner = k != link and not self._stands(k)
                if (
                    inner and not self.links[k].slides
                ):  # its carriers know its mass already
                    here = [p for p in here if p[0] != MBAR]
                pairs.append(
                    (k, self.slots, [e + (e == MBAR and inner) for e, _ in here])
                )
                columns += [column for _, column in here]
                self.slots += len(here)
        for law, column in terms:
            self.terms.append((self.slots, link, law))
            columns.append(column)
            self.slots += 1
        self.measured.append(self.slots)
        for k, slot, entries in pairs:
            made = (
                2 if force else USUAL
            )  # entries written there at once; later ones overwrite
            usual = [e for e in entries if e < USUAL]
            fits = usual == list(range(len(usual))) and slot + made <= self.slots + 1
            pair = Pair(
                len(self.starts), k == link, force, slot, len(usual) * fits, entries
            )
            self.pairs[k].append(pair)
        self.slots = start + -(-(self.slots + 1 - start) // 4) * 4
        self.starts.append(start)
        self.owners.append(max(link, 0))
        self.widths.append(self.slots - start)
        self.columns.append(np.array(columns, dtype=np.int64))

    def _stands(self, k: int) -> bool:
        """Whether a link stands on what measures the wrench, a resting frame between or not."""
        if self.base >= 0:
            return k == self.base
        inward = self.links[k].parent
        while inward >= 0 and self.links[inward].joint < 0:
            inward = self.links[inward].parent
        return inward < 0

    def _carries(self, inner: int, outer: int) -> bool:
        while outer > inner:
            outer = self.links[outer].parent
        return outer == inner

    def _paths(self) -> tuple[list[Pair], list[int], list[int]]:
        """All pairs, link by link; where their screws come from, and where they go."""
        shelf = Shelf(self.links, SEEDS)
        pairs, source, target = list[Pair](), list[int](), list[int]()
        for k, link in enumerate(self.links):
            for pair in self.pairs[k]:
                if pair.own:
                    shelf.places[pair.channel, k] = SLIDING if link.slides else TURNING
                    source.append(shelf.places[pair.channel, k])
                    target.append(shelf.places[pair.channel, k])
                else:
                    source.append(
                        shelf.places.get((pair.channel, link.parent), pair.channel)
                    )
                    target.append(shelf.put(pair.channel, k))
                pairs.append(pair)
        return pairs, source, target

    def rows(self) -> Rows:
        """All channels as arrays."""
        pairs, source, target = self._paths()
        sizes = [m + 1 - s for m, s in zip(self.measured, self.starts, strict=True)]
        copies = [
            [(e, pair.slot + n) for n, e in enumerate(pair.entries) if n >= pair.direct]
            for pair in pairs
        ]
        return Rows(
            first=ints(np.cumsum([0, *map(len, self.pairs)])),
            source=ints(source),
            target=ints(target),
            force=np.array([pair.force for pair in pairs], np.bool_),
            slot=ints([pair.slot for pair in pairs]),
            direct=np.array([pair.direct > 0 for pair in pairs], np.bool_),
            rest=np.array(
                [max(pair.entries, default=0) >= USUAL for pair in pairs], np.bool_
            ),
            copies=ints(np.cumsum([0, *map(len, copies)])),
            copy_from=ints([e for each in copies for e, _ in each]),
            copy_to=ints([slot for each in copies for _, slot in each]),
            term_slot=ints([slot for slot, _, _ in self.terms]),
            term_link=ints([link for _, link, _ in self.terms]),
            term_law=ints([law for _, _, law in self.terms]),
            start=ints(self.starts),
            width=ints(self.widths),
            measured=ints(self.measured),
            link=ints(self.owners),
            group_size=ints(sizes),
            group_gram=ints(np.cumsum([0, *(width**2 for width in self.widths[:-1])])),
            slots=self.slots,
            block=int(np.clip(CACHE // (8 * self.slots) // NB * NB, NB, KS)),
        )


TINY = 1e-13
"""Coefficients that are zero but for rounding."""


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

    def combined(self, rows: Array, basis: Array) -> Array:
        """Combinations of the columns, (C, k, q).

        Args:
            rows: All slots, (slots, k).
            basis: How the columns are combined, (P, q).
        """
        result = np.empty((self.width, rows.shape[1], basis.shape[1]))
        for c, own in enumerate(self.channels):
            at = self.rows.start[c]
            result[c] = rows[at : at + len(own)].T @ basis[own]
        return result

    @property
    def compiles(self) -> bool:
        """Whether the compiled kernel knows all columns: those of LAWS, at joints."""
        return all(
            law_number(term.law) != UNKNOWN and term.joint < self.tree.n
            for term in self.terms
        )


def layout(tree: Tree, minimal: MinimalSet, terms: Sequence[JointTerm] = ()) -> Layout:
    """Lay out the rows of a minimal set.

    Args:
        tree: The robot; only its geometry matters.
        minimal: delta_d or delta_r.
        terms: The joints' own columns, for a dynamic set.
    """
    frames = canonical(tree)
    turns = frames.to_canonical()
    picked, weights = _columns(turns, minimal, whole=tree.floating)
    own = len(terms)
    basis = np.zeros((len(picked) + own, minimal.count + own))
    basis[: len(picked), : minimal.count] = weights
    basis[len(picked) :, minimal.count :] = np.eye(own)
    places: list[list[tuple[int, int]]] = [[] for _ in frames.links]
    for column, parameter in enumerate(picked):
        entry = ORDER.index(parameter % 10)
        places[frames.place[parameter // 10]].append((entry, column))
    base = frames.place[tree.sensor_body] if tree.sensor_body >= 0 else -1
    draft = LayoutBuilder(frames, [sorted(each) for each in places], base)
    turn = shares(tree)
    if minimal.model == "dynamic":
        for j, link in enumerate(frames.place):
            extra = [
                (law_number(term.law), len(picked) + k)
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
        robot=_robot(frames, minimal.gravity, tree),
        rows=draft.rows(),
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


def _robot(frames: Canonical, gravity: Array, tree: Tree) -> Robot:
    links = frames.links
    places = [0]  # the bedplate's
    shelf = Shelf(links, 1)
    for k in range(len(links)):
        places.append(shelf.put(0, k))
    seeds = np.zeros((SEEDS, 6))
    here = frames.bedplate if tree.sensor_body < 0 else frames.frames[tree.sensor_body]
    seeds[:3, 3:] = seeds[3:6, :3] = (
        here  # row k: axis k of the bedplate, or of the base
    )
    if tree.sensor is not None:
        seeds[:6] = tree.sensor.X_BS.inverse.wrench_matrix @ seeds[:6]
    seeds[TURNING, 2] = seeds[SLIDING, 5] = 1.0
    return Robot(
        coordinate=np.array([link.joint for link in links]),
        place=ints(places[1:]),
        carrier=ints([places[link.parent + 1] for link in links]),
        slides=np.array([link.slides for link in links]),
        square=np.array(
            [abs(link.lean[0]) < TINY and link.lean[1] > 0 for link in links], np.bool_
        ),
        joint=np.array(
            [
                (
                    *link.lean,
                    *link.offset,
                    link.turn,
                    np.cos(link.turn),
                    np.sin(link.turn),
                )
                for link in links
            ]
        ),
        ground=-frames.bedplate.T @ gravity,
        seeds=seeds,
    )


def _columns(
    turn: Array, minimal: MinimalSet, *, whole: bool
) -> tuple[list[int], Array]:
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
        allowed = (
            ~(np.abs(back) * minimal.known_zero[:, :, None] > TINY).any(axis=1).ravel()
        )
        projected = np.einsum(
            "njb,jbc->njc", minimal.matrix.reshape(-1, len(turn), 10), back
        )
        projected = projected.reshape(minimal.count, -1) * allowed
        order = [10 * j + c for c in ORDER for j in range(len(turn))]
        picked = sorted(independent_columns(projected, order))
        if len(picked) == minimal.count:
            return picked, np.linalg.inv(projected[:, picked])
    return needed.tolist(), lift[needed]
