"""Recordings of an instrument with noise, within the joints' ranges, no physics engine involved."""

from __future__ import annotations

import numpy as np

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.recordings.metadata import NO_METADATA
from testbed.core.recordings.recording import Recording, Truth
from testbed.core.robot.drive_torque import drive_torque
from testbed.lab.instruments.chain import Instrument, measure

SPEED = {"revolute": 1.5, "prismatic": 0.5}


def measured(
    tree: tb.Tree,
    seed: int = 0,
    *,
    duration: float = 20.0,
    rate: float = 200.0,
    speed: float = 1.0,
    memory: float = 0.0,
    noise: float = 1.0,
) -> Recording:
    """Encoders, drives and plate as in table6.

    Args:
        tree: The robot, with its friction and rotors, on its pedestal.
        seed: Of motion and noise.
        duration: [s].
        rate: [Hz].
        speed: Times a usual one.
        memory: Correlation of the noise from sample to sample.
        noise: Times 1e-4 rad, 0.5 N, 0.1 N m, 0.5 N m.
    """
    rng = np.random.default_rng(seed)
    motion = random_fourier(tree, rng, speed).at(np.arange(0, duration, 1 / rate))

    def some(size: float, channels: int) -> Array:
        white = rng.normal(size=(motion.samples, channels))
        for k in range(1, len(white) if memory else 0):
            white[k] = memory * white[k - 1] + np.sqrt(1 - memory**2) * white[k]
        return noise * size * white

    tare = tb.pedestal_wrench(tree)
    torque = tb.joint_forces(tree, motion) + drive_torque(tree, motion.qd, motion.qdd)
    return Recording(
        tree.names,
        motion.t,
        motion.q + noise * 1e-4 * rng.normal(size=motion.q.shape),
        torque=torque + some(0.5, tree.n),
        wrench=tb.base_wrench(tree, motion) + tare + np.hstack([some(0.5, 3), some(0.1, 3)]),
        tare=tare,
    )


def clean(tree: tb.Tree, seed: int, *, duration: float = 20.0, rate: float = 500.0) -> Recording:
    """By an instrument with the noise of table6 and exact torque constants, with the truth."""
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
    usual = Instrument(
        rate=rate, encoder_resolution=1e-4, encoder_noise=1e-4, torque_noise=0.5, force_noise=0.5,
        moment_noise=0.1,
    )  # fmt: skip
    return measure(usual, tree.names, states.t, truth, tare, NO_METADATA, seed)


def random_fourier(tree: tb.Tree, rng: np.random.Generator, speed: float) -> tb.Fourier:
    """A periodic motion that uses most of the joints' ranges, or of their speeds."""
    known = [joint.position_range for joint in tree.joints]
    wide = [3.0 if joint.revolute else 0.5 for joint in tree.joints]
    ranges = np.array(
        [r if np.isfinite(r).all() else [-w, w] for r, w in zip(known, wide, strict=True)]
    )
    half = np.diff(ranges, axis=1)[:, 0] / 2
    sine, cosine = rng.normal(size=(2, tree.n, 5)) / np.arange(1, 6)
    shape = tb.Fourier(0.1, np.zeros(tree.n), sine, cosine).at(np.linspace(0, 10, 500))
    fast = speed * np.array([SPEED[joint.kind] for joint in tree.joints])
    swing = np.abs(shape.q).max(axis=0)
    size = np.minimum(0.9 * half / swing, fast / np.abs(shape.qd).max(axis=0))
    room = 0.9 * half - size * swing
    offset = ranges.mean(axis=1) + 0.5 * rng.uniform(-1, 1, tree.n) * room
    return tb.Fourier(0.1, offset, size[:, None] * sine, size[:, None] * cosine)
