"""A payload in the words of robot controllers: one function a vendor, `VENDORS` lists them.

All of them want mass, mass centre in the flange's frame, and inertia about the mass centre; KUKA
the principal moments, with the axes that they are about.

Source    Universal Robots' script manual, `set_target_payload`: m [kg], cog [m] from the tool
          mount, inertia [Ixx, Iyy, Izz, Ixy, Ixz, Iyz] [kg m^2] with origin in the cog and axes
          of the tool flange
Source    libfranka, `Robot::setLoad` and `RobotState::I_load`: inertia about the mass centre,
          column-major; keys as in Franka's `endeffector-config.json` for Desk
Source    KUKA, KR IONTEC V4, 4.3: mass [kg], centre [mm], principal moments [kg m^2], their axes
          by A about Z, B about Y', C about X'' [degrees]
Source    ROS 2, geometry_msgs/Inertia: m [kg], com [m], tensor about the mass centre [kg m^2]
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.applications.payload.payload import PayloadEstimate
from testbed.bodies.prior import matrices
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError, few
from testbed.core.robot.inertia import Inertia, inertia_flaw, to_rpy
from testbed.core.robot.repair import Link
from testbed.core.robot.tree import Tree

SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Entries of an inertia: Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""

STEP = 1e-3
"""Of derivatives, in standard deviations."""


@dataclass(frozen=True, eq=False)
class FlangePayload:
    """A payload about and along a flange's frame.

    Attributes:
        frame: The flange's link.
        inertia: The body.
        axes: Of its principal moments, from their frame to the flange's, (3, 3).
        sigma: Standard deviations of mass, centre, the six of the inertia about the mass centre
            in the order SIX, and the principal moments, (13,) [kg, m, kg m^2]; of mass and centre
            alone, (4,), where the inertia is not identifiable.
    """

    frame: str
    inertia: Inertia
    axes: Array
    sigma: Array

    @property
    def six(self) -> list[float]:
        """Inertia about the mass centre: Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg m^2], or empty."""
        return [float(self.inertia.central[at]) for at in SIX[: len(self.sigma) - 4]]

    @property
    def sentences(self) -> list[str]:
        """What a comment says: the frame, and the standard deviations."""
        mass, centre, six = self.sigma[:1], self.sigma[1:4], self.sigma[4:10]
        return [
            f"payload about and along the frame of '{self.frame}'; standard deviations:",
            f"mass {_rounded(mass)} kg, centre {_rounded(centre)} m,",
            f"Ixx Iyy Izz Ixy Ixz Iyz {_rounded(six)} kg m^2"
            if len(six)
            else "the inertia is not identifiable by poses at rest: by a motion it is",
        ]


CLEAR = 3.0
"""Standard deviations by which a mass is none of noise."""


def at_flange(found: PayloadEstimate, tree: Tree, link: Link | None = None) -> FlangePayload:
    """A payload, or the tool that a force sensor carries, about and along a flange's frame.

    Args:
        found: About and along the frame of the link that its joint moves, a tool's of the sensor.
        tree: The robot, or what the sensor feels.
        link: The flange, fixed to that link; None for that link or sensor itself.

    Raises:
        SettingsError: Not all of it is identifiable, it is no body that can exist, or the flange
            is on another link.
    """
    whole = any(found.identifiable[4:])
    wanted = 10 if whole else 4
    known = np.array(found.identifiable)
    lacking = [name for name, one in zip(found.names[:wanted], known, strict=False) if not one]
    if lacking:
        raise SettingsError(
            f"a controller wants all of a payload, and {few(lacking)} are not identifiable"
        )
    body, sensor = tree.index(found.joint), tree.sensor
    if link is not None and link.body != body:
        raise SettingsError(f"'{link.name}' does not move with joint '{found.joint}'")

    def seen(values: Array) -> Inertia:
        inertia = Inertia.of_pseudo(matrices(values))
        if link is not None and sensor is not None:
            inertia = inertia.moved(sensor.rotation, sensor.position)
        return inertia if link is None else link.seen_from(inertia)

    inertia = seen(found.values)
    flaw = inertia_flaw("payload", inertia.mass, inertia.central if whole else np.eye(3))
    if flaw:
        remedy = "longer and faster motion makes it more precise"
        if found.values[0] < -CLEAR * found.sigma[0]:
            remedy = "the recording without the payload comes first, the one with it second"
        elif abs(found.values[0]) <= CLEAR * found.sigma[0]:
            remedy = "the recordings do not differ by a payload"
        raise SettingsError(f"no controller should get a body that cannot exist: {flaw}; {remedy}")
    _, axes = np.linalg.eigh(inertia.central if whole else np.eye(3))
    axes[:, 0] *= np.sign(np.linalg.det(axes))

    def numbers(values: Array) -> Array:
        own = seen(values)
        principal = np.diagonal(axes.T @ own.central @ axes)
        return np.array([own.mass, *own.com, *(own.central[at] for at in SIX), *principal])

    steps = STEP * np.diag(found.sigma)[known]
    pairs = [(numbers(found.values + d), numbers(found.values - d)) for d in steps]
    slope = np.array([(one - other) / 2 for one, other in pairs]).T / steps.sum(axis=1)
    covariance = found.covariance[np.ix_(known, known)]
    sigma = np.sqrt(np.diagonal(slope @ covariance @ slope.T))[: 13 if whole else 4]
    own = tree.joints[body].body if sensor is None else sensor.name
    frame = own if link is None else link.name
    return FlangePayload(frame, inertia, axes, sigma)


def universal_robots(load: FlangePayload) -> str:
    """URScript: `set_target_payload`."""
    inertia = load.inertia
    words = [inertia.mass, inertia.com.tolist(), load.six][: 2 + bool(load.six)]
    call = f"set_target_payload({str(words)[1:-1]})"
    return "\n".join([*_comment("# ", load.sentences), call])


def franka(load: FlangePayload) -> str:
    """JSON with the three arguments of `setLoad`, named as in Desk's file of an end effector."""
    inertia = load.inertia
    said = {
        "mass": inertia.mass,
        "centerOfMass": inertia.com.tolist(),
        "comment": " ".join(load.sentences),
    }
    if load.six:
        said["inertia"] = inertia.central.ravel(order="F").tolist()
    return json.dumps(said, indent=1)


