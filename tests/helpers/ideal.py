"""Recordings of a perfect instrument, made without a physics engine, and what is true of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.recording import Recording, Truth
from testbed.core.robot.joint_law import JointLaw

EXACT = tb.Settings(position_cutoff="off", cutoff="off")


def ideal(
    tree: tb.Tree,
    duration: float = 10.0,
    rate: float = 200.0,
    seed: int = 0,
    own: Mapping[JointLaw, ArrayLike] | None = None,
) -> Recording:
    """What a perfect instrument with sensed kinematics records, no physics engine involved.

    Friction and rotors are the tree's; `own` adds coefficients of any law, one a joint.
    """
    rng = np.random.default_rng(seed)
    size = rng.normal(size=(2, tree.n, 5)) * 0.5 / np.arange(1, 6)
    motion = tb.Fourier(0.2, rng.uniform(-0.5, 0.5, tree.n), *size)
    states = motion.at(np.arange(0, duration, 1 / rate))
    torque = tb.joint_forces(tree, states)
    wrench = tb.base_wrench(tree, states)
    dry, wet, rotor = (
        np.array([getattr(j, k) for j in tree.joints])
        for k in ("coulomb", "viscous", "rotor_inertia")
    )
    friction = dry * np.sign(states.qd) + wet * states.qd
    torque = torque + friction + rotor * states.qdd
    for law, coefficients in (own or {}).items():
        torque = torque + np.asarray(coefficients) * law.column(states.qd, states.qdd)
    truth = Truth(states.q, states.qd, states.qdd, torque, friction, wrench)
    return Recording(
        tree.names,
        states.t,
        states.q,
        torque,
        wrench,
        states.qd,
        states.qdd,
        tare=np.zeros(6),
        truth=truth,
    )


def true_values(tree: tb.Tree, method: Signal, zeros: bool = False) -> Array:
    model: Signal = "wrench" if method == "wrench" else "torque"
    delta = tb.minimal_set(tree, model, zeros=zeros).values(tb.barycentric(tree))
    if method == "wrench":
        return delta
    return np.concatenate(
        [delta, [j.coulomb for j in tree.joints], [j.viscous for j in tree.joints]]
    )


def plus(recording: Recording, **extra: ArrayLike) -> Recording:
    """A recording with something added to some of its signals."""
    changed: dict[str, Any] = {s: recording.measured(s) + np.asarray(v) for s, v in extra.items()}
    return replace(recording, **changed)
