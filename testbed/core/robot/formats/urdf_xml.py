"""Checked XML of a URDF file, with plain numbers and with locked joints made fixed.

Faults that parsers ignore are detected here: loops, unconnected links, floating and planar joints,
misspelled elements. Parsers differ in the numbers that they accept, such as "3 ". Texts that are
not plain numbers are rejected; numbers are rewritten so that Pinocchio and MuJoCo accept them.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import ModelError, quoted_list, shortened_list
from testbed.core.base.transform import Transform
from testbed.core.robot.inertia import MAX_INERTIAL_PARAMETER
from testbed.core.robot.locks import (
    JointLocks,
    JointTravel,
    MimicCoupling,
    lock_positions,
)
from testbed.core.robot.parsing import (
    format_numbers,
    parse_decimals,
    prefix_model_errors,
    read_xml,
)
from testbed.core.robot.refusals import FreeRootError
from testbed.core.robot.rotations import (
    joint_displacement,
    matrix_to_rpy,
    rpy_to_matrix,
)
from testbed.core.robot.tree import AXIS_NORM_TOLERANCE, MAX_COORDINATE, ModelSource

MAX_CHAIN_LENGTH = 1_500
"""Largest number of links in series; Pinocchio's parser overflows its stack at 2000 to 4000."""
_MOVING_TYPES = ("revolute", "continuous", "prismatic")
_JOINT_TYPES = (*_MOVING_TYPES, "fixed")
_USED_TAGS: dict[str, tuple[str, ...]] = {
    "robot": ("link", "joint"),
    "link": ("inertial",),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
}
"""Child elements that are read, keyed by parent element."""
_IGNORED_TAGS: dict[str, tuple[str, ...]] = {
    "robot": ("material", "transmission", "gazebo", "sensor", "ros2_control", "mujoco"),
    "link": ("visual", "collision"),
    "joint": ("safety_controller", "calibration"),
}
"""Known child elements for simulators, drawings and drives, keyed by parent element."""

TENSOR_INDICES = {
    "ixx": (0, 0),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyy": (1, 1),
    "iyz": (1, 2),
    "izz": (2, 2),
}
"""Row and column of an inertia tensor's entry, keyed by attribute."""


@dataclass(frozen=True)
class _NumberFormat:
    """Format of an attribute that holds numbers.

    Attributes:
        count: Required count of numbers.
        default: Text in place of a missing attribute; None if the attribute is required.
        max_magnitude: Largest accepted magnitude.
        signed: True if negative numbers are accepted.
        angles: True to replace angles close to multiples of a right angle by the exact angle.
    """

    count: int
    default: str | None
    max_magnitude: float = float("inf")
    signed: bool = True
    angles: bool = False


_POSE_FORMATS = {
    "xyz": _NumberFormat(3, "0 0 0", MAX_COORDINATE),
    "rpy": _NumberFormat(3, "0 0 0", MAX_COORDINATE, angles=True),
}
_NUMBER_FORMATS = {
    "origin": _POSE_FORMATS,
    "axis": {"xyz": _NumberFormat(3, "1 0 0", MAX_COORDINATE)},
    "mass": {"value": _NumberFormat(1, None, MAX_INERTIAL_PARAMETER)},
    "inertia": {
        key: _NumberFormat(1, None, MAX_INERTIAL_PARAMETER) for key in TENSOR_INDICES
    },
    "limit": {
        **{key: _NumberFormat(1, "0") for key in ("lower", "upper")},
        **{key: _NumberFormat(1, "0", signed=False) for key in ("effort", "velocity")},
    },
    "dynamics": {
        "damping": _NumberFormat(1, "0"),
        "friction": _NumberFormat(1, "0", signed=False),
    },
    "mimic": {"multiplier": _NumberFormat(1, "1"), "offset": _NumberFormat(1, "0")},
    "box": {"size": _NumberFormat(3, None, MAX_COORDINATE)},
    "sphere": {"radius": _NumberFormat(1, None, MAX_COORDINATE)},
    "cylinder": {
        key: _NumberFormat(1, None, MAX_COORDINATE) for key in ("radius", "length")
    },
    "capsule": {
        key: _NumberFormat(1, None, MAX_COORDINATE) for key in ("radius", "length")
    },
    "mesh": {"scale": _NumberFormat(3, "1 1 1", MAX_COORDINATE)},
    "color": {"rgba": _NumberFormat(4, None, 1.0)},
}
"""Formats of attributes that hold numbers, keyed by element, then by attribute."""
_TEXT_ATTRIBUTES: dict[str, tuple[str, ...]] = {
    "robot": ("name", "version"),
    "link": ("name",),
    "joint": ("name", "type"),
    "parent": ("link",),
    "child": ("link",),
    "mimic": ("joint",),
}
"""Known attributes without numbers, keyed by element."""
_NON_FINITE_WORDS = ("nan", "inf", "infinity")
"""Words for numbers that are not finite."""


