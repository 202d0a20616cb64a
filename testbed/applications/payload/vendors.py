"""Payload commands and files for robot controllers, one function per vendor in `VENDORS`.

All need the mass, the centre of mass in the flange's frame, and the inertia about the centre of
mass; KUKA the principal moments, and the orientation of the principal axes.

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
from testbed.core.base.errors import SettingsError, shortened_list
from testbed.core.estimation.regression.normal_equations import standard_deviations
from testbed.core.parameters.pseudo_inertia import pseudo_inertias
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.repair import ModelLink
from testbed.core.robot.rigid_matter import inertia_flaw
from testbed.core.robot.rotations import matrix_to_rpy
from testbed.core.robot.tree import Tree

INERTIA_INDICES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Indices of an inertia matrix: Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""

STEP_SIGMAS = 1e-3
"""Step of numerical derivatives, in standard deviations."""

Z_THRESHOLD = 3.0
"""Smallest significant mass, in standard deviations."""


@dataclass(frozen=True, eq=False)
class FlangePayload:
    """Inertial parameters of a payload in a flange's frame.

    Attributes:
        frame: Name of the flange's link.
        inertia: Mass, centre of mass and inertia about the centre of mass, in the flange's frame;
            the inertia has no meaning if it is not identifiable.
        sigma: Standard deviations of mass, centre, and inertia about the centre of mass in the
            order `INERTIA_INDICES`, (10,) [kg, m, kg m^2]. If the inertia is not identifiable,
            those of mass and centre only, (4,).
    """

    frame: str
    inertia: Inertia
    sigma: Array

    @property
    def inertia_components(self) -> list[float]:
        """Inertia components Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass [kg m^2].

        The list is empty if the inertia is not identifiable.
        """
        return [
            float(self.inertia.central[index])
            for index in INERTIA_INDICES[: len(self.sigma) - 4]
        ]

    def comment(self, mark: str) -> list[str]:
        """Comment lines with frame and standard deviations, for a robot controller's program.

        Args:
            mark: Prefix of a comment line.
        """
        mass, *other_sigmas = (f"{value:.2g}" for value in self.sigma)
        inertia_line = (
            "the inertia is not identifiable by poses at rest: by a motion it is"
        )
        if self.inertia_components:
            inertia_line = (
                f"Ixx Iyy Izz Ixy Ixz Iyz {' '.join(other_sigmas[3:])} kg m^2"
            )
        return [
            f"{mark}payload about and along the frame of '{self.frame}'; standard deviations:",
            f"{mark}mass {mass} kg, centre {' '.join(other_sigmas[:3])} m,",
            f"{mark}{inertia_line}",
        ]


def flange_payload(
    estimate: PayloadEstimate, tree: Tree, link: ModelLink | None = None
) -> FlangePayload:
    """Transform the estimate of a payload or tool to the frame of a flange.

    If no component of the inertia is identifiable, only mass and centre of mass are transformed.

    Args:
        estimate: Estimate in the frame of the link that its joint moves, or, for a tool, in the
            frame of the sensor.
        tree: The robot; for a tool, the links beyond the force sensor.
        link: Flange, fixed to the link that the joint moves; None for the frame of the estimate.

    Raises:
        SettingsError: Mass, centre, or some component of the inertia is not identifiable, the
            parameters are not those of a physical body, or the flange is on another link.
    """
    count = 10 if any(estimate.identifiable[4:]) else 4
    identifiable = np.array(estimate.identifiable)
    unidentifiable = [
        name
        for name, is_identifiable in zip(
            estimate.names[:count], identifiable, strict=False
        )
        if not is_identifiable
    ]
    if unidentifiable:
        raise SettingsError(
            "a controller requires all of a payload, and "
            f"{shortened_list(unidentifiable)} are not identifiable"
        )
    body_index, sensor = tree.index(estimate.joint), tree.sensor
    if link is not None and link.body != body_index:
        raise SettingsError(
            f"'{link.name}' does not move with joint '{estimate.joint}'"
        )

    def flange_inertia(values: Array) -> Inertia:
        inertia = Inertia.of_pseudo(pseudo_inertias(values))
        if link is not None and sensor is not None:
            inertia = inertia.transformed(sensor.X_BS)
        return inertia if link is None else inertia.transformed(link.X_BL.inverse)

    def flange_parameters(values: Array) -> Array:
        transformed = flange_inertia(values)
        return np.array(
            [
                transformed.mass,
                *transformed.com,
                *(transformed.central[index] for index in INERTIA_INDICES),
            ]
        )[:count]

    inertia = flange_inertia(estimate.values)
    _check_inertia(estimate, inertia, whole=count == 10)
    steps = STEP_SIGMAS * np.where(identifiable, estimate.sigma, 1.0)
    jacobian = approx_fprime(estimate.values, flange_parameters, steps)
    frame = tree.joints[body_index].body if sensor is None else sensor.name
    return FlangePayload(
        frame=frame if link is None else link.name,
        inertia=inertia,
        sigma=standard_deviations(
            jacobian @ np.where(identifiable, estimate.covariance, 0.0) @ jacobian.T
        ),
    )


def _check_inertia(estimate: PayloadEstimate, inertia: Inertia, *, whole: bool) -> None:
    """Raise SettingsError if no physical body has these inertial parameters.

    Args:
        estimate: Estimate, from which the message derives the likely cause.
        inertia: Inertia in the flange's frame.
        whole: True to check mass and inertia, False for the mass only.
    """
    flaw = inertia_flaw(
        "payload", inertia.mass, inertia.central if whole else np.eye(3)
    )
    if not flaw:
        return
    remedy = "longer and faster motion makes it more precise"
    if estimate.values[0] < -Z_THRESHOLD * estimate.sigma[0]:
        remedy = "the recording without the payload comes first, the one with it second"
    elif abs(estimate.values[0]) <= Z_THRESHOLD * estimate.sigma[0]:
        remedy = "the recordings do not differ by a payload"
    raise SettingsError(
        f"no controller should get a body that cannot exist: {flaw}; {remedy}"
    )


def universal_robots(load: FlangePayload) -> str:
    """URScript call of `set_target_payload`, preceded by comment lines.

    The arguments are mass [kg], centre of mass [m], and inertia about the centre of mass [kg m^2]
    if identifiable.
    """
    arguments = [
        load.inertia.mass,
        load.inertia.com.tolist(),
        *([load.inertia_components] if load.inertia_components else []),
    ]
    return "\n".join(
        [*load.comment("# "), f"set_target_payload({str(arguments)[1:-1]})"]
    )


def franka(load: FlangePayload) -> str:
    """JSON object with the arguments of `setLoad`.

    The keys are "mass", "centerOfMass", "comment" and "inertia". The inertia about the centre of
    mass is in column-major order, and absent if not identifiable.
    """
    inertia = load.inertia
    fields = {
        "mass": inertia.mass,
        "centerOfMass": inertia.com.tolist(),
        "comment": " ".join(load.comment("")),
    }
    if load.inertia_components:
        fields["inertia"] = inertia.central.ravel(order="F").tolist()
    return json.dumps(fields, indent=1)


def kuka(load: FlangePayload) -> str:
    """KRL assignment to LOAD_DATA of tool 1, preceded by comment lines.

    The fields are the mass M [kg], the frame CM with the centre of mass [mm] and the orientation A,
    B, C of the principal axes [degrees], and the principal moments J [kg m^2] in ascending order. J
    is absent if the inertia is not identifiable.
    """
    moments, axes = np.linalg.eigh(
        load.inertia.central if load.inertia_components else np.eye(3)
    )
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    angles = np.rad2deg(matrix_to_rpy(axes)[::-1])
    centre = _krl_fields("XYZABC", [*(1e3 * load.inertia.com), *angles])
    inertia = f",J {{{_krl_fields('XYZ', moments)}}}" if load.inertia_components else ""
    call = f"LOAD_DATA[1]={{M {load.inertia.mass!r},CM {{{centre}}}{inertia}}}"
    return "\n".join([*load.comment("; "), call])


def _krl_fields(names: str, values: Sequence[float] | Array) -> str:
    """Text of KRL structure fields from names and values: "X 1.0,Y 2.0"."""
    return ",".join(
        f"{name} {float(x)!r}" for name, x in zip(names, values, strict=True)
    )


VENDOR_WRITERS: Mapping[str, Callable[[FlangePayload], str]] = {
    "ur": universal_robots,
    "franka": franka,
    "kuka": kuka,
}
"""Functions that write a payload, by vendor on the command line."""
