"""A URDF file's XML, made fit for any parser: checked, of plain numbers, locked joints fixed.

What parsers pass over in silence is found here: loops, links that hang nowhere, floating and planar
joints, misspelled elements. urdfdom drops a whole inertial whose mass is "3 " and says so only on
standard error; other parsers take other texts. What is no plain number is refused, and what is one
is written as every parser takes it, so that Pinocchio and MuJoCo read the same numbers.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import ModelError, few, quoted
from testbed.core.base.transform import Transform
from testbed.core.robot.inertia import HEAVIEST
from testbed.core.robot.locks import Coupling, Lock, Travel, lock_positions
from testbed.core.robot.parsing import decimals, errors_of, plain, read_xml
from testbed.core.robot.refusals import FreeRootError
from testbed.core.robot.rotations import displacement, from_rpy, to_rpy
from testbed.core.robot.tree import FARTHEST, UNIT, ModelSource

DEEPEST_LINKS = 1_500
"""Links in a row: Pinocchio's parser overflows its stack between 2000 and 4000."""
_MOVING = ("revolute", "continuous", "prismatic")
_SUPPORTED = (*_MOVING, "fixed")
_PARTS: dict[str, tuple[str, ...]] = {
    "robot": ("link", "joint"),
    "link": ("inertial",),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
}
"""What counts of an element."""
_BESIDE: dict[str, tuple[str, ...]] = {
    "robot": ("material", "transmission", "gazebo", "sensor", "ros2_control", "mujoco"),
    "link": ("visual", "collision"),
    "joint": ("safety_controller", "calibration"),
}
"""What is for simulators, drawings and drives."""

TENSOR = {
    "ixx": (0, 0),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyy": (1, 1),
    "iyz": (1, 2),
    "izz": (2, 2),
}
"""Entries of an inertia, by attribute."""


@dataclass(frozen=True)
class _Numbers:
    """What an attribute holds.

    Attributes:
        count: So many numbers.
        absent: What it is where it is not given; None where it must be.
        greatest: Magnitude that none of them exceeds.
        signed: Whether they may be negative.
        angles: Whether right angles are meant where they nearly are.
    """

    count: int
    absent: str | None
    greatest: float = float("inf")
    signed: bool = True
    angles: bool = False


_PLACE = {
    "xyz": _Numbers(3, "0 0 0", FARTHEST),
    "rpy": _Numbers(3, "0 0 0", FARTHEST, angles=True),
}
_ATTRIBUTES = {
    "origin": _PLACE,
    "axis": {"xyz": _Numbers(3, "1 0 0", FARTHEST)},
    "mass": {"value": _Numbers(1, None, HEAVIEST)},
    "inertia": {key: _Numbers(1, None, HEAVIEST) for key in TENSOR},
    "limit": {
        **{key: _Numbers(1, "0") for key in ("lower", "upper")},
        **{key: _Numbers(1, "0", signed=False) for key in ("effort", "velocity")},
    },
    "dynamics": {
        "damping": _Numbers(1, "0"),
        "friction": _Numbers(1, "0", signed=False),
    },
    "mimic": {"multiplier": _Numbers(1, "1"), "offset": _Numbers(1, "0")},
    "box": {"size": _Numbers(3, None, FARTHEST)},
    "sphere": {"radius": _Numbers(1, None, FARTHEST)},
    "cylinder": {key: _Numbers(1, None, FARTHEST) for key in ("radius", "length")},
    "capsule": {key: _Numbers(1, None, FARTHEST) for key in ("radius", "length")},
    "mesh": {"scale": _Numbers(3, "1 1 1", FARTHEST)},
    "color": {"rgba": _Numbers(4, None, 1.0)},
}
_TEXTS: dict[str, tuple[str, ...]] = {
    "robot": ("name", "version"),
    "link": ("name",),
    "joint": ("name", "type"),
    "parent": ("link",),
    "child": ("link",),
    "mimic": ("joint",),
}
"""Attributes that hold no numbers."""
_NO_NUMBERS = ("nan", "inf", "infinity")


def supported_xml(
    file: ModelSource, *, keep_visuals: bool = False
) -> tuple[ET.Element, tuple[Diagnostic, ...]]:
    """The file's links and joints, checked for what is supported; held joints become fixed ones.

    Args:
        file: The file, and how to read it; errors are those of `load_tree`.
        keep_visuals: Keep what is to be seen.

    Returns:
        The root element, and what was accepted although it is wrong.
    """
    root, said = _checked(file.path, file.weld_root, keep_visuals)
    return root, (*said, *_hold(root.findall("joint"), file.lock, file.path))


