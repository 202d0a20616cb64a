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
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import approx_fprime

from testbed.applications.payload.payload import PayloadEstimate
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError, few
from testbed.core.estimation.regression.normal_equations import standard_deviations
from testbed.core.parameters.pseudo_inertia import matrices
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.repair import FileLink
from testbed.core.robot.rigid_matter import inertia_flaw
from testbed.core.robot.rotations import to_rpy
from testbed.core.robot.tree import Tree

SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Entries of an inertia: Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""

STEP = 1e-3
"""Of derivatives, in standard deviations."""

CLEAR = 3.0
"""Standard deviations by which a mass is none of noise."""


@dataclass(frozen=True, eq=False)
class FlangePayload:
    """A payload about and along a flange's frame.

    Attributes:
        frame: The flange's link.
        inertia: The body.
        sigma: Standard deviations of mass, centre, and the six of the inertia about the mass
            centre in the order SIX, (10,) [kg, m, kg m^2]; of mass and centre alone, (4,), where
            the inertia is not identifiable.
    """

    frame: str
    inertia: Inertia
    sigma: Array

    @property
    def six(self) -> list[float]:
        """Inertia about the mass centre: Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg m^2], or empty."""
        return [float(self.inertia.central[at]) for at in SIX[: len(self.sigma) - 4]]

    def comment(self, mark: str) -> list[str]:
        """Lines of a comment: the frame, and the standard deviations.

        Args:
            mark: What a comment begins with.
        """
        mass, *rest = (f"{value:.2g}" for value in self.sigma)
        six = "the inertia is not identifiable by poses at rest: by a motion it is"
        if self.six:
            six = f"Ixx Iyy Izz Ixy Ixz Iyz {' '.join(rest[3:])} kg m^2"
        return [
            f"{mark}payload about and along the frame of '{self.frame}'; standard deviations:",
            f"{mark}mass {mass} kg, centre {' '.join(rest[:3])} m,",
            f"{mark}{six}",
        ]


def at_flange(
    found: PayloadEstimate, tree: Tree, link: FileLink | None = None
) -> FlangePayload:
    """A payload, or the tool that a force sensor carries, about and along a flange's frame.

    Args:
        found: About and along the frame of the link that its joint moves, a tool's of the sensor.
        tree: The robot, or what the sensor feels.
        link: The flange, fixed to that link; None for that link or sensor itself.

    Raises:
        SettingsError: Not all of it is identifiable, it is no body that can exist, or the flange
            is on another link.
    """
    count = 10 if any(found.identifiable[4:]) else 4
    known = np.array(found.identifiable)
    lacking = [
        name for name, one in zip(found.names[:count], known, strict=False) if not one
    ]
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
            inertia = inertia.moved(sensor.X_BS)
        return inertia if link is None else inertia.moved(link.X_BL.inverse)

    def numbers(values: Array) -> Array:
        own = seen(values)
        return np.array([own.mass, *own.com, *(own.central[at] for at in SIX)])[:count]

    inertia = seen(found.values)
    _check(found, inertia, whole=count == 10)
    steps = STEP * np.where(known, found.sigma, 1.0)
    slope = approx_fprime(found.values, numbers, steps)
    frame = tree.joints[body].body if sensor is None else sensor.name
    return FlangePayload(
        frame=frame if link is None else link.name,
        inertia=inertia,
        sigma=standard_deviations(
            slope @ np.where(known, found.covariance, 0.0) @ slope.T
        ),
    )


def _check(found: PayloadEstimate, inertia: Inertia, *, whole: bool) -> None:
    """Raise SettingsError where no body has such a mass and inertia."""
    flaw = inertia_flaw(
        "payload", inertia.mass, inertia.central if whole else np.eye(3)
    )
    if not flaw:
        return
    remedy = "longer and faster motion makes it more precise"
    if found.values[0] < -CLEAR * found.sigma[0]:
        remedy = "the recording without the payload comes first, the one with it second"
    elif abs(found.values[0]) <= CLEAR * found.sigma[0]:
        remedy = "the recordings do not differ by a payload"
    raise SettingsError(
        f"no controller should get a body that cannot exist: {flaw}; {remedy}"
    )


def universal_robots(load: FlangePayload) -> str:
    """URScript: `set_target_payload`."""
    words = [
        load.inertia.mass,
        load.inertia.com.tolist(),
        *([load.six] if load.six else []),
    ]
    return "\n".join([*load.comment("# "), f"set_target_payload({str(words)[1:-1]})"])


def franka(load: FlangePayload) -> str:
    """JSON with the three arguments of `setLoad`, named as in Desk's file of an end effector."""
    inertia = load.inertia
    said = {
        "mass": inertia.mass,
        "centerOfMass": inertia.com.tolist(),
        "comment": " ".join(load.comment("")),
    }
    if load.six:
        said["inertia"] = inertia.central.ravel(order="F").tolist()
    return json.dumps(said, indent=1)


def kuka(load: FlangePayload) -> str:
    """KRL: LOAD_DATA of tool 1, with principal moments."""
    moments, axes = np.linalg.eigh(load.inertia.central if load.six else np.eye(3))
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    angles = np.rad2deg(to_rpy(axes)[::-1])
    centre = _fields("XYZABC", [*(1e3 * load.inertia.com), *angles])
    inertia = f",J {{{_fields('XYZ', moments)}}}" if load.six else ""
    call = f"LOAD_DATA[1]={{M {load.inertia.mass!r},CM {{{centre}}}{inertia}}}"
    return "\n".join([*load.comment("; "), call])


def _fields(names: str, values: Sequence[float] | Array) -> str:
    return ",".join(
        f"{name} {float(x)!r}" for name, x in zip(names, values, strict=True)
    )


VENDORS: Mapping[str, Callable[[FlangePayload], str]] = {
    "ur": universal_robots,
    "franka": franka,
    "kuka": kuka,
}
"""By the word on the command line."""
