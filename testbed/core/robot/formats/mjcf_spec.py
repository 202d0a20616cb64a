"""An MJCF file as MuJoCo's editable model: checked, reduced to its mechanism, joints held.

MuJoCo's compiler resolves classes, frames, includes and inertias implied by geoms. A tree knows
inertia, gravity, friction and motors. What MuJoCo calls passive forces besides, springs above all,
would make its plant another robot than the one that is identified: it is left out, and said.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeAlias

import mujoco
import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import ModelError, quoted
from testbed.core.base.transform import Transform
from testbed.core.robot.formats.mjcf_compile import (
    check_files,
    no_mujoco_warnings,
    one_line,
    resolve,
    rotation_matrix,
)
from testbed.core.robot.locks import Coupling, Lock, Travel, lock_positions
from testbed.core.robot.refusals import FreeRootError, LoopError, MimicError
from testbed.core.robot.rotations import displacement, to_quaternion
from testbed.core.robot.tree import ModelSource

VELOCITY_LIMIT = "velocity_limit/"
"""MJCF has no element for a velocity limit: <numeric name="velocity_limit/JOINT" data=.../>."""
LINEAR = 1
"""A delayed actuator reads its command between two that it has kept."""
_SUPPORTED = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
_JOINT, _SITE = mujoco.mjtWrap.mjWRAP_JOINT, mujoco.mjtWrap.mjWRAP_SITE
_PLATE = (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE)

_Couplings: TypeAlias = dict[str, tuple[str | None, Array]]
"""By follower: whom it follows, and five coefficients; both positions are counted from the file's
posture."""


def commands_kept(delay: float, timestep: float) -> int:
    """How many commands a delayed actuator keeps: MuJoCo's `nsample`, 0 without a delay.

    Args:
        delay: [s].
        timestep: Of the simulation [s].
    """
    return int(np.ceil(delay / timestep)) + 2 if delay else 0


def open_spec(file: ModelSource) -> tuple[mujoco.MjSpec, tuple[Diagnostic, ...]]:
    """The editable MuJoCo model of an MJCF file: its mechanism, checked for what is supported.

    Held joints are taken out, their bodies posed. Errors are those of `load_tree`.

    Returns:
        The model, and what was accepted although it is wrong.
    """
    path = file.path
    spec = parse(path)
    spec.compiler.fusestatic = False  # fused bodies would lose what their links weigh
    _set_total_mass(spec, path)
    _strip(spec)
    for joint in list(spec.joints):
        if (
            joint.type == mujoco.mjtJoint.mjJNT_FREE
            and joint.parent.parent.name == "world"
        ):
            if not file.weld_root:
                raise FreeRootError(path.name, joint.name or joint.parent.name)
            spec.delete(joint)
        elif joint.type not in _SUPPORTED:
            kind = joint.type.name.removeprefix("mjJNT_").lower()
            raise ModelError(
                f"{path}: joint '{joint.name or joint.parent.name}' is of type '{kind}', which is "
                "not supported (supported: hinge, slide)"
            )
    said = hold_joints(spec, file.lock, path)
    return spec, (*said, *drop_passive_forces(spec, path))


def travels(path: Path) -> dict[str, Travel]:
    """Coupling of every hinge and slide of an MJCF file, by name; ranges are left open."""
    spec = parse(path)
    couplings, _ = _couplings(spec)
    followers = {name: Coupling(master, ()) for name, (master, _) in couplings.items()}
    names = [joint.name for joint in spec.joints if joint.type in _SUPPORTED]
    return {name: Travel(coupling=followers.get(name)) for name in names}


def parse(path: Path) -> mujoco.MjSpec:
    """The file as MuJoCo's parser takes it, everything named.

    Raises:
        ModelError: MuJoCo does not take it.
    """
    check_files(path)
    if path.suffix != ".xml":
        raise ModelError(
            f"{path}: MuJoCo reads MJCF from files that end in .xml; rename it"
        )
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
    model, stated = resolve(spec, path)
    masses = {
        name: float(model.body(name).mass[0]) for name in (b.name for b in spec.bodies)
    }
    factor = wanted / sum(
        (masses | {n: body.mass for n, body in stated.items()}).values()
    )
    for body in spec.bodies:
        body.mass, body.inertia = factor * body.mass, factor * body.inertia
        body.fullinertia = factor * body.fullinertia
    for geom in spec.geoms:
        geom.mass, geom.density = factor * geom.mass, factor * geom.density


def _release_mocap(spec: mujoco.MjSpec) -> None:
    """Take out what welds a robot to bodies that a program moves: these drive it, as motors do."""
    moved = {body.name for body in spec.bodies if body.mocap}
    for equality in list(spec.equalities):
        ends = {equality.name1, equality.name2}
        if equality.objtype == mujoco.mjtObj.mjOBJ_BODY and moved & ends:
            spec.delete(equality)
    for body in spec.bodies:
        body.mocap = False  # it stands still


def _name_everything(spec: mujoco.MjSpec) -> None:
    """Names are optional in MJCF, and everything here is distinguished by name."""
    taken = {body.name for body in spec.bodies} | {joint.name for joint in spec.joints}
    for k, body in enumerate(spec.bodies):
        if not body.name:
            body.name = next(
                n for i in range(len(taken) + 1) if (n := f"body{k + i}") not in taken
            )
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


def hold_joints(spec: mujoco.MjSpec, lock: Lock, path: Path) -> tuple[Diagnostic, ...]:
    """Take locked joints out of a model, those that go along with them, and all tendons.

    Args:
        spec: The model, which is changed.
        lock: The joints to be held.
        path: Its file, for messages.

    Returns:
        Followers that are held where their masters do not take them, and tendons.

    Raises:
        ModelError: What couples joints is not supported; MimicError for a joint that follows
            another that moves.
        UnknownName: A joint to be held is not there.
    """
    couplings, loops = _couplings(spec)
    tendons = drop_tendons(spec)
    if not lock and not couplings and not loops:
        return tendons
    model, _ = resolve(spec, path)
    travels = _travels(model, couplings)
    try:
        held, said = lock_positions(travels, lock, path.name)
    except MimicError:
        # what may hold the master, too, comes first
        _check_loops(loops, travels, lock, path)
        raise
    _check_loops(loops, travels, held, path)
    for numeric in list(spec.numerics):
        if numeric.name.removeprefix(VELOCITY_LIMIT) in held:
            spec.delete(numeric)
    for body in spec.bodies:
        if any(joint.name in held for joint in body.joints):
            _hold(spec, body, model, held)
    return (*said, *tendons)


def _check_loops(
    loops: Mapping[str, tuple[str, ...]],
    travels: Mapping[str, Travel],
    held: Lock,
    path: Path,
) -> None:
    for constraint, joints in loops.items():
        moving = {
            name: travels[name].rest
            for name in joints
            if name in travels.keys() - held.keys()
        }
        if moving:
            raise LoopError(path.name, constraint, moving)


def _couplings(spec: mujoco.MjSpec) -> tuple[_Couplings, dict[str, tuple[str, ...]]]:
    """Joints that follow others, and joints along loops by constraint; taken out of `spec`."""
    found: _Couplings = {}
    loops: dict[str, tuple[str, ...]] = {}
    for number, equality in enumerate(list(spec.equalities), start=1):
        if equality.active:
            coupled = _coupled(spec, equality)
            if coupled is not None and coupled[0] not in found:
                found[coupled[0]] = coupled[1:]
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
                loops[f"{label} on {ends}"] = _along(spec, equality)
        spec.delete(equality)  # an inactive one does nothing
    return found, loops


def _coupled(
    spec: mujoco.MjSpec, equality: mujoco.MjsEquality
) -> tuple[str, str | None, Array] | None:
    """Follower, master and coefficients of a constraint that couples two joints; None of another.

    A tendon of two joints that keeps its length does so: c1 q1 + c2 q2 = length.
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
    (first, own), (second, other) = ((wrap.target.name, wrap.coef) for wrap in wraps)
    return first, second, np.array([data[0] / own, -other / own, 0.0, 0.0, 0.0])


