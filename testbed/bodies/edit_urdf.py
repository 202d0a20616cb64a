"""Copies of a URDF file with other inertials and friction."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from testbed.bodies.xml_bytes import Element, XmlBytes, as_tag, comment
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import ModelError
from testbed.core.robot.formats.urdf_xml import TENSOR
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.parsing import plain
from testbed.core.robot.repair import Edit

_LOSSES = {"friction": "coulomb", "damping": "viscous"}
"""What a joint's <dynamics> states, by attribute."""


def edit_urdf(
    path: Path, changes: Iterable[Edit], note: list[str]
) -> Iterator[tuple[bytes, tuple[Diagnostic, ...]]]:
    """The file's bytes with other inertials and friction; arguments are those of `edit_mjcf`.

    Yields:
        The bytes, and what URDF has no place for.

    Raises:
        ModelError: The file cannot be edited; or a link has more than one inertial.
    """
    document = XmlBytes(path.read_bytes(), str(path))
    root = document.root
    elements = {each.attributes.get("name", ""): each for each in root.named("link")}
    jointed = {each.attributes.get("name", ""): each for each in root.named("joint")}
    for change in changes:
        document.insert(root, comment(note))
        for link, inertia in change.links.items():
            _set_inertial(document, elements[link], inertia, path)
        for joint, values in change.joints.items():
            said = {
                k: plain([values[what]])
                for k, what in _LOSSES.items()
                if what in values
            }
            if said:
                document.put(jointed[joint], "dynamics", **said)
        rotors = [
            f"{joint} {values['rotor_inertia']:.6g}"
            for joint, values in change.joints.items()
            if "rotor_inertia" in values
        ]
        lost = [diagnose("model.rotors", ", ".join(rotors))] if rotors else []
        if change.gears:
            gears = ", ".join(
                f"{joint} {gear:.6g}" for joint, gear in change.gears.items()
            )
            lost.append(diagnose("model.gears", gears))
        if change.delay:
            lost.append(diagnose("model.delay", f"{change.delay:.4g} s"))
        yield document.edit(), tuple(lost)


def _set_inertial(
    document: XmlBytes, link: Element, inertia: Inertia, path: Path
) -> None:
    """The mass centre, the mass, and the inertia about it, along the link's axes."""
    central = inertia.central
    parts = {
        "origin": {"xyz": plain(inertia.com), "rpy": "0 0 0"},
        "mass": {"value": plain([inertia.mass])},
        "inertia": {key: plain([central[at]]) for key, at in TENSOR.items()},
    }
    there = link.named("inertial")
    if len(there) > 1:
        raise ModelError(
            f"{path}: link '{link.attributes.get('name')}' has two inertials"
        )
    if there:
        for part, values in parts.items():
            document.put(there[0], part, **values)
    else:
        inside = "".join(as_tag(part, values) for part, values in parts.items())
        document.insert(link, f"<inertial>{inside}</inertial>")
