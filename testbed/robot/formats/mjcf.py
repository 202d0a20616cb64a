"""MJCF -> Tree, through MuJoCo: the other of two independent roads.

MuJoCo's compiler resolves classes, frames, includes and inertias implied by geoms; bodies
without joints are merged here. Mesh files that are missing are dropped where an explicit
inertia makes them irrelevant.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from testbed.arrays import Array
from testbed.errors import FreeRootError, InertiaError, ModelError
from testbed.robot.inertia import NOTHING, Inertia, flaw
from testbed.robot.stderr import captured_stderr
from testbed.robot.tree import Joint, Kind, Tree

_KINDS: dict[int, Kind] = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "revolute",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
}
MASSLESS = 1e-12
"""Given to massless bodies so that the compiler takes them; read back as no matter [kg]."""

_VELOCITY_LIMIT = "velocity_limit/"
"""MJCF has no element for a velocity limit: <numeric name="velocity_limit/JOINT" data=.../>."""


def open_spec(path: Path, *, weld_root: bool = False) -> mujoco.MjSpec:
    """The editable MuJoCo model of an MJCF file, checked for what is supported.

    Raises:
        ModelError: The file is not MJCF, or holds what is not supported.
        FreeRootError: The root floats and `weld_root` is not set.
    """
    with no_mujoco_warnings():
        try:
            spec = mujoco.MjSpec.from_file(str(path))
        except Exception as error:  # MuJoCo raises ValueError and its own FatalError
            raise ModelError(f"{path}: not a valid MJCF: {_one_line(error)}") from None
    _name_everything(spec)
    spec.compiler.fusestatic = False  # fused bodies would lose what their links weigh
    if spec.compiler.settotalmass > 0:
        raise ModelError(
            f"{path}: compiler settotalmass is deprecated and not supported; scale the masses in "
            "the file"
        )
    for equality in spec.equalities:
        raise ModelError(
            f"{path}: equality constraint '{equality.name}' between '{equality.name1}' and "
            f"'{equality.name2}' closes a loop or couples joints, which is not supported"
        )
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE and joint.parent.parent.name == "world":
            if not weld_root:
                raise FreeRootError(path.name, joint.name or joint.parent.name)
            spec.delete(joint)
        elif int(joint.type) not in _KINDS:
            kind = joint.type.name.removeprefix("mjJNT_").lower()
            raise ModelError(
                f"{path}: joint '{joint.name or joint.parent.name}' is of type '{kind}', which is "
                "not supported (supported: hinge, slide)"
            )
    return spec


def compile_spec(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """Compile; where mesh or texture files are missing, without what is only for the eye.

    Raises:
        ModelError: MuJoCo refuses the model.
    """
    with no_mujoco_warnings():
        try:
            return spec.compile()
        except Exception as error:
            first = _one_line(error)
        if "file" not in first:
            raise ModelError(f"{path}: {first}")
        _drop_assets(spec, path, first)
        try:
            return spec.compile()
        except Exception as error:
            raise ModelError(f"{path}: {_one_line(error)}") from None


def read_mjcf(path: Path, *, weld_root: bool = False, accept_inertia: bool = False) -> Tree:
    """The tree of an MJCF file; the bedplate frame is MuJoCo's world frame.

    Args:
        path: The file.
        weld_root: Weld a floating root to the bedplate instead of refusing it.
        accept_inertia: Take impossible inertias as they are and note them in `warnings`.

    Raises:
        ModelError: The file is not MJCF, or holds what is not supported.
        FreeRootError: The root floats and `weld_root` is not set.
        InertiaError: A body cannot be rigid and `accept_inertia` is not set.
    """
    spec = open_spec(path, weld_root=weld_root)
    flaws, stated = _stated_inertias(spec)
    if flaws and not accept_inertia:
        raise InertiaError(path.name, flaws)
    spec.compiler.boundmass = spec.compiler.boundinertia = MASSLESS
    model = compile_spec(spec, path)
    for k in range(model.nnumeric):
        name = model.numeric(k).name
        if name.startswith(_VELOCITY_LIMIT) and not _is_joint(model, name):
            raise ModelError(f"{path}: <numeric name='{name}'> names no joint")
    return _tree_of(model, stated, tuple(flaws) + _springs(model))


@dataclass(frozen=True)
class _Stated:
    """An inertia as the file states it: the compiler's principal axes cost digits."""

    mass: float
    central: Array | None  # None: along the principal axes given by the body's `iquat`


