"""Joint friction beyond model files: Stribeck, load-dependent, warming up, LuGre.

It acts at the joints and does not change the base wrench of a given motion. Laws that jump at
reversals are smoothed over a small speed, since forces are held over a step: sign(v) is
tanh(v / 0.01). Load-dependent friction is solved with the acceleration, without smoothing.
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
    ROOM_TEMPERATURE,
    ROTOR,
    VISCOUS,
    WARM_VISCOUS,
    joint_law,
    stribeck_decay,
    stribeck_law,
)
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.tree import Tree
from testbed.lab.simulation.effect import Effect, ForceFunction
from testbed.lab.simulation.gear_friction import Gears
from testbed.sensors.kind_table import PerJoint, joint_array

SIGN_SMOOTHING_SPEED = 0.01
"""Speed over which sign(v) is smoothed [rad/s or m/s]."""


class LawFriction(Effect):
    """Base class of friction effects that depend on velocity only.

    The friction is the sum of coefficients times regressor columns, smoothed at velocity reversals.
    """

    def force_function(self, tree: Tree, step: float) -> ForceFunction:
        """Function for the joint forces `-coefficient * column`, summed over the laws."""
        del step
        terms = self.true_coefficients(tree)

        def push(time: float, q: Array, qd: Array, motor: Array) -> Array:
            del time, q, motor
            rest = np.zeros_like(qd)
            torques = (
                size * law.columns(qd, rest, SIGN_SMOOTHING_SPEED)
                for law, size in terms.items()
            )
            return -sum(torques, rest)

        return push


@dataclass(frozen=True, eq=False)
class Stribeck(LawFriction):
    """Stribeck friction, which is larger at low speed.

    The torque is coefficient sign(v) exp(-(v / speed)^2), in addition to the joints' dry and
    viscous friction.

    Source    Our own choice: half a PUMA's dry friction, below 0.1 rad/s.

    Attributes:
        coefficient: Additional dry friction at rest [N m or N].
        speed: Stribeck speed, above which this friction decays [rad/s or m/s].
    """

    kind: ClassVar[str] = "stribeck_friction"
    coefficient: Annotated[PerJoint, Ge(0)] = 3.0
    speed: Annotated[PerJoint, Gt(0)] = 0.08

    def true_coefficients(self, tree: Tree) -> Mapping[JointLaw, Array]:
        """Coefficients of Stribeck laws, one law per distinct Stribeck speed."""
        del tree
        size, speed = joint_array(self.coefficient), joint_array(self.speed)
        return {stribeck_law(v): size * (speed == v) for v in speed.ravel().tolist()}


@dataclass(frozen=True, eq=False)
class FrictionTerm(LawFriction):
    """Friction by one of the estimator's velocity laws.

    The torque is the coefficient times the law's function of velocity, in addition to the joints'
    dry and viscous friction.

    Source    Our own choice.

    Attributes:
        term: Name of the law, such as "quadratic", "square_root" or "stribeck@0.1".
        coefficient: Coefficient in the units of the law.
    """

    kind: ClassVar[str] = "friction_term"
    term: str = "quadratic"
    coefficient: PerJoint = 1.0

    def true_coefficients(self, tree: Tree) -> Mapping[JointLaw, Array]:
        """Coefficients of the friction law named by `term`, (n,) or ().

        Raises:
            SettingsError: The law depends on more than the velocity, for example on the load.
        """
        del tree
        law = joint_law(self.term)
        if law.by or law.parameter == ROTOR.parameter:
            raise SettingsError(
                f"friction_term: '{self.term}' depends on more than the velocity"
            )
        return {law: joint_array(self.coefficient)}


@dataclass(frozen=True, eq=False)
class LoadFriction(Effect):
    """Gear friction that increases with the load, the torque T on the link.

    Friction is sign(v) (c + loss abs(T)) + (viscous + viscous_load abs(T)) v. It replaces the dry
    and viscous friction of the model, with the same coefficients. c is larger at low speed: coulomb
    (1 + (static - 1) exp(-(v / speed)^2)). The loss has another value where the motion drives the
    gear back: a gear of efficiency e loses 1 / e - 1 of T when driving and 1 - e when driven. Since
    T depends on the acceleration, both are solved together at every step.

    Source    Duclusaud et al., arXiv 2410.08650 (2024), models M3 to M5. Sizes are our own choice:
        gears lose 3 to 10 % of the torque that they pass on.

    Attributes:
        share: Loss, relative to the load, when the gear drives.
        driven: Loss when the gear is driven back, as a multiple of `share`.
        viscous_load: Viscous friction per unit of load [s/rad or s/m].
        static: Ratio of dry friction at rest to that in motion.
        speed: Speed above which the additional friction at rest decays [rad/s or m/s].
    """

    kind: ClassVar[str] = "load_friction"
    owns_friction: ClassVar[bool] = True
    share: Annotated[PerJoint, Ge(0), Le(0.9)] = 0.05
    driven: Annotated[PerJoint, Ge(0), Le(1)] = 1.0
    viscous_load: Annotated[PerJoint, Ge(0)] = 0.0
    static: Annotated[PerJoint, Ge(1), Le(10)] = 1.0
    speed: Annotated[PerJoint, Gt(0)] = 0.08

    def gear_friction(self, tree: Tree) -> Gears:
        """Gear friction coefficients of all joints, with the tree's dry and viscous friction."""
        share, one = joint_array(self.share), np.ones(tree.n)
        return Gears(
            coulomb=COULOMB.coefficients(tree),
            static=one * joint_array(self.static),
            speed=one * joint_array(self.speed),
            viscous=VISCOUS.coefficients(tree),
            driving=one * share,
            driven=one * share * joint_array(self.driven),
            viscous_load=one * joint_array(self.viscous_load),
        )


