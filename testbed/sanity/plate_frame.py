"""How a plate's frame is turned, in which units and order its columns are: fitted, not listed.

For one order of columns, everything else that a mapping says of a plate is a turn, a place, a ratio
of gains and a delay. Gauss's and Newton's steps on these (`PlateRows.judge`), from the 24 turns
that take axes to axes, all at once, end in the least of all turns: none is further than 63 degrees
from a start. Units are those pairs whose ratio is near, and a turn that a person would write is
tried where one is near.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from testbed.arrays import Array
from testbed.recordings.importing.foreign_units import FORCES, MOMENTS
from testbed.robot.rotations import from_rpy, from_vector, to_rpy
from testbed.sanity.mistakes import AS_READ, STEPS, Frame, Mistake, turned
from testbed.sanity.plate_map import LATE, RATIO, SHIFT, TURN, PlateRows, quarter_turns

ROUNDS, LARGEST_TURN, LARGEST_RATIO = 7, 0.5, 0.7
"""Of Gauss and Newton; their largest steps of a turn [rad] and of the ratio's logarithm."""

SNAPPED = 0.02
"""Distance of a turn's matrix to one by multiples of 15 degrees from which that is tried."""

NEAR = 0.1
"""By how much the ratio of gains may be off for a pair of units to be tried."""

Hypothesis = tuple[tuple[Mistake, ...], Array]
"""Mistakes about a plate, and the map that undoes them, (6, 6)."""


def frame_hypotheses(plate: PlateRows, frame: Frame, order: Sequence[int]) -> Iterator[Hypothesis]:
    """The turns and units that explain a plate best, its columns in one order.

    The sense is the sign of what the model file predicts; shift and delay are fitted beside.

    Args:
        plate: Products of its channels.
        frame: How the mapping has read it.
        order: In which column each channel is.
    """
    turn, ratio = _fitted(plate, frame, order)
    given = MOMENTS[frame.units[1]] / FORCES[frame.units[0]]
    for units in product(FORCES, MOMENTS):
        if abs(MOMENTS[units[1]] / FORCES[units[0]] / (ratio * given) - 1) > NEAR:
            continue
        exact = _refined(plate, frame, turn, units, order)
        angles = [round(angle / STEPS[-1]) * STEPS[-1] for angle in to_rpy(exact)]
        written = from_rpy(angles)
        both = (exact, written) if np.linalg.norm(exact - written) < SNAPPED else (exact,)
        for each in both:
            mistakes = [Mistake("plate_order", (), tuple(order))] * (tuple(order) != AS_READ)
            mistakes += [Mistake("units", (), units)] * (units != frame.units)
            mistakes += [turned(each)] * bool(np.linalg.norm(each - frame.turn) > 1e-6)
            yield tuple(mistakes), frame.map(each, units, order)


def _fitted(plate: PlateRows, frame: Frame, order: Sequence[int]) -> tuple[Array, float]:
    """The best turn of the frame, (3, 3), and how many times too small its moments are."""
    turns = [turn @ frame.turn for turn in quarter_turns()]
    ratios = np.full(len(turns), plate.gain_ratio(frame.map(frame.turn, frame.units, order)))
    for _ in range(ROUNDS):
        maps = [
            frame.map(turn, frame.units, order, ratio)
            for turn, ratio in zip(turns, ratios, strict=True)
        ]
        judged = plate.judge(maps, (*SHIFT, LATE, *TURN, RATIO))
        best = int(np.argmin(judged.left.sum(axis=1)))
        steps = judged.extras[:, list(TURN)]
        size = np.linalg.norm(steps, axis=1, keepdims=True)
        steps = steps * np.minimum(1, LARGEST_TURN / np.maximum(size, LARGEST_TURN))
        turns = [from_vector(step) @ turn for step, turn in zip(steps, turns, strict=True)]
        change = np.clip(judged.extras[:, RATIO], -LARGEST_RATIO, LARGEST_RATIO)
        ratios = ratios * np.exp(change)
    return turns[best], float(ratios[best])


def _refined(
    plate: PlateRows, frame: Frame, turn: Array, units: tuple[str, str], order: Sequence[int]
) -> Array:
    """The turn with gains of these units, (3, 3)."""
    for _ in range(3):
        judged = plate.judge([frame.map(turn, units, order)], (*SHIFT, LATE, *TURN))
        turn = from_vector(judged.extras[0, list(TURN)]) @ turn
    return turn