def _along(spec: mujoco.MjSpec, equality: mujoco.MjsEquality) -> tuple[str, ...]:
    """The joints that move what a constraint joins."""
    names = [name for name in (equality.name1, equality.name2) if name]
    if equality.type == mujoco.mjtEq.mjEQ_JOINT:
        return tuple(names)
    if equality.type == mujoco.mjtEq.mjEQ_TENDON:
        wraps = [wrap for name in names for wrap in spec.tendon(name).path]
        joints = [wrap.target.name for wrap in wraps if wrap.type == _JOINT]
        bodies = [wrap.target.parent for wrap in wraps if wrap.type == _SITE]
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
    for chain in chains:  # what carries both ends does not move one against the other
        joints += [
            n for n in chain if len(chains) == 1 or not all(n in c for c in chains)
        ]
    return tuple(dict.fromkeys(joints))


def _travels(model: mujoco.MjModel, couplings: _Couplings) -> dict[str, Travel]:
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
            ahead = np.polynomial.Polynomial([-zero.get(master or "", 0.0), 1.0])
            polynomial = np.polynomial.Polynomial(coefficients)(ahead) + zero[name]
            powers = polynomial.coef if master else polynomial.coef[:1]
            coupling = Coupling(master, tuple(float(c) for c in powers))
        travels[name] = Travel(float(low), float(high), coupling)
    return travels


