"""MJCF -> Tree, through MuJoCo: the other of two independent roads.

Bodies without joints are merged into those that carry them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import ModelError
from testbed.core.base.transform import Transform
from testbed.core.robot.formats.mjcf_compile import (
    MASSLESS,
    StatedInertia,
    compile_spec,
    set_inertia,
    stated_inertias,
)
from testbed.core.robot.formats.mjcf_spec import VELOCITY_LIMIT, open_spec, parse
from testbed.core.robot.inertia import NOTHING, Inertia
from testbed.core.robot.locks import Lock
from testbed.core.robot.repair import Bodies, FileLink, Repair, repaired
from testbed.core.robot.rotations import from_vector
from testbed.core.robot.tree import FARTHEST, Joint, Kind, Tree

_KINDS: dict[int, Kind] = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "revolute",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
}


def read_mjcf(
    path: Path,
    *,
    weld_root: bool = False,
    repair: Bodies | None = None,
    lock: Lock | None = None,
) -> Tree:
    """The tree of an MJCF file; the bedplate frame is MuJoCo's world frame.

    Arguments and errors are those of `load_tree`.
    """
    found = repaired_spec(path, weld_root=weld_root, repair=repair, lock=lock)
    model = compile_spec(found.spec, path)
    for k in range(model.nnumeric):
        name = model.numeric(k).name
        joint = name.removeprefix(VELOCITY_LIMIT)
        if joint != name and not _has(model, mujoco.mjtObj.mjOBJ_JOINT, joint):
            raise ModelError(f"{path}: <numeric name='{name}'> names no joint")
    said = (*found.repair.diagnostics, *found.diagnostics)
    return _tree_of(model, found.stated, said)


@dataclass(frozen=True, eq=False)
class RepairedSpec:
    """MuJoCo's editable model of a file, of bodies that can be.

    Attributes:
        spec: The model.
        stated: Inertias as stated, by body.
        repair: What was repaired.
        diagnostics: What was accepted although it is wrong.
    """

    spec: mujoco.MjSpec
    stated: dict[str, StatedInertia]
    repair: Repair
    diagnostics: tuple[Diagnostic, ...]


def repaired_spec(
    path: Path,
    *,
    weld_root: bool = False,
    repair: Bodies | None = None,
    lock: Lock | None = None,
) -> RepairedSpec:
    """An MJCF file with bodies that can be, for every reader; otherwise as `read_mjcf`."""
    spec, said = open_spec(path, weld_root=weld_root, lock=lock)
    suspects, stated = stated_inertias(spec)
    model = compile_spec(spec, path)
    _check_places(model, path)
    # bodies that the compiler makes stay as they are
    reach = float(np.linalg.norm(model.body_pos, axis=1).sum()) if stated else np.inf
    # no chain ends without matter: MuJoCo takes no such file
    found = repaired(_links(model, stated, path), suspects, (), repair, path.name, reach)
    for name, inertia in found.links.items():
        stated[name] = set_inertia(spec.body(name), inertia)
    return RepairedSpec(spec, stated, found, said)


def read_links(
    path: Path, *, weld_root: bool = False, lock: Lock | None = None
) -> tuple[FileLink, ...]:
    """The bodies of an MJCF file in those of its tree, carriers before what they carry.

    Arguments are those with which `read_mjcf` has read it.
    """
    spec, _ = open_spec(path, weld_root=weld_root, lock=lock)
    _, stated = stated_inertias(spec)
    return _links(compile_spec(spec, path), stated, path)


def _links(
    model: mujoco.MjModel, stated: dict[str, StatedInertia], path: Path
) -> tuple[FileLink, ...]:
    """The bodies with their inertias as the file has them."""
    spec = parse(path)  # kept while its bodies are read: they live in it
    jointed = {body.name for body in spec.bodies if body.joints}
    found: dict[int, FileLink] = {}
    for b, (owner, rotation, position) in _places(model).items():
        name, below = model.body(b).name, found.get(model.body_parentid[b])
        carrier = name if below is None or name in jointed else below.carrier
        inertia = _inertia_of(model, b, stated)
        parent = "" if below is None else below.name
        found[b] = FileLink(name, owner, parent, carrier, rotation, position, inertia)
    return tuple(found.values())


def _check_places(model: mujoco.MjModel, path: Path) -> None:
    """Whether bodies, joints and mass centres are near enough to be reckoned with."""
    bodies, joints = range(1, model.nbody), range(model.njnt)
    places = [
        *((f"body '{model.body(b).name}'", model.body_pos[b]) for b in bodies),
        *((f"mass centre of body '{model.body(b).name}'", model.body_ipos[b]) for b in bodies),
        *((f"joint '{model.joint(j).name}'", model.jnt_pos[j]) for j in joints),
    ]
    for what, place in places:
        if not (np.abs(place) <= FARTHEST).all():
            raise ModelError(
                f"{path}: the {what} is {np.abs(place).max():.3g} m away; {FARTHEST:g} m is the "
                "limit"
            )


def _tree_of(
    model: mujoco.MjModel, stated: dict[str, StatedInertia], diagnostics: tuple[Diagnostic, ...]
) -> Tree:
    joints: list[Joint] = []
    places = _places(model, joints)
    inertias = [NOTHING] * len(joints)
    pedestal = NOTHING
    for b, (owner, rotation, position) in places.items():
        inertia = _inertia_of(model, b, stated).moved(Transform(rotation, position))
        if owner < 0:
            pedestal = pedestal + inertia
        else:
            inertias[owner] = inertias[owner] + inertia
    return Tree(
        name=model.names[: model.names.index(b"\0")].decode() or "robot",
        joints=tuple(joints),
        inertias=tuple(inertias),
        pedestal=pedestal,
        gravity=np.zeros(3) if _disabled(model, "GRAVITY") else model.opt.gravity,
        diagnostics=diagnostics,
    )


def _places(
    model: mujoco.MjModel, joints: list[Joint] | None = None
) -> dict[int, tuple[int, Array, Array]]:
    """By MuJoCo body, the tree's body that it is part of, and its pose there.

    Args:
        model: Compiled.
        joints: Gets the tree's joints.
    """
    joints = [] if joints is None else joints
    found = {0: (-1, np.eye(3), np.zeros(3))}
    for b in range(1, model.nbody):
        owner, rotation, position = found[model.body_parentid[b]]
        position = position + rotation @ model.body_pos[b]
        rotation = rotation @ _matrix(model.body_quat[b])
        for j in range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b]):
            joints.append(_joint_of(model, j, owner, rotation, position))
            owner, rotation, position = len(joints) - 1, np.eye(3), -model.jnt_pos[j]
        found[b] = (owner, rotation, position)
    del found[0]
    return found


def _joint_of(model: mujoco.MjModel, j: int, owner: int, rotation: Array, position: Array) -> Joint:
    """Joint j, its body's axes at `rotation` and origin at `position` in the owner's frame.

    MuJoCo turns about the anchor `jnt_pos`, which becomes our O^j, and counts from the
    position `qpos0` that the file's posture has.
    """
    body = model.body(model.jnt_bodyid[j]).name
    name = model.joint(j).name
    axis, zero = model.jnt_axis[j], model.qpos0[model.jnt_qposadr[j]]
    attachment = position + rotation @ model.jnt_pos[j]
    kind = _KINDS[int(model.jnt_type[j])]
    if kind == "revolute":
        rotation = rotation @ from_vector(-zero * axis)
    else:
        attachment = attachment - rotation @ axis * zero
    dof = model.jnt_dofadr[j]
    bounded, capped = model.jnt_limited[j], model.jnt_actfrclimited[j]
    limit = VELOCITY_LIMIT + name
    stated = _has(model, mujoco.mjtObj.mjOBJ_NUMERIC, limit)
    dry, wet = (not _disabled(model, flag) for flag in ("FRICTIONLOSS", "DAMPER"))
    return Joint(
        name=name,
        body=body,
        kind=kind,
        parent=owner,
        axis=axis,
        offset=attachment,
        rotation=rotation,
        position_range=model.jnt_range[j] if bounded else np.array([-np.inf, np.inf]),
        max_velocity=float(model.numeric(limit).data[0]) if stated else np.inf,
        max_effort=float(np.abs(model.jnt_actfrcrange[j]).min()) if capped else np.inf,
        coulomb=float(model.dof_frictionloss[dof]) if dry else 0.0,
        viscous=float(np.ravel(model.dof_damping[dof])[0]) if wet else 0.0,
        rotor_inertia=float(model.dof_armature[dof]),
    )


def _has(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> bool:
    return int(mujoco.mj_name2id(model, kind, name)) >= 0


def _disabled(model: mujoco.MjModel, flag: str) -> bool:
    return bool(model.opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}")))


def _inertia_of(model: mujoco.MjModel, b: int, stated: dict[str, StatedInertia]) -> Inertia:
    """The inertia of MuJoCo body b in its body frame, as stated where the file states it."""
    said = stated.get(model.body(b).name)
    mass, moments = model.body_mass[b], model.body_inertia[b]
    if said is not None:
        mass, moments = said.mass, said.moments
    elif mass <= MASSLESS:
        return NOTHING
    axes = _matrix(model.body_iquat[b])
    central = axes @ np.diag(moments) @ axes.T if moments.ndim == 1 else moments
    return Inertia.about_centre(mass, model.body_ipos[b], central)


def _matrix(quaternion: Array) -> Array:
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)
