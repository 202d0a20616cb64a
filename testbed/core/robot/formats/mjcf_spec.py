"""Editable MuJoCo model of an MJCF file: checked, reduced to the mechanism, joints locked.

MuJoCo's compiler resolves classes, frames, includes and inertias implied by geoms. A tree
represents inertia, gravity, friction and motors. Other passive forces of MuJoCo, mainly springs,
are removed with a diagnostic, so that the simulated plant equals the identified robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeAlias

import mujoco
import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import ModelError, quoted_list
from testbed.core.base.transform import Transform
from testbed.core.robot.formats.mjcf_compile import (
    check_mjcf_size,
    compile_copy,
    error_line,
    rotation_matrix,
    suppress_mujoco_warnings,
)
from testbed.core.robot.locks import (
    JointLocks,
    JointTravel,
    MimicCoupling,
    lock_positions,
)
from testbed.core.robot.refusals import FreeRootError, LoopError, MimicError
from testbed.core.robot.rotations import joint_displacement, matrix_to_quaternion
from testbed.core.robot.tree import ModelSource

VELOCITY_LIMIT_PREFIX = "velocity_limit/"
"""Prefix of names of velocity limits: <numeric name="velocity_limit/JOINT" data=.../>.

MJCF has no element for a velocity limit."""
LINEAR_INTERPOLATION = 1
"""Interpolation order of a delayed actuator: linear, between two buffered commands."""
_JOINT_TYPES = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
_JOINT_WRAP, _SITE_WRAP = mujoco.mjtWrap.mjWRAP_JOINT, mujoco.mjtWrap.mjWRAP_SITE
_FORCE_SENSOR_TYPES = (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE)

_Couplings: TypeAlias = dict[str, tuple[str | None, Array]]
"""Master joint and five polynomial coefficients, keyed by mimic joint, for positions relative to
the reference positions of the file."""


def buffered_command_count(delay: float, timestep: float) -> int:
    """Number of commands that a delayed actuator buffers, ceil(delay / timestep) + 2.

    This is MuJoCo's `nsample`; the number is zero for zero delay.

    Args:
        delay: Delay of the actuator [s].
        timestep: Time step of the simulation [s].
    """
    return int(np.ceil(delay / timestep)) + 2 if delay else 0


def open_spec(file: ModelSource) -> tuple[mujoco.MjSpec, tuple[Diagnostic, ...]]:
    """Editable MuJoCo model of an MJCF file, checked and reduced to the supported mechanism.

    Locked joints are removed, and their bodies are placed at the locked positions. Errors are those
    of `load_tree`.

    Returns:
        Editable model, and diagnostics of faults that were accepted.
    """
    path = file.path
    spec = parse_mjcf(path)
    spec.compiler.fusestatic = (
        False  # fused bodies would lose the masses of their links
    )
    _set_total_mass(spec, path)
    _remove_unused_elements(spec)
    for joint in list(spec.joints):
        if (
            joint.type == mujoco.mjtJoint.mjJNT_FREE
            and joint.parent.parent.name == "world"
        ):
            if not file.weld_root:
                raise FreeRootError(path.name, joint.name or joint.parent.name)
            spec.delete(joint)
        elif joint.type not in _JOINT_TYPES:
            kind = joint.type.name.removeprefix("mjJNT_").lower()
            raise ModelError(
                f"{path}: joint '{joint.name or joint.parent.name}' is of type '{kind}', which is "
                "not supported (supported: hinge, slide)"
            )
    diagnostics = lock_joints(spec, file.lock, path)
    return spec, (*diagnostics, *drop_passive_forces(spec, path))


def mjcf_joint_travels(path: Path) -> dict[str, JointTravel]:
    """Master joint of each coupled hinge or slide joint, by name; other fields are unset."""
    spec = parse_mjcf(path)
    couplings, _ = _remove_couplings(spec)
    followers = {
        name: MimicCoupling(master, ()) for name, (master, _) in couplings.items()
    }
    names = [joint.name for joint in spec.joints if joint.type in _JOINT_TYPES]
    return {name: JointTravel(coupling=followers.get(name)) for name in names}


def parse_mjcf(path: Path) -> mujoco.MjSpec:
    """Parse an MJCF file into an editable MuJoCo model; name unnamed bodies and joints.

    Mocap bodies become static, and constraints to them are removed.

    Raises:
        ModelError: MuJoCo rejects the file, it exceeds `check_mjcf_size`, or is not named *.xml.
    """
    check_mjcf_size(path)
    if path.suffix != ".xml":
        raise ModelError(
            f"{path}: MuJoCo reads MJCF from files that end in .xml; rename it"
        )
    with suppress_mujoco_warnings():
        try:
            spec = mujoco.MjSpec.from_file(str(path))
        except Exception as error:  # MuJoCo raises ValueError and its own FatalError
            raise ModelError(f"{path}: not a valid MJCF: {error_line(error)}") from None
    _name_everything(spec)
    _release_mocap(spec)
    return spec


def _set_total_mass(spec: mujoco.MjSpec, path: Path) -> None:
    """Scale all masses and inertias to the file's `settotalmass`, as MuJoCo's compiler does."""
    total_mass = spec.compiler.settotalmass
    if not total_mass > 0:
        return
    spec.compiler.settotalmass = -1.0
    model, stated = compile_copy(spec, path)
    masses = {
        name: float(model.body(name).mass[0]) for name in (b.name for b in spec.bodies)
    }
    factor = total_mass / sum(
        (masses | {n: body.mass for n, body in stated.items()}).values()
    )
    for body in spec.bodies:
        body.mass, body.inertia = factor * body.mass, factor * body.inertia
        body.fullinertia = factor * body.fullinertia
    for geom in spec.geoms:
        geom.mass, geom.density = factor * geom.mass, factor * geom.density


def _release_mocap(spec: mujoco.MjSpec) -> None:
    """Remove constraints that drive bodies with mocap bodies, and make mocap bodies static."""
    mocap_bodies = {body.name for body in spec.bodies if body.mocap}
    for equality in list(spec.equalities):
        ends = {equality.name1, equality.name2}
        if equality.objtype == mujoco.mjtObj.mjOBJ_BODY and mocap_bodies & ends:
            spec.delete(equality)
    for body in spec.bodies:
        body.mocap = False  # fixed in place


def _name_everything(spec: mujoco.MjSpec) -> None:
    """Name unnamed bodies and joints: body0, body1, ... and BODY_joint, made unique by numbers."""
    taken = {body.name for body in spec.bodies} | {joint.name for joint in spec.joints}
    for k, body in enumerate(spec.bodies):
        if not body.name:
            body.name = next(
                n for i in range(len(taken) + 1) if (n := f"body{k + i}") not in taken
            )
            taken.add(body.name)
    for k, joint in enumerate(spec.joints):
        if not joint.name:
            default_name = f"{joint.parent.name}_joint"
            joint.name = (
                default_name if default_name not in taken else f"{default_name}{k}"
            )
            taken.add(joint.name)


def _remove_unused_elements(spec: mujoco.MjSpec) -> None:
    """Remove actuators, keyframes, textures, height fields and sensors other than force and torque.

    Tuples, contact pairs and skins are also removed, and reserved memory sizes are reset.
    """
    for elements in (spec.actuators, spec.keys, spec.tuples, spec.pairs, spec.skins):
        for element in list(elements):
            spec.delete(element)
    for sensor in list(spec.sensors):
        if sensor.type not in _FORCE_SENSOR_TYPES:
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


def lock_joints(
    spec: mujoco.MjSpec, lock: JointLocks, path: Path
) -> tuple[Diagnostic, ...]:
    """Remove locked joints, mimic joints of locked masters, and all tendons from a model.

    Args:
        spec: Model, changed in place.
        lock: Positions of the joints to be locked, keyed by name [rad or m].
        path: Model file, for messages.

    Returns:
        Diagnostics of `lock_positions`, and of removed tendons.

    Raises:
        LoopError: An equality constraint closes a loop with joints that are not locked.
        MimicError: A mimic joint and its master are both not locked.
        UnknownName: A joint to be locked is not in the model.
    """
    couplings, loops = _remove_couplings(spec)
    tendons = drop_tendons(spec)
    if not lock and not couplings and not loops:
        return tendons
    model, _ = compile_copy(spec, path)
    travels = _travels(model, couplings)
    try:
        locked, diagnostics = lock_positions(travels, lock, path.name)
    except MimicError:
        # first report a loop, whose remedy may lock the master too
        _check_loops(loops, travels, lock, path)
        raise
    _check_loops(loops, travels, locked, path)
    for numeric in list(spec.numerics):
        if numeric.name.removeprefix(VELOCITY_LIMIT_PREFIX) in locked:
            spec.delete(numeric)
    for body in spec.bodies:
        if any(joint.name in locked for joint in body.joints):
            _lock_joints_of_body(spec, body, model, locked)
    return (*diagnostics, *tendons)


def _check_loops(
    loops: Mapping[str, tuple[str, ...]],
    travels: Mapping[str, JointTravel],
    locked: JointLocks,
    path: Path,
) -> None:
    """Raise LoopError for the first of `loops` (joints by constraint) with unlocked joints."""
    for constraint, joints in loops.items():
        moving = {
            name: travels[name].rest_position
            for name in joints
            if name in travels.keys() - locked.keys()
        }
        if moving:
            raise LoopError(path.name, constraint, moving)


def _remove_couplings(
    spec: mujoco.MjSpec,
) -> tuple[_Couplings, dict[str, tuple[str, ...]]]:
    """Remove equality constraints from a model; return joint couplings and loops.

    Couplings are keyed by mimic joint; loops map a description of a constraint to its joints. Every
    active constraint is a loop unless it is the first coupling of a joint.
    """
    couplings: _Couplings = {}
    loops: dict[str, tuple[str, ...]] = {}
    for number, equality in enumerate(list(spec.equalities), start=1):
        if equality.active:
            coupling = _joint_coupling(spec, equality)
            if coupling is not None and coupling[0] not in couplings:
                couplings[coupling[0]] = coupling[1:]
            else:
                ends = " and ".join(
                    f"'{name}'" for name in (equality.name1, equality.name2) if name
                )
                kind = equality.type.name.removeprefix("mjEQ_").lower()
                label = (
                    f"'{equality.name}'"
                    if equality.name
                    else f"<{kind}> (number {number})"
                )
                loops[f"{label} on {ends}"] = _loop_joints(spec, equality)
        spec.delete(equality)  # inactive constraints have no effect
    return couplings, loops


def _joint_coupling(
    spec: mujoco.MjSpec, equality: mujoco.MjsEquality
) -> tuple[str, str | None, Array] | None:
    """Mimic joint, master and polynomial coefficients (5,) of an equality constraint.

    The result is None if the constraint does not couple joints. The master of a joint at a constant
    position is None. A tendon of fixed length, c1 q1 + c2 q2 = length, couples joint 1 to joint 2.
    """
    data = np.array(equality.data[:5])
    if equality.type == mujoco.mjtEq.mjEQ_JOINT:
        return equality.name1, equality.name2 or None, data
    if equality.type != mujoco.mjtEq.mjEQ_TENDON or equality.name2:
        return None
    wraps = list(spec.tendon(equality.name1).path)
    if len(wraps) != 2 or any(
        wrap.type != mujoco.mjtWrap.mjWRAP_JOINT for wrap in wraps
    ):
        return None
    (first, first_coef), (second, second_coef) = (
        (wrap.target.name, wrap.coef) for wrap in wraps
    )
    return (
        first,
        second,
        np.array([data[0] / first_coef, -second_coef / first_coef, 0.0, 0.0, 0.0]),
    )


def _loop_joints(spec: mujoco.MjSpec, equality: mujoco.MjsEquality) -> tuple[str, ...]:
    """Names of the joints in a constraint's loop, except joints that carry both ends."""
    names = [name for name in (equality.name1, equality.name2) if name]
    if equality.type == mujoco.mjtEq.mjEQ_JOINT:
        return tuple(names)
    if equality.type == mujoco.mjtEq.mjEQ_TENDON:
        wraps = [wrap for name in names for wrap in spec.tendon(name).path]
        joints = [wrap.target.name for wrap in wraps if wrap.type == _JOINT_WRAP]
        bodies = [wrap.target.parent for wrap in wraps if wrap.type == _SITE_WRAP]
    else:
        on_sites = equality.objtype == mujoco.mjtObj.mjOBJ_SITE
        joints, bodies = (
            [],
            [spec.site(n).parent if on_sites else spec.body(n) for n in names],
        )
    chains: list[list[str]] = []
    for body in bodies:
        chains.append([])
        while body.name != "world":
            chains[-1] += [joint.name for joint in body.joints]
            body = body.parent
    for chain in chains:  # joints that carry both ends cause no relative motion
        joints += [
            n for n in chain if len(chains) == 1 or not all(n in c for c in chains)
        ]
    return tuple(dict.fromkeys(joints))


