"""URDF -> Tree, through Pinocchio: one of two independent roads.

Pinocchio reads the kinematics and merges fixed links; what it would pass over in silence
has been found in the XML before. Visual and collision elements are dropped unread, so
meshes and `package://` addresses never matter.
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
    TENSOR,
    link_at,
    numbers_of,
    supported_xml,
)
from testbed.core.robot.inertia import NOTHING, Inertia
from testbed.core.robot.parsing import capture_stderr, errors_of, plain, read_xml
from testbed.core.robot.repair import FileLink, Repair, repaired
from testbed.core.robot.rigid_matter import inertia_flaw
from testbed.core.robot.tree import Joint, Kind, ModelSource, Tree


@dataclass(frozen=True, eq=False)
class UrdfModel:
    """Links and joints of a URDF file, of bodies that can be, for all readers.

    Attributes:
        path: The file.
        root: Its XML.
        links: Links with their inertias as the file has them, carriers before what they carry.
        repair: What was repaired.
        diagnostics: What was accepted although it is wrong.
    """

    path: Path
    root: ET.Element
    links: tuple[FileLink, ...]
    repair: Repair
    diagnostics: tuple[Diagnostic, ...]

    def tree(self) -> Tree:
        """Robot; the bedplate frame is the root link's frame.

        Raises:
            ModelError: Pinocchio does not take the file.
        """
        model = _built(self.root, self.path)
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
    """Read a URDF file; errors are those of `load_tree`."""
    path = file.path
    root, said = supported_xml(file)
    elements = {link.get("name", ""): link for link in root.findall("link")}
    with errors_of(path):
        suspects = {
            name: line for name, link in elements.items() if (line := _link_flaw(link))
        }
    links, parents = _links(root, path)
    repair = repaired(links, suspects, parents, file.repair, path.name, _reach(root))
    for name, inertia in repair.links.items():
        _set_inertia(elements[name], inertia)
    return UrdfModel(path, root, links, repair, said)


def _reach(root: ET.Element) -> float:
    """Sum of the distances from joint to joint [m]."""
    origins = (joint.find("origin") for joint in root.findall("joint"))
    return sum(math.hypot(*numbers_of(origin, "xyz", "0 0 0")) for origin in origins)


def _links(
    root: ET.Element, path: Path
) -> tuple[tuple[FileLink, ...], tuple[int, ...]]:
    """The links with their inertias as the file has them, and the parents of the tree's bodies."""
    joints = read_xml(path).findall("joint")
    parents = {link_at(joint, "child"): link_at(joint, "parent") for joint in joints}
    held = {link_at(joint, "child") for joint in joints if joint.get("type") == "fixed"}
    inertias = {
        link.get("name", ""): _link_inertia(link) for link in root.findall("link")
    }
    bare = ET.Element("robot", root.attrib)
    bare[:] = [ET.Element("link", name=name) for name in inertias] + root.findall(
        "joint"
    )
    model = _built(bare, path)
    links: dict[str, FileLink] = {}
    for frame in model.frames.tolist():
        if frame.type == pin.FrameType.BODY:
            carrier = frame.name
            if frame.name in held:
                carrier = links[parents[frame.name]].carrier
            links[frame.name] = FileLink(
                name=frame.name,
                body=frame.parentJoint - 1,
                parent=parents.get(frame.name, ""),
                carrier=carrier,
                X_BL=Transform(frame.placement.rotation, frame.placement.translation),
                inertia=inertias[frame.name],
            )
    return tuple(links.values()), tuple(
        model.parents[j] - 1 for j in range(1, model.njoints)
    )


def _link_inertia(link: ET.Element) -> Inertia:
    """As the file has it, in the link's frame."""
    inertial = link.find("inertial")
    if inertial is None:
        return NOTHING
    origin = inertial.find("origin")
    R_LC = pin.rpy.rpyToMatrix(*numbers_of(origin, "rpy", "0 0 0"))
    X_LC = Transform(R_LC, np.array(numbers_of(origin, "xyz", "0 0 0")))
    mass, central = _stated(inertial)
    return Inertia(mass, np.zeros(3), central).moved(X_LC)