def _checked(
    path: Path, weld_root: bool, keep_visuals: bool = False
) -> tuple[ET.Element, list[Diagnostic]]:
    """Links and joints alone, in one tree, their numbers plain; and what is wrong and accepted."""
    root = read_xml(path)
    root.set("name", root.get("name") or path.stem)  # parsers want one
    links, joints = root.findall("link"), root.findall("joint")
    shown = root.findall("material") if keep_visuals else []
    with errors_of(path):
        said = [each for part in root.iter() for each in _accepted(part)]
        ignored = dict([*_keep(root, "", ("visual",) if keep_visuals else ())][::-1])
        if ignored:
            owners = [f"{name} of {owner}" for name, owner in ignored.items()]
            said.append(diagnose("model.ignored", few(owners[::-1]), file=path.name))
        root[:] = [*shown, *links, *joints]
        carriers = _carriers(links, joints)
        for joint in joints:
            if (
                joint.get("type") == "floating"
                and link_at(joint, "parent") not in carriers
            ):
                if not weld_root:
                    raise FreeRootError(path.name, joint.get("name", "?"))
                joint.set("type", "fixed")
            _check_joint(joint)
        for link in links:
            for inertial in link.findall("inertial"):
                rewrite_numbers(inertial, f"link '{link.get('name')}'", allow_nan=True)
    return root, said


def _check_joint(joint: ET.Element) -> None:
    """Whether a joint is supported, its numbers made plain."""
    name, kind = f"joint '{joint.get('name')}'", joint.get("type", "?")
    if kind not in _SUPPORTED:
        raise ModelError(
            f"{name} is of type '{kind:.40}', which is not supported (supported: "
            f"{', '.join(_SUPPORTED)})"
        )
    rewrite_numbers(joint, name)
    axis = numbers_of(joint.find("axis"), "xyz", "1 0 0")
    if kind != "fixed" and max(np.abs(axis)) < UNIT:
        raise ModelError(f"{name} has no direction: its <axis> xyz is {axis}")
    if not all(mimic.get("joint") for mimic in joint.findall("mimic")):
        raise ModelError(f"{name}: <mimic> names no joint")


def _accepted(element: ET.Element) -> Iterator[Diagnostic]:
    """Of several places the first, as URDF's own parser takes it; friction that drives is none."""
    name = f"{element.tag} '{element.get('name', '')}'"
    for part in (
        (element, *element.findall("inertial")) if element.tag in _PARTS else ()
    ):
        for more in part.findall("origin")[1:]:
            part.remove(more)
            yield diagnose("model.origins", name)
    for dynamics in element.findall("dynamics"):
        found = decimals(dynamics.get("friction", "0"), 1)
        if found and found[0] < 0:
            dynamics.set("friction", "0")
            yield diagnose("model.negative-friction", name, found[0])


def travels(path: Path) -> dict[str, Travel]:
    """Range and coupling of every joint of a URDF file that moves, by name."""
    root, _ = _checked(path, weld_root=True)
    return _travels(root.findall("joint"))


def _travels(joints: list[ET.Element]) -> dict[str, Travel]:
    """How the joints of a checked file move, by name; fixed ones do not."""
    moving = {
        joint.get("name", ""): joint for joint in joints if joint.get("type") in _MOVING
    }
    fixed = {joint.get("name", "") for joint in joints} - moving.keys()
    travels = {}
    for name, joint in moving.items():
        low, high = -np.inf, np.inf
        limit, mimic = joint.find("limit"), joint.find("mimic")
        if limit is not None and joint.get("type") != "continuous":
            ends = *numbers_of(limit, "lower"), *numbers_of(limit, "upper")
            low, high = ends if any(ends) else (low, high)  # zeros: not known
        coupling = None
        if mimic is not None:
            master = mimic.get("joint", "")
            offset, slope = (
                *numbers_of(mimic, "offset"),
                *numbers_of(mimic, "multiplier", "1"),
            )
            coupling = Coupling(master, (offset, slope))
            if master in fixed:
                coupling = Coupling(None, (offset,))
        travels[name] = Travel(low, high, coupling)
    return travels


def _hold(joints: list[ET.Element], lock: Lock, path: Path) -> tuple[Diagnostic, ...]:
    """Make locked joints fixed ones, in the place where they are held."""
    held, said = lock_positions(_travels(joints), lock, path.name)
    for joint in joints:
        name = joint.get("name", "")
        if name in held:
            if held[name]:
                _move_origin(joint, held[name])
            joint.set("type", "fixed")
        if joint.get("type") == "fixed":
            for part in list(joint):
                if part.tag in ("axis", "limit", "dynamics", "mimic"):
                    joint.remove(part)
        elif joint.get("type") != "continuous" and joint.find("limit") is None:
            zeros = dict.fromkeys(("lower", "upper", "effort", "velocity"), "0")
            ET.SubElement(joint, "limit", zeros)  # parsers want one; zeros: not known
    return said


def _move_origin(joint: ET.Element, position: float) -> None:
    """Turn or shift a joint's origin by the joint's own motion."""
    origin = joint.find("origin")
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    axis = np.array(numbers_of(joint.find("axis"), "xyz", "1 0 0"))
    axis /= np.linalg.norm(axis)
    rpy, xyz = (np.array(numbers_of(origin, key, "0 0 0")) for key in ("rpy", "xyz"))
    X_PB = Transform(from_rpy(rpy), xyz) @ displacement(
        axis, position, revolute=joint.get("type") != "prismatic"
    )
    origin.set("xyz", plain(X_PB.p_AB_A))
    origin.set("rpy", plain(to_rpy(X_PB.R_AB)))


