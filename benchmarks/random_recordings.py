"""Recordings of random motions, made from the equations of rigid bodies: fast, and exactly true."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.recordings.metadata import NO_METADATA
from testbed.core.recordings.recording import Recording, Truth
from testbed.lab.experiment.motions import experiment_motion
from testbed.lab.instruments.chain import Instrument, measure
from testbed.motion.fourier import Fourier
from testbed.motion.limits import joint_limits
from testbed.motion.random_motion import random_motion
from testbed.sensors.sensor_error import SensorError
from tests.helpers.paths import GOLDEN, ROOT

ROBOTS: Mapping[str, Path] = {"puma": ROOT / "models/puma562.xml"} | {
    name: GOLDEN / f"robots/{name}.urdf"
    for name in ("ur5", "gantry_ppp_rrr", "stanford", "kuka_lwr4")
}
SPEEDS: Mapping[str, float | None] = {"default": None, "slow": 0.3}
"""Greatest joint speed [rad/s or m/s] of a random motion; None for the robot's own."""

MOTIONS = (*SPEEDS, "chosen")
"""Besides, the best of forty random ones, as experiments/table6.toml runs it: of the PUMA."""

PLATE = Instrument(
    encoder_resolution=1e-4, encoder_noise=1e-4, force_noise=0.5, moment_noise=0.1, torque_noise=0.5
)
"""The instrument of table6, its torque constants exact."""

QUIET = 0.1
"""Part of the plate's white noise that stands beside coloured noise."""

NOISES: Mapping[str, tuple[SensorError, ...]] = {
    "white": (),
    "ar .3 s": (tb.PlateColouredNoise(time_constant=0.3),),
    "ar 3 s": (tb.PlateColouredNoise(time_constant=3.0),),
    "pink": (tb.PlatePinkNoise(lowest=0.02),),
}
"""Of the plate; joints' torques have white noise always."""


def instrument(noise: str, faults: Sequence[SensorError] = ()) -> Instrument:
    """That of table6, its plate with one of NOISES.

    Args:
        noise: Which.
        faults: What is wrong besides.
    """
    quiet = QUIET if NOISES[noise] else 1.0
    return replace(
        PLATE,
        force_noise=quiet * PLATE.force_noise,
        moment_noise=quiet * PLATE.moment_noise,
        fault=(*NOISES[noise], *faults),
    )


def happened(tree: tb.Tree, motion: str, seconds: float, seed: int) -> tuple[Array, Truth, Array]:
    """Times, what is true of a random motion, and the tare; joints without friction.

    Args:
        tree: The robot.
        motion: One of MOTIONS.
        seconds: Duration.
        seed: Of the motion.
    """
    states = _series(tree, motion, seed).at(np.arange(0, seconds, 1 / PLATE.rate))
    tare = tb.pedestal_wrench(tree)
    still = np.zeros_like(states.q)
    torque, wrench = tb.joint_forces(tree, states), tb.base_wrench(tree, states) + tare
    return states.t, Truth(states.q, states.qd, states.qdd, torque, still, wrench), tare


def _series(tree: tb.Tree, motion: str, seed: int) -> Fourier:
    if motion == "chosen":
        return _chosen(seed)
    speed = SPEEDS[motion]
    limits = joint_limits(tree, {} if speed is None else dict.fromkeys(tree.names, speed), {})
    return random_motion(tree, limits, 0.1, 5, np.random.default_rng(seed))


@lru_cache(maxsize=1)
def _chosen(seed: int) -> Fourier:
    table6 = tb.Experiment.from_toml(ROOT / "experiments/table6.toml", [f"seed={seed}"])
    return experiment_motion(table6, tb.load_tree(ROBOTS["puma"]))


def recorded(
    tree: tb.Tree,
    motion: str,
    noise: str,
    seconds: float,
    seed: int,
    faults: Sequence[SensorError] = (),
) -> Recording:
    """A recording of a motion of its own, without its truth.

    Args:
        tree: The robot.
        motion: One of MOTIONS.
        noise: One of NOISES.
        seconds: Duration.
        seed: Of motion and noise.
        faults: What is wrong with the instrument.
    """
    time, truth, tare = happened(tree, motion, seconds, seed)
    return measure(
        instrument(noise, faults), tree.names, time, truth, tare, NO_METADATA, seed
    ).blind()