def _built(root: ET.Element, path: Path) -> pin.Model:
    """The file's mechanism as Pinocchio has it."""
    with capture_stderr() as said:
        try:
            model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
        except Exception as error:  # Pinocchio raises whatever its parser meets
            raise ModelError(
                f"{path}: {_first_complaint(said(), str(error))}"
            ) from None
        if said():  # its parser leaves out what it complains of
            raise ModelError(f"{path}: {_first_complaint(said(), said())}")
    return model


def _link_flaw(link: ET.Element) -> str | None:
    """What is wrong with the link's inertia as it stands, if anything."""
    name, inertial = link.get("name", "?"), link.find("inertial")
    if inertial is None:
        return None
    if inertial.find("mass") is None or inertial.find("inertia") is None:
        raise ModelError(f"the inertial of link '{name}' lacks a mass or an inertia")
    origin = inertial.find("origin")
    place = numbers_of(origin, "xyz", "0 0 0") + numbers_of(origin, "rpy", "0 0 0")
    if not np.isfinite(place).all():
        return f"link '{name}' has a mass centre or inertia frame that is not a number"
    mass, central = _stated(inertial)
    return inertia_flaw(name, mass, central)


def _stated(inertial: ET.Element) -> tuple[float, Array]:
    """Mass, and inertia along the axes of the element's origin."""
    (mass,) = numbers_of(inertial.find("mass"), "value")
    central = np.empty((3, 3))
    for key, (a, b) in TENSOR.items():
        central[a, b] = central[b, a] = numbers_of(inertial.find("inertia"), key)[0]
    return mass, central


def _set_inertia(link: ET.Element, inertia: Inertia) -> None:
    """Give a link another inertia, along its own axes."""
    for old in link.findall("inertial"):
        link.remove(old)
    if inertia.pseudo.any():
        new = ET.SubElement(link, "inertial")
        ET.SubElement(new, "origin", xyz=plain(inertia.com), rpy="0 0 0")
        ET.SubElement(new, "mass", value=plain([inertia.mass]))
        moments = {key: plain([inertia.central[at]]) for key, at in TENSOR.items()}
        ET.SubElement(new, "inertia", moments)


def _joint_of(model: pin.Model, j: int, bodies: dict[int, str]) -> Joint:
    kind, axis = _screw(model, j)
    v, q = model.idx_vs[j], model.idx_qs[j]
    # a continuous joint is kept as a point of the circle
    bounded = model.joints[j].nq == 1
    limits = (model.lowerPositionLimit[q], model.upperPositionLimit[q])
    # in URDF a limit of zero means none is known
    bounded = bounded and limits != (
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
        position_range=np.array(limits if bounded else (-np.inf, np.inf)),
        max_velocity=float(model.upperVelocityLimit[v]) or np.inf,
        max_effort=float(model.upperEffortLimit[v]) or np.inf,
        coulomb=float(model.upperDryFrictionLimit[v]),
        viscous=float(model.damping[v]),
        rotor_inertia=float(model.armature[v]),
    )


def _screw(model: pin.Model, j: int) -> tuple[Kind, np.ndarray]:
    """Kind and axis of a joint, from the motion that its unit velocity makes."""
    slide, turn = np.split(np.ravel(model.joints[j].createData().S), 2)
    revolute = np.linalg.norm(turn) > 0.5
    return ("revolute", turn.copy()) if revolute else ("prismatic", slide.copy())


def _inertia_of(inertia: pin.Inertia) -> Inertia:
    return Inertia.about_centre(inertia.mass, inertia.lever, inertia.inertia)


def _first_complaint(said: str, raised: str) -> str:
    """The parser's first reason, on one line."""
    reasons: list[str] = re.findall(r"Error:\s*(.+)", said) or [raised]
    return "not a valid URDF: " + " ".join(reasons[0].split())[:400]
