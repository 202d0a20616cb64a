"""Friction that no model file can state: at low speed, under load, warming up, with a memory.

All of it acts at the joints and none reaches the plate. What jumps where a motion reverses is
smoothed over a small speed, since forces are held over a step: sign(v) is tanh(v / 0.01). Only
friction that grows with the load is solved with the motion, and needs no such speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt, Le

from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError
from testbed.core.robot.friction import (
    COULOMB,
    ROOM,
    ROTOR,
    VISCOUS,
    WARM_VISCOUS,
    fading,
    joint_law,
    stribeck,
)
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.tree import Tree
from testbed.lab.simulation.effect import Effect, StepForces
from testbed.lab.simulation.gear_friction import Gears
from testbed.sensors.kind_table import PerJoint, each_joint

SMOOTH = 0.01
"""Speed over which a sign is smoothed [rad/s or m/s]."""


class LawFriction(Effect):
    """Friction by laws of the velocity: coefficients times columns, jumps smoothed."""

    def forces(self, tree: Tree, step: float) -> StepForces:
        """Torques of the terms."""
        del step
        terms = self.terms(tree)

        def push(time: float, q: Array, qd: Array, motor: Array) -> Array:
            del time, q, motor
            rest = np.zeros_like(qd)
            each = (size * law.columns(qd, rest, SMOOTH) for law, size in terms.items())
            return -sum(each, rest)

        return push


@dataclass(frozen=True, eq=False)
class Stribeck(LawFriction):
    """Friction that is higher at low speed: coefficient sign(v) exp(-(v / speed)^2).

    It comes on top of the joints' own dry and viscous friction.

    Source    Our own choice: half a PUMA's dry friction, below 0.1 rad/s.

    Attributes:
        coefficient: What dry friction at rest has more [N m or N].
        speed: Above which it fades out [rad/s or m/s].
    """

    kind: ClassVar[str] = "stribeck_friction"
    coefficient: Annotated[PerJoint, Ge(0)] = 3.0
    speed: Annotated[PerJoint, Gt(0)] = 0.08

    def terms(self, tree: Tree) -> Mapping[JointLaw, Array]:
        """One law a speed."""
        del tree
        size, speed = each_joint(self.coefficient), each_joint(self.speed)
        return {stribeck(v): size * (speed == v) for v in speed.ravel().tolist()}


@dataclass(frozen=True, eq=False)
class FrictionTerm(LawFriction):
    """Friction by any term of the joints' torques that estimates know: coefficient times column.

    It comes on top of the joints' own dry and viscous friction.

    Source    Our own choice.

    Attributes:
        term: Its name, as "quadratic", "square_root" or "stribeck@0.1".
        coefficient: In the units of the term.
    """

    kind: ClassVar[str] = "friction_term"
    term: str = "quadratic"
    coefficient: PerJoint = 1.0

    def terms(self, tree: Tree) -> Mapping[JointLaw, Array]:
        """The law of that name."""
        del tree
        law = joint_law(self.term)
        if law.by or law.parameter == ROTOR.parameter:
            raise SettingsError(
                f"friction_term: '{self.term}' depends on more than the velocity"
            )
        return {law: each_joint(self.coefficient)}


@dataclass(frozen=True, eq=False)
class LoadFriction(Effect):
    """Friction of gears that grows with the load, the torque T that moves the link.

    It takes sign(v) (c + loss abs(T)) + (viscous + viscous_load abs(T)) v instead of dry and
    viscous friction, which are the model's; the loss is another one where the motion drives the
    gear back. Gears of efficiency e lose 1 / e - 1 of T when they drive and 1 - e when they are
    driven. c is higher at low speed: coulomb (1 + (static - 1) exp(-(v / speed)^2)). Solved at
    every step together with the acceleration, on which T depends.

    Source    Duclusaud et al., arXiv 2410.08650 (2024), models M3 to M5. Sizes are our own choice:
        gears lose 3 to 10 % of the torque that they pass on.

    Attributes:
        share: Lost when the gear drives.
        driven: Lost when it is driven, as a multiple of the share.
        viscous_load: Viscous friction that a unit of load adds [s/rad or s/m].
        static: Dry friction at rest over that in motion.
        speed: Above which the difference fades out [rad/s or m/s].
    """

    kind: ClassVar[str] = "load_friction"
    owns_friction: ClassVar[bool] = True
    share: Annotated[PerJoint, Ge(0), Le(0.9)] = 0.05
    driven: Annotated[PerJoint, Ge(0), Le(1)] = 1.0
    viscous_load: Annotated[PerJoint, Ge(0)] = 0.0
    static: Annotated[PerJoint, Ge(1), Le(10)] = 1.0
    speed: Annotated[PerJoint, Gt(0)] = 0.08

    def gears(self, tree: Tree) -> Gears:
        """Of all joints."""
        share, one = each_joint(self.share), np.ones(tree.n)
        return Gears(
            coulomb=COULOMB.coefficients(tree),
            static=one * each_joint(self.static),
            speed=one * each_joint(self.speed),
            viscous=VISCOUS.coefficients(tree),
            driving=one * share,
            driven=one * share * each_joint(self.driven),
            viscous_load=one * each_joint(self.viscous_load),
        )


@dataclass(frozen=True, eq=False)
class WarmingDrives(Effect):
    """Drives that warm up, from 25 degC, and whose viscous friction changes with it.

    The recording has their temperature: 25 degC + rise (1 - exp(-t / time_constant)). The joints'
    viscous friction is the model's, times 1 + viscous (temperature - 25 degC).

    Source    Our own choice: greases lose 1 to 3 % of their viscosity a kelvin.

    Attributes:
        rise: Of the temperature [K].
        time_constant: In which most of it happens [s].
        viscous: Relative change of viscous friction a kelvin [1/K].
    """

    kind: ClassVar[str] = "warming_drives"
    rise: Annotated[PerJoint, Ge(-100), Le(100)] = 20.0
    time_constant: Annotated[float, Gt(0)] = 60.0
    viscous: PerJoint = -0.02

    def temperature(self, time: Array) -> Array:
        """Of the drives, (M, n) or (M, 1) [degC]."""
        warm = -np.expm1(-np.maximum(time, 0.0) / self.time_constant)
        return ROOM + np.outer(warm, each_joint(self.rise))

    def forces(self, tree: Tree, step: float) -> StepForces:
        """What viscous friction has more than at 25 degC."""
        del step
        change = self.terms(tree)[WARM_VISCOUS]

        def push(time: float, q: Array, qd: Array, motor: Array) -> Array:
            del q, motor
            warmth = self.temperature(np.array([time]))[0] - ROOM
            return np.asarray(-change * warmth * qd)

        return push

    def terms(self, tree: Tree) -> Mapping[JointLaw, Array]:
        """Viscous friction's change."""
        return {WARM_VISCOUS: VISCOUS.coefficients(tree) * each_joint(self.viscous)}


