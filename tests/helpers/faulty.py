"""Recordings of instruments with faults, of any robot, no physics engine involved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import testbed as tb
from testbed.instruments.chain import Instrument, measure
from testbed.recordings.recording import Recording, Truth
from tests.helpers.measured import random_fourier

USUAL = Instrument(
    encoder_resolution=1e-4, encoder_noise=1e-4, torque_noise=0.5, force_noise=0.5, moment_noise=0.1
)
"""Of table6, with exact torque constants."""


def clean(tree: tb.Tree, seed: int, *, duration: float = 20.0, rate: float = 500.0) -> Recording:
    """With the noise of table6, along a motion of its own, and the truth."""
    motion = random_fourier(tree, np.random.default_rng(seed), 1.0)
    states = motion.at(np.arange(0, duration, 1 / rate))
    tare = tb.pedestal_wrench(tree)
    truth = Truth(
        states.q,
        states.qd,
        states.qdd,
        tb.joint_forces(tree, states),
        np.zeros_like(states.q),
        tb.base_wrench(tree, states) + tare,
    )
    usual = replace(USUAL, rate=rate)
    return measure(usual, tree.names, states.t, truth, tare, {}, seed)