def _travels(model: mujoco.MjModel, couplings: _Couplings) -> dict[str, JointTravel]:
    """Range and coupling of a compiled model's joints, keyed by name, as absolute positions."""
    names = [model.joint(j).name for j in range(model.njnt)]
    zero = {
        name: float(model.qpos0[model.jnt_qposadr[j]]) for j, name in enumerate(names)
    }
    travels = {}
    for j, name in enumerate(names):
        low, high = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
        coupling = None
        if name in couplings:
            master, coefficients = couplings[name]
            master_offset = np.polynomial.Polynomial(
                [-zero.get(master or "", 0.0), 1.0]
            )
            polynomial = (
                np.polynomial.Polynomial(coefficients)(master_offset) + zero[name]
            )
            powers = polynomial.coef if master else polynomial.coef[:1]
            coupling = MimicCoupling(master, tuple(float(c) for c in powers))
        travels[name] = JointTravel(float(low), float(high), coupling)
    return travels


def _lock_joints_of_body(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    model: mujoco.MjModel,
    locked: dict[str, float],
) -> None:
    """Remove a body's locked joints and set the body's pose at the locked positions [rad or m].

    The joints of a body act in series; free joints before a locked joint are expressed in the
    displaced frame.
    """
    compiled_body = model.body(body.name)
    X_PB = X_PB_zero = Transform(rotation_matrix(compiled_body.quat), compiled_body.pos)
    free_joints: list[tuple[mujoco.MjsJoint, Array, Array]] = []
    for joint in list(body.joints):
        compiled_joint, slides = (
            model.joint(joint.name),
            joint.type == mujoco.mjtJoint.mjJNT_SLIDE,
        )
        anchor, axis = compiled_joint.pos.copy(), compiled_joint.axis.copy()
        if joint.name not in locked:
            free_joints.append((joint, anchor, axis))
            continue
        spec.delete(joint)
        if q := locked[compiled_joint.name] - float(compiled_joint.qpos0[0]):
            X = Transform(p_AB_A=anchor) @ joint_displacement(
                axis, q, revolute=not slides
            )
            X = X @ Transform(p_AB_A=-anchor)
            X_inverse = X.inverse
            free_joints = [
                (each, X_inverse.point(p), X_inverse.R_AB @ e)
                for each, p, e in free_joints
            ]
            X_PB = X_PB @ X
    if X_PB is not X_PB_zero:
        # without enclosing frames, which would displace it again
        body.set_frame(body.parent.add_frame())
        body.pos, body.quat = X_PB.p_AB_A, matrix_to_quaternion(X_PB.R_AB)
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        for joint, anchor, axis in free_joints:
            joint.set_frame(body.add_frame())
            joint.pos, joint.axis = anchor, axis


