"""Layout of regressor rows for the kernel: arrays of links, rows and columns.

A channel is a measured quantity with a row of the regressor: the torque of a joint, or one of the
six components of the wrench. A slot is an array for one element of this row. The slots of a channel
hold the body columns, body by body, the joint terms, the measurement, and zeros up to a multiple of
four. A column belongs to one parameter of one body about canonical axes; `Layout.basis` maps the
columns to the unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.kernel.canonical_frames import (
    CanonicalFrames,
    KernelLink,
    canonical_frames,
)
from testbed.core.kernel.independent_columns import independent_columns
from testbed.core.kernel.records import (
    ENTRY_PARAMETERS,
    FORCE_ENTRIES,
    LEADING_ENTRIES,
    MASS_ENTRY,
    MAX_BLOCK_BYTES,
    MAX_BLOCK_ROWS,
    NB,
    NO_LAW,
    PRISMATIC_SEED,
    REVOLUTE_SEED,
    SEED_COUNT,
    Ints,
    LinkArrays,
    RowArrays,
    int_array,
    law_number,
)
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.rules import Signal
from testbed.core.robot.friction import JointTerm
from testbed.core.robot.shafts import transmission_matrix
from testbed.core.robot.tree import Tree


class Pair(NamedTuple):
    """Screw of a channel on a link, with slots (arrays) and entries of the row.

    Attributes:
        channel: Index of the channel.
        own: True for the screw of the link's own joint.
        force: True for a screw without angular part.
        slot: Index of the first slot.
        direct: Number of entries that are written to their slots without a copy.
        entries: Row entries as in `records.ENTRY_PARAMETERS`, in the order of the slots.
    """

    channel: int
    own: bool
    force: bool
    slot: int
    direct: int
    entries: list[int]


class IndexAllocator:
    """Allocator of workspace indices; an index is reused after all carried links are visited.

    Args:
        links: Links, parents first.
        first: First free index.
    """

    def __init__(self, links: Sequence[KernelLink], first: int) -> None:
        self.links, self.count = links, first
        self.carried = np.bincount(
            [link.parent + 1 for link in links], minlength=len(links) + 1
        )
        self.places: dict[tuple[int, int], int] = {}
        self.remaining: dict[tuple[int, int], int] = {}
        self.free: list[int] = []

    def allocate(self, channel: int, link: int) -> int:
        """Allocate a workspace index for the data of a channel on a link."""
        if not self.free:
            self.free.append(self.count)
            self.count += 1
        place = self.free.pop()
        self.places[channel, link], self.remaining[channel, link] = (
            place,
            self.carried[link + 1],
        )
        for visited in ((channel, link), (channel, self.links[link].parent)):
            if visited in self.remaining:
                self.remaining[visited] -= visited[1] != link
                if self.remaining[visited] == 0:
                    self.free.append(self.places[visited])
        return place


class LayoutBuilder:
    """Builder of row arrays, to which channels are added one by one.

    Args:
        frames: Links in canonical frames.
        places: Kernel entries of each link, paired with their columns.
        base: Index of the link that carries the sensor; -1 for the bedplate.
    """

    def __init__(
        self,
        frames: CanonicalFrames,
        places: list[list[tuple[int, int]]],
        base: int = -1,
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

    def add_channel(self, link: int, force: bool, terms: list[tuple[int, int]]) -> None:
        """Add the row of a joint or of a component of the wrench.

        The slots (arrays) of the row hold the columns of the moved bodies, the joint terms, the
        measurement, and zeros up to a multiple of four.

        Args:
            link: Link of the joint; -1 for the next component of the wrench.
            force: True for the force of a prismatic joint, or a force component of the wrench.
            terms: Indices of the law and of the column, for each joint term.
        """
        start, columns = self.slots, list[int]()
        pairs = []
        for k in range(len(self.links)):
            if self._is_carrier(self.base if link < 0 else link, k):
                entries_and_columns = [
                    p for p in self.places[k] if not force or p[0] in FORCE_ENTRIES
                ]
                inner = k != link and not self._is_on_sensor(k)
                # carriers of a revolute joint's body include its mass
                if inner and not self.links[k].prismatic:
                    entries_and_columns = [
                        p for p in entries_and_columns if p[0] != MASS_ENTRY
                    ]
                pairs.append(
                    (
                        k,
                        self.slots,
                        [
                            e + (e == MASS_ENTRY and inner)
                            for e, _ in entries_and_columns
                        ],
                    )
                )
                columns += [column for _, column in entries_and_columns]
                self.slots += len(entries_and_columns)
        for law, column in terms:
            self.terms.append((self.slots, link, law))
            columns.append(column)
            self.slots += 1
        self.measured.append(self.slots)
        for k, slot, entries in pairs:
            # entries written together; those of later pairs overwrite the excess
            written = 2 if force else LEADING_ENTRIES
            leading = [e for e in entries if e < LEADING_ENTRIES]
            fits = (
                leading == list(range(len(leading)))
                and slot + written <= self.slots + 1
            )
            pair = Pair(
                len(self.starts), k == link, force, slot, len(leading) * fits, entries
            )
            self.pairs[k].append(pair)
        self.slots = start + -(-(self.slots + 1 - start) // 4) * 4
        self.starts.append(start)
        self.owners.append(max(link, 0))
        self.widths.append(self.slots - start)
        self.columns.append(np.array(columns, dtype=np.int64))

    def _is_on_sensor(self, k: int) -> bool:
        """True if only frames without joints are between a link and the bedplate or sensor."""
        if self.base >= 0:
            return k == self.base
        inward = self.links[k].parent
        while inward >= 0 and self.links[inward].joint < 0:
            inward = self.links[inward].parent
        return inward < 0

    def _is_carrier(self, inner: int, outer: int) -> bool:
        """True if the inner link equals the outer link or carries it, directly or indirectly."""
        while outer > inner:
            outer = self.links[outer].parent
        return outer == inner

    def _pair_screws(self) -> tuple[list[Pair], list[int], list[int]]:
        """Pairs of screws and links, link by link, with workspace indices of the screws.

        Returns:
            The pairs; for each pair, the workspace index of its screw on the link's carrier; and
            the workspace index of its screw on the link.
        """
        allocator = IndexAllocator(self.links, SEED_COUNT)
        pairs, source, target = list[Pair](), list[int](), list[int]()
        for k, link in enumerate(self.links):
            for pair in self.pairs[k]:
                if pair.own:
                    allocator.places[pair.channel, k] = (
                        PRISMATIC_SEED if link.prismatic else REVOLUTE_SEED
                    )
                    source.append(allocator.places[pair.channel, k])
                    target.append(allocator.places[pair.channel, k])
                else:
                    source.append(
                        allocator.places.get((pair.channel, link.parent), pair.channel)
                    )
                    target.append(allocator.allocate(pair.channel, k))
                pairs.append(pair)
        return pairs, source, target

    def rows(self) -> RowArrays:
        """Arrays of all channels added so far."""
        pairs, source, target = self._pair_screws()
        sizes = [m + 1 - s for m, s in zip(self.measured, self.starts, strict=True)]
        copies = [
            [(e, pair.slot + n) for n, e in enumerate(pair.entries) if n >= pair.direct]
            for pair in pairs
        ]
        return RowArrays(
            first=int_array(np.cumsum([0, *map(len, self.pairs)])),
            source=int_array(source),
            target=int_array(target),
            force=np.array([pair.force for pair in pairs], np.bool_),
            slot=int_array([pair.slot for pair in pairs]),
            direct=np.array([pair.direct > 0 for pair in pairs], np.bool_),
            has_extra=np.array(
                [max(pair.entries, default=0) >= LEADING_ENTRIES for pair in pairs],
                np.bool_,
            ),
            copies=int_array(np.cumsum([0, *map(len, copies)])),
            copy_from=int_array([e for each in copies for e, _ in each]),
            copy_to=int_array([slot for each in copies for _, slot in each]),
            term_slot=int_array([slot for slot, _, _ in self.terms]),
            term_link=int_array([link for _, link, _ in self.terms]),
            term_law=int_array([law for _, _, law in self.terms]),
            start=int_array(self.starts),
            width=int_array(self.widths),
            measured=int_array(self.measured),
            link=int_array(self.owners),
            group_size=int_array(sizes),
            group_gram=int_array(
                np.cumsum([0, *(width**2 for width in self.widths[:-1])])
            ),
            slots=self.slots,
            block=int(
                np.clip(
                    MAX_BLOCK_BYTES // (8 * self.slots) // NB * NB, NB, MAX_BLOCK_ROWS
                )
            ),
        )


COEFFICIENT_TOLERANCE = 1e-13
"""Magnitude below which coefficients are rounding errors of zero."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Layout of a robot's regressor rows, for joint torques or for the wrench.

    Attributes:
        tree: The robot; only its geometry matters.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2].
        model: "torque" for one channel per joint, "wrench" for the six components of the wrench.
        terms: Terms of the joints, such as friction.
        robot: Arrays of the links.
        rows: Arrays of the rows.
        theta: Barycentric parameters for a unit value of each of the P' body columns, (n, 10, P').
        basis: Matrix with columns @ basis = regressor of the minimal parameters, then of the terms,
            (P, unknowns), for P columns of bodies and terms.
        channel_columns: Indices of the columns of each channel, in storage order.
    """

    tree: Tree
    gravity: Array
    model: Signal
    terms: tuple[JointTerm, ...]
    robot: LinkArrays
    rows: RowArrays
    theta: Array
    basis: Array
    channel_columns: tuple[Ints, ...]

    @property
    def channel_count(self) -> int:
        """Number of measured channels."""
        return len(self.channel_columns)

    def combine_columns(self, rows: Array, basis: Array) -> Array:
        """Linear combinations of the columns, for each of the C channels, (C, k, q).

        Args:
            rows: Values of all slots (row elements of all channels) in k rows, (slots, k).
            basis: Coefficients of q combinations of the P columns, (P, q).
        """
        result = np.empty((self.channel_count, rows.shape[1], basis.shape[1]))
        for c, own in enumerate(self.channel_columns):
            at = self.rows.start[c]
            result[c] = rows[at : at + len(own)].T @ basis[own]
        return result

    @property
    def is_compiled(self) -> bool:
        """True if the compiled kernel computes all columns: known laws, at joints only."""
        return all(
            law_number(term.law) != NO_LAW and term.joint < self.tree.n
            for term in self.terms
        )


def make_layout(
    tree: Tree, minimal: MinimalSet, terms: Sequence[JointTerm] = ()
) -> Layout:
    """Lay out the regressor rows of a minimal set.

    Args:
        tree: The robot; only its geometry matters.
        minimal: Minimal set of joint torques (one channel per joint) or of the wrench (six).
        terms: Terms of the joints, for joint torques.
    """
    frames = canonical_frames(tree)
    turns = frames.to_canonical()
    chosen, weights = _body_columns(turns, minimal, whole=tree.floating)
    term_count = len(terms)
    basis = np.zeros((len(chosen) + term_count, minimal.count + term_count))
    basis[: len(chosen), : minimal.count] = weights
    basis[len(chosen) :, minimal.count :] = np.eye(term_count)
    places: list[list[tuple[int, int]]] = [[] for _ in frames.links]
    for column, parameter in enumerate(chosen):
        entry = ENTRY_PARAMETERS.index(parameter % 10)
        places[frames.place[parameter // 10]].append((entry, column))
    base = frames.place[tree.sensor_body] if tree.sensor_body >= 0 else -1
    builder = LayoutBuilder(frames, [sorted(each) for each in places], base)
    shaft_ratios = transmission_matrix(tree)
    if minimal.model == "torque":
        for j, link in enumerate(frames.place):
            joint_laws = [
                (law_number(term.law), len(chosen) + k)
                for k, term in enumerate(terms)
                if shaft_ratios[term.joint, j]
            ]
            builder.add_channel(link, frames.links[link].prismatic, joint_laws)
    else:
        for axis in range(6):
            builder.add_channel(-1, axis < 3, [])
    return Layout(
        tree=tree,
        gravity=minimal.gravity,
        model=minimal.model,
        terms=tuple(terms),
        robot=_link_arrays(frames, minimal.gravity, tree),
        rows=builder.rows(),
        theta=_column_parameters(turns, chosen),
        basis=basis,
        channel_columns=tuple(builder.columns),
    )


def _column_parameters(turns: Array, chosen: list[int]) -> Array:
    """Barycentric parameters in body axes for unit values of canonical parameters, (n, 10, P).

    Args:
        turns: Matrices from body axes to canonical axes, (n, 10, 10).
        chosen: Indices of P canonical parameters among the 10 n.
    """
    back = np.linalg.inv(turns)
    theta = np.zeros((*back.shape[:2], len(chosen)))
    for column, parameter in enumerate(chosen):
        theta[parameter // 10, :, column] = back[parameter // 10, :, parameter % 10]
    return theta


def _link_arrays(frames: CanonicalFrames, gravity: Array, tree: Tree) -> LinkArrays:
    """Arrays of the links, with the constant screws.

    Args:
        frames: Links in canonical frames.
        gravity: Gravity acceleration in the bedplate frame, (3,) [m/s^2].
        tree: The robot.
    """
    links = frames.links
    places = [0]  # index of the bedplate
    allocator = IndexAllocator(links, 1)
    for k in range(len(links)):
        places.append(allocator.allocate(0, k))
    seeds = np.zeros((SEED_COUNT, 6))
    wrench_axes = (
        frames.bedplate if tree.sensor_body < 0 else frames.frames[tree.sensor_body]
    )
    seeds[:3, 3:] = seeds[3:6, :3] = (
        wrench_axes  # row k: axis k of the bedplate, or of the base
    )
    if tree.sensor is not None:
        seeds[:6] = tree.sensor.X_BS.inverse.wrench_matrix @ seeds[:6]
    seeds[REVOLUTE_SEED, 2] = seeds[PRISMATIC_SEED, 5] = 1.0
    return LinkArrays(
        coordinate=np.array([link.joint for link in links]),
        place=int_array(places[1:]),
        carrier=int_array([places[link.parent + 1] for link in links]),
        prismatic=np.array([link.prismatic for link in links]),
        square=np.array(
            [
                abs(link.lean[0]) < COEFFICIENT_TOLERANCE and link.lean[1] > 0
                for link in links
            ],
            np.bool_,
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


def _body_columns(
    turn: Array, minimal: MinimalSet, *, whole: bool
) -> tuple[list[int], Array]:
    """Canonical parameters that become columns, and the matrix from columns to minimal set.

    If possible, as many parameters are chosen as the minimal set has. Otherwise all parameters are
    chosen that have a nonzero element in the right inverse of the minimal set's matrix (`lift`).

    Args:
        turn: Matrices from body axes to canonical axes, (n, 10, 10).
        minimal: Minimal set of N parameters.
        whole: True to choose all parameters with a nonzero element in the right inverse, as a free
            base requires, whose coordinate bodies share one mass.

    Returns:
        Indices of P canonical parameters among the 10 n, and the matrix, (P, N).
    """
    lift = np.einsum("jab,jbn->jan", turn, minimal.lift.reshape(len(turn), 10, -1))
    lift = lift.reshape(10 * len(turn), -1)
    needed = np.flatnonzero(
        np.abs(lift).max(axis=1, initial=0.0) > COEFFICIENT_TOLERANCE
    )
    if len(needed) > minimal.count and not whole:
        back = np.linalg.inv(turn)
        allowed = (
            ~(np.abs(back) * minimal.known_zero[:, :, None] > COEFFICIENT_TOLERANCE)
            .any(axis=1)
            .ravel()
        )
        projected = np.einsum(
            "njb,jbc->njc", minimal.matrix.reshape(-1, len(turn), 10), back
        )
        projected = projected.reshape(minimal.count, -1) * allowed
        order = [10 * j + c for c in ENTRY_PARAMETERS for j in range(len(turn))]
        chosen = sorted(independent_columns(projected, order))
        if len(chosen) == minimal.count:
            return chosen, np.linalg.inv(projected[:, chosen])
    return needed.tolist(), lift[needed]
