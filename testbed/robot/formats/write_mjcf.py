"""An MJCF file with other inertials, joint losses and armatures, and not another byte changed.

Bodies and joints are found where MuJoCo's parser has them, one beside the other through the
whole tree: names are optional, and frames, classes and defaults may stand between.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import zip_longest
from pathlib import Path

import mujoco
import numpy as np

from testbed.diagnostics.diagnostic import Diagnostic, diagnose
from testbed.errors import ModelError, few
from testbed.robot.formats.mjcf_compile import FULL
from testbed.robot.formats.mjcf_spec import parse
from testbed.robot.formats.xml_bytes import Element, XmlBytes, comment
from testbed.robot.inertia import Inertia
from testbed.robot.parsing import plain

_TURNS = ("diaginertia", "quat", "axisangle", "xyaxes", "zaxis", "euler")
"""Other ways to say an inertia's axes."""
_LOSSES = {"frictionloss": "coulomb", "damping": "viscous", "armature": "rotor_inertia"}


def edit_mjcf(
    path: Path,
    links: Mapping[str, Inertia],
    joints: Mapping[str, Mapping[str, float]],
    note: list[str],
) -> tuple[bytes, tuple[Diagnostic, ...]]:
    """The file's bytes with other inertials, friction and armatures.

    Args:
        path: The file.
        links: New inertias about and along the bodies' frames, by body.
        joints: By name, friction and rotor inertia where they have changed.
        note: Lines of a comment that says where the numbers come from.

    Returns:
        The bytes, and a line for what MuJoCo will make otherwise than they say.

    Raises:
        ModelError: The file cannot be edited: inertias are computed from geoms whatever
            inertials say, or bodies stand in other files or are copies.
    """
    spec = parse(path)
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
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
    document.insert(document.root, comment(note))
    world = document.root.named("worldbody")
    places = dict(_bodies(spec.worldbody, world, path))
    for name, inertia in links.items():
        document.put(places[name][0], "inertial", **_inertial(inertia))
    for _, own in places.values():
        for joint, element in own:
            losses = joints.get(joint, {})
            said = {key: plain([losses[what]]) for key, what in _LOSSES.items() if what in losses}
            document.set(element, **said)
    return document.edit(), tuple(_changed_by_compiler(spec, links))


_Joints = list[tuple[str, Element]]


def _bodies(
    body: mujoco.MjsBody, elements: list[Element], path: Path
) -> Iterator[tuple[str, tuple[Element, _Joints]]]:
    """By body below one, its element, and the elements of its joints."""
    inside = [each for element in elements for each in _within(element)]
    for own, element in zip_longest(body.bodies, [e for e in inside if e.tag == "body"]):
        if own is None or element is None or element.attributes.get("name", own.name) != own.name:
            raise ModelError(
                f"{path}: the bodies in '{body.name}' are not those that stand in this file, one "
                "by one: <include>, <attach>, <replicate> or the like makes them; write into a "
                "file that holds them itself"
            )
        joints = [e for e in _within(element) if e.tag in ("joint", "freejoint")]
        if len(joints) != len(own.joints):
            raise ModelError(f"{path}: the joints of body '{own.name}' do not stand in this file")
        yield own.name, (element, list(zip((j.name for j in own.joints), joints, strict=True)))
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


def _changed_by_compiler(spec: mujoco.MjSpec, links: Mapping[str, Inertia]) -> Iterator[Diagnostic]:
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
