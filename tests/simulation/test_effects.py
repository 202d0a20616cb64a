"""Effects in the plant: each follows its own law, and none of friction reaches the plate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.base.errors import ExperimentError, ModelError, SettingsError, TestbedError
from testbed.core.robot.friction import COULOMB, VISCOUS
from testbed.core.robot.model_file import ModelFile
from testbed.core.robot.rotor_spin import with_rotor_spin
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.rig import robot_of
from testbed.lab.simulation.effect import Effect, ForceFunction
from testbed.lab.simulation.effects import EFFECT_KINDS, effect_from_table
from testbed.lab.simulation.plant import Plant, build_plant
from testbed.lab.simulation.rollout import Rollout, Sampling, simulate_motion
from tests.helpers.paths import ROOT
from tests.helpers.plants import PUMA, check_laws, waving
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot, random_robot
from tests.helpers.strategies import few, rngs, robots

SPEEDS = np.array([-1.0, -0.3, -0.1, 0.1, 0.3, 1.0])
STEP = 2.5e-4


def taken(tree: Tree, qd: Array, motor: float = 0.0, steps: int = 1, **table: object) -> Array:
    """What friction takes at speeds, one joint's."""
    found = []
    for speed in qd:
        push = effect_from_table(table).for_joints(tree.names).force_function(tree, 1e-3)
        assert push is not None
        for _ in range(steps):
            force = push(0.0, np.zeros(tree.n), np.full(tree.n, speed), np.full(tree.n, motor))
        found.append(-force[0])
    return np.array(found)


def test_friction_follows_its_law(puma: Tree) -> None:
    """Stribeck's and LuGre's bristles: formulas by hand."""
    sign, v = np.sign(SPEEDS), SPEEDS
    dip = np.exp(-((v / 0.2) ** 2))
    dry, wet = COULOMB.coefficients(puma)[0], VISCOUS.coefficients(puma)[0]
    stribeck = taken(puma, v, -20.0, kind="stribeck_friction", coefficient=2.0, speed=0.2)
    np.testing.assert_allclose(stribeck, 2 * sign * dip, rtol=1e-8)
    roots = taken(puma, v, kind="friction_term", term="square_root", coefficient=2.0)
    np.testing.assert_allclose(roots, 2 * sign * np.abs(v) ** 0.5, rtol=1e-12)
    for term in ("rotor", "load", "tar"):
        with refuses(TestbedError, term):
            taken(puma, v, kind="friction_term", term=term)
    slip = taken(puma, v, steps=400, kind="lugre_friction", static=1.5, speed=0.2)
    np.testing.assert_allclose(slip, sign * dry * (1 + 0.5 * dip) + wet * v, rtol=1e-6)
    for damping in (0.0, 100.0):  # at first a spring and a damper
        table: dict[str, Any] = {"kind": "lugre_friction", "stiffness": 1e4, "damping": damping}
        held = taken(puma, np.array([1e-6]), **table)
        assert held == pytest.approx((1e4 * 1e-3 + damping + wet) * 1e-6, rel=1e-3)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> tuple[Tree, Path]:
    path = tmp_path_factory.mktemp("robot") / "robot.xml"
    path.write_text(random_robot(np.random.default_rng(11), 3).mjcf())
    return tb.load_tree(path), path


def run(
    robot: tuple[Tree, Path], sampling: Sampling, forces: ForceFunction | None, viscous: float = 0.0
) -> Rollout:
    tree, path = robot
    rubbing = tree.with_joints({name: {"viscous": viscous} for name in tree.names})
    plant = build_plant(ModelFile(path), rubbing, STEP, changed_joints=tree.names)
    return simulate_motion(plant, tree, waving(3), 0.4, 60.0, sampling, forces=forces)


