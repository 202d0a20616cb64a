"""A plate's frame that is turned by any angle, from the best map of all; no list of hypotheses."""

from __future__ import annotations

from itertools import product

import numpy as np

from testbed.arrays import Array
from testbed.recordings.importing.foreign_units import FORCES, MOMENTS
from testbed.robot.rotations import from_rpy, from_vector, to_rpy
from testbed.sanity.explanation import Explanation
from testbed.sanity.mistakes import AS_READ, PLATE_ORDERS, STEPS, Mistake, turned
from testbed.sanity.plate_map import LATE, SHIFT, TURN, placed
from testbed.sanity.position_reading import Reading

SNAPPED = 0.02
"""Distance of a turn's matrix to one by multiples of 15 degrees from which that is tried."""

ALIKE = 0.2
"""By how much the turns of forces and of moments in the best map may differ."""

NEAR = 0.1
"""By how much the ratio of gains in the best map may be off for a pair of units to be tried."""


def any_turn(reading: Reading) -> list[Explanation]:
    """Explanations by a frame turned by any angle: that of the best map of all, refined."""
    from scipy.linalg import polar

    if reading.plate is None:
        return []
    frame, found = reading.prior.frame, []
    at_once, late = (reading.plate.best_map(late=late)[1] for late in (False, True))
    given = MOMENTS[frame.units[1]] / FORCES[frame.units[0]]
    for best, order in product((at_once, late), (AS_READ, *PLATE_ORDERS)):
        blind = best @ placed(frame.turn, frame.place)
        ordered = blind @ np.eye(6)[list(order)].T
        (turn, forces), (other, moments) = (polar(ordered[k : k + 3, k : k + 3]) for k in (0, 3))
        if np.linalg.norm(turn - other) > ALIKE:
            continue
        turn = turn * np.sign(np.linalg.det(turn))  # the opposite sense is no reflection
        ratio = np.trace(moments) / np.trace(forces) * given
        for units in product(FORCES, MOMENTS):
            if abs(MOMENTS[units[1]] / FORCES[units[0]] / ratio - 1) < NEAR:
                found += _turned_near(reading, turn, units, order)
    return found


def _turned_near(reading: Reading, turn: Array, units: tuple[str, str], order: tuple[int, ...]
                 ) -> list[Explanation]:  # fmt: skip
    """Explanations by a frame turned about so, and by what a person would write of it."""
    assert reading.plate is not None
    frame = reading.prior.frame
    for _ in range(3):
        judged = reading.plate.judge([frame.map(turn, units, order)], (*SHIFT, LATE, *TURN))
        turn = from_vector(judged.extras[0, list(TURN)]) @ turn
    written = from_rpy([round(angle / STEPS[-1]) * STEPS[-1] for angle in to_rpy(turn)])
    mistakes = [Mistake("plate_order", (), order)] * (order != AS_READ)
    mistakes += [Mistake("units", (), units)] * (units != frame.units)
    found = []
    for each in (turn, written) if np.linalg.norm(turn - written) < SNAPPED else (turn,):
        found += reading.of_plate([(*mistakes, turned(each))], [frame.map(each, units, order)])
    return found
