"""Copies of a URDF file with edited inertials and joint friction."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from testbed.bodies.xml_bytes import (
    XmlBytes,
    XmlElement,
    empty_element_tag,
    xml_comment,
)
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import ModelError
from testbed.core.robot.formats.urdf_xml import TENSOR_INDICES
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.parsing import format_numbers
from testbed.core.robot.repair import ModelEdit

_DYNAMICS_FIELDS = {"friction": "coulomb", "damping": "viscous"}
"""Field of a joint by attribute of its <dynamics> element."""


def edit_urdf(
    path: Path, changes: Iterable[ModelEdit], note: list[str]
) -> Iterator[tuple[bytes, tuple[Diagnostic, ...]]]:
    """Yield a copy of a URDF file's bytes with edited numbers for each change.

    Inertials and joint friction are edited.

    Args:
        path: URDF file.
        changes: Changes, one for each copy.
        note: Lines of a comment on the source of the numbers, which is inserted at the beginning of
            the root element.

    Yields:
        Bytes of the copy, and diagnostics of values that URDF cannot express: rotor inertias,
        torque ratios and the drives' delay.

    Raises:
        ModelError: The file is not XML or has a DOCTYPE, or a link has more than one inertial.
    """
    document = XmlBytes(path.read_bytes(), str(path))
    root = document.root
    elements = {
        each.attributes.get("name", ""): each for each in root.children_named("link")
    }
    joints = {
        each.attributes.get("name", ""): each for each in root.children_named("joint")
    }
    for change in changes:
        document.insert_text(root, xml_comment(note))
        for link, inertia in change.links.items():
            _set_inertial(document, elements[link], inertia, path)
        for joint, values in change.joints.items():
            attributes = {
                k: format_numbers([values[field]])
                for k, field in _DYNAMICS_FIELDS.items()
                if field in values
            }
            if attributes:
                document.set_child(joints[joint], "dynamics", **attributes)
        rotors = [
            f"{joint} {values['rotor_inertia']:.6g}"
            for joint, values in change.joints.items()
            if "rotor_inertia" in values
        ]
        losses = [make_diagnostic("model.rotors", ", ".join(rotors))] if rotors else []
        if change.torque_ratios:
            gears = ", ".join(
                f"{joint} {gear:.6g}" for joint, gear in change.torque_ratios.items()
            )
            losses.append(make_diagnostic("model.gears", gears))
        if change.delay:
            losses.append(make_diagnostic("model.delay", f"{change.delay:.4g} s"))
        yield document.apply_changes(), tuple(losses)


def _set_inertial(
    document: XmlBytes, link: XmlElement, inertia: Inertia, path: Path
) -> None:
    """Set a link's <inertial>: centre of mass, mass, and central inertia in the link's axes.

    Raises:
        ModelError: The link has more than one inertial.
    """
    central = inertia.central
    parts = {
        "origin": {"xyz": format_numbers(inertia.com), "rpy": "0 0 0"},
        "mass": {"value": format_numbers([inertia.mass])},
        "inertia": {
            key: format_numbers([central[at]]) for key, at in TENSOR_INDICES.items()
        },
    }
    inertials = link.children_named("inertial")
    if len(inertials) > 1:
        raise ModelError(
            f"{path}: link '{link.attributes.get('name')}' has two inertials"
        )
    if inertials:
        for part, values in parts.items():
            document.set_child(inertials[0], part, **values)
    else:
        content = "".join(
            empty_element_tag(part, values) for part, values in parts.items()
        )
        document.insert_text(link, f"<inertial>{content}</inertial>")