def checked_urdf_xml(
    file: ModelSource, *, keep_visuals: bool = False
) -> tuple[ET.Element, tuple[Diagnostic, ...]]:
    """Checked root element of a URDF file, with locked joints made fixed.

    Args:
        file: Model file with options for reading; errors are those of `load_tree`.
        keep_visuals: True to keep visual elements and materials.

    Returns:
        Root element, and diagnostics of faults that were accepted.
    """
    root, diagnostics = _checked_xml(file.path, file.weld_root, keep_visuals)
    return root, (
        *diagnostics,
        *_fix_locked_joints(root.findall("joint"), file.lock, file.path),
    )


def _checked_xml(
    path: Path, weld_root: bool, keep_visuals: bool = False
) -> tuple[ET.Element, list[Diagnostic]]:
    """Root element of a URDF file with links and joints, checked to form a tree.

    Numbers are rewritten in plain form. Unused elements and accepted faults are removed; the second
    result holds the diagnostics. Errors are those of `load_tree`.

    Args:
        path: URDF file.
        weld_root: True to convert a floating joint at the root to a fixed joint.
        keep_visuals: True to keep visual elements and materials.
    """
    root = read_xml(path)
    root.set("name", root.get("name") or path.stem)  # required by parsers
    links, joints = root.findall("link"), root.findall("joint")
    materials = root.findall("material") if keep_visuals else []
    with prefix_model_errors(path):
        diagnostics = [each for part in root.iter() for each in _correct_faults(part)]
        ignored = dict(
            [*_remove_unused_elements(root, "", ("visual",) if keep_visuals else ())][
                ::-1
            ]
        )
        if ignored:
            owners = [f"{name} of {owner}" for name, owner in ignored.items()]
            diagnostics.append(
                make_diagnostic(
                    "model.ignored", shortened_list(owners[::-1]), file=path.name
                )
            )
        root[:] = [*materials, *links, *joints]
        carriers = _carriers(links, joints)
        for joint in joints:
            if (
                joint.get("type") == "floating"
                and joint_link(joint, "parent") not in carriers
            ):
                if not weld_root:
                    raise FreeRootError(path.name, joint.get("name", "?"))
                joint.set("type", "fixed")
            _check_joint(joint)
        for link in links:
            for inertial in link.findall("inertial"):
                rewrite_numbers(inertial, f"link '{link.get('name')}'", allow_nan=True)
    return root, diagnostics


def _check_joint(joint: ET.Element) -> None:
    """Check type, axis and mimic joint of a joint element; rewrite numbers in plain form."""
    name, kind = f"joint '{joint.get('name')}'", joint.get("type", "?")
    if kind not in _JOINT_TYPES:
        raise ModelError(
            f"{name} is of type '{kind:.40}', which is not supported (supported: "
            f"{', '.join(_JOINT_TYPES)})"
        )
    rewrite_numbers(joint, name)
    axis = attribute_numbers(joint.find("axis"), "xyz", "1 0 0")
    if kind != "fixed" and max(np.abs(axis)) < AXIS_NORM_TOLERANCE:
        raise ModelError(f"{name} has no direction: its <axis> xyz is {axis}")
    if not all(mimic.get("joint") for mimic in joint.findall("mimic")):
        raise ModelError(f"{name}: <mimic> names no joint")


def _correct_faults(element: ET.Element) -> Iterator[Diagnostic]:
    """Correct repeated origins and negative friction of an element; yield a diagnostic for each.

    The first of several origins is kept, as in urdfdom; negative friction is set to zero.
    """
    name = f"{element.tag} '{element.get('name', '')}'"
    for part in (
        (element, *element.findall("inertial")) if element.tag in _USED_TAGS else ()
    ):
        for repeated in part.findall("origin")[1:]:
            part.remove(repeated)
            yield make_diagnostic("model.origins", name)
    for dynamics in element.findall("dynamics"):
        numbers = parse_decimals(dynamics.get("friction", "0"), 1)
        if numbers and numbers[0] < 0:
            dynamics.set("friction", "0")
            yield make_diagnostic("model.negative-friction", name, numbers[0])


def urdf_joint_travels(path: Path) -> dict[str, JointTravel]:
    """Range and mimic coupling of every moving joint of a URDF file, keyed by name."""
    root, _ = _checked_xml(path, weld_root=True)
    return _travels(root.findall("joint"))


