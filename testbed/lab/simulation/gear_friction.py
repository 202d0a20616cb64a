"""Friction of gears under load: it depends on the torque that they pass on, and that one on it.

The equation is implicit, and of all joints at once: what friction takes at one changes how all of
them accelerate, and with that what their rotors leave for the links. It is solved for the friction
that acts over a step; dry friction holds a joint that would otherwise turn round within it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.kernel.compiler import outer, plain

SWEEPS = 200
"""Most passes over the joints; a robot's masses need about ten."""

EXACT = 1e-13
"""Change of all frictions, beside the largest, that is rounding."""


class Gears(NamedTuple):
    """Friction of every joint's gear, (n,) each.

    With the torque T that moves the link it takes sign(v) (coulomb (1 + (static - 1)
    exp(-(v / speed)^2)) + loss abs(T)) + (viscous + viscous_load abs(T)) v, where the loss is
    `driving` if T drives the motion, and `driven` if the motion drives it back.
    """

    coulomb: Array  # [N m or N]
    static: Array  # over dry friction in motion
    speed: Array  # [rad/s or m/s]
    viscous: Array  # [N m s/rad or N s/m]
    driving: Array
    driven: Array
    viscous_load: Array  # [s/rad or s/m]


@outer
def solve_friction(
    gears: Gears,
    step: float,
    velocity: Array,
    free: Array,
    loose: Array,
    force: Array,
    rotor: Array,
    friction: Array,
) -> None:
    """What gears take over a step, by Gauss and Seidel's sweeps; compiled.

    Each joint's own equation is linear on either side of a load of zero but for the speed in the
    middle of the step, at which the load's viscous friction is taken: that is the last sweep's.

    Args:
        gears: Their friction.
        step: [s].
        velocity: At its beginning, (n,) [rad/s or m/s].
        free: Accelerations without this friction, (n,).
        loose: How much more a force on one joint accelerates another, (n, n).
        force: Of motors and whatever else acts on the joints, (n,) [N m or N].
        rotor: Inertias, (n,) [kg m^2 or kg].
        friction: Where to begin; set, (n,) [N m or N].
    """
    n = len(velocity)
    for _ in range(SWEEPS):
        moved, largest = 0.0, 0.0
        for j in range(n):
            rate = free[j]
            for k in range(n):
                if k != j:
                    rate -= loose[j, k] * friction[k]
            found = _at_joint(
                gears,
                j,
                step,
                velocity[j],
                rate,
                loose[j, j],
                force[j],
                rotor[j],
                friction[j],
            )
            moved = max(moved, abs(found - friction[j]))
            largest = max(largest, abs(found))
            friction[j] = found
        if moved <= EXACT * largest:
            return


@plain
def _at_joint(
    gears: Gears,
    j: int,
    step: float,
    velocity: float,
    rate: float,
    loose: float,
    force: float,
    rotor: float,
    before: float,
) -> float:
    """Of one joint, those of the others given; `rate` is its acceleration without its own."""
    end, gives = velocity + step * rate, step * loose
    # a unit of friction takes so much
    load, passes = (
        force - rotor * rate,
        1.0 - rotor * loose,
    )
    dip = (velocity / gears.speed[j]) ** 2
    dry = gears.coulomb[j] * (1.0 + (gears.static[j] - 1.0) * np.exp(-dip))
    held = end / gives
    sign = 1.0 if held > 0 else -1.0
    left = load - passes * held
    loss = gears.driving[j] if left * sign > 0 else gears.driven[j]
    if abs(held) <= dry + loss * abs(left):
        return held
    middle, wet = (velocity + end) / 2.0, gears.viscous[j]
    found, by_load = held, gears.viscous_load[j] * (middle - gives * before / 2.0)
    for side in (1.0, -1.0):  # driving, driven
        loss = side * (
            (gears.driving[j] if side > 0 else gears.driven[j]) + sign * by_load
        )
        kept = 1.0 + loss * passes + wet * gives / 2.0
        if kept <= 0:  # a gear that is driven takes all and more: it locks itself
            return held
        found = (sign * dry + loss * load + wet * middle) / kept
        if side * sign * (load - passes * found) >= 0:
            break
    return found
