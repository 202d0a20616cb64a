"""A URDF file with other inertials and joint friction, and not another byte changed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from testbed.errors import ModelError
from testbed.robot.formats.urdf_xml import TENSOR
from testbed.robot.formats.xml_bytes import Element, XmlBytes, comment
from testbed.robot.inertia import Inertia
from testbed.robot.tree import Joint

_LOSSES = {"friction": "coulomb", "damping": "viscous"}
"""What a joint's <dynamics> states, by attribute."""


def edit_urdf(
    path: Path,
    links: Mapping[str, Inertia],
    joints: Mapping[str, tuple[Joint, Joint]],
    note: list[str],
) -> tuple[bytes, tuple[str, ...]]:
    """The file's bytes with other inertials and friction.

    Args:
        path: The file.
        links: New inertias about and along the links' frames, by link.
        joints: By name, as the file has them and as they are to be.
        note: Lines of a comment that says where the numbers come from.

    Returns:
        The bytes, and a line for what URDF has no place for.

    Raises:
        ModelError: The file cannot be edited; or a link has more than one inertial.
    """
    document = XmlBytes(path.read_bytes(), str(path))
    root = document.root
    document.insert(root, comment(note))
    elements = {each.attributes.get("name", ""): each for each in root.named("link")}
    for link, inertia in links.items():
        _set_inertial(document, elements[link], inertia, path)
    elements = {each.attributes.get("name", ""): each for each in root.named("joint")}
    for joint, (before, after) in joints.items():
        _set_losses(document, elements[joint], before, after)
    return document.edit(), tuple(_lost(joints.values()))


def _set_inertial(document: XmlBytes, link: Element, inertia: Inertia, path: Path) -> None:
    """The mass centre, the mass, and the inertia about it, along the link's axes."""
    said: dict[str, dict[str, str]] = {
        "origin": {"xyz": " ".join(repr(float(x)) for x in inertia.com), "rpy": "0 0 0"},
        "mass": {"value": repr(inertia.mass)},
        "inertia": {key: repr(float(inertia.central[at])) for key, at in TENSOR.items()},
    }
    there = link.named("inertial")
    if len(there) > 1:
        raise ModelError(f"{path}: link '{link.attributes.get('name')}' has two inertials")
    parts = {part: there[0].named(part) for part in said} if there else {}
    missing = []
    for part, values in said.items():
        if parts.get(part):
            document.set(parts[part][0], **values)
        else:
            listed = " ".join(f'{key}="{value}"' for key, value in values.items())
            missing.append(f"<{part} {listed}/>")
    if not there:
        document.insert(link, f"<inertial>{''.join(missing)}</inertial>")
    elif missing:
        document.insert(there[0], "".join(missing))


def _set_losses(document: XmlBytes, element: Element, before: Joint, after: Joint) -> None:
    """Friction and damping, where they have changed."""
    changed = {
        key: repr(float(getattr(after, what)))
        for key, what in _LOSSES.items()
        if getattr(after, what) != getattr(before, what)
    }
    there = element.named("dynamics")
    if changed and there:
        document.set(there[0], **changed)
    elif changed:
        listed = " ".join(f'{key}="{value}"' for key, value in changed.items())
        document.insert(element, f"<dynamics {listed}/>")


def _lost(joints: Iterable[tuple[Joint, Joint]]) -> Iterator[str]:
    """What URDF has no place for."""
    rotors = [
        f"{after.name} {after.rotor_inertia:.6g}"
        for before, after in joints
        if after.rotor_inertia != before.rotor_inertia
    ]
    if rotors:
        yield (
            f"URDF has no place for rotors' inertias ({', '.join(rotors)} kg m^2 or kg): what "
            "reads the file needs them as armature; MJCF has it"
        )
