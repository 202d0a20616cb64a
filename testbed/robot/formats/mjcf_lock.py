"""Joints of an MJCF model that are held: found, posed and taken out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeAlias

import mujoco
import numpy as np

from testbed.arrays import Array
from testbed.errors import LoopError, MimicError
from testbed.robot.formats.mjcf_compile import resolved
from testbed.robot.formats.mjcf_passive import drop_tendons
from testbed.robot.locks import Coupling, Lock, Travel, held_positions

VELOCITY_LIMIT = "velocity_limit/"
"""MJCF has no element for a velocity limit: <numeric name="velocity_limit/JOINT" data=.../>."""


def hold_joints(spec: mujoco.MjSpec, lock: Lock, path: Path) -> tuple[str, ...]:
    """Take locked joints out of a model, those that go along with them, and all tendons.

    Args:
        spec: The model, which is changed.
        lock: The joints to be held.
        path: Its file, for messages.

    Returns:
        A line for each follower that is held where its master does not take it, and for tendons.

    Raises:
        ModelError: What couples joints is not supported; MimicError for a joint that follows
            another that moves.
        UnknownName: A joint to be held is not there.
    """
    couplings, loops = _couplings(spec)
    tendons = drop_tendons(spec)
    if not lock and not couplings and not loops:
        return tendons
    model, _ = resolved(spec, path)
    travels = _travels(model, couplings)
    try:
        held, warnings = held_positions(travels, lock, path.name)
    except MimicError:
        _check_loops(loops, travels, lock, path)  # what may hold the master, too, comes first
        raise
    _check_loops(loops, travels, held, path)
    for numeric in list(spec.numerics):
        if numeric.name.removeprefix(VELOCITY_LIMIT) in held:
            spec.delete(numeric)
    for body in spec.bodies:
        if any(joint.name in held for joint in body.joints):
            _hold(spec, body, model, held)
    return (*warnings, *tendons)


def _check_loops(
    loops: Mapping[str, tuple[str, ...]], travels: Mapping[str, Travel], held: Lock, path: Path
) -> None:
    for constraint, joints in loops.items():
        moving = {
            name: travels[name].rest for name in joints if name in travels.keys() - held.keys()
        }
        if moving:
            raise LoopError(path.name, constraint, moving)


def followers(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """The joints of a model that follow others that move."""
    return tuple(name for name, (master, _) in _couplings(spec)[0].items() if master)


_Couplings: TypeAlias = dict[str, tuple[str | None, Array]]
"""By follower: whom it follows, and five coefficients; both positions are counted from the file's
posture."""


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
                label = f"'{equality.name}'" if equality.name else f"<{kind}> (number {number})"
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
    if len(wraps) != 2 or any(wrap.type != mujoco.mjtWrap.mjWRAP_JOINT for wrap in wraps):
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
        ends = [wrap.target for wrap in wraps]
        joints = [e.name for e, w in zip(ends, wraps, strict=True) if w.type == _JOINT]
        bodies = [e.parent for e, w in zip(ends, wraps, strict=True) if w.type == _SITE]
    else:
        on_sites = equality.objtype == mujoco.mjtObj.mjOBJ_SITE
        joints, bodies = [], [spec.site(n).parent if on_sites else spec.body(n) for n in names]
    chains = [_carriers(body) for body in bodies]
    for chain in chains:  # what carries both ends does not move one against the other
        joints += [n for n in chain if len(chains) == 1 or not all(n in c for c in chains)]
    return tuple(dict.fromkeys(joints))


_JOINT, _SITE = mujoco.mjtWrap.mjWRAP_JOINT, mujoco.mjtWrap.mjWRAP_SITE


def _carriers(body: mujoco.MjsBody) -> list[str]:
    """Joints between a body and the world."""
    found: list[str] = []
    while body.name != "world":
        found += [joint.name for joint in body.joints]
        body = body.parent
    return found


def _travels(model: mujoco.MjModel, couplings: _Couplings) -> dict[str, Travel]:
    names = [model.joint(j).name for j in range(model.njnt)]
    zero = {name: float(model.qpos0[model.jnt_qposadr[j]]) for j, name in enumerate(names)}
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
    spec: mujoco.MjSpec, body: mujoco.MjsBody, model: mujoco.MjModel, held: dict[str, float]
) -> None:
    """Take a body's held joints out and pose it where they hold it.

    Joints of one body move it one after the other; those before a held one are seen from
    where it takes the body.
    """
    place, turn = model.body(body.name).pos.copy(), model.body(body.name).quat.copy()
    before: list[tuple[mujoco.MjsJoint, Array, Array]] = []
    posed = False
    for joint in list(body.joints):
        known = model.joint(joint.name)
        anchor, axis = known.pos.copy(), known.axis.copy()
        if joint.name not in held:
            before.append((joint, anchor, axis))
            continue
        way = held[joint.name] - float(known.qpos0[0])
        slides = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
        spec.delete(joint)
        if way:
            by = _turn(axis, 0.0 if slides else way)
            shift = axis * way if slides else anchor - _turned(anchor, by)
            place, turn = place + _turned(shift, turn), _product(turn, by)
            back = by * [1, -1, -1, -1]
            before = [(j, _turned(p - shift, back), _turned(e, back)) for j, p, e in before]
            posed = True
    if posed:
        _pose(body, place, turn, before)


def _pose(
    body: mujoco.MjsBody,
    place: Array,
    turn: Array,
    joints: list[tuple[mujoco.MjsJoint, Array, Array]],
) -> None:
    """Set a body's pose in its carrier, and its joints' anchors and axes."""
    body.set_frame(body.parent.add_frame())  # out of frames that would move it once more
    body.pos, body.quat = place, turn
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    for joint, anchor, axis in joints:
        joint.set_frame(body.add_frame())
        joint.pos, joint.axis = anchor, axis


def _turn(axis: Array, angle: float) -> Array:
    quaternion = np.empty(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    return quaternion


def _turned(vector: Array, quaternion: Array) -> Array:
    result = np.empty(3)
    mujoco.mju_rotVecQuat(result, vector, quaternion)
    return result


def _product(first: Array, second: Array) -> Array:
    result = np.empty(4)
    mujoco.mju_mulQuat(result, first, second)
    return result
