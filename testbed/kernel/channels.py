"""Channels as they are laid out: which screws meet which links, and where entries go."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from testbed.arrays import AnyArray
from testbed.kernel.canonical import Canonical, Link
from testbed.kernel.constants import CACHE, KS, MBAR, NB, PUSHED, SEEDS, SLIDING, TURNING, USUAL
from testbed.kernel.records import Bools, Ints, Rows


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

    def __init__(self, links: Sequence[Link], first: int) -> None:
        self.links, self.count = links, first
        self.carried = np.bincount([link.parent + 1 for link in links], minlength=len(links) + 1)
        self.places: dict[tuple[int, int], int] = {}
        self.left: dict[tuple[int, int], int] = {}
        self.free: list[int] = []

    def put(self, channel: int, link: int) -> int:
        """A place for what a channel holds of a link."""
        if not self.free:
            self.free.append(self.count)
            self.count += 1
        place = self.free.pop()
        self.places[channel, link], self.left[channel, link] = place, self.carried[link + 1]
        for done in ((channel, link), (channel, self.links[link].parent)):
            if done in self.left:
                self.left[done] -= done[1] != link
                if self.left[done] == 0:
                    self.free.append(self.places[done])
        return place


class Draft:
    """Channels as they are added; `rows` makes arrays of them."""

    def __init__(self, frames: Canonical, places: list[list[tuple[int, int]]]) -> None:
        self.links, self.places = frames.links, places
        self.pairs: list[list[Pair]] = [[] for _ in self.links]
        self.terms: list[tuple[int, int, int]] = []  # slot, link, law
        self.starts: list[int] = []
        self.measured: list[int] = []
        self.owners: list[int] = []
        self.widths: list[int] = []
        self.columns: list[Ints] = []
        self.slots = 0

    def channel(self, link: int, force: bool, terms: list[tuple[int, int]]) -> None:
        """Add the row of a link's joint, or, for -1, of the bedplate's next seed."""
        start, columns = self.slots, list[int]()
        pairs = []
        for k in range(len(self.links)):
            if link < 0 or self._carries(link, k):
                here = [p for p in self.places[k] if not force or p[0] in PUSHED]
                inner = k != link and not self._stands(k)
                if inner and not self.links[k].slides:  # its carriers know its mass already
                    here = [p for p in here if p[0] != MBAR]
                pairs.append((k, self.slots, [e + (e == MBAR and inner) for e, _ in here]))
                columns += [column for _, column in here]
                self.slots += len(here)
        for law, column in terms:
            self.terms.append((self.slots, link, law))
            columns.append(column)
            self.slots += 1
        self.measured.append(self.slots)
        for k, slot, entries in pairs:
            made = 2 if force else USUAL  # entries written there at once; later ones overwrite
            usual = [e for e in entries if e < USUAL]
            fits = usual == list(range(len(usual))) and slot + made <= self.slots + 1
            pair = Pair(len(self.starts), k == link, force, slot, len(usual) * fits, entries)
            self.pairs[k].append(pair)
        self.slots = start + -(-(self.slots + 1 - start) // 4) * 4
        self.starts.append(start)
        self.owners.append(max(link, 0))
        self.widths.append(self.slots - start)
        self.columns.append(np.array(columns, dtype=np.int64))

    def _stands(self, k: int) -> bool:
        """Whether a link stands on the bedplate, a resting frame between or not."""
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
                    source.append(shelf.places.get((pair.channel, link.parent), pair.channel))
                    target.append(shelf.put(pair.channel, k))
                pairs.append(pair)
        return pairs, source, target

    def rows(self, joined: bool) -> Rows:
        """All channels as arrays."""
        pairs, source, target = self._paths()
        unknown = np.full(self.slots, -1)
        for start, columns in zip(self.starts, self.columns, strict=True):
            unknown[start : start + len(columns)] = columns
        widths = [self.slots] if joined else self.widths
        sizes = [m + 1 - s for m, s in zip(self.measured, self.starts, strict=True)]
        copies = [
            [(e, pair.slot + n) for n, e in enumerate(pair.entries) if n >= pair.direct]
            for pair in pairs
        ]
        return Rows(
            first=ints(np.cumsum([0, *map(len, self.pairs)])),
            source=ints(source),
            target=ints(target),
            force=bools([pair.force for pair in pairs]),
            slot=ints([pair.slot for pair in pairs]),
            direct=bools([pair.direct > 0 for pair in pairs]),
            rest=bools([max(pair.entries, default=0) >= USUAL for pair in pairs]),
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
            unknown=ints(unknown),
            group_slot=ints([0] if joined else self.starts),
            group_size=ints([self.slots] if joined else sizes),
            group_width=ints(widths),
            group_gram=ints(np.cumsum([0, *(width**2 for width in widths[:-1])])),
            slots=self.slots,
            block=int(np.clip(CACHE // (8 * self.slots) // NB * NB, NB, KS)),
        )


def ints(values: AnyArray | list[int]) -> Ints:
    """The kernel's integers."""
    return np.array(values, dtype=np.int64)


def bools(values: list[bool]) -> Bools:
    """The kernel's booleans."""
    return np.array(values, dtype=np.bool_)
