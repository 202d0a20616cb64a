"""Reader of MJCF files: builds a tree with MuJoCo, independently of the URDF reader.

Bodies without joints are merged into the bodies that carry them.
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
    MIN_COMPILED_MASS,
    ExplicitInertia,
    compile_spec,
    extract_explicit_inertias,
    rotation_matrix,
    set_inertia,
)
from testbed.core.robot.formats.mjcf_spec import (
    VELOCITY_LIMIT_PREFIX,
    open_spec,
    parse_mjcf,
)
from testbed.core.robot.inertia import ZERO_INERTIA, Inertia
from testbed.core.robot.repair import ModelLink, Repair, repair_inertias
from testbed.core.robot.rotations import joint_displacement
from testbed.core.robot.tree import MAX_COORDINATE, Joint, JointKind, ModelSource, Tree

_JOINT_KINDS: dict[int, JointKind] = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "revolute",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
}


@dataclass(frozen=True, eq=False)
class MjcfModel:
    """MJCF file as an editable MuJoCo model with physically consistent inertias.

    Attributes:
        path: MJCF file.
        spec: Editable model.
        compiled: Model compiled before the repair of inertias.
        links: Bodies with inertias as stated in the file, each after its carrier.
        repair: Replacements for inconsistent inertias.
        diagnostics: Diagnostics of faults in the file that were accepted.
    """

    path: Path
    spec: mujoco.MjSpec
    compiled: mujoco.MjModel
    links: tuple[ModelLink, ...]
    repair: Repair
    diagnostics: tuple[Diagnostic, ...]

    def tree(self) -> Tree:
        """Build the tree; the bedplate frame is MuJoCo's world frame.

        Raises:
            ModelError: A velocity limit names no joint.
        """
        model = self.compiled
        for k in range(model.nnumeric):
            name = model.numeric(k).name
            joint = name.removeprefix(VELOCITY_LIMIT_PREFIX)
            if joint != name and not _has_name(model, mujoco.mjtObj.mjOBJ_JOINT, joint):
                raise ModelError(f"{self.path}: <numeric name='{name}'> names no joint")
        joints, _ = _joints(model)
        bodies = [ZERO_INERTIA] * (len(joints) + 1)  # the last is the pedestal, body -1
        for link in self.links:
            inertia = self.repair.links.get(link.name, link.inertia)
            bodies[link.body] += inertia.transformed(link.X_BL)
        *inertias, pedestal = bodies
        return Tree(
            name=model.names[: model.names.index(b"\0")].decode() or "robot",
            joints=joints,
            inertias=tuple(inertias),
            pedestal=pedestal,
            gravity=np.zeros(3)
            if _is_disabled(model, "GRAVITY")
            else model.opt.gravity,
            diagnostics=(*self.repair.diagnostics, *self.diagnostics),
        )


def read(file: ModelSource) -> MjcfModel:
    """Read an MJCF file into a MuJoCo model; raises the errors of `load_tree`."""
    path = file.path
    spec, diagnostics = open_spec(file)
    suspects, stated = extract_explicit_inertias(spec)
    model = compile_spec(spec, path)
    _check_distances(model, path)
    # inertias computed by the compiler are not checked for scale
    reach = float(np.linalg.norm(model.body_pos, axis=1).sum()) if stated else np.inf
    links = _links(model, stated, path)
    # no massless chain ends: MuJoCo rejects such a file
    repair = repair_inertias(links, suspects, (), file.repair, path.name, reach)
    for name, inertia in repair.links.items():
        set_inertia(spec.body(name), inertia)
    return MjcfModel(path, spec, model, links, repair, diagnostics)


def _links(
    model: mujoco.MjModel, stated: dict[str, ExplicitInertia], path: Path
) -> tuple[ModelLink, ...]:
    """Bodies of the compiled model as links, with inertias as stated in the file.

    Args:
        model: Compiled model, with locked joints removed.
        stated: Explicit inertias, keyed by body.
        path: MJCF file, whose own bodies without joints define `fixed_carrier`.
    """
    spec = parse_mjcf(path)  # referenced while its bodies are in use
    jointed = {body.name for body in spec.bodies if body.joints}
    links: dict[int, ModelLink] = {}
    for b, (owner, X_OB) in _joints(model)[1].items():
        name, parent_link = model.body(b).name, links.get(model.body_parentid[b])
        carrier = (
            name
            if parent_link is None or name in jointed
            else parent_link.fixed_carrier
        )
        parent = "" if parent_link is None else parent_link.name
        inertia = _inertia_of(model, b, stated)
        links[b] = ModelLink(name, owner, parent, carrier, X_OB, inertia)
    return tuple(links.values())


def _check_distances(model: mujoco.MjModel, path: Path) -> None:
    """Check that coordinates of bodies, joints and mass centres are at most MAX_COORDINATE.

    Raises:
        ModelError: A coordinate in the local frame exceeds MAX_COORDINATE.
    """
    bodies, joints = range(1, model.nbody), range(model.njnt)
    points = [
        *((f"body '{model.body(b).name}'", model.body_pos[b]) for b in bodies),
        *(
            (f"mass centre of body '{model.body(b).name}'", model.body_ipos[b])
            for b in bodies
        ),
        *((f"joint '{model.joint(j).name}'", model.jnt_pos[j]) for j in joints),
    ]
    for label, point in points:
        if not (np.abs(point) <= MAX_COORDINATE).all():
            raise ModelError(
                f"{path}: the {label} is {np.abs(point).max():.3g} m away; "
                f"{MAX_COORDINATE:g} m is the limit"
            )


def _joints(
    model: mujoco.MjModel,
) -> tuple[tuple[Joint, ...], dict[int, tuple[int, Transform]]]:
    """Joints of the tree, and pairs of owner and pose X_OB keyed by MuJoCo body.

    The owner O is the tree's body that contains MuJoCo's body B (-1 for the bedplate); X_OB is the
    pose of B in the frame of O. A MuJoCo body with several joints becomes several bodies of the
    tree in series, one per joint.
    """
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
    """Joint j of a MuJoCo body with pose X_OB in its owner's frame.

    The anchor `jnt_pos`, about which MuJoCo rotates the body, becomes the origin O^j. The joint
    position in the reference configuration of the file is `qpos0`, which need not be zero.

    Args:
        model: Compiled model.
        j: Index of the joint in MuJoCo.
        owner: Index of the carrying body in the tree, -1 for the bedplate.
        X_OB: Pose of the MuJoCo body in the owner's frame, in the reference configuration.
    """
    body = model.body(model.jnt_bodyid[j]).name
    name = model.joint(j).name
    axis, zero = model.jnt_axis[j], model.qpos0[model.jnt_qposadr[j]]
    kind = _JOINT_KINDS[int(model.jnt_type[j])]
    X_OJ = X_OB @ Transform(p_AB_A=model.jnt_pos[j])
    X_OJ = X_OJ @ joint_displacement(axis, -zero, revolute=kind == "revolute")
    dof = model.jnt_dofadr[j]
    has_range, has_max_effort = model.jnt_limited[j], model.jnt_actfrclimited[j]
    limit = VELOCITY_LIMIT_PREFIX + name
    has_max_velocity = _has_name(model, mujoco.mjtObj.mjOBJ_NUMERIC, limit)
    has_coulomb, has_damping = (
        not _is_disabled(model, flag) for flag in ("FRICTIONLOSS", "DAMPER")
    )
    return Joint(
        name=name,
        body=body,
        kind=kind,
        parent=owner,
        axis=axis,
        offset=X_OJ.p_AB_A,
        rotation=X_OJ.R_AB,
        position_range=model.jnt_range[j] if has_range else np.array([-np.inf, np.inf]),
        max_velocity=float(model.numeric(limit).data[0])
        if has_max_velocity
        else np.inf,
        max_effort=float(np.abs(model.jnt_actfrcrange[j]).min())
        if has_max_effort
        else np.inf,
        coulomb=float(model.dof_frictionloss[dof]) if has_coulomb else 0.0,
        viscous=float(np.ravel(model.dof_damping[dof])[0]) if has_damping else 0.0,
        rotor_inertia=float(model.dof_armature[dof]),
    )


def _has_name(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> bool:
    """Test whether a compiled model has an element of given type and name."""
    return int(mujoco.mj_name2id(model, kind, name)) >= 0


def _is_disabled(model: mujoco.MjModel, flag: str) -> bool:
    """Test whether an option flag of a MuJoCo model is disabled."""
    return bool(
        model.opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}"))
    )


def _inertia_of(
    model: mujoco.MjModel, b: int, stated: dict[str, ExplicitInertia]
) -> Inertia:
    """Inertia of a MuJoCo body relative to its frame.

    An explicit inertia is returned as stated in the file. Any other inertia is computed by MuJoCo's
    compiler; it is set to zero if the mass is at most MIN_COMPILED_MASS.

    Args:
        model: Compiled model.
        b: Index of the body in MuJoCo.
        stated: Explicit inertias, keyed by body.
    """
    explicit = stated.get(model.body(b).name)
    mass, moments = model.body_mass[b], model.body_inertia[b]
    if explicit is not None:
        mass, moments = explicit.mass, explicit.moments
    elif mass <= MIN_COMPILED_MASS:
        return ZERO_INERTIA
    axes = rotation_matrix(model.body_iquat[b])
    central = axes @ np.diag(moments) @ axes.T if moments.ndim == 1 else moments
    return Inertia.about_centre(mass, model.body_ipos[b], central)