def _keep(
    element: ET.Element, owner: str, also: tuple[str, ...]
) -> Iterator[tuple[str, str]]:
    """Remove unknown elements; yields unknown elements and attributes, and their owners."""
    tag, tags = element.tag, [child.tag for child in element]
    owner = f"{tag} '{element.get('name', '?')}'" if tag in _BESIDE else owner
    parts, beside = _PARTS.get(tag, ()), _BESIDE.get(tag, ())
    attributes = (*_ATTRIBUTES.get(tag, ()), *_TEXTS.get(tag, ()))
    keys = [key for key in element.attrib if not key.startswith("xmlns")]
    for names, known in ((tags, parts), (keys, attributes)):
        for name in sorted({*names} - {*known, *beside}):
            near = get_close_matches(name.lower(), {*known} - {*names}, n=1, cutoff=0.8)
            if near and near[0] not in name:  # a longer name is another one
                said = (
                    f"<{tag}> holds the unknown {name!r:.40}; did you mean {near[0]}?"
                )
                raise ModelError(f"{owner}: {said}")
            yield f"'{name:.40}' in <{tag}>", owner
    element[:] = [child for child in element if child.tag in (*parts, *also)]
    for child in element:
        if tag != "robot" and tags.count(child.tag) > 1 and child.tag in parts:
            raise ModelError(f"{owner} has more than one <{child.tag}>")
        if child.tag in parts:
            yield from _keep(child, owner, also)


def _carriers(
    links: list[ET.Element], joints: list[ET.Element]
) -> dict[str, ET.Element]:
    """The joint that carries each link; the links hang together as one tree."""
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
        name, child = joint.get("name", ""), link_at(joint, "child")
        for end in ("parent", "child"):
            if link_at(joint, end) not in known:
                raise ModelError(
                    f"joint '{name}' has no {end} link '{link_at(joint, end)}'"
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
    """Whether all links hang on one root, and not too deep: parsers recurse along them."""
    roots = [name for name in known if name not in carriers]
    below: dict[str, list[str]] = {}
    for child, joint in carriers.items():
        below.setdefault(link_at(joint, "parent"), []).append(child)
    reached, level, depth = set(roots), roots, 0
    while level:
        level = [child for link in level for child in below.get(link, [])]
        reached.update(level)
        depth += 1
        if depth > DEEPEST_LINKS:
            raise ModelError(f"a chain of more than {DEEPEST_LINKS} links")
    if len(reached) < len(known):
        lost = min(known - reached)
        raise ModelError(
            f"link '{lost}' hangs on no root; its chain of joints is a closed loop"
        )
    if len(roots) > 1:
        raise ModelError(
            f"{len(roots)} links are carried by no joint ({quoted(sorted(roots))}); a robot "
            "has one such"
        )


def link_at(joint: ET.Element, end: str) -> str:
    """The link at an end of a joint, "parent" or "child"; "" if none is said."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def rewrite_numbers(owner: ET.Element, where: str, *, allow_nan: bool = False) -> None:
    """Read the numbers of an element's parts strictly, and write them plainly.

    Args:
        owner: A joint or an inertial; its parts are changed.
        where: Owner, for messages.
        allow_nan: Leave texts like "nan" as NaN: an inertia that is none is refused as such.

    Raises:
        ModelError: Names the attribute that holds something else.
    """
    for part in owner:
        for key, numbers in _ATTRIBUTES.get(part.tag, {}).items():
            text = part.get(key, numbers.absent)
            if text is None:
                raise ModelError(f"{where}: <{part.tag}> has no {key}")
            part.set(
                key, _plain(text, numbers, f"{where}: <{part.tag}> {key}", allow_nan)
            )


def numbers_of(element: ET.Element | None, key: str, absent: str = "0") -> list[float]:
    """The numbers of an attribute that has been rewritten."""
    text = absent if element is None else element.get(key, absent)
    return [float(word) for word in text.split()]


def _plain(text: str, numbers: _Numbers, where: str, allow_nan: bool) -> str:
    values = decimals(text, numbers.count)
    if values is None:
        words = text.lower().split()
        if allow_nan and len(words) == numbers.count:
            finite = [w for w in words if w.lstrip("+-") not in _NO_NUMBERS]
            if len(finite) < len(words) and all(decimals(word, 1) for word in finite):
                return " ".join(["nan"] * numbers.count)
        wanted = (
            "a decimal number"
            if numbers.count == 1
            else f"{numbers.count} decimal numbers"
        )
        raise ModelError(f"{where}={text!r:.60} is not {wanted}")
    for value in values:
        if abs(value) > numbers.greatest:
            raise ModelError(
                f"{where} holds {value:g}; {numbers.greatest:g} is the limit"
            )
        if value < 0 and not numbers.signed:
            raise ModelError(f"{where} holds {value:g}, which cannot be negative")
    if numbers.angles:
        right = [round(2 * angle / math.pi) * math.pi / 2 for angle in values]
        # angles of rpy so near a multiple of a right angle are one, rounded in the file [rad]
        values = [
            r if abs(a - r) <= 1e-5 else a for a, r in zip(values, right, strict=True)
        ]
    return plain(values)
