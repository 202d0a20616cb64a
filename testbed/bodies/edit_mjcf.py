"""Copies of an MJCF file with edited inertials, friction, armatures and motors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import zip_longest
from pathlib import Path

import mujoco
import numpy as np

from testbed.bodies.xml_bytes import (
    XmlBytes,
    XmlElement,
    empty_element_tag,
    xml_comment,
)
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import ModelError, shortened_list
from testbed.core.robot.formats.mjcf_compile import FULLINERTIA_ENTRIES
from testbed.core.robot.formats.mjcf_spec import buffered_command_count, parse_mjcf
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.parsing import format_numbers
from testbed.core.robot.repair import ModelEdit

_INERTIA_AXES = ("diaginertia", "quat", "axisangle", "xyaxes", "zaxis", "euler")
"""Attributes of <inertial> that `fullinertia` replaces."""
_JOINT_FIELDS = {
    "frictionloss": "coulomb",
    "damping": "viscous",
    "armature": "rotor_inertia",
}


def edit_mjcf(
    path: Path, changes: Iterable[ModelEdit], note: list[str]
) -> Iterator[tuple[bytes, tuple[Diagnostic, ...]]]:
    """Yield a copy of an MJCF file's bytes with edited numbers for each change.

    Inertials, friction, armatures and motors are edited.

    Args:
        path: MJCF file.
        changes: Changes, one for each copy.
        note: Lines of a comment on the source of the numbers, which is inserted at the beginning of
            the root element.

    Yields:
        Bytes of the copy, and diagnostics of masses or moments of inertia below the compiler's
        boundmass or boundinertia, of balanceinertia, and of actuators that are not motors.

    Raises:
        ModelError: The file cannot be edited, because MuJoCo computes inertias from geoms or scales
            masses, or because bodies, joints or actuators come from other files or are generated
            copies.
    """
    spec = parse_mjcf(path)
    if (
        spec.compiler.inertiafromgeom
        == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    ):
        raise ModelError(
            f'{path}: compiler inertiafromgeom="true" makes MuJoCo pass over all inertials; set it '
            'to "auto" and write again'
        )
    if spec.compiler.settotalmass > 0:
        raise ModelError(
            f"{path}: compiler settotalmass scales all masses that are written; scale them in the "
            "file and take it out"
        )
    document = XmlBytes(path.read_bytes(), str(path))
    world = document.root.children_named("worldbody")
    body_elements = dict(_body_elements(spec.worldbody, world, path))
    for change in changes:
        document.insert_text(document.root, xml_comment(note))
        for name, inertia in change.links.items():
            document.set_child(
                body_elements[name][0], "inertial", **_inertial_attributes(inertia)
            )
        for _, joint_elements in body_elements.values():
            for joint, element in joint_elements:
                values = change.joints.get(joint, {})
                attributes = {
                    k: format_numbers([values[field]])
                    for k, field in _JOINT_FIELDS.items()
                    if field in values
                }
                document.set_attributes(element, **attributes)
        motor_diagnostics = _set_motors(
            document, spec, change.torque_ratios, change.delay
        )
        yield (
            document.apply_changes(),
            (*_compiler_changes(spec, change.links), *motor_diagnostics),
        )


def _set_motors(
    document: XmlBytes, spec: mujoco.MjSpec, gears: Mapping[str, float], delay: float
) -> tuple[Diagnostic, ...]:
    """Scale and delay the motors of joints; add a motor to joints without an actuator.

    Position servos and other actuators are not changed.

    Args:
        document: MJCF file to change.
        spec: MuJoCo's specification of the file.
        gears: Factors on the gears of the motors, keyed by joint; an added motor has the factor as
            its gear. Other joints are unchanged.
        delay: Delay from a command to its torque for the motors of these joints [s].

    Returns:
        A diagnostic of joints whose actuators are not motors; empty if there are no such joints.

    Raises:
        ModelError: Actuators come from other files or are generated copies.
    """
    buffer_size = str(buffered_command_count(delay, spec.option.timestep))
    delay_attributes = (
        {"delay": format_numbers([delay]), "nsample": buffer_size, "interp": "linear"}
        if delay
        else {}
    )
    elements = [
        e for part in document.root.children_named("actuator") for e in part.children
    ]
    driven_joints, other_joints = set(), []
    if gears and len(spec.actuators) != len(elements):
        raise ModelError(
            "the actuators do not stand in this file, one by one; write without gears"
        )
    for actuator, element in (
        zip(spec.actuators, elements, strict=True) if gears else ()
    ):
        joint = actuator.target
        if actuator.trntype != mujoco.mjtTrn.mjTRN_JOINT or joint not in gears:
            continue
        driven_joints.add(joint)
        if element.tag == "motor":
            gear = [actuator.gear[0] * gears[joint], *actuator.gear[1:]]
            document.set_attributes(
                element, gear=format_numbers(gear), **delay_attributes
            )
        else:
            other_joints.append(joint)
    motors = [
        empty_element_tag(
            "motor",
            {
                "name": f"drive/{joint}",
                "joint": joint,
                "gear": format_numbers([gear]),
                **delay_attributes,
            },
        )
        for joint, gear in gears.items()
        if joint not in driven_joints
    ]
    if motors:
        document.insert_text(document.root, f"<actuator>{''.join(motors)}</actuator>")
    return (
        (make_diagnostic("model.actuators", shortened_list(other_joints)),)
        if other_joints
        else ()
    )


_Joints = list[tuple[str, XmlElement]]


def _body_elements(
    body: mujoco.MjsBody, elements: list[XmlElement], path: Path
) -> Iterator[tuple[str, tuple[XmlElement, _Joints]]]:
    """Yield name, XML element and named joint elements of each body below a body.

    Parents come before children.

    Args:
        body: Body in MuJoCo's specification.
        elements: Elements that contain the child bodies.
        path: MJCF file, for messages.

    Raises:
        ModelError: Bodies or joints come from other files or are generated copies.
    """
    child_elements = [
        each for element in elements for each in _children_through_frames(element)
    ]
    for child, element in zip_longest(
        body.bodies, [e for e in child_elements if e.tag == "body"]
    ):
        if (
            child is None
            or element is None
            or element.attributes.get("name", child.name) != child.name
        ):
            raise ModelError(
                f"{path}: the bodies in '{body.name}' are not those that stand in this file, one "
                "by one: <include>, <attach>, <replicate> or the like makes them; write into a "
                "file that holds them itself"
            )
        joints = [
            e
            for e in _children_through_frames(element)
            if e.tag in ("joint", "freejoint")
        ]
        if len(joints) != len(child.joints):
            raise ModelError(
                f"{path}: the joints of body '{child.name}' do not stand in this file"
            )
        yield (
            child.name,
            (element, list(zip((j.name for j in child.joints), joints, strict=True))),
        )
        yield from _body_elements(child, [element], path)


def _children_through_frames(element: XmlElement) -> Iterator[XmlElement]:
    """Child elements of a body, including children of <frame> elements."""
    for child in element.children:
        if child.tag == "frame":
            yield from _children_through_frames(child)
        else:
            yield child


def _inertial_attributes(inertia: Inertia) -> dict[str, str | None]:
    """Attributes of <inertial>: centre of mass, mass, and central inertia in the body's axes.

    Attributes of other representations of the inertia are None, so that they are removed.
    """
    central, others = inertia.central, dict.fromkeys(("fullinertia", *_INERTIA_AXES))
    attributes = {
        "pos": format_numbers(inertia.com),
        "mass": format_numbers([inertia.mass]),
        **others,
    }
    if central.any():
        return attributes | {
            "fullinertia": format_numbers(central[at] for at in FULLINERTIA_ENTRIES)
        }
    return attributes | {
        "diaginertia": "0 0 0"
    }  # MuJoCo rejects a fullinertia of zeros


def _compiler_changes(
    spec: mujoco.MjSpec, links: Mapping[str, Inertia]
) -> Iterator[Diagnostic]:
    """Diagnostics of compiler settings that affect the written masses or inertias.

    Reported are masses below boundmass and principal moments of inertia below boundinertia, which
    MuJoCo increases, and balanceinertia, which no longer has an effect.
    """
    compiler = spec.compiler
    masses = {name: inertia.mass for name, inertia in links.items()}
    moments = {
        name: np.linalg.eigvalsh(inertia.central)[0] for name, inertia in links.items()
    }
    for setting, bound, values in (
        ("boundmass", compiler.boundmass, masses),
        ("boundinertia", compiler.boundinertia, moments),
    ):
        names = [name for name, value in values.items() if value < bound]
        if names:
            yield make_diagnostic(
                "model.compiler-bound", shortened_list(names), bound, setting=setting
            )
    if compiler.balanceinertia:
        yield make_diagnostic("model.balance")