def kuka(load: FlangePayload) -> str:
    """KRL: LOAD_DATA of tool 1, with principal moments."""
    moments = np.diagonal(load.axes.T @ load.inertia.central @ load.axes)
    angles = np.rad2deg(to_rpy(load.axes)[::-1])
    centre = _fields("XYZABC", [*(1e3 * load.inertia.com), *angles])
    inertia, own = "", []
    if load.six:
        inertia = f",J {{{_fields('XYZ', moments)}}}"
        own = [f"J X Y Z {_rounded(load.sigma[10:])} kg m^2"]
    call = f"LOAD_DATA[1]={{M {load.inertia.mass!r},CM {{{centre}}}{inertia}}}"
    return "\n".join([*_comment("; ", [*load.sentences, *own]), call])


def ros(load: FlangePayload) -> str:
    """YAML of geometry_msgs/Inertia."""
    inertia = load.inertia
    x, y, z = inertia.com.tolist()
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    tensor = dict(zip(names, load.six, strict=False))
    lines = [f"m: {inertia.mass!r}", f"com: {{x: {x!r}, y: {y!r}, z: {z!r}}}"]
    lines += [f"{name}: {tensor[name]!r}" for name in sorted(tensor)]
    return "\n".join([*_comment("# ", load.sentences), *lines])


VENDORS: Mapping[str, Callable[[FlangePayload], str]] = {
    "ur": universal_robots,
    "franka": franka,
    "kuka": kuka,
    "ros": ros,
}
"""By the word on the command line."""


def _comment(mark: str, sentences: Sequence[str]) -> list[str]:
    return [mark + sentence for sentence in sentences]


def _fields(names: str, values: Sequence[float] | Array) -> str:
    return ",".join(f"{name} {float(x)!r}" for name, x in zip(names, values, strict=True))


def _rounded(values: Array) -> str:
    return " ".join(f"{value:.2g}" for value in values)
