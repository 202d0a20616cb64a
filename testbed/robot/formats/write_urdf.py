"""A URDF file with other inertials and joint friction, and not another byte changed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from testbed.diagnostics.diagnostic import Diagnostic, diagnose
from testbed.errors import ModelError
from testbed.robot.formats.urdf_xml import TENSOR
from testbed.robot.formats.xml_bytes import Element, XmlBytes, as_tag, comment
from testbed.robot.inertia import Inertia
from testbed.robot.parsing import plain

_LOSSES = {"friction": "coulomb", "damping": "viscous"}
"""What a joint's <dynamics> states, by attribute."""


def edit_urdf(
    path: Path,
    links: Mapping[str, Inertia],
    joints: Mapping[str, Mapping[str, float]],
    note: list[str],
) -> tuple[bytes, tuple[Diagnostic, ...]]:
    """The file's bytes with other inertials and friction; arguments are those of `edit_mjcf`.

    Returns:
        The bytes, and what URDF has no place for.

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
    for joint, losses in joints.items():
        dynamics = {key: plain([losses[what]]) for key, what in _LOSSES.items() if what in losses}
        if dynamics:
            document.put(elements[joint], "dynamics", **dynamics)
    rotors = [
        f"{joint} {losses['rotor_inertia']:.6g}"
        for joint, losses in joints.items()
        if "rotor_inertia" in losses
    ]
    if not rotors:
        return document.edit(), ()
    return document.edit(), (diagnose("model.rotors", ", ".join(rotors)),)


def _set_inertial(document: XmlBytes, link: Element, inertia: Inertia, path: Path) -> None:
    """The mass centre, the mass, and the inertia about it, along the link's axes."""
    parts = {
        "origin": {"xyz": plain(inertia.com), "rpy": "0 0 0"},
        "mass": {"value": plain([inertia.mass])},
        "inertia": {key: plain([inertia.central[at]]) for key, at in TENSOR.items()},
    }
    there = link.named("inertial")
    if len(there) > 1:
        raise ModelError(f"{path}: link '{link.attributes.get('name')}' has two inertials")
    if there:
        for part, values in parts.items():
            document.put(there[0], part, **values)
    else:
        inside = "".join(as_tag(part, values) for part, values in parts.items())
        document.insert(link, f"<inertial>{inside}</inertial>")
