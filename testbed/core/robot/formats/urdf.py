"""Reader of URDF files: builds a tree with Pinocchio, independently of the MJCF reader.

Pinocchio reads the kinematics and merges fixed links; faults that Pinocchio ignores are detected in
the XML beforehand. Visual and collision elements are dropped unread, so that meshes and
`package://` addresses have no effect.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import ModelError
from testbed.core.base.transform import Transform
from testbed.core.robot.formats.urdf_xml import (
    TENSOR_INDICES,
    attribute_numbers,
    checked_urdf_xml,
    joint_link,
)
from testbed.core.robot.inertia import ZERO_INERTIA, Inertia
from testbed.core.robot.parsing import (
    capture_stderr,
    format_numbers,
    prefix_model_errors,
    read_xml,
)
from testbed.core.robot.repair import ModelLink, Repair, repair_inertias
from testbed.core.robot.rigid_matter import inertia_flaw
from testbed.core.robot.tree import Joint, JointKind, ModelSource, Tree


@dataclass(frozen=True, eq=False)
class UrdfModel:
    """URDF file as checked XML with physically consistent inertias.

    Attributes:
        path: URDF file.
        root: Root element of the XML.
        links: Links with inertias as stated in the file, each after its carrier.
        repair: Replacements for inconsistent inertias.
        diagnostics: Diagnostics of faults in the file that were accepted.
    """

    path: Path
    root: ET.Element
    links: tuple[ModelLink, ...]
    repair: Repair
    diagnostics: tuple[Diagnostic, ...]

    def tree(self) -> Tree:
        """Build the tree; the bedplate frame is the root link's frame.

        Raises:
            ModelError: Pinocchio rejects the file.
        """
        model = _pinocchio_model(self.root, self.path)
        bodies = {
            frame.parentJoint: frame.name
            for frame in reversed(model.frames.tolist())
            if frame.type == pin.FrameType.BODY
        }
        pedestal, *inertias = (_inertia_of(inertia) for inertia in model.inertias)
        return Tree(
            name=self.root.get("name", ""),
            joints=tuple(_joint_of(model, j, bodies) for j in range(1, model.njoints)),
            inertias=tuple(inertias),
            pedestal=pedestal,
            gravity=model.gravity.linear,
            diagnostics=(*self.repair.diagnostics, *self.diagnostics),
        )


def read(file: ModelSource) -> UrdfModel:
    """Read a URDF file into checked XML; raises the errors of `load_tree`."""
    path = file.path
    root, diagnostics = checked_urdf_xml(file)
    elements = {link.get("name", ""): link for link in root.findall("link")}
    with prefix_model_errors(path):
        suspects = {
            name: line for name, link in elements.items() if (line := _link_flaw(link))
        }
    links, parents = _links(root, path)
    repair = repair_inertias(
        links, suspects, parents, file.repair, path.name, _sum_of_distances(root)
    )
    for name, inertia in repair.links.items():
        _set_inertia(elements[name], inertia)
    return UrdfModel(path, root, links, repair, diagnostics)


def _sum_of_distances(root: ET.Element) -> float:
    """Sum of the lengths of all joint origins of a URDF [m]."""
    origins = (joint.find("origin") for joint in root.findall("joint"))
    return sum(
        math.hypot(*attribute_numbers(origin, "xyz", "0 0 0")) for origin in origins
    )


def _links(
    root: ET.Element, path: Path
) -> tuple[tuple[ModelLink, ...], tuple[int, ...]]:
    """Links with inertias as stated in the file, and parent indices of the tree's bodies.

    Links are in the order of Pinocchio's frames, carriers first. Bodies carried by the bedplate
    have the parent index -1.

    Args:
        root: Checked XML, with locked joints made fixed.
        path: URDF file, whose own fixed joints define `fixed_carrier`.
    """
    joints = read_xml(path).findall("joint")
    parents = {
        joint_link(joint, "child"): joint_link(joint, "parent") for joint in joints
    }
    fixed_links = {
        joint_link(joint, "child") for joint in joints if joint.get("type") == "fixed"
    }
    inertias = {
        link.get("name", ""): _link_inertia(link) for link in root.findall("link")
    }
    kinematics = ET.Element("robot", root.attrib)
    kinematics[:] = [ET.Element("link", name=name) for name in inertias] + root.findall(
        "joint"
    )
    model = _pinocchio_model(kinematics, path)
    links: dict[str, ModelLink] = {}
    for frame in model.frames.tolist():
        if frame.type == pin.FrameType.BODY:
            carrier = frame.name
            if frame.name in fixed_links:
                carrier = links[parents[frame.name]].fixed_carrier
            links[frame.name] = ModelLink(
                name=frame.name,
                body=frame.parentJoint - 1,
                parent=parents.get(frame.name, ""),
                fixed_carrier=carrier,
                X_BL=Transform(frame.placement.rotation, frame.placement.translation),
                inertia=inertias[frame.name],
            )
    return tuple(links.values()), tuple(
        model.parents[j] - 1 for j in range(1, model.njoints)
    )


def _link_inertia(link: ET.Element) -> Inertia:
    """Stated inertia of a link, relative to the link's frame; zero if missing."""
    inertial = link.find("inertial")
    if inertial is None:
        return ZERO_INERTIA
    origin = inertial.find("origin")
    R_LC = pin.rpy.rpyToMatrix(*attribute_numbers(origin, "rpy", "0 0 0"))
    X_LC = Transform(R_LC, np.array(attribute_numbers(origin, "xyz", "0 0 0")))
    mass, central = _mass_and_tensor(inertial)
    return Inertia(mass, np.zeros(3), central).transformed(X_LC)


