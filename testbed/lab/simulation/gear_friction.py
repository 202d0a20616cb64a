"""Load-dependent friction of gears, solved together with the joint accelerations.

Friction depends on the torque that the gear transmits, and this torque depends on the friction:
the equation is implicit and couples all joints through the mass matrix. It is solved for the
friction that acts over a step; dry friction holds a joint that would otherwise reverse within it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.kernel.compiler import compiled_entry, compiled_function

MAX_SWEEPS = 200
"""Largest number of Gauss-Seidel sweeps; about ten suffice for a robot."""

CONVERGENCE_TOLERANCE = 1e-13
"""Change of friction, relative to the largest friction, at which the sweeps have converged."""


class Gears(NamedTuple):
    """Coefficients of load-dependent gear friction for each joint, (n,) each.

    With the torque T on the link and the joint velocity v, friction is sign(v) (coulomb (1 +
    (static - 1) exp(-(v / speed)^2)) + loss abs(T)) + (viscous + viscous_load abs(T)) v. The loss
    is `driving` if T drives the motion, and `driven` if the motion drives the gear back.
    """

    coulomb: Array  # [N m or N]
    static: Array  # ratio of dry friction at rest to that in motion
    speed: Array  # [rad/s or m/s]
    viscous: Array  # [N m s/rad or N s/m]
    driving: Array
    driven: Array
    viscous_load: Array  # [s/rad or s/m]


@compiled_entry
def solve_friction(
    gears: Gears,
    step: float,
    velocity: Array,
    free_acceleration: Array,
    inverse_mass: Array,
    force: Array,
    rotor: Array,
    friction: Array,
) -> None:
    """Solve for the gear friction over a step by Gauss-Seidel sweeps over the joints.

    The equation of a joint is linear for each sign of the load, except for the load-dependent
    viscous friction. The speed in that term, at the middle of the step, is taken from the previous
    sweep. The sweeps end at `CONVERGENCE_TOLERANCE` or after `MAX_SWEEPS`.

    Args:
        gears: Friction coefficients.
        step: Integration step [s].
        velocity: Velocities at the beginning of the step, (n,) [rad/s or m/s].
        free_acceleration: Accelerations without gear friction, (n,).
        inverse_mass: Inverse of the mass matrix: acceleration per force, (n, n).
        force: Forces of motors and other sources on the joints, (n,) [N m or N].
        rotor: Rotor inertias, (n,) [kg m^2 or kg].
        friction: Initial friction, set to the solution, (n,) [N m or N].
    """
    n = len(velocity)
    for _ in range(MAX_SWEEPS):
        change, largest = 0.0, 0.0
        for j in range(n):
            acceleration = free_acceleration[j]
            for k in range(n):
                if k != j:
                    acceleration -= inverse_mass[j, k] * friction[k]
            solution = _joint_friction(
                gears,
                j,
                step,
                velocity[j],
                acceleration,
                inverse_mass[j, j],
                force[j],
                rotor[j],
                friction[j],
            )
            change = max(change, abs(solution - friction[j]))
            largest = max(largest, abs(solution))
            friction[j] = solution
        if change <= CONVERGENCE_TOLERANCE * largest:
            return


@compiled_function
def _joint_friction(
    gears: Gears,
    j: int,
    step: float,
    velocity: float,
    acceleration: float,
    inverse_mass: float,
    force: float,
    rotor: float,
    previous: float,
) -> float:
    """Friction of a joint over a step, given the friction of the other joints [N m or N].

    The friction is the value that brings the joint to rest if dry friction and load loss can stop
    the joint within the step, or if the gear is self-locking.

    Args:
        gears: Friction coefficients.
        j: Joint index.
        step: Integration step [s].
        velocity: Velocity at the beginning of the step [rad/s or m/s].
        acceleration: Acceleration without the friction of this joint [rad/s^2 or m/s^2].
        inverse_mass: Acceleration of this joint per force on it [1/(kg m^2) or 1/kg].
        force: Force on the joint without friction [N m or N].
        rotor: Rotor inertia [kg m^2 or kg].
        previous: Friction of this joint after the previous sweep [N m or N].
    """
    free_velocity, velocity_per_friction = (
        velocity + step * acceleration,
        step * inverse_mass,
    )
    # load on the gear without friction, and its decrease per friction
    load, load_per_friction = (
        force - rotor * acceleration,
        1.0 - rotor * inverse_mass,
    )
    squared_speed_ratio = (velocity / gears.speed[j]) ** 2
    dry = gears.coulomb[j] * (
        1.0 + (gears.static[j] - 1.0) * np.exp(-squared_speed_ratio)
    )
    holding_friction = free_velocity / velocity_per_friction
    sign = 1.0 if holding_friction > 0 else -1.0
    held_load = load - load_per_friction * holding_friction
    loss = gears.driving[j] if held_load * sign > 0 else gears.driven[j]
    if abs(holding_friction) <= dry + loss * abs(held_load):
        return holding_friction
    mean_velocity, viscous = (velocity + free_velocity) / 2.0, gears.viscous[j]
    solution, load_viscous = (
        holding_friction,
        gears.viscous_load[j]
        * (mean_velocity - velocity_per_friction * previous / 2.0),
    )
    for side in (1.0, -1.0):  # driving, driven
        loss = side * (
            (gears.driving[j] if side > 0 else gears.driven[j]) + sign * load_viscous
        )
        denominator = (
            1.0 + loss * load_per_friction + viscous * velocity_per_friction / 2.0
        )
        if denominator <= 0:  # self-locking gear
            return holding_friction
        solution = (sign * dry + loss * load + viscous * mean_velocity) / denominator
        if side * sign * (load - load_per_friction * solution) >= 0:
            break
    return solution
