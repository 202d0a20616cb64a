"""What acts of itself in an MJCF file and is no rigid body's: left out, and said.

A tree knows inertia, gravity, friction and motors. What MuJoCo calls passive forces besides,
springs above all, would make its plant another robot than the one that is identified.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from testbed.robot.formats.mjcf_compile import resolved
from testbed.robot.repair import listed


def drop_tendons(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Take all tendons out.

    Returns:
        A line that names those that would act.
    """
    acting = []
    for number, tendon in enumerate(list(spec.tendons), start=1):
        acts = (*tendon.stiffness, *tendon.damping, tendon.armature, tendon.frictionloss)
        stops = tendon.limited != mujoco.mjtLimited.mjLIMITED_FALSE and np.any(tendon.range)
        if any(acts) or stops:
            acting.append(tendon.name or f"number {number}")
        spec.delete(tendon)
    return _left_out({"the tendons": acting})


def drop_passive_forces(spec: mujoco.MjSpec, path: Path) -> tuple[str, ...]:
    """Take out springs, damping that is not linear, gravity compensation and fluid.

    Args:
        spec: The model, which is changed.
        path: Its file, for messages.

    Returns:
        A line for each kind that would act, with the joints or bodies where it is.
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
    lines = _left_out(
        {
            "springs of": springs,
            "damping that grows faster than the speed of": curved,
            "gravity compensation of": floating,
        }
    )
    return (*lines, *(["left out: the fluid around the robot"] if fluid else []))


def _dampers_of_springs(spec: mujoco.MjSpec, path: Path) -> dict[str, float]:
    """Damping that MuJoCo's compiler finds for springs that files say by their time and ratio."""
    names = [joint.name for joint in spec.joints if np.all(joint.springdamper)]
    if not names:
        return {}
    model, _ = resolved(spec, path)
    return {n: float(np.ravel(model.dof_damping[model.joint(n).dofadr[0]])[0]) for n in names}


def _left_out(found: dict[str, list[str]]) -> tuple[str, ...]:
    return tuple(f"left out: {what} {listed(names)}" for what, names in found.items() if names)
