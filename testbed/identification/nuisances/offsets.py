"""Constants and trends of the plate's channels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.arrays import Array
from testbed.identification.nuisances.foretold import Foretold
from testbed.identification.nuisances.nuisance import Nuisance, Part
from testbed.recordings.columns import AXES, PLATE_UNITS
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree


def _constant(foretold: Foretold) -> Array:
    return np.broadcast_to(np.eye(6), (len(foretold.time), 6, 6))


def _trend(foretold: Foretold) -> Array:
    return np.asarray(foretold.time[:, None, None] * np.eye(6))


def _without_constant(recording: Recording, values: Array, time: Array) -> Recording:
    del time
    return replace(recording, wrench=recording.measured("wrench") - values)


def _without_trend(recording: Recording, values: Array, time: Array) -> Recording:
    return replace(recording, wrench=recording.measured("wrench") - time[:, None] * values)


def _channels(kind: str, per: str = "") -> tuple[Part, ...]:
    units = zip(AXES, PLATE_UNITS, strict=True)
    return tuple(Part(f"{kind}/{axis}", f"{unit}{per}") for axis, unit in units)


def _biases(tree: Tree) -> tuple[Part, ...]:
    del tree
    return _channels("bias")


def _slopes(tree: Tree) -> tuple[Part, ...]:
    del tree
    return _channels("slope", "/s")


def _tares(tree: Tree) -> tuple[Part, ...]:
    del tree
    return _channels("tare")


BIAS = Nuisance(
    "bias", "a zero of the plate that is off", _biases, _constant, _without_constant, passing=True
)

SLOPE = Nuisance("slope", "a drift of the plate", _slopes, _trend, _without_trend, passing=True)
"""From the middle of the recording."""

TARE = Nuisance("tare", "a wrong tare", _tares, _constant, _without_constant)
"""What the plate shows of the pedestal beyond the tare: to a fixed plate the same as a bias."""
