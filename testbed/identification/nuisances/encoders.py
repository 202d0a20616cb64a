"""Encoders whose zero or scale is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.arrays import Array
from testbed.identification.nuisances.foretold import Foretold
from testbed.identification.nuisances.nuisance import Nuisance, Part
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree


def _zeros(tree: Tree) -> tuple[Part, ...]:
    units = ("rad" if joint.revolute else "m" for joint in tree.joints)
    return tuple(Part(f"joint_zeros/{j}", u) for j, u in zip(tree.names, units, strict=True))


def _gains(tree: Tree) -> tuple[Part, ...]:
    return tuple(Part(f"encoder_gains/{joint}", "") for joint in tree.names)


def _moved(foretold: Foretold) -> Array:
    return _derivatives(foretold, scaled=False)


def _scaled(foretold: Foretold) -> Array:
    return _derivatives(foretold, scaled=True)


def _derivatives(foretold: Foretold, scaled: bool) -> Array:
    """The robot was where the encoders show it less their errors."""
    each = [-foretold.along(joint, scaled) for joint in range(foretold.tree.n)]
    return foretold.rows(np.stack(each, axis=2))


def _back(recording: Recording, values: Array, time: Array) -> Recording:
    del time
    return replace(recording, position=recording.position - values)


JOINT_ZEROS = Nuisance("joint_zeros", "zeros of the encoders that are off", _zeros, _moved, _back)
"""What the encoders show too much."""

ENCODER_GAINS = Nuisance(
    "encoder_gains",
    "scales of the encoders that are wrong",
    _gains,
    _scaled,
    cure="correct the encoders' scales",
)
"""Relative."""