def _stated_inertias(spec: mujoco.MjSpec) -> tuple[list[str], dict[str, _Stated]]:
    """Flaws, and the explicit inertias by body name; flawed ones are replaced in `spec`."""
    flaws: list[str] = []
    stated: dict[str, _Stated] = {}
    compiler = spec.compiler
    from_geoms = compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if from_geoms or compiler.balanceinertia:
        return flaws, stated  # what counts is what the compiler makes of the file
    for body in spec.bodies:
        if not body.explicitinertial:
            continue
        xx, yy, zz, xy, xz, yz = body.fullinertia
        full = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        given_in_full = not np.isnan(xx)
        found = flaw(body.name, body.mass, full if given_in_full else np.diag(body.inertia))
        if not np.isfinite(body.ipos).all():
            found = f"link '{body.name}' has a mass centre that is not a number"
            body.ipos = np.zeros(3)
        stated[body.name] = _Stated(body.mass, full if given_in_full else None)
        if found:
            flaws.append(found)
            tensor = full if given_in_full else np.diag(body.inertia)
            finite = np.isfinite(body.mass) and np.isfinite(tensor).all()
            stated[body.name] = (
                _Stated(body.mass, tensor) if finite else _Stated(0.0, np.zeros((3, 3)))
            )
            body.mass, body.inertia, body.fullinertia = 1.0, np.ones(3), np.full(6, np.nan)
    return flaws, stated


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


@contextmanager
def no_mujoco_warnings() -> Iterator[None]:
    """MuJoCo's warnings go nowhere: neither to the terminal nor to MUJOCO_LOG.TXT."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        with captured_stderr(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        mujoco.set_mju_user_warning(before)


def _springs(model: mujoco.MjModel) -> tuple[str, ...]:
    return tuple(
        f"joint '{model.joint(j).name}' has a spring ({model.jnt_stiffness[j].flat[0]:g} N m/rad "
        "or N/m) that the joint model does not know"
        for j in range(model.njnt)
        if np.any(model.jnt_stiffness[j])
    )


def _tree_of(model: mujoco.MjModel, stated: dict[str, _Stated], warnings: tuple[str, ...]) -> Tree:
    joints: list[Joint] = []
    inertias: list[Inertia] = []
    pedestal = NOTHING
    carrier = {0: (-1, np.eye(3), np.zeros(3))}  # MuJoCo body -> (our body, its pose there)
    for b in range(1, model.nbody):
        owner, rotation, position = carrier[model.body_parentid[b]]
        position = position + rotation @ model.body_pos[b]
        rotation = rotation @ _matrix(model.body_quat[b])
        for j in range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b]):
            joints.append(_joint_of(model, j, owner, rotation, position))
            inertias.append(NOTHING)
            owner, rotation, position = len(joints) - 1, np.eye(3), -model.jnt_pos[j]
        carrier[b] = (owner, rotation, position)
        inertia = _inertia_of(model, b, stated).moved(rotation, position)
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
        warnings=warnings,
    )


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
        rotation = rotation @ _turn(axis, -zero)
    else:
        attachment = attachment - rotation @ axis * zero
    dof = model.jnt_dofadr[j]
    bounded, capped = model.jnt_limited[j], model.jnt_actfrclimited[j]
    limit = _VELOCITY_LIMIT + name
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
        max_velocity=float(model.numeric(limit).data[0]) if _has(model, limit) else np.inf,
        max_effort=float(np.abs(model.jnt_actfrcrange[j]).min()) if capped else np.inf,
        coulomb=float(model.dof_frictionloss[dof]) if dry else 0.0,
        viscous=float(np.ravel(model.dof_damping[dof])[0]) if wet else 0.0,
        rotor_inertia=float(model.dof_armature[dof]),
    )


def _is_joint(model: mujoco.MjModel, numeric: str) -> bool:
    joint = numeric.removeprefix(_VELOCITY_LIMIT)
    return int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)) >= 0


def _disabled(model: mujoco.MjModel, flag: str) -> bool:
    return bool(model.opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}")))


def _has(model: mujoco.MjModel, name: str) -> bool:
    return int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)) >= 0


def _inertia_of(model: mujoco.MjModel, b: int, stated: dict[str, _Stated]) -> Inertia:
    """The inertia of MuJoCo body b in its body frame, as stated where the file states it."""
    axes = _matrix(model.body_iquat[b])
    principal = axes @ np.diag(model.body_inertia[b]) @ axes.T
    said = stated.get(model.body(b).name)
    if said is not None:
        central = principal if said.central is None else said.central
        return Inertia.about_centre(said.mass, model.body_ipos[b], central)
    mass = model.body_mass[b]
    if mass <= MASSLESS:
        return NOTHING
    return Inertia.about_centre(mass, model.body_ipos[b], principal)


def _matrix(quaternion: Array) -> Array:
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)


def _turn(axis: Array, angle: float) -> Array:
    quaternion = np.empty(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    return _matrix(quaternion)


def _drop_assets(spec: mujoco.MjSpec, path: Path, reason: str) -> None:
    """Remove meshes, height fields, textures and what uses them, unless an inertia needs them."""
    shapes = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF, mujoco.mjtGeom.mjGEOM_HFIELD)
    for geom in list(spec.geoms):
        if geom.type in shapes:
            body = geom.parent
            if not body.explicitinertial and body.name != "world":
                raise ModelError(
                    f"{path}: the inertia of body '{body.name}' comes from its mesh, and {reason}"
                )
            spec.delete(geom)
        else:
            geom.material = ""
    for site in spec.sites:
        site.material = ""
    for assets in (spec.skins, spec.meshes, spec.hfields, spec.materials, spec.textures):
        for asset in list(assets):
            spec.delete(asset)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).removeprefix("Error: ").split())