@dataclass(frozen=True, eq=False)
class LuGreFriction(Effect):
    """Friction with a memory, of bristles that bend before they slip, instead of dry friction.

    With deflection z: dz/dt = v - stiffness abs(v) z / g(v), friction = stiffness z + damping dz/dt
    + viscous v, g(v) = coulomb (1 + (static - 1) exp(-(v / speed)^2)). Dry and viscous friction are
    the model's.

    Source    Canudas de Wit et al., IEEE Transactions on Automatic Control 40 (1995) 419.

    Attributes:
        static: Friction at rest over dry friction in motion.
        speed: Above which the difference fades out [rad/s or m/s].
        stiffness: Of the bristles [N m/rad or N/m].
        damping: Of the bristles [N m s/rad or N s/m].
    """

    kind: ClassVar[str] = "lugre_friction"
    owns_friction: ClassVar[bool] = True
    static: Annotated[PerJoint, Ge(1), Le(10)] = 1.5
    speed: Annotated[PerJoint, Gt(0)] = 0.08
    stiffness: Annotated[PerJoint, Gt(0)] = 2e4
    damping: Annotated[PerJoint, Ge(0)] = 50.0

    def forces(self, tree: Tree, step: float) -> StepForces:
        """Of bristles that are straight at first."""
        dry, wet = COULOMB.coefficients(tree), VISCOUS.coefficients(tree)
        static, speed = each_joint(self.static), each_joint(self.speed)
        stiff, damping = each_joint(self.stiffness), each_joint(self.damping)
        bent = np.zeros(tree.n)

        def push(time: float, q: Array, qd: Array, motor: Array) -> Array:
            del time, q, motor
            nonlocal bent
            slip = dry * (1 + (static - 1) * fading(qd, speed))
            before = bent
            bent = _bent(before, qd, slip, stiff, step)
            rate = (bent - before) / step
            return -(stiff * bent + damping * rate + wet * qd)

        return push


def _bent(
    before: Array, velocity: Array, slip: Array, stiff: Array, step: float
) -> Array:
    """Deflection after a step of constant velocity: exact, so that it never overshoots."""
    tiny = np.finfo(float).tiny
    decay = np.maximum(step * stiff * np.abs(velocity) / np.maximum(slip, 1e-99), tiny)
    return before * np.exp(-decay) - velocity * step * np.expm1(-decay) / decay