def _hold(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    model: mujoco.MjModel,
    held: dict[str, float],
) -> None:
    """Take a body's held joints out and pose it where they hold it.

    Joints of one body move it one after the other; those before a held one are seen from
    where it takes the body.
    """
    at_zero = model.body(body.name)
    X_PB = X_PB_zero = Transform(rotation_matrix(at_zero.quat), at_zero.pos)
    free: list[tuple[mujoco.MjsJoint, Array, Array]] = []
    for joint in list(body.joints):
        known, slides = (
            model.joint(joint.name),
            joint.type == mujoco.mjtJoint.mjJNT_SLIDE,
        )
        anchor, axis = known.pos.copy(), known.axis.copy()
        if joint.name not in held:
            free.append((joint, anchor, axis))
            continue
        spec.delete(joint)
        if q := held[known.name] - float(known.qpos0[0]):
            X = Transform(p_AB_A=anchor) @ displacement(axis, q, revolute=not slides)
            X = X @ Transform(p_AB_A=-anchor)
            back = X.inverse
            free = [(each, back.point(p), back.R_AB @ e) for each, p, e in free]
            X_PB = X_PB @ X
    if X_PB is not X_PB_zero:
        # out of frames that would move it once more
        body.set_frame(body.parent.add_frame())
        body.pos, body.quat = X_PB.p_AB_A, to_quaternion(X_PB.R_AB)
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        for joint, anchor, axis in free:
            joint.set_frame(body.add_frame())
            joint.pos, joint.axis = anchor, axis


def drop_tendons(spec: mujoco.MjSpec) -> tuple[Diagnostic, ...]:
    """Take all tendons out.

    Returns:
        Those that would act.
    """
    acting = []
    for number, tendon in enumerate(list(spec.tendons), start=1):
        acts = (
            *tendon.stiffness,
            *tendon.damping,
            tendon.armature,
            tendon.frictionloss,
        )
        stops = tendon.limited != mujoco.mjtLimited.mjLIMITED_FALSE and np.any(
            tendon.range
        )
        if any(acts) or stops:
            acting.append(tendon.name or f"number {number}")
        spec.delete(tendon)
    return _left_out({"the tendons": acting})


def drop_passive_forces(spec: mujoco.MjSpec, path: Path) -> tuple[Diagnostic, ...]:
    """Take out springs, damping that is not linear, gravity compensation and fluid.

    Args:
        spec: The model, which is changed.
        path: Its file, for messages.

    Returns:
        Each kind that would act, with the joints or bodies where it is.
    """
    springs, curved, floating = list[str](), list[str](), list[str]()
    dampers = _dampers_of_springs(spec, path)
    for joint in spec.joints:
        if np.any(joint.stiffness) or joint.name in dampers:
            springs.append(joint.name)
        if np.any(joint.damping[1:]):
            curved.append(joint.name)
        joint.stiffness = np.zeros_like(joint.stiffness)
        joint.damping[1:] = 0.0
        joint.damping[0] = dampers.get(joint.name, joint.damping[0])
        joint.springdamper = np.zeros(2)
    for body in spec.bodies:
        if body.gravcomp:
            floating.append(body.name)
        body.gravcomp = 0.0
    option = spec.option
    fluid = option.density or option.viscosity
    option.density = option.viscosity = 0.0
    said = _left_out(
        {
            "springs of": springs,
            "damping that grows faster than the speed of": curved,
            "gravity compensation of": floating,
        }
    )
    return said + (_left_out({"the fluid around": ["the robot"]}) if fluid else ())


def _dampers_of_springs(spec: mujoco.MjSpec, path: Path) -> dict[str, float]:
    """Damping that MuJoCo's compiler finds for springs that files say by their time and ratio."""
    names = [joint.name for joint in spec.joints if np.all(joint.springdamper)]
    if not names:
        return {}
    model, _ = resolve(spec, path)
    return {
        n: float(np.ravel(model.dof_damping[model.joint(n).dofadr[0]])[0])
        for n in names
    }


def _left_out(found: dict[str, list[str]]) -> tuple[Diagnostic, ...]:
    return tuple(
        diagnose("model.left-out", quoted(names), what=what)
        for what, names in found.items()
        if names
    )
