"""An MJCF file as MuJoCo's editable model: checked, reduced to its mechanism, joints held.

MuJoCo's compiler resolves classes, frames, includes and inertias implied by geoms.
"""

from __future__ import annotations

from pathlib import Path

import mujoco

from testbed.errors import FreeRootError, ModelError
from testbed.robot.formats.mjcf_compile import no_mujoco_warnings, one_line, resolved
from testbed.robot.formats.mjcf_lock import followers, hold_joints
from testbed.robot.formats.mjcf_passive import drop_passive_forces
from testbed.robot.formats.mjcf_xml import check_files
from testbed.robot.locks import Lock

_SUPPORTED = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
_PLATE = (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE)


def open_spec(
    path: Path, *, weld_root: bool = False, lock: Lock | None = None
) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """The editable MuJoCo model of an MJCF file: its mechanism, checked for what is supported.

    Args:
        path: The file.
        weld_root: Weld a floating root to the bedplate instead of refusing it.
        lock: Joints to be held, which are taken out, their bodies posed.

    Returns:
        The model, and a line for each thing that was accepted with a warning.

    Raises:
        ModelError: The file is not MJCF, or holds what is not supported; FreeRootError for a
            floating root, MimicError for a joint that follows another that moves.
        UnknownName: A joint to be held is not there.
    """
    spec = parsed(path)
    spec.compiler.fusestatic = False  # fused bodies would lose what their links weigh
    _set_total_mass(spec, path)
    _strip(spec)
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE and joint.parent.parent.name == "world":
            if not weld_root:
                raise FreeRootError(path.name, joint.name or joint.parent.name)
            spec.delete(joint)
        elif joint.type not in _SUPPORTED:
            kind = joint.type.name.removeprefix("mjJNT_").lower()
            raise ModelError(
                f"{path}: joint '{joint.name or joint.parent.name}' is of type '{kind}', which is "
                "not supported (supported: hinge, slide)"
            )
    notes = hold_joints(spec, lock or {}, path)
    return spec, (*notes, *drop_passive_forces(spec, path))


def follower_names(path: Path) -> tuple[str, ...]:
    """The joints of an MJCF file that follow others that move."""
    return followers(parsed(path))


def parsed(path: Path) -> mujoco.MjSpec:
    """The file as MuJoCo's parser takes it, everything named.

    Raises:
        ModelError: MuJoCo does not take it.
    """
    check_files(path)
    if path.suffix != ".xml":
        raise ModelError(f"{path}: MuJoCo reads MJCF from files that end in .xml; rename it")
    with no_mujoco_warnings():
        try:
            spec = mujoco.MjSpec.from_file(str(path))
        except Exception as error:  # MuJoCo raises ValueError and its own FatalError
            raise ModelError(f"{path}: not a valid MJCF: {one_line(error)}") from None
    _name_everything(spec)
    _release_mocap(spec)
    return spec


def _set_total_mass(spec: mujoco.MjSpec, path: Path) -> None:
    """Scale all bodies to the total mass that the file wants, as MuJoCo's compiler would last."""
    wanted = spec.compiler.settotalmass
    if not wanted > 0:
        return
    spec.compiler.settotalmass = -1.0
    model, stated = resolved(spec, path)
    masses = {name: float(model.body(name).mass[0]) for name in (b.name for b in spec.bodies)}
    factor = wanted / sum((masses | {n: body.mass for n, body in stated.items()}).values())
    for body in spec.bodies:
        body.mass, body.inertia = factor * body.mass, factor * body.inertia
        body.fullinertia = factor * body.fullinertia
    for geom in spec.geoms:
        geom.mass, geom.density = factor * geom.mass, factor * geom.density


def _release_mocap(spec: mujoco.MjSpec) -> None:
    """Take out what welds a robot to bodies that a program moves: these drive it, as motors do."""
    moved = {body.name for body in spec.bodies if body.mocap}
    for equality in list(spec.equalities):
        if equality.objtype == mujoco.mjtObj.mjOBJ_BODY and moved & {
            equality.name1,
            equality.name2,
        }:
            spec.delete(equality)
    for body in spec.bodies:
        body.mocap = False


def _name_everything(spec: mujoco.MjSpec) -> None:
    """Names are optional in MJCF, and everything here is told apart by name."""
    taken = {body.name for body in spec.bodies} | {joint.name for joint in spec.joints}
    for k, body in enumerate(spec.bodies):
        if not body.name:
            body.name = next(n for i in range(len(taken) + 1) if (n := f"body{k + i}") not in taken)
            taken.add(body.name)
    for k, joint in enumerate(spec.joints):
        if not joint.name:
            near = f"{joint.parent.name}_joint"
            joint.name = near if near not in taken else f"{near}{k}"
            taken.add(joint.name)


def _strip(spec: mujoco.MjSpec) -> None:
    """Leave the mechanism and the plate's sensors: no drives, postures, textures, memory."""
    for elements in (spec.actuators, spec.keys, spec.tuples, spec.pairs, spec.skins):
        for element in list(elements):
            spec.delete(element)
    for sensor in list(spec.sensors):
        if sensor.type not in _PLATE:
            spec.delete(sensor)
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_HFIELD:
            spec.delete(geom)
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for assets in (spec.hfields, spec.textures):
        for asset in list(assets):
            spec.delete(asset)
    spec.memory = spec.njmax = spec.nconmax = -1
    spec.nuserdata = spec.nkey = 0
    for body in spec.bodies:
        body.mocap = False  # nobody moves it: it stands still
