"""Copies of an MJCF file with other inertials, friction, armatures and motors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import zip_longest
from pathlib import Path

import mujoco
import numpy as np

from testbed.bodies.xml_bytes import Element, XmlBytes, as_tag, comment
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import ModelError, few
from testbed.core.robot.formats.mjcf_compile import FULL
from testbed.core.robot.formats.mjcf_spec import commands_kept, parse
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.parsing import plain
from testbed.core.robot.repair import Edit

_TURNS = ("diaginertia", "quat", "axisangle", "xyaxes", "zaxis", "euler")
"""Other ways to say an inertia's axes."""
_LOSSES = {"frictionloss": "coulomb", "damping": "viscous", "armature": "rotor_inertia"}


def edit_mjcf(
    path: Path, changes: Iterable[Edit], note: list[str]
) -> Iterator[tuple[bytes, tuple[Diagnostic, ...]]]:
    """The file's bytes with other inertials, friction and armatures, once for each change.

    Args:
        path: The file.
        changes: Each makes another copy.
        note: Lines of a comment that says where the numbers come from.

    Yields:
        The bytes, and a line for what MuJoCo will make otherwise than they say.

    Raises:
        ModelError: The file cannot be edited: inertias are computed from geoms whatever
            inertials say, or bodies stand in other files or are copies.
    """
    spec = parse(path)
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
    world = document.root.named("worldbody")
    places = dict(_bodies(spec.worldbody, world, path))
    for change in changes:
        document.insert(document.root, comment(note))
        for name, inertia in change.links.items():
            document.put(places[name][0], "inertial", **_inertial(inertia))
        for _, own in places.values():
            for joint, element in own:
                values = change.joints.get(joint, {})
                said = {
                    k: plain([values[what]])
                    for k, what in _LOSSES.items()
                    if what in values
                }
                document.set(element, **said)
        kept = _set_motors(document, spec, change.gears, change.delay)
        yield document.edit(), (*_changed_by_compiler(spec, change.links), *kept)


def _set_motors(
    document: XmlBytes, spec: mujoco.MjSpec, gears: Mapping[str, float], delay: float
) -> tuple[Diagnostic, ...]:
    """Scale and delay joints' motors, add one where a joint has none; other actuators stay."""
    kept = str(commands_kept(delay, spec.option.timestep))
    late = (
        {"delay": plain([delay]), "nsample": kept, "interp": "linear"} if delay else {}
    )
    elements = [e for part in document.root.named("actuator") for e in part.children]
    driven, others = set(), []
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
        driven.add(joint)
        if element.tag == "motor":
            gear = [actuator.gear[0] * gears[joint], *actuator.gear[1:]]
            document.set(element, gear=plain(gear), **late)
        else:
            others.append(joint)
    motors = [
        as_tag(
            "motor",
            {"name": f"drive/{joint}", "joint": joint, "gear": plain([gear]), **late},
        )
        for joint, gear in gears.items()
        if joint not in driven
    ]
    if motors:
        document.insert(document.root, f"<actuator>{''.join(motors)}</actuator>")
    return (diagnose("model.actuators", few(others)),) if others else ()


_Joints = list[tuple[str, Element]]


def _bodies(
    body: mujoco.MjsBody, elements: list[Element], path: Path
) -> Iterator[tuple[str, tuple[Element, _Joints]]]:
    """By body below one, its element, and the elements of its joints."""
    inside = [each for element in elements for each in _within(element)]
    for own, element in zip_longest(
        body.bodies, [e for e in inside if e.tag == "body"]
    ):
        if (
            own is None
            or element is None
            or element.attributes.get("name", own.name) != own.name
        ):
            raise ModelError(
                f"{path}: the bodies in '{body.name}' are not those that stand in this file, one "
                "by one: <include>, <attach>, <replicate> or the like makes them; write into a "
                "file that holds them itself"
            )
        joints = [e for e in _within(element) if e.tag in ("joint", "freejoint")]
        if len(joints) != len(own.joints):
            raise ModelError(
                f"{path}: the joints of body '{own.name}' do not stand in this file"
            )
        yield (
            own.name,
            (element, list(zip((j.name for j in own.joints), joints, strict=True))),
        )
        yield from _bodies(own, [element], path)


def _within(element: Element) -> Iterator[Element]:
    """What stands in a body, frames being no bodies."""
    for child in element.children:
        if child.tag == "frame":
            yield from _within(child)
        else:
            yield child


def _inertial(inertia: Inertia) -> dict[str, str | None]:
    """The mass centre, the mass, and the inertia about it, along the body's axes."""
    central, others = inertia.central, dict.fromkeys(("fullinertia", *_TURNS))
    said = {"pos": plain(inertia.com), "mass": plain([inertia.mass]), **others}
    if central.any():
        return said | {"fullinertia": plain(central[at] for at in FULL)}
    return said | {"diaginertia": "0 0 0"}  # MuJoCo takes no full inertia that is zero


def _changed_by_compiler(
    spec: mujoco.MjSpec, links: Mapping[str, Inertia]
) -> Iterator[Diagnostic]:
    """Settings of the file's compiler that make other bodies of those that are written."""
    compiler = spec.compiler
    masses = {name: own.mass for name, own in links.items()}
    moments = {name: np.linalg.eigvalsh(own.central)[0] for name, own in links.items()}
    for setting, least, values in (
        ("boundmass", compiler.boundmass, masses),
        ("boundinertia", compiler.boundinertia, moments),
    ):
        light = [name for name, value in values.items() if value < least]
        if light:
            yield diagnose("model.compiler-bound", few(light), least, setting=setting)
    if compiler.balanceinertia:
        yield diagnose("model.balance")
