"""Friction of gears under load: the equation holds at every instant, whoever solves it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.core.base.errors import ExperimentError
from testbed.core.robot.model_file import ModelFile
from testbed.lab.simulation.effects import effect_of
from testbed.lab.simulation.plant import build_plant
from testbed.lab.simulation.rollout import Sampling, simulate_motion
from tests.helpers.paths import ROOT
from tests.helpers.plants import check_laws, waving
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot
from tests.helpers.strategies import few, rngs, robots

STEP = 2.5e-4


@few(6)
@given(robot=robots((2, 6)), rng=rngs)
def test_gears_take_what_their_law_says_of_the_load(
    robot: Robot, rng: np.random.Generator, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The load is Newton's and Euler's torque of the motion that came of it; rotors are none."""
    path: Path = tmp_path_factory.mktemp("robot") / "robot.xml"
    path.write_text(robot.mjcf())
    tree = tb.load_tree(path)
    n = tree.n
    dry, wet, rotor, share, viscous = rng.uniform(0.05, 0.3, (5, n))
    back, static, viscous = rng.uniform(0, 1, n), rng.uniform(1, 2, n), 0.1 * viscous
    joints = zip(tree.names, dry, wet, rotor, strict=True)
    tree = tree.with_joints(
        {k: {"coulomb": c, "viscous": d, "rotor_inertia": r} for k, c, d, r in joints}
    )
    said = {
        "kind": "load_friction", "share": share.tolist(), "driven": back.tolist(),
        "viscous_load": viscous.tolist(), "static": static.tolist(), "speed": 0.2,
    }  # fmt: skip
    effect = effect_of(said).on(tree.names)
    plant = build_plant(ModelFile(path), tree, STEP, changed=tree.names, effects=(effect,))
    sampling = Sampling(1000.0, 4, False, 0.1)
    run = simulate_motion(plant, tree, waving(n), 0.4, 60.0, sampling, gears=effect.gears(tree))
    true = run.truth
    load = true.torque - true.friction - rotor * true.acceleration
    motion = tb.Motion(run.time, true.position, true.velocity, true.acceleration)
    np.testing.assert_allclose(load, tb.joint_forces(tree, motion), atol=1e-9 * np.abs(load).max())
    end = true.velocity + STEP * true.acceleration
    middle = (true.velocity + end) / 2
    level = dry * (1 + (static - 1) * np.exp(-((true.velocity / 0.2) ** 2)))
    level = level + share * np.where(load * true.friction > 0, 1.0, back) * np.abs(load)
    law = np.sign(end) * level + (wet + viscous * np.abs(load)) * middle
    slips = np.abs(end) > 1e-9
    assert slips.mean() > 0.5
    np.testing.assert_allclose(true.friction[slips], law[slips], rtol=1e-7, atol=1e-9)
    assert (np.abs(true.friction[~slips]) <= level[~slips] * (1 + 1e-9)).all()


def test_the_plate_feels_none_of_it_and_two_owners_are_refused() -> None:
    """Else the plate's estimate would be of another robot; and drives that warm up say so."""
    words = ["motion.duration=2", "motion.candidates=1", "measurement.averaged=false"]
    gear, warm = "{kind='load_friction'}", "{kind='warming_drives',rise=10,time_constant=2}"
    asked = tb.Experiment.load(
        ROOT / "experiments/table6.toml", [*words, f"simulation.effect=[{gear},{warm}]"]
    )
    recording, tree = tb.record(asked), tb.load_tree(ROOT / "models/puma562.xml")
    assert recording.truth is not None
    check_laws(tree, recording.time, recording.truth, 1e-9)
    assert recording.temperature is not None
    want = 25 + 10 * (1 - np.exp(-recording.time / 2))
    np.testing.assert_allclose(recording.temperature, np.tile(want[:, None], tree.n))
    both = [*words, f"simulation.effect=[{gear},{{kind='lugre_friction'}}]"]
    with refuses(ExperimentError, "lugre_friction"):
        tb.record(tb.Experiment.load(ROOT / "experiments/table6.toml", both))
