"""Effects in the plant: each follows its own law, none of friction reaches the plate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import SettingsError
from testbed.robot.friction import COULOMB, VISCOUS
from testbed.robot.model_file import ModelFile
from testbed.robot.rotor_spin import with_rotor_spin
from testbed.robot.tree import Tree
from testbed.simulation.build import build_plant
from testbed.simulation.effect import Effect
from testbed.simulation.effects import KINDS, effect_of
from tests.helpers.paths import ROOT
from tests.helpers.robots import random_robot

FRICTION = [kind for kind in KINDS if kind.endswith("_friction")]
ROBOTS = ("puma562.xml", "puma562.urdf")


def torque(effect: Effect, tree: Tree, qd: Array, motor: float = 0.0, steps: int = 1) -> Array:
    """What friction takes at speeds, one joint's."""
    found = []
    for speed in qd:
        push = effect.on(tree.names).forces(tree, 1e-3)
        assert push is not None
        v = np.full(tree.n, speed)
        for _ in range(steps):
            force = push(0.0, np.zeros(tree.n), v, np.full(tree.n, motor))
        found.append(-force[0])
    return np.array(found)


SPEEDS = np.array([-1.0, -0.3, -0.1, 0.1, 0.3, 1.0])


def test_friction_follows_its_law(puma: Tree) -> None:
    sign = np.sign(SPEEDS)
    stribeck = effect_of({"kind": "stribeck_friction", "coefficient": 2.0, "speed": 0.2})
    want = 2 * sign * np.exp(-((SPEEDS / 0.2) ** 2))
    np.testing.assert_allclose(torque(stribeck, puma, SPEEDS), want, rtol=1e-8)
    power = effect_of({"kind": "power_friction", "coefficient": 3.0, "exponent": 2.0})
    np.testing.assert_allclose(torque(power, puma, SPEEDS), 3 * sign * SPEEDS**2, rtol=1e-8)
    lopsided = effect_of({"kind": "asymmetric_friction", "coulomb": 1.0, "viscous": 0.5})
    want = np.where(SPEEDS > 0, 1 + 0.5 * SPEEDS, 0.0)
    np.testing.assert_allclose(torque(lopsided, puma, SPEEDS), want, rtol=1e-8)
    load = effect_of({"kind": "load_friction", "share": 0.1})
    np.testing.assert_allclose(torque(load, puma, SPEEDS, -20.0), 2.0 * sign, rtol=1e-8)


def test_bristles_slip_at_the_steady_law(puma: Tree) -> None:
    """After a while at constant speed: coulomb with the Stribeck excess, and viscous."""
    lugre = effect_of({"kind": "lugre_friction", "static": 1.5, "speed": 0.2})
    dry, wet = COULOMB.coefficients(puma)[0], VISCOUS.coefficients(puma)[0]
    want = np.sign(SPEEDS) * dry * (1 + 0.5 * np.exp(-((SPEEDS / 0.2) ** 2))) + wet * SPEEDS
    np.testing.assert_allclose(torque(lugre, puma, SPEEDS, steps=400), want, rtol=1e-6)
    small = effect_of({"kind": "lugre_friction", "stiffness": 1e4, "damping": 0.0})
    held = torque(small, puma, np.array([1e-6]), steps=1)
    assert held == pytest.approx(1e4 * 1e-6 * 1e-3 + wet * 1e-6, rel=1e-3)  # a spring, still


@pytest.mark.slow
@pytest.mark.parametrize("kind", FRICTION)
def test_no_friction_reaches_the_plate(kind: str) -> None:
    """The wrench is that of the motion alone, and torque less friction what moves the bodies."""
    words = ["motion.duration=1", "motion.candidates=1", f'simulation.effect=[{{kind="{kind}"}}]']
    experiment = tb.Experiment.load(ROOT / "experiments/noise_free.toml", words)
    truth = tb.simulate(experiment).truth
    assert truth is not None
    plain = tb.simulate(tb.Experiment.load(ROOT / "experiments/noise_free.toml", words[:2])).truth
    assert plain is not None
    tree = tb.load_tree(experiment.model)
    assert np.abs(truth.friction - plain.friction).max() > 0.1
    motion = tb.Motion(
        np.arange(len(truth.position)) / 1e3, truth.position, truth.velocity, truth.acceleration
    )
    gap = truth.torque - truth.friction - tb.joint_forces(tree, motion)
    assert np.abs(gap).max() < 2e-2 * np.abs(truth.torque).max()  # means of a sample, not instants
    left = truth.wrench - tb.base_wrench(tree, motion)
    assert np.abs(left - np.median(left, axis=0)).max() < 2e-3 * np.abs(truth.wrench).max()


def test_a_payload_is_the_same_body_for_tree_and_plant(tmp_path: Path) -> None:
    """On random trees, on any link: the plant's self-check compares them."""
    for seed in range(4):
        made = random_robot(np.random.default_rng(seed), 4)
        path = tmp_path / f"{seed}.xml"
        path.write_text(made.mjcf())
        tree = tb.load_tree(path)
        table = {"kind": "payload", "joint": tree.names[seed % 4], "mass": 0.7,
                 "centre": [0.1, -0.05, 0.2], "inertia": [2e-3, 3e-3, 4e-3]}  # fmt: skip
        effect = effect_of(table).on(tree.names)
        loaded = effect.robot(tree)
        build_plant(ModelFile(path), loaded, 1e-3, effects=[effect])
        with pytest.raises(tb.errors.ModelError, match="do not feel the robot"):
            build_plant(ModelFile(path), loaded, 1e-3)


