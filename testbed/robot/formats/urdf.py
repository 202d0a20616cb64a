"""URDF -> Tree, through Pinocchio: one of two independent roads.

Pinocchio reads the kinematics and merges fixed links. What it passes over in silence
(mimic joints, loops, floating and planar joints, impossible inertias) is looked for in
the XML first. Visual and collision elements are dropped unread, so meshes and
`package://` addresses never matter.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin

from testbed.errors import FreeRootError, InertiaError, ModelError
from testbed.robot.inertia import Inertia, flaw
from testbed.robot.stderr import captured_stderr
from testbed.robot.tree import Joint, Kind, Tree

_SUPPORTED = ("revolute", "continuous", "prismatic", "fixed")


def read_urdf(path: Path, *, weld_root: bool = False, accept_inertia: bool = False) -> Tree:
    """The tree of a URDF file; the bedplate frame is the root link's frame.

    Args:
        path: The file.
        weld_root: Weld a floating root to the bedplate instead of refusing it.
        accept_inertia: Take impossible inertias as they are and note them in `warnings`.

    Raises:
        ModelError: The file is not a URDF, or holds what is not supported.
        FreeRootError: The root floats and `weld_root` is not set.
        InertiaError: A link cannot be a rigid body and `accept_inertia` is not set.
    """
    root = supported_xml(path, weld_root=weld_root)
    flaws = [found for link in root.findall("link") if (found := _link_flaw(link, path))]
    if flaws and not accept_inertia:
        raise InertiaError(path.name, flaws)
    with captured_stderr() as said:
        try:
            model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
        except Exception as error:  # Pinocchio raises whatever its parser meets
            raise ModelError(f"{path}: {_first_complaint(said(), str(error))}") from None
    return _tree_of(model, root.get("name", path.stem), tuple(flaws))


def supported_xml(path: Path, *, weld_root: bool = False, keep_visuals: bool = False) -> ET.Element:
    """The file's XML without shapes (or with those to be seen), checked for what is supported.

    Raises:
        ModelError: The file is not XML, or holds what is not supported.
        FreeRootError: The root floats and `weld_root` is not set.
    """
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, LookupError, ValueError) as error:  # the latter: odd encodings
        raise ModelError(f"{path}: not well-formed XML ({error})") from None
    for link in root.findall("link"):
        visuals = [] if keep_visuals else link.findall("visual")
        for shape in (*visuals, *link.findall("collision")):
            link.remove(shape)
    for joint in root.findall("joint"):
        _check_joint(joint, root, path, weld_root)
    _check_loops(root, path)
    return root


def _check_joint(joint: ET.Element, root: ET.Element, path: Path, weld_root: bool) -> None:
    name, kind = joint.get("name", "?"), joint.get("type", "?")
    if joint.find("mimic") is not None:
        raise ModelError(f"{path}: joint '{name}' mimics another joint, which is not supported")
    if kind == "floating" and _is_root(joint, root):
        if not weld_root:
            raise FreeRootError(path.name, name)
        joint.set("type", "fixed")
    elif kind not in _SUPPORTED:
        raise ModelError(
            f"{path}: joint '{name}' is of type '{kind}', which is not supported "
            f"(supported: {', '.join(_SUPPORTED)})"
        )


def _is_root(joint: ET.Element, root: ET.Element) -> bool:
    parent = _link_of(joint, "parent")
    return all(_link_of(other, "child") != parent for other in root.findall("joint"))


def _check_loops(root: ET.Element, path: Path) -> None:
    carrier: dict[str, str] = {}
    for joint in root.findall("joint"):
        child, name = _link_of(joint, "child"), joint.get("name", "?")
        if child in carrier:
            raise ModelError(
                f"{path}: link '{child}' is carried by joint '{carrier[child]}' and by joint "
                f"'{name}'; closed loops are not supported"
            )
        carrier[child] = name


def _link_of(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _link_flaw(link: ET.Element, path: Path) -> str | None:
    """The link's flaw, if any; a mass or inertia that is not finite is emptied on the way."""
    name, inertial = link.get("name", "?"), link.find("inertial")
    if inertial is None:
        return None
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        raise ModelError(f"{path}: the inertial of link '{name}' lacks a mass or an inertia")
    try:
        m = float(mass.get("value", "nan"))
        xx, xy, xz, yy, yz, zz = (
            float(inertia.get(key, "nan")) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
    except ValueError as error:
        raise ModelError(f"{path}: the inertial of link '{name}': {error}") from None
    found = flaw(name, m, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    origin = inertial.find("origin")
    place = " ".join([] if origin is None else [origin.get("xyz", ""), origin.get("rpy", "")])
    if any(word.lower().strip("+-") in ("nan", "inf", "infinity") for word in place.split()):
        found = f"link '{name}' has a mass centre or inertia frame that is not a number"
        link.remove(inertial)
    elif not np.isfinite([m, xx, xy, xz, yy, yz, zz]).all():
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
    data, velocity = model.createData(), np.zeros(model.nv)
    velocity[model.idx_vs[j]] = 1.0
    pin.forwardKinematics(model, data, pin.neutral(model), velocity)
    turn, slide = data.v[j].angular, data.v[j].linear
    revolute = np.linalg.norm(turn) > 0.5
    return ("revolute", turn.copy()) if revolute else ("prismatic", slide.copy())


def _inertia_of(inertia: pin.Inertia) -> Inertia:
    return Inertia.about_centre(inertia.mass, inertia.lever, inertia.inertia)


def _first_complaint(said: str, raised: str) -> str:
    """The parser's first reason, on one line."""
    reasons: list[str] = re.findall(r"Error:\s*(.+)", said) or [raised]
    return "not a valid URDF: " + " ".join(reasons[0].split())