def _pinocchio_model(root: ET.Element, path: Path) -> pin.Model:
    """Pinocchio model of a URDF's XML.

    Raises:
        ModelError: Pinocchio's parser fails or reports an error on standard error.
    """
    with capture_stderr() as stderr_text:
        try:
            model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
        except Exception as error:  # Pinocchio raises whatever its parser meets
            raise ModelError(
                f"{path}: {_first_parser_error(stderr_text(), str(error))}"
            ) from None
        if stderr_text():  # the parser drops elements with errors
            raise ModelError(
                f"{path}: {_first_parser_error(stderr_text(), stderr_text())}"
            )
    return model


def _link_flaw(link: ET.Element) -> str | None:
    """Reason why a link's inertial element is physically inconsistent; None if consistent.

    Raises:
        ModelError: The inertial element has no mass or no inertia.
    """
    name, inertial = link.get("name", "?"), link.find("inertial")
    if inertial is None:
        return None
    if inertial.find("mass") is None or inertial.find("inertia") is None:
        raise ModelError(f"the inertial of link '{name}' lacks a mass or an inertia")
    origin = inertial.find("origin")
    place = attribute_numbers(origin, "xyz", "0 0 0") + attribute_numbers(
        origin, "rpy", "0 0 0"
    )
    if not np.isfinite(place).all():
        return f"link '{name}' has a mass centre or inertia frame that is not a number"
    mass, central = _mass_and_tensor(inertial)
    return inertia_flaw(name, mass, central)


def _mass_and_tensor(inertial: ET.Element) -> tuple[float, Array]:
    """Mass [kg] and inertia tensor in the frame of an inertial element, (3, 3) [kg m^2]."""
    (mass,) = attribute_numbers(inertial.find("mass"), "value")
    central = np.empty((3, 3))
    for key, (a, b) in TENSOR_INDICES.items():
        central[a, b] = central[b, a] = attribute_numbers(
            inertial.find("inertia"), key
        )[0]
    return mass, central


def _set_inertia(link: ET.Element, inertia: Inertia) -> None:
    """Replace the inertial element of a link, with axes along the link's frame.

    A zero inertia removes the element.

    Args:
        link: Link element, changed in place.
        inertia: Inertia relative to the link's frame.
    """
    for old in link.findall("inertial"):
        link.remove(old)
    if inertia.pseudo.any():
        new = ET.SubElement(link, "inertial")
        ET.SubElement(new, "origin", xyz=format_numbers(inertia.com), rpy="0 0 0")
        ET.SubElement(new, "mass", value=format_numbers([inertia.mass]))
        moments = {
            key: format_numbers([inertia.central[at]])
            for key, at in TENSOR_INDICES.items()
        }
        ET.SubElement(new, "inertia", moments)


def _joint_of(model: pin.Model, j: int, bodies: dict[int, str]) -> Joint:
    """Joint j of a Pinocchio model as a joint of the tree.

    In URDF, velocity and effort limits of zero, and position limits that are both zero, mean
    unknown limits; they become infinite, as do the position limits of continuous joints.

    Args:
        model: Pinocchio model.
        j: Index of the joint in Pinocchio, from 1.
        bodies: Link names, keyed by Pinocchio's joint index.
    """
    kind, axis = _kind_and_axis(model, j)
    v, q = model.idx_vs[j], model.idx_qs[j]
    # Pinocchio stores a continuous joint as a point of the circle
    has_range = model.joints[j].nq == 1
    limits = (model.lowerPositionLimit[q], model.upperPositionLimit[q])
    # in URDF a limit of zero means none is known
    has_range = has_range and limits != (
        0.0,
        0.0,
    )
    placement = model.jointPlacements[j]
    return Joint(
        name=model.names[j],
        body=bodies[j],
        kind=kind,
        parent=model.parents[j] - 1,
        axis=axis,
        offset=placement.translation,
        rotation=placement.rotation,
        position_range=np.array(limits if has_range else (-np.inf, np.inf)),
        max_velocity=float(model.upperVelocityLimit[v]) or np.inf,
        max_effort=float(model.upperEffortLimit[v]) or np.inf,
        coulomb=float(model.upperDryFrictionLimit[v]),
        viscous=float(model.damping[v]),
        rotor_inertia=float(model.armature[v]),
    )


def _kind_and_axis(model: pin.Model, j: int) -> tuple[JointKind, np.ndarray]:
    """Kind of a joint and unit axis in the body's frame, from the motion subspace."""
    linear, angular = np.split(np.ravel(model.joints[j].createData().S), 2)
    revolute = np.linalg.norm(angular) > 0.5
    return ("revolute", angular.copy()) if revolute else ("prismatic", linear.copy())


def _inertia_of(inertia: pin.Inertia) -> Inertia:
    """Inertia about the body frame's origin from Pinocchio's inertia about the mass centre."""
    return Inertia.about_centre(inertia.mass, inertia.lever, inertia.inertia)


def _first_parser_error(stderr_text: str, exception_text: str) -> str:
    """First error message of the parser, prefixed, on one line of limited length.

    Args:
        stderr_text: Standard error of the parser, searched for "Error:".
        exception_text: Text in place of a missing "Error:".
    """
    reasons: list[str] = re.findall(r"Error:\s*(.+)", stderr_text) or [exception_text]
    return "not a valid URDF: " + " ".join(reasons[0].split())[:400]