def _travels(joints: list[ET.Element]) -> dict[str, JointTravel]:
    """Range and coupling of moving joints among checked joint elements, keyed by name."""
    moving = {
        joint.get("name", ""): joint
        for joint in joints
        if joint.get("type") in _MOVING_TYPES
    }
    fixed = {joint.get("name", "") for joint in joints} - moving.keys()
    travels = {}
    for name, joint in moving.items():
        low, high = -np.inf, np.inf
        limit, mimic = joint.find("limit"), joint.find("mimic")
        if limit is not None and joint.get("type") != "continuous":
            ends = (
                *attribute_numbers(limit, "lower"),
                *attribute_numbers(limit, "upper"),
            )
            low, high = ends if any(ends) else (low, high)  # zeros: unknown
        coupling = None
        if mimic is not None:
            master = mimic.get("joint", "")
            offset, slope = (
                *attribute_numbers(mimic, "offset"),
                *attribute_numbers(mimic, "multiplier", "1"),
            )
            coupling = MimicCoupling(master, (offset, slope))
            if master in fixed:
                coupling = MimicCoupling(None, (offset,))
        travels[name] = JointTravel(low, high, coupling)
    return travels


def _fix_locked_joints(
    joints: list[ET.Element], lock: JointLocks, path: Path
) -> tuple[Diagnostic, ...]:
    """Convert locked joints to fixed joints at the locked positions.

    Returns the diagnostics of `lock_positions`. Missing limits become zero, which means unknown.
    """
    locked, diagnostics = lock_positions(_travels(joints), lock, path.name)
    for joint in joints:
        name = joint.get("name", "")
        if name in locked:
            if locked[name]:
                _move_origin(joint, locked[name])
            joint.set("type", "fixed")
        if joint.get("type") == "fixed":
            for part in list(joint):
                if part.tag in ("axis", "limit", "dynamics", "mimic"):
                    joint.remove(part)
        elif joint.get("type") != "continuous" and joint.find("limit") is None:
            zeros = dict.fromkeys(("lower", "upper", "effort", "velocity"), "0")
            ET.SubElement(joint, "limit", zeros)  # required by parsers; zeros: unknown
    return diagnostics


def _move_origin(joint: ET.Element, position: float) -> None:
    """Displace a joint's origin by the motion of the joint to a position [rad or m]."""
    origin = joint.find("origin")
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    axis = np.array(attribute_numbers(joint.find("axis"), "xyz", "1 0 0"))
    axis /= np.linalg.norm(axis)
    rpy, xyz = (
        np.array(attribute_numbers(origin, key, "0 0 0")) for key in ("rpy", "xyz")
    )
    X_PB = Transform(rpy_to_matrix(rpy), xyz) @ joint_displacement(
        axis, position, revolute=joint.get("type") != "prismatic"
    )
    origin.set("xyz", format_numbers(X_PB.p_AB_A))
    origin.set("rpy", format_numbers(matrix_to_rpy(X_PB.R_AB)))


def _remove_unused_elements(
    element: ET.Element, owner: str, also: tuple[str, ...]
) -> Iterator[tuple[str, str]]:
    """Remove unused child elements, recursively; yield unknown tags and attributes with owners.

    Args:
        element: Element, changed in place.
        owner: Description of the link or joint that contains the element.
        also: Further tags to be kept.

    Raises:
        ModelError: A name is probably misspelled, or a child element is repeated.
    """
    tag, tags = element.tag, [child.tag for child in element]
    owner = f"{tag} '{element.get('name', '?')}'" if tag in _IGNORED_TAGS else owner
    parts, ignored = _USED_TAGS.get(tag, ()), _IGNORED_TAGS.get(tag, ())
    attributes = (*_NUMBER_FORMATS.get(tag, ()), *_TEXT_ATTRIBUTES.get(tag, ()))
    keys = [key for key in element.attrib if not key.startswith("xmlns")]
    for names, known in ((tags, parts), (keys, attributes)):
        for name in sorted({*names} - {*known, *ignored}):
            matches = get_close_matches(
                name.lower(), {*known} - {*names}, n=1, cutoff=0.8
            )
            if matches and matches[0] not in name:  # a longer name is distinct
                message = f"<{tag}> holds the unknown {name!r:.40}; did you mean {matches[0]}?"
                raise ModelError(f"{owner}: {message}")
            yield f"'{name:.40}' in <{tag}>", owner
    element[:] = [child for child in element if child.tag in (*parts, *also)]
    for child in element:
        if tag != "robot" and tags.count(child.tag) > 1 and child.tag in parts:
            raise ModelError(f"{owner} has more than one <{child.tag}>")
        if child.tag in parts:
            yield from _remove_unused_elements(child, owner, also)


