"""A force sensor between two links: the tree that lies beyond it.

The bedplate is the force sensor at the root. One anywhere else feels the links beyond its cut: they
are a robot of their own, whose base the joints before the cut move. Those joints stay in the tree,
without matter; what hangs elsewhere is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from testbed.arrays import Array, freeze
from testbed.errors import ModelError, UnknownName
from testbed.robot.free_base import FREE
from testbed.robot.inertia import NOTHING
from testbed.robot.repair import Link, total
from testbed.robot.tree import Placement, Tree


@dataclass(frozen=True, eq=False)
class ForceSensor:
    """A six-axis sensor between a link and the one that carries it.

    It shows what it exerts on the links beyond the cut, force first.

    Attributes:
        link: The first link beyond the cut.
        position: Of the sensor's origin in that link's frame, (3,) [m].
        rotation: From the sensor's axes to the link's, (3, 3).
    """

    link: str
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        freeze(self, position=(3,), rotation=(3, 3))


def beyond_sensor(tree: Tree, links: Sequence[Link], sensor: ForceSensor) -> Tree:
    """What a force sensor feels, as a tree: the joints that lead to it, and all beyond it.

    Args:
        tree: The robot.
        links: Its model file's, carriers before what they carry.
        sensor: Where it is cut.

    Returns:
        Joints keep their names and frames. Of the body that is cut, the links beyond the sensor
        are left; its `sensor` says where the wrench is measured.

    Raises:
        UnknownName: The model file has no such link.
        ModelError: The link is the root: that sensor is the bedplate.
    """
    named = {link.name: link for link in links}
    if sensor.link not in named:
        raise UnknownName("link", sensor.link, sorted(named))
    first = named[sensor.link]
    if not first.parent and first.body < 0 and not tree.floating:
        raise ModelError(
            f"link '{sensor.link}' is the root: the force sensor under it is the force plate"
        )
    shift = FREE if tree.floating else 0  # the pedestal's links are the base's then
    beyond = {first.name}
    for link in links:
        if link.parent in beyond:
            beyond.add(link.name)
    path = tree.chain(first.body + shift)
    carried = {link.body + shift for link in links if link.name in beyond}
    kept = [*path, *sorted(carried - {*path, -1})]
    place = {-1: -1} | {old: new for new, old in enumerate(kept)}
    cut = total(link.in_body for link in links if link.name in beyond and link.body == first.body)
    inertias = [NOTHING if body in path else tree.inertias[body] for body in kept]
    if path:
        inertias[len(path) - 1] = cut
    return replace(
        tree,
        joints=tuple(
            replace(tree.joints[old], parent=place[tree.joints[old].parent]) for old in kept
        ),
        inertias=tuple(inertias),
        pedestal=NOTHING if path else cut,
        shafts=(),
        lead=len(path),
        sensor=Placement(
            first.position + first.rotation @ sensor.position,
            first.rotation @ sensor.rotation,
        ),
    )
