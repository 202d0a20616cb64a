"""Links of a model file in the bodies of a tree, and what each gets of a body's matter.

A tree's body is all that moves together: a link, what is fixed to it, and what hangs on joints
that are held. Its matter goes to the link that carries the others, or to all in proportion; links
on held joints keep their proportion, because in the file they move.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from testbed.arrays import Array, readonly
from testbed.robot.inertia import NOTHING, Inertia, upper_root

Fixed = Literal["lump", "share"]

THIN = 1e-9
"""Least part of a body's matter in any direction that can be shared out."""


@dataclass(frozen=True, eq=False)
class Link:
    """A link of a model file.

    Attributes:
        name: In the file.
        body: Index of the tree's body that it is part of, -1 for the pedestal.
        carrier: The link to which fixed joints of the file hold it; itself where none does.
        rotation: From the link's frame to the body's, (3, 3).
        position: Of the link's origin in the body's frame, (3,) [m].
        inertia: As the file has it, about and along the link's frame.
    """

    name: str
    body: int
    carrier: str
    rotation: Array
    position: Array
    inertia: Inertia

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotation", readonly(self.rotation, (3, 3), "rotation"))
        object.__setattr__(self, "position", readonly(self.position, (3,), "position"))

    @property
    def in_body(self) -> Inertia:
        """Its inertia about and along the body's frame."""
        return self.inertia.moved(self.rotation, self.position)

    def seen_from(self, inertia: Inertia) -> Inertia:
        """An inertia about the body's frame, about and along the link's.

        Args:
            inertia: Of anything.
        """
        return inertia.moved(self.rotation.T, -self.rotation.T @ self.position)


def shared_out(
    links: Sequence[Link], bodies: Mapping[int, Inertia], fixed: Fixed
) -> tuple[dict[str, Inertia], tuple[str, ...]]:
    """What each link gets.

    Args:
        links: All, carriers before what they carry.
        bodies: New inertias of some of the tree's bodies, by index.
        fixed: "lump" gives all of what is fixed together to the link that carries the rest;
            "share" gives to every link in proportion to what it had.

    Returns:
        Inertias by link, about and along its frame; and a line for what could not be shared.
    """
    found: dict[str, Inertia] = {}
    notes: list[str] = []
    for body, whole in bodies.items():
        own = [link for link in links if link.body == body]
        groups = [own] if fixed == "share" else _rigid(own)
        if len(own) > 1 and (fixed == "share" or len(groups) > 1):
            parts = _in_proportion(own, whole)
            if parts is None:
                notes.append(
                    f"all of '{own[0].name}' and what is held with it is given to that link: the "
                    "file's bodies are no measure"
                )
                groups = [own]
        else:
            parts = None
        for group in groups:
            if parts is not None and fixed == "share":
                found |= {link.name: link.seen_from(parts[link.name]) for link in group}
                continue
            lump = whole if parts is None else total(parts[link.name] for link in group)
            found |= {link.name: NOTHING for link in group}
            found[group[0].name] = group[0].seen_from(lump)
    bare = {link.name for link in links if not link.inertia.pseudo.any()}
    kept = {name: own for name, own in found.items() if own.mass or name not in bare}
    return kept, tuple(notes)


def _rigid(own: Sequence[Link]) -> list[list[Link]]:
    """Links that are fixed to each other in the file, the carrying one first."""
    groups: dict[str, list[Link]] = {}
    for link in own:
        groups.setdefault(link.carrier, []).append(link)
    return list(groups.values())


def _in_proportion(own: Sequence[Link], whole: Inertia) -> dict[str, Inertia] | None:
    """Parts that make up a body, by link, about the body's frame; None where there is no measure.

    One affine map and one factor take the file's matter to the new one: all parts go along, and
    each stays such as a body can have.
    """
    before = total(link.in_body for link in own).pseudo
    scale = np.sqrt(np.abs(np.diagonal(before)))
    if not (scale > 0).all():
        return None
    if np.linalg.eigvalsh(before / np.outer(scale, scale))[0] < THIN:
        return None
    change = upper_root(whole.pseudo) @ np.linalg.inv(upper_root(before))
    parts = {link.name: change @ link.in_body.pseudo @ change.T for link in own}
    return {name: Inertia.of_pseudo(part) for name, part in parts.items()}


def total(parts: Iterable[Inertia]) -> Inertia:
    """Bodies welded together, all about the same frame."""
    return sum(parts, NOTHING)