def drop_tendons(spec: mujoco.MjSpec) -> tuple[Diagnostic, ...]:
    """Remove all tendons; return a diagnostic of tendons with forces, inertia or limits."""
    names = []
    for number, tendon in enumerate(list(spec.tendons), start=1):
        parameters = (
            *tendon.stiffness,
            *tendon.damping,
            tendon.armature,
            tendon.frictionloss,
        )
        is_limited = tendon.limited != mujoco.mjtLimited.mjLIMITED_FALSE and np.any(
            tendon.range
        )
        if any(parameters) or is_limited:
            names.append(tendon.name or f"number {number}")
        spec.delete(tendon)
    return _removal_diagnostics({"the tendons": names})


def drop_passive_forces(spec: mujoco.MjSpec, path: Path) -> tuple[Diagnostic, ...]:
    """Remove springs, nonlinear damping, gravity compensation and fluid forces from a model.

    Args:
        spec: Model, changed in place.
        path: Model file, for messages.

    Returns:
        Diagnostics of removed forces, with the names of joints or bodies. Damping that is stated by
        the time constant and damping ratio of a spring is kept.
    """
    springs, nonlinear, compensated = list[str](), list[str](), list[str]()
    spring_damping = _spring_damping(spec, path)
    for joint in spec.joints:
        if np.any(joint.stiffness) or joint.name in spring_damping:
            springs.append(joint.name)
        if np.any(joint.damping[1:]):
            nonlinear.append(joint.name)
        joint.stiffness = np.zeros_like(joint.stiffness)
        joint.damping[1:] = 0.0
        joint.damping[0] = spring_damping.get(joint.name, joint.damping[0])
        joint.springdamper = np.zeros(2)
    for body in spec.bodies:
        if body.gravcomp:
            compensated.append(body.name)
        body.gravcomp = 0.0
    option = spec.option
    fluid = option.density or option.viscosity
    option.density = option.viscosity = 0.0
    diagnostics = _removal_diagnostics(
        {
            "springs of": springs,
            "damping that grows faster than the speed of": nonlinear,
            "gravity compensation of": compensated,
        }
    )
    return diagnostics + (
        _removal_diagnostics({"the fluid around": ["the robot"]}) if fluid else ()
    )


def _spring_damping(spec: mujoco.MjSpec, path: Path) -> dict[str, float]:
    """Damping of joints with `springdamper` (time constant, damping ratio), keyed by joint.

    The damping is that computed by MuJoCo's compiler [N m s/rad or N s/m].
    """
    names = [joint.name for joint in spec.joints if np.all(joint.springdamper)]
    if not names:
        return {}
    model, _ = compile_copy(spec, path)
    return {
        n: float(np.ravel(model.dof_damping[model.joint(n).dofadr[0]])[0])
        for n in names
    }


def _removal_diagnostics(names_by_kind: dict[str, list[str]]) -> tuple[Diagnostic, ...]:
    """Diagnostics of removed elements that act on the robot, one per kind."""
    return tuple(
        make_diagnostic("model.left-out", quoted_list(names), what=what)
        for what, names in names_by_kind.items()
        if names
    )