@pytest.mark.parametrize("name", ROBOTS)
def test_spin_reaches_the_plate_by_its_law(name: str) -> None:
    """MuJoCo's geared bodies against a change of inertias: the plant refuses what differs."""
    path = ROOT / "models" / name
    tree = tb.load_tree(path)
    effect = effect_of({"kind": "geared_rotor", "inertia": 3e-4, "ratio": -50.0}).on(tree.names)
    loaded = effect.robot(tree)
    plant = build_plant(ModelFile(path), loaded, 1e-3, effects=[effect])
    assert plant.model.nv == 2 * tree.n
    assert effect.flaw(plant, loaded) is None
    other = effect_of({"kind": "geared_rotor", "inertia": 3e-4, "ratio": -51.0}).on(tree.names)
    assert "rotors' spin" in str(other.flaw(plant, loaded))


def test_spin_of_a_rotor_on_the_bedplate_adds_to_the_first_inertia(puma: Tree) -> None:
    minimal = tb.minimal_set(puma, "reaction", zeros=True)
    spun = with_rotor_spin(puma, {"waist": 0.018})
    more = minimal.values(tb.barycentric(spun)) - minimal.values(tb.barycentric(puma))
    assert dict(zip(minimal.names, more.tolist(), strict=True)) == pytest.approx(
        {name: 0.018 * (name == "K*1zz") for name in minimal.names}, abs=1e-15
    )


def test_sliding_joints_have_no_spin(tmp_path: Path) -> None:
    made = random_robot(np.random.default_rng(3), 5)
    path = tmp_path / "robot.xml"
    path.write_text(made.mjcf())
    tree = tb.load_tree(path)
    sliding = [joint.name for joint in tree.joints if not joint.revolute]
    assert sliding, "the seed makes a sliding joint"
    with pytest.raises(SettingsError, match="slides"):
        effect_of({"kind": "geared_rotor"}).on(tree.names).robot(tree)
    with pytest.raises(tb.errors.ModelError, match="slides"):
        with_rotor_spin(tree, {sliding[0]: 0.1})


def test_the_plate_gives_way_as_stiff_as_asked(puma: Tree) -> None:
    path = ROOT / "models/puma562.xml"
    soft = effect_of({"kind": "compliant_plate", "frequency": 80.0})
    plant = build_plant(ModelFile(path), puma, 1e-3, effects=[soft])
    assert plant.model.nv == puma.n + 6
    wrong = effect_of({"kind": "compliant_plate", "frequency": 81.0})
    assert "springs" in str(wrong.flaw(plant, puma))


def test_a_plate_is_on_springs_once(puma: Tree) -> None:
    soft = effect_of({"kind": "compliant_plate"})
    with pytest.raises(SettingsError, match="on springs already"):
        build_plant(ModelFile(ROOT / "models/puma562.xml"), puma, 1e-3, effects=[soft, soft])


def test_gravity_is_turned_and_keeps_its_size(puma: Tree) -> None:
    path = ROOT / "models/puma562.xml"
    tilt = effect_of({"kind": "tilt", "angle": 0.1, "direction": np.pi / 2})
    gravity = build_plant(ModelFile(path), puma, 1e-3, effects=[tilt]).model.opt.gravity
    size = np.linalg.norm(puma.gravity)
    np.testing.assert_allclose(gravity, size * np.array([-np.sin(0.1), 0, -np.cos(0.1)]), atol=1e-9)


def simulated(settings: list[str]) -> tb.Recording:
    return tb.simulate(tb.Experiment.load(ROOT / "experiments/noise_free.toml", settings))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ('[{kind="wobble"}]', "'wobble'"),
        ("[{coefficient=1}]", "an effect is a table with its kind"),
        ('[{kind="payload", mass=-1}]', "payload: mass is a positive number"),
        ('[{kind="payload", joint="wrist"}]', "'wrist'"),
        ('[{kind="tilt", slope=1}]', "'slope'"),
        ('[{kind="stribeck_friction", coefficient={wrist=1.0}}]', "'wrist'"),
    ],
)
def test_what_is_not_understood_is_refused(words: str, said: str) -> None:
    settings = [f"simulation.effect={words}", "motion.duration=1", "motion.candidates=1"]
    with pytest.raises(tb.errors.TestbedError, match=said) as refused:
        simulated(settings)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", KINDS)
def test_effects_are_written_back_as_they_were_read(kind: str) -> None:
    words = [f'simulation.effect=[{{kind="{kind}"}}]']
    experiment = tb.Experiment.load(ROOT / "experiments/noise_free.toml", words)
    assert experiment.simulation.effect == (KINDS[kind](),)
    assert f'kind = "{kind}"' in experiment.as_toml()
