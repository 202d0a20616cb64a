"""Subtree beyond a six-axis force sensor between two links.

The force plate is the sensor at the root. A sensor between two links measures the wrench on the
links beyond this cut. The links beyond the cut form a robot whose base is moved by the joints
before the cut; these joints remain in the tree, with massless bodies. Other branches are left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.errors import ModelError, UnknownName
from testbed.core.base.summary_table import Value
from testbed.core.base.transform import Transform
from testbed.core.robot.free_base import N_BASE_COORDINATES
from testbed.core.robot.inertia import ZERO_INERTIA
from testbed.core.robot.repair import ModelLink, total_inertia
from testbed.core.robot.tree import SensorPlacement, Tree


@dataclass(frozen=True, eq=False)
class ForceSensor(Value):
    """Six-axis force sensor between a link and the link that carries it.

    The sensor measures the wrench exerted on the links beyond the cut, about the sensor origin and
    along the sensor axes, force first.

    Attributes:
        link: Name of the first link beyond the cut.
        position: Sensor origin in that link's frame, (3,) [m].
        rotation: Rotation matrix from sensor axes to link axes, (3, 3).
        name: Sensor name.
    """

    link: str
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    name: str = ""

    def __post_init__(self) -> None:
        freeze_arrays(self, position=(3,), rotation=(3, 3))

    @property
    def X_LS(self) -> Transform:
        """Pose of the sensor frame S in the link frame L."""
        return Transform(self.rotation, self.position)


def tree_beyond_sensor(
    tree: Tree,
    links: Sequence[ModelLink],
    sensor: ForceSensor,
    other_sensors: Iterable[ForceSensor] = (),
) -> Tree:
    """Subtree beyond a force sensor, together with the joints that lead to the sensor.

    Args:
        tree: Robot.
        links: Links of the model file, each after its carrier.
        sensor: Force sensor at the cut.
        other_sensors: Further sensors. Links beyond the next sensors after `sensor` are left out,
            as the wrench on these links is measured.

    Returns:
        Tree with unchanged joint names and frames, without shafts. A body that the sensor cuts
        keeps only the links beyond the sensor; a body that a next sensor cuts keeps only the links
        before that sensor. Bodies before the sensor's body are massless. The attribute `sensor`
        holds the placement of the sensor, `cuts` the placements of the next sensors.

    Raises:
        UnknownName: No link of the model file has the name.
        ModelError: The link is the root of a robot with a fixed base, whose sensor is the force
            plate; two sensors have the same link; or no joint moves the links between the sensors.
    """
    first = _sensor_link(links, sensor)
    if not first.parent and first.body < 0 and not tree.floating:
        raise ModelError(
            f"link '{sensor.link}' is the root: the force sensor under it is the force plate"
        )
    return _segment(tree, links, sensor, other_sensors)


def tree_before_sensors(
    tree: Tree, links: Sequence[ModelLink], other_sensors: Iterable[ForceSensor]
) -> Tree:
    """Tree between the bedplate and the first force sensors.

    Links beyond the sensors are left out; `cuts` holds the placements of the first sensors.

    Args:
        tree: Robot.
        links: Links of the model file, each after its carrier.
        other_sensors: Force sensors; a sensor beyond another sensor has no effect.

    Raises:
        UnknownName: No link of the model file has the name.
        ModelError: Two sensors have the same link, or no joint moves the links before the sensors.
    """
    return _segment(tree, links, None, other_sensors)


def _segment(
    tree: Tree,
    links: Sequence[ModelLink],
    sensor: ForceSensor | None,
    other_sensors: Iterable[ForceSensor],
) -> Tree:
    """Tree between a sensor, or the bedplate, and the next force sensors.

    Bodies from the bedplate to the sensor's body are kept, but all except the last are massless. A
    body that is cut has the inertia of its links within the segment. Shafts are removed.

    Args:
        tree: Robot.
        links: Links of the model file, each after its carrier.
        sensor: Sensor at the base of the segment; None for the bedplate.
        other_sensors: Further sensors.

    Raises:
        UnknownName: No link of the model file has the name of a sensor's link.
        ModelError: Two sensors have the same link, or no joint moves the segment.
    """
    if tree.floating:  # the pedestal's links belong to the base
        links = [replace(link, body=link.body + N_BASE_COORDINATES) for link in links]
    segment_links, next_sensors = _segment_links(links, sensor, other_sensors)
    base = [] if sensor is None else [(sensor, _sensor_link(links, sensor))]
    path = tree.chain(base[0][1].body) if base else ()
    link_bodies, cut_bodies = (
        {link.body for link in segment_links},
        [link.body for _, link in next_sensors],
    )
    bodies = [*path, *sorted({*link_bodies, *cut_bodies} - {*path, -1})]
    if not bodies:
        first = f"force sensor '{sensor.name}'" if sensor else "the force plate"
        raise ModelError(
            f"nothing that moves lies between {first} and the next force sensors"
        )
    index = dict(zip((-1, *bodies), range(-1, len(bodies)), strict=True))
    partial_inertias = {
        k: total_inertia(
            link.inertia_in_body for link in segment_links if link.body == k
        )
        for k in (*cut_bodies, *(link.body for _, link in base))
    }
    return replace(
        tree,
        joints=tuple(
            replace(tree.joints[k], parent=index[tree.parents[k]]) for k in bodies
        ),
        inertias=tuple(
            ZERO_INERTIA
            if k in path[:-1]
            else partial_inertias.get(k, tree.inertias[k])
            for k in bodies
        ),
        pedestal=ZERO_INERTIA if path else partial_inertias.get(-1, tree.pedestal),
        shafts=(),
        lead=len(path),
        sensor=next((_placement(*each, index) for each in base), None),
        cuts=tuple(_placement(*each, index) for each in next_sensors),
        bare=tuple(index[k] for k in cut_bodies if k not in link_bodies),
    )


def _placement(
    sensor: ForceSensor, link: ModelLink, index: Mapping[int, int]
) -> SensorPlacement:
    """Placement of a sensor on its body in a tree with renumbered bodies.

    Args:
        sensor: Force sensor.
        link: Link of the sensor.
        index: New body indices, keyed by old index.
    """
    X_BS = link.X_BL @ sensor.X_LS
    return SensorPlacement(X_BS.p_AB_A, X_BS.R_AB, sensor.name, index[link.body])


def _segment_links(
    links: Sequence[ModelLink],
    sensor: ForceSensor | None,
    other_sensors: Iterable[ForceSensor],
) -> tuple[list[ModelLink], list[tuple[ForceSensor, ModelLink]]]:
    """Links of a segment, and the force sensors at its ends with their links.

    The segment extends from a sensor, or the bedplate, to the next sensors.

    Args:
        links: Links of the model file, each after its carrier.
        sensor: Sensor at the base of the segment; None for the bedplate.
        other_sensors: Further sensors; a next sensor lies beyond `sensor` and beyond no other
            sensor.

    Raises:
        ModelError: Two sensors have the same link.
    """
    names = _names_beyond(links, sensor)
    inner_sensors = [each for each in other_sensors if each.link in names]
    for a, b in combinations([*([sensor] if sensor else []), *inner_sensors], 2):
        if a.link == b.link:
            raise ModelError(
                f"force sensors '{a.name}' and '{b.name}' both carry '{a.link}'"
            )
    names_beyond = {each.link: _names_beyond(links, each) for each in inner_sensors}
    next_sensors = [
        each
        for each in inner_sensors
        if not any(
            each.link in beyond
            for link, beyond in names_beyond.items()
            if link != each.link
        )
    ]
    excluded = set().union(*(names_beyond[each.link] for each in next_sensors))
    segment_links = [link for link in links if link.name in names - excluded]
    return segment_links, [(each, _sensor_link(links, each)) for each in next_sensors]


def _sensor_link(links: Sequence[ModelLink], sensor: ForceSensor) -> ModelLink:
    """Link of the model file named by a force sensor.

    Raises:
        UnknownName: No link of the model file has the name.
    """
    links_by_name = {link.name: link for link in links}
    if sensor.link not in links_by_name:
        raise UnknownName("link", sensor.link, sorted(links_by_name))
    return links_by_name[sensor.link]


def _names_beyond(links: Sequence[ModelLink], sensor: ForceSensor | None) -> set[str]:
    """Names of a sensor's link and its descendants; names of all links for None (the bedplate)."""
    names = (
        {link.name for link in links}
        if sensor is None
        else {_sensor_link(links, sensor).name}
    )
    for link in links:
        if link.parent in names:
            names.add(link.name)
    return names