@pytest.mark.parametrize("averaged", [True, False])
def test_viscous_pushes_are_viscous_friction_and_know_time_and_place_of_every_step(
    averaged: bool, robot: tuple[Tree, Path]
) -> None:
    sampling, seen = Sampling(500.0, 8, averaged, 0.1), list[tuple[float, Array]]()

    def rubbing(time: float, q: Array, qd: Array, motor: Array) -> Array:
        seen.append((time, q.copy()))
        return -2.0 * qd

    inside, outside = run(robot, sampling, None, viscous=2.0), run(robot, sampling, rubbing)
    times = np.array([time for time, _ in seen])
    np.testing.assert_allclose(np.diff(times), STEP)
    first = int(np.searchsorted(times, -1e-9))
    assert abs(times[first]) < 1e-12
    np.testing.assert_allclose(seen[first][1], outside.truth.position[0], atol=2e-3)
    scale = np.abs(inside.truth.friction).max()
    assert scale > 0.1
    assert np.abs(inside.truth.friction - outside.truth.friction).max() < 0.02 * scale
    assert np.abs(inside.truth.position - outside.truth.position).max() < 1e-4


@few(8)
@given(robot=robots((2, 6)), rng=rngs)
def test_a_sample_that_is_integrated_at_once_is_that_of_its_small_steps(
    robot: Robot, rng: np.random.Generator, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Else a recording is another one as soon as an effect, even of zero, asks for small steps."""
    path = tmp_path_factory.mktemp("robot") / "robot.xml"
    path.write_text(robot.mjcf())
    tree = tb.load_tree(path)
    frictions = zip(tree.names, *rng.uniform(0, 1, (2, tree.n)), strict=True)
    tree = tree.with_joints({name: {"coulomb": c, "viscous": v} for name, c, v in frictions})
    plant = build_plant(ModelFile(path), tree, STEP, changed_joints=tree.names)
    for averaged in (True, False):
        asked = tree, waving(tree.n), 0.5, 60.0, Sampling(1000.0, 4, averaged, 0.1)
        short, all_steps = (
            simulate_motion(plant, *asked, forces=forces).truth
            for forces in (None, lambda t, q, v, motor: np.zeros(tree.n))
        )
        for name, values in vars(all_steps).items():
            if not values.size:
                continue  # no force sensors
            off = np.abs(getattr(short, name) - values).max()
            assert off <= 2e-6 * np.abs(values).max(), name


def built(tree: Tree, path: Path = PUMA, **table: object) -> tuple[Effect, tb.Tree, Plant]:
    """An effect on a robot, and the plant with it."""
    effect = effect_from_table(table).for_joints(tree.names)
    loaded = effect.robot_with_effect(tree)
    return effect, loaded, build_plant(ModelFile(path), loaded, 1e-3, effects=[effect])


@few(4)
@given(robot=robots((4, 4)))
def test_a_payload_is_the_same_body_for_tree_and_plant(
    robot: Robot, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """On any link: the plant's self-check compares them."""
    path = tmp_path_factory.mktemp("payload") / "r.xml"
    path.write_text(robot.mjcf())
    tree = tb.load_tree(path)
    loaded = built(tree, path, kind="payload", joint=tree.names[1], mass=0.7,
                   centre=[0.1, -0.05, 0.2], inertia=[2e-3, 3e-3, 4e-3])[1]  # fmt: skip
    assert loaded.inertias[1].mass == pytest.approx(tree.inertias[1].mass + 0.7)
    if loaded.joints[1].revolute and np.any(tree.gravity):
        with refuses(ModelError, path.name):
            build_plant(ModelFile(path), loaded, 1e-3)


def test_a_rotors_spin_reaches_the_plate_by_its_law(robot: tuple[Tree, Path], puma: Tree) -> None:
    """MuJoCo's geared bodies against a change of inertias; sliding joints have no spin."""
    rng = np.random.default_rng(0)
    for name in ("puma562.xml", "puma562.urdf"):
        path = ROOT / "models" / name
        _, loaded, plant = built(
            tb.load_tree(path), path, kind="geared_rotor", inertia=3e-4, ratio=-50.0
        )
        data, (q, qd, motor) = mujoco.MjData(plant.model), rng.uniform(0.5, 1.0, (3, loaded.n))
        data.qpos[:], data.qvel[:], data.ctrl[:] = (
            plant.velocity_ratios @ q,
            plant.velocity_ratios @ qd,
            motor,
        )
        mujoco.mj_forward(plant.model, data)
        motion = tb.Motion(np.zeros(1), q[None], qd[None], data.qacc[plant.velocity_index][None])
        still = tb.base_wrench(loaded, motion)[0]
        turning = with_rotor_spin(loaded, dict.fromkeys(loaded.names, -50.0 * 3e-4))
        spun = tb.base_wrench(turning, motion)[0] - still
        felt = plant.X_BS.wrench(data.sensordata[plant.plate_index]) - plant.tare - still
        np.testing.assert_allclose(felt, spun, atol=1e-3 * np.abs(spun).max())
    minimal = tb.minimal_set(puma, "wrench", zeros=True)
    spun = with_rotor_spin(puma, {"waist": 0.018})
    more = minimal.values(tb.barycentric(spun)) - minimal.values(tb.barycentric(puma))
    expected = [0.018 * (name == "K*1zz") for name in minimal.names]
    np.testing.assert_allclose(more, expected, atol=1e-15)
    asked = tb.Experiment.of_model(PUMA, ["robot.joint.waist.rotor_spin=0.018"])
    assert (asked.robot.rotor_spins, robot_of(asked).names) == ({"waist": 0.018}, puma.names)
    tree = robot[0]
    sliding = next(joint.name for joint in tree.joints if not joint.revolute)
    with refuses(SettingsError, sliding):
        effect_from_table({"kind": "geared_rotor"}).for_joints(tree.names).robot_with_effect(tree)
    with refuses(ModelError, sliding):
        with_rotor_spin(tree, {sliding: 0.1})


def test_the_bedplate_gives_way_and_tilts_as_asked(puma: Tree) -> None:
    """Springs and dampers by MuJoCo's own mass matrix; gravity keeps its size and turns."""
    soft: dict[str, Any] = {"kind": "compliant_plate", "damping": 0.1}
    plant = built(puma, frequency=80.0, **soft)[2]
    model = plant.model
    assert model.nv == puma.n + 6
    data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    plate = [k for k in range(model.nv) if model.joint(model.dof_jntid[k]).name not in puma.names]
    moved = np.diagonal(mass)[plate]
    pulse = 160 * np.pi
    np.testing.assert_allclose(model.jnt_stiffness[plate], moved * pulse**2, rtol=1e-6)
    np.testing.assert_allclose(model.dof_damping[plate], 0.2 * moved * pulse, rtol=1e-6)
    again = effect_from_table(soft)
    with refuses(SettingsError, "compliant_plate"):
        build_plant(ModelFile(PUMA), puma, 1e-3, effects=[again, again])
    tilted = built(puma, kind="tilt", angle=0.1, direction=np.pi / 2)[2]
    size = np.linalg.norm(puma.gravity)
    turned = size * np.array([-np.sin(0.1), 0, -np.cos(0.1)])
    np.testing.assert_allclose(tilted.model.opt.gravity, turned, atol=1e-9)


def test_an_experiment_file_says_effects() -> None:
    """Every kind is read with its defaults and written back."""
    file = ROOT / "experiments/noise_free.toml"
    for kind, made in EFFECT_KINDS.items():
        experiment = tb.Experiment.from_toml(file, [f'simulation.effect=[{{kind="{kind}"}}]'])
        assert experiment.simulation.effect == (made(),)
        assert f'kind = "{kind}"' in experiment.as_toml()


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
    effect = effect_from_table(said).for_joints(tree.names)
    plant = build_plant(ModelFile(path), tree, STEP, changed_joints=tree.names, effects=(effect,))
    sampling = Sampling(1000.0, 4, False, 0.1)
    run = simulate_motion(
        plant, tree, waving(n), 0.4, 60.0, sampling, gears=effect.gear_friction(tree)
    )
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
    asked = tb.Experiment.from_toml(
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
        tb.record(tb.Experiment.from_toml(ROOT / "experiments/table6.toml", both))
