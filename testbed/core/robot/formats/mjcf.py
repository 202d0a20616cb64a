"""MJCF -> Tree, through MuJoCo: the other of two independent roads.

Bodies without joints are merged into those that carry them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import ModelError
from testbed.core.base.transform import Transform
from testbed.core.robot.formats.mjcf_compile import (
    MASSLESS,
    StatedInertia,
    compile_spec,
    rotation_matrix,
    set_inertia,
    stated_inertias,
)
from testbed.core.robot.formats.mjcf_spec import VELOCITY_LIMIT, open_spec, parse
from testbed.core.robot.inertia import NOTHING, Inertia
from testbed.core.robot.repair import FileLink, Repair, repaired
from testbed.core.robot.rotations import displacement
from testbed.core.robot.tree import FARTHEST, Joint, Kind, ModelSource, Tree

_KINDS: dict[int, Kind] = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "revolute",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
}


@dataclass(frozen=True, eq=False)
class MjcfModel:
    """MJCF file as MuJoCo's editable model, of bodies that can be.

    Attributes:
        path: The file.
        spec: The model.
        compiled: Compiled before inertias were repaired.
        links: Bodies with their inertias as the file has them, carriers before what they carry.
        repair: What was repaired.
        diagnostics: What was accepted although it is wrong.
    """

    path: Path
    spec: mujoco.MjSpec
    compiled: mujoco.MjModel
    links: tuple[FileLink, ...]
    repair: Repair
    diagnostics: tuple[Diagnostic, ...]

    def tree(self) -> Tree:
        """Robot; the bedplate frame is MuJoCo's world frame.

        Raises:
            ModelError: A velocity limit is of no joint.
        """
        model = self.compiled
        for k in range(model.nnumeric):
            name = model.numeric(k).name
            joint = name.removeprefix(VELOCITY_LIMIT)
            if joint != name and not _has(model, mujoco.mjtObj.mjOBJ_JOINT, joint):
                raise ModelError(f"{self.path}: <numeric name='{name}'> names no joint")
        joints, _ = _joints(model)
        bodies = [NOTHING] * (len(joints) + 1)  # the last is the pedestal, body -1
        for link in self.links:
            inertia = self.repair.links.get(link.name, link.inertia)
            bodies[link.body] += inertia.moved(link.X_BL)
        *inertias, pedestal = bodies
        return Tree(
            name=model.names[: model.names.index(b"\0")].decode() or "robot",
            joints=joints,
            inertias=tuple(inertias),
            pedestal=pedestal,
            gravity=np.zeros(3) if _disabled(model, "GRAVITY") else model.opt.gravity,
            diagnostics=(*self.repair.diagnostics, *self.diagnostics),
        )


def read(file: ModelSource) -> MjcfModel:
    """Read an MJCF file; errors are those of `load_tree`."""
    path = file.path
    spec, said = open_spec(file)
    suspects, stated = stated_inertias(spec)
    model = compile_spec(spec, path)
    _check_places(model, path)
    # bodies that the compiler makes stay as they are
    reach = float(np.linalg.norm(model.body_pos, axis=1).sum()) if stated else np.inf
    links = _links(model, stated, path)
    # no chain ends without matter: MuJoCo takes no such file
    repair = repaired(links, suspects, (), file.repair, path.name, reach)
    for name, inertia in repair.links.items():
        set_inertia(spec.body(name), inertia)
    return MjcfModel(path, spec, model, links, repair, said)


def _links(
    model: mujoco.MjModel, stated: dict[str, StatedInertia], path: Path
) -> tuple[FileLink, ...]:
    """The bodies with their inertias as the file has them."""
    spec = parse(path)  # kept while its bodies are read: they live in it
    jointed = {body.name for body in spec.bodies if body.joints}
    links: dict[int, FileLink] = {}
    for b, (owner, X_OB) in _joints(model)[1].items():
        name, below = model.body(b).name, links.get(model.body_parentid[b])
        carrier = name if below is None or name in jointed else below.carrier
        parent = "" if below is None else below.name
        inertia = _inertia_of(model, b, stated)
        links[b] = FileLink(name, owner, parent, carrier, X_OB, inertia)
    return tuple(links.values())


def _check_places(model: mujoco.MjModel, path: Path) -> None:
    """Whether bodies, joints and mass centres are near enough to be reckoned with."""
    bodies, joints = range(1, model.nbody), range(model.njnt)
    places = [
        *((f"body '{model.body(b).name}'", model.body_pos[b]) for b in bodies),
        *(
            (f"mass centre of body '{model.body(b).name}'", model.body_ipos[b])
            for b in bodies
        ),
        *((f"joint '{model.joint(j).name}'", model.jnt_pos[j]) for j in joints),
    ]
    for what, place in places:
        if not (np.abs(place) <= FARTHEST).all():
            raise ModelError(
                f"{path}: the {what} is {np.abs(place).max():.3g} m away; {FARTHEST:g} m is the "
                "limit"
            )


def _joints(
    model: mujoco.MjModel,
) -> tuple[tuple[Joint, ...], dict[int, tuple[int, Transform]]]:
    """The tree's joints; and by MuJoCo body, its owner in the tree and its pose X_OB there."""
    joints: list[Joint] = []
    poses = {0: (-1, Transform())}
    for b in range(1, model.nbody):
        owner, X_OP = poses[model.body_parentid[b]]
        X_OB = X_OP @ Transform(rotation_matrix(model.body_quat[b]), model.body_pos[b])
        for j in range(
            model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b]
        ):
            joints.append(_joint_of(model, j, owner, X_OB))
            owner, X_OB = len(joints) - 1, Transform(p_AB_A=-model.jnt_pos[j])
        poses[b] = owner, X_OB
    del poses[0]
    return tuple(joints), poses


def _joint_of(model: mujoco.MjModel, j: int, owner: int, X_OB: Transform) -> Joint:
    """Joint j of a body in pose X_OB on its owner.

    MuJoCo turns about the anchor `jnt_pos`, which becomes our O^j, and counts from the
    position `qpos0` that the file's posture has.
    """
    body = model.body(model.jnt_bodyid[j]).name
    name = model.joint(j).name
    axis, zero = model.jnt_axis[j], model.qpos0[model.jnt_qposadr[j]]
    kind = _KINDS[int(model.jnt_type[j])]
    X_OJ = X_OB @ Transform(p_AB_A=model.jnt_pos[j])
    X_OJ = X_OJ @ displacement(axis, -zero, revolute=kind == "revolute")
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
        offset=X_OJ.p_AB_A,
        rotation=X_OJ.R_AB,
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
    return bool(
        model.opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}"))
    )


def _inertia_of(
    model: mujoco.MjModel, b: int, stated: dict[str, StatedInertia]
) -> Inertia:
    """The inertia of MuJoCo body b in its body frame, as stated where the file states it."""
    said = stated.get(model.body(b).name)
    mass, moments = model.body_mass[b], model.body_inertia[b]
    if said is not None:
        mass, moments = said.mass, said.moments
    elif mass <= MASSLESS:
        return NOTHING
    axes = rotation_matrix(model.body_iquat[b])
    central = axes @ np.diag(moments) @ axes.T if moments.ndim == 1 else moments
    return Inertia.about_centre(mass, model.body_ipos[b], central)