@dataclass(frozen=True, eq=False)
class WarmingDrives(Effect):
    """Drives that warm up from 25 degC, with viscous friction that depends on temperature.

    The temperature, which is recorded, is 25 degC + rise (1 - exp(-t / time_constant)). The viscous
    friction of the joints is multiplied by 1 + viscous (temperature - 25 degC).

    Source    Our own choice: greases lose 1 to 3 % of their viscosity a kelvin.

    Attributes:
        rise: Final rise of the temperature [K].
        time_constant: Time constant of the rise [s].
        viscous: Relative change of viscous friction per kelvin [1/K].
    """

    kind: ClassVar[str] = "warming_drives"
    rise: Annotated[PerJoint, Ge(-100), Le(100)] = 20.0
    time_constant: Annotated[float, Gt(0)] = 60.0
    viscous: PerJoint = -0.02

    def temperature(self, time: Array) -> Array:
        """Temperature of the drives, (M, n) or (M, 1) [degC]; 25 degC until t = 0."""
        warm = -np.expm1(-np.maximum(time, 0.0) / self.time_constant)
        return ROOM_TEMPERATURE + np.outer(warm, joint_array(self.rise))

    def force_function(self, tree: Tree, step: float) -> ForceFunction:
        """Function for the forces due to the change of viscous friction from 25 degC."""
        del step
        change = self.true_coefficients(tree)[WARM_VISCOUS]

        def push(time: float, q: Array, qd: Array, motor: Array) -> Array:
            del q, motor
            temperature_rise = self.temperature(np.array([time]))[0] - ROOM_TEMPERATURE
            return np.asarray(-change * temperature_rise * qd)

        return push

    def true_coefficients(self, tree: Tree) -> Mapping[JointLaw, Array]:
        """Change of viscous friction per kelvin, for the law `WARM_VISCOUS`, (n,)."""
        return {WARM_VISCOUS: VISCOUS.coefficients(tree) * joint_array(self.viscous)}


@dataclass(frozen=True, eq=False)
class LuGreFriction(Effect):
    """LuGre friction, with elastic bristles that deflect before the joint slips.

    With the bristle deflection z: dz/dt = v - stiffness abs(v) z / g(v), friction = stiffness z +
    damping dz/dt + viscous v, g(v) = coulomb (1 + (static - 1) exp(-(v / speed)^2)). The law
    replaces the dry and viscous friction of the model, with the same Coulomb and viscous
    coefficients.

    Source    Canudas de Wit et al., IEEE Transactions on Automatic Control 40 (1995) 419.

    Attributes:
        static: Ratio of friction at rest to dry friction in motion.
        speed: Speed above which the additional friction at rest decays [rad/s or m/s].
        stiffness: Stiffness of the bristles [N m/rad or N/m].
        damping: Damping of the bristles [N m s/rad or N s/m].
    """

    kind: ClassVar[str] = "lugre_friction"
    owns_friction: ClassVar[bool] = True
    static: Annotated[PerJoint, Ge(1), Le(10)] = 1.5
    speed: Annotated[PerJoint, Gt(0)] = 0.08
    stiffness: Annotated[PerJoint, Gt(0)] = 2e4
    damping: Annotated[PerJoint, Ge(0)] = 50.0

    def force_function(self, tree: Tree, step: float) -> ForceFunction:
        """Function for the forces of LuGre friction, with undeflected bristles at the start.

        The function stores the deflection between calls and must be called once per step.
        """
        dry, viscous = COULOMB.coefficients(tree), VISCOUS.coefficients(tree)
        static, speed = joint_array(self.static), joint_array(self.speed)
        stiffness, damping = joint_array(self.stiffness), joint_array(self.damping)
        deflection = np.zeros(tree.n)

        def push(time: float, q: Array, qd: Array, motor: Array) -> Array:
            del time, q, motor
            nonlocal deflection
            slip_force = dry * (1 + (static - 1) * stribeck_decay(qd, speed))
            previous = deflection
            deflection = _bristle_deflection(previous, qd, slip_force, stiffness, step)
            rate = (deflection - previous) / step
            return -(stiffness * deflection + damping * rate + viscous * qd)

        return push


def _bristle_deflection(
    previous: Array, velocity: Array, slip_force: Array, stiffness: Array, step: float
) -> Array:
    """Bristle deflection after a step of constant velocity, (n,) [rad or m].

    This is the exact solution of the differential equation, so it does not overshoot for any step
    size.

    Args:
        previous: Deflection before the step, (n,) [rad or m].
        velocity: Joint velocity, (n,) [rad/s or m/s].
        slip_force: Friction g(v) at which the bristles slip, (n,) [N m or N].
        stiffness: Stiffness of the bristles, (n,) [N m/rad or N/m].
        step: Integration step [s].
    """
    tiny = np.finfo(float).tiny
    decay = np.maximum(
        step * stiffness * np.abs(velocity) / np.maximum(slip_force, 1e-99), tiny
    )
    return previous * np.exp(-decay) - velocity * step * np.expm1(-decay) / decay
