"""Postures about which a robot can move: that of zeros, or one that it can hold and is clear."""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.motion import Motion
from testbed.excitation.clearance import POSTURES, ClearanceTerm
from testbed.excitation.limit_terms import LimitTerm
from testbed.excitation.limits import Limits, motor_efforts
from testbed.excitation.proof import Rules
from testbed.excitation.samples import Computed
from testbed.robot.tree import Tree


def rest_posture(rules: Rules) -> Array:
    """The posture of zeros where it keeps all limits at rest, else the best of random ones.

    Args:
        rules: Limits of efforts, plate and clearance.

    Returns:
        (n,) [rad or m]; where no posture keeps all limits, the one that exceeds them least.
    """
    terms: list[LimitTerm] = list(rules.terms)
    if rules.collision is not None and rules.collision.pairs:
        terms.append(ClearanceTerm(rules.collision, rules.limits, rules.clearance))

    def excess(postures: Array) -> Array:
        still = Computed(rules.tree, _still(postures))
        found = [term.values(still).max(axis=0) for term in terms]
        return np.asarray(np.max(found, axis=0, initial=-np.inf))

    home = rules.limits.home
    if not terms or excess(home[None])[0] < 0:
        return home
    postures = tried_postures(rules.limits)
    return np.asarray(postures[excess(postures).argmin()])


def easiest_posture(tree: Tree, limits: Limits) -> Array:
    """The posture that asks least of its motors, of the zeros and random ones, (n,) [rad or m].

    Args:
        tree: The robot.
        limits: Of its joints.
    """
    postures = tried_postures(limits)
    share = np.abs(motor_efforts(tree, _still(postures))) / limits.effort
    return np.asarray(postures[share.max(axis=1).argmin()])


def tried_postures(limits: Limits) -> Array:
    """The posture of zeros and random ones, the same every time, (POSTURES + 1, n) [rad or m].

    Args:
        limits: Of the joints.
    """
    random = np.random.default_rng(0).uniform(limits.low, limits.high, (POSTURES, len(limits.low)))
    return np.vstack([limits.home, random])


def _still(postures: Array) -> Motion:
    nothing = np.zeros_like(postures)
    return Motion(np.arange(float(len(postures))), postures, nothing, nothing)
