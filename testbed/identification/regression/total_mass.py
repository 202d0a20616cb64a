"""Mass and centre of mass of all moving bodies, as combinations of the minimal parameters.

A mass is a scale's reading, a centre of mass that of scales under three feet, or of a plumb line.
"""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import linear
from testbed.dynamics.motion import Motion
from testbed.errors import SettingsError, UnknownName
from testbed.parameters.minimal_set import MinimalSet
from testbed.robot.tree import Tree

MASS = "mass"
"""Of all moving bodies together, as the plate carries it [kg]."""

CENTRE = "centre/"
"""Of their mass, along an axis of the bedplate's frame [m]: centre/x with all joints at zero,
centre/x@elbow=1.57 with one of them elsewhere."""

IN_SPACE = 1e-9
"""Part of a combination that the minimal parameters cannot say, of one that they can."""

_LOADS = {"x": (2, 4, -1.0), "y": (2, 3, 1.0), "z": (0, 4, 1.0)}
"""By axis: along which one a unit of gravity has to pull, backwards, for the first moment along it
to be a channel of the wrench, and of which sign: a moment is the first moment x the force."""


def total_mass(tree: Tree, minimal: MinimalSet) -> Array:
    """The combination of minimal parameters that is the mass of all moving bodies, (N,) [kg].

    Args:
        tree: The robot.
        minimal: Its minimal parameters.

    Raises:
        SettingsError: No minimal parameters say it.
    """
    return _combination(minimal, _wrench(tree, np.zeros(tree.n), 2)[2], MASS)


def centre_of_mass(tree: Tree, minimal: MinimalSet, name: str, value: float) -> Array:
    """The combination that is zero where the centre of mass is at `value`, (N,) [kg m].

    It is their first moment less `value` times their mass.

    Args:
        tree: The robot.
        minimal: Its minimal parameters.
        name: Such as "centre/x", or "centre/x@elbow=1.57,waist=0.3".
        value: [m].

    Raises:
        UnknownName: There is no such axis or joint.
        SettingsError: The posture is none, or no minimal parameters say it.
    """
    axis, _, where = name.removeprefix(CENTRE).partition("@")
    if axis not in _LOADS:
        raise UnknownName("known fact", name, [f"{CENTRE}{each}" for each in _LOADS])
    pulled, channel, sign = _LOADS[axis]
    moment = sign * _wrench(tree, _posture(tree, name, where), pulled)[channel]
    return _combination(minimal, moment, name) - value * total_mass(tree, minimal)


def _posture(tree: Tree, name: str, where: str) -> Array:
    """Joint positions of words such as elbow=1.57,waist=0.3; zero where none is given, (n,)."""
    q = np.zeros(tree.n)
    for word in filter(None, where.split(",")):
        joint, _, number = word.rpartition("=")
        try:
            q[tree.index(joint)] = float(number)
        except ValueError:
            q[:] = np.nan
        if not np.isfinite(q).all():
            raise SettingsError(f"'{name}': write a posture as {CENTRE}x@{tree.names[-1]}=1.57")
    return q


def _wrench(tree: Tree, q: Array, pulled: int) -> Array:
    """Of every barycentric parameter at rest, gravity of 1 m/s^2 against an axis, (6, 10 n)."""
    still = np.zeros((1, tree.n))
    every = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
    found = linear(tree, Motion(np.zeros(1), q[None], still, still), every, -np.eye(3)[pulled])
    return np.asarray(found[1][0])


def _combination(minimal: MinimalSet, wanted: Array, name: str) -> Array:
    """A functional on the barycentric parameters as one on the minimal ones, (N,)."""
    wanted = np.where(minimal.known_zero.ravel(), 0.0, wanted)
    found = wanted @ minimal.lift
    if np.abs(found @ minimal.matrix - wanted).max() > IN_SPACE * np.abs(wanted).max(initial=1.0):
        raise SettingsError(
            f"'{name}' is not among what this recording tells: "
            + (
                "it needs the plate, and its weight without tare"
                if name == MASS
                else "its motion does not change with it; measure it along another axis, or in "
                "another posture"
            )
        )
    return np.asarray(found)
