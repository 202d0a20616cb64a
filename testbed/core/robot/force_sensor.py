"""A force sensor between two links: the tree that lies beyond it.

The bedplate is the force sensor at the root. One anywhere else feels the links beyond its cut: they
are a robot of their own, whose base the joints before the cut move. Those joints stay in the tree,
without matter; what hangs elsewhere is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.errors import ModelError, UnknownName
from testbed.core.base.summary_table import Value
from testbed.core.base.transform import Transform
from testbed.core.robot.free_base import FREE
from testbed.core.robot.inertia import NOTHING
from testbed.core.robot.repair import FileLink, total
from testbed.core.robot.tree import Placement, Tree


@dataclass(frozen=True, eq=False)
class ForceSensor(Value):
    """A six-axis sensor between a link and the one that carries it.

    It shows what it exerts on the links beyond the cut, force first.

    Attributes:
        link: The first link beyond the cut.
        position: Of the sensor's origin in that link's frame, (3,) [m].
        rotation: From the sensor's axes to the link's, (3, 3).
        name: Of the sensor.
    """

    link: str
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    name: str = ""

    def __post_init__(self) -> None:
        freeze(self, position=(3,), rotation=(3, 3))

    @property
    def X_LS(self) -> Transform:
        """Pose of the sensor S in the link's frame L."""
        return Transform(self.rotation, self.position)


def beyond_sensor(
    tree: Tree,
    links: Sequence[FileLink],
    sensor: ForceSensor,
    others: Iterable[ForceSensor] = (),
) -> Tree:
    """What a force sensor feels, as a tree: the joints that lead to it, and all beyond it.

    Args:
        tree: The robot.
        links: Its model file's, carriers before what they carry.
        sensor: Where it is cut.
        others: Further sensors: what lies beyond the next of them is left out, its wrench is
            measured.

    Returns:
        Joints keep their names and frames. Of a body that is cut, the links on this side are
        left; `sensor` says where the wrench is measured, `cuts` where those of the next are.

    Raises:
        UnknownName: The model file has no such link.
        ModelError: The link is the root: that sensor is the bedplate; or two sensors are one; or
            no joint moves what lies between them.
    """
    first = _link(links, sensor)
    if not first.parent and first.body < 0 and not tree.floating:
        raise ModelError(
            f"link '{sensor.link}' is the root: the force sensor under it is the force plate"
        )
    return _segment(tree, links, sensor, others)


def before_sensors(
    tree: Tree, links: Sequence[FileLink], others: Iterable[ForceSensor]
) -> Tree:
    """What the bedplate feels without what lies beyond force sensors; as `beyond_sensor`.

    Args:
        tree: The robot.
        links: Its model file's.
        others: The sensors.
    """
    return _segment(tree, links, None, others)


def _segment(
    tree: Tree,
    links: Sequence[FileLink],
    sensor: ForceSensor | None,
    others: Iterable[ForceSensor],
) -> Tree:
    """What lies between a sensor, or the bedplate, and the next ones."""
    if tree.floating:  # the pedestal's links are the base's then
        links = [replace(link, body=link.body + FREE) for link in links]
    ours, ends = _between(links, sensor, others)
    base = [] if sensor is None else [(sensor, _link(links, sensor))]
    path = tree.chain(base[0][1].body) if base else ()
    whole, cut = {link.body for link in ours}, [link.body for _, link in ends]
    kept = [*path, *sorted({*whole, *cut} - {*path, -1})]
    if not kept:
        first = f"force sensor '{sensor.name}'" if sensor else "the force plate"
        raise ModelError(
            f"nothing that moves lies between {first} and the next force sensors"
        )
    index = dict(zip((-1, *kept), range(-1, len(kept)), strict=True))
    parts = {
        k: total(link.in_body for link in ours if link.body == k)
        for k in (*cut, *(link.body for _, link in base))
    }
    return replace(
        tree,
        joints=tuple(
            replace(tree.joints[k], parent=index[tree.parents[k]]) for k in kept
        ),
        inertias=tuple(
            NOTHING if k in path[:-1] else parts.get(k, tree.inertias[k]) for k in kept
        ),
        pedestal=NOTHING if path else parts.get(-1, tree.pedestal),
        shafts=(),
        lead=len(path),
        sensor=next((_placed(*each, index) for each in base), None),
        cuts=tuple(_placed(*each, index) for each in ends),
        bare=tuple(index[k] for k in cut if k not in whole),
    )


def _placed(sensor: ForceSensor, link: FileLink, index: Mapping[int, int]) -> Placement:
    """Where a sensor is in a tree whose bodies have other numbers."""
    X_BS = link.X_BL @ sensor.X_LS
    return Placement(X_BS.p_AB_A, X_BS.R_AB, sensor.name, index[link.body])


def _between(
    links: Sequence[FileLink], sensor: ForceSensor | None, others: Iterable[ForceSensor]
) -> tuple[list[FileLink], list[tuple[ForceSensor, FileLink]]]:
    """Links between a sensor, or the bedplate, and the next ones; and these with their links."""
    beyond = _beyond(links, sensor)
    inside = [each for each in others if each.link in beyond]
    for a, b in combinations([*([sensor] if sensor else []), *inside], 2):
        if a.link == b.link:
            raise ModelError(
                f"force sensors '{a.name}' and '{b.name}' both carry '{a.link}'"
            )
    farther = {each.link: _beyond(links, each) for each in inside}
    following = [
        each
        for each in inside
        if not any(
            each.link in names for link, names in farther.items() if link != each.link
        )
    ]
    left_out = set().union(*(farther[each.link] for each in following))
    ours = [link for link in links if link.name in beyond - left_out]
    return ours, [(each, _link(links, each)) for each in following]


def _link(links: Sequence[FileLink], sensor: ForceSensor) -> FileLink:
    named = {link.name: link for link in links}
    if sensor.link not in named:
        raise UnknownName("link", sensor.link, sorted(named))
    return named[sensor.link]


def _beyond(links: Sequence[FileLink], sensor: ForceSensor | None) -> set[str]:
    """Names of the links beyond a sensor; of all beyond the bedplate."""
    found = (
        {link.name for link in links} if sensor is None else {_link(links, sensor).name}
    )
    for link in links:
        if link.parent in found:
            found.add(link.name)
    return found
