"""URDF -> Tree, through Pinocchio: one of two independent roads.

Pinocchio reads the kinematics and merges fixed links; what it would pass over in silence
has been found in the XML before. Visual and collision elements are dropped unread, so
meshes and `package://` addresses never matter.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin

from testbed.errors import InertiaError, ModelError
from testbed.robot.formats.urdf_numbers import numbers_of
from testbed.robot.formats.urdf_xml import supported_xml
from testbed.robot.inertia import NOTHING, Inertia, inertia_flaw
from testbed.robot.links import Link
from testbed.robot.locks import Lock
from testbed.robot.model_xml import read_xml
from testbed.robot.rotations import from_rpy
from testbed.robot.stderr import captured_stderr
from testbed.robot.tree import Joint, Kind, Tree


def read_urdf(
    path: Path,
    *,
    weld_root: bool = False,
    accept_inertia: bool = False,
    lock: Lock | None = None,
) -> Tree:
    """The tree of a URDF file; the bedplate frame is the root link's frame.

    Args:
        path: The file.
        weld_root: Weld a floating root to the bedplate instead of refusing it.
        accept_inertia: Take impossible inertias as they are and note them in `warnings`.
        lock: Joints to be held, which are no joints of the tree.

    Raises:
        ModelError: The file is not a URDF, or holds what is not supported; FreeRootError and
            MimicError are such.
        InertiaError: A link cannot be a rigid body and `accept_inertia` is not set.
    """
    root, warnings = supported_xml(path, weld_root=weld_root, lock=lock)
    flaws = [found for link in root.findall("link") if (found := _link_flaw(link, path))]
    if flaws and not accept_inertia:
        raise InertiaError(path.name, flaws)
    return _tree_of(_built(root, path), root.get("name", path.stem), (*flaws, *warnings))


def read_links(
    path: Path, *, weld_root: bool = False, lock: Lock | None = None
) -> tuple[Link, ...]:
    """The links of a URDF file in the bodies of its tree, carriers before what they carry.

    Args:
        path: The file, which `read_urdf` has read.
        weld_root: As then.
        lock: As then.
    """
    moving = {
        child.get("link")
        for joint in read_xml(path).findall("joint")
        if joint.get("type") != "fixed"
        for child in joint.findall("child")
    }
    root, _ = supported_xml(path, weld_root=weld_root, lock=lock)
    elements = {link.get("name", ""): link for link in root.findall("link")}
    for link in elements.values():
        _link_flaw(link, path)
    model = _built(root, path)
    return tuple(
        Link(
            name=frame.name,
            body=frame.parentJoint - 1,
            moves=frame.name in moving,
            rotation=frame.placement.rotation,
            position=frame.placement.translation,
            inertia=_link_inertia(elements[frame.name]),
        )
        for frame in model.frames.tolist()
        if frame.type == pin.FrameType.BODY
    )


def _link_inertia(link: ET.Element) -> Inertia:
    """As the file has it, in the link's frame."""
    inertial = link.find("inertial")
    if inertial is None:
        return NOTHING
    origin, central = inertial.find("origin"), inertial.find("inertia")
    (mass,) = numbers_of(inertial.find("mass"), "value")
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (numbers_of(central, key)[0] for key in keys)
    turn = from_rpy(numbers_of(origin, "rpy", "0 0 0"))
    tensor = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    return Inertia.about_centre(mass, numbers_of(origin, "xyz", "0 0 0"), tensor)


def _built(root: ET.Element, path: Path) -> pin.Model:
    """The file's mechanism as Pinocchio has it."""
    with captured_stderr() as said:
        try:
            model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
        except Exception as error:  # Pinocchio raises whatever its parser meets
            raise ModelError(f"{path}: {_first_complaint(said(), str(error))}") from None
        if said():  # its parser leaves out what it complains of
            raise ModelError(f"{path}: {_first_complaint(said(), said())}")
    return model


def _link_flaw(link: ET.Element, path: Path) -> str | None:
    """The link's flaw, if any; a mass or inertia that is not finite is emptied on the way."""
    name, inertial = link.get("name", "?"), link.find("inertial")
    if inertial is None:
        return None
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        raise ModelError(f"{path}: the inertial of link '{name}' lacks a mass or an inertia")
    (m,) = numbers_of(mass, "value")
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (numbers_of(inertia, key)[0] for key in keys)
    found = inertia_flaw(name, m, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    origin = inertial.find("origin")
    place = numbers_of(origin, "xyz", "0 0 0") + numbers_of(origin, "rpy", "0 0 0")
    if not np.isfinite(place).all():
        found = f"link '{name}' has a mass centre or inertia frame that is not a number"
    if not np.isfinite([m, xx, xy, xz, yy, yz, zz, *place]).all():
        link.remove(inertial)
    return found


def _tree_of(model: pin.Model, name: str, warnings: tuple[str, ...]) -> Tree:
    bodies = {
        frame.parentJoint: frame.name
        for frame in reversed(model.frames.tolist())
        if frame.type == pin.FrameType.BODY
    }
    joints = tuple(_joint_of(model, j, bodies) for j in range(1, model.njoints))
    inertias = tuple(_inertia_of(model.inertias[j]) for j in range(1, model.njoints))
    return Tree(
        name=name,
        joints=joints,
        inertias=inertias,
        pedestal=_inertia_of(model.inertias[0]),
        gravity=model.gravity.linear,
        warnings=warnings,
    )


def _joint_of(model: pin.Model, j: int, bodies: dict[int, str]) -> Joint:
    kind, axis = _screw(model, j)
    v, q = model.idx_vs[j], model.idx_qs[j]
    bounded = model.joints[j].nq == 1  # a continuous joint is kept as a point of the circle
    limits = (model.lowerPositionLimit[q], model.upperPositionLimit[q])
    bounded = bounded and limits != (0.0, 0.0)  # in URDF a limit of zero means none is known
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