def _carriers(
    links: list[ET.Element], joints: list[ET.Element]
) -> dict[str, ET.Element]:
    """Joint that carries each link, keyed by link; ModelError unless links form one tree."""
    for what, elements in (("link", links), ("joint", joints)):
        names = [element.get("name", "") for element in elements]
        if "" in names:
            raise ModelError(f"a {what} has no name")
        if len(set(names)) < len(names):
            twice = next(name for k, name in enumerate(names) if name in names[:k])
            raise ModelError(f"two {what}s have the name '{twice}'")
    known = {link.get("name", "") for link in links}
    carriers: dict[str, ET.Element] = {}
    for joint in joints:
        name, child = joint.get("name", ""), joint_link(joint, "child")
        for end in ("parent", "child"):
            if joint_link(joint, end) not in known:
                raise ModelError(
                    f"joint '{name}' has no {end} link '{joint_link(joint, end)}'"
                )
        if child in carriers:
            raise ModelError(
                f"link '{child}' is carried by joint '{carriers[child].get('name')}' and by joint "
                f"'{name}'; closed loops are not supported"
            )
        carriers[child] = joint
    _check_tree(known, carriers)
    return carriers


def _check_tree(known: set[str], carriers: dict[str, ET.Element]) -> None:
    """Check that all links descend from one root, in chains of limited length.

    Args:
        known: Names of all links.
        carriers: Joint that carries each link, keyed by link name.
    """
    roots = [name for name in known if name not in carriers]
    children: dict[str, list[str]] = {}
    for child, joint in carriers.items():
        children.setdefault(joint_link(joint, "parent"), []).append(child)
    reached, level, depth = set(roots), roots, 0
    while level:
        level = [child for link in level for child in children.get(link, [])]
        reached.update(level)
        depth += 1
        if depth > MAX_CHAIN_LENGTH:
            raise ModelError(f"a chain of more than {MAX_CHAIN_LENGTH} links")
    if len(reached) < len(known):
        unreached = min(known - reached)
        raise ModelError(
            f"link '{unreached}' hangs on no root; its chain of joints is a closed loop"
        )
    if len(roots) > 1:
        raise ModelError(
            f"{len(roots)} links are carried by no joint ({quoted_list(sorted(roots))}); a robot "
            "has one such"
        )


def joint_link(joint: ET.Element, end: str) -> str:
    """Name of the "parent" or "child" link of a joint; "" if missing."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def rewrite_numbers(owner: ET.Element, where: str, *, allow_nan: bool = False) -> None:
    """Check the numbers in an element's children and rewrite the texts in plain form.

    Args:
        owner: Joint or inertial element, whose children are changed.
        where: Description of the owner, for messages.
        allow_nan: True to keep texts like "nan" as NaN: the inertia is rejected later.

    Raises:
        ModelError: A number is missing, malformed or out of bounds; the message names it.
    """
    for part in owner:
        for key, numbers in _NUMBER_FORMATS.get(part.tag, {}).items():
            text = part.get(key, numbers.default)
            if text is None:
                raise ModelError(f"{where}: <{part.tag}> has no {key}")
            part.set(
                key,
                _plain_numbers(
                    text, numbers, f"{where}: <{part.tag}> {key}", allow_nan
                ),
            )


def attribute_numbers(
    element: ET.Element | None, key: str, default: str = "0"
) -> list[float]:
    """Numbers of an attribute after `rewrite_numbers`.

    Args:
        element: Element; None for a missing element.
        key: Attribute.
        default: Text in place of a missing attribute.
    """
    text = default if element is None else element.get(key, default)
    return [float(word) for word in text.split()]


def _plain_numbers(
    text: str, numbers: _NumberFormat, where: str, allow_nan: bool
) -> str:
    """Numbers of an attribute in plain form, checked against a format.

    Args:
        text: Text of the attribute.
        numbers: Required format.
        where: Description of the attribute, for messages.
        allow_nan: True to return "nan" for all numbers if any number is NaN or infinite.

    Raises:
        ModelError: Count, form or size of the numbers is wrong.
    """
    values = parse_decimals(text, numbers.count)
    if values is None:
        words = text.lower().split()
        if allow_nan and len(words) == numbers.count:
            finite = [w for w in words if w.lstrip("+-") not in _NON_FINITE_WORDS]
            if len(finite) < len(words) and all(
                parse_decimals(word, 1) for word in finite
            ):
                return " ".join(["nan"] * numbers.count)
        requirement = (
            "a decimal number"
            if numbers.count == 1
            else f"{numbers.count} decimal numbers"
        )
        raise ModelError(f"{where}={text!r:.60} is not {requirement}")
    for value in values:
        if abs(value) > numbers.max_magnitude:
            raise ModelError(
                f"{where} holds {value:g}; {numbers.max_magnitude:g} is the limit"
            )
        if value < 0 and not numbers.signed:
            raise ModelError(f"{where} holds {value:g}, which cannot be negative")
    if numbers.angles:
        right_angles = [round(2 * angle / math.pi) * math.pi / 2 for angle in values]
        # angles of rpy this close to a multiple of a right angle are rounded in the file [rad]
        values = [
            r if abs(a - r) <= 1e-5 else a
            for a, r in zip(values, right_angles, strict=True)
        ]
    return format_numbers(values)
