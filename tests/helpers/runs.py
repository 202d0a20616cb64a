"""Runs without a physics engine: what a good instrument records of any robot, identified."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import testbed as tb
from testbed.lab.experiment.evaluate import prior_and_options, with_body_metrics
from testbed.lab.experiment.experiment_tables import Bound
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.robots import random_robot

ROBOTS = ("puma", "ur5", "gantry", "random")
"""A robot with friction, one without, one that slides, a tree."""

MODELS = {
    "puma": ROOT / "models/puma562.xml",
    "ur5": GOLDEN / "robots/ur5.urdf",
    "gantry": GOLDEN / "robots/gantry_ppp_rrr.urdf",
}


def robot(name: str) -> tb.Tree:
    """One of ROBOTS."""
    if name == "random":
        return random_robot(np.random.default_rng(5), 5).tree()
    return tb.load_tree(MODELS[name])


def noisy(recording: tb.Recording, seed: int = 3, size: float = 0.5) -> tb.Recording:
    """Noise on the plate and on the torques of a perfect recording."""
    rng = np.random.default_rng(seed)
    wrench, torque = recording.measured("wrench"), recording.measured("torque")
    return replace(
        recording,
        wrench=wrench + size * rng.normal(size=wrench.shape),
        torque=torque + size * rng.normal(size=torque.shape),
    )


def without(recording: tb.Recording, signal: str) -> tb.Recording:
    """The recording of an instrument that lacks a signal."""
    lacking: dict[str, Any] = {signal: None}
    return replace(recording, **lacking)


def experiment(expect: dict[str, Bound] | None = None) -> tb.Experiment:
    """An experiment that says no more than it must."""
    return tb.Experiment(name="made", model=str(MODELS["puma"]), expect=expect or {})


def run_of(
    tree: tb.Tree, recording: tb.Recording | None = None, asked: tb.Experiment | None = None
) -> tb.Run:
    """What can be identified from a recording with sensed kinematics; judged if asked for."""
    recording = noisy(ideal(tree)) if recording is None else recording
    bodies = None if asked is None else prior_and_options(asked, tree)
    run = tb.assemble_run(
        tree, recording, name="made", settings=EXACT, experiment=asked, bodies=bodies
    )
    return with_body_metrics(run)


def judged_run(name: str) -> tb.Run:
    """A run of one of ROBOTS, with its truth."""
    return run_of(robot(name), asked=experiment())
