"""Shafts that turn with several joints: which of their terms have columns of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.dynamics.drive_set import drive_set
from testbed.dynamics.witnesses import verify_drives
from testbed.errors import ModelError, SettingsError, UnknownName
from testbed.identification.drive_findings import identify_drives
from testbed.identification.predict import own_torque
from testbed.recordings.recording import Recording
from testbed.robot.shafts import with_shafts
from tests.helpers.chains import X, Y, Z, chain
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.robots import random_robot

WRIST = {"motor": {"j1": 1.0, "j2": 1.0}}
DIFFERENTIAL = {"left": {"j1": 0.5, "j2": 0.5}, "right": {"j1": 0.5, "j2": -0.5}}


def names(tree: tb.Tree, *laws: str) -> tuple[str, ...]:
    found = drive_set(tree, tb.minimal_set(tree, "dynamic"), laws)
    assert verify_drives(tree, found).holds
    return found.names


def test_a_shaft_rubs_beside_its_joints() -> None:
    tree = with_shafts(chain(("revolute", Z), ("revolute", Y)), WRIST)
    assert {"coulomb/motor", "viscous/motor", "rotor/motor"} <= set(
        names(tree, "coulomb", "viscous", "rotor")
    )


def test_the_inertia_of_a_shaft_of_parallel_joints_is_the_outer_bodys() -> None:
    """q1 + q2 is how the second body turns."""
    tree = with_shafts(chain(("revolute", Z), ("revolute", Z)), WRIST)
    assert "K2zz+rotor/motor" in names(tree, "rotor/motor")


def test_a_differentials_two_shafts_rub_as_its_joints_do() -> None:
    """(v1 + v2)^2 + (v1 - v2)^2 = 2 v1^2 + 2 v2^2: of four viscous coefficients three are told."""
    tree = with_shafts(chain(("revolute", Z), ("revolute", Y)), DIFFERENTIAL)
    own = [name for name in names(tree, "viscous") if name.startswith("viscous")]
    assert len(own) == 3
    assert len([n for n in names(tree, "coulomb") if n.startswith("coulomb")]) == 4


def test_an_offset_is_the_joints_alone() -> None:
    tree = with_shafts(chain(("revolute", Z), ("revolute", Y)), WRIST)
    assert "offset/motor" not in names(tree, "offset")


def with_friction(tree: tb.Tree, recording: Recording, turn: Array) -> Recording:
    """Dry and viscous friction and inertia of a shaft, by power: 1.5, 0.7 and 0.2."""
    assert recording.velocity is not None
    assert recording.acceleration is not None
    assert recording.torque is not None
    speed, faster = recording.velocity @ turn, recording.acceleration @ turn
    rubs = 1.5 * np.sign(speed) + 0.7 * speed + 0.2 * faster
    return replace(recording, torque=recording.torque + rubs[:, None] * turn)


@pytest.mark.parametrize("seed", range(12))
def test_what_a_shaft_takes_is_found_on_random_trees(seed: int) -> None:
    rng = np.random.default_rng(700 + seed)
    turning: list[int] = []
    while len(turning) < 2:
        tree = random_robot(rng, int(rng.integers(2, 7))).tree()
        turning = [k for k, joint in enumerate(tree.joints) if joint.revolute]
    some = rng.choice(turning, 2, replace=False)
    turn = np.zeros(tree.n)
    turn[some] = rng.uniform(0.5, 2, 2) * rng.choice([-1, 1], 2)
    tree = with_shafts(tree, {"shaft": {tree.names[k]: float(turn[k]) for k in some}})
    recording = with_friction(tree, ideal(tree, seed=seed), turn)
    settings = replace(EXACT, terms=("coulomb", "viscous", "rotor"), deadband=0.0)
    found = tb.identify(tree, recording, "internal", settings=settings)
    assert found.drives is not None
    assert verify_drives(tree, found.drives).holds
    truth = found.drives.values(tb.barycentric(tree), tree)
    shafts = [t for t in found.drives.asked if t.joint >= tree.n]
    for term, value in zip(shafts, (1.5, 0.7, 0.2), strict=True):
        truth = truth + value * found.drives.columns[:, found.drives.asked.index(term)]
    assert np.abs(found.values - truth).max() <= 1e-8 * np.abs(truth).max()


def test_a_prediction_counts_the_shaft() -> None:
    tree = with_shafts(chain(("revolute", Z), ("revolute", Y), ("revolute", X)), WRIST)
    turn = np.array([1.0, 1.0, 0.0])
    recording = with_friction(tree, ideal(tree), turn)
    settings = replace(EXACT, terms=("coulomb/motor", "viscous/motor", "rotor/motor"), deadband=0.0)
    found = tb.identify(tree, recording, "internal", settings=settings)
    assert recording.velocity is not None
    assert recording.acceleration is not None
    states = recording.time, recording.position, recording.velocity, recording.acceleration
    speed, faster = recording.velocity @ turn, recording.acceleration @ turn
    rubs = 1.5 * np.sign(speed) + 0.7 * speed + 0.2 * faster
    np.testing.assert_allclose(
        own_torque(tb.Motion(*states), found), rubs[:, None] * turn, atol=1e-7
    )


def test_terms_of_single_joints() -> None:
    tree = chain(("revolute", Z), ("revolute", Z), ("revolute", Y))
    found = names(tree, "coulomb", "rotor/j2", "offset/j3")
    assert found[-5:] == ("coulomb/j1", "coulomb/j2", "coulomb/j3", "rotor/j2", "offset/j3")
    with pytest.raises(UnknownName, match="j4"):
        names(tree, "rotor/j4")
    with pytest.raises(UnknownName, match="glue"):
        tb.Settings(terms=("glue/j1",))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"motor": {"j1": 1.0}}, "two joints or more"),
        ({"motor": {"j1": 1.0, "j2": 0.0}}, "not zero"),
        ({"j1": {"j1": 1.0, "j2": 1.0}}, "a name of its own"),
        ({"a": {"j1": 1.0, "j2": 1.0}, "b": {"j1": -2.0, "j2": -2.0}}, "one shaft"),
        ({"motor": {"j1": 1.0, "j3": 1.0}}, "prismatic"),
    ],
)
def test_what_is_no_shaft_is_refused(given: dict[str, dict[str, float]], said: str) -> None:
    tree = chain(("revolute", Z), ("revolute", Y), ("prismatic", Z))
    with pytest.raises(ModelError, match=said):
        with_shafts(tree, given)


def test_joints_that_a_shaft_couples_are_not_held_against_the_plate_one_by_one() -> None:
    tree = with_shafts(chain(("revolute", Z), ("revolute", Y)), WRIST)
    recording = ideal(tree)
    plate = tb.identify(tree, recording, "external", settings=EXACT)
    with pytest.raises(SettingsError, match=r"robot\.coupling"):
        identify_drives(tree, recording, plate)
